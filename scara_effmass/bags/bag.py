"""An open recording, of whatever format."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any, NamedTuple, final

from scara_effmass.bags.batches import LATEST_NS
from scara_effmass.bags.blocks import BlockDecoder
from scara_effmass.bags.definitions import check_definition
from scara_effmass.errors import BagError, DecodeError
from scara_effmass.wire.force import decode_force_block
from scara_effmass.wire.message_types import FORCE_BLOCK, JOINT_STATE

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator
    from pathlib import Path
    from types import TracebackType

    from rosbags.typesys.store import Typestore

    from scara_effmass.bags.batches import Losses, Source, Topic
    from scara_effmass.bags.blocks import JointStateBlock
    from scara_effmass.values import ForceBlock


class RawMessage(NamedTuple):
    """A message as CDR bytes, with the time at which it was recorded."""

    topic: str
    type: str
    log_time_ns: int
    data: bytes


@final
class Bag:
    """An open recording. Times are log times in [ns], the recorder's clock; messages come in their order.

    What cannot be read is left out and said in `losses`, some of it only once the messages have been read.
    """

    def __init__(self, path: Path, source: Source, losses: Losses) -> None:
        self.path = path
        self.topics: tuple[Topic, ...] = source.topics
        self.start_ns = source.start_ns
        self.end_ns = source.end_ns
        self._source = source
        self._losses = losses

    @property
    def duration_ns(self) -> int:
        """From the first to the last message."""
        return self.end_ns - self.start_ns

    @property
    def losses(self) -> tuple[str, ...]:
        """What could not be read so far, a line each."""
        return tuple(self._losses)

    @property
    def joint_state_topics(self) -> tuple[str, ...]:
        """The names of the topics of type sensor_msgs/JointState."""
        return tuple(topic.name for topic in self.topics if topic.type == JOINT_STATE)

    @property
    def types(self) -> Typestore:
        """The message types: those defined in the recording, else the known ones."""
        return self._source.types

    def messages(
        self, topics: Collection[str] | None = None, start_ns: int | None = None, stop_ns: int | None = None
    ) -> Iterator[RawMessage]:
        """Yield the messages of `topics` (None: all), from `start_ns` up to but without `stop_ns`.

        Raises BagError when a topic is not in the recording.
        """
        if unknown := set(topics or ()) - {topic.name for topic in self.topics}:
            known = ", ".join(topic.name for topic in self.topics)
            raise BagError(f"{self.path}: no topic {min(unknown)}; there are {known}")
        chosen = {number for number, topic in enumerate(self.topics) if topics is None or topic.name in topics}
        return self._messages(chosen, *_span(start_ns, stop_ns))

    def joint_state_blocks(
        self, topic: str | None = None, start_ns: int | None = None, stop_ns: int | None = None
    ) -> Iterator[JointStateBlock]:
        """Yield the joint states of `topic` (None: of the only topic that has any), as `messages` would.

        Raises BagError when the topic is not there or not of that type.
        """
        candidates = self.joint_state_topics
        name = candidates[0] if topic is None and len(candidates) == 1 else topic
        if name is None or name not in candidates:
            asked = f"no joint states on topic {name}" if name else "no topic named"
            right = (
                f"one of {', '.join(candidates)} would be right" if candidates else "it holds no joint states at all"
            )
            raise BagError(f"{self.path}: {asked}; {right}")
        check_definition(self.types, JOINT_STATE, str(self.path))
        chosen = {n for n, each in enumerate(self.topics) if (each.name, each.type) == (name, JOINT_STATE)}
        return self._blocks(name, chosen, *_span(start_ns, stop_ns))

    def force_blocks(self, topic: str) -> Iterator[ForceBlock]:
        """Yield the force blocks of `topic`; what is no ForceBlock is left out and said in `losses`.

        Raises BagError when the topic is not there, or the recording has another definition of the type.
        """
        check_definition(self.types, FORCE_BLOCK, str(self.path))
        return self._force_blocks(self.messages([topic]))

    def deserialize(self, message: RawMessage) -> Any:  # noqa: ANN401 - of a class that the recording defines
        """Return a message as an object with the fields of its type.

        Raises DecodeError.
        """
        try:
            return self.types.deserialize_cdr(message.data, message.type)
        except Exception as error:  # noqa: BLE001 - the code is generated from definitions nobody checked
            reason = " ".join(str(error).split()) or type(error).__name__
            raise DecodeError(f"{self.path}: {message.topic}: {message.type} cannot be decoded: {reason}") from None

    def close(self) -> None:
        """Close its files."""
        self._source.close()

    def __enter__(self) -> Bag:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def _messages(self, chosen: set[int], start_ns: int, stop_ns: int) -> Iterator[RawMessage]:
        for batch in self._source.batches(chosen, start_ns, stop_ns):
            columns = (batch.topic.tolist(), batch.log_time_ns.tolist(), batch.start.tolist(), batch.stop.tolist())
            for number, log_time_ns, start, stop in zip(*columns, strict=True):
                topic = self.topics[number]
                yield RawMessage(topic.name, topic.type, log_time_ns, batch.data[start:stop])

    def _force_blocks(self, messages: Iterator[RawMessage]) -> Iterator[ForceBlock]:
        left_out: Counter[str] = Counter()
        for message in messages:
            if message.type != FORCE_BLOCK:
                continue
            try:
                yield decode_force_block(message.data)
            except DecodeError as error:
                line = f"{self.path}: {message.topic}: left out: {error}"
                left_out[line] += 1
                self._losses.add(line, left_out[line])

    def _blocks(self, name: str, chosen: set[int], start_ns: int, stop_ns: int) -> Iterator[JointStateBlock]:
        decoder = BlockDecoder(f"{self.path}: {name}", self._losses)
        for batch in self._source.batches(chosen, start_ns, stop_ns):
            yield from decoder.blocks(batch)


def _span(start_ns: int | None, stop_ns: int | None) -> tuple[int, int]:
    return 0 if start_ns is None else start_ns, LATEST_NS if stop_ns is None else stop_ns

"""An open bag of any format."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, final

from rosbags.typesys.store import Typestore

from scara_effmass.bags.batches import MAX_TIME_NS, LossLog, Source, Topic
from scara_effmass.bags.definitions import check_definition
from scara_effmass.bags.joint_state_blocks import BlockDecoder, JointStateBlock
from scara_effmass.errors import BagError, DecodeError
from scara_effmass.values import ForceBlock
from scara_effmass.wire.force import decode_force_block
from scara_effmass.wire.message_types import FORCE_BLOCK, JOINT_STATE


class RawMessage(NamedTuple):
    """A message as CDR bytes, with the time at which it was recorded."""

    topic: str
    type: str
    log_time_ns: int
    data: bytes


@final
class Bag:
    """An open bag. Times are log times [ns] of the recorder's clock; messages come in log-time order.

    Data that cannot be read is skipped and listed in `losses`, partly only after the messages have been read.
    """

    def __init__(self, path: Path, source: Source, losses: LossLog) -> None:
        self.path = path
        self.topics: tuple[Topic, ...] = source.topics
        self.start_ns = source.start_ns
        self.end_ns = source.end_ns
        self._source = source
        self._losses = losses

    @property
    def duration_ns(self) -> int:
        """The time from the first to the last message."""
        return self.end_ns - self.start_ns

    @property
    def losses(self) -> tuple[str, ...]:
        """Data that could not be read so far, one line each."""
        return tuple(self._losses)

    @property
    def joint_state_topics(self) -> tuple[str, ...]:
        """The names of the topics of type sensor_msgs/JointState."""
        return tuple(topic.name for topic in self.topics if topic.type == JOINT_STATE)

    @property
    def types(self) -> Typestore:
        """The message types: those that the bag defines, otherwise the known ones."""
        return self._source.types

    def messages(
        self, topics: Collection[str] | None = None, start_ns: int | None = None, stop_ns: int | None = None
    ) -> Iterator[RawMessage]:
        """Yield the messages of `topics` (None: all) with start_ns <= log time < stop_ns.

        Raises BagError if the bag has no such topic.
        """
        names = {topic.name for topic in self.topics}
        if unknown := set(topics or ()) - names:
            known = ", ".join(topic.name for topic in self.topics)
            raise BagError(f"{self.path}: topic = {min(unknown)}: must be one of {known}")
        indices = {i for i, topic in enumerate(self.topics) if topics is None or topic.name in topics}
        return self._messages(indices, *_time_range(start_ns, stop_ns))

    def joint_state_blocks(
        self, topic: str | None = None, start_ns: int | None = None, stop_ns: int | None = None
    ) -> Iterator[JointStateBlock]:
        """Yield the joint states of `topic` (None: the only one) with start_ns <= log time < stop_ns.

        Raises BagError if the topic is missing or of another type.
        """
        candidates = self.joint_state_topics
        name = candidates[0] if topic is None and len(candidates) == 1 else topic
        if not candidates:
            raise BagError(f"{self.path}: contains no joint states")
        if name not in candidates:
            raise BagError(f"{self.path}: topic of joint states = {name}: must be one of {', '.join(candidates)}")
        check_definition(self.types, JOINT_STATE, str(self.path))
        indices = {i for i, topic in enumerate(self.topics) if (topic.name, topic.type) == (name, JOINT_STATE)}
        return self._joint_state_blocks(name, indices, *_time_range(start_ns, stop_ns))

    def force_blocks(self, topic: str) -> Iterator[ForceBlock]:
        """Yield the force blocks of `topic`; invalid messages are skipped and listed in `losses`.

        Raises BagError if the topic is missing or the bag defines ForceBlock differently.
        """
        check_definition(self.types, FORCE_BLOCK, str(self.path))
        return self._force_blocks(self.messages([topic]))

    def deserialize(self, message: RawMessage) -> Any:  # noqa: ANN401 - of a class that the bag defines
        """Return a message as an object with the fields of its type. Raises DecodeError."""
        try:
            return self.types.deserialize_cdr(message.data, message.type)
        except Exception as error:  # noqa: BLE001 - code generated from unchecked definitions
            reason = " ".join(str(error).split()) or type(error).__name__
            raise DecodeError(f"{self.path}: {message.topic}: {message.type} cannot be decoded: {reason}") from None

    def close(self) -> None:
        """Close the files."""
        self._source.close()

    def __enter__(self) -> Bag:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def _messages(self, indices: set[int], start_ns: int, stop_ns: int) -> Iterator[RawMessage]:
        for batch in self._source.batches(indices, start_ns, stop_ns):
            columns = (batch.topic.tolist(), batch.log_time_ns.tolist(), batch.start.tolist(), batch.stop.tolist())
            for index, log_time_ns, start, stop in zip(*columns, strict=True):
                topic = self.topics[index]
                yield RawMessage(topic.name, topic.type, log_time_ns, batch.data[start:stop])

    def _force_blocks(self, messages: Iterator[RawMessage]) -> Iterator[ForceBlock]:
        failure_counts: Counter[str] = Counter()
        for message in messages:
            if message.type != FORCE_BLOCK:
                continue
            try:
                yield decode_force_block(message.data)
            except DecodeError as error:
                line = f"{self.path}: {message.topic}: left out: {error}"
                failure_counts[line] += 1
                self._losses.add(line, failure_counts[line])

    def _joint_state_blocks(
        self, name: str, indices: set[int], start_ns: int, stop_ns: int
    ) -> Iterator[JointStateBlock]:
        decoder = BlockDecoder(f"{self.path}: {name}", self._losses)
        for batch in self._source.batches(indices, start_ns, stop_ns):
            yield from decoder.blocks(batch)


def _time_range(start_ns: int | None, stop_ns: int | None) -> tuple[int, int]:
    return 0 if start_ns is None else start_ns, MAX_TIME_NS if stop_ns is None else stop_ns

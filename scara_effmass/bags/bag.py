# SPDX-License-Identifier: Apache-2.0
"""An open bag of any format."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Sequence
from contextlib import ExitStack, suppress
from functools import cached_property
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
from rosbags.typesys.store import Typestore
from typing_extensions import Self

from scara_effmass.bags.batches import (
    MAX_TIME_NS,
    BlockDecoder,
    JointStateBlock,
    LossLog,
    MessageBatch,
    Topic,
    merged_topics,
)
from scara_effmass.bags.compression import ZSTD_MAGIC, inflate_message
from scara_effmass.bags.definitions import check_definition, types_of
from scara_effmass.errors import BagError, DecodeError
from scara_effmass.values import ForceBlock, Impact, RunInfo
from scara_effmass.wire.cdr import NS
from scara_effmass.wire.force import decode_force_block, decode_impact
from scara_effmass.wire.message_types import (
    FORCE_BLOCK,
    FORMER_CONTACT_STATE,
    IMPACT,
    JOINT_STATE,
    RUN_INFO,
    WRENCH,
    WRENCH_STAMPED,
    former_contact_state,
)
from scara_effmass.wire.run_info import decode_run_info
from scara_effmass.wire.topics import JOINT_COMMANDS

MAX_OVERLAP = 0.25
"""Share of a block by which the next one may begin earlier, as the fit of the clock moves the stamps."""
MAX_STAMP_STEP_S = 0.05
"""Largest time by which the stamp of a force block may differ from that of the block before and its samples [s]."""
USUAL = {
    JOINT_STATE: "joint_states",
    FORCE_BLOCK: "force",
    IMPACT: "impact",
    WRENCH_STAMPED: "wrench",
    WRENCH: "wrench",
}
"""Usual topic of each type."""
Decoded = TypeVar("Decoded")


class RawMessage(NamedTuple):
    """A message in CDR, with the time at which it was recorded."""

    topic: str
    type: str
    log_time_ns: int
    data: bytes


class StoredTopic(NamedTuple):
    """A topic in one file of a bag, and the definition of its type if the file contains one."""

    path: Path
    topic: Topic
    encoding: str
    definition: MessageDefinition | None


class Bag(ABC):
    """An open bag. Times are log times [ns] of the recorder's clock; messages come in log-time order.

    Data that cannot be read is skipped and listed in `losses`; part of it shows only while messages are read.
    """

    start_ns: int
    end_ns: int
    _stack: ExitStack
    """Closes the files."""

    def __init__(self, path: Path, stored: Iterable[StoredTopic], losses: LossLog, *, is_ros1: bool = False) -> None:
        self.path = path
        self._losses = losses
        self._is_ros1 = is_ros1
        self._definitions: dict[str, MessageDefinition] = {}
        topics: list[Topic] = []
        for file, topic, encoding, definition in stored:
            if encoding != "cdr":
                losses.add(f"{file}: {topic.name}: encoding = {encoding!r}: must be cdr; not read")
                continue
            topics.append(topic)
            if definition is not None:
                self._definitions.setdefault(topic.type, definition)
        self.topics = tuple(sorted(merged_topics(topics), key=lambda topic: (topic.name, topic.type)))
        self._topic_indices = {(topic.name, topic.type): index for index, topic in enumerate(self.topics)}

    @abstractmethod
    def batches(self, topics: Collection[int], start_ns: int, stop_ns: int) -> Iterator[MessageBatch]:
        """Yield the messages of these topic indices with start_ns <= log time < stop_ns."""

    def close(self) -> None:
        """Close the files."""
        self._stack.close()

    @property
    def duration_ns(self) -> int:
        """Time from the first to the last message."""
        return self.end_ns - self.start_ns

    @property
    def losses(self) -> tuple[str, ...]:
        """Data that could not be read so far, one line each."""
        return tuple(self._losses)

    def add_loss(self, line: str) -> None:
        """Add a `line` to `losses`, for a reader that leaves out messages."""
        self._losses.add(f"{self.path}: {line}")

    @property
    def joint_state_topics(self) -> tuple[str, ...]:
        """Names of the topics of type sensor_msgs/JointState."""
        return tuple(topic.name for topic in self.topics if topic.type == JOINT_STATE)

    def find_topic(self, name: str, types: Sequence[str], setting: str = "topic", remedy: str = "") -> Topic:
        """Return the topic `name`, with or without a leading slash; if empty, the only one of the first of `types`.

        Of several of that type, the one with the USUAL name is taken, and commands only by their name. Topics without
        messages do not count. Raises BagError, which names the `setting` and the choice, or `remedy`.
        """
        topics = [topic for kind in types for topic in self.topics if topic.type == kind and topic.count]
        if not topics:
            raise BagError(f"{self.path}: has no topic of type {', '.join(types)}{remedy}")
        if name:
            candidates = [topic for topic in topics if topic.name.lstrip("/") == name.lstrip("/")]
        else:
            measured = (topic for topic in topics if not topic.name.endswith(JOINT_COMMANDS))
            candidates = [topic for topic in measured if topic.type == topics[0].type]
            usual = USUAL.get(topics[0].type)
            candidates = [topic for topic in candidates if topic.name.lstrip("/") == usual] or candidates
        if len(candidates) != 1:
            choices = ", ".join(f"{topic.name} ({topic.type})" for topic in candidates or topics)
            raise BagError(f"{self.path}: {setting} {f'= {name}' if name else 'is empty'}: must be one of {choices}")
        return candidates[0]

    @cached_property
    def types(self) -> Typestore:
        """Message types: those that the bag defines, and the known ones."""
        definitions = dict(self._definitions)
        if any(topic.type == FORMER_CONTACT_STATE for topic in self.topics):
            former = MessageDefinition(MessageDefinitionFormat.MSG, former_contact_state())
            definitions.setdefault(FORMER_CONTACT_STATE, former)
        return types_of(frozenset(definitions.items()), ros1=self._is_ros1)

    def messages(
        self, topics: Collection[str] | None = None, start_ns: int = 0, stop_ns: int = MAX_TIME_NS
    ) -> Iterator[RawMessage]:
        """Yield the messages of `topics` (None: all) with start_ns <= log time < stop_ns.

        Raises BagError if the bag has no such topic.
        """
        names = {topic.name for topic in self.topics}
        if unknown := set(topics or ()) - names:
            known = ", ".join(topic.name for topic in self.topics)
            raise BagError(f"{self.path}: topic = {min(unknown)}: must be one of {known}")
        indices = {i for i, topic in enumerate(self.topics) if topics is None or topic.name in topics}
        return (raw for batch in self.batches(indices, start_ns, stop_ns) for raw in self._raw_messages(batch))

    def joint_state_blocks(self, topic: str = "") -> Iterator[JointStateBlock]:
        """Yield the joint states of `topic`; empty: the only one. Raises BagError if there is no such topic."""
        name = topic if topic in self.joint_state_topics else self.find_topic(topic, (JOINT_STATE,)).name
        check_definition(self.types, JOINT_STATE, str(self.path))
        decoder = BlockDecoder(f"{self.path}: {name}", self._losses)
        indices = {self._topic_indices[name, JOINT_STATE]}
        return (block for batch in self.batches(indices, 0, MAX_TIME_NS) for block in decoder.blocks(batch))

    def force_blocks(self, topic: str) -> Iterator[ForceBlock]:
        """Yield the force blocks of `topic`; invalid messages are skipped and listed in `losses`.

        Raises BagError if the topic is missing, if the bag defines ForceBlock differently, or if blocks overlap in
        time, because the detection would take those of two publishers as one broken signal.
        """
        return (block for _, block in self.timed_force_blocks(topic))

    def timed_force_blocks(self, topic: str) -> Iterator[tuple[int, ForceBlock]]:
        """Yield log time [ns] and force block; see `force_blocks`."""
        check_definition(self.types, FORCE_BLOCK, str(self.path))
        blocks = self.decoded(topic, FORCE_BLOCK, lambda message: decode_force_block(message.data))
        key = attrgetter("stamp_ns", "first_sample", "frame_id", "source")
        return self._of_one_publisher(topic, self._once(topic, blocks, key))

    def timed_impacts(self, topic: str) -> Iterator[tuple[int, Impact]]:
        """Yield log time [ns] and impact; see `force_blocks`."""
        is_earlier = check_definition(self.types, IMPACT, str(self.path))
        impacts = self.decoded(topic, IMPACT, lambda message: decode_impact(message.data, is_earlier=is_earlier))
        return self._once(topic, impacts, lambda impact: impact)

    def decoded(
        self, topic: str, message_type: str, decode: Callable[[RawMessage], Decoded]
    ) -> Iterator[tuple[int, Decoded]]:
        """Yield log time [ns] and content of each message; those for which `decode` raises DecodeError are losses."""
        add_loss = self._losses.counter()
        for message in self.messages([topic]):
            if message.type != message_type:
                continue
            try:
                yield message.log_time_ns, decode(message)
            except DecodeError as error:
                add_loss(f"{self.path}: {topic}: left out: {error}")

    def _once(
        self, topic: str, items: Iterable[tuple[int, Decoded]], key: Callable[[Decoded], Hashable]
    ) -> Iterator[tuple[int, Decoded]]:
        """Yield `items`; those whose key an earlier one has are losses, because each impact must count once."""
        add_loss, seen = self._losses.counter(), set[Hashable]()
        for log_time_ns, item in items:
            if key(item) in seen:
                add_loss(f"{self.path}: {topic}: left out: recorded twice")
                continue
            seen.add(key(item))
            yield log_time_ns, item

    def _of_one_publisher(
        self, topic: str, blocks: Iterable[tuple[int, ForceBlock]]
    ) -> Iterator[tuple[int, ForceBlock]]:
        """Yield `blocks`; stamps that step beside the sample numbers are losses.

        Raises BagError if two of them overlap in time.
        """
        before: ForceBlock | None = None
        add_loss = self._losses.counter()
        for log_time_ns, block in blocks:
            if before is not None and abs(_stamp_step(before, block)) > MAX_STAMP_STEP_S:
                rest = "samples are missing or out of order, or a clock was set"
                add_loss(f"{self.path}: {topic}: the stamps of blocks do not follow the sample numbers: {rest}")
            if before is not None and _overlap(before, block):
                problem = f"blocks at {block.stamp_ns / NS:.3f} s overlap in time; must be of one publisher"
                raise BagError(f"{self.path}: {topic}: {problem}")
            before = block
            yield log_time_ns, block

    def deserialize(self, message: RawMessage) -> Any:  # noqa: ANN401 - of a class that the bag defines
        """Return a message as an object with the fields of its type. Raises DecodeError."""
        try:
            return self.types.deserialize_cdr(message.data, message.type)
        except Exception as error:  # noqa: BLE001 - code generated from unchecked definitions
            raise DecodeError(f"{message.type} cannot be decoded: {one_line(error)}") from None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _raw_messages(self, batch: MessageBatch) -> Iterator[RawMessage]:
        columns = (batch.topic.tolist(), batch.log_time_ns.tolist(), batch.start.tolist(), batch.stop.tolist())
        for index, log_time_ns, start, stop in zip(*columns, strict=True):
            yield RawMessage(self.topics[index].name, self.topics[index].type, log_time_ns, batch.data[start:stop])


def _overlap(before: ForceBlock, block: ForceBlock) -> bool:
    """Return whether `block` has much of the time of the one `before`; a clock step between the two does not count."""
    lengths_ns = [len(item.force) / item.sample_rate * NS for item in (before, block)]
    begin_ns = max(before.stamp_ns, block.stamp_ns)
    end_ns = min(before.stamp_ns + lengths_ns[0], block.stamp_ns + lengths_ns[1])
    is_next = block.first_sample == before.first_sample + len(before.force)
    return not is_next and end_ns - begin_ns > MAX_OVERLAP * min(lengths_ns)


def _stamp_step(before: ForceBlock, block: ForceBlock) -> float:
    """Return the time [s] from `before` to `block` by their stamps, beyond that by their samples.

    It is 0 where the sample numbers restart, and beside a block without samples.
    """
    if block.first_sample < before.first_sample or not (before.force.size and block.force.size):
        return 0.0
    samples = max(block.first_sample - before.first_sample, before.force.size + block.lost_samples)
    return (block.stamp_ns - before.stamp_ns) / NS - samples / before.sample_rate


def inflate_stored(path: Path, data: bytes, add_loss: Callable[[str], None]) -> bytes:
    """Return a message, decompressed if rosbag2 compressed it; if it is damaged, call `add_loss` and return no bytes.

    The magic number of zstd tells, which no message in CDR begins with: metadata.yaml can be lost or wrong.
    """
    if not data.startswith(ZSTD_MAGIC):
        return data
    try:
        return inflate_message(data)
    except DecodeError as error:
        add_loss(f"{path}: a compressed message is lost: {error}")
        return b""


def one_line(error: Exception) -> str:
    """Return the message of another library's error in one line; the name of its type if there is no message."""
    return " ".join(str(error).split()) or type(error).__name__


def run_infos(bag: Bag) -> Iterator[tuple[int, RunInfo]]:
    """Yield log time [ns] and content of each run information in `bag`, unchecked.

    Raises BagError for a RunInfo that cannot be decoded or has another definition.
    """
    topics = [topic.name for topic in bag.topics if topic.type == RUN_INFO]
    if not topics:
        return
    check_definition(bag.types, RUN_INFO, str(bag.path))
    for message in bag.messages(topics):
        if message.type != RUN_INFO:
            continue
        try:
            info = decode_run_info(message.data)
        except DecodeError as error:
            raise BagError(f"{bag.path}: {message.topic}: {error}") from None
        yield message.log_time_ns, info


def first_run_info(bag: Bag) -> RunInfo | None:
    """Return the first run information in `bag`, unchecked; None if none can be read."""
    with suppress(BagError):
        return next((info for _, info in run_infos(bag)), None)
    return None

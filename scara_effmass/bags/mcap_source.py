"""The MCAP files of one bag, read as one."""

from collections.abc import Collection, Iterator, Sequence
from contextlib import ExitStack
from functools import cached_property
from pathlib import Path

import numpy as np
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
from rosbags.typesys.store import Typestore

from scara_effmass.bags.batches import LossLog, MessageBatch, Topic, in_log_time_order
from scara_effmass.bags.definitions import types_of
from scara_effmass.bags.mcap_file import McapFile

ENCODINGS = {"ros2msg": MessageDefinitionFormat.MSG, "ros2idl": MessageDefinitionFormat.IDL}


class McapSource:
    """A `Source` of MCAP files."""

    def __init__(self, paths: Sequence[Path], losses: LossLog) -> None:
        self._definitions: dict[str, MessageDefinition] = {}
        with ExitStack() as stack:
            self._files = [McapFile(path, stack.enter_context(path.open("rb")), losses) for path in paths]
            self._stack = stack.pop_all()
        counts: dict[tuple[str, str], int] = {}
        hashes: dict[tuple[str, str], str] = {}
        for file in self._files:
            for channel in file.channels.values():
                key = file.topic_and_type(channel)
                if channel.message_encoding != "cdr":
                    losses.add(f"{file.path}: {key[0]}: encoding = {channel.message_encoding!r}: must be cdr; not read")
                    continue
                counts[key] = counts.get(key, 0) + file.counts.get(channel.id, 0)
                hashes.setdefault(key, channel.metadata.get("topic_type_hash", ""))
                schema = file.schemas.get(channel.schema_id)
                if schema is not None and schema.encoding in ENCODINGS and schema.data:
                    text = schema.data.decode("utf-8", "replace")
                    self._definitions.setdefault(key[1], MessageDefinition(ENCODINGS[schema.encoding], text))
        self.topics = tuple(Topic(*key, count, hashes[key]) for key, count in sorted(counts.items()))
        indices = {(topic.name, topic.type): index for index, topic in enumerate(self.topics)}
        for file in self._files:
            file.assign_topics(indices)
        chunks = ((chunk, file) for file in self._files for chunk in file.chunks)
        self._chunks = sorted(chunks, key=lambda pair: pair[0].start_ns)
        self.start_ns = min((chunk.start_ns for chunk, _ in self._chunks), default=0)
        self.end_ns = max((chunk.end_ns for chunk, _ in self._chunks), default=0)

    @cached_property
    def types(self) -> Typestore:
        """See `Source`."""
        return types_of(self._definitions)

    def batches(self, topics: Collection[int], start_ns: int, stop_ns: int) -> Iterator[MessageBatch]:
        """See `Source`."""
        chunks = [(c, file) for c, file in self._chunks if c.end_ns >= start_ns and c.start_ns < stop_ns]
        horizons_ns = [*[chunk.start_ns for chunk, _ in chunks], stop_ns][1:]
        topic_indices = np.array(sorted(topics), np.int64)

        def read() -> Iterator[tuple[MessageBatch, int]]:
            for (chunk, file), horizon_ns in zip(chunks, horizons_ns, strict=True):
                batch = file.read(chunk)
                inside = (batch.log_time_ns >= start_ns) & (batch.log_time_ns < stop_ns)
                yield batch.select(inside & np.isin(batch.topic, topic_indices)), horizon_ns

        return in_log_time_order(read())

    def close(self) -> None:
        """See `Source`."""
        self._stack.close()

# SPDX-License-Identifier: Apache-2.0
"""Messages of any known type, encoded by rosbags; MCAP files written by `mcap`; run information."""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from mcap.writer import LIBRARY_IDENTIFIER, CompressionType, IndexType, Writer

from scara_effmass.bags.bag import run_infos
from scara_effmass.bags.definitions import known_types
from scara_effmass.bags.files import open_bag
from scara_effmass.values import RunInfo
from scara_effmass.wire.cdr import NS
from scara_effmass.wire.message_types import HEADER

TIME = "builtin_interfaces/msg/Time"


def serialized(message_type: str, fields: Mapping[str, Any]) -> bytes:
    """Return the CDR bytes of a message; fields that are messages come from `message`."""
    return bytes(known_types().serialize_cdr(message(message_type, fields), message_type))


def message(message_type: str, fields: Mapping[str, Any]) -> object:
    """Return a message of a known type; all fields must be given."""
    make: Any = known_types().types[message_type]
    return make(**fields)


def header(stamp_ns: int, frame_id: str) -> object:
    """Return a std_msgs/Header."""
    sec, nanosec = divmod(stamp_ns, NS)
    return message(HEADER, {"stamp": message(TIME, {"sec": sec, "nanosec": nanosec}), "frame_id": frame_id})


class Message(NamedTuple):
    """A message to write; a publish time of 0 stands for the log time."""

    topic: str
    type: str
    log_time_ns: int
    data: bytes
    publish_time_ns: int = 0
    sequence: int = 0


def write_mcap(
    path: Path,
    messages: Iterable[Message],
    *,
    compression: CompressionType = CompressionType.ZSTD,
    indexed: bool = True,
    chunked: bool = True,
    chunk_size: int = 4000,
    profile: str = "ros2",
    library: str = LIBRARY_IDENTIFIER,
    statistics: bool = True,
    definitions: Mapping[str, str] = MappingProxyType({}),
    channel_metadata: Mapping[str, str] = MappingProxyType({}),
    add_records: Callable[[Writer], None] = lambda _: None,
) -> Path:
    """Write an MCAP file with the `mcap` library; `add_records` adds records in front of the messages."""
    with path.open("wb") as file:
        writer = Writer(
            file,
            chunk_size=chunk_size,
            compression=compression,
            use_chunking=chunked,
            index_types=IndexType.ALL if indexed else IndexType.NONE,
            use_statistics=indexed and statistics,
            repeat_channels=indexed,
            repeat_schemas=indexed,
            use_summary_offsets=indexed,
        )
        writer.start(profile, library)
        add_records(writer)
        channels: dict[tuple[str, str], int] = {}
        for topic, kind, log_time_ns, data, publish_time_ns, sequence in messages:
            if (topic, kind) not in channels:
                definition = definitions.get(kind) or known_types().generate_msgdef(kind, ros_version=2)[0]
                schema = writer.register_schema(kind, "ros2msg", definition.encode())
                channels[topic, kind] = writer.register_channel(topic, "cdr", schema, dict(channel_metadata))
            channel = channels[topic, kind]
            writer.add_message(channel, log_time_ns, data, publish_time_ns or log_time_ns, sequence)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def run_info_of(path: Path) -> RunInfo:
    """Return the only run information of a bag."""
    with open_bag(path) as bag:
        ((_, info),) = run_infos(bag)
    return info

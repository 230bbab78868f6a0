"""What makes a folder of MCAP files a rosbag2 recording: metadata.yaml, and the QoS in it."""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import yaml

from scara_effmass.bags.disk_file import is_being_written
from scara_effmass.bags.files import METADATA, data_files, is_recording
from scara_effmass.errors import OutputError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from scara_effmass.bags.batches import Topic

ROSBAG2_VERSION = 9
"""Of the metadata, as ROS 2 Jazzy writes them."""


class OfferedQos(NamedTuple):
    """What one publisher offers, in rosbag2's words: `history` "keep_last", `reliability` "best_effort", ..."""

    history: str
    depth: int
    reliability: str
    durability: str
    deadline_ns: int
    lifespan_ns: int
    liveliness: str
    liveliness_lease_duration_ns: int


def qos_text(offered: Iterable[OfferedQos]) -> str:
    """Return what publishers offer in rosbag2's YAML, nothing where there are none."""

    def span(time_ns: int) -> dict[str, int]:
        sec, nsec = divmod(time_ns, 1_000_000_000)
        return {"sec": sec, "nsec": nsec}

    profiles = [
        {
            "history": qos.history,
            "depth": qos.depth,
            "reliability": qos.reliability,
            "durability": qos.durability,
            "deadline": span(qos.deadline_ns),
            "lifespan": span(qos.lifespan_ns),
            "liveliness": qos.liveliness,
            "liveliness_lease_duration": span(qos.liveliness_lease_duration_ns),
            "avoid_ros_namespace_conventions": False,
        }
        for qos in offered
    ]
    return yaml.safe_dump(profiles, sort_keys=False) if profiles else ""


@dataclass(frozen=True, slots=True)
class Part:
    """One file of a recording, as its metadata describe it; times are log times in [ns], 0 without messages."""

    name: str
    start_ns: int
    end_ns: int
    topics: tuple[Topic, ...]

    @property
    def count(self) -> int:
        """Messages of all topics."""
        return sum(topic.count for topic in self.topics)


def metadata(parts: Sequence[Part], custom: Mapping[str, str] | None = None) -> dict[str, Any]:
    """Return what rosbag2 says of a recording of these files; `custom` becomes its custom_data."""
    topics: dict[tuple[str, str], Topic] = {}
    for topic in (topic for part in parts for topic in part.topics):
        before = topics.get((topic.name, topic.type), replace(topic, count=0))
        topics[topic.name, topic.type] = replace(before, count=before.count + topic.count)
    full = [part for part in parts if part.count]
    start_ns = min((part.start_ns for part in full), default=0)
    end_ns = max((part.end_ns for part in full), default=0)
    return {
        "version": ROSBAG2_VERSION,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": end_ns - start_ns},
        "starting_time": {"nanoseconds_since_epoch": start_ns},
        "message_count": sum(part.count for part in parts),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.type,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": _profiles(topic.offered_qos),
                    "type_description_hash": topic.type_hash,
                },
                "message_count": topic.count,
            }
            for topic in topics.values()
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [part.name for part in parts],
        "files": [
            {
                "path": part.name,
                "starting_time": {"nanoseconds_since_epoch": part.start_ns},
                "duration": {"nanoseconds": part.end_ns - part.start_ns},
                "message_count": part.count,
            }
            for part in parts
        ],
        "custom_data": dict(custom) if custom else None,
        "ros_distro": "jazzy",
    }


def write_metadata(folder: Path, parts: Sequence[Part], custom: Mapping[str, str] | None = None) -> None:
    """Write metadata.yaml, on the disk and complete before it takes the place of an older one. Raises OSError."""
    fresh = folder / f".{METADATA}.new"
    with fresh.open("w", encoding="utf-8") as file:
        file.write(yaml_text({"rosbag2_bagfile_information": metadata(parts, custom)}))
        file.flush()
        os.fsync(file.fileno())
    fresh.replace(folder / METADATA)
    sync_folder(folder)


def sync_folder(folder: Path) -> None:
    """Bring names that were given or changed in `folder` to the disk, where its file system can. Raises OSError."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):
            os.fsync(descriptor)
    finally:
        os.close(descriptor)


def refuse_existing(path: Path, *, overwrite: bool) -> None:
    """Refuse to record to `path` (a file if it ends in .mcap, else a folder) when something is there.

    With `overwrite`, a recording of that kind may be there, also one whose recorder was killed, but none that is still
    being made. Raises OutputError.
    """
    if not path.exists():
        return
    if not overwrite:
        raise OutputError(f"{path}: exists already; --force replaces it")
    try:
        replaceable = path.is_file() if path.suffix == ".mcap" else _is_recording_alone(path)
        busy = replaceable and any(map(is_being_written, data_files(path) if path.is_dir() else [path]))
    except OSError as error:
        raise OutputError(f"{path}: cannot be read: {error.strerror}") from None
    if not replaceable:
        raise OutputError(f"{path}: exists and is no such recording; it is not replaced")
    if busy:
        raise OutputError(f"{path}: is being recorded; end the recorder first")


def _is_recording_alone(folder: Path) -> bool:
    """Whether a folder is a recording; one without metadata.yaml must hold nothing else. Raises OSError."""
    if not is_recording(folder):
        return False
    seen = {child for child in folder.iterdir() if not child.name.startswith(".")}
    return (folder / METADATA).is_file() or seen == set(data_files(folder))


def _profiles(text: str) -> list[Any]:
    """Return the offered QoS of a file, which need not be ours, nothing where they cannot be read."""
    try:
        profiles = yaml.safe_load(text)
    except yaml.YAMLError:
        return []
    return profiles if isinstance(profiles, list) else []


def yaml_text(content: Mapping[str, Any]) -> str:
    """Return `content` as YAML, in its order."""
    return str(yaml.safe_dump(content, sort_keys=False))

# SPDX-License-Identifier: Apache-2.0
"""The rosbag2 format: metadata.yaml, QoS profiles and checks of an output folder."""

import fcntl
import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from scara_effmass.bags.batches import Topic, merged_topics
from scara_effmass.bags.files import METADATA, bag_files, is_rosbag2_folder
from scara_effmass.errors import OutputError
from scara_effmass.input_files import YAML_ERRORS

ROSBAG2_VERSION = 9
"""Metadata version of ROS 2 Jazzy."""


def qos_yaml(profiles: Iterable[Mapping[str, object]]) -> str:
    """Return QoS profiles (with rosbag2's keys) in rosbag2's YAML; empty if there are none."""
    profiles = [dict(profile) for profile in profiles]
    return yaml_text(profiles) if profiles else ""


@dataclass(frozen=True, slots=True)
class BagFile:
    """One file of a bag as the metadata describes it; times are log times [ns], 0 if there are no messages."""

    name: str
    start_ns: int
    end_ns: int
    topics: tuple[Topic, ...]

    @property
    def count(self) -> int:
        """Messages of all topics."""
        return sum(topic.count for topic in self.topics)


def metadata(files: Sequence[BagFile], custom_data: Mapping[str, str] | None = None) -> dict[str, Any]:
    """Return the metadata of a bag of these files."""
    nonempty = [file for file in files if file.count]
    start_ns = min((file.start_ns for file in nonempty), default=0)
    end_ns = max((file.end_ns for file in nonempty), default=0)
    return {
        "version": ROSBAG2_VERSION,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": end_ns - start_ns},
        "starting_time": {"nanoseconds_since_epoch": start_ns},
        "message_count": sum(file.count for file in files),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.type,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": _parse_profiles(topic.offered_qos),
                    "type_description_hash": topic.type_hash,
                },
                "message_count": topic.count,
            }
            for topic in merged_topics(topic for file in files for topic in file.topics)
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.name for file in files],
        "files": [
            {
                "path": file.name,
                "starting_time": {"nanoseconds_since_epoch": file.start_ns},
                "duration": {"nanoseconds": file.end_ns - file.start_ns},
                "message_count": file.count,
            }
            for file in files
        ],
        "custom_data": dict(custom_data) if custom_data else None,
        "ros_distro": "jazzy",
    }


def write_metadata(folder: Path, files: Sequence[BagFile], custom_data: Mapping[str, str] | None = None) -> None:
    """Write metadata.yaml; an older one is replaced once the new one is on the disk. Raises OSError."""
    unfinished = folder / f".{METADATA}.new"
    with unfinished.open("w", encoding="utf-8") as output:
        output.write(yaml_text({"rosbag2_bagfile_information": metadata(files, custom_data)}))
        output.flush()
        os.fsync(output.fileno())
    unfinished.replace(folder / METADATA)
    sync_folder(folder)


def sync_folder(folder: Path) -> None:
    """Synchronise the names in `folder` to the disk, if the file system supports it. Raises OSError."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):
            os.fsync(descriptor)
    finally:
        os.close(descriptor)


def check_output(path: Path, *, overwrite: bool) -> None:
    """Raise OutputError if a bag must not be written to `path`, a file if it ends in .mcap, otherwise a folder.

    With `overwrite`, a bag of the same kind is replaced, even that of a killed recorder, unless it is being recorded.
    """
    if not path.exists():
        return
    if not overwrite:
        raise OutputError(f"{path}: already exists; use --force to replace it")
    try:
        is_replaceable = path.is_file() if path.suffix == ".mcap" else _is_only_a_bag(path)
        is_busy = is_replaceable and any(map(is_being_written, bag_files(path) if path.is_dir() else [path]))
    except OSError as error:
        raise OutputError(f"{path}: cannot be read: {error.strerror}") from None
    if not is_replaceable:
        raise OutputError(f"{path}: is not a bag of this kind and is not replaced")
    if is_busy:
        raise OutputError(f"{path}: is being recorded; stop the recorder first")


def is_being_written(path: Path) -> bool:
    """Return whether a recorder has the file open. Raises OSError."""
    with path.open("rb") as file:
        try:
            fcntl.flock(file.fileno(), fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:  # this file system has no locks
            return False
    return False


def _is_only_a_bag(folder: Path) -> bool:
    """Return whether a folder is a bag; without metadata.yaml it must contain nothing else. Raises OSError."""
    if not is_rosbag2_folder(folder):
        return False
    children = {child for child in folder.iterdir() if not child.name.startswith(".")}
    return (folder / METADATA).is_file() or children == set(bag_files(folder))


def _parse_profiles(text: str) -> list[Any]:
    """Return the QoS profiles stated in a file, which any tool may have written; empty if invalid."""
    try:
        profiles = yaml.safe_load(text)
    except YAML_ERRORS:
        return []
    return profiles if isinstance(profiles, list) else []


def yaml_text(content: object) -> str:
    """Return `content` as YAML; keys keep their order."""
    return str(yaml.safe_dump(content, sort_keys=False))

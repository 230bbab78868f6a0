# SPDX-License-Identifier: Apache-2.0
"""Bags as files: find and open them, write metadata.yaml as rosbag2 does, and check an output folder."""

import fcntl
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag2 import Reader as Ros2Reader

from scara_effmass.bags.bag import Bag
from scara_effmass.bags.batches import LossLog, Topic, merged_topics
from scara_effmass.bags.mcap_bag import McapBag
from scara_effmass.bags.mcap_copy import MAGIC
from scara_effmass.bags.rosbags_bag import RosbagsBag
from scara_effmass.errors import BagError, OutputError
from scara_effmass.input_files import YAML_ERRORS
from scara_effmass.url import Url, local_file

SUFFIXES = {".mcap", ".db3", ".bag"}
METADATA = "metadata.yaml"
SPLIT_NAME = re.compile(r"(?P<name>.+)_(?P<number>\d+)\.(?P<suffix>mcap|db3)")
"""Name of a file in a rosbag2 folder."""
ROSBAG2_VERSION = 9
"""Metadata version of ROS 2 Jazzy."""

FORMATS: dict[bytes, Callable[[Path, Sequence[Path], LossLog], Bag]] = {
    MAGIC: McapBag,
    b"SQLite format 3\0": lambda path, paths, losses: RosbagsBag(path, [*map(local_file, paths)], losses, Ros2Reader),
    b"#ROSBAG V": lambda path, paths, losses: RosbagsBag(path, [*map(local_file, paths)], losses, Ros1Reader),
}
"""Readers by the first bytes of a file."""


def find_bags(path: Path) -> list[Path]:
    """Return the bags at `path`: a file, a rosbag2 folder, or a folder of these. Raises BagError if there is none."""
    try:
        if path.is_file() or is_rosbag2_folder(path):
            return [path]
        children = sorted(path.iterdir())
        bags = [p for p in children if is_rosbag2_folder(p) or (p.is_file() and p.suffix in SUFFIXES)]
    except FileNotFoundError:
        raise BagError(f"{path}: does not exist") from None
    except OSError as error:
        raise BagError(f"{error.filename or path}: cannot be read: {error.strerror}") from None
    if not bags:
        raise BagError(f"{path}: contains no bag; expected a rosbag2 folder, .mcap, .db3 or ROS 1 .bag")
    return bags


def open_bag(path: Path) -> Bag:
    """Open the bag at `path`, a file or a rosbag2 folder. Raises BagError if no message can be read."""
    bag, *others = find_bags(path)
    if others:
        raise BagError(f"{path}: contains {1 + len(others)} bags: must be one of them ({bag.name}, ...)")
    losses = LossLog()
    try:
        opened = _open_folder(bag, losses) if bag.is_dir() else _open_files(bag, [bag], losses)
    except OSError as error:
        raise BagError(f"{error.filename or bag}: cannot be read: {error.strerror or error}") from None
    if not sum(topic.count for topic in opened.topics):
        opened.close()
        reason = "no message can be read" if any(losses) else "contains no messages"
        raise BagError("; ".join([f"{bag}: {reason}", *losses]))
    return opened


def is_rosbag2_folder(folder: Path) -> bool:
    """Return whether a folder is one rosbag2 bag: it has metadata.yaml, or the numbered files of a bag that lost it."""
    if not folder.is_dir():
        return False
    if (folder / METADATA).is_file():
        return True
    matches = [SPLIT_NAME.fullmatch(path.name) for path in bag_files(folder)]
    names = {(match["name"], match["suffix"]) for match in matches if match}
    numbers = sorted(int(match["number"]) for match in matches if match)
    return len(names) == 1 and numbers == list(range(len(matches)))


def bag_files(folder: Path) -> list[Path]:
    """Return the bag files in `folder` in the order of their numbers. Raises OSError."""

    def order(path: Path) -> tuple[int, Path]:
        match = SPLIT_NAME.fullmatch(path.name)
        return int(match["number"]) if match else 0, path

    return sorted((path for path in folder.iterdir() if path.suffix in SUFFIXES and path.is_file()), key=order)


def bag_bytes(bag: Path) -> int:
    """Return the size of a bag that `find_bags` found."""
    paths = bag_files(bag) if bag.is_dir() else [bag]
    return sum(path.size() if isinstance(path, Url) else path.stat().st_size for path in paths)


def _open_files(bag: Path, paths: Sequence[Path], losses: LossLog) -> Bag:
    formats = set()
    for path in paths:
        with path.open("rb") as file:
            head = file.read(16)
        if not head:
            raise BagError(f"{path}: is empty")
        formats.add(next((magic for magic in FORMATS if head.startswith(magic)), b""))
        if (journal := Path(f"{path}-wal")).exists() and journal.stat().st_size:
            losses.add(f"{journal}: the recorder did not finish; messages in this journal are not read")
    magic = formats.pop()
    if formats or not magic:
        raise BagError(f"{paths[0]}: is not a bag; expected MCAP, SQLite (rosbag2) or ROS 1")
    return FORMATS[magic](bag, paths, losses)


def _open_folder(folder: Path, losses: LossLog) -> Bag:
    metadata = _read_metadata(folder, losses)
    present = bag_files(folder)
    if metadata.get("compression_mode"):
        if isinstance(folder, Url):
            raise BagError(f"{folder}: is compressed by rosbag2: must be a local folder, or MCAP")
        return RosbagsBag(folder, [folder], losses, Ros2Reader)
    # Older recorders wrote the names with the folder in front.
    named = [folder / Path(str(name)).name for name in metadata.get("relative_file_paths") or ()]
    for path in named:
        if path not in present:
            losses.add(f"{folder / METADATA}: names {path.name}, which does not exist")
    paths = [path for path in named if path in present]
    if not paths:
        paths = present
    else:
        for path in (path for path in present if path not in named):
            # A recorder that was killed has not listed its last file.
            if _continues(path, named):
                losses.add(f"{folder / METADATA}: does not name {path.name}, which continues the bag; it is read too")
                paths.append(path)
            else:
                losses.add(f"{folder / METADATA}: does not name {path.name}; not read")
    if not paths:
        raise BagError("; ".join([f"{folder}: contains no .mcap or .db3 file", *losses]))
    bag = _open_files(folder, paths, losses)
    count = sum(topic.count for topic in bag.topics)
    if metadata.get("message_count", count) != count:
        losses.add(f"{folder / METADATA}: lists {metadata['message_count']} messages, the files contain {count}")
    return bag


def _continues(path: Path, named: Sequence[Path]) -> bool:
    """Return whether a file continues the bag with the files `named`."""
    match = SPLIT_NAME.fullmatch(path.name)
    earlier = [SPLIT_NAME.fullmatch(other.name) for other in named]
    return match is not None and all(
        other is not None
        and (other["name"], other["suffix"]) == (match["name"], match["suffix"])
        and int(other["number"]) < int(match["number"])
        for other in earlier
    )


def _read_metadata(folder: Path, losses: LossLog) -> dict[str, Any]:
    """Return the content of metadata.yaml; empty if it is unusable."""
    path = folder / METADATA
    try:
        information = yaml.safe_load(path.read_text(encoding="utf-8"))["rosbag2_bagfile_information"]
    except FileNotFoundError:
        losses.add(f"{path}: does not exist; read without it")
        return {}
    except YAML_ERRORS:
        information = None
    if not isinstance(information, dict) or not isinstance(information.get("relative_file_paths"), list):
        losses.add(f"{path}: does not describe a bag; read without it")
        return {}
    return information


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

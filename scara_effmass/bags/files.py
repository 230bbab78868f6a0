"""Recordings on disk: which there are at a path, and what opens them."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag2 import Reader as Ros2Reader

from scara_effmass.bags.bag import Bag
from scara_effmass.bags.batches import Losses
from scara_effmass.bags.mcap_records import MAGIC
from scara_effmass.bags.mcap_source import McapSource
from scara_effmass.bags.rosbags_source import RosbagsSource
from scara_effmass.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from scara_effmass.bags.batches import Source

SUFFIXES = {".mcap", ".db3", ".bag"}
METADATA = "metadata.yaml"
PART = re.compile(r"(?P<name>.+)_(?P<number>\d+)\.(?P<suffix>mcap|db3)")
"""How rosbag2 names the files of one recording."""

FORMATS: dict[bytes, Callable[[Sequence[Path], Losses], Source]] = {
    MAGIC: McapSource,
    b"SQLite format 3\0": lambda paths, losses: RosbagsSource(paths, losses, Ros2Reader),
    b"#ROSBAG V": lambda paths, losses: RosbagsSource(paths, losses, Ros1Reader),
}
"""How the files of each format begin, and what reads them."""


def find_bags(path: Path) -> list[Path]:
    """Return the recordings at `path`: a file, a rosbag2 folder, or a folder of these, each for `open_bag`.

    Raises BagError when there is none.
    """
    try:
        if path.is_file() or is_recording(path):
            return [path]
        inside = sorted(path.iterdir())
        found = [child for child in inside if is_recording(child) or (child.is_file() and child.suffix in SUFFIXES)]
    except FileNotFoundError:
        raise BagError(f"{path}: there is no such file or folder") from None
    except OSError as error:
        raise BagError(f"{error.filename or path}: cannot be read: {error.strerror}") from None
    if not found:
        raise BagError(f"{path}: holds no recording; a rosbag2 folder, .mcap, .db3 or ROS 1 .bag would be right")
    return found


def open_bag(path: Path) -> Bag:
    """Open the recording at `path`, a file or a rosbag2 folder; to be closed, or used in a `with`.

    Raises BagError when nothing of it can be read.
    """
    (first, *others) = find_bags(path)
    if others:
        raise BagError(f"{path}: holds {1 + len(others)} recordings; one of them would be right: {first.name}, ...")
    losses = Losses()
    try:
        source = _opened_folder(first, losses) if first.is_dir() else _opened_files([first], losses)
    except OSError as error:
        raise BagError(f"{error.filename or first}: cannot be read: {error.strerror or error}") from None
    if not sum(topic.count for topic in source.topics):
        source.close()
        empty = f"{first}: holds no messages" if not any(losses) else f"{first}: no message of it can be read"
        raise BagError("; ".join([empty, *losses]))
    return Bag(first, source, losses)


def is_recording(folder: Path) -> bool:
    """Whether a folder is one rosbag2 recording: it has the metadata, or the files of one that lost them."""
    if not folder.is_dir():
        return False
    if (folder / METADATA).is_file():
        return True
    parts = [PART.fullmatch(path.name) for path in data_files(folder)]
    names = {(part["name"], part["suffix"]) for part in parts if part}
    numbers = sorted(int(part["number"]) for part in parts if part)
    return len(names) == 1 and numbers == list(range(len(parts)))


def data_files(folder: Path) -> list[Path]:
    """Return the files in `folder` that may hold messages, parts of one recording in their order. Raises OSError."""
    files = (path for path in folder.iterdir() if path.suffix in SUFFIXES and path.is_file())

    def order(path: Path) -> tuple[int, Path]:
        part = PART.fullmatch(path.name)
        return int(part["number"]) if part else 0, path

    return sorted(files, key=order)


def _opened_files(paths: Sequence[Path], losses: Losses) -> Source:
    sources = set()
    for path in paths:
        with path.open("rb") as file:
            begin = file.read(16)
        sources |= {magic for magic in FORMATS if begin.startswith(magic)} or {begin}
        if (journal := Path(f"{path}-wal")).exists() and journal.stat().st_size:
            losses.add(f"{journal}: the recorder did not finish; what is only in this journal is not read")
        if begin == b"":
            raise BagError(f"{path}: is empty; a recording would be right")
    magic, *others = sources
    if others or magic not in FORMATS:
        raise BagError(f"{paths[0]}: is no recording in one of the formats MCAP, SQLite (rosbag2) or ROS 1 bag")
    return FORMATS[magic](paths, losses)


def _opened_folder(folder: Path, losses: Losses) -> Source:
    metadata = _metadata(folder, losses)
    present = data_files(folder)
    if metadata.get("compression_mode"):
        return RosbagsSource([folder], losses, Ros2Reader)
    # older recorders wrote the paths with the folder in front
    named = [folder / Path(str(name)).name for name in metadata.get("relative_file_paths") or ()]
    for path in named:
        if path not in present:
            losses.add(f"{folder / METADATA}: names {path.name}, which is not there")
    paths = [path for path in named if path in present]
    if not paths:
        paths = present
    else:
        # a recorder that was killed has described the files before its last one
        late = [path for path in present if path not in named and _continues(path, named)]
        for path in late:
            losses.add(f"{folder / METADATA}: does not name {path.name}, which continues it; read as well")
        paths += late
        if unnamed := [path.name for path in present if path not in paths]:
            losses.add(f"{folder / METADATA}: does not name {', '.join(unnamed)}, not read")
    if not paths:
        raise BagError("; ".join([f"{folder}: holds no .mcap or .db3 file", *losses]))
    source = _opened_files(paths, losses)
    count = sum(topic.count for topic in source.topics)
    if metadata.get("message_count", count) != count:
        losses.add(f"{folder / METADATA}: says {metadata['message_count']} messages, the files hold {count}")
    return source


def _continues(path: Path, named: Sequence[Path]) -> bool:
    """Whether a file is a later one of the recording whose files are `named`."""
    part = PART.fullmatch(path.name)
    before = [PART.fullmatch(each.name) for each in named]
    return part is not None and all(
        each is not None
        and (each["name"], each["suffix"]) == (part["name"], part["suffix"])
        and int(each["number"]) < int(part["number"])
        for each in before
    )


def _metadata(folder: Path, losses: Losses) -> dict[str, Any]:
    """Return what the metadata say of the recording, nothing where they cannot be used: the files decide."""
    path = folder / METADATA
    try:
        information = yaml.safe_load(path.read_text(encoding="utf-8"))["rosbag2_bagfile_information"]
    except FileNotFoundError:
        losses.add(f"{path}: is not there; the files were read without it")
        return {}
    except (yaml.YAMLError, ValueError, TypeError, LookupError):
        information = None
    if not isinstance(information, dict) or not isinstance(information.get("relative_file_paths"), list):
        losses.add(f"{path}: is no description of a recording; the files were read without it")
        return {}
    return information

"""Recordings of every kind behind one door: rosbag2 (MCAP, SQLite), single files, ROS 1."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import yaml
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag2 import Reader as Ros2Reader

from scara_effmass.bag_io.batches import LATEST_NS, Losses, Source, Topic
from scara_effmass.bag_io.blocks import BlockDecoder, JointStateBlock
from scara_effmass.bag_io.definitions import JOINT_STATE, check_joint_state
from scara_effmass.bag_io.mcap_records import MAGIC
from scara_effmass.bag_io.mcap_source import McapSource
from scara_effmass.bag_io.rosbags_source import RosbagsSource
from scara_effmass.errors import BagError, DecodeError

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Sequence
    from types import TracebackType

    from rosbags.typesys.store import Typestore

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


class RawMessage(NamedTuple):
    """A message as CDR bytes, with the time at which it was recorded."""

    topic: str
    type: str
    log_time_ns: int
    data: bytes


def find_bags(path: Path) -> list[Path]:
    """Return the recordings at `path`: a file, a rosbag2 folder, or a folder of these, each for `open_bag`.

    Raises BagError when there is none.
    """
    if path.is_file() or _is_recording(path):
        return [path]
    if not path.exists():
        raise BagError(f"{path}: there is no such file or folder")
    try:
        inside = sorted(path.iterdir())
    except OSError as error:
        raise BagError(f"{path}: cannot be read: {error.strerror}") from None
    found = [child for child in inside if _is_recording(child) or (child.is_file() and child.suffix in SUFFIXES)]
    if not found:
        raise BagError(f"{path}: holds no recording; a rosbag2 folder or a .mcap, .db3 or ROS 1 .bag file would be right")
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
        raise BagError("; ".join([f"{first}: holds no messages", *losses]))
    return Bag(first, source, losses)


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
        if topic not in candidates and not (topic is None and len(candidates) == 1):
            asked = "several topics hold joint states" if topic is None and candidates else f"no joint states on {topic}"
            right = f"choose one of {', '.join(candidates)}" if candidates else "no topic holds any"
            raise BagError(f"{self.path}: {asked if topic or candidates else 'no joint states'}; {right}")
        name = candidates[0] if topic is None else topic
        check_joint_state(self.types, str(self.path))
        chosen = {n for n, each in enumerate(self.topics) if (each.name, each.type) == (name, JOINT_STATE)}
        return self._blocks(name, chosen, *_span(start_ns, stop_ns))

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

    def _blocks(self, name: str, chosen: set[int], start_ns: int, stop_ns: int) -> Iterator[JointStateBlock]:
        decoder = BlockDecoder(f"{self.path}: {name}", self._losses)
        for batch in self._source.batches(chosen, start_ns, stop_ns):
            yield from decoder.blocks(batch)


def _span(start_ns: int | None, stop_ns: int | None) -> tuple[int, int]:
    return 0 if start_ns is None else start_ns, LATEST_NS if stop_ns is None else stop_ns


def _is_recording(folder: Path) -> bool:
    """Whether a folder is one rosbag2 recording: it has the metadata, or the files of one that lost them."""
    if not folder.is_dir():
        return False
    if (folder / METADATA).is_file():
        return True
    parts = [PART.fullmatch(path.name) for path in _data_files(folder)]
    names = {(part["name"], part["suffix"]) for part in parts if part}
    numbers = sorted(int(part["number"]) for part in parts if part)
    return len(names) == 1 and numbers == list(range(len(parts)))


def _data_files(folder: Path) -> list[Path]:
    files = (path for path in folder.iterdir() if path.suffix in SUFFIXES and path.is_file())
    return sorted(files, key=lambda path: ((part := PART.fullmatch(path.name)) and int(part["number"]) or 0, path))


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
    present = _data_files(folder)
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
    elif unnamed := [path.name for path in present if path not in paths]:
        losses.add(f"{folder / METADATA}: does not name {', '.join(unnamed)}, not read")
    if not paths:
        raise BagError("; ".join([f"{folder}: holds no .mcap or .db3 file", *losses]))
    source = _opened_files(paths, losses)
    count = sum(topic.count for topic in source.topics)
    if metadata.get("message_count", count) != count:
        losses.add(f"{folder / METADATA}: says {metadata['message_count']} messages, the files hold {count}")
    return source


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

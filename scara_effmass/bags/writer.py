# SPDX-License-Identifier: Apache-2.0
"""Writers of MCAP files and of complete bags, with profile, schemas, messages and metadata.yaml as in rosbag2."""

import fcntl
import os
import shutil
import weakref
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from io import BytesIO
from itertools import zip_longest
from pathlib import Path
from secrets import token_hex
from typing import IO, Any, final

import yaml
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer
from rosbags.typesys.store import Typestore
from typing_extensions import Self

from scara_effmass.bags.batches import MAX_TIME_NS, Topic, merged_topics
from scara_effmass.bags.definitions import definition_of, known_types
from scara_effmass.bags.files import METADATA, bag_files, is_rosbag2_folder
from scara_effmass.bags.mcap_bag import HASH_KEY, QOS_KEY
from scara_effmass.errors import OutputError, writing
from scara_effmass.input_files import YAML_ERRORS, check_not_input
from scara_effmass.values import JointState
from scara_effmass.wire.joint_state import joint_state_message
from scara_effmass.wire.message_types import JOINT_STATE

FileOpener = Callable[[Path], IO[bytes]]

PROFILE = "ros2"
LIBRARY = "scara_effmass"
ROSBAG2_VERSION = 9
"""Metadata version of ROS 2 Jazzy."""
METADATA_RECORD = "rosbag2"
"""The MCAP metadata record in which rosbag2 repeats metadata.yaml."""
CHUNK_BYTES = 1 << 20
"""Message bytes after which the caller should save."""


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
    check_not_input(path, OutputError)
    try:
        is_replaceable = _is_mcap(path) if path.suffix == ".mcap" else _is_only_a_bag(path)
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


def _is_mcap(path: Path) -> bool:
    """Return whether a file is MCAP, or empty. Raises OSError."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(MCAP0_MAGIC)) in {MCAP0_MAGIC, b""}


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


def open_unbuffered(path: Path) -> IO[bytes]:
    """Create a file without a buffer, which would delay errors of the disk."""
    return path.open("xb", buffering=0)


class _FileEnd(BytesIO):
    """The end of a file that is not yet written, with offsets in the file."""

    start = 0
    """Offset of the first byte."""

    def tell(self) -> int:
        return self.start + super().tell()


@final
class McapFileWriter:
    """Writes one MCAP file with checksums, an index and message definitions. The file is locked while open.

    `mcap.writer.Writer` writes to memory, and `save` copies that to the file. So a failing disk cannot corrupt the
    state of the writer, and the file always ends with a complete chunk.
    """

    def __init__(
        self, path: Path, name: str = "", *, compress: bool = True, opener: FileOpener = open_unbuffered
    ) -> None:
        """Create the file; `name` is its final name, if different. Raises OSError."""
        self.start_ns, self.end_ns = MAX_TIME_NS, 0
        """First and last log time so far."""
        self.topics: list[Topic] = []
        self.saved_bytes = 0
        self.pending_bytes = 0
        """Size of the messages that are not yet saved."""
        self.finished = False
        self._name = name or path.name
        self._counts: list[int] = []
        self._schemas: dict[str, int] = {}
        self._unsaved = _FileEnd()
        self._synced_bytes = 0
        self._sync_thread = ThreadPoolExecutor(1, "sync")
        self._sync: Future[None] = Future()
        self._sync.set_result(None)
        self._file = opener(path)
        with suppress(OSError):  # some network file systems have no locks
            fcntl.flock(self._file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
        self._writer = Writer(
            self._unsaved,
            chunk_size=MAX_TIME_NS,  # `save` ends the chunks
            compression=CompressionType.ZSTD if compress else CompressionType.NONE,
        )
        self._writer.start(profile=PROFILE, library=LIBRARY)
        self.saved = self._bag_file()
        """Description of the saved content."""

    @property
    def is_saved(self) -> bool:
        """Whether everything is in the file and synchronised to the disk."""
        return not self.pending_bytes and self._unsaved.tell() == self.saved_bytes == self._synced_bytes

    @property
    def unsaved_counts(self) -> list[int]:
        """Messages of each topic that are not yet saved."""
        saved_counts = (topic.count for topic in self.saved.topics)
        return [count - saved for count, saved in zip_longest(self._counts, saved_counts, fillvalue=0)]

    def add_topic(self, topic: Topic, definition: str) -> None:
        """Add a topic, with the definition of its type as "ros2msg"; topics are numbered from 0."""
        if topic.type not in self._schemas:
            self._schemas[topic.type] = self._writer.register_schema(topic.type, "ros2msg", definition.encode())
        channel_metadata = {QOS_KEY: topic.offered_qos, HASH_KEY: topic.type_hash}
        self._writer.register_channel(topic.name, "cdr", self._schemas[topic.type], channel_metadata)
        self.topics.append(topic)
        self._counts.append(0)

    def add_message(self, topic: int, log_time_ns: int, data: bytes, sequence: int | None = None) -> None:
        """Add a message of a topic; `sequence` defaults to the number of its previous messages."""
        count = self._counts[topic]
        # Writer numbers channels from 1; sequence numbers have 32 bits.
        number = (count if sequence is None else sequence) & 0xFFFFFFFF
        self._writer.add_message(topic + 1, log_time_ns, data, log_time_ns, number)
        self._counts[topic] = count + 1
        self.pending_bytes += len(data)
        self.start_ns = min(self.start_ns, log_time_ns)
        self.end_ns = max(self.end_ns, log_time_ns)

    def add_metadata(self, name: str, content: Mapping[str, str]) -> None:
        """Add a metadata record."""
        self._writer.add_metadata(name, dict(content))

    def finish(self, custom_data: Mapping[str, str] | None = None) -> None:
        """Add index and summary, and metadata.yaml as rosbag2 does; `save` must follow."""
        self._writer.flush()  # type: ignore[no-untyped-call]
        text = yaml_text(metadata([self._bag_file()], custom_data))
        self.add_metadata(METADATA_RECORD, {"serialized_metadata": text})
        self._writer.finish()  # type: ignore[no-untyped-call]
        self.finished = True

    def save(self) -> None:
        """End the chunk and write to the file, either everything or nothing. Raises OSError."""
        if not self.finished:
            self._writer.flush()  # type: ignore[no-untyped-call]
        data = memoryview(self._unsaved.getvalue())
        written = 0
        try:
            while written < len(data):
                written += self._file.write(data[written:])
        except OSError:
            with suppress(OSError):  # without it, the file ends in a torn record, which the readers here skip
                self._file.truncate(self.saved_bytes)
            self._file.seek(self.saved_bytes)
            raise
        self.saved_bytes += written
        self._unsaved.seek(0)
        self._unsaved.truncate()
        self._unsaved.start = self.saved_bytes
        self.pending_bytes = 0
        self.saved = self._bag_file()

    def sync(self) -> None:
        """Synchronise what is saved to the disk, so that it also survives a power failure. Raises OSError."""
        wait((self._sync,))
        self.start_sync()
        self._sync.result()

    def start_sync(self) -> None:
        """Synchronise in a thread, unless the previous call is still at work: a busy disk takes seconds.

        Raises the OSError of the previous call.
        """
        if self._sync.done():
            previous, self._sync = self._sync, self._sync_thread.submit(self._sync_file, self.saved_bytes)
            previous.result()

    def close(self) -> None:
        """Close the file; unsaved messages are lost."""
        self._sync_thread.shutdown()
        self._file.close()

    def _sync_file(self, size: int) -> None:
        os.fdatasync(self._file.fileno())
        self._synced_bytes = size

    def _bag_file(self) -> BagFile:
        topics = tuple(replace(topic, count=count) for topic, count in zip(self.topics, self._counts, strict=True))
        return BagFile(self._name, self.start_ns if any(self._counts) else 0, self.end_ns, topics)


@final
class BagWriter:
    """Writes a bag, which appears at `path` only once it is complete: when the `with` ends without an error.

    `path` is a file if it ends in .mcap, otherwise a rosbag2 folder.
    """

    def __init__(self, path: Path, *, overwrite: bool = False, types: Typestore | None = None) -> None:
        """Start a bag; `types` (default: the known ones) must define the types of the messages.

        Raises OutputError if `path` exists and `overwrite` is false, or if it cannot be created.
        """
        self.path = path
        self._overwrite = overwrite
        self._types = types or known_types()
        self._topics: dict[tuple[str, str], int] = {}
        self._is_file = path.suffix == ".mcap"
        check_output(path, overwrite=overwrite)
        with writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            self._temporary = path.parent / f".{path.name}-{token_hex(4)}"
            # Whenever a signal arrives, also before the `with` begins, the folder is removed together with this object.
            self._remove = weakref.finalize(self, shutil.rmtree, self._temporary, ignore_errors=True)
            with ExitStack() as undo:
                undo.callback(self._remove)
                self._unfinished = self._temporary / path.name
                (self._temporary if self._is_file else self._unfinished).mkdir(parents=True)
                mcap_path = self._unfinished if self._is_file else self._unfinished / f"{path.name}_0.mcap"
                self._file = McapFileWriter(mcap_path)
                undo.pop_all()

    def write(self, topic: str, message_type: str, log_time_ns: int, data: bytes) -> None:
        """Add a message (CDR bytes). Raises BagError if the type is unknown, OutputError if the disk fails."""
        index = self._topics.get((topic, message_type))
        if index is None:
            definition, type_hash = definition_of(self._types, message_type, f"{self.path}: {topic}")
            index = self._topics[topic, message_type] = len(self._topics)
            self._file.add_topic(Topic(topic, message_type, 0, type_hash), definition)
        self._file.add_message(index, log_time_ns, data)
        if self._file.pending_bytes >= CHUNK_BYTES:
            with writing(self.path):
                self._file.save()

    def write_joint_states(self, topic: str, states: Iterable[JointState], frame_id: str = "") -> None:
        """Add joint states with their stamps as log times. Raises OutputError."""
        for state in states:
            self.write(topic, JOINT_STATE, state.stamp_ns, joint_state_message(state, frame_id))

    def close(self) -> None:
        """Complete the bag and move it to its path. Raises OutputError."""
        try:
            with writing(self.path):
                self._file.finish()
                self._file.save()
                self._file.close()
                if not self._is_file:
                    write_metadata(self._unfinished, [self._file.saved])
                check_output(self.path, overwrite=self._overwrite)
                if self.path.exists():
                    self.path.rename(self._temporary / "replaced")
                self._unfinished.rename(self.path)
        finally:
            self.abort()

    def abort(self) -> None:
        """Delete the unfinished bag."""
        self._file.close()
        try:
            self._remove()
        finally:
            # Repeat it in case a signal interrupted the first attempt.
            shutil.rmtree(self._temporary, ignore_errors=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.close()
        else:
            self.abort()

# SPDX-License-Identifier: Apache-2.0
"""Find and open bags; rosbags reads all formats but MCAP: SQLite, compressed rosbag2 and ROS 1."""

import heapq
import json
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from operator import itemgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import yaml
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinitionFormat
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag1.reader import Header, RecordType
from rosbags.rosbag2 import Reader as Ros2Reader

from scara_effmass.bags.bag import Bag, StoredTopic, inflate_stored, one_line
from scara_effmass.bags.batches import LossLog, MessageBatch, Topic, batch_of
from scara_effmass.bags.compression import ZSTD_MAGIC, ZSTD_SUFFIXES, inflate, inflate_file
from scara_effmass.bags.mcap_bag import MAGIC, McapBag
from scara_effmass.errors import BagError
from scara_effmass.input_files import YAML_ERRORS, check_regular_file
from scara_effmass.url import Url, local_file

Reader = Ros1Reader | Ros2Reader

SUFFIXES = {".mcap", ".db3", ".bag"}
UNFINISHED = ".active"
METADATA = "metadata.yaml"
SPLIT_NAME = re.compile(r"(?P<name>.+)_(?P<number>\d+)\.(?P<suffix>(mcap|db3)(\.zstd)?)", re.IGNORECASE)
"""Name of a file in a rosbag2 folder."""
LOSSES_RECORD = "scara_effmass/losses"
"""Name of the MCAP metadata record, and key in custom_data of metadata.yaml, with the messages lost in recording."""
REPAIR_RECORD = "scara_effmass/not_repaired"
"""Key in custom_data of metadata.yaml with the lines about what a repair could not keep."""
BATCH_MESSAGES = 1000
BATCH_BYTES = 1 << 20


def find_bags(path: Path) -> list[Path]:
    """Return the bags at `path`: a file, a rosbag2 folder, or those in a folder and the folders below, by name.

    Hidden folders are left out. A bag that cannot be opened, such as a link to nowhere, is one of them. Raises BagError
    if there is none.
    """
    try:
        if path.is_file() or is_rosbag2_folder(path):
            return [path]
        if path.exists() and not path.is_dir():
            check_regular_file(path, BagError)
        bags = list(_bags_below(path, set()))
    except FileNotFoundError:
        raise BagError(f"{path}: does not exist") from None
    except OSError as error:
        raise BagError(f"{error.filename or path}: cannot be read: {error.strerror}") from None
    if not bags:
        raise BagError(f"{path}: contains no bag; expected a rosbag2 folder, .mcap, .db3 or ROS 1 .bag")
    return bags


def _bags_below(folder: Path, visited: set[Path]) -> Iterator[Path]:
    """Yield the bags in `folder` and below; links may lead to a folder again, which counts once. Raises OSError."""
    if (target := folder.resolve()) in visited:
        return
    visited.add(target)
    for path in sorted(folder.iterdir()):
        if path.is_dir():
            if is_rosbag2_folder(path):
                yield path
            elif not path.name.startswith("."):
                yield from _bags_below(path, visited)
        elif is_bag_name(path):
            yield path


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
    """Return whether a folder is one rosbag2 bag: it has metadata.yaml, or the numbered files of a bag that lost it.

    Files with the name of their folder are those of one bag, even if some are missing.
    """
    if not folder.is_dir():
        return False
    if (folder / METADATA).is_file():
        return True
    splits = [_split_name(path) for path in bag_files(folder)]
    names = {name for name, _ in splits}
    if len(names) != 1 or "" in names:
        return False
    is_complete = [number for _, number in splits] == list(range(len(splits)))
    return is_complete or splits[0][0].startswith(f"{folder.resolve().name}.")


def bag_files(folder: Path) -> list[Path]:
    """Return the bag files in `folder` in the order of their numbers. Raises OSError."""
    paths = (path for path in folder.iterdir() if is_bag_name(path) and path.is_file())
    return sorted(paths, key=lambda path: (_split_name(path)[1], path))


def _split_name(path: Path) -> tuple[str, int]:
    """Return name and suffix, which all files of a rosbag2 folder share, and the number of the file; else "" and 0."""
    match = SPLIT_NAME.fullmatch(path.name)
    return (f"{match['name']}.{match['suffix']}", int(match["number"])) if match else ("", 0)


def is_bag_name(path: Path) -> bool:
    """Return whether a file has the suffix of a bag, compressed or not, or of one that the recorder did not finish."""
    *_, inner, suffix = "", "", *(suffix.lower() for suffix in path.suffixes)
    return suffix in SUFFIXES or (suffix in {*ZSTD_SUFFIXES, UNFINISHED} and inner in SUFFIXES)


def bag_bytes(bag: Path) -> int:
    """Return the size of a bag that `find_bags` found."""
    paths = bag_files(bag) if bag.is_dir() else [bag]
    return sum(path.size() if isinstance(path, Url) else path.stat().st_size for path in paths if path.is_file())


def _open_files(bag: Path, paths: Sequence[Path], losses: LossLog) -> Bag:
    """Open the files of a bag. Compressed ones are decompressed to temporary files, which are deleted at once."""
    with ExitStack() as stack:

        def uncompressed(path: Path) -> Path:
            if not _head(path).startswith(ZSTD_MAGIC):
                return path
            return inflate_file(path, Path(stack.enter_context(TemporaryDirectory(prefix="scara-effmass-"))))

        files: list[tuple[Path, Path]] = []
        problems: list[str] = []
        formats = set()
        for path in paths:
            head = _head(file := uncompressed(path))
            magic = next((magic for magic in FORMATS if head.startswith(magic)), None)
            if magic is None:
                remedy = "; `scara-effmass import` converts text (CSV), TDMS and LVM: export others as CSV"
                remedy = "" if is_bag_name(path) else remedy
                content = f"is not a bag; expected MCAP, SQLite (rosbag2) or ROS 1{remedy}" if head else "is empty"
                problems.append(f"{path}: {content}")
                continue
            files.append((path, file))
            formats.add(magic)
            if (journal := Path(f"{path}-wal")).exists() and journal.stat().st_size:
                losses.add(f"{journal}: the recorder did not finish; messages in this journal are not read")
        if not files:
            raise BagError("; ".join(problems))
        losses.extend(problems)
        magic = formats.pop()
        if formats:
            raise BagError(f"{bag}: has files of several formats: must be of one")
        return FORMATS[magic](bag, files, losses)


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(16)


def _open_folder(folder: Path, losses: LossLog) -> Bag:
    metadata = read_metadata(folder, losses)
    present = bag_files(folder)
    _name_inner_bags(folder, present, losses)
    mode, compression = (str(metadata.get(key) or "").lower() for key in ("compression_mode", "compression_format"))
    if mode not in {"", "none", "file", "message"} or (mode in {"file", "message"} and compression != "zstd"):
        raise BagError(
            f"{folder / METADATA}: compression = {compression} of each {mode}: must be zstd of file or message"
        )
    named = named_files(folder, metadata)
    losses.extend(missing_files(folder, present, named))
    losses.extend(f"{folder / METADATA}: {line}" for line in _stored_losses(metadata))
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


def named_files(folder: Path, metadata: Mapping[str, Any]) -> list[Path]:
    """Return the files of `folder` that its `metadata` names, each once."""
    # Older recorders wrote the names with the folder in front.
    return [*dict.fromkeys(folder / Path(str(name)).name for name in metadata.get("relative_file_paths") or ())]


def missing_files(folder: Path, present: Sequence[Path], named: Sequence[Path]) -> Iterator[str]:
    """Yield a line about each file that metadata.yaml names and `folder` lacks, and about skipped numbers of files."""
    for path in named:
        if path not in present:
            yield f"{folder / METADATA}: names {path.name}, which does not exist"
    whole = f"{folder.resolve().name}."  # rosbags gives the only file the name of its folder, which can end in a number
    splits = {_split_name(path) for path in (*present, *named) if not path.name.startswith(whole)}
    last = max((number for _, number in splits), default=0)
    if len({name for name, _ in splits}) == 1 and len(splits) <= last:
        yield f"{folder}: files before number {last} that do not exist: {last + 1 - len(splits)}"


def _stored_losses(metadata: Mapping[str, Any]) -> Iterator[str]:
    """Yield a line about each loss that a recorder or a repair has stated in metadata.yaml, if it can be read."""
    with suppress(TypeError, ValueError, AttributeError, LookupError, RecursionError):
        for topic, counts in json.loads(metadata["custom_data"][LOSSES_RECORD]).items():
            yield f"{topic}: {sum(counts.values())} messages were lost in recording"
    with suppress(TypeError, AttributeError, LookupError):
        yield from metadata["custom_data"][REPAIR_RECORD].splitlines()


def _name_inner_bags(folder: Path, present: Sequence[Path], losses: LossLog) -> None:
    for path in _bags_below(folder, set()):
        if path not in present:
            losses.add(f"{path}: lies in the bag {folder}; not read")


def _continues(path: Path, named: Sequence[Path]) -> bool:
    """Return whether a file continues the bag with the files `named`."""
    name, number = _split_name(path)
    return bool(name) and all(other == name and earlier < number for other, earlier in map(_split_name, named))


def read_metadata(folder: Path, losses: LossLog) -> dict[str, Any]:
    """Return the content of metadata.yaml; empty if it is unusable."""
    path = folder / METADATA
    if not path.exists():
        losses.add(f"{path}: does not exist; read without it")
        return {}
    try:
        check_regular_file(path, BagError)
        information = yaml.safe_load(path.read_text(encoding="utf-8"))["rosbag2_bagfile_information"]
    except (*YAML_ERRORS, BagError):
        information = None
    if not isinstance(information, dict) or not isinstance(information.get("relative_file_paths"), list):
        losses.add(f"{path}: does not describe a bag; read without it")
        return {}
    return information


class SqliteReader(Ros2Reader):
    """Reader of an SQLite file with any suffix."""

    def __init__(self, path: Path) -> None:
        """See `rosbags.rosbag2.Reader`."""
        self.path, self.is_open, self.storage = path, False, self.STORAGE_PLUGINS[".db3"](path)


class RosbagsBag(Bag):
    """A bag of files that are each read by rosbags."""

    def __init__(
        self, path: Path, paths: Sequence[tuple[Path, Path]], losses: LossLog, make_reader: type[Reader]
    ) -> None:
        """Open the bag as `McapBag` does."""
        with ExitStack() as stack:
            self._readers = [(file, _open_reader(file, copy, make_reader, stack)) for file, copy in paths]
            self._stack = stack.pop_all()
        super().__init__(path, list(self._stored_topics()), losses, is_ros1=make_reader is Ros1Reader)
        for file, reader in self._readers:
            for line in _lost_rows(reader):
                losses.add(f"{file}: {line}")
        nonempty = [reader for _, reader in self._readers if reader.message_count]
        self.start_ns = min((reader.start_time for reader in nonempty), default=0)
        self.end_ns = max((reader.end_time - 1 for reader in nonempty), default=0)

    def batches(self, topics: Collection[int], start_ns: int, stop_ns: int) -> Iterator[MessageBatch]:
        """See `Bag`."""
        streams = [self._messages(path, reader, topics, start_ns, stop_ns) for path, reader in self._readers]
        merged = heapq.merge(*streams, key=itemgetter(0))
        messages: list[tuple[int, int, bytes]] = []
        size = 0
        for message in merged:
            messages.append(message)
            size += len(message[2])
            if len(messages) == BATCH_MESSAGES or size > BATCH_BYTES:
                yield _batch(messages)
                messages, size = [], 0
        if messages:
            yield _batch(messages)

    def _stored_topics(self) -> Iterator[StoredTopic]:
        for path, connection in ((path, c) for path, reader in self._readers for c in reader.connections):
            topic = Topic(connection.topic, connection.msgtype, connection.msgcount, connection.digest)
            ext = connection.ext
            encoding = ext.serialization_format if isinstance(ext, ConnectionExtRosbag2) else "cdr"
            has_definition = connection.msgdef.format != MessageDefinitionFormat.NONE
            yield StoredTopic(path, topic, encoding, connection.msgdef if has_definition else None)

    def _messages(
        self, path: Path, reader: Reader, topics: Collection[int], start_ns: int, stop_ns: int
    ) -> Iterator[tuple[int, int, bytes]]:
        connections = [c for c in reader.connections if self._topic_indices.get((c.topic, c.msgtype)) in topics]
        if not connections:
            return
        add_loss = self._losses.counter()
        try:
            rows: Iterator[tuple[Connection, Any, Any]] = reader.messages(connections, start_ns, stop_ns)
            for connection, log_time_ns, stored in rows:
                is_stored = isinstance(stored, bytes) and (stored or self._is_ros1)  # SQLite checks no types
                if not isinstance(log_time_ns, int) or not is_stored:
                    add_loss(f"{path}: {connection.topic}: left out a message without a time or data")
                    continue
                data = self._cdr(path, connection, stored, add_loss)
                if data:
                    yield log_time_ns, self._topic_indices[connection.topic, connection.msgtype], data
        except Exception as error:  # noqa: BLE001 - rosbags raises many types for a damaged file
            self._losses.add(f"{path}: damaged, the rest is lost: {one_line(error)}")

    def _cdr(self, path: Path, connection: Connection, stored: bytes, add_loss: Callable[[str], None]) -> bytes:
        """Return a message in CDR; empty if it cannot be decompressed, or converted from ROS 1."""
        if not self._is_ros1:
            return inflate_stored(path, stored, add_loss)
        try:
            return bytes(self.types.ros1_to_cdr(stored, connection.msgtype))
        except Exception as error:  # noqa: BLE001 - code generated from unchecked definitions
            origin = f"{path}: {connection.topic}: {connection.msgtype}"
            add_loss(f"{origin} cannot be converted: {one_line(error)}")
            return b""


def _batch(messages: list[tuple[int, int, bytes]]) -> MessageBatch:
    times, indices, data = zip(*messages, strict=True)
    return batch_of(indices, times, list(data))


def _open_reader(path: Path, uncompressed: Path, make_reader: type[Reader], stack: ExitStack) -> Reader:
    """Open the `uncompressed` copy of the file at `path` with rosbags until `stack` closes it."""
    try:
        reader = make_reader(local_file(uncompressed))
        reader.open()
        if isinstance(reader, Ros1Reader):
            _bound_chunks(reader)
    except OSError:
        raise
    except Exception as error:  # noqa: BLE001 - rosbags raises many types for a damaged file
        raise BagError(f"{path}: cannot be read: {one_line(error)}") from None
    stack.callback(reader.close)
    return reader


def _bound_chunks(reader: Ros1Reader) -> None:
    """Let a reader decompress each chunk at most to the size that the chunk states."""

    def decompressor(compression: str, size: int) -> Callable[[bytes], bytes]:
        return lambda data: inflate(data, compression, size)

    if (file := reader.bio) is None:
        return
    for position, chunk in reader.chunks.items():
        file.seek(position)
        header = Header.read(file, RecordType.CHUNK)
        bounded = decompressor(header.get_string("compression"), header.get_uint32("size"))
        reader.chunks[position] = chunk._replace(decompressor=bounded)


def _lost_rows(reader: Reader) -> Iterator[str]:
    """Yield a line for each kind of rows of an SQLite file that `Reader.messages` leaves out without a word."""
    database = getattr(getattr(reader, "storage", None), "dbconn", None)
    if database is None:
        return
    named = "topic_id IN (SELECT id FROM topics)"
    kinds = {
        f"topic_id IS NULL OR NOT {named}": "of topics that the file does not define",
        f"{named} AND (typeof(timestamp) <> 'integer' OR timestamp < 0)": "without a time, or before 1970,",
    }
    for condition, text in kinds.items():
        with suppress(Exception):  # apsw raises many types for a damaged file, which shows while messages are read
            if count := database.execute(f"SELECT count(*) FROM messages WHERE {condition}").fetchone()[0]:  # noqa: S608
                yield f"{count} messages {text} are lost"


FORMATS: dict[bytes, Callable[..., Bag]] = {
    MAGIC: McapBag,
    b"SQLite format 3\0": partial(RosbagsBag, make_reader=SqliteReader),
    b"#ROSBAG V": partial(RosbagsBag, make_reader=Ros1Reader),
}
"""Bags by the first bytes of their files."""

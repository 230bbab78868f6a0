"""Recordings that were not completed: index, summary and metadata made again from what is there."""

from __future__ import annotations

import json
import os
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

import yaml
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from rosbags.typesys.msg import normalize_msgtype

from scara_effmass.bags.batches import Losses, Topic
from scara_effmass.bags.disk_file import is_being_written
from scara_effmass.bags.files import METADATA, PART, data_files
from scara_effmass.bags.mcap_copy import copy_records
from scara_effmass.bags.mcap_file import McapFile
from scara_effmass.bags.mcap_records import HEAD, records
from scara_effmass.bags.part_writer import HASH_KEY, QOS_KEY
from scara_effmass.bags.recorded_topic import LOSSES_RECORD, custom_data
from scara_effmass.bags.rosbag2 import Part, sync_folder, write_metadata
from scara_effmass.errors import BagError, OutputError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

DAMAGED = ".damaged"
"""Suffix of an original that is kept because not everything in it could be saved."""


@dataclass(frozen=True, slots=True)
class FileRepair:
    """What became of one file. `messages` it holds now; `lost` says what could not be saved, a line each."""

    path: Path
    intact: bool
    """It was complete, and has been left alone."""
    messages: int
    lost: tuple[str, ...] = ()
    kept_original: Path | None = None
    """The file as it was, where more than its torn end could not be read."""


@dataclass(frozen=True, slots=True)
class RepairReport:
    """What became of a recording."""

    files: tuple[FileRepair, ...]
    failed: tuple[str, ...]
    """Files that hold nothing of a recording, and why; they have been left alone."""
    metadata_rewritten: bool

    @property
    def intact(self) -> bool:
        """Whether nothing had to be done."""
        return not self.failed and not self.metadata_rewritten and all(file.intact for file in self.files)


def repair(path: Path) -> RepairReport:
    """Complete the recording at `path`, an MCAP file or a rosbag2 folder of such files.

    All that can be read is written to a new file, which is checked and then takes the place of the old one. A file
    that is complete is left alone. A file of the rosbag2 folder that bears its name stands for the whole folder.

    Raises BagError when there is no recording in MCAP, OutputError when it is being recorded or cannot be written.
    """
    part = PART.fullmatch(path.name)
    folder = path.parent if path.is_file() and part and part["name"] == path.parent.resolve().name else path
    try:
        if folder.is_dir():
            return _repaired_folder(folder)
        return RepairReport((_repaired(folder),), (), metadata_rewritten=False)
    except OutputError:
        raise
    except FileNotFoundError as error:
        raise BagError(f"{error.filename}: there is no such file or folder") from None
    except OSError as error:
        raise OutputError(f"{error.filename or path}: cannot be repaired: {error.strerror or error}") from None


def _repaired_folder(folder: Path) -> RepairReport:
    files = [file for file in data_files(folder) if file.suffix == ".mcap"]
    if not files:
        raise BagError(f"{folder}: holds no .mcap file; only recordings in MCAP are repaired")
    outcomes = [_tried(file) for file in files]
    repaired = [outcome for outcome in outcomes if isinstance(outcome, FileRepair)]
    failed = [outcome for outcome in outcomes if isinstance(outcome, str)]
    if not repaired:
        raise BagError(failed[0])
    return RepairReport(tuple(repaired), tuple(failed), metadata_rewritten=_describe(folder, repaired))


def _tried(path: Path) -> FileRepair | str:
    """Return what became of a file, or why nothing could."""
    try:
        return _repaired(path)
    except BagError as error:
        return str(error)


def _repaired(path: Path) -> FileRepair:
    if is_being_written(path):
        raise OutputError(f"{path}: is being recorded; end the recorder first")
    if _is_complete(path):
        return FileRepair(path, intact=True, messages=_described(path).count)
    fresh = path.with_name(f".{path.name}.repaired")
    try:
        with path.open("rb") as file, fresh.open("wb") as out:
            copied = copy_records(path, file, out)
            out.flush()
            os.fsync(out.fileno())
        if not _is_complete(fresh) or (messages := _described(fresh).count) != copied.messages:
            raise OutputError(f"{path}: what was made of it cannot be read back; it has been left alone")
        original = None
        if copied.gaps:
            original = path.with_name(path.name + DAMAGED)
            if original.exists():
                raise OutputError(f"{original}: exists already; take it away first, it may hold what {path} does not")
            path.rename(original)
        fresh.replace(path)
        sync_folder(path.parent)
    finally:
        with suppress(OSError):
            fresh.unlink()
    return FileRepair(path, intact=False, messages=messages, lost=tuple(copied.lost), kept_original=original)


def _is_complete(path: Path) -> bool:
    """Whether everything in a file can be read and is indexed. Raises BagError when it is no MCAP file."""
    losses = Losses()
    with path.open("rb") as file:
        mcap = McapFile(path, file, losses)
        for segment in mcap.segments:
            mcap.read(segment)
        if any(losses):
            return False
        chunks = {r.at - HEAD.size for r in records(file, file.seek(0, 2)) if r.opcode == Opcode.CHUNK}
        try:
            file.seek(0)
            summary = SeekingReader(file).get_summary()
        except (McapError, ValueError, LookupError):
            return False
    if summary is None or summary.statistics is None:
        return False
    return {index.chunk_start_offset for index in summary.chunk_indexes} == chunks


def _described(path: Path) -> Part:
    """Return what the summary of a complete file says."""
    with path.open("rb") as file:
        summary = SeekingReader(file).get_summary()
    if summary is None or summary.statistics is None:
        raise BagError(f"{path}: has no summary")
    counts = summary.statistics.channel_message_counts
    topics = [
        Topic(
            channel.topic,
            normalize_msgtype(summary.schemas[channel.schema_id].name) if channel.schema_id in summary.schemas else "",
            counts.get(channel.id, 0),
            channel.metadata.get(HASH_KEY, ""),
            channel.metadata.get(QOS_KEY, ""),
        )
        for channel in summary.channels.values()
    ]
    statistics = summary.statistics
    return Part(path.name, statistics.message_start_time, statistics.message_end_time, tuple(topics))


def _describe(folder: Path, files: Sequence[FileRepair]) -> bool:
    """Write metadata.yaml unless it is there and right; return whether it was written."""
    about: dict[str, object] = {}
    with suppress(OSError, yaml.YAMLError, ValueError, TypeError, LookupError):
        about = dict(yaml.safe_load((folder / METADATA).read_text(encoding="utf-8"))["rosbag2_bagfile_information"])
    named, count = about.get("relative_file_paths"), sum(file.messages for file in files)
    is_right = named == [file.path.name for file in files] and about.get("message_count") == count
    if is_right and all(file.intact for file in files):
        return False
    known = about.get("custom_data")
    custom = {**(known if isinstance(known, dict) else {}), **_losses(files)}
    write_metadata(folder, [_described(file.path) for file in files], custom)
    return True


def _losses(files: Sequence[FileRepair]) -> dict[str, str]:
    """Return what the recorder itself said it had lost, as custom_data."""
    said: dict[str, str] = {}
    for repaired in files:
        with repaired.path.open("rb") as file:
            for record in SeekingReader(file).iter_metadata():
                if record.name == LOSSES_RECORD:
                    said = record.metadata
    with suppress(json.JSONDecodeError):
        return custom_data(said)
    return {}

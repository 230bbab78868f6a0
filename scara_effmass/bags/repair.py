# SPDX-License-Identifier: Apache-2.0
"""Repair incomplete bags: make index, summary and metadata from the readable content."""

import os
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from secrets import token_hex
from typing import Any

from mcap.opcode import Opcode

from scara_effmass.bags.batches import LossLog
from scara_effmass.bags.files import (
    LOSSES_RECORD,
    METADATA,
    REPAIR_RECORD,
    SPLIT_NAME,
    bag_files,
    missing_files,
    named_files,
    read_metadata,
)
from scara_effmass.bags.mcap_bag import (
    DAMAGE,
    RECORD_HEAD,
    McapCopy,
    McapFile,
    open_mcap,
    read_index,
    records,
    stored_metadata,
)
from scara_effmass.bags.recorder import losses_custom_data
from scara_effmass.bags.writer import BagFile, is_being_written, sync_folder, write_metadata
from scara_effmass.errors import BagError, OutputError
from scara_effmass.input_files import check_regular_file

DAMAGED_SUFFIX = ".damaged"
"""Suffix of an original file that is kept because part of its content could not be copied."""


@dataclass(frozen=True, slots=True)
class FileRepair:
    """Result for one file: the number of messages that it now contains, and lines about lost data."""

    path: Path
    intact: bool
    """The file was complete and is unchanged."""
    messages: int
    lost: tuple[str, ...] = ()
    kept_original: Path | None = None
    """Path of the original; None if at most its torn end could not be read."""


@dataclass(frozen=True, slots=True)
class RepairReport:
    """Result for a bag."""

    files: tuple[FileRepair, ...]
    failed: tuple[str, ...]
    """Lines about files that are not MCAP, which are unchanged, and about files that are missing."""
    metadata_rewritten: bool

    @property
    def intact(self) -> bool:
        """Whether the bag was complete; nothing has changed."""
        return not self.failed and not self.metadata_rewritten and all(file.intact for file in self.files)


def repair(path: Path) -> RepairReport:
    """Complete the bag at `path`, an MCAP file or a rosbag2 folder of MCAP files.

    The readable content is copied to a new file, which is checked and then replaces the original. Complete files stay
    unchanged. The path of a file that has the name of its rosbag2 folder stands for the whole folder.

    Raises BagError if there is no MCAP bag, OutputError if it is being recorded or cannot be written.
    """
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise BagError(f"{path}: is a device or a pipe; must be an MCAP file or a rosbag2 folder")
    match = SPLIT_NAME.fullmatch(path.name)
    is_split_file = path.is_file() and match is not None and match["name"] == path.parent.resolve().name
    bag = path.parent if is_split_file else path
    try:
        return _repair_bag(bag)
    except OutputError:
        raise
    except FileNotFoundError as error:
        raise BagError(f"{error.filename}: does not exist") from None
    except OSError as error:
        raise OutputError(f"{error.filename or path}: cannot be repaired: {error.strerror or error}") from None


def _repair_bag(bag: Path) -> RepairReport:
    is_folder = bag.is_dir()
    paths = bag_files(bag) if is_folder else [bag]
    others = [path for path in paths if is_folder and path.suffix.lower() != ".mcap"]
    if len(others) == len(paths):
        raise BagError(f"{bag}: contains no .mcap file; only MCAP bags can be repaired")
    if others:
        raise BagError(f"{others[0]}: must be decompressed or moved away first, as metadata.yaml will name .mcap files")
    _check_one_bag(bag, paths)
    repaired: list[tuple[FileRepair, BagFile]] = []
    failed: list[str] = []
    for path in paths:
        try:
            repaired.append(_repair_file(path))
        except BagError as error:  # noqa: PERF203 - a few files
            failed.append(str(error))
    if not repaired:
        raise BagError(failed[0])
    files = tuple(file for file, _ in repaired)
    if not is_folder:
        return RepairReport(files, tuple(failed), metadata_rewritten=False)
    information: dict[str, Any] = {}
    with suppress(OSError):
        information = read_metadata(bag, LossLog())
    failed += missing_files(bag, bag_files(bag), named_files(bag, information))
    lost = [line.removeprefix(f"{bag}{os.sep}") for line in [*failed, *(line for file in files for line in file.lost)]]
    rewritten = _update_metadata(bag, information, files, [content for _, content in repaired], lost)
    return RepairReport(files, tuple(failed), metadata_rewritten=rewritten)


def _check_one_bag(bag: Path, paths: Sequence[Path]) -> None:
    """Raise BagError for the files of several bags, which metadata.yaml would join, and where it cannot be written."""
    if bag.is_dir() and (metadata := bag / METADATA).exists():
        check_regular_file(metadata, BagError)
    elif len(paths) > 1:
        names = {match["name"] if (match := SPLIT_NAME.fullmatch(path.name)) else "" for path in paths}
        if len(names) > 1 or "" in names:
            raise BagError(f"{bag}: contains {len(paths)} bags: must be one of them ({paths[0].name}, ...)")


def _repair_file(path: Path) -> tuple[FileRepair, BagFile]:
    """Repair a file; return the result and the new content. Raises BagError, OutputError or OSError."""
    if is_being_written(path):
        raise OutputError(f"{path}: is being recorded; stop the recorder first")
    if (content := _complete_file(path)) is not None:
        return FileRepair(path, intact=True, messages=content.count), content
    unfinished = path.with_name(f".{path.name}-{token_hex(4)}.repaired")
    try:
        losses = LossLog()
        with path.open("rb") as file, unfinished.open("xb") as output:
            copy = McapCopy(path, file, output, losses)
            output.flush()
            os.fsync(output.fileno())
        content = _complete_file(unfinished)
        if content is None or content.count != copy.messages:
            raise OutputError(f"{path}: the repaired copy cannot be read back; the file is unchanged")
        original = None
        if copy.has_gaps:
            original = path.with_name(path.name + DAMAGED_SUFFIX)
            if original.exists():
                raise OutputError(f"{original}: already exists; move it away first, it may contain more than {path}")
            path.rename(original)
        unfinished.replace(path)
        sync_folder(path.parent)
    finally:
        with suppress(OSError):
            unfinished.unlink()
    repaired = FileRepair(path, intact=False, messages=content.count, lost=tuple(losses), kept_original=original)
    return repaired, replace(content, name=path.name)


def _complete_file(path: Path) -> BagFile | None:
    """Return the content of a file if its index covers all of it and all can be read. Raises BagError if not MCAP."""
    with open_mcap(path) as file:
        try:
            summary = read_index(file)
            deque(stored_metadata(file), maxlen=0)  # of which nothing else reads all
        except DAMAGE:
            return None
        stored = [record.start - RECORD_HEAD.size for record in records(file) if record.opcode == Opcode.CHUNK]
    if summary is None or stored != [chunk.chunk_start_offset for chunk in summary.chunk_indexes]:
        return None
    losses = LossLog()
    with closing(McapFile(path, losses)) as mcap:
        for chunk in mcap.chunks:
            mcap.read(chunk)
        start_ns = min((chunk.message_start_time for chunk in mcap.chunks), default=0)
        end_ns = max((chunk.message_end_time for chunk in mcap.chunks), default=0)
        content = BagFile(path.name, start_ns, end_ns, tuple(stored.topic for stored in mcap.stored_topics()))
    return None if any(losses) else content


def _update_metadata(
    folder: Path,
    information: Mapping[str, Any],
    files: Sequence[FileRepair],
    contents: Sequence[BagFile],
    lost: Sequence[str],
) -> bool:
    """Write metadata.yaml unless its `information` is correct; return whether it was written.

    It keeps the lines about what is `lost`, because the repaired files do not show it.
    """
    names, count = [file.path.name for file in files], sum(file.messages for file in files)
    is_correct = information.get("relative_file_paths") == names and information.get("message_count") == count
    if is_correct and all(file.intact for file in files):
        return False
    stored = information.get("custom_data")
    custom_data = {**(stored if isinstance(stored, dict) else {}), **_recorded_losses(files)}
    if lines := [*str(custom_data.get(REPAIR_RECORD, "")).splitlines(), *lost]:
        custom_data[REPAIR_RECORD] = "\n".join(dict.fromkeys(lines))
    write_metadata(folder, contents, custom_data)
    return True


def _recorded_losses(files: Sequence[FileRepair]) -> dict[str, str]:
    """Return, as custom_data, the losses that the recorder stored in the files."""
    losses: dict[str, str] = {}
    for repaired in files:
        with repaired.path.open("rb") as file:
            for record in stored_metadata(file):
                if record.name == LOSSES_RECORD:
                    losses = record.metadata
    with suppress(ValueError, RecursionError):
        return losses_custom_data(losses)
    return {}

# SPDX-License-Identifier: Apache-2.0
"""Assess recordings: each into a table, or into a dataset of a Parquet file per recording, by cell and day.

In a dataset no recording is assessed twice.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from glob import escape
from pathlib import Path
from typing import Annotated, NamedTuple

from pydantic import Field, InstanceOf, TypeAdapter, ValidationError

from scara_effmass import __version__
from scara_effmass.analysis.assessment import (
    ClockSkew,
    Time,
    assess_joint_states,
    cross_checked,
    generated_description,
    joint_state_topic,
    open_velocities,
    other_topic_lines,
    unapplied_lines,
)
from scara_effmass.analysis.forces import RecordedForce, read_force
from scara_effmass.analysis.output import atomic_file, check_output_path
from scara_effmass.analysis.summary import Summary, iso_time
from scara_effmass.analysis.tables import AssessmentWriter, open_writer, provenance
from scara_effmass.analysis.time_series import TimeSeries, TimeSeriesBuilder
from scara_effmass.bags.files import bag_bytes, open_bag
from scara_effmass.codes import Reason
from scara_effmass.errors import BagError, OutputError
from scara_effmass.input_files import digest
from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.safety.reasons import LOAD_ENTRY, plain_text
from scara_effmass.settings import MonitorSettings
from scara_effmass.url import Url

RECORDS = "_results"
"""Folder with the results of the recordings; readers of datasets skip names that begin with _."""
UNKNOWN_CELL = "unknown"


@dataclass(frozen=True, slots=True)
class BagTask:
    """What to do with each recording; can be pickled. `topic` None: the only one with joint states.

    `velocity_bag` holds the velocities, if given; `report` keeps the time series and the force; `cross_check` compares
    with the decisions of a second monitor.
    """

    settings: MonitorSettings
    time: Time = Time.LIVE
    topic: str | None = None
    velocity_bag: Path | None = None
    report: bool = False
    cross_check: bool = False


class Drawable(NamedTuple):
    """What a report draws of one recording: series by contact point, force, and whether its motion is generated."""

    series: Mapping[str, TimeSeries]
    force: RecordedForce | None
    generated: bool


@dataclass(slots=True)
class BagResult:
    """Result of one recording; can be pickled. `unmodelled` are joints that moved, but are not in the model."""

    summary: Summary
    counts: dict[str, int]
    losses: tuple[str, ...]
    notes: list[tuple[str, str]]
    unmodelled: tuple[str, ...]
    drawable: Annotated[InstanceOf[Drawable] | None, Field(exclude=True)] = None


def assess_bag(
    path: Path, task: BagTask, dynamics: RobotDynamics, table: AssessmentWriter, advance: Callable[[float], object]
) -> BagResult:
    """Assess the joint states of the bag at `path` with a fresh monitor and write them to `table`.

    `dynamics` is the robot of the settings. `advance` is called with the share of each further part.
    Raises BagError, SettingsError and CrossCheckError.
    """
    settings, count = task.settings, 0
    with (
        open_bag(path) as bag,
        open_velocities(task.velocity_bag, task.topic, settings) as velocities,
        ExitStack() as stack,
    ):
        topic = joint_state_topic(bag, task.topic)
        series = [TimeSeriesBuilder() for _ in dynamics.contact_points] if task.report else []
        monitor, name = Monitor(dynamics, settings), str(bag.path)
        summary, skew = Summary(round(settings.timeout * 1e9)), ClockSkew()
        batches = assess_joint_states(bag, topic, monitor, task.time, velocities, skew, advance)
        if task.cross_check:
            reference = Monitor(dynamics, settings, use_reference=True)
            second = stack.enter_context(open_bag(path))
            others = stack.enter_context(open_velocities(task.velocity_bag, task.topic, settings))
            expected = assess_joint_states(second, topic, reference, task.time, others)
            batches = cross_checked(name, batches, expected)
        with ThreadPoolExecutor(1) as writer:
            written = writer.submit(lambda: None)
            for states in batches:
                count += len(states)
                written.result()  # at most one batch waits
                written = writer.submit(table.add, name, states)
                summary.add(states, name)
                for point, builder in enumerate(series):
                    builder.add(states, point)
            written.result()
        summary.end(bag.end_ns)
        counts = {"joint_states": count + monitor.ignored, "foreign": monitor.ignored, "refused": monitor.rejected}
        notes = [*skew.lines(settings, task.time)]
        if velocities and (missing := summary.reasons[plain_text(Reason.NO_VELOCITY)]):
            cause = f"before or after it, in its gaps above {settings.timeout:g} s, or without one of the joints"
            notes.append(("velocity", f"{missing} joint states have none in {velocities.bag.path}: {cause}"))
        if monitor.load_watch.estimate is not None:
            notes.append((LOAD_ENTRY, monitor.load_text))
        notes += [*other_topic_lines(bag, topic, monitor), *unapplied_lines(bag, settings)]
        if monitor.unmatched:
            notes.append(("ignored joints", f"no joint state names {', '.join(monitor.unmatched)}"))
        drawable = None
        if task.report:
            builds = (builder.build() for builder in series)
            named = dict(zip(dynamics.contact_points, builds, strict=True))
            drawable = Drawable(named, read_force(bag), bool(generated_description(bag)))
        losses = bag.losses + (velocities.bag.losses if velocities else ())
        return BagResult(summary, counts, losses, notes, monitor.unmodelled_joints, drawable)


class Record(NamedTuple):
    """Result of one recording: `key` is a hash of all that it depends on.

    `part` is the file of the assessed states in the dataset, and `part_hash` that of its content.
    """

    key: str
    part: str
    part_hash: str
    result: BagResult


_RECORD = TypeAdapter(Record, config={"ser_json_inf_nan": "constants"})
_PART = re.compile(r"(?P<cell>cell=[^/]+)/day=[^/]+/[^/]+-(?P<content>[0-9a-f]{16})\.parquet")
_COUNTS = {"joint_states", "foreign", "refused"}


def cell_of(path: Path) -> str:
    """Return the cell of a recording by the folder `cell=NAME` that contains it, UNKNOWN_CELL without one."""
    return next((part[5:] for part in reversed(path.parts) if part.startswith("cell=")), UNKNOWN_CELL)


def without_copies(paths: Sequence[Path], cell: str | None) -> tuple[list[Path], list[tuple[str, str]]]:
    """Return `paths` without those of the same content as an earlier one in its cell, and a line about each copy.

    `cell` is that of `assess_part`, None for `cell_of`.
    """
    kinds = [(cell or cell_of(path), bag_bytes(path)) for path in paths]
    counts, notes = Counter(kinds), list[tuple[str, str]]()
    first: dict[tuple[object, ...], Path] = {}
    for path, kind in zip(paths, kinds, strict=True):
        content = str(path)
        if counts[kind] > 1:
            with suppress(BagError):  # the assessment names it
                content = _hash_of(path)
        original = first.setdefault((*kind, content), path)
        if original is not path:
            notes.append(("counted once", f"{path}: same content as {original}"))
    return [*first.values()], notes


def assess_part(
    folder: Path,
    task: BagTask,
    path: Path,
    advance: Callable[[float], object],
    *,
    cell: str | None,
    overwrite: bool,
) -> BagResult:
    """Assess the bag at `path` into `folder`/cell=`cell`/day=DAY/, unless that was done; return the result.

    It was done if bag, cell (None: `cell_of` the path), settings, robot and version have the same hashes, and the part
    is as it was written; a cross-check assesses again, and so does a damaged result. Raises BagError, SettingsError,
    and OutputError if anything but bag and cell differs, unless `overwrite`.
    """
    content, cell = _hash_of(path), cell or cell_of(path)
    inputs = [content, task.settings.model_dump_json(), digest(Path(task.settings.robot_path), BagError), __version__]
    inputs += sorted(task.settings.model_fields_set)  # the others are assumed
    inputs += [task.time.value, str(task.topic), cell, _hash_of(task.velocity_bag) if task.velocity_bag else ""]
    key = hashlib.sha256(json.dumps(inputs).encode()).hexdigest()
    file = folder / RECORDS / f"cell={cell}" / f"{content[:16]}.json"
    notes: list[tuple[str, str]] = []
    check_output_path(file, overwrite=True)
    if file.exists():
        record = _read_record(file, folder, overwrite=overwrite)
        if record is None:
            notes.append(("assessed again", f"{file}: was damaged, or of another version"))
        elif record.key != key:
            if not overwrite:
                problem = "is of other settings, robot or version; use --force to replace it"
                raise OutputError(f"{folder / record.part}: {problem}")
        elif (earlier := folder / record.part).is_file():
            is_as_written = _hash_of(earlier) == record.part_hash
            if is_as_written and not task.cross_check:
                advance(1.0)
                return record.result
            if not is_as_written:
                notes.append(("assessed again", f"{earlier}: was damaged or changed since it was written"))
    with open_bag(path) as bag:
        day = iso_time(bag.start_ns)[:10]
    part = f"cell={cell}/day={day}/{path.stem}-{content[:16]}.parquet"
    dynamics = RobotDynamics(load_robot(task.settings.robot_path, task.settings))
    origin = provenance(task.settings, dynamics.robot.origin, [path])
    with open_writer(folder / part, origin, dynamics.robot.base_frame, overwrite=True) as table:
        result = assess_bag(path, task, dynamics, table, advance)
    _remove_other_parts(folder, part)
    with atomic_file(file, overwrite=True) as unfinished:
        unfinished.write_bytes(_RECORD.dump_json(Record(key, part, _hash_of(folder / part), result)))
    result.notes = [*result.notes, *notes]
    return result


def remove_unfinished(folder: Path, bags: Iterable[Path]) -> None:
    """Remove from a local `folder` what killed processes of this machine have left of the parts of `bags`."""
    stems = {bag.stem for bag in bags}
    for file in () if isinstance(folder, Url) else folder.glob("cell=*/day=*/.*.parquet"):
        unfinished = re.fullmatch(r"\.(?P<stem>.+)-[0-9a-f]{16}-(?P<process>\d+)\.parquet", file.name)
        if unfinished and unfinished["stem"] in stems and not Path("/proc", unfinished["process"]).exists():
            file.unlink(missing_ok=True)


def _remove_other_parts(folder: Path, part: str) -> None:
    """Remove from a local `folder` the other parts of the recording and cell of `part`: of another name or day."""
    name = _PART.fullmatch(part)
    if isinstance(folder, Url) or name is None:
        return
    for other in folder.glob(f"{escape(name['cell'])}/day=*/*-{name['content']}.parquet"):
        if other != folder / part and other.resolve().is_relative_to(folder.resolve()):
            other.unlink()


def _read_record(file: Path, folder: Path, *, overwrite: bool) -> Record | None:
    """Return the result in `file`, whose part is in `folder` and nowhere else; None if it is damaged.

    Raises OutputError for one of another version, unless `overwrite`, which takes it for a damaged one.
    """
    try:
        with file.open("rb") as stream:
            record: Record = _RECORD.validate_json(stream.read())
        _check_record(record, file, folder)
    except OSError as error:
        raise OutputError(f"{file}: cannot be read: {error.strerror or error}") from None
    except (ValueError, LookupError, TypeError, ArithmeticError) as error:
        is_no_json = isinstance(error, ValidationError) and error.errors()[0]["type"] == "json_invalid"
        if overwrite or is_no_json:
            return None
        problem = "must be a result of this version: remove it, or use --force to assess again"
        raise OutputError(f"{file}: {problem}") from None
    return record


def _check_record(record: Record, file: Path, folder: Path) -> None:
    """Raise ValueError, LookupError, TypeError or ArithmeticError if a result cannot be used as it is.

    A dataset may come from anywhere: its part must be of this recording and in `folder`, also behind symbolic links.
    """
    name = _PART.fullmatch(record.part)
    if name is None or (name["cell"], name["content"]) != (file.parent.name, file.stem):
        raise ValueError(record.part)
    if not isinstance(folder, Url) and not (folder / record.part).resolve().is_relative_to(folder.resolve()):
        raise ValueError(record.part)
    kept = record.result.summary
    is_complete = all(len(kept.numbers[text]) == text.count("…") for text in kept.reasons)
    if record.result.counts.keys() != _COUNTS or not is_complete:
        raise ValueError(record)
    summary = Summary(kept.timeout_ns)
    summary.merge(kept)
    json.dumps(summary.as_dict(), allow_nan=False)
    list(summary.lines())


def _hash_of(bag: Path) -> str:
    """Return the SHA-256 of a local bag, or of the checksums that a remote file system gives. Raises BagError."""
    if not isinstance(bag, Url):
        return digest(bag, BagError)
    try:
        files = sorted(bag.rglob("*")) if bag.is_dir() else [bag]
        return hashlib.sha256("".join(file.checksum() for file in files).encode()).hexdigest()
    except OSError as error:
        raise BagError(f"{error.filename or bag}: cannot be read: {error.strerror}") from None

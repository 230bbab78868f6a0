# SPDX-License-Identifier: Apache-2.0
"""Joint states from a CSV file, such as a log of UR's RTDE or `ros2 topic echo --csv`, read by a mapping file."""

import math
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from pydantic import Field, StrictInt

from scara_effmass.bags.writer import BagWriter
from scara_effmass.errors import BagError, SettingsError
from scara_effmass.importers.csv_file import Rows, has_number, named_rows, spelled_unit, with_nanoseconds
from scara_effmass.importers.times import NS_PER_UNIT, Midnights, Numbers, time_ns
from scara_effmass.input_files import read_yaml
from scara_effmass.settings import checked
from scara_effmass.settings.loading import FrozenSettings
from scara_effmass.values import JointState
from scara_effmass.wire.cdr import MAX_SEC, NS

Column = StrictInt | str
"""Name of a column, or its number from 0."""
SCALES = {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180.0, "m": 1.0, "mm": 1e-3}
SPELLINGS = {"degree": "deg", "degrees": "deg", "°": "deg", "radian": "rad", "radians": "rad"}
MIN_RATE, MAX_RATE = 2.0, 1e5
"""Rates of joint states [Hz] between which times are in seconds unless the mapping states their unit."""
MIN_COUNT = 16
"""Number of joint states that show their rate."""
FIRST_NS = NS
"""Stamp of the first joint state if the times begin at 0 or before, which would be no valid stamp."""


class JointColumns(FrozenSettings):
    """Columns of one joint; its position is in `unit`, its velocity in `unit` per second."""

    position: Column
    velocity: Column | None = None
    unit: Literal["rad", "mrad", "deg", "m", "mm"] = "rad"


class JointTable(FrozenSettings):
    """Content of a mapping file; `time` is one column, or two columns with seconds and nanoseconds.

    A `rate` [Hz] in place of `time` is that of a file without times.
    """

    time: Column | tuple[Column, Column] | None = None
    rate: float | None = Field(None, gt=0.0, lt=1e7)
    time_unit: Literal["s", "ms", "us", "ns"] = "s"
    delimiter: str = Field(",", min_length=1, max_length=1, pattern=r'[^"\r\n]')
    header: bool = True
    joints: dict[str, JointColumns] = Field(min_length=1)


class ImportedJointStates(NamedTuple):
    """Summary of an imported CSV file; `shift_s` was added to its times."""

    joint_states: int
    first_stamp_s: float
    last_stamp_s: float
    shift_s: float
    has_velocity: bool
    rows_without_values: int


def write_joint_state_bag(
    path: Path, mapping: Path, output: Path, *, rate: float = 0.0, header: bool = True, overwrite: bool = False
) -> ImportedJointStates:
    """Write the joint states in the CSV file `path` to the topic joint_states of a new bag.

    A `rate` [Hz] replaces the times of the mapping; `header` false: the file has none, whatever the mapping says.
    Raises BagError, SettingsError or OutputError; no incomplete bag remains.
    """
    content = read_yaml(mapping, SettingsError)
    if not isinstance(content, Mapping):
        raise SettingsError(f"{mapping}: must hold time and joints")
    content = dict(content) | ({"rate": rate, "time": None} if rate else {}) | ({} if header else {"header": False})
    table = checked(JointTable, content, str(mapping))
    if (table.time is None) == (table.rate is None):
        raise SettingsError(f"{mapping}: time: must be a column, or rate [Hz] must be given in its place (--rate)")
    has_velocity = all(joint.velocity is not None for joint in table.joints.values())
    if not has_velocity and any(joint.velocity is not None for joint in table.joints.values()):
        raise SettingsError(f"{mapping}: joints: velocity must be given for all joints, or for none")
    count = first_ns = last_ns = shift_ns = without_values = 0
    with BagWriter(output, overwrite=overwrite) as bag:
        for line, state in _joint_states(path, mapping, table):
            if state is None:
                without_values += 1
                continue
            if not count:
                shift_ns = FIRST_NS - state.stamp_ns if state.stamp_ns <= 0 else 0
                first_ns = state.stamp_ns + shift_ns
            stamp_ns = state.stamp_ns + shift_ns
            if count and stamp_ns <= last_ns:
                is_whole = stamp_ns == last_ns and not state.stamp_ns % NS
                remedy = "; of whole seconds, state time: [SECONDS, NANOSECONDS], or --rate HZ" if is_whole else ""
                raise BagError(f"{path}: line {line}: time: must be later than in the row before{remedy}")
            bag.write_joint_states("/joint_states", [state._replace(stamp_ns=stamp_ns)])
            count, last_ns = count + 1, stamp_ns
        if not count:
            raise BagError(f"{path}: has no rows of numbers")
        sample_rate = (count - 1) * NS / max(1, last_ns - first_ns)
        is_assumed = isinstance(table.time, (int, str)) and "time_unit" not in table.model_fields_set
        if is_assumed and count > MIN_COUNT and not MIN_RATE <= sample_rate <= MAX_RATE:
            rule = f"must be stated (s, ms, us or ns): {path} would have {sample_rate:.4g} joint states per second"
            raise SettingsError(f"{mapping}: time_unit: {rule}")
    return ImportedJointStates(count, first_ns / NS, last_ns / NS, shift_ns / NS, has_velocity, without_values)


def _joint_states(path: Path, mapping: Path, table: JointTable) -> Iterator[tuple[int, JointState | None]]:
    """Yield the line number of each row, and its joint state unless all its cells are empty; blank rows are skipped.

    A program that writes several topics to a table leaves the cells of the others empty. A row of units may be below
    the header. Raises BagError for a row with fewer cells than the first one has up to its last name: which ones it
    lacks is unknown.
    """
    names, number, midnights = tuple(table.joints), Numbers(table.delimiter), Midnights()
    stated_times = table.time if isinstance(table.time, tuple) else (table.time,)
    stated = {
        *stated_times,
        *(column for joint in table.joints.values() for column in (joint.position, joint.velocity)),
    }
    rows = named_rows(path, table.delimiter, {column for column in stated if isinstance(column, str)})
    header = next(rows, (0, []))[1] if table.header else []
    columns = max((number for number, name in enumerate(header, start=1) if name), default=0)
    index = partial(_index, mapping, header)
    times = [index(column, "time") for column in stated_times if column is not None]
    positions = [index(joint.position, f"joints.{name}.position") for name, joint in table.joints.items()]
    velocities = [
        index(joint.velocity, f"joints.{name}.velocity")
        for name, joint in table.joints.items()
        if joint.velocity is not None
    ]
    scales = np.array([SCALES[joint.unit] for joint in table.joints.values()])
    units: dict[int, str] = {column: table.time_unit for column in times if len(times) == 1}
    for numbers in (positions, velocities):
        units |= {column: joint.unit for column, joint in zip(numbers, table.joints.values(), strict=False)}
    rows, ns_per_unit = _below_units(path, header, rows, units, table.delimiter), NS_PER_UNIT[table.time_unit]
    if len(times) > 1:
        rows, ns_per_unit = with_nanoseconds(rows, times[0], times[1], path, ", ".join(map(str, stated_times))), 1
    for count, (line, row) in enumerate(rows):
        columns = columns or len(row)
        if len(row) < columns:
            problem = f"has {len(row)} fields, the first row {columns}: must be as many"
            raise BagError(f"{path}: line {line}: {problem}")
        if not any("".join(row[i : i + 1]) for i in (*positions, *velocities)):
            yield line, None
            continue
        try:
            if table.rate is None:
                text = row[times[0]]
                stamp_ns = midnights.continued(text, time_ns(text, ns_per_unit, number))
            else:
                stamp_ns = round(count / table.rate * NS)
            position, velocity = (np.array([number(row[i]) for i in numbers]) for numbers in (positions, velocities))
        except OverflowError:
            problem = f"time: must be within {MAX_SEC} s of 1970; time_unit of the mapping states s, ms, us or ns"
            raise BagError(f"{path}: line {line}: {problem}") from None
        except (ValueError, IndexError):
            problem = f"must have numbers in columns {sorted({*times, *positions, *velocities})}"
            raise BagError(f"{path}: line {line}: {problem} (from 0)") from None
        yield line, JointState(stamp_ns, names, position * scales, velocity * scales[: len(velocity)])


def _below_units(path: Path, header: list[str], rows: Rows, units: Mapping[int, str], delimiter: str) -> Rows:
    """Yield the rows that are not blank, without one of units below the header.

    Raises BagError if it states another unit of a column than the mapping, whose `units` are by column.
    """
    filled = ((line, row) for line, row in rows if any(row))
    first = next(filled, None)
    if first is None:
        return
    line, row = first
    if not header or has_number(row, delimiter):
        yield first
    else:
        for column, unit in units.items():
            cell = spelled_unit("".join(row[column : column + 1])).partition("/")[0].strip()
            if cell and SPELLINGS.get(cell.lower(), cell) not in {unit, "µs" if unit == "us" else unit}:
                problem = f"{header[column]} = {row[column]}: must be a number, or {unit}, as in the mapping"
                raise BagError(f"{path}: line {line}: {problem}")
    yield from filled


def _index(mapping: Path, header: list[str], column: Column, key: str) -> int:
    """Return the number of a column."""
    if isinstance(column, int) and column < 0:
        raise SettingsError(f"{mapping}: {key} = {column}: must be a name, or a number from 0")
    if isinstance(column, str) and header.count(column) != 1:
        rule = f"must be one of {', '.join(header)}" if header else "must be a number without header"
        remedy = "; without times, state --rate HZ" if key == "time" else ""
        raise SettingsError(f"{mapping}: {key} = {column}: {rule}{remedy}")
    return header.index(column) if isinstance(column, str) else column

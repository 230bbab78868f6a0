# SPDX-License-Identifier: Apache-2.0
"""Write assessments: Parquet or CSV with a row per contact point and joint state, or a bag of ContactStates."""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import Any, BinaryIO, Protocol

import pyarrow as pa
from pyarrow import csv, parquet

from scara_effmass import __version__
from scara_effmass.analysis.output import atomic_file
from scara_effmass.bags.writer import BagWriter
from scara_effmass.errors import OutputError
from scara_effmass.iso15066 import EDITION, TABLE_HASH
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import ContactAssessment, RunInfo
from scara_effmass.wire import topics
from scara_effmass.wire.contact_state import ContactStateEncoder
from scara_effmass.wire.message_types import CONTACT_STATE, RUN_INFO
from scara_effmass.wire.run_info import run_info_message

ROW_GROUP_SIZE = 16_384
"""Rows of a Parquet row group, which are held in memory."""
SUFFIXES = (".parquet", ".csv", ".mcap")

_UNITS = {
    "speed": "speed_m_s",
    "effective_mass": "effective_mass_kg",
    "lumped_mass": "lumped_mass_kg",
    "full_mass": "full_mass_kg",
    "iso_mass": "iso_mass_kg",
    "worst_direction_mass": "worst_direction_mass_kg",
    "obstacle_mass": "obstacle_mass_kg",
    "reduced_mass": "reduced_mass_kg",
    "stiffness": "stiffness_n_m",
    "predicted_force": "predicted_force_n",
    "allowable_speed": "allowable_speed_m_s",
    "margin": "margin_m_s",
    "input_age": "input_age_s",
    "smallest_singular_value": "smallest_singular_value",
    "worst_normal_reduced_mass": "worst_normal_reduced_mass_kg",
    "force_bound": "force_bound_n",
    "clamping_force": "clamping_force_n",
    "test_effective_mass": "test_effective_mass_kg",
    "velocity_delay": "velocity_delay_s",
}
_LABELS = (
    *("contact_point", "body_region", "criterion", "verdict", "reason"),
    *("contact_normal", "mass_model", "mass_model_reason"),
)
_MOBILITIES = {
    model: [f"{model}_{entry}_1_kg" for entry in ("xx", "xy", "xz", "yy", "yz", "zz")]
    for model in ("lumped_mobility", "full_mobility")
}
_VECTORS = ("direction", "test_direction")
_FLAGS = ("worst_direction_used", "mass_capped", "watchdog")

SCHEMA = pa.schema(
    [("bag", pa.string()), ("log_time_ns", pa.int64()), ("stamp_ns", pa.int64())]
    + [(name, pa.string()) for name in _LABELS]
    + [(f"{name}_{axis}", pa.float64()) for name in _VECTORS for axis in "xyz"]
    + [(name, pa.float64()) for name in (*_UNITS.values(), *chain(*_MOBILITIES.values()))]
    + [(name, pa.bool_()) for name in _FLAGS]
)
"""Columns of a table: recording, log time, and the fields of ContactState with their units."""


class AssessmentWriter(Protocol):
    """Writes assessments."""

    def add(self, bag: str, log_time_ns: int, contacts: Sequence[ContactAssessment]) -> None:
        """Write the contact points of one joint state."""


def provenance(settings: MonitorSettings, robot: str, bags: Sequence[Path]) -> dict[str, str]:
    """Return the origin of a file: version, settings, robot, recordings, and edition of the standard."""
    return {
        "scara_effmass_version": __version__,
        "settings": settings.model_dump_json(),
        "robot": robot,
        "bags": json.dumps([str(bag) for bag in bags]),
        "limits_edition": EDITION,
        "limits_hash": TABLE_HASH,
    }


@contextmanager
def open_writer(path: Path, origin: Mapping[str, str], frame: str, *, overwrite: bool) -> Iterator[AssessmentWriter]:
    """Give the writer for the suffix of `path`, to be used in a `with`; directions are in `frame`.

    Raises OutputError for another suffix, and where the file exists or cannot be written.
    """
    if path.suffix not in SUFFIXES:
        raise OutputError(f"{path}: suffix {path.suffix or 'missing'!r}: must be one of {', '.join(SUFFIXES)}")
    if path.suffix == ".mcap":
        with BagWriter(path, overwrite=overwrite) as bag:
            yield _BagWriter(bag, origin, frame)
        return
    with (
        atomic_file(path, overwrite=overwrite) as unfinished,
        unfinished.open("wb") as file,
        open_table(file, path.suffix, SCHEMA, origin) as table,
    ):
        rows = _TableWriter(table)
        yield rows
        rows.flush()


def open_table(
    file: BinaryIO, suffix: str, schema: pa.Schema, origin: Mapping[str, str]
) -> parquet.ParquetWriter | csv.CSVWriter:
    """Return a writer into `file`, ".parquet" or ".csv" by `suffix`, to be used in a `with`.

    Parquet carries `origin` as metadata of its schema, CSV in lines that begin with #, above its header.
    """
    if suffix == ".parquet":
        return parquet.ParquetWriter(file, schema.with_metadata(dict(origin)), compression="zstd")
    file.writelines(f"# {name}: {value}\n".encode() for name, value in origin.items())
    return csv.CSVWriter(file, schema)


class _TableWriter:
    def __init__(self, writer: parquet.ParquetWriter | csv.CSVWriter) -> None:
        self._writer = writer
        self._rows: list[tuple[str, int, ContactAssessment]] = []

    def add(self, bag: str, log_time_ns: int, contacts: Sequence[ContactAssessment]) -> None:
        self._rows += [(bag, log_time_ns, contact) for contact in contacts]
        if len(self._rows) >= ROW_GROUP_SIZE:
            self.flush()

    def flush(self) -> None:
        """Write the buffered rows."""
        if self._rows:
            self._writer.write_table(pa.table(_columns(self._rows), SCHEMA))
            self._rows.clear()


def _columns(rows: list[tuple[str, int, ContactAssessment]]) -> dict[str, Sequence[Any]]:
    bags, times, contacts = zip(*rows, strict=True)
    fields = dict(zip(contacts[0]._fields, zip(*contacts, strict=True), strict=True))
    columns: dict[str, Sequence[Any]] = {"bag": bags, "log_time_ns": times, "stamp_ns": fields["stamp_ns"]}
    columns |= {name: fields[name] for name in (*_LABELS, *_FLAGS)}
    columns["verdict"] = [verdict.name for verdict in fields["verdict"]]
    for name in _VECTORS:
        for axis, values in zip("xyz", zip(*fields[name], strict=True), strict=True):
            columns[f"{name}_{axis}"] = values
    for field, names in _MOBILITIES.items():
        columns |= dict(zip(names, zip(*fields[field], strict=True), strict=True))
    return columns | {name: fields[field] for field, name in _UNITS.items()}


class _BagWriter:
    def __init__(self, writer: BagWriter, origin: Mapping[str, str], frame: str) -> None:
        self._writer = writer
        self._frame = frame
        self._note = json.dumps(dict(origin))
        self._topics: dict[str, str] = {}
        self._encoders: dict[str, ContactStateEncoder] = {}
        self._single = len(json.loads(origin["bags"])) == 1

    def add(self, bag: str, log_time_ns: int, contacts: Sequence[ContactAssessment]) -> None:
        if not self._topics:
            info = RunInfo(stamp_ns=log_time_ns, note=self._note)
            self._writer.write(f"/{topics.RUN_INFO}", RUN_INFO, log_time_ns, run_info_message(info))
        if bag not in self._topics:
            # One topic per recording: their times may overlap.
            name = re.sub(r"\W", "_", Path(bag).stem)
            self._topics[bag] = "/contact_state" if self._single else f"/bag_{len(self._topics)}_{name}/contact_state"
        for contact in contacts:
            name = contact.contact_point
            encoder = self._encoders.setdefault(name, ContactStateEncoder(name, self._frame))
            self._writer.write(self._topics[bag], CONTACT_STATE, log_time_ns, encoder.encode(contact))

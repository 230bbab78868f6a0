# SPDX-License-Identifier: Apache-2.0
"""Write assessments: Parquet or CSV with a row per contact point and joint state, or a bag of ContactStates."""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, BinaryIO, Protocol, get_args, get_origin, get_type_hints

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import csv, parquet

from scara_effmass import __version__
from scara_effmass.analysis.assessment import ROWS, AssessedStates
from scara_effmass.analysis.output import atomic_file
from scara_effmass.bags.files import open_bag
from scara_effmass.bags.writer import BagWriter
from scara_effmass.errors import OutputError
from scara_effmass.iso15066 import EDITION, TABLE_HASH
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import ContactAssessment, Mobility6, RunInfo, Vector3, Verdict
from scara_effmass.wire import topics
from scara_effmass.wire.contact_states import ContactStatesEncoder
from scara_effmass.wire.message_types import CONTACT_STATES, RUN_INFO
from scara_effmass.wire.run_info import run_info_message

SUFFIXES = (".parquet", ".csv", ".mcap")
MARKS = {".parquet": b"PAR1", ".csv": b"# scara_effmass_version: "}
"""What a table holds near its beginning."""

_INDICES = {Vector3: ("x", "y", "z"), Mobility6: ("xx", "xy", "xz", "yy", "yz", "zz")}


def _entries(kind: Any) -> tuple[object, list[str]]:  # noqa: ANN401 - a type, annotated with a unit or not
    """Return the type of a field of `ContactAssessment`, and what its columns have after the name."""
    plain, *unit = get_args(kind) if get_origin(kind) is Annotated else (kind,)
    indices = _INDICES.get(plain)
    return plain, ["_".join(("", *parts, *unit)) for parts in ([[index] for index in indices] if indices else [[]])]


_KINDS = {name: _entries(kind) for name, kind in get_type_hints(ContactAssessment, include_extras=True).items()}
_NUMBERS = {
    name: [f"{name}{end}" for end in ends]
    for name, (kind, ends) in _KINDS.items()
    if kind in {float, Vector3, Mobility6}
}
"""Columns of each field that is a number, a vector or a mobility."""
_FLAGS = tuple(name for name, (kind, _) in _KINDS.items() if kind is bool)
_LABELS = ("verdict", *(name for name, (kind, _) in _KINDS.items() if kind is str), "contact_normal")
_TIMES = {"input_age_s": "age", "velocity_delay_s": "delay"}
"""Fields of a State by their columns."""

SCHEMA = pa.schema(
    [("bag", pa.string()), ("log_time_ns", pa.int64()), ("stamp_ns", pa.int64())]
    + [(name, pa.string()) for name in _LABELS]
    + [(name, pa.float64()) for name in (*chain(*_NUMBERS.values()), *_TIMES)]
    + [(name, pa.bool_()) for name in (*_FLAGS, "watchdog")]
)
"""Columns of a table: recording, log time, and the fields of `Decision` and `ContactAssessment` with their units."""
_TEXT = pa.dictionary(pa.int32(), pa.string())
_ENCODED = pa.schema(
    pa.field(field.name, _TEXT if field.type == pa.string() else field.type, nullable=False) for field in SCHEMA
)
"""SCHEMA with an index for each text, and no nulls: marks of nulls cost a third of the time of writing."""


class AssessmentWriter(Protocol):
    """Writes assessments."""

    def add(self, bag: str, states: AssessedStates) -> None:
        """Write the contact points of each joint state of the recording `bag`."""

    def extend(self, bag: str, part: Path) -> None:
        """Write what the writer of `part`, a file, wrote of `bag`."""


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
        open_table(file, path.suffix, SCHEMA if path.suffix == ".csv" else _ENCODED, origin) as table,
    ):
        yield _TableWriter(table)


def open_table(
    file: BinaryIO, suffix: str, schema: pa.Schema, origin: Mapping[str, str]
) -> parquet.ParquetWriter | csv.CSVWriter:
    """Return a writer into `file`, ".parquet" or ".csv" by `suffix`, to be used in a `with`.

    Parquet carries `origin` as metadata of its schema, CSV in lines that begin with #, above its header.
    """
    if suffix == ".parquet":
        texts = [field.name for field in schema if not pa.types.is_primitive(field.type)]
        bounds = [field.name for field in schema if field.type != pa.float64()] + _NUMBERS["margin"]
        # Dictionaries of numbers cost three times as much as all else. Without Arrow's schema, texts are read as texts.
        writer = parquet.ParquetWriter(
            file,
            schema,
            compression="snappy",
            use_dictionary=texts,
            write_statistics=bounds,
            write_batch_size=ROWS,
            store_schema=False,
        )
        writer.add_key_value_metadata(dict(origin))
        return writer
    file.writelines(f"# {name}: {value}\n".encode() for name, value in origin.items())
    return csv.CSVWriter(file, schema)


class _TableWriter:
    def __init__(self, writer: parquet.ParquetWriter | csv.CSVWriter) -> None:
        self._writer = writer
        self._schema = SCHEMA if isinstance(writer, csv.CSVWriter) else _ENCODED

    def add(self, bag: str, states: AssessedStates) -> None:
        self._writer.write_table(pa.table(_columns(bag, states), _ENCODED).cast(self._schema))

    def extend(self, bag: str, part: Path) -> None:  # noqa: ARG002 - the rows state it
        with parquet.ParquetFile(part) as file:
            for batch in file.iter_batches():
                self._writer.write_table(pa.Table.from_batches([batch]).cast(self._schema))


def _columns(bag: str, states: AssessedStates) -> dict[str, pa.Array]:
    """Return the columns of SCHEMA, texts as dictionaries; the rows of one joint state follow each other."""
    assessments = states.assessments
    count, points = len(states), len(assessments.points)

    def repeated(values: NDArray[Any]) -> pa.Array:
        return pa.array(np.repeat(values, points))

    def labels(codes: NDArray[Any], texts: Sequence[str]) -> pa.Array:
        valid = [text.encode("utf-8", "backslashreplace").decode() for text in texts]  # names of files may be any bytes
        choices = pa.array(valid, pa.string()).dictionary_encode()  # no text twice
        return pa.DictionaryArray.from_arrays(choices.indices.to_numpy()[codes], choices.dictionary)

    records, columns = assessments.states, assessments.columns()
    reasons, starts = [assessments.reasons(point) for point in range(points)], [0]
    for _, texts in reasons:
        starts.append(starts[-1] + len(texts))
    indices = [start + own for start, (own, _) in zip(starts, reasons, strict=False)]
    table: dict[str, pa.Array] = {
        "bag": labels(np.zeros(count * points, np.int64), [bag]),
        "log_time_ns": repeated(states.log_time_ns),
        "stamp_ns": repeated(records["stamp_ns"]),
        **{column: repeated(records[name]) for column, name in _TIMES.items()},
        "watchdog": repeated(records["is_watchdog"] != 0),
        "contact_point": labels(np.tile(np.arange(points), count), assessments.points),
        "verdict": labels(columns["verdict"].astype(np.int64), Verdict._member_names_),
        "reason": labels(np.stack(indices, axis=1).reshape(-1), [text for _, texts in reasons for text in texts]),
        "contact_normal": labels(np.repeat(records["is_admitted"], points), ["", assessments.normal]),
    }
    for name, choices in assessments.labels.items():
        table[name] = labels(columns[name].astype(np.int64), choices)
    for name, names in _NUMBERS.items():
        table |= {entry: pa.array(values) for entry, values in zip(names, np.atleast_2d(columns[name]), strict=True)}
    table |= {name: pa.array(columns[name] != 0.0) for name in _FLAGS}
    return {name: table[name] for name in SCHEMA.names}


class _BagWriter:
    def __init__(self, writer: BagWriter, origin: Mapping[str, str], frame: str) -> None:
        self._writer = writer
        self._frame = frame
        self._note = json.dumps(dict(origin))
        self._topics: dict[str, str] = {}
        self._encoders: dict[str, ContactStatesEncoder] = {}
        self._single = len(json.loads(origin["bags"])) == 1

    def extend(self, bag: str, part: Path) -> None:
        with open_bag(part) as source:
            for message in source.messages(["/contact_states"]):
                self._begin(bag, message.log_time_ns)
                self._writer.write(self._topics[bag], CONTACT_STATES, message.log_time_ns, message.data)

    def _begin(self, bag: str, log_time_ns: int) -> None:
        if not self._topics:
            info = RunInfo(stamp_ns=log_time_ns, note=self._note)
            self._writer.write(f"/{topics.RUN_INFO}", RUN_INFO, log_time_ns, run_info_message(info))
        if bag not in self._topics:
            # One topic per recording: their times may overlap.
            name = re.sub(r"\W", "_", Path(bag).stem)
            self._topics[bag] = "/contact_states" if self._single else f"/bag_{len(self._topics)}_{name}/contact_states"
            self._encoders[bag] = ContactStatesEncoder(self._frame)

    def add(self, bag: str, states: AssessedStates) -> None:
        self._begin(bag, int(states.log_time_ns[0]))
        topic, encoder = self._topics[bag], self._encoders[bag]
        for row, log_time_ns in enumerate(states.log_time_ns.tolist()):
            self._writer.write(topic, CONTACT_STATES, log_time_ns, encoder.encode(states.assessments, row))

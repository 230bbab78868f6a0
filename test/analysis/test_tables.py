"""Columns of the tables."""

from __future__ import annotations

from scara_effmass.analysis.tables import SCHEMA
from scara_effmass.values import ContactAssessment


def test_every_field_of_an_assessment_has_a_column_and_every_quantity_its_unit() -> None:
    columns = set(SCHEMA.names) - {"bag", "log_time_ns"} - {f"direction_{axis}" for axis in "xyz"}
    left = set(columns)
    for field in set(ContactAssessment._fields) - {"direction"}:
        (column,) = (name for name in columns if name == field or name.removesuffix(f"_{unit_of(name)}") == field)
        left.discard(column)
    assert left == set()


def unit_of(column: str) -> str:
    units = [unit for unit in ("n_m", "m_s", "kg", "n", "s") if column.endswith(f"_{unit}")]
    return units[0] if units else ""

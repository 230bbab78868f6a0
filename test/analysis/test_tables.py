# SPDX-License-Identifier: Apache-2.0
"""Columns of the tables."""

import re

from scara_effmass.analysis.tables import SCHEMA
from scara_effmass.values import ContactAssessment

OF_STATE = {"stamp_ns", "input_age", "velocity_delay", "contact_normal", "watchdog"}


def test_every_field_has_a_column_and_every_column_a_field() -> None:
    vectors = {"direction", "test_direction"}
    columns = set(SCHEMA.names) - {"bag", "log_time_ns"} - {f"{name}_{axis}" for name in vectors for axis in "xyz"}
    axes = ("xx", "xy", "xz", "yy", "yz", "zz")
    entries = {f"{model}_mobility_{axis}_1_kg" for model in ("lumped", "full") for axis in axes}
    assert entries < columns
    columns -= entries
    fields = OF_STATE | set(ContactAssessment._fields) - {"reason_code"}
    names = {name if name in fields else re.sub("_(n_m|m_s|kg|n|j|s)$", "", name) for name in columns}
    assert len(names) == len(columns)
    assert names == fields - vectors - {"lumped_mobility", "full_mobility"}

# SPDX-License-Identifier: Apache-2.0
"""The compiled messages match `msg_schemas/msg` and the public contract."""

import importlib
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np
import pyarrow as pa
import pytest
from rclpy.node import Node
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from scara_effmass.analysis.tables import SCHEMA
from scara_effmass.codes import Assumption, Reason
from scara_effmass.kernel.records import CONTACT, REASON_SIZE
from scara_effmass.values import ContactAssessment, Mobility6, Vector3, Verdict
from test.nodes.conftest import ros_node

SCHEMAS = Path(__file__).parents[2] / "msg_schemas/msg"

CONTRACT = {
    "ContactState": (
        "position position_in_link "
        "direction speed effective_mass lumped_mass full_mass iso_mass worst_direction_mass body_mass reduced_mass "
        "stiffness predicted_force contact_energy allowable_speed margin smallest_singular_value "
        "worst_normal_reduced_mass force_bound clamping_force lumped_mobility full_mobility test_direction "
        "test_effective_mass worst_direction_used mass_capped verdict reason_code contact_point body_region criterion "
        "mass_model mass_model_reason reason"
    ),
    "ContactStates": (
        "header sequence_number watchdog verdict reason_code allowable_speed speed_scaling input_age velocity_delay "
        "contact_normal reason assumptions accepted_assumptions scope contacts"
    ),
    "ForceBlock": (
        "header first_sample sample_rate force lost_samples saturated saturated_samples clock_residual filter_delay "
        "source simulated tare tare_stamp relative_uncertainty"
    ),
    "Impact": (
        "header peak_force duration impulse onset_sample clipped incomplete rebound baseline noise clock_residual "
        "source simulated compression_impulse held_force load_force"
    ),
    "ImpactValidation": (
        "header predicted_force measured_force relative_error effective_mass reduced_mass speed stiffness conservative "
        "compression_impulse measured_reduced_mass measured_effective_mass measured_stiffness clock_offset body_region "
        "region_force limit_force exceeds_limit series held_force held_limit held_region"
    ),
    "NodeReadiness": "header node active use_sim_time peers",
    "PayloadEstimate": (
        "header mass mass_lower mass_upper stated_mass moment moment_deviation is_observable text joint_names "
        "coulomb_friction viscous_friction effort_error"
    ),
    "RunInfo": (
        "header configuration obstacle_mass impact_position plate_normal guide_direction simulated note "
        "contact_stiffness contact_exponent true_onset true_speed true_effective_mass true_peak_force true_duration "
        "true_impulse"
    ),
    "SeriesStatistics": (
        "count correlation fitted_stiffness bias rmse non_conservative gain gain_interval mass_scale "
        "mass_scale_interval detectable_mass_error exponent exponent_interval clock_offset exceedances accepted "
        "decidable reason"
    ),
}

KINDS = {
    "geometry_msgs/Vector3": Vector3,
    "double": float,
    "double[6]": Mobility6,
    "boolean": bool,
    "string": str,
    "uint8": Verdict,
    "uint16": Reason,
}
"""Types of the fields of `ContactAssessment` by those of its message."""
COLUMNS = {float: pa.float64(), Vector3: pa.float64(), Mobility6: pa.float64(), bool: pa.bool_()}
"""Types of the columns by those of the fields; texts otherwise."""
COLUMN_END = re.compile("(_[xyz]{1,2})?(_(n_m|m_s|1_kg|kg|n|j|s|m))?$")
"""Entry and unit in the name of a column."""


def message(name: str) -> Any:  # noqa: ANN401, generated classes have no types
    return getattr(importlib.import_module("scara_effmass_msgs.msg"), name)


@pytest.mark.parametrize("name", CONTRACT)
def test_fields_match_the_contract(name: str) -> None:
    assert list(message(name).get_fields_and_field_types()) == CONTRACT[name].split()


def test_an_assessment_has_the_fields_of_its_message_in_order() -> None:
    fields = message("ContactState").get_fields_and_field_types()
    kinds = get_type_hints(ContactAssessment)
    assert list(kinds) == list(fields)
    assert kinds == {name: KINDS[kind] for name, kind in fields.items()}


def test_record_of_the_kernel_has_the_fields_of_an_assessment() -> None:
    kinds = get_type_hints(ContactAssessment)
    sizes = {name: len(get_args(kind)) or 1 for name, kind in kinds.items()} | {"reason": REASON_SIZE}
    # The contact point is the index in an array, the code is the first number of the reason.
    records = {name: size for name, size in sizes.items() if name not in {"contact_point", "reason_code"}}
    assert {name: CONTACT[name].itemsize // 8 for name in CONTACT.names or ()} == records
    assert {CONTACT[name].base for name in CONTACT.names or ()} == {np.dtype("f8")}


def test_columns_of_a_table_are_the_fields_of_an_assessment() -> None:
    of_state = {"bag", "log_time_ns", "stamp_ns", "input_age_s", "velocity_delay_s", "watchdog", "contact_normal"}
    expected = []
    for name, kind in get_type_hints(ContactAssessment).items():
        if name != "reason_code":
            expected += [(name, COLUMNS.get(kind, pa.string()))] * (len(get_args(kind)) or 1)
    columns = [(COLUMN_END.sub("", field.name), field.type) for field in SCHEMA if field.name not in of_state]
    assert sorted(columns, key=str) == sorted(expected, key=str)


def test_constants_of_the_message_are_the_verdicts() -> None:
    assert {name: getattr(message("ContactState"), name) for name in Verdict.__members__} == dict(Verdict.__members__)


def test_constants_of_contact_states_are_the_assumptions() -> None:
    members = Assumption.__members__
    assert {name: getattr(message("ContactStates"), name) for name in members} == dict(members)


def test_contract_names_every_message() -> None:
    assert {path.stem for path in SCHEMAS.glob("*.msg")} == set(CONTRACT)


@pytest.fixture
def node(own_domain: int) -> Iterator[Node]:  # noqa: ARG001 - isolates the node
    with ros_node("type_hashes") as node:
        yield node


@pytest.mark.parametrize("name", CONTRACT)
def test_schema_hash_equals_the_announced_hash(node: Node, name: str) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    for path in SCHEMAS.glob("*.msg"):
        store.register(get_types_from_msg(path.read_text(encoding="utf-8"), f"scara_effmass_msgs/msg/{path.stem}"))
    publisher = node.create_publisher(message(name), name, 1)
    (endpoint,) = node.get_publishers_info_by_topic(publisher.topic_name)
    announced = endpoint.topic_type_hash
    assert store.hash_rihs01(f"scara_effmass_msgs/msg/{name}") == str(announced)

# SPDX-License-Identifier: Apache-2.0
"""The compiled messages match `msg_schemas/msg` and the public contract."""

import importlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from rclpy.node import Node
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from scara_effmass.values import ContactAssessment
from test.nodes.conftest import ros_node

SCHEMAS = Path(__file__).parents[2] / "msg_schemas/msg"

CONTRACT = {
    "ContactState": (
        "direction speed effective_mass lumped_mass full_mass iso_mass worst_direction_mass body_mass reduced_mass "
        "stiffness predicted_force allowable_speed margin smallest_singular_value worst_normal_reduced_mass "
        "force_bound clamping_force lumped_mobility full_mobility test_direction test_effective_mass "
        "worst_direction_used mass_capped verdict contact_point body_region criterion mass_model mass_model_reason "
        "reason"
    ),
    "ContactStates": (
        "header sequence_number watchdog verdict allowable_speed speed_scaling input_age velocity_delay "
        "contact_normal reason contacts"
    ),
    "ForceBlock": (
        "header first_sample sample_rate force lost_samples saturated saturated_samples clock_residual filter_delay "
        "source simulated tare tare_stamp relative_uncertainty"
    ),
    "Impact": (
        "header peak_force duration impulse onset_sample clipped incomplete rebound baseline noise clock_residual "
        "source simulated compression_impulse"
    ),
    "ImpactValidation": (
        "header predicted_force measured_force relative_error effective_mass reduced_mass speed stiffness conservative "
        "compression_impulse measured_reduced_mass measured_effective_mass measured_stiffness clock_offset body_region "
        "region_force limit_force exceeds_limit series"
    ),
    "NodeReadiness": "header node active use_sim_time peers",
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


def message(name: str) -> Any:  # noqa: ANN401, generated classes have no types
    return getattr(importlib.import_module("scara_effmass_msgs.msg"), name)


@pytest.mark.parametrize("name", CONTRACT)
def test_fields_match_the_contract(name: str) -> None:
    assert list(message(name).get_fields_and_field_types()) == CONTRACT[name].split()


def test_assessment_of_a_contact_has_the_fields_of_its_message_in_order() -> None:
    assert list(ContactAssessment._fields) == CONTRACT["ContactState"].split()


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

# SPDX-License-Identifier: Apache-2.0
"""A setting that has no effect with the others is named with what it needs; defaults and shipped files have none."""

from typing import Any

import pytest

from scara_effmass.settings import DaqSettings, MonitorSettings, ValidatorSettings, checked, load_settings
from scara_effmass.settings.loading import FrozenSettings
from scara_effmass.share import share

KINDS: dict[str, type[FrozenSettings]] = {
    "monitor": MonitorSettings,
    "validator": ValidatorSettings,
    "daq": DaqSettings,
}
DIRECTION = [1.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("node", "name", "value", "cure"),
    [
        ("monitor", "contact_links", ["link1"], {"contact_points": ["whole_arm"]}),
        ("monitor", "payload_com", [0.0, 0.0, 0.1], {"payload_mass": 1.0}),
        ("monitor", "link_uncertainty", 0.1, {"effort_uncertainty": 0.03}),
        ("monitor", "person_direction", DIRECTION, {"person_speed": 1.6}),
        ("monitor", "person_direction_frame", "link1", {"person_direction": DIRECTION, "person_speed": 1.6}),
        ("monitor", "contact_normal_frame", "link1", {"contact_normal": "0 0 1"}),
        ("monitor", "test_direction_frame", "link1", {"test_direction": DIRECTION}),
        ("monitor", "servo.bandwidth", 2.0, {"drives": "servo"}),
        ("monitor", "servo.damping", 0.5, {"drives": "servo"}),
        ("monitor", "servo.computed_torque", True, {"drives": "servo"}),
        ("monitor", "servo.stopping_time", 1.0, {"drives": "immovable", "contact": "quasi_static"}),
        ("monitor", "external_force_limit", 100.0, {"contact": "quasi_static"}),
        ("validator", "obstacle_mass", 3.0, {"obstacle_fixed": False}),
        ("daq", "filter.cutoff", 100.0, {"filter.kind": "causal"}),
        ("daq", "bag.path", "run1", {"source": "bag"}),
        ("daq", "bag.topic", "force", {"source": "bag"}),
    ],
)
def test_setting_without_effect_is_named_until_it_has_one(
    node: str, name: str, value: object, cure: dict[str, Any]
) -> None:
    idle: dict[str, dict[str, Any]] = {
        "monitor": {"drives": "free", "contact_points": ["tool"], "effort_uncertainty": 0.0},
        "validator": {"obstacle_fixed": True},
        "daq": {},
    }
    (line,) = checked(KINDS[node], {**idle[node], name: value}, node).without_effect()
    assert line.startswith(f"{name} = ")
    assert "has no effect without" in line
    assert checked(KINDS[node], {**idle[node], **cure, name: value}, node).without_effect() == []


def test_force_of_a_safety_function_has_no_effect_on_an_impact() -> None:
    """It stops a contact that lasts, also one with a servo."""
    settings = checked(MonitorSettings, {"drives": "servo", "external_force_limit": 100.0}, "monitor")
    assert settings.without_effect() == ["external_force_limit = 100.0 has no effect without contact = quasi_static"]


@pytest.mark.parametrize("node", ["monitor", "daq"])
def test_shipped_files_have_no_setting_without_effect(node: str) -> None:
    path = share("config", f"{node}.yaml")
    assert load_settings(KINDS[node], path, node).without_effect() == []

# SPDX-License-Identifier: Apache-2.0
"""Run information in the JSON of older recordings."""

import json
import math

import pytest

from scara_effmass.errors import SettingsError
from scara_effmass.impacts.impact_matcher import check_run_info
from scara_effmass.values import RunInfo
from scara_effmass.wire.run_info import run_info_from_json


def test_json_of_the_campaign_is_read() -> None:
    fields = {
        "generated": True,
        "description": "impact on a cart",
        "configuration": "300_0",
        "obstacle_mass": 2,
        "point": [0.3, 0.0],
        "direction": [1.0, 0.0, 0.0],
        "stiffness": 2e6,
        "exponent": 1.0,
        "since_ns": 5,
        "truth": {
            "onset_ns": 7,
            "speed": 0.25,
            "effective_mass": 1.0,
            "peak_force": 200.0,
            "duration": 2e-3,
            "impulse": 0.4,
            "contacts": 2,
        },
    }
    assert run_info_from_json(json.dumps(fields)) == RunInfo(
        stamp_ns=5,
        configuration="300_0",
        obstacle_mass=2.0,
        impact_position=(0.3, 0.0, 0.0),
        plate_normal=(1.0, 0.0, 0.0),
        simulated=True,
        note="impact on a cart",
        contact_stiffness=2e6,
        contact_exponent=1.0,
        true_onset_ns=7,
        true_speed=0.25,
        true_effective_mass=1.0,
        true_peak_force=200.0,
        true_duration=2e-3,
        true_impulse=0.4,
    )


@pytest.mark.parametrize("fields", [{}, {"obstacle_mass": None, "configuration": None, "since_ns": None}])
def test_json_without_values_states_nothing(fields: dict[str, None]) -> None:
    assert run_info_from_json(json.dumps(fields)) == RunInfo()


@pytest.mark.parametrize(
    "fields",
    [
        {"truth": 1, "stiffness": "2000", "exponent": True},
        {"truth": {"speed": -1.0, "effective_mass": math.nan, "peak_force": "big", "duration": None}},
        {"point": [0.3, 0.0]},
    ],
)
def test_json_with_unusable_ground_truth_is_unknown(fields: dict[str, object]) -> None:
    assert run_info_from_json(json.dumps(fields)) == RunInfo()


def test_json_point_that_is_none_is_not_a_number() -> None:
    info = run_info_from_json('{"point": "somewhere", "direction": [1.0, 0.0, 0.0]}')
    assert info is not None
    assert math.isnan(info.impact_position[0])
    assert info.plate_normal == (1.0, 0.0, 0.0)


@pytest.mark.parametrize("text", ["", "no JSON", "[1]", "2.39", "[" * 100_000, '{"a": ' * 100_000])
def test_text_without_json_object_gives_none(text: str) -> None:
    assert run_info_from_json(text) is None


@pytest.mark.parametrize(
    ("key", "value"),
    [
        *(("obstacle_mass", value) for value in ("NaN", "Infinity", "-1", "1001", "true", '"2.39"', "[2.39]")),
        *(("stamp", value) for value in ("1e999", "NaN", "1.5", "true", '"now"', "9" * 30)),
        *(("configuration", value) for value in (r'"\ud800"', r'"a\nb"')),
    ],
)
def test_json_values_that_cannot_be_used_are_refused(key: str, value: str) -> None:
    info = run_info_from_json(f'{{"{key if key != "stamp" else "since_ns"}": {value}}}')
    assert info is not None
    with pytest.raises(SettingsError, match=f"^{key}.*: must be "):
        check_run_info(info)

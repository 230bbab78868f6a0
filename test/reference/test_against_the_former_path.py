# SPDX-License-Identifier: Apache-2.0
"""The reference gives the numbers, codes and texts of the former assessment, for every robot and setting."""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scara_effmass.iso15066 import limits_for
from scara_effmass.iso15066.speed_limit import SpeedLimits
from scara_effmass.kernel.records import ROW
from scara_effmass.model.load import load_robot
from scara_effmass.reference import ContactResult, RobotDynamics, assess
from scara_effmass.safety.contact_assessor import ContactAssessor
from scara_effmass.safety.reasons import CRITERIA, MODELS, Reasons
from scara_effmass.settings import ContactType, Drives, MonitorSettings
from scara_effmass.values import ContactAssessment

REPOSITORY = Path(__file__).resolve().parents[2]
LUMPING = {"policy": "project_com", "free_parameters": "fit_inertia"}
ROBOTS = [REPOSITORY / "config" / "omron_i4_550l.yaml", *sorted(REPOSITORY.glob("*/robots/*.urdf"))]
EXACT, CANCELLED, SINGULAR = 1e-9, 1e-5, 1e-6
ROUNDED = {"kinova": 1e-6, "ur10_robot": 1e-8}
"""Lumped models of tiny inertia (2.5e-7 kg m2), which the former path's inverse rounds."""
MODEL_CHOICES = ["auto", "lumped", "full", "iso", "largest"]
CONTACTS: dict[str, list[Any]] = {
    "effective_mass_model": MODEL_CHOICES,
    "contact_normal": ["worst", "velocity", "1 -2 0.5"],
    "drives": ["free", "servo", "immovable"],
    "contact": ["transient", "quasi_static"],
}
OTHERS: dict[str, list[Any]] = {
    "servo": [{"computed_torque": False}, {"computed_torque": True}],
    "external_force_limit": [0.0, 100.0],
    "mass_uncertainty": [0.0, 0.1, 1.0],
    "speed_uncertainty": [0.0, 0.05],
    "model_margin": [0.0, 0.1, 0.6, 1.0],
    "person_speed": [0.0, 0.2, 1.6],
    "stiffness_uncertainty": [0.0, 0.2],
    "body_regions": [(), ("chest",), ("hand_fingers", "back_shoulders")],
    "test_direction": [(0.0, 0.0, 0.0), (1.0, 0.0, 2.0)],
    "payload_mass": [0.0, 1.5],
    "mass_cap": [100.0, 1000.0],
}


def number(contact: Any, name: str) -> Any:  # noqa: ANN401 - any field
    return getattr(contact, "body_mass" if name == "obstacle_mass" else name)


def row_of(result: ContactResult) -> list[float]:
    row = np.zeros(1, ROW)
    for name in ROW.names or ():
        row[name] = number(result, name)
    return row.view(np.float64).tolist()


def difference(result: ContactResult, expected: ContactAssessment, reasons: Reasons, tolerance: float) -> str:
    """Return the first field in which `result` differs from `expected`; empty if none."""
    if expected.smallest_singular_value < SINGULAR:
        tolerance = max(tolerance, SINGULAR)
    for name in ROW.names or ():
        if isinstance(value := getattr(expected, name, ""), str):
            continue
        if not np.allclose(number(result, name), value, tolerance, tolerance, equal_nan=True):
            return f"{name}: {number(result, name)}, {value}"
    texts = {
        "body_region": reasons.regions[result.body_region],
        "criterion": CRITERIA[result.criterion],
        "mass_model": MODELS[result.mass_model],
        "mass_model_reason": reasons.whys[result.mass_model_reason],
        "reason": reasons.of_row(row_of(result)),
    }
    pairs = [(name, text, getattr(expected, name)) for name, text in texts.items()]
    return next((f"{name}: {text}, {wanted}" for name, text, wanted in pairs if text != wanted), "")


def differences(robot: Path, values: dict[str, Any], seed: int, count: int) -> list[str]:
    chosen = MonitorSettings.model_validate({"lumping": LUMPING, **values})
    loaded = load_robot(robot, chosen)
    dynamics, limits = RobotDynamics(loaded), limits_for(chosen)
    former = ContactAssessor(dynamics, chosen)
    reasons = Reasons(dynamics, chosen, SpeedLimits(limits, chosen))
    cancels = chosen.drives is Drives.SERVO or chosen.contact is ContactType.QUASI_STATIC
    rng = np.random.default_rng(seed)
    lower = np.maximum(loaded.model.lowerPositionLimit, -math.pi)
    upper = np.minimum(loaded.model.upperPositionLimit, math.pi)
    q = rng.uniform(lower, upper, (count, loaded.model.nv))
    q[::4] = np.clip(rng.choice([0.0, math.pi / 2.0, -math.pi / 2.0], q.shape), lower, upper)[::4]
    qd = rng.uniform(-1.0, 1.0, q.shape) * 10.0 ** rng.uniform(-4.0, 1.0, (count, 1))
    qd[::6] = 0.0
    found = []
    tolerance = CANCELLED if cancels else ROUNDED.get(robot.stem, EXACT)
    for state in zip(q, qd, rng.uniform(0.0, 0.01, q.shape).tolist(), strict=True):
        for result, expected in zip(assess(dynamics, chosen, limits, *state), former.assess(*state), strict=True):
            found.append(difference(result, expected, reasons, tolerance))
    return [text for text in found if text]


@pytest.mark.parametrize("robot", ROBOTS, ids=lambda path: path.stem)
def test_every_robot(robot: Path) -> None:
    for seed, contact in enumerate(({}, {"contact": "quasi_static", "drives": "servo"}, {"contact_normal": "0 0 1"})):
        assert differences(robot, contact, seed, 24) == []


@pytest.mark.parametrize("contact", [*itertools.product(*CONTACTS.values())], ids="-".join)
@pytest.mark.parametrize("robot", [ROBOTS[0], ROBOTS[3]], ids=lambda path: path.stem)
def test_every_kind_of_contact(robot: Path, contact: tuple[Any, ...]) -> None:
    assert differences(robot, dict(zip(CONTACTS, contact, strict=True)), 11, 16) == []


@settings(max_examples=40)
@given(
    robot=st.sampled_from(ROBOTS),
    values=st.fixed_dictionaries({name: st.sampled_from(choices) for name, choices in (CONTACTS | OTHERS).items()}),
    seed=st.integers(0, 2**32 - 1),
)
def test_every_setting(robot: Path, values: dict[str, Any], seed: int) -> None:
    assert differences(robot, values, seed, 12) == []

# SPDX-License-Identifier: Apache-2.0
"""The compiled kernel gives the verdict, texts and numbers of the reference, for every robot and setting."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scara_effmass.iso15066.speed_limit import SpeedLimits
from scara_effmass.kernel.contact_columns import NUMBERS, ContactColumns
from scara_effmass.safety.contact_assessor import ContactAssessor

from scara_effmass.iso15066 import limits_for
from scara_effmass.kernel import jit
from scara_effmass.kernel.contact_kernel import ContactKernel
from scara_effmass.kernel.records import MAX_JOINTS, OFFSETS
from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.settings import ContactType, Drives, MonitorSettings
from scara_effmass.values import FloatArray

REPOSITORY = Path(__file__).resolve().parents[2]
LUMPING = {"policy": "project_com", "free_parameters": "fit_inertia"}
ROBOTS = [REPOSITORY / "config" / "omron_i4_550l.yaml", *sorted(REPOSITORY.glob("*/robots/*.urdf"))]
STATES = 48
TOLERANCE = 1e-10
SINGULAR = 1e-6
"""Smallest singular value below which a pose counts as singular, and the tolerance there: leading digits cancel."""
ROUNDED = {"kinova": 1e-6, "ur10_robot": 1e-8}
"""Tolerance of lumped models of tiny inertia (2.5e-7 kg m2), which Pinocchio's inverse rounds; see the test of CRBA."""
CANCELLED = 1e-5
"""Tolerance with a servo or a clamped body part, whose bounds without obstacle mass invert nearly singular matrices."""

MODELS = st.sampled_from(["auto", "lumped", "full", "iso", "largest"])
CONTACTS = st.fixed_dictionaries(
    {
        "contact": st.sampled_from(["transient", "quasi_static"]),
        "contact_normal": st.sampled_from(["worst", "velocity", "0 0 1", "1 -2 0.5"]),
        "drives": st.sampled_from(["free", "servo", "immovable"]),
        "external_force_limit": st.sampled_from([0.0, 100.0]),
        "effective_mass_model": MODELS,
    }
)
OTHERS = st.fixed_dictionaries(
    {
        "servo": st.fixed_dictionaries({"computed_torque": st.booleans()}),
        "mass_uncertainty": st.sampled_from([0.0, 0.1, 1.0]),
        "model_margin": st.sampled_from([0.0, 0.1, 0.6, 1.0]),
        "person_speed": st.sampled_from([0.0, 0.2, 1.6]),
        "stiffness_uncertainty": st.sampled_from([0.0, 0.2]),
        "body_regions": st.sampled_from([(), ("chest",), ("hand_fingers", "back_shoulders")]),
        "test_direction": st.sampled_from([(0.0, 0.0, 0.0), (1.0, 0.0, 2.0)]),
        "mass_cap": st.sampled_from([100.0, 1000.0]),
    }
)


def motions(assessor: ContactAssessor, seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return positions, velocities and tolerances (STATES, n): at rest, slow, fast, and at poses where axes align."""
    robot = assessor.dynamics.robot
    rng = np.random.default_rng(seed)
    lower = np.maximum(robot.model.lowerPositionLimit, -math.pi)
    upper = np.minimum(robot.model.upperPositionLimit, math.pi)
    q = rng.uniform(lower, upper, (STATES, robot.model.nv))
    aligned = rng.choice([0.0, math.pi / 2.0, -math.pi / 2.0], q.shape)
    q[::4] = np.clip(aligned, lower, upper)[::4]
    qd = rng.uniform(-1.0, 1.0, q.shape) * 10.0 ** rng.uniform(-4.0, 1.0, (STATES, 1))
    qd[::6] = 0.0
    return q, qd, rng.uniform(0.0, 0.01, q.shape)


def assert_equal(columns: ContactColumns, expected: ContactColumns, tolerance: float = TOLERANCE) -> None:
    assert (columns.contact_point, columns.contact_normal) == (expected.contact_point, expected.contact_normal)
    is_singular = expected.smallest_singular_value < SINGULAR
    for name in NUMBERS:
        found, wanted = getattr(columns, name), getattr(expected, name)
        assert (found.shape, found.dtype) == (wanted.shape, wanted.dtype)
        for of_states, bound in ((is_singular, max(SINGULAR, tolerance)), (~is_singular, tolerance)):
            np.testing.assert_allclose(found[of_states], wanted[of_states], bound, bound, err_msg=name)
    assert columns.labels() == expected.labels()
    assert columns.reasons(range(STATES)) == expected.reasons(range(STATES))


def compare(robot: Path, values: dict[str, Any], seed: int) -> tuple[ContactColumns, ...]:
    chosen = MonitorSettings.model_validate({"lumping": LUMPING, **values})
    assessor = ContactAssessor(RobotDynamics(load_robot(robot, chosen)), chosen)
    cancels = chosen.drives is Drives.SERVO or chosen.contact is ContactType.QUASI_STATIC
    if why := assessor.load_kernel():
        assert "disagrees with Pinocchio in" in why
        assert robot.stem in ROUNDED
    states = motions(assessor, seed)
    columns = assessor.compute(*states)
    for of_point, expected in zip(columns, assessor.compute_reference(*states), strict=True):
        assert_equal(of_point, expected, CANCELLED if cancels else ROUNDED.get(robot.stem, TOLERANCE))
    return columns


@pytest.mark.parametrize("robot", ROBOTS, ids=lambda path: path.stem)
def test_mobilities_are_those_of_the_mass_matrix_in_local_frames(robot: Path) -> None:
    """CRBA in local frames rounds less than the inverse that the reference takes."""
    chosen = MonitorSettings.model_validate({"lumping": LUMPING})
    dynamics = RobotDynamics(load_robot(robot, chosen))
    assessor = ContactAssessor(dynamics, chosen)
    q, qd, tolerance = motions(assessor, 0)
    models = {} if dynamics.lumped is None else {"lumped_mobility": dynamics.lumped.model}
    models |= {} if dynamics.full_reason else {"full_mobility": dynamics.robot.model}
    kernel = ContactKernel(dynamics, chosen, SpeedLimits(limits_for(chosen), chosen))
    for contact, rows in enumerate(kernel.columns(q, qd, tolerance).T):
        for name, model in models.items():
            entries = rows[:, OFFSETS[name] : OFFSETS[name] + 6]
            for i in np.flatnonzero(entries.any(axis=1)):
                jacobian = dynamics.at(q[i]).contacts[contact].jacobian
                matrix = pin.crba(model, model.createData(), q[i], pin.Convention.LOCAL)
                mobility = jacobian @ np.linalg.solve(matrix + dynamics.robot.rotors.coupling, jacobian.T)
                xx, xy, xz, yy, yz, zz = entries[i]
                found = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
                assert np.abs(found - mobility).max() < TOLERANCE * np.trace(mobility)


@pytest.mark.parametrize("robot", ROBOTS, ids=lambda path: path.stem)
def test_kernel_equals_the_reference_for_every_robot(robot: Path) -> None:
    for seed, contact in enumerate(({}, {"contact": "quasi_static", "drives": "servo"}, {"contact_normal": "0 0 1"})):
        compare(robot, contact, seed)


@settings(max_examples=25)
@given(robot=st.sampled_from(ROBOTS[:4]), contact=CONTACTS, other=OTHERS, seed=st.integers(0, 2**32 - 1))
def test_kernel_equals_the_reference_for_every_setting(
    robot: Path, contact: dict[str, Any], other: dict[str, Any], seed: int
) -> None:
    compare(robot, contact | other, seed)


@pytest.fixture
def assessor() -> ContactAssessor:
    chosen = MonitorSettings(contact_points=("tool",))
    return ContactAssessor(RobotDynamics(load_robot(settings=chosen)), chosen)


@pytest.mark.parametrize("robot", ROBOTS[:4], ids=lambda path: path.stem)
@pytest.mark.parametrize("normal", ["worst", "velocity", "1 -2 0.5"])
def test_kernel_equals_the_reference_where_joints_saturate(robot: Path, normal: str) -> None:
    servo = {"drives": "servo", "servo": {"computed_torque": True}}
    compare(robot, servo | {"contact_normal": normal, "effective_mass_model": "full"}, 7)


def test_reference_computes_without_the_kernel(assessor: ContactAssessor, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jit, "WHY_NOT", "numba is not installed")
    assert assessor.load_kernel() == "numba is not installed"
    states = motions(assessor, 0)
    (columns,), (expected,) = assessor.compute(*states), assessor.compute_reference(*states)
    np.testing.assert_array_equal(columns.allowable_speed, expected.allowable_speed)


@pytest.mark.parametrize(
    ("field", "factor", "reason"), [("allowable_speed", 1.001, "in allowable_speed"), ("body_region", 0.0, "in what")]
)
def test_kernel_that_disagrees_is_not_used(
    assessor: ContactAssessor, monkeypatch: pytest.MonkeyPatch, field: str, factor: float, reason: str
) -> None:
    correct = ContactKernel.columns

    def wrong(kernel: ContactKernel, *states: FloatArray) -> FloatArray:
        columns = correct(kernel, *states)
        columns[OFFSETS[field]] *= factor
        return columns

    monkeypatch.setattr(ContactKernel, "columns", wrong)
    assert f"disagrees with Pinocchio {reason}" in assessor.load_kernel()
    states = motions(assessor, 0)
    (columns,), (expected,) = assessor.compute(*states), assessor.compute_reference(*states)
    np.testing.assert_array_equal(columns.allowable_speed, expected.allowable_speed)


def test_robot_with_too_many_joints_uses_the_reference(tmp_path: Path) -> None:
    rows = "".join(
        f"  - {{name: joint{i}, type: revolute, a: 0.1, alpha: 0.0, d: 0.0, theta: 0.0, lower: -1, upper: 1, "
        "max_speed: 1}\n"
        for i in range(MAX_JOINTS + 1)
    )
    links = "".join(
        f"  - {{name: link{i}, mass: 1.0, com: [0.1, 0.0, 0.02], inertia: [0.01, 0.01, 0.01, 0, 0, 0]}}\n"
        for i in range(MAX_JOINTS + 1)
    )
    path = tmp_path / "chain.yaml"
    head = "robot: chain\nbase_frame: base\ncontact_points: {tip: [0, 0, 0]}\n"
    path.write_text(f"{head}joints:\n{rows}links:\n{links}", encoding="utf-8")
    chosen = MonitorSettings()
    assessor = ContactAssessor(RobotDynamics(load_robot(path, chosen)), chosen)
    assert assessor.load_kernel() == f"the compiled kernel is for at most {MAX_JOINTS} joints, the robot has 17"

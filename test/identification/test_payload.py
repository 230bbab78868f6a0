# SPDX-License-Identifier: Apache-2.0
"""Load of the last link by the torques, on simulated joint states."""

from dataclasses import replace
from pathlib import Path
from statistics import NormalDist

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.identification.arm import identify_arm
from scara_effmass.identification.payload import PayloadEstimate, PayloadEstimator, mass_gain
from scara_effmass.kernel.intervals import Intervals
from scara_effmass.model.load import load_robot
from scara_effmass.model.robot import Robot
from scara_effmass.settings import MonitorSettings
from scara_effmass.sim.experiment import LiveSim
from scara_effmass.studies.load import CASES, Case, States, robot_of, run, simulated
from test.identification.conftest import planar_arm

SCARA, UR10, PANDA = CASES[:3]


def estimates(robot: Robot, states: States, stated: float = 0.0) -> list[PayloadEstimate]:
    estimator = PayloadEstimator(robot, effort_uncertainty=0.03, mass_uncertainty=0.1, stated=stated)
    rows, means = Intervals(robot.periods, 0.1).add(*states)
    found = [estimator.add(int(states.stamps[row]), mean) for row, mean in zip(rows, means, strict=True)]
    return [estimate for estimate in found if estimate]


def harmonic(robot: Robot, load: pin.Inertia, sizes: list[float], seconds: float = 8.0) -> States:
    """Return joint states without any error, of joints that move by `sizes` (n,)."""
    t, size = np.arange(0.0, seconds, 0.005), np.array(sizes)
    w, start = 2.0 + 0.7 * np.arange(len(size)), np.arange(len(size))
    middle = np.clip(0.4, robot.model.lowerPositionLimit, robot.model.upperPositionLimit)
    q, qd = middle + size * np.sin(np.outer(t, w) + start), size * w * np.cos(np.outer(t, w) + start)
    qdd = -size * w**2 * np.sin(np.outer(t, w) + start)
    model = robot.model.copy()
    model.appendBodyToJoint(model.njoints - 1, load, pin.SE3.Identity())
    data = model.createData()
    torque = np.array([pin.rnea(model, data, *row) for row in zip(q, qd, qdd, strict=True)])
    return States(1_000_000_000 + np.round(1e9 * t).astype(np.int64), q, qd, torque + qdd @ robot.rotors.coupling)


@pytest.mark.parametrize(("case", "sizes"), [(UR10, [0.5] * 6), (PANDA, [0.3] * 7), (SCARA, [0.5, 0.5, 0.02, 0.5])])
def test_mass_and_moment_are_those_of_an_independent_model(case: Case, sizes: list[float]) -> None:
    robot, com = robot_of(case), np.array([0.03, -0.02, 0.05])
    load = pin.Inertia(0.8, com, 1e-3 * np.eye(3))
    *_, last = estimates(robot, harmonic(robot, load, sizes), stated=0.5)
    assert last.mass == pytest.approx(0.5 + 0.8, abs=0.01)
    known = last.moment_deviations < 1e-2  # of a SCARA, nothing tells the height
    np.testing.assert_allclose(last.moment[known], 0.8 * com[known], atol=2e-3)
    assert known.sum() == (2 if case is SCARA else 3)
    assert last.is_observable
    assert not last.unfit
    assert (last.telling_joint, last.stated) == ("", 0.5)


@pytest.mark.parametrize("case", [SCARA, UR10, PANDA])
def test_load_picked_up_is_found_within_seven_seconds(case: Case) -> None:
    """Before, nothing shows one; blocks without the load go (else it takes 7 to 8 s), and those with it stay."""
    robot = robot_of(case)
    for seed in range(3):  # of the same friction
        parts = [simulated(robot, case, load, 12.0, np.random.default_rng(seed)) for load in (0.0, case.load)]
        parts[1] = parts[1]._replace(stamps=parts[1].stamps + 12_500_000_000)
        found = estimates(robot, States(*(np.concatenate(columns) for columns in zip(*parts, strict=True))))
        seconds = [1e-9 * estimate.stamp_ns - 13.5 for estimate in found if estimate.mass > 5.0 * estimate.deviation]
        assert 0.0 < seconds[0] < 6.5
        assert found[-1].mass == pytest.approx(case.load, abs=0.1)
        assert found[-1].deviation < 0.05


@pytest.mark.parametrize("friction", [-20.0, 20.0])
def test_friction_of_motion_one_way_is_no_load(friction: float) -> None:
    """The shoulder moves and stops every 2 s, and its friction [N m] keeps its sign: so would a load's torque."""
    robot = robot_of(UR10)
    t = np.arange(0.0, 10.0, 0.01)
    rate, phase = 2.0 * np.pi / 1.5, np.minimum(t % 2.0, 1.5)
    shoulder = np.eye(6)[1]
    qd = np.outer(0.05 * (1.0 - np.cos(rate * phase)), shoulder)
    qdd = np.outer(0.05 * rate * np.sin(rate * phase), shoulder)
    q = np.array([0.0, -1.3, 1.0, -0.5, 0.7, 0.0]) + np.cumsum(qd, axis=0) * 0.01
    data = robot.model.createData()
    torque = np.array([pin.rnea(robot.model, data, *row) for row in zip(q, qd, qdd, strict=True)])
    torque += friction * shoulder
    torque += np.random.default_rng(0).normal(0.0, 0.005, torque.shape) * robot.effort_limits
    found = estimates(robot, States(1_000_000_000 + np.round(1e9 * t).astype(np.int64), q, qd, torque))
    assert len(found) > 4
    assert max(abs(estimate.mass) / estimate.deviation for estimate in found) < 3.0


def test_efforts_of_zero_do_not_fit() -> None:
    """As of simulated hardware, also where one joint alone moves."""
    robot = robot_of(UR10)
    for sizes in ([0.5] * 6, [0.5, *[0.0] * 5]):
        states = harmonic(robot, pin.Inertia(0.5, np.zeros(3), np.zeros((3, 3))), sizes)
        found = estimates(robot, states._replace(effort=0.0 * states.effort))
        assert found
        assert not [estimate for estimate in found if estimate.is_observable and not estimate.unfit]


def test_impacts_are_no_load() -> None:
    """Every 3 s the arm of the simulated cell hits a cart."""
    robot = load_robot(settings=MonitorSettings(contact_points=("tool",)))
    output = LiveSim(1_000_000_000).advance_to(16_000_000_000)
    columns = zip(*((one.stamp_ns, one.position, one.velocity, one.effort) for one in output.joint_states), strict=True)
    found = estimates(robot, States(*map(np.array, columns)), stated=robot.payload_mass)
    assert len(output.carts) >= 3
    assert not [estimate.unfit for estimate in found if estimate.unfit]
    assert len(found) > 5
    assert max(abs(estimate.mass - 0.25) for estimate in found) < 0.05


def test_intervals_cover_the_load() -> None:
    """And none of the robots without a load shows one."""
    outcomes = [run(case, 10.0, seed) for case in (SCARA, UR10, PANDA) for seed in range(8)]
    errors = np.array([[abs(part.error) / part.deviation for part in pair] for pair in outcomes])
    assert 43 <= np.sum(errors < 1.96) <= 48
    assert all(np.isfinite(loaded.found_s) and np.isinf(empty.found_s) for loaded, empty in outcomes)


def test_scara_that_only_turns_does_not_show_its_load() -> None:
    """Its torques show inertia alone, and that only together with errors of the torque constants."""
    robot = robot_of(SCARA)
    *_, last = estimates(robot, harmonic(robot, pin.Inertia.Zero(), [0.02, 0.0, 0.0, 0.0]))
    assert not last.is_observable
    assert last.telling_joint == "joint3"  # which lifts it


def test_robot_at_rest_gives_no_estimate() -> None:
    robot = robot_of(UR10)
    assert not estimates(robot, harmonic(robot, pin.Inertia.Zero(), [0.0] * 6))


def test_effort_of_another_unit_fits_no_load() -> None:
    robot = robot_of(UR10)
    states = simulated(robot, UR10, 1.0, 6.0, np.random.default_rng(5))
    assert not any(estimate.unfit for estimate in estimates(robot, states))
    for factor in (0.3, 3.0, 0.0, -1.0):
        *_, last = estimates(robot, states._replace(effort=factor * states.effort))
        assert "off the torque of the model" in last.unfit


@pytest.mark.parametrize(
    ("case", "factor", "text"),
    [(SCARA, 0.0, "is 0 while it moves"), (UR10, 0.0, "is 0 while it moves"), (SCARA, -1.0, "")],
)
def test_torque_of_one_joint_unlike_the_model_fits_no_load(case: Case, factor: float, text: str) -> None:
    """The last joint carries little, so that its error hides in the load and in friction."""
    robot = robot_of(case)
    states = simulated(robot, case, case.load, 12.0, np.random.default_rng(6))
    effort = states.effort * np.append(np.ones(robot.model.nv - 1), factor)
    *_, found = estimates(robot, states._replace(effort=effort))
    assert robot.joint_names[-1] in found.unfit
    assert text in found.unfit


def test_torques_a_thousand_times_too_large_fit_no_load() -> None:
    robot = robot_of(UR10)
    states = simulated(robot, UR10, 1.0, 6.0, np.random.default_rng(5))
    *_, last = estimates(robot, states._replace(effort=1000.0 * states.effort))
    assert last.unfit


def test_robot_of_one_joint() -> None:
    model, planar = pin.Model(), planar_arm()
    model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "joint1")
    model.appendBodyToJoint(1, planar.model.inertias[1], pin.SE3.Identity())
    model.lowerPositionLimit, model.upperPositionLimit = np.full(1, -3.0), np.full(1, 3.0)
    model.effortLimit, model.velocityLimit, model.armature = np.full(1, 50.0), np.full(1, 3.0), np.zeros(1)
    tool = model.addFrame(pin.Frame("tool", 1, 0, planar.model.frames[-1].placement, pin.FrameType.OP_FRAME))
    rotors = replace(planar.rotors, matrix=np.zeros((1, 1)))
    robot = replace(planar, model=model, contact_frames={"tool": tool}, rotors=rotors)
    *_, last = estimates(robot, harmonic(robot, pin.Inertia(1.0, np.array([0.4, 0.0, 0.0]), np.zeros((3, 3))), [1.0]))
    assert abs(last.moment[0] - 0.4) < 3.0 * last.moment_deviations[0]
    assert identify_arm(robot, Intervals(robot.periods, 0.1).add(*harmonic(robot, pin.Inertia.Zero(), [1.0]))[1], 0.03)
    # The point at the end of the lever of 0.4 m moves across it only.
    own = pin.crba(model, model.createData(), np.zeros(1)).item()
    assert mass_gain(robot, 1.0, np.array([0.4, 0.0, 0.0])) == pytest.approx(1.0 + 0.4**2 / own)


@given(st.floats(-4.0, 20.0), st.floats(1e-3, 10.0))
def test_interval_is_that_of_a_mass_that_is_not_negative(ratio: float, deviation: float) -> None:
    nothing = np.zeros(0)
    numbers = ratio * deviation, deviation, 0.0, nothing, nothing
    found = PayloadEstimate(
        0, *numbers, is_observable=True, telling_joint="", unfit="", friction=nothing, scale_errors=nothing
    )
    lower, upper = found.interval
    above = NormalDist(ratio * deviation, deviation)
    assert lower <= max(0.0, ratio * deviation) < upper
    assert above.cdf(upper) - above.cdf(lower) == pytest.approx(0.95 * (1.0 - above.cdf(0.0)), rel=1e-3)


def test_mass_gain_is_the_ratio_of_effective_masses() -> None:
    """A point mass at the contact point adds at most its own mass to any effective mass."""
    robot = load_robot(Path(__file__).parents[2] / "config/robots/ur5_robot.urdf", MonitorSettings())
    (frame,) = (robot.model.frames[index].placement.translation for index in robot.contact_frames.values())
    gain = mass_gain(robot, 2.0, 2.0 * frame)
    lightest = []
    for q in robot.sample_configurations():
        data = robot.model.createData()
        inverse = np.linalg.inv(robot.mass_matrix(robot.model, data, q))
        jacobian = pin.computeFrameJacobian(
            robot.model, data, q, *robot.contact_frames.values(), pin.LOCAL_WORLD_ALIGNED
        )[:3]
        lightest.append(1.0 / np.linalg.eigvalsh(jacobian @ inverse @ jacobian.T)[0])
    assert gain == pytest.approx(1.0 + 2.0 / min(lightest), rel=1e-9)
    assert mass_gain(robot, 0.0 + 1e-9, np.zeros(3)) == pytest.approx(1.0, abs=1e-6)
    # The same mass elsewhere is another centre of mass of the last link.
    assert mass_gain(robot, 0.0, 0.05 * frame) > 1.0 > mass_gain(robot, -0.05, np.zeros(3))
    # A load that is lighter than the last link leaves a part of it.
    last = robot.model.inertias[robot.model.njoints - 1].mass
    assert 0.0 < mass_gain(robot, -2.0 * last, np.zeros(3)) == mass_gain(robot, -0.9 * last, np.zeros(3)) < 1.0


def test_mass_gain_counts_where_a_point_moves_in_a_plane_alone() -> None:
    """Across the plane its mass is infinite, with and without the load."""
    assert mass_gain(planar_arm(), 2.0, 2.0 * np.array([0.4, 0.0, 0.0])) > 1.5

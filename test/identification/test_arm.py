# SPDX-License-Identifier: Apache-2.0
"""Masses of all links by the torques, on simulated joint states."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from scara_effmass.identification.arm import (
    ArmEstimate,
    effective_mass,
    effective_masses,
    identify_arm,
    modelled_torques,
    with_parameters,
)
from scara_effmass.identification.regression import link_parameters, rest_speeds
from scara_effmass.kernel.intervals import HIGHEST, LOWEST, TORQUE, Intervals
from scara_effmass.model.robot import Robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.studies.load import CASES, Case, States, robot_of, simulated
from test.identification.conftest import planar_arm

SCARA, UR10, PANDA = CASES[:3]


def wrong(robot: Robot, factors: Sequence[float]) -> pin.Model:
    """Return a model whose links have `factors` of the masses and inertias."""
    model = robot.model.copy()
    for joint, factor in enumerate(factors, start=1):
        stated = model.inertias[joint]
        model.inertias[joint] = pin.Inertia(factor * stated.mass, stated.lever, factor * stated.inertia)
    return model


def estimated(robot: Robot, states: States) -> ArmEstimate:
    _, means = Intervals(robot.periods, 0.1).add(*states)
    found = identify_arm(robot, means, 0.03)
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("case", "factors"), [(SCARA, (1.4, 1.4, 1.3, 1.3)), (PANDA, (1, 1.3, 0.7, 1.2, 1.3, 0.8, 1.2))]
)
def test_effective_mass_is_that_of_the_true_arm(case: Case, factors: tuple[float, ...]) -> None:
    """Also where the file is a third off."""
    robot = robot_of(case)
    truth = replace(robot, model=wrong(robot, factors))
    found = estimated(robot, simulated(truth, case, 0.0, 40.0, np.random.default_rng(4)))
    assert not found.unfit
    masses = effective_masses(found, 60)
    true = effective_masses(found._replace(parameters=link_parameters(truth.model)), 60).identified
    covered = np.abs(masses.identified - true) < 1.96 * masses.deviations
    assert covered.mean() > 0.9
    assert np.median(np.abs(masses.identified / true - 1.0)) < 0.5 * np.median(np.abs(masses.stated / true - 1.0))


@pytest.mark.parametrize("is_lumped", [False, True])
def test_modelled_torques_are_the_measured_ones_up_to_the_residual(is_lumped: bool) -> None:  # noqa: FBT001
    robot = robot_of(SCARA)
    lumped = RobotDynamics(robot).lumped if is_lumped else None
    _, means = Intervals(robot.periods, 0.1).add(*simulated(robot, SCARA, 0.0, 20.0, np.random.default_rng(5)))
    found = identify_arm(robot, means, 0.03, lumped)
    assert found is not None
    torques = modelled_torques(robot, found, means)
    rms = np.sqrt(np.nanmean((means[:, TORQUE] - torques) ** 2, axis=0))
    assert (rms < 2.5 * found.solution.residuals).all()  # which are those of means of four intervals
    at_rest = np.maximum(abs(means[:, LOWEST]), abs(means[:, HIGHEST])) < rest_speeds(robot)
    assert np.isnan(torques[at_rest]).all()
    assert 0.5 < np.isfinite(torques).mean() < 1.0


def test_a_tool_that_the_file_does_not_have_is_found() -> None:
    """It weighs five times as much as the last link of the file."""
    robot = robot_of(UR10)
    model = robot.model.copy()
    model.appendBodyToJoint(6, pin.Inertia(1.0, robot.tip.translation, 1e-3 * np.eye(3)), pin.SE3.Identity())
    found = estimated(robot, simulated(replace(robot, model=model), UR10, 0.0, 40.0, np.random.default_rng(7)))
    assert not found.unfit
    assert abs(found.parameters[-1, 0] - model.inertias[6].mass) < 2.5 * found.deviations[-1, 0]
    masses = effective_masses(found, 60)
    true = effective_masses(found._replace(parameters=link_parameters(model)), 60).identified
    assert np.mean(true < masses.identified + 1.96 * masses.deviations) > 0.9


def test_friction_that_pushes_does_not_fit() -> None:
    """The last wrist carries little: a wrong sign of its effort passes for a light link and negative friction."""
    robot = robot_of(UR10)
    states = simulated(robot, UR10, 0.0, 15.0, np.random.default_rng(3))
    found = estimated(robot, states._replace(effort=states.effort * [1.0, 1.0, 1.0, 1.0, 1.0, -1.0]))
    assert found.unfit == "the friction of wrist_3_joint pushes, as if its effort had the wrong sign"


def test_every_link_is_a_body() -> None:
    for seed in range(3):
        robot = robot_of(UR10)
        found = estimated(robot, simulated(robot, UR10, 0.0, 8.0, np.random.default_rng(seed)))
        matrices = [pin.PseudoInertia.FromDynamicParameters(link).toMatrix() for link in found.parameters]
        assert all(np.linalg.eigvalsh(matrix)[0] > 0.0 for matrix in matrices)


def test_a_right_file_is_confirmed() -> None:
    robot = robot_of(PANDA)
    masses = effective_masses(estimated(robot, simulated(robot, PANDA, 0.0, 40.0, np.random.default_rng(1))), 60)
    assert np.mean(np.abs(masses.identified - masses.stated) < 1.96 * masses.deviations) > 0.9


def test_base_parameters_of_a_planar_arm_are_those_counted_by_hand() -> None:
    """Two parallel horizontal axes: I1 + m2 l^2, m1 c1 + m2 l (2 of the CoM), I2 and m2 c2 (2); Khalil & Dombre."""
    planar = planar_arm()
    found = estimated(planar, simulated(planar, UR10, 0.0, 10.0, np.random.default_rng(2)))
    assert found.base.identifiable == found.base.rank == 6


def test_gradient_is_that_of_finite_differences() -> None:
    robot = robot_of(PANDA)
    q, normals = robot.sample_configurations(3)[1], np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8]])
    parameters, frame = link_parameters(robot.model), next(iter(robot.contact_frames.values()))
    _, gradients = effective_mass(robot, robot.model, robot.model.createData(), q, normals, frame)
    for index in range(0, parameters.size, 3):
        step = np.zeros(parameters.size)
        step[index] = 1e-5
        both = [with_parameters(robot.model, parameters + sign * step.reshape(parameters.shape)) for sign in (1, -1)]
        up, down = (effective_mass(robot, model, model.createData(), q, normals, frame)[0] for model in both)
        np.testing.assert_allclose(gradients[:, index], (up - down) / 2e-5, rtol=1e-4, atol=1e-6)


def test_no_motion_gives_no_estimate() -> None:
    robot = robot_of(UR10)
    assert identify_arm(robot, [], 0.03) is None


def test_lumped_mass_covers_that_of_the_true_masses() -> None:
    """An arm of point masses: link 2 a third heavier than stated."""
    robot = robot_of(SCARA)
    lumped = RobotDynamics(robot).lumped
    assert lumped is not None
    bodies = lumped.model.copy()
    bodies.armature = robot.model.armature
    truth = replace(robot, model=wrong(replace(robot, model=bodies), (1.0, 1.3, 1.0, 1.0)))
    covered = []
    for seed in range(4):
        states = simulated(truth, SCARA, 0.0, 30.0, np.random.default_rng(seed))
        found = identify_arm(robot, Intervals(robot.periods, 0.1).add(*states)[1], 0.03, lumped)
        assert found is not None
        assert found.point_masses is not None
        assert not found.unfit
        assert found.base.identifiable == 3
        true = effective_masses(found._replace(parameters=link_parameters(truth.model)), 60).identified
        masses = effective_masses(found, 60)
        covered.append(np.mean(np.abs(masses.identified - true) < 1.96 * masses.deviations))
        assert np.median(np.abs(masses.identified / true - 1.0)) < 0.5 * np.median(np.abs(masses.stated / true - 1.0))
    assert np.mean(covered) > 0.9


def test_a_lumped_mass_that_would_be_negative_is_none() -> None:
    """Torques of an arm of a twentieth of its masses, in little motion."""
    robot = robot_of(SCARA)
    lumped = RobotDynamics(robot).lumped
    assert lumped is not None
    truth = replace(robot, model=wrong(robot, (0.05, 0.05, 0.05, 0.05)))
    states = simulated(truth, SCARA, 0.0, 5.0, np.random.default_rng(1))
    found = identify_arm(robot, Intervals(robot.periods, 0.1).add(*states)[1], 0.03, lumped)
    assert found is not None
    assert found.point_masses is not None
    assert found.is_projected
    assert (found.point_masses.identified >= 0.0).all()

# SPDX-License-Identifier: Apache-2.0
"""Impact of an arm on a free plate: kinematics, closed forms, and the error of the time step."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

from scara_effmass.iso15066 import limits_for
from scara_effmass.settings import MonitorSettings, ServoSettings
from scara_effmass.sim import plate_sim
from scara_effmass.sim.plate_sim import PHASE_STEP
from scara_effmass.studies.bounds import ROBOTS, arm_of

(CHEST,) = limits_for(MonitorSettings(body_regions=("chest",)))
STILL = 1e-6
"""Pace at which the arm stays in its pose."""
DECOUPLED = ServoSettings(bandwidth=5.0, computed_torque=True)


@pytest.mark.parametrize("robot", ROBOTS)
def test_mujoco_and_pinocchio_agree_on_every_contact_point(robot: str) -> None:
    arm = arm_of(robot)
    arm.sim.scale_masses(np.ones(arm.sim.n))
    description = arm.dynamics.robot
    rng = np.random.default_rng(1)
    for point in range(len(arm.dynamics.contacts)):
        q = rng.uniform(arm.lower, arm.upper)
        jacobian, mass_matrix = arm.sim.kinematics(q, point)
        assert np.allclose(jacobian, arm.dynamics.at(q).contacts[point].jacobian, atol=1e-9)
        robot_matrix = description.mass_matrix(description.model, description.model.createData(), q)
        upper = np.triu_indices(arm.sim.n)  # Pinocchio fills this half only
        assert np.allclose(mass_matrix[upper], robot_matrix[upper], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("robot", ROBOTS)
def test_mujoco_and_pinocchio_agree_on_every_place_of_a_link(robot: str) -> None:
    arm, rng = arm_of(robot, is_whole=True), np.random.default_rng(1)
    model = arm.dynamics.robot.model
    data = model.createData()
    for link in arm.links():
        q, place = rng.uniform(arm.lower, arm.upper), arm.random_place(rng, link)
        arm.sim.move_contact(link, place)
        frame = arm.dynamics.contacts[link].frame
        twist = pin.computeFrameJacobian(model, data, q, frame, pin.ReferenceFrame.LOCAL)
        pin.framesForwardKinematics(model, data, q)
        expected = data.oMf[frame].rotation @ (twist[:3] - pin.skew(place) @ twist[3:])
        assert np.allclose(arm.sim.kinematics(q, link)[0], expected, atol=1e-8)


def test_peak_of_free_joints_in_one_pose_is_v_root_mu_k() -> None:
    arm = arm_of("UR5")
    rng = np.random.default_rng(2)
    for _ in range(5):
        q, qd = arm.draw_motion(rng)
        normal = arm.sim.worst_normal(q, qd, CHEST)
        jacobian, mass_matrix = arm.sim.kinematics(q)
        row = normal @ jacobian
        mu = 1.0 / (row @ np.linalg.solve(mass_matrix, row) + 1.0 / CHEST.body_mass_kg)
        force = float(row @ qd) * math.sqrt(mu * CHEST.stiffness_n_m)
        peak = arm.sim.touch(q, qd, normal, CHEST, pace=STILL)
        assert peak.force == pytest.approx(force, rel=3e-4)
        assert peak.time == pytest.approx(0.5 * math.pi * math.sqrt(mu / CHEST.stiffness_n_m), rel=PHASE_STEP)


def test_stiff_servo_makes_the_arm_immovable() -> None:
    arm = arm_of("i4-550L")
    q, qd = arm.draw_motion(np.random.default_rng(3))
    normal = arm.sim.kinematics(q)[0] @ qd
    speed = float(np.linalg.norm(normal))
    peak = arm.sim.touch(q, qd, normal / speed, CHEST, ServoSettings(bandwidth=300.0, computed_torque=True), pace=STILL)
    assert peak.force == pytest.approx(speed * math.sqrt(CHEST.body_mass_kg * CHEST.stiffness_n_m), rel=0.01)


def test_masses_scale_the_mass_matrix() -> None:
    arm = arm_of("Panda")
    q = np.full(arm.sim.n, 0.3)
    arm.sim.scale_masses(np.ones(arm.sim.n))
    _, nominal = arm.sim.kinematics(q)
    arm.sim.scale_masses(np.full(arm.sim.n, 1.1))
    _, heavier = arm.sim.kinematics(q)
    arm.sim.scale_masses(np.ones(arm.sim.n))
    assert np.allclose(heavier, 1.1 * nominal, rtol=1e-9)


@pytest.mark.parametrize("servo", [None, DECOUPLED])
def test_a_simulation_that_diverges_has_no_peak(servo: ServoSettings | None) -> None:
    arm = arm_of("UR5")
    q, qd = arm.draw_motion(np.random.default_rng(5))
    normal = arm.sim.worst_normal(q, qd, CHEST)
    with pytest.raises(ArithmeticError, match="diverged"):
        arm.sim.touch(q, qd * math.nan, normal, CHEST, servo)


@pytest.mark.parametrize("servo", [None, DECOUPLED, ServoSettings(bandwidth=20.0, damping=0.5)])
def test_error_of_the_time_step(servo: ServoSettings | None, monkeypatch: pytest.MonkeyPatch) -> None:
    arm = arm_of("UR10")
    rng = np.random.default_rng(4)
    for _ in range(3):
        q, creep = arm.draw_motion(rng)
        qd = creep * (0.8 / 0.006)
        normal = arm.sim.worst_normal(q, qd, CHEST)
        coarse = arm.sim.touch(q, qd, normal, CHEST, servo).force
        with monkeypatch.context() as finer:
            finer.setattr(plate_sim, "PHASE_STEP", PHASE_STEP / 4.0)
            fine = arm.sim.touch(q, qd, normal, CHEST, servo).force
        assert coarse == pytest.approx(fine, rel=1e-3)

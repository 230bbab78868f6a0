# SPDX-License-Identifier: Apache-2.0
"""Drawings show the robot: forward kinematics, masses that balance, ellipsoids and normals by their definitions.

Poses of many configurations are those of Pinocchio, one at a time.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.model.load import load_robot
from scara_effmass.model.poses import ManyPoses, mass_ellipsoid, pose_geometry, quaternion, rotation_to
from scara_effmass.reference import RobotDynamics
from scara_effmass.reference.mobility import effective_mass
from scara_effmass.settings import MonitorSettings
from scara_effmass.share import share

if TYPE_CHECKING:
    from collections.abc import Callable

    from scara_effmass.model.robot import Robot
    from scara_effmass.values import FloatArray

CAP = 1000.0
L = 0.275
ANGLE = st.floats(-math.pi, math.pi)
ENTRY = st.floats(-3.0, 3.0)
MATRIX = st.lists(ENTRY, min_size=9, max_size=9).map(lambda entries: np.array(entries).reshape(3, 3))
MOBILITY = MATRIX.map(lambda root: root @ root.T + 1e-2 * np.eye(3))
DIRECTION = (
    st.tuples(ENTRY, ENTRY, ENTRY)
    .filter(lambda v: math.hypot(*v) > 1e-3)
    .map(lambda v: tuple(x / math.hypot(*v) for x in v))
)


@given(q1=ANGLE, q2=ANGLE, q3=st.floats(0.0, 0.4), q4=ANGLE)
def test_shipped_robot_is_drawn_by_its_forward_kinematics(q1: float, q2: float, q3: float, q4: float) -> None:
    drawn = pose_geometry(OMRON.robot, OMRON.lumped, np.array([q1, q2, q3, q4]))
    elbow = np.array([L * math.cos(q1), L * math.sin(q1), 0.0])
    wrist = elbow + np.array([L * math.cos(q1 + q2), L * math.sin(q1 + q2), 0.0])
    tool = wrist - [0.0, 0.0, q3]
    assert drawn.contact_points["elbow"] == pytest.approx(elbow, abs=1e-9)
    assert drawn.contact_points["tool"] == pytest.approx(tool, abs=1e-9)
    lines = [(np.zeros(3), elbow), (elbow, wrist), *([(wrist, tool)] if q3 > 1e-5 else [])]
    for line in lines:
        assert np.abs(drawn.segments - line).max(axis=(1, 2)).min() < 1e-9
    # Table II of the paper: one mass on each axis.
    masses = [mass for mass, _ in drawn.lumped_masses]
    assert masses[:2] == pytest.approx([1.94, 2.38], abs=0.01)
    assert sum(masses[2:]) == pytest.approx(0.97, abs=0.01)
    places = [np.array(place)[:2] for _, place in drawn.lumped_masses]
    assert np.allclose(places[:2], np.array([(0.0, 0.0), elbow[:2]]), atol=1e-9)
    assert np.allclose(places[2:], wrist[:2], atol=1e-9)


@pytest.mark.parametrize("name", ["", "scara_icube_tutorial.urdf", "kinova.urdf", "ur10_robot.urdf"])
def test_lumped_masses_balance_at_the_centre_of_mass_of_the_robot(
    name: str, load_urdf_file: Callable[..., Robot]
) -> None:
    dynamics = RobotDynamics(load_urdf_file(name)) if name else OMRON
    robot = dynamics.robot
    for q in robot.sample_configurations(16):
        masses = pose_geometry(dynamics.robot, dynamics.lumped, q).lumped_masses
        total = sum(mass for mass, _ in masses)
        centre = np.array([mass * np.array(place) for mass, place in masses]).sum(axis=0) / total
        data = robot.model.createData()
        pin.forwardKinematics(robot.model, data, q)
        bodies = [(body.mass, data.oMi[i].act(body.lever)) for i, body in enumerate(robot.model.inertias) if i]
        assert total == pytest.approx(sum(mass for mass, _ in bodies))
        expected = np.array([mass * place for mass, place in bodies]).sum(axis=0) / total
        across = slice(0, 2) if robot.revolute == (True, True, False, True) else slice(0, 3)  # heights do not matter
        assert centre[across] == pytest.approx(expected[across], abs=1e-4)


def test_links_of_a_six_axis_arm_are_rigid_and_end_at_its_contact_point(load_urdf_file: Callable[..., Robot]) -> None:
    dynamics = RobotDynamics(load_urdf_file("ur5_robot.urdf"))
    lengths = set()
    for q in dynamics.robot.sample_configurations(16):
        drawn = pose_geometry(dynamics.robot, dynamics.lumped, q)
        (point,) = drawn.contact_points.values()
        assert point == pytest.approx(dynamics.at(q).contacts[0].position, abs=1e-9)
        assert np.abs(drawn.segments[:, 1] - point).max(axis=1).min() < 1e-9
        lengths.add(tuple(np.linalg.norm(drawn.segments[:, 1] - drawn.segments[:, 0], axis=1).round(6)))
    assert len(lengths) == 1
    assert {0.089159, 0.39225} <= {round(length, 6) for length in lengths.pop()}  # of the data sheet


@given(mobility=MOBILITY, n=DIRECTION)
def test_radius_of_the_ellipsoid_is_the_root_of_the_mass_along_it(
    mobility: FloatArray, n: tuple[float, float, float]
) -> None:
    ellipsoid = mass_ellipsoid(mobility, CAP)
    assert np.linalg.det(ellipsoid.axes) == pytest.approx(1.0)
    on_surface = math.sqrt(effective_mass(mobility, np.array(n))) * np.array(n)
    assert float(np.sum((ellipsoid.axes.T @ on_surface) ** 2 / ellipsoid.masses)) == pytest.approx(1.0, rel=1e-6)
    for mass, axis in zip(ellipsoid.masses, ellipsoid.axes.T, strict=True):
        assert mobility @ axis == pytest.approx(axis / mass, abs=1e-9)  # an eigenvector


def test_mass_of_a_direction_that_no_joint_moves_is_limited() -> None:
    ellipsoid = mass_ellipsoid(np.diag([0.5, 0.0, 0.0]), CAP)
    assert ellipsoid.masses == pytest.approx([CAP, CAP, 2.0])
    assert abs(ellipsoid.axes[0, 2]) == pytest.approx(1.0)


@given(n=DIRECTION)
def test_rotation_and_quaternion_turn_z_to_the_direction(n: tuple[float, float, float]) -> None:
    rotation = rotation_to(n)
    x, y, z, w = quaternion(rotation)
    assert rotation[:, 2] == pytest.approx(n, abs=1e-9)
    assert (2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)) == pytest.approx(n, abs=1e-9)


OMRON = RobotDynamics(load_robot())


@pytest.mark.parametrize("name", ["omron_i4_550l.yaml", "robots/ur5_robot.urdf", "robots/panda.urdf"])
def test_positions_jacobians_and_directions_are_those_of_pinocchio(name: str) -> None:
    settings = MonitorSettings(robot=str(share("config", *name.split("/"))))
    dynamics = RobotDynamics(load_robot(settings.robot_path, settings))
    robot = dynamics.robot
    q = robot.sample_configurations(50)
    poses = ManyPoses(robot, q)
    states = [dynamics.at(row) for row in q]
    points = [(index, point.frame) for index, point in enumerate(dynamics.contacts) if not len(point.vertices)]
    for index, frame in points:
        contacts = [state.contacts[index] for state in states]
        np.testing.assert_allclose(poses.position(frame), [contact.position for contact in contacts], atol=1e-14)
        np.testing.assert_allclose(poses.jacobian(frame), [contact.jacobian for contact in contacts], atol=1e-14)
    direction = (0.0, 0.6, -0.8)
    for name_of_frame in dict.fromkeys(("", robot.base_frame, *(frame.name for frame in robot.model.frames))):
        expected = np.array([state.in_base(direction, name_of_frame) for state in states])
        np.testing.assert_allclose(poses.in_base(direction, name_of_frame), expected, atol=1e-14)

# SPDX-License-Identifier: Apache-2.0
"""Mass matrices and Jacobians agree with Eqs. 9-14 in numpy and with finite differences."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from scara_effmass.model.robot import Robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.values import FloatArray

STEP = 1e-6


def joint_poses(rows: dict[str, Any], q: FloatArray) -> list[FloatArray]:
    """Poses (4, 4) of the moving joint frames, and last of the DH frame at the end, by standard DH rows."""
    pose, poses = np.eye(4), []
    for row, value in zip(rows["joints"], q, strict=True):
        theta, d = (value, 0.0) if row["type"] == "revolute" else (0.0, value)
        pose = pose @ screw(theta, d)
        poses.append(pose)
        offset = screw(row.get("theta", 0.0), row.get("d", 0.0))
        c, s = np.cos(row["alpha"]), np.sin(row["alpha"])
        pose = pose @ offset @ np.array([[1, 0, 0, row["a"]], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1.0]])
    return [*poses, pose]


def screw(theta: float, d: float) -> FloatArray:
    c, s = np.cos(theta), np.sin(theta)
    return np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, d], [0, 0, 0, 1.0]])


def link_pose(rows: dict[str, Any], q: FloatArray, link: int) -> FloatArray:
    row = rows["joints"][link]
    return np.asarray(joint_poses(rows, q)[link] @ screw(row.get("theta", 0.0), row.get("d", 0.0)))


def geometric(rows: dict[str, Any], q: FloatArray, link: int, point: FloatArray) -> tuple[FloatArray, FloatArray]:
    """J_P, J_O (3, n) of a point in the base frame, fixed to `link`: Eqs. 10-13."""
    n = len(rows["joints"])
    linear, angular = np.zeros((3, n)), np.zeros((3, n))
    poses = joint_poses(rows, q)
    for j in range(link + 1):
        axis, origin = poses[j][:3, 2], poses[j][:3, 3]
        if rows["joints"][j]["type"] == "revolute":
            linear[:, j], angular[:, j] = np.cross(axis, point - origin), axis
        else:
            linear[:, j] = axis
    return linear, angular


def eq_9(rows: dict[str, Any], q: FloatArray) -> FloatArray:
    """Full mass matrix: sum of m J_P^T J_P + J_O^T R I R^T J_O over links and payload, plus armature."""
    n = len(rows["joints"])
    matrix = np.diag([row.get("armature", 0.0) for row in rows["joints"]])
    bodies = [(i, link, link_pose(rows, q, i)) for i, link in enumerate(rows["links"])]
    bodies.append((n - 1, {"com": [0, 0, 0], **rows["payload"]}, joint_poses(rows, q)[-1]))
    for i, body, pose in bodies:
        linear, angular = geometric(rows, q, i, pose[:3, :3] @ body["com"] + pose[:3, 3])
        rotation = pose[:3, :3]
        matrix = matrix + body["mass"] * linear.T @ linear
        matrix = matrix + angular.T @ rotation @ tensor(body["inertia"]) @ rotation.T @ angular
    return np.asarray(matrix)


def tensor(inertia: float | list[float]) -> FloatArray:
    if isinstance(inertia, float):
        return np.diag([0.5 * inertia, 0.5 * inertia, inertia])
    xx, yy, zz, xy, xz, yz = inertia
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


@pytest.fixture
def spatial_rows(omron_rows: dict[str, Any]) -> dict[str, Any]:
    """Return a robot with everything that DH rows can state: skew axes, offsets, full tensors, armature, a payload."""
    rng = np.random.default_rng(10218)
    for row in omron_rows["joints"]:
        row["a"], row["alpha"], row["d"], row["theta"] = rng.uniform(-0.5, 0.5, 4).tolist()
        row["armature"] = float(rng.uniform(0.0, 0.2))
    for body in (*omron_rows["links"], omron_rows["payload"]):
        body["com"] = rng.uniform(-0.3, 0.3, 3).tolist()
        masses, points = rng.uniform(0.1, 0.5, 6), rng.uniform(-0.1, 0.1, (6, 3))
        spread = sum(m * (p @ p * np.eye(3) - np.outer(p, p)) for m, p in zip(masses, points, strict=True))
        body["inertia"] = [float(spread[i, j]) for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    omron_rows["contact_points"] = {"tool": [0.05, -0.02, 0.1]}
    return omron_rows


@pytest.mark.parametrize("which", ["omron_rows", "spatial_rows"])
def test_full_mass_matrix_is_eq_9(
    which: str, request: pytest.FixtureRequest, load_rows: Callable[[object], Robot]
) -> None:
    rows = request.getfixturevalue(which)
    robot = load_rows(rows)
    data = robot.model.createData()
    for q in robot.sample_configurations():
        np.testing.assert_allclose(pin.crba(robot.model, data, q), eq_9(rows, q), rtol=1e-9, atol=1e-12)


def test_mass_matrix_is_twice_the_kinetic_energy(
    spatial_rows: dict[str, Any], load_rows: Callable[[object], Robot]
) -> None:
    robot = load_rows(spatial_rows)
    rng = np.random.default_rng(1)
    bodies = [(i, link) for i, link in enumerate(spatial_rows["links"])]

    for q in robot.sample_configurations()[:16]:
        qd = rng.uniform(-1.0, 1.0, 4)
        energy = 0.5 * sum(row["armature"] * rate**2 for row, rate in zip(spatial_rows["joints"], qd, strict=True))
        held = (3, spatial_rows["payload"])
        for (i, body), end in [*((entry, False) for entry in bodies), (held, True)]:
            before, now, after = (
                joint_poses(spatial_rows, q + k * STEP * qd)[-1]
                if end
                else link_pose(spatial_rows, q + k * STEP * qd, i)
                for k in (-1.0, 0.0, 1.0)
            )
            rate = (after - before) / (2.0 * STEP)
            velocity = rate[:3, :3] @ body["com"] + rate[:3, 3]
            turning = rate[:3, :3] @ now[:3, :3].T  # the cross-product matrix of the angular velocity
            omega = now[:3, :3].T @ [turning[2, 1], turning[0, 2], turning[1, 0]]
            energy += 0.5 * body["mass"] * velocity @ velocity + 0.5 * omega @ tensor(body["inertia"]) @ omega
        matrix = pin.crba(robot.model, robot.model.createData(), q)
        assert 0.5 * qd @ matrix @ qd == pytest.approx(energy, rel=1e-7)


def test_jacobian_agrees_with_finite_differences(
    spatial_rows: dict[str, Any], load_rows: Callable[[object], Robot]
) -> None:
    robot = load_rows(spatial_rows)
    dynamics = RobotDynamics(robot)
    tool = np.array([*spatial_rows["contact_points"]["tool"], 1.0])
    for q in robot.sample_configurations()[:16]:
        columns = [
            (joint_poses(spatial_rows, q + e) @ tool - joint_poses(spatial_rows, q - e) @ tool)[-1][:3] / (2.0 * STEP)
            for e in STEP * np.eye(4)
        ]
        np.testing.assert_allclose(dynamics.at(q).contacts[0].jacobian, np.transpose(columns), atol=1e-8)


def test_lumped_mass_matrix_is_eq_14(omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]) -> None:
    for link in omron_rows["links"]:
        link["com"][2] = 0.07  # heights do not matter on parallel axes, and must change nothing
    dynamics = RobotDynamics(load_rows(omron_rows))
    assert dynamics.lumped is not None
    model = dynamics.lumped.model
    data = model.createData()
    for q in dynamics.robot.sample_configurations():
        matrix = np.zeros((4, 4))
        for i, link in enumerate(dynamics.lumped.links):
            for mass, point in ((link.kappa1 * link.mass, link.point1), (link.kappa2 * link.mass, link.point2)):
                jacobian = np.transpose(
                    [
                        (joint_poses(omron_rows, q + e)[i] - joint_poses(omron_rows, q - e)[i])[:3] @ [*point, 1.0]
                        for e in STEP * np.eye(4)
                    ]
                ) / (2.0 * STEP)
                matrix += mass * jacobian.T @ jacobian
        matrix[3, 3] += 1.0  # nothing is left to turn about joint 4; its armature stands in
        np.testing.assert_allclose(pin.crba(model, data, q), matrix, atol=1e-8)


def test_two_masses_keep_mass_and_centre_of_mass_of_every_link(omron_dynamics: RobotDynamics) -> None:
    assert omron_dynamics.lumped is not None
    for link, body in zip(omron_dynamics.lumped.links, list(omron_dynamics.robot.model.inertias)[1:], strict=True):
        centre = link.kappa1 * np.array(link.point1) + link.kappa2 * np.array(link.point2)
        assert link.kappa1 + link.kappa2 == pytest.approx(1.0)
        assert link.mass == pytest.approx(body.mass)
        np.testing.assert_allclose(centre, body.lever, atol=1e-12)


def test_armature_adds_to_the_diagonal_of_both_models(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot], omron_dynamics: RobotDynamics
) -> None:
    rotors = np.array([0.31, 0.17, 4.0, 0.02])
    for row, rotor in zip(omron_rows["joints"], rotors, strict=True):
        row["armature"] = float(rotor)
    geared = RobotDynamics(load_rows(omron_rows))
    assert geared.lumped is not None
    assert omron_dynamics.lumped is not None
    for q in geared.robot.sample_configurations()[:8]:
        for with_rotors, without, at_rest in (
            (geared.robot.model, omron_dynamics.robot.model, 0.0),
            (geared.lumped.model, omron_dynamics.lumped.model, 1.0),
        ):
            added = pin.crba(with_rotors, with_rotors.createData(), q) - pin.crba(without, without.createData(), q)
            np.testing.assert_allclose(added, np.diag(rotors - [0.0, 0.0, 0.0, at_rest]), atol=1e-12)


def test_armature_makes_the_robot_heavier(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot], omron_dynamics: RobotDynamics
) -> None:
    omron_rows["joints"][1]["armature"] = 0.1
    geared = RobotDynamics(load_rows(omron_rows))
    for q in geared.robot.sample_configurations():
        heavy, light = (
            dynamics.at(q, np.array([1.0, 0.0, 0.0, 0.0])).contacts[0] for dynamics in (geared, omron_dynamics)
        )
        assert heavy.lumped >= light.lumped * (1.0 - 1e-12)
        assert heavy.full >= light.full * (1.0 - 1e-12)


def test_only_inertia_about_the_axes_affects_a_scara(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot], omron_dynamics: RobotDynamics
) -> None:
    for body in omron_rows["links"]:
        izz = body["inertia"]
        body["inertia"] = [0.9 * izz, 0.8 * izz, izz, 0.1 * izz, 0.0, 0.0]
    other = RobotDynamics(load_rows(omron_rows))
    for q in other.robot.sample_configurations():
        here, there = (
            pin.crba(dynamics.robot.model, dynamics.robot.model.createData(), q) for dynamics in (omron_dynamics, other)
        )
        np.testing.assert_allclose(there, here, atol=1e-12)


def test_compute_minverse_is_the_inverse_of_crba(omron_dynamics: RobotDynamics) -> None:
    assert omron_dynamics.lumped is not None
    for model in (omron_dynamics.robot.model, omron_dynamics.lumped.model):
        data = model.createData()
        for q in omron_dynamics.robot.sample_configurations():
            matrix = pin.crba(model, data, q).copy()
            np.testing.assert_allclose(pin.computeMinverse(model, data, q) @ matrix, np.eye(4), atol=1e-9)

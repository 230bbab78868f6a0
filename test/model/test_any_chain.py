# SPDX-License-Identifier: Apache-2.0
"""Both models of real arms with five to seven axes: Pinocchio, Eq. 14 by hand, invariances, singular poses."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin
import pytest

from scara_effmass.codes import ModelCode
from scara_effmass.model.robot import Robot
from scara_effmass.reference import ContactState, RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.settings import LumpingSettings, MonitorSettings
from scara_effmass.values import FloatArray, JointState, Verdict

RNG_SEED = 3
POSES = 2000
NOW = 1_700_000_000_000_000_000
MIRROR = np.diag([1.0, -1.0, 1.0])


class Arm(NamedTuple):
    file: str
    contact_point: str
    axes: int
    placeholders: bool = False


ARMS = (
    Arm("ur5_robot.urdf", "ee_link", 6),
    Arm("ur10_robot.urdf", "ee_link", 6),
    Arm("panda.urdf", "panda_hand_tcp", 7),
    Arm("tm5-700-nominal.urdf", "flange", 6, placeholders=True),
    Arm("tm12-nominal.urdf", "flange", 6, placeholders=True),
    Arm("wx200.urdf", "wx200/ee_arm_link", 5),
    Arm("kinova.urdf", "j2s6s200_end_effector", 6),
    Arm("xarm7.urdf", "link7", 7),
)
Load = Callable[..., Robot]


@pytest.fixture(scope="session", params=ARMS, ids=[arm.file for arm in ARMS])
def dynamics(request: pytest.FixtureRequest, load_urdf_file: Load) -> RobotDynamics:
    """The arm with a lumped model by approximation; placeholder centres of mass move towards the next joint."""
    arm: Arm = request.param
    lumping = LumpingSettings.model_validate({"policy": "project_com", "free_parameters": "fit_inertia"})
    robot = load_urdf_file(arm.file, contact_points=(arm.contact_point,), lumping=lumping)
    assert robot.model.nv == arm.axes
    assert bool(robot.coms_reason) == arm.placeholders
    for joint in range(1, arm.axes) if arm.placeholders else ():
        robot.model.inertias[joint].lever = 0.4 * robot.model.jointPlacements[joint + 1].translation
    return RobotDynamics(replace(robot, coms_reason="", inertias_reason=""))


def frame_of(robot: Robot) -> pin.Frame:
    (frame,) = robot.contact_frames.values()
    return robot.model.frames[frame]


def poses(robot: Robot, count: int) -> FloatArray:
    lower = np.maximum(robot.model.lowerPositionLimit, -math.pi)
    upper = np.minimum(robot.model.upperPositionLimit, math.pi)
    return np.asarray(np.random.default_rng(RNG_SEED).uniform(lower, upper, (count, robot.model.nv)))


def contact_at(dynamics: RobotDynamics, q: FloatArray) -> ContactState:
    (contact,) = dynamics.at(q).contacts
    return contact


def agree(left: object, right: object, tolerance: float = 1e-9) -> bool:
    left, right = np.array(left), np.array(right)
    return bool(np.abs(left - right).max() < tolerance * np.abs(right).max())


def test_full_mobility_is_the_inverse_of_pinocchios_operational_space_inertia(dynamics: RobotDynamics) -> None:
    model, frame = dynamics.robot.model, frame_of(dynamics.robot)
    data = model.createData()
    contact = pin.RigidConstraintModel(
        pin.ContactType.CONTACT_3D, model, frame.parentJoint, frame.placement, pin.ReferenceFrame.LOCAL
    )
    contacts, contact_data = pin.StdVec_RigidConstraintModel(), pin.StdVec_RigidConstraintData()
    contacts.append(contact)
    contact_data.append(contact.createData())
    for q in poses(dynamics.robot, POSES):
        delassus = pin.computeDelassusMatrix(model, data, q, contacts, contact_data, 0.0)
        rotation = data.oMi[frame.parentJoint].rotation @ frame.placement.rotation
        assert agree(contact_at(dynamics, q).mobilities[ModelCode.FULL], rotation @ delassus @ rotation.T)


def eq_14(robot: Robot, points: list[tuple[int, float, FloatArray]], q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the sum of m J_P^T J_P over point masses (joint, m, place in its frame), and J_v of the contact point."""
    origins, rotations, axes = [np.zeros(3)], [np.eye(3)], [np.zeros(3)]
    for joint in range(1, robot.model.njoints):
        placement, axis = robot.model.jointPlacements[joint], robot.axis_in_joint_frame(joint)
        origins.append(origins[-1] + rotations[-1] @ placement.translation)
        frame, cross = rotations[-1] @ placement.rotation, pin.skew(axis)
        axes.append(frame @ axis)
        angle = q[joint - 1] if robot.revolute[joint - 1] else 0.0
        rotations.append(frame @ (np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross))

    def jacobian(joint: int, at: FloatArray) -> FloatArray:
        columns = np.zeros((3, robot.model.nv))
        place = origins[joint] + rotations[joint] @ at
        for j in range(1, joint + 1):
            columns[:, j - 1] = np.cross(axes[j], place - origins[j])
        return columns

    total = np.zeros((robot.model.nv, robot.model.nv))
    for joint, mass, at in points:
        total += mass * jacobian(joint, at).T @ jacobian(joint, at)
    frame = frame_of(robot)
    return total, jacobian(frame.parentJoint, frame.placement.translation)


def test_lumped_mobility_is_that_of_eq_14(dynamics: RobotDynamics) -> None:
    lumped = dynamics.lumped
    assert lumped is not None, dynamics.lumped_reason
    links = list(enumerate(lumped.links, start=1))
    pairs = [(joint, link.kappa1 * link.mass, np.array(link.point1)) for joint, link in links]
    pairs += [(joint, link.kappa2 * link.mass, np.array(link.point2)) for joint, link in links]
    added = [(mass.joint, mass.mass, np.array(mass.point)) for mass in lumped.masses]
    assert dynamics.robot.model.nv < len(added) <= len(pairs)
    assert sum(mass for _, mass, _ in added) == pytest.approx(sum(mass for _, mass, _ in pairs))
    assert sum(lumped.aggregated) == pytest.approx(sum(link.mass for link in lumped.links))
    for q in poses(dynamics.robot, 50):
        contact = contact_at(dynamics, q)
        matrix, jacobian = eq_14(dynamics.robot, pairs, q)
        assert agree(eq_14(dynamics.robot, added, q)[0], matrix)
        armature = np.zeros(len(q))
        armature[list(lumped.massless_joints)] = 1.0
        if ModelCode.LUMPED in contact.mobilities:
            assert agree(
                contact.mobilities[ModelCode.LUMPED],
                jacobian @ np.linalg.solve(matrix + np.diag(armature), jacobian.T),
                1e-6,
            )


def moved(robot: Robot, change: Callable[[pin.SE3], pin.SE3], *, base: bool) -> Robot:
    """Return the robot with `change` of the pose of its base, or else of every placement, CoM and inertia."""
    model = robot.model.copy()
    for joint in range(1, 2 if base else model.njoints):
        model.jointPlacements[joint] = change(model.jointPlacements[joint])
    if base:
        return replace(robot, model=model)
    for joint, body in enumerate(list(robot.model.inertias)[1:], start=1):
        inertia = MIRROR @ body.inertia @ MIRROR
        model.inertias[joint] = pin.Inertia(body.mass, MIRROR @ body.lever, (inertia + inertia.T) / 2.0)
    for frame in robot.contact_frames.values():
        model.frames[frame].placement = change(model.frames[frame].placement)
    return replace(robot, model=model, tip=change(robot.tip))


def test_turning_the_base_turns_the_mobilities(dynamics: RobotDynamics) -> None:
    turn = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.2, 0.9), np.array([1.0, 2.0, 3.0]))
    other = RobotDynamics(moved(dynamics.robot, lambda pose: turn * pose, base=True))
    for q in poses(dynamics.robot, 20):
        here, there = contact_at(dynamics, q).mobilities, contact_at(other, q).mobilities
        assert here.keys() == there.keys()
        assert all(agree(turn.rotation @ here[model] @ turn.rotation.T, there[model]) for model in here)


def test_mirrored_arm_has_mirrored_mobilities(dynamics: RobotDynamics) -> None:
    def mirrored(pose: pin.SE3) -> pin.SE3:
        return pin.SE3(MIRROR @ pose.rotation @ MIRROR, MIRROR @ pose.translation)

    robot = dynamics.robot
    other = RobotDynamics(moved(robot, mirrored, base=False))
    # A turn by q about u becomes one by -q about the mirrored u, which is u or -u.
    axes = [robot.axis_in_joint_frame(joint) for joint in range(1, robot.model.njoints)]
    signs = np.array([-float(axis @ MIRROR @ axis) for axis in axes])
    for q in poses(robot, 20):
        here, there = contact_at(dynamics, q).mobilities, contact_at(other, signs * q).mobilities
        assert here.keys() == there.keys()
        assert all(agree(MIRROR @ here[model] @ MIRROR, there[model], 1e-8) for model in here)


@pytest.mark.parametrize("arm", [arm for arm in ARMS if arm.axes == 7], ids=["panda", "xarm7"])
def test_seven_axes_at_singular_poses_allow_no_more_than_the_full_model(arm: Arm, load_urdf_file: Load) -> None:
    lumping = {"policy": "project_com", "free_parameters": "fit_inertia"}
    robot = load_urdf_file(arm.file, contact_points=(arm.contact_point,), lumping=lumping)
    dynamics = RobotDynamics(robot)
    lower, upper = robot.model.lowerPositionLimit, robot.model.upperPositionLimit
    rng = np.random.default_rng(RNG_SEED)
    aligned = np.clip(rng.choice([0.0, math.pi / 2.0, -math.pi / 2.0], (40, 7)), lower, upper)
    chosen = set()
    for q in (np.clip(np.zeros(7), lower, upper), *aligned):
        for qd in (np.full(7, 1e-9), rng.uniform(-0.5, 0.5, 7)):
            contacts = {}
            for model in ("auto", "full"):
                settings = MonitorSettings.model_validate({"effective_mass_model": model, "lumping": lumping})
                decision = Monitor(dynamics, settings).assess(JointState(NOW, robot.joint_names, q, qd), NOW)
                assert decision is not None
                (contacts[model],) = decision.contacts
            auto, full = contacts["auto"], contacts["full"]
            assert auto.verdict is not Verdict.UNKNOWN, auto.reason
            assert auto.allowable_speed * math.sqrt(0.9) <= full.allowable_speed * (1.0 + 1e-6)
            assert auto.effective_mass >= 0.9 * full.effective_mass * (1.0 - 1e-6)
            assert all(map(math.isfinite, (auto.effective_mass, auto.allowable_speed, auto.force_bound)))
            chosen.add(auto.mass_model)
    assert "full" in chosen


def test_lumped_mass_that_auto_takes_allows_no_more_than_the_full_model(load_urdf_file: Load) -> None:
    """Fast motions of an arm whose models differ little in mass, but more in the change of pose."""
    robot = load_urdf_file("kinova.urdf", contact_points=("j2s6s200_end_effector",))
    dynamics = RobotDynamics(robot)
    models = {
        name: MonitorSettings.model_validate({"effective_mass_model": name}) for name in ("auto", "lumped", "full")
    }
    monitors = {name: Monitor(dynamics, settings) for name, settings in models.items()}
    rng = np.random.default_rng(RNG_SEED)
    taken = 0
    for q in poses(robot, 300):
        qd = (
            rng.uniform(-1.0, 1.0, robot.model.nv) * np.minimum(robot.model.velocityLimit, 3.0) * rng.choice([0.2, 0.9])
        )
        contacts = {}
        for name, monitor in monitors.items():
            monitor.clear_history()
            decision = monitor.assess(JointState(NOW, robot.joint_names, q, qd), NOW)
            assert decision is not None
            (contacts[name],) = decision.contacts
        if contacts["auto"].mass_model == "lumped":
            taken += 1
            assert contacts["auto"].effective_mass == contacts["lumped"].effective_mass
            for other in ("lumped", "full"):
                assert contacts["auto"].allowable_speed <= contacts[other].allowable_speed * (1.0 + 1e-9)
    assert 100 < taken < 300

# SPDX-License-Identifier: Apache-2.0
"""Robot and settings as the arrays that the compiled functions read."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from struct import Struct
from typing import Any, NamedTuple

import numpy as np

from scara_effmass.iso15066.speed_limit import SpeedLimits
from scara_effmass.kernel import jit
from scara_effmass.kernel.functions import WORK, assess, assess_columns
from scara_effmass.kernel.records import (
    FIXED,
    MAX_JOINTS,
    MODELS,
    NORMALS,
    ROW,
    ByteArray,
    Case,
    Point,
    Setup,
    dtype_of,
)
from scara_effmass.model.lumping import is_scara, lumped_suffices
from scara_effmass.model.robot import Robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.settings import ContactType, Drives, MonitorSettings
from scara_effmass.values import ZERO_VECTOR, FloatArray, Vector3

BLOCK = 64
"""Number of joint states whose rows are turned into columns together: few enough for the first-level cache."""


def why_not(robot: Robot) -> str:
    """Return why the kernel cannot be used for `robot`, empty if it can."""
    if robot.model.nv > MAX_JOINTS:
        return f"the compiled kernel is for at most {MAX_JOINTS} joints, the robot has {robot.model.nv}"
    return jit.WHY_NOT


class SingleState(NamedTuple):
    """Memory of one joint state: `write` q, qd and the tolerances of qd in one call, `run`, and read the `rows`.

    `rows` are the bytes of P rows, as `records.Row` has them.
    """

    write: Callable[..., None]
    run: Callable[[], None]
    rows: memoryview


class ContactKernel:
    """Assesses joint states of one robot with one setting."""

    def __init__(self, dynamics: RobotDynamics, settings: MonitorSettings, limits: SpeedLimits) -> None:
        """Copy what the functions need. `limits` are those of `settings`."""
        robot, self._dynamics = dynamics.robot, dynamics
        model = robot.model
        regions = [limit.region for limit in limits.limits]
        lumped = dynamics.lumped
        models = (model if lumped is None else lumped.model, model)
        has_masses = not robot.masses_reason
        is_servo, clamps = settings.drives is Drives.SERVO, settings.contact is ContactType.QUASI_STATIC
        joints = range(1, model.njoints)
        normal_joint, normal = self._direction(settings.fixed_normal, settings.contact_normal_frame)
        test_joint, test = self._direction(settings.fixed_test_direction, settings.test_direction_frame)
        bodies = [list(of_model.inertias)[1:] for of_model in models]
        setup = Setup(
            joints=model.nv,
            parent=np.array([model.parents[joint] - 1 for joint in joints]),
            is_revolute=np.array(robot.revolute),
            is_massless=np.array([lumped is not None and joint - 1 in lumped.massless_joints for joint in joints]),
            effort=robot.effort_limits,
            rotation=np.array([model.jointPlacements[joint].rotation for joint in joints]),
            place=np.array([model.jointPlacements[joint].translation for joint in joints]),
            axis=np.array([robot.axis_in_joint_frame(joint) for joint in joints]),
            mass=np.array([[body.mass for body in of_model] for of_model in bodies]),
            armature=np.array([of_model.armature for of_model in models]),
            lever=np.array([[body.lever for body in of_model] for of_model in bodies]),
            inertia=np.array([[body.inertia for body in of_model] for of_model in bodies]),
            coupling=robot.rotors.coupling,
            normal_joint=normal_joint,
            normal_vector=normal,
            has_test=settings.fixed_test_direction is not None,
            test_joint=test_joint,
            test_vector=test,
            has_lumped=lumped is not None,
            has_full=not dynamics.full_reason,
            is_lumped_regular=lumped is None or lumped.is_regular,
            has_masses=has_masses,
            is_scara=is_scara(robot),
            lumped_suffices=lumped_suffices(robot),
            is_free=limits.is_free,
            is_servo=is_servo,
            joints_are_coupled=is_servo and settings.servo.computed_torque,
            joints_are_held=is_servo and not settings.servo.computed_torque,
            clamps=clamps,
            needs_gravity=is_servo or clamps,
            model=MODELS.index(settings.effective_mass_model),
            normal=NORMALS.index(settings.contact_normal) if settings.fixed_normal is None else FIXED,
            iso_mass=robot.iso_mass if has_masses else 0.0,
            mass_cap=settings.mass_cap,
            mass_factor=1.0 + settings.mass_uncertainty,
            model_margin=settings.model_margin,
            speed_threshold=settings.speed_threshold,
            person_speed=settings.person_speed,
            closing_speed=settings.person_speed + settings.speed_uncertainty,
            warn_ratio=settings.warn_ratio,
            external_force=settings.external_force_limit or math.inf,
            weakest_force=limits.weakest.permissible_force_n,
            min_alpha=limits.min_alpha,
            min_stiffness=limits.min_stiffness,
            max_drive_time=limits.max_drive_time,
            gravity=model.gravity.linear,
        )
        cases = [
            Case(
                region=regions.index(case.limit.region),
                is_pressure=case.criterion == "pressure",
                force=case.force,
                stiffness=case.stiffness,
                rate=case.rate,
                obstacle_mobility=case.obstacle_mobility,
                max_mu=case.obstacle_mass,
                drive_time=case.drive_time,
                nominal_stiffness=case.limit.stiffness_n_m,
                obstacle_mass=case.obstacle_mass,
                line_count=len(case.lines),
                lines=np.array(case.lines),
            )
            for case in limits.cases
        ]
        frames = [(model.frames[frame], rank) for _, frame, rank in dynamics.contacts]
        points = [Point(frame.parentJoint - 1, rank, frame.placement.translation) for frame, rank in frames]
        self._arrays = _bytes([setup]), _bytes(points), _bytes(cases)
        self._points = len(points)

    def _direction(self, vector: Vector3 | None, name: str) -> tuple[int, FloatArray]:
        """Return the joint that carries the frame `name`, -1 for the base, and `vector` in the axes of that joint."""
        model = self._dynamics.robot.model
        if vector is None or name in {"", self._dynamics.robot.base_frame}:
            return -1, np.array(vector or ZERO_VECTOR)
        frame = model.frames[self._dynamics.robot.frame_indices()[name]]
        return frame.parentJoint - 1, frame.placement.rotation @ np.array(vector)

    def columns(self, q: FloatArray, qd: FloatArray, velocity_tolerance: FloatArray) -> FloatArray:
        """Return the entries of `records.Row` field by field (fields, N, P), of P contact points at N joint states.

        `q`, `qd` and `velocity_tolerance` (N, n) are finite numbers.
        """
        columns = np.empty((ROW.itemsize // 8, len(q), self._points))
        states, scratch = np.stack((q, qd, velocity_tolerance), axis=1), np.empty(WORK.itemsize, np.uint8)
        assess_columns(states, *self._arrays, columns, self._new_rows(BLOCK), scratch)
        return columns

    def single_state(self) -> SingleState:
        """Return memory for assessing one joint state after another."""
        joints = self._dynamics.robot.model.nv
        state, rows = np.zeros((1, 3, joints)), self._new_rows(1)
        run = partial(assess, state, *self._arrays, rows, np.zeros(WORK.itemsize, np.uint8))
        return SingleState(
            partial(Struct(f"{state.size}d").pack_into, state.data.cast("B"), 0),
            run,
            rows.data.cast("B"),
        )

    def _new_rows(self, count: int) -> FloatArray:
        return np.zeros((self._points, count, ROW.itemsize // 8))


def _bytes(records: Sequence[Any]) -> ByteArray:
    """Return the bytes of `records`, all of one class; an array shorter than its field fills the first entries."""
    array = np.zeros(len(records), dtype_of(type(records[0])))
    for entry, record in zip(array, records, strict=True):
        for name in array.dtype.names or ():
            value = getattr(record, name)
            if np.ndim(value):
                entry[name][tuple(slice(size) for size in np.shape(value))] = value
            else:
                entry[name] = value
    return array.view(np.uint8)

# SPDX-License-Identifier: Apache-2.0
"""Robot and settings as the arrays that the compiled functions read."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import chain
from typing import Any

import numpy as np

from scara_effmass.iso15066 import ContactCase, contact_cases, limits_of
from scara_effmass.iso15066.allowable_speed import weakest_case
from scara_effmass.kernel.assess import assess_states
from scara_effmass.kernel.codes import MODELS, NORMALS, Normal
from scara_effmass.kernel.records import (
    MAX_JOINTS,
    WORK,
    ByteArray,
    Case,
    Point,
    Setup,
    dtype_of,
)
from scara_effmass.model.lumping import is_scara, lumped_suffices
from scara_effmass.model.robot import Robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.reference.dynamics import ContactPoint
from scara_effmass.reference.hull import hull_mobility
from scara_effmass.settings import ContactType, Drives, MonitorSettings
from scara_effmass.values import ZERO_VECTOR, FloatArray, Vector3


def too_large(robot: Robot) -> str:
    """Return why the kernel is not for `robot`, empty if it is."""
    if robot.model.nv > MAX_JOINTS:
        return f"the compiled kernel is for at most {MAX_JOINTS} joints, the robot has {robot.model.nv}"
    return ""


class ContactKernel:
    """Assesses joint states of one robot with one setting."""

    def __init__(self, dynamics: RobotDynamics, settings: MonitorSettings) -> None:
        """Copy what the functions need. Raises LimitError."""
        self._dynamics = dynamics
        limits = limits_of(settings, dynamics.contact_points)
        cases = [contact_cases(of_contact, settings) for of_contact in limits]
        points = [_point(dynamics.robot, *contact) for contact in zip(dynamics.contacts, cases, strict=True)]
        regions = [limit.region for limit in limits[0]]
        rows = [_case(case, regions.index(case.limit.region)) for case in chain(*cases)]
        self._arrays = _bytes([self._setup(settings, cases[0])]), _bytes(points), _bytes(rows)

    def _setup(self, settings: MonitorSettings, cases: Sequence[ContactCase]) -> Setup:
        """Return robot and settings, `cases` those of any contact: no field depends on their forces."""
        dynamics, robot, model = self._dynamics, self._dynamics.robot, self._dynamics.robot.model
        lumped = dynamics.lumped
        models = (model if lumped is None else lumped.model, model)
        has_masses = not robot.masses_reason
        is_servo, clamps = settings.drives is Drives.SERVO, settings.contact is ContactType.QUASI_STATIC
        joints = range(1, model.njoints)
        bodies = [list(of_model.inertias)[1:] for of_model in models]
        return Setup(
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
            **self._directions(settings),
            has_test=settings.fixed_test_direction is not None,
            has_lumped=lumped is not None,
            has_full=not dynamics.full_reason,
            is_lumped_regular=lumped is None or lumped.is_regular,
            has_masses=has_masses,
            is_scara=is_scara(robot),
            lumped_suffices=lumped_suffices(robot),
            is_free=settings.drives is Drives.FREE,
            is_servo=is_servo,
            joints_are_coupled=is_servo and settings.servo.computed_torque,
            joints_are_held=is_servo and not settings.servo.computed_torque,
            clamps=clamps,
            needs_gravity=is_servo or clamps,
            counts_person=settings.counts_person_velocity,
            has_person_direction=settings.fixed_person_direction is not None,
            model=MODELS.index(settings.effective_mass_model),
            normal=NORMALS.index(settings.contact_normal) if settings.fixed_normal is None else int(Normal.FIXED),
            iso_mass=robot.iso_mass if has_masses else 0.0,
            mass_cap=settings.mass_cap,
            mass_factor=1.0 + settings.mass_uncertainty,
            model_margin=settings.model_margin,
            speed_threshold=settings.speed_threshold,
            max_acceleration=settings.max_acceleration,
            reaction_time=settings.reaction_time,
            amplification=cases[0].amplification,
            person_speed=settings.person_speed,
            speed_uncertainty=settings.speed_uncertainty,
            warn_ratio=settings.warn_ratio,
            external_force=settings.external_force_limit or math.inf,
            min_alpha=min((alpha / beta for case in cases for alpha, beta in case.lines if beta), default=0.0),
            gravity=model.gravity.linear,
        )

    def _directions(self, settings: MonitorSettings) -> dict[str, Any]:
        """Return the fields of the directions that settings state."""
        stated = {
            "normal": (settings.fixed_normal, settings.contact_normal_frame),
            "test": (settings.fixed_test_direction, settings.test_direction_frame),
            "person": (settings.fixed_person_direction, settings.person_direction_frame),
        }
        fields: dict[str, Any] = {}
        for name, (vector, frame) in stated.items():
            fields[f"{name}_joint"], fields[f"{name}_vector"] = self._direction(vector, frame)
        return fields

    def _direction(self, vector: Vector3 | None, name: str) -> tuple[int, FloatArray]:
        """Return the joint that carries the frame `name`, -1 for the base, and `vector` in the axes of that joint."""
        model = self._dynamics.robot.model
        if vector is None or name in {"", self._dynamics.robot.base_frame}:
            return -1, np.array(vector or ZERO_VECTOR)
        frame = model.frames[self._dynamics.robot.frame_indices()[name]]
        return frame.parentJoint - 1, frame.placement.rotation @ np.array(vector)

    def bind(self, states: ByteArray, motions: FloatArray, numbers: FloatArray) -> Callable[[], None]:
        """Return what writes the contacts at the admitted ones of N joint states, as `assess_states`."""
        return assess_states.bind(states, motions, *self._arrays, numbers, np.empty(WORK.itemsize, np.uint8))


def _point(robot: Robot, contact: ContactPoint, cases: Sequence[ContactCase]) -> Point:
    frame, vertices = robot.model.frames[contact.frame], contact.vertices
    return Point(
        joint=frame.parentJoint - 1,
        rank=contact.rank,
        place=frame.placement.translation,
        rotation=frame.placement.rotation,
        weakest=cases.index(weakest_case(cases)),
        hull_mobility=hull_mobility(cases),
        vertex_count=len(vertices),
        vertices=vertices,
    )


def _case(case: ContactCase, region: int) -> Case:
    """Return the record of `case`, whose limit is that of `region`, an index."""
    return Case(
        region=region,
        is_pressure=case.limit.criterion == "pressure",
        force=case.force,
        stiffness=case.stiffness,
        rate=case.stiffness / case.force**2,
        obstacle_mobility=case.obstacle_mobility,
        drive_time=case.drive_time or 0.0,
        nominal_stiffness=case.limit.stiffness_n_m,
        body_mass=case.limit.body_mass_kg,
        line_count=len(case.lines),
        lines=np.array(case.lines),
    )


def _bytes(records: Sequence[Any]) -> ByteArray:
    """Return the bytes of `records`, all of one class; an array shorter than its field fills the first entries."""
    kind: type = type(records[0])
    array = np.zeros(len(records), dtype_of(kind))
    for entry, record in zip(array, records, strict=True):
        for name in array.dtype.names or ():
            value = getattr(record, name)
            if np.ndim(value):
                entry[name][tuple(slice(size) for size in np.shape(value))] = value
            else:
                entry[name] = value
    return array.view(np.uint8)

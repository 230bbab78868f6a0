"""A serial robot as every model of this room sees it, whatever file it came from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from scara_effmass.errors import RobotError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from scara_effmass.values import FloatArray, Vector3

SAMPLES = 64
"""Configurations, spread over the joint ranges, at which structural properties are read off a model."""


@dataclass(frozen=True, slots=True)
class Robot:
    """Kinematics, masses and limits of one serial robot, payload included.

    `model` is Pinocchio's, one degree of freedom per joint, bodies carrying their full inertia tensors as far as
    the file states them. The distal axis of the last link, which no joint follows, is the parallel to its own axis
    through `tool_point`, in the last joint's frame [m]. A `*_reason` is empty when that kind of data can be believed.
    """

    name: str
    origin: str
    base_frame: str
    model: pin.Model
    contact_frames: Mapping[str, int]
    tool_point: Vector3
    payload_mass: float
    masses_reason: str
    coms_reason: str
    inertias_reason: str
    notes: tuple[str, ...]

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Joints that the model moves, in its order."""
        return tuple(self.model.names)[1:]

    @property
    def revolute(self) -> tuple[bool, ...]:
        """Whether each joint turns (else it slides)."""
        return tuple(joint.shortname().startswith("JointModelR") for joint in list(self.model.joints)[1:])

    @property
    def moving_mass(self) -> float:
        """M of Eq. 17: mass of all moving links without the payload [kg]."""
        return float(sum(inertia.mass for inertia in list(self.model.inertias)[1:])) - self.payload_mass

    @property
    def iso_mass(self) -> float:
        """m_R = M/2 + m_L, the configuration-independent effective mass of ISO/TS 15066 (Eq. 17) [kg]."""
        return self.moving_mass / 2.0 + self.payload_mass

    def axis_in_joint_frame(self, joint: int) -> FloatArray:
        """Return the unit axis (3,) of joint `joint` (1-based, as Pinocchio counts) in its own frame."""
        data = self.model.joints[joint].createData()
        self.model.joints[joint].calc(data, pin.neutral(self.model), np.ones(self.model.nv))
        motion = data.v
        axis = motion.angular if self.revolute[joint - 1] else motion.linear
        return np.asarray(axis, dtype=np.float64)

    def sample_configurations(self) -> FloatArray:
        """Return (SAMPLES, n) configurations spread over the joint ranges, the same on every call [rad, m]."""
        lower = np.maximum(self.model.lowerPositionLimit, -np.pi)
        upper = np.minimum(self.model.upperPositionLimit, np.pi)
        # The generalised golden ratio spreads points evenly in any dimension, and without a seed.
        n = self.model.nv
        ratio = 2.0
        for _ in range(50):
            ratio = (1.0 + ratio) ** (1.0 / (n + 1))
        steps = ratio ** -np.arange(1, n + 1)
        fractions = (0.5 + np.outer(np.arange(1, SAMPLES + 1), steps)) % 1.0
        return np.asarray(lower + fractions * (upper - lower), dtype=np.float64)


def finished(model: pin.Model, origin: str, **facts: object) -> Robot:
    """Check a freshly read model for placeholder data and return the Robot.

    Raises RobotError where nothing could be said of any effective mass: no joint, or no mass.
    """
    bodies = list(model.inertias)[1:]
    if not bodies:
        raise RobotError(f"{origin}: no joint moves, so there is nothing to watch")
    masses = np.array([body.mass for body in bodies])
    if not np.all(np.isfinite(masses)) or np.any(masses < 0.0) or masses.sum() <= 0.0:
        raise RobotError(f"{origin}: masses of the moving links are {masses.tolist()}: give every link its mass")
    heavy = [body for body in bodies if body.mass > 0.0]
    coms_reason = ""
    if len(heavy) > 1 and all(np.allclose(body.lever, 0.0) for body in heavy):
        coms_reason = "every centre of mass lies at its link's origin: placeholders, not data"
    tensors = [np.asarray(body.inertia) for body in heavy]
    inertias_reason = coms_reason
    masses_reason = ""
    if all(np.allclose(tensor, 0.0) for tensor in tensors):
        inertias_reason = "the file gives no inertia tensors"
    elif len(heavy) > 1 and all(np.allclose(tensor, np.eye(3)) for tensor in tensors):
        inertias_reason = "every inertia tensor is the identity: placeholders, not data"
        if np.allclose(masses, 1.0):
            masses_reason = coms_reason = "every link has mass 1 and identity inertia: placeholders, not data"
    for name, body in zip(list(model.names)[1:], bodies, strict=True):
        moments = np.linalg.eigvalsh(body.inertia)
        if not inertias_reason and (moments[0] < -1e-9 or moments[2] > moments[0] + moments[1] + 1e-9):
            inertias_reason = (
                f"the inertia of the link behind {name} cannot belong to a body: principal moments "
                f"{np.array2string(moments, precision=6)} kg m2 break positivity or the triangle inequality"
            )
    return Robot(
        model=model,
        origin=origin,
        masses_reason=masses_reason,
        coms_reason=coms_reason,
        inertias_reason=inertias_reason,
        **facts,  # type: ignore[arg-type]
    )

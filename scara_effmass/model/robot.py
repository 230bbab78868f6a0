"""A serial robot as every model of this room sees it, whatever file it came from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from scara_effmass.errors import RobotError
from scara_effmass.iso15066 import robot_mass
from scara_effmass.model.inertial_check import check_inertials

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from scara_effmass.model.inertial_check import StatedLink
    from scara_effmass.values import FloatArray, Vector3

PARALLEL = 2e-3
"""Sine of the angle below which two axes count as parallel: files write pi as 3.14."""
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
        return robot_mass(self.moving_mass, self.payload_mass)

    def axis_in_joint_frame(self, joint: int) -> FloatArray:
        """Return the unit axis (3,) of joint `joint` (1-based, as Pinocchio counts) in its own frame."""
        data = self.model.joints[joint].createData()
        self.model.joints[joint].calc(data, pin.neutral(self.model), np.ones(self.model.nv))
        motion = data.v
        axis = motion.angular if self.revolute[joint - 1] else motion.linear
        return np.asarray(axis, dtype=np.float64)

    def sample_configurations(self) -> FloatArray:
        """Return (SAMPLES, n) configurations spread over the joint ranges, the same on every call [rad, m].

        Of a range wider than a turn, the turn around its point nearest to zero is sampled.
        """
        lower, upper = self.model.lowerPositionLimit, self.model.upperPositionLimit
        centre = np.clip(0.0, lower, upper)
        lower, upper = np.maximum(lower, centre - np.pi), np.minimum(upper, centre + np.pi)
        # The generalised golden ratio spreads points evenly in any dimension, and without a seed.
        n = self.model.nv
        ratio = 2.0
        for _ in range(50):
            ratio = (1.0 + ratio) ** (1.0 / (n + 1))
        steps = ratio ** -np.arange(1, n + 1)
        fractions = (0.5 + np.outer(np.arange(1, SAMPLES + 1), steps)) % 1.0
        return np.asarray(lower + fractions * (upper - lower), dtype=np.float64)


def build_robot(
    model: pin.Model, origin: str, links: Sequence[StatedLink], notes: Sequence[str], **facts: object
) -> Robot:
    """Return the Robot of a freshly read `model`, made of `links`, with what is to be doubted about them.

    Raises RobotError where nothing could be said of any effective mass: no joint, or no mass.
    """
    if model.nv == 0:
        raise RobotError(f"{origin}: no joint moves, so there is nothing to watch")
    if not any(link.mass > 0.0 for link in links):
        raise RobotError(f"{origin}: the moving links have no mass: give each one its mass and centre of mass")
    doubts = check_inertials(links)
    bodies = zip(list(model.names)[1:], list(model.inertias)[1:], strict=True)
    light = [joint for joint, body in bodies if body.mass == 0.0]
    masses_reason = doubts.masses
    if light:
        masses_reason = f"no mass behind {', '.join(light)}: the robot is heavier than the file says"
    return Robot(
        model=model,
        origin=origin,
        masses_reason=masses_reason,
        coms_reason=masses_reason or doubts.coms,
        inertias_reason=masses_reason or doubts.coms or doubts.inertias,
        notes=(*notes, *doubts.notes),
        **facts,  # type: ignore[arg-type]
    )

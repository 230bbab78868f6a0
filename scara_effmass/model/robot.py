"""A serial robot as every model of this room sees it, whatever file it came from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin

from scara_effmass.errors import RobotError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

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


class StatedLink(NamedTuple):
    """One moving link as its file states it, before fixed links and payload are added to it.

    `com` (3,) [m] and `inertia` (3, 3) [kg m2], about the centre of mass, are in axes of the file's choice.
    """

    name: str
    mass: float
    com: FloatArray
    inertia: FloatArray

    @property
    def placeholder(self) -> bool:
        """Whether the inertia is the identity, or the mass times it: numbers that no link of a robot arm has."""
        return any(np.allclose(self.inertia, scale * np.eye(3), rtol=1e-6, atol=0.0) for scale in (1.0, self.mass))


def finished(model: pin.Model, origin: str, links: Sequence[StatedLink], notes: Sequence[str], **facts: object) -> Robot:
    """Judge how far the data of a freshly read `model`, made of `links`, can be believed, and return the Robot.

    Raises RobotError where nothing could be said of any effective mass: no joint, or no mass.
    """
    if model.nv == 0:
        raise RobotError(f"{origin}: no joint moves, so there is nothing to watch")
    heavy = [link for link in links if link.mass > 0.0]
    if not heavy:
        raise RobotError(f"{origin}: the moving links have no mass: give each one its mass and centre of mass")
    light = [name for name, body in zip(list(model.names)[1:], list(model.inertias)[1:], strict=True) if body.mass == 0.0]
    fake = [link.name for link in heavy if link.placeholder]
    masses_reason = coms_reason = inertias_reason = ""
    if light:
        masses_reason = f"no mass behind {', '.join(light)}: the robot is heavier than the file says"
    elif len(heavy) > 1 and len(fake) == len(heavy) and all(link.mass == 1.0 for link in heavy):
        masses_reason = "every link has mass 1 and identity inertia: placeholders, not data"
    if len(heavy) > 1 and all(np.allclose(link.com, 0.0) for link in heavy):
        coms_reason = "every centre of mass lies at its link's origin: placeholders, not data"
    if all(np.allclose(link.inertia, 0.0, atol=1e-12) for link in heavy):
        inertias_reason = "the file gives no inertia tensors"
    elif len(heavy) > 1 and len(fake) == len(heavy):
        inertias_reason = "every inertia tensor is the identity, or the mass times it: placeholders, not data"
    elif fake:
        notes = (*notes, f"placeholder inertia, taken as it stands, which errs to the heavy side: {', '.join(fake)}")
    for link in heavy:
        low, middle, high = principal_moments(link.inertia)
        if not inertias_reason and high > (low + middle) * (1.0 + 1e-3) + 1e-12:
            inertias_reason = (
                f"the inertia of {link.name} cannot belong to a body: of its principal moments "
                f"({low:.6g}, {middle:.6g}, {high:.6g}) kg m2 the largest exceeds the sum of the others"
            )
    return Robot(
        model=model,
        origin=origin,
        masses_reason=masses_reason,
        coms_reason=masses_reason or coms_reason,
        inertias_reason=masses_reason or coms_reason or inertias_reason,
        notes=tuple(notes),
        **facts,  # type: ignore[arg-type]
    )


def principal_moments(inertia: FloatArray) -> tuple[float, float, float]:
    """Return the principal moments of an inertia tensor (3, 3), ascending. Raises ValueError where one is negative."""
    low, middle, high = np.linalg.eigvalsh(inertia).tolist()
    if low < -1e-9 * high or high < 0.0:
        raise ValueError(f"inertia has the principal moments ({low:.6g}, {middle:.6g}, {high:.6g}): none may be negative")
    return low, middle, high

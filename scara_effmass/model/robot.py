"""Serial robot, independent of its file format."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from scara_effmass.errors import RobotError
from scara_effmass.iso15066 import robot_mass
from scara_effmass.model.inertial_check import StatedLink, check_inertials
from scara_effmass.model.rotors import RotorInertia
from scara_effmass.values import FloatArray, Vector3

PARALLEL = 2e-3
"""Sine of the angle below which two axes count as parallel, because some files write pi as 3.14."""
UNKNOWN_EFFORT = 1e9
"""Effort limit from which on none is stated; URDF files write 0 as well."""
SAMPLES = 64
"""Number of configurations at which structural properties of a model are evaluated."""


@dataclass(frozen=True, slots=True)
class Robot:
    """Kinematics, inertial data and limits of one serial robot, payload included.

    `model` has one degree of freedom per joint and the inertia tensors that the file states; its armature is the
    diagonal of the matrix of `rotors`, and `mass_matrix` adds the rest. `contact_frames` maps
    contact points to frame ids. The distal axis of the last link is parallel to its joint axis through `tool_point`
    [m], in the last joint's frame. A `*_reason` states why masses, centres of mass (CoM) or inertias are implausible;
    it is empty if they are plausible.
    """

    name: str
    origin: str
    base_frame: str
    model: pin.Model
    contact_frames: Mapping[str, int]
    tool_point: Vector3
    payload_mass: float
    rotors: RotorInertia
    masses_reason: str
    coms_reason: str
    inertias_reason: str
    notes: tuple[str, ...]

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the model's joints, in its order."""
        return tuple(self.model.names)[1:]

    @property
    def revolute(self) -> tuple[bool, ...]:
        """Whether each joint is revolute (else prismatic)."""
        return tuple(joint.shortname().startswith("JointModelR") for joint in list(self.model.joints)[1:])

    @property
    def effort_limits(self) -> FloatArray:
        """Effort limits (n,) of the joints [N m, N]; infinite where the description states none."""
        effort = np.asarray(self.model.effortLimit, dtype=np.float64)
        return np.where((effort > 0.0) & (effort < UNKNOWN_EFFORT), effort, np.inf)

    @property
    def moving_mass(self) -> float:
        """Mass M of all moving links without the payload [kg] (Eq. 17)."""
        return float(sum(inertia.mass for inertia in list(self.model.inertias)[1:])) - self.payload_mass

    @property
    def iso_mass(self) -> float:
        """Effective mass m_R of ISO/TS 15066 [kg] (Eq. 17), see `iso15066.robot_mass`."""
        return robot_mass(self.moving_mass, self.payload_mass)

    def mass_matrix(self, model: pin.Model, data: pin.Data, q: FloatArray) -> FloatArray:
        """Return the mass matrix (n, n) of `model`, this robot's or its lumped copy, rotors included."""
        return np.asarray(pin.crba(model, data, q) + self.rotors.coupling)

    def axis_in_joint_frame(self, joint: int) -> FloatArray:
        """Return the unit axis (3,) of `joint` (1-based, as in Pinocchio) in its own frame."""
        data = self.model.joints[joint].createData()
        self.model.joints[joint].calc(data, pin.neutral(self.model), np.ones(self.model.nv))
        motion = data.v
        axis = motion.angular if self.revolute[joint - 1] else motion.linear
        return np.asarray(axis, dtype=np.float64)

    def sample_configurations(self) -> FloatArray:
        """Return (SAMPLES, n) configurations [rad, m] spread evenly over the joint ranges, the same on every call.

        A range wider than one turn is sampled over the turn around its value nearest to zero.
        """
        lower, upper = self.model.lowerPositionLimit, self.model.upperPositionLimit
        centre = np.clip(0.0, lower, upper)
        lower, upper = np.maximum(lower, centre - np.pi), np.minimum(upper, centre + np.pi)
        # The generalised golden ratio gives a low-discrepancy sequence in n dimensions, without a seed.
        n = self.model.nv
        ratio = 2.0
        for _ in range(50):
            ratio = (1.0 + ratio) ** (1.0 / (n + 1))
        steps = ratio ** -np.arange(1, n + 1)
        fractions = (0.5 + np.outer(np.arange(1, SAMPLES + 1), steps)) % 1.0
        return np.asarray(lower + fractions * (upper - lower), dtype=np.float64)


def build_robot(
    model: pin.Model,
    origin: str,
    links: Sequence[StatedLink],
    rotors: RotorInertia,
    notes: Sequence[str],
    **fields: object,
) -> Robot:
    """Return the Robot of `model` with `rotors` and the plausibility check of its `links`; `fields` go to Robot.

    Raises RobotError for a model without joints or without mass.
    """
    if model.nv == 0:
        raise RobotError(f"{origin}: must have at least one joint that moves")
    if not any(link.mass > 0.0 for link in links):
        raise RobotError(f"{origin}: the moving links have no mass: every link must have its mass and centre of mass")
    check = check_inertials(links)
    bodies = zip(list(model.names)[1:], list(model.inertias)[1:], strict=True)
    massless = [joint for joint, body in bodies if body.mass == 0.0]
    masses_reason = check.masses
    if massless:
        masses_reason = f"no mass behind {', '.join(massless)}: the robot is heavier than the file says"
    model.armature = np.diag(rotors.matrix)
    return Robot(
        model=model,
        origin=origin,
        rotors=rotors,
        masses_reason=masses_reason,
        coms_reason=masses_reason or check.coms,
        inertias_reason=masses_reason or check.coms or check.inertias,
        notes=(*notes, *check.notes, *rotors.notes, *filter(None, [rotors.warning])),
        **fields,  # type: ignore[arg-type]
    )

# SPDX-License-Identifier: Apache-2.0
"""What the assessments assume of robot and situation, and whether assuming it can make a verdict too permissive.

An assumption is stated if the robot file or a parameter states it, or a topic. While one that can make a verdict too
permissive is neither stated nor accepted, no verdict is OK. What an OK covers, and which mass decides from what, is in
`scope` and `deciding_mass`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from scara_effmass.codes import Assumption
from scara_effmass.model.lumping import lumped_suffices
from scara_effmass.model.robot import Robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.settings import PAYLOAD_CONTACT, WHOLE_ARM, MassModel, MonitorSettings

Codes = tuple[Assumption, ...]


class Rule(NamedTuple):
    """Row of the table of assumptions.

    `is_stated` says whether `parameters` or the robot state it, `text` what is assumed otherwise, and by which option
    to state it. `is_permissive`: assuming it can make a verdict too permissive.
    """

    is_permissive: bool
    parameters: tuple[str, ...]
    text: str
    is_stated: Callable[[Robot], bool] = lambda _: False


RULES: Mapping[Assumption, Rule] = {
    Assumption.PAYLOAD: Rule(
        is_permissive=True,
        parameters=("payload_mass", "payload_topic"),
        text="payload not stated: --payload 0 if there is none, else with its --payload-com",
    ),
    Assumption.ROTOR_INERTIA: Rule(
        is_permissive=True,
        parameters=(),
        text="rotor inertia not stated: --armature JOINT=VALUE for each joint",
        is_stated=lambda robot: not robot.rotors.unstated,
    ),
    Assumption.DRIVES: Rule(
        is_permissive=False,
        parameters=("drives",),
        text="drives not stated, assumed to push on as a position control does: --drives free for joints that yield",
    ),
    Assumption.CONTACT_AREA: Rule(
        is_permissive=True,
        parameters=("contact_area_m2",),
        text="contact area not stated, assumed to be 1 cm2: --contact-area-m2 of the smallest area that can hit",
    ),
    Assumption.CONTACT_SURFACE: Rule(
        is_permissive=False,
        parameters=("contact_normal",),
        text="contact surface not stated, any normal counts: --contact-normal for a known one",
    ),
    Assumption.PERSON_SPEED: Rule(
        is_permissive=True,
        parameters=("person_speed",),
        text="person's speed not stated, assumed to be 0: --person-speed, 0 for a person who stands still",
    ),
    Assumption.CONTACT_POINTS: Rule(
        is_permissive=True,
        parameters=("contact_points",),
        text="contact points not stated, not every moving link is watched: --contact-point whole_arm with the geometry "
        "of every link, or each that can hit",
        is_stated=lambda robot: bool({*robot.hulls} - {PAYLOAD_CONTACT}) and not robot.unwatched,
    ),
    Assumption.MASSES: Rule(
        is_permissive=True,
        parameters=(),
        text="inertial data missing or placeholders, ISO's mass counts: state mass, centre of mass and inertia of each "
        "link in the robot file",
        is_stated=lambda robot: not mass_source(robot),
    ),
    Assumption.ACCELERATION: Rule(
        is_permissive=True,
        parameters=("max_acceleration", "max_joint_acceleration"),
        text="acceleration not stated, that of the joint states counts: --max-acceleration of the contact points, 0 if "
        "it does not rise during a contact, or --max-joint-acceleration",
    ),
    Assumption.CONTACT_DAMPING: Rule(
        is_permissive=True,
        parameters=("contact_damping",),
        text="contact damping not stated, assumed to be 0: --contact-damping RATIO, 0 for an elastic contact as in "
        "ISO's model",
    ),
    Assumption.CONTACT_FRICTION: Rule(
        is_permissive=True,
        parameters=("contact_friction",),
        text="contact friction not stated, assumed to be 0: --contact-friction, 0 for a force along the normal as in "
        "ISO's model",
    ),
}
"""A row for each assumption, in the order of the messages."""


@dataclass(frozen=True)
class Assumptions:
    """Assumptions that nothing states: those that count, and those that `accept_assumptions` accepts."""

    assumed: Codes = ()
    accepted: Codes = ()

    @property
    def limiting(self) -> Codes:
        """Those that make WARN of an OK."""
        return tuple(code for code in self.assumed if RULES[code].is_permissive)

    @property
    def reason(self) -> str:
        """Why no verdict is OK, such as "payload not stated: …"; empty if one can be."""
        if not self.limiting:
            return ""
        first, *others = self.limiting
        names = f"; also assumed: {', '.join(map(name_of, others))}" if others else ""
        return f"{RULES[first].text}{names}"

    @property
    def lines(self) -> list[tuple[str, str]]:
        """What to print of each: its name, and its text with the option that states it."""
        accepted = [(name_of(code), f"accepted: {RULES[code].text}") for code in self.accepted]
        return [*((name_of(code), RULES[code].text) for code in self.assumed), *accepted]

    def as_dict(self) -> dict[str, dict[str, str]]:
        """Return the texts by kind and name, for JSON."""
        kinds = {"assumed": self.assumed, "accepted": self.accepted}
        return {kind: {name_of(code): RULES[code].text for code in codes} for kind, codes in kinds.items()}


NO_ASSUMPTIONS = Assumptions()
"""Those of no robot."""


def name_of(code: Assumption) -> str:
    """Return the name of an assumption in `accept_assumptions`."""
    return code.name.lower()


def assumptions_of(robot: Robot, settings: MonitorSettings) -> Assumptions:
    """Return what neither the file of `robot` nor `settings` state."""
    # An empty list or topic states nothing.
    stated = {name for name in settings.model_fields_set if getattr(settings, name) not in ((), "")}
    if robot.unwatched and WHOLE_ARM in settings.contact_points:
        stated -= {"contact_points"}
    assumed = [
        code
        for code, rule in RULES.items()
        if code not in robot.stated and not stated.intersection(rule.parameters) and not rule.is_stated(robot)
    ]
    if settings.payload_mass and "payload_com" not in stated and not robot.coms_reason:  # its place counts, too
        assumed = sorted({*assumed, Assumption.PAYLOAD})
    accepted = tuple(code for code in assumed if name_of(code) in settings.accept_assumptions)
    return Assumptions(tuple(code for code in assumed if code not in accepted), accepted)


def mass_source(robot: Robot) -> str:
    """Return why ISO's mass counts in place of the masses of the robot file, empty if those suffice."""
    if robot.coms_reason:
        return robot.coms_reason
    return "" if lumped_suffices(robot) else robot.inertias_reason


def scope(robot: Robot, settings: MonitorSettings) -> str:
    """Return what an OK covers: points watched, person, load, the joints whose links are not watched, the robot."""
    points = ", ".join(robot.contact_frames)
    watched = {robot.model.frames[frame].parentJoint for frame in robot.contact_frames.values()}
    others = [name for joint, name in enumerate(robot.joint_names, start=1) if joint not in watched]
    person = f"a person at {settings.person_speed:g} m/s" if settings.person_speed else "a person who stands still"
    text = f"slower than the allowable speed at {points}, for {person} and a load of {robot.payload_text}"
    text += f"; not watched: the links behind {', '.join(others)}" if others else ""
    ignored = [*settings.ignored_joints, *(joint.name for joint in robot.held if joint.is_harmless)]
    text += f"; robot {robot.name} ({Path(robot.origin).name})"
    return f"{text}; motion does not count of {', '.join(ignored)}" if ignored else text


def deciding_mass(dynamics: RobotDynamics, model: MassModel) -> str:
    """Return which effective mass decides the verdict with the setting `model`, and from what."""
    full, lumped = "full from masses, centres of mass and inertia tensors", "lumped from masses and centres of mass"
    iso = "ISO's M/2 + m_L from the masses alone"
    sources = {MassModel.LUMPED: lumped, MassModel.FULL: full, MassModel.ISO: iso, MassModel.LARGEST: "the largest"}
    if model is not MassModel.AUTO:
        return sources[model]
    if not dynamics.full_reason:
        return full if dynamics.lumped is None else f"{lumped}, {full} where lumped is too light (model_margin)"
    missing = f"no full mass: {dynamics.full_reason}"
    if dynamics.lumped is None:
        return f"{iso}: {missing}"
    masses = lumped if lumped_suffices(dynamics.robot) else f"the heavier of {lumped}, and {iso}"
    return f"{masses}: {missing}"

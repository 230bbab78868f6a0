# SPDX-License-Identifier: Apache-2.0
"""Texts of verdicts: which model decides and why, and the reason if the verdict is not OK. Codes are in `codes`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from scara_effmass.codes import Reason
from scara_effmass.iso15066 import MIN_EFFECTIVE_MASS, Limit
from scara_effmass.kernel.state import CODE, DETAIL, HELD, JOINT, LATCHED, VALUES, WORDS
from scara_effmass.model.lumping import lumped_suffices
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety.assumptions import Assumptions, scope
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import at_least, at_most, speed_texts

NOT_DEFINITE = "the lumped mass matrix is singular or not positive definite at this pose"
MASSLESS = "a joint moves the contact point, but no lumped mass"
MODELS = ("", "lumped", "full", "iso")
CRITERIA = ("", "force", "pressure")
HELD_AFTER = "held after: "
"""Prefix of the reason of a verdict that is held from an earlier joint state."""
LATCHED_UNTIL_RESET = "latched until reset: "
LOAD_ENTRY = "load by the torques"
"""Subject of the estimated load in diagnostics and summaries."""
OTHER_JOINTS = "({v[1]:.0f} named none of the robot's joints){detail}"

TEXTS = {
    Reason.NONE: "",
    Reason.UNDECODABLE: "{detail}",
    Reason.NO_NAMES: "the joint state has no names",
    Reason.EMPTY_NAME: "name {v[0]:.0f} of the joint state is empty",
    Reason.NAMED_TWICE: "joint {detail} is named twice",
    Reason.MISSING_JOINT: "joint {joint} is missing{detail}",
    Reason.SEVERAL_NAMES: "joint_map gives joint {detail}",
    Reason.OTHER_ARM: "joint states of another arm than {robot}, which has no {detail}",
    Reason.POSITION_COUNT: "{v[0]:.0f} positions for {v[1]:.0f} names",
    Reason.VELOCITY_COUNT: "{v[0]:.0f} velocities for {v[1]:.0f} names",
    Reason.NO_VELOCITY: "the velocity is empty: set velocity_source to from_positions",
    Reason.LONE_POSITION: "the velocity is empty, and one joint state alone cannot be differentiated",
    Reason.SECOND_PUBLISHER: (
        "a second publisher, or a restarted one: joint state number {v[0]:.0f} follows number {v[1]:.0f}"
    ),
    Reason.ZERO_STAMP: "the header stamp is zero or negative",
    Reason.FUTURE_STAMP: "the header stamp is {v[0]:.3f} s in the future",
    Reason.COARSE_CLOCK: (
        "the header stamp is {v[0]:.3f} s in the future: /clock moves in steps of {v[1]:.3f} s, above half of timeout"
    ),
    Reason.OLD_STAMP: "the joint state is {v[0]:.3f} s old",
    Reason.REPEATED_STAMP: "the header stamp is repeated",
    Reason.BACKWARD_STAMP: "the header stamp goes back by {v[0]:.6f} s",
    Reason.TWO_PUBLISHERS: "{detail}",
    Reason.POSITION_NOT_FINITE: "the position of {joint} is {v[0]}",
    Reason.VELOCITY_NOT_FINITE: "the velocity of {joint} is {v[0]}",
    Reason.POSITION_LIMIT: "{joint} at {v[0]:.4f} {unit} lies outside its limits {v[1]:.4f} to {v[2]:.4f}",
    Reason.SPEED_LIMIT: "{joint} at {speed} {unit}/s exceeds its maximum speed of {allowed} {unit}/s",
    Reason.VELOCITY_MISMATCH: "the position of {joint} is {v[0]:+.4f} {unit} off the integral of its velocity",
    Reason.UNCONFIRMED_ZERO: "the velocity of {joint} reads zero, not yet confirmed by its position",
    Reason.NO_COMMAND: "no joint command yet",
    Reason.OLD_COMMAND: "no joint command for {v[0]:.3f} s",
    Reason.COMMAND_MISMATCH: "{joint} is {v[0]:+.4f} {unit} off its command",
    Reason.PAYLOAD_UNKNOWN: "{detail}",
    Reason.GAP: "no valid joint state for {v[0]:.3f} s",
    Reason.SILENCE: "no valid joint state for {v[0]:.2f} s",
    Reason.NO_JOINT_STATE: "no joint state yet",
    Reason.ONLY_OTHER_JOINTS: f"no joint state yet {OTHER_JOINTS}",
    Reason.OTHER_JOINTS_SINCE: f"no valid joint state for {{v[0]:.2f}} s {OTHER_JOINTS}",
    Reason.UNMODELLED_MOTION: "joint {detail}, but is not in the model",
    Reason.HELD_ELSEWHERE: "joint {detail} is at {v[0]:.4g}, but the model holds it at {v[1]:.4g}",
    Reason.HELD_UNREPORTED: "not every joint that the model holds fixed is reported: {detail}",
    Reason.NO_MASSES: "{masses}",
    Reason.NO_LUMPED_MASS: "no lumped mass ({lumped}): choose effective_mass_model auto, full or iso",
    Reason.NO_FULL_MASS: "no full mass ({full}): choose effective_mass_model auto, lumped or iso",
    Reason.NO_CLAMPING_FORCE: (
        "the clamping force is unknown: state effort limits in the robot file that carry the arm, or "
        "external_force_limit"
    ),
    Reason.TOO_LIGHT: "{model} mass = {v[1]:.3g} kg: must be at least {min_mass:g} kg: check the robot",
    Reason.NO_WORST_MASS: (
        "no {model} mass for every contact normal, because a joint moves no lumped mass: choose "
        "effective_mass_model auto or full, or contact_normal velocity"
    ),
    Reason.TOO_FAST: "{speed} m/s is above the {allowed} m/s that the {criterion} limit of {region} allows",
    Reason.NEAR_LIMIT: "{speed} m/s is close to the {allowed} m/s that the {criterion} limit of {region} allows",
    Reason.PERSON_TOO_FAST: (
        "a person at {speed} m/s leaves no speed: the {criterion} limit of {region} allows {allowed} m/s with the "
        "robot at rest: state a lower person_speed, its direction or other body_regions, or lower the moving mass"
    ),
    Reason.LIGHT_MODEL: "the {choice} mass of {v[4]:.3g} kg is below the {best} model's {v[5]:.3g} kg",
    Reason.ASSUMED: "{assumed}",
    Reason.CLAMPED: "the drives can clamp with {force} N, above the {limit} N of {region}, at any speed",
    Reason.UNSTATED_LOAD: "{detail}: the robot is heavier than its masses with `mass_uncertainty`",
    Reason.HEAVIER_LOAD: "{detail}",
    Reason.TURNS: (
        "{joint} accelerates: until the peak of a contact it would turn {v[0]:.2g} {unit} further than at constant "
        "velocity, more than the force is computed for"
    ),
    Reason.KERNEL_DISAGREES: "the compiled kernel disagrees with the reference in {detail}",
    Reason.TOO_SLOW: "the assessment took {v[0]:.3f} s",
    Reason.STUCK: "the assessment of a joint state takes too long",
    Reason.NO_ROBOT: "{detail}",
    Reason.ROBOT_CHANGES: "a new robot_description is being read",
    Reason.DEACTIVATED: "the monitor was deactivated",
    Reason.SHUTDOWN: "the node shuts down",
    Reason.NODE_ERROR: "the node ends: {detail}",
    Reason.STATED: "{detail}",
    Reason.NO_MONITOR: "no monitor: contact_states has no publisher",
    Reason.TWO_MONITORS: "two monitors publish contact_states: must be one",
    Reason.MONITOR_SILENT: "the monitor is silent: no contact states for {v[0]:.1f} s",
    Reason.NO_CONTACT_STATES: "no contact states yet",
}
"""English text of each code: `v` are its numbers, `joint` and `unit` those of its joint, `detail` its own text.

Of a code about speeds, `speed` is the actual and `allowed` the allowed one.
"""


def plain_text(code: Reason, *values: float, detail: str = "") -> str:
    """Return the text of a reason that needs no robot."""
    return TEXTS[code].format(v=values, detail=detail)


@dataclass(frozen=True)
class ReasonTexts:
    """Makes the texts for one robot and its settings.

    `joints` and their `units` are those of the robot, `regions` and `whys` the texts of the codes of body regions and
    of why a model decides, `lumped` those of why there is no lumped mass; `fixed` are texts by name in TEXTS;
    `scope` is what an OK covers.
    """

    joints: tuple[str, ...] = ("",)
    units: tuple[str, ...] = ("",)
    regions: tuple[str, ...] = ("",)
    whys: tuple[str, ...] = ("",)
    lumped: tuple[str, ...] = ("",)
    fixed: Mapping[str, object] = field(default_factory=dict)
    scope: str = ""

    @classmethod
    def of(
        cls, dynamics: RobotDynamics, settings: MonitorSettings, limits: Sequence[Limit], assumptions: Assumptions
    ) -> ReasonTexts:
        """Return the texts of a robot under `limits`, those of a contact under `settings`."""
        robot, full_reason, choice = dynamics.robot, dynamics.full_reason, settings.effective_mass_model.value
        margin = f"more than {100.0 * settings.model_margin:.3g} % lighter than the full model"
        largest = "lumped" if lumped_suffices(robot) else "lumped and iso"
        massless = (f"{joint} moves the contact point along n, but no lumped mass" for joint in robot.joint_names)
        lumped = (dynamics.lumped_reason, NOT_DEFINITE, MASSLESS, *massless)
        return cls(
            joints=robot.joint_names,
            units=tuple("rad" if revolute else "m" for revolute in robot.revolute),
            regions=("", *(limit.region for limit in limits)),
            whys=(
                "",
                f"effective_mass_model {choice}",
                f"nowhere {margin}",
                f"the lumped model is {margin} along some direction",
                f"largest of {largest}, no full mass: {full_reason}",
                *(f"no lumped mass: {reason}" for reason in lumped),
                *(f"no full mass: {full_reason}; no lumped mass: {reason}" for reason in lumped),
            ),
            lumped=lumped,
            fixed={
                "robot": robot.name,
                "masses": robot.masses_reason,
                "assumed": assumptions.reason,
                "full": full_reason,
                "choice": choice,
                "best": "lumped" if full_reason else "full",
                "min_mass": MIN_EFFECTIVE_MASS,
            },
            scope=scope(robot, settings),
        )

    def text(self, reason: Sequence[float], details: Sequence[str]) -> str:
        """Return the text of a `reason` (12,), whose texts are in `details`."""
        text = self.words(reason, details)
        if reason[HELD]:
            text = f"{HELD_AFTER}{text}"
        if reason[LATCHED]:
            point = details[int(reason[LATCHED]) - 1]
            text = f"{LATCHED_UNTIL_RESET}{f'{point}: ' if point else ''}{text}"
        return text

    def words(self, reason: Sequence[float], details: Sequence[str]) -> str:
        """Return its text without what became of it."""
        if reason[WORDS]:
            return details[int(reason[WORDS])]
        code = Reason(int(reason[CODE]))
        if code is Reason.NONE:
            return ""
        numbers, joint = reason[VALUES:], int(reason[JOINT])
        fields = dict(self.fixed)
        fields |= {"v": numbers, "detail": details[int(reason[DETAIL])]}
        fields |= {"joint": self.joints[joint], "unit": self.units[joint]}
        is_speed = code in {Reason.TOO_FAST, Reason.NEAR_LIMIT, Reason.PERSON_TOO_FAST}
        if is_speed or code is Reason.SPEED_LIMIT:
            speed, allowed = speed_texts(numbers[0], numbers[1], 3 if is_speed else 4)
            fields |= {"speed": speed, "allowed": allowed}
        if is_speed:
            fields |= {"criterion": CRITERIA[int(numbers[2])], "region": self.regions[int(numbers[3])]}
        elif code is Reason.CLAMPED:
            fields |= {"force": at_least(numbers[0], 0), "limit": at_most(numbers[1], 0)}
            fields["region"] = self.regions[int(numbers[2])]
        elif code is Reason.NO_LUMPED_MASS:
            fields["lumped"] = self.lumped[int(numbers[0])]
        elif code in {Reason.TOO_LIGHT, Reason.NO_WORST_MASS}:
            fields["model"] = MODELS[int(numbers[0])]
        text = TEXTS[code].format(**fields)
        if is_speed and numbers[4] > 0.0:
            text += f"; {TEXTS[Reason.LIGHT_MODEL].format(**fields)}"
        return text


NO_TEXTS = ReasonTexts()
"""Without a robot."""

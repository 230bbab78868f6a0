# SPDX-License-Identifier: Apache-2.0
"""Options of the commands, as arguments of `ArgumentParser.add_argument`."""

import argparse
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from scara_effmass.settings import ContactType, MassModel, VelocitySource
from scara_effmass.settings.loading import FORMER_UNITS, number_rule, rescaled


class Option:
    """An option or argument: `names` are separated by a space, `keywords` are those of `add_argument`."""

    def __init__(
        self,
        names: str,
        text: str,
        metavar: str | tuple[str, ...] | None = None,
        kind: Callable[[str], object] | None = None,
        **keywords: Any,  # noqa: ANN401
    ) -> None:
        """Use `text` as help and `kind` as type."""
        self.names = names.split()
        self.keywords = {"help": text, **keywords}
        if keywords.get("action") != "store_true":  # which takes no value
            self.keywords |= {"metavar": metavar, "type": kind}

    @property
    def dest(self) -> str:
        """Attribute of the parsed arguments, for most options a setting."""
        return str(self.keywords.get("dest", self.names[-1].lstrip("-").replace("-", "_")))


def flag(name: str, text: str, **keywords: Any) -> Option:  # noqa: ANN401 - those of add_argument
    """Return an option without a value."""
    return Option(name, text, action="store_true", **keywords)


def params(nodes: str) -> Option:
    """Return --params, a parameter file that the other options override."""
    return Option("--params", f"YAML file with the parameters of {nodes}", "FILE", Path)


def output(metavar: str, text: str) -> Option:
    """Return -o."""
    return Option("-o --output", text, metavar, Path, required=True)


def number(rule: str, is_valid: Callable[[float], bool], kind: type[float] = float) -> Callable[[str], float]:
    """Return an argparse type: a number for which `is_valid` holds; `rule` says what it must be."""

    def parse(text: str) -> float:
        hint = ""
        try:
            value = kind(text)
            if is_valid(value):
                return value
        except ValueError:
            hint = number_rule(text).removeprefix("must be a number")
        raise argparse.ArgumentTypeError(f"{text}: must be {rule}{hint}")

    return parse


def former_options(option: Option) -> Iterator[Option]:
    """Yield the hidden option that refuses the former name of `option`, of which it would be an abbreviation."""
    for name, (new_name, factor) in FORMER_UNITS.items():
        if option.dest == new_name:

            def refuse(text: str, factor: float = factor) -> float:
                value = rescaled(NUMBER(text), factor)
                raise argparse.ArgumentTypeError(f"{text}: must be {option.names[-1]} {value!r}")

            yield Option(f"--{name.replace('_', '-')}", argparse.SUPPRESS, kind=refuse)


def plane(text: str) -> tuple[int, float]:
    """Return axis number and value [m] of a plane such as z=0.3."""
    axis, _, value = text.partition("=")
    if axis not in {"x", "y", "z"}:
        raise argparse.ArgumentTypeError(f"{text}: must be x=M, y=M or z=M")
    return "xyz".index(axis), number("AXIS=M with a number M", math.isfinite)(value)


def words(text: str) -> list[str]:
    """Return the words of a list, separated by commas."""
    return text.split(",")


FORCE = flag("--force", "replace existing output")
LOGGING = (
    flag("-q --quiet", "log warnings and errors only"),
    flag("-v --verbose", "log a status line every second (default: every 10 s, parameter status_period)"),
)
PAGE = (
    Option("--language", "language of the report: en or de (default: en)", choices=["en", "de"], default="en"),
    flag("--pdf", "write the report as report.pdf, too, with Chromium or Chrome"),
)
"""How a report is rendered."""
JSON = flag("--json", "print the result as JSON")
BAGS = Option("bags", "recording, or folder of recordings", "BAG", Path, nargs="+")
BAG = Option("--bag", "recording to assess, which shows whether the settings fit it", "BAG", Path)
TOPIC = Option("--topic", "topic of the joint states (default: joint_states, else the only one)")
ROBOT = (
    Option("--robot", "robot: URDF or DH YAML (default: the shipped Omron i4-550L)", "FILE"),
    Option(
        "--model",
        "effective mass that decides the verdict (default: auto, of validate: lumped)",
        dest="effective_mass_model",
        choices=[model.value for model in MassModel],
    ),
)
JOINTS = (
    Option("--joint-limits", 'in place of the file\'s: "joint=LOWER UPPER,..." [rad or m]', "LIMITS", words),
    Option("--joint-map", 'names of joint states and robot: "reported=robot,..." or "left_*=*"', "MAP", words),
    Option("--joint-names", "names for joint states that have none: NAME,...", "NAMES", words),
    Option(
        "--velocity",
        "reported, or from-positions (default: reported)",
        kind=lambda text: text.replace("-", "_"),
        choices=[source.value for source in VelocitySource],
        dest="velocity_source",
    ),
    Option("--velocity-window", "window of the velocity filter; delays it by half (default: none)", "S", float),
)
TIME = Option(
    "--time",
    "header stamps, judged at the log times as live (default) or alone, or log times in their place",
    choices=["live", "header", "log"],
    default="live",
)
NOT_NEGATIVE = number("a number >= 0", lambda value: 0.0 <= value < math.inf)
NUMBER = number("a number", lambda _: True)
IMPORT = (
    Option("--axis", "of a wrench; norm: |F|, without a sign (default: z)", choices=["x", "y", "z", "norm"]),
    Option("--unit", "N, kN, lbf, kgf, V or mV (default: as the file states, N for messages)"),
    Option("--time-column", "CSV column of the times (default: the first one)", "NAME"),
    flag("--invert", "compression is negative in the file", dest="sensor.invert", default=None),
    Option(
        "--sensitivity",
        "sensitivity behind V or mV [mV/N] (default: 2.248)",
        "MV_PER_N",
        NUMBER,
        dest="sensor.sensitivity",
    ),
    Option("--range", "end of the measuring range; marks saturation (default: 2224)", "N", NUMBER, dest="sensor.range"),
)
FORCE_FILES = (
    Option(
        "--force-topic",
        "topic of force blocks, impacts or wrenches, CSV column or TDMS channel (default: force, or the only one)",
        "TOPIC",
    ),
    Option(
        "--force-from",
        "CSV file, TDMS file or bag with the force, one for each BAG (default: the BAG)",
        "FILE",
        Path,
        action="append",
        default=[],
    ),
    Option(
        "--force-offset",
        "time to add to the stamps in FILE (default: estimated from the kinks of the velocity)",
        "S",
        number("a number", math.isfinite),
    ),
    *IMPORT,
    Option(
        "--plate-normal",
        'normal of the plate in the base frame, "X Y Z", if the recording states none (default: the motion)',
        "XYZ",
    ),
)
"""Where the force beside joint states is, and how it was measured."""
POSITIVE = number("a number > 0", lambda value: value > 0.0)
PAYLOAD = (
    Option(
        "--contact-point",
        'point that can hit a person: a link, or "NAME=LINK: X Y Z" [m]; may be repeated (default: all points of a DH '
        "file, the tip of a URDF)",
        "POINT",
        dest="contact_points",
        action="append",
    ),
    Option(
        "--payload",
        "mass of the load in addition to the tool of the robot file [kg] (default: 0)",
        "KG",
        NOT_NEGATIVE,
        dest="payload_mass",
    ),
    Option(
        "--payload-com",
        "its centre of mass in the frame of the first contact point on the last link [m]",
        ("X", "Y", "Z"),
        NUMBER,
        nargs=3,
    ),
    Option(
        "--payload-inertia",
        "its inertia about the centre of mass [kg m2] (default: a point mass)",
        ("IXX", "IYY", "IZZ", "IXY", "IXZ", "IYZ"),
        NUMBER,
        nargs=6,
    ),
    Option("--payload-topic", "latched topic of the payload (geometry_msgs/Inertia), in place of the three", "TOPIC"),
)
LIMITS = (
    Option(
        "--region",
        "body region that the robot can hit; may be repeated (default: all with a limit)",
        "NAME",
        dest="body_regions",
        action="append",
    ),
    Option("--contact", "type of contact (default: transient)", choices=[contact.value for contact in ContactType]),
    Option("--contact-area-m2", "contact area for the pressure limit [m2] (default: 1e-4, 1 cm2)", "M2", POSITIVE),
)
PERSON = Option(
    "--person-speed", "speed of the person towards the robot [m/s] (default: 0; walking: 1.6)", "M_S", NOT_NEGATIVE
)
DIRECTION = (
    Option(
        "--direction",
        "direction along which the effective mass is computed, as of a press test",
        ("X", "Y", "Z"),
        NUMBER,
        nargs=3,
        dest="test_direction",
    ),
    Option("--direction-frame", "frame of the direction (default: the base)", "FRAME", dest="test_direction_frame"),
)
CELL = (*ROBOT, *JOINTS, *PAYLOAD, *LIMITS, PERSON)
"""Robot, what it carries, and what it can hit: the options of every command that assesses, all of them settings."""
COUNT = number("a whole number from 1", lambda count: count >= 1, int)
PORT = number("a whole number from 0 to 65535", lambda port: 0 <= port <= 65535, int)
MASS = number("a number from 0.001 to 1000", lambda mass: 1e-3 <= mass <= 1e3)
REPEATED = "may be repeated (default: the paper's experiment)"

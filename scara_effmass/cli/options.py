# SPDX-License-Identifier: Apache-2.0
"""Options of the commands, the common ones from options.yaml, and the settings and the robot that they state."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from enum import Enum
from functools import partial
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

from scara_effmass.errors import SettingsError
from scara_effmass.input_files import protect_inputs, read_table
from scara_effmass.iso15066 import MIN_EFFECTIVE_MASS
from scara_effmass.settings import (
    DaqSettings,
    ImportSettings,
    LumpingSettings,
    MonitorSettings,
    ValidatorSettings,
    checked,
    load_settings,
)
from scara_effmass.settings.loading import Settings, choices, flat_fields, number_rule
from scara_effmass.url import Url, location
from scara_effmass.wire.cdr import MAX_SEC

if TYPE_CHECKING:
    from scara_effmass.model.robot import Robot
    from scara_effmass.reference import RobotDynamics


class Option:
    """An option or argument: `names` separated by spaces, and the `keywords` of `add_argument`."""

    def __init__(self, names: str, keywords: Mapping[str, Any]) -> None:
        """Replace `type` by one of `TYPES`; an option without `help` takes help and choices from its setting."""
        self.names = names.split()
        self.keywords = dict(keywords)
        if "help" not in keywords:
            self.keywords |= _setting_keywords(self.dest, keywords)
        if "type" in keywords:
            self.keywords["type"] = TYPES[keywords["type"]]
        if self.names == ["--params"]:
            self.keywords["action"] = _Once
        if isinstance(keywords.get("metavar"), list):
            self.keywords["metavar"] = tuple(keywords["metavar"])

    @property
    def dest(self) -> str:
        """Attribute of the parsed arguments, for most options a setting."""
        return str(self.keywords.get("dest", self.names[-1].lstrip("-").replace("-", "_")))

    @property
    def shown(self) -> str:
        """Name in messages: the longest one, of an argument its metavar."""
        return self.names[-1] if self.names[-1].startswith("-") else str(self.keywords["metavar"])

    def is_stated(self, args: argparse.Namespace) -> bool:
        """Return whether `args` have another value than the default."""
        default = self.keywords.get("default", False if self.keywords.get("action") == "store_true" else None)
        return getattr(args, self.dest) not in (default, [])


class _Once(argparse.Action):
    """Refuses a second value: it would replace the first one, where ROS takes the parameters of both files."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,  # noqa: ANN401 - as argparse
        option_string: str | None = None,
    ) -> None:
        if (first := getattr(namespace, self.dest)) is not None:
            parser.error(f"{option_string} {values}: must be given once, not also with {first}")
        setattr(namespace, self.dest, values)


_FIELDS = {
    name: field
    for kind in (LumpingSettings, ValidatorSettings, DaqSettings, ImportSettings, MonitorSettings)
    for name, field in flat_fields(kind).items()
}
"""Settings by flat name; where several have a field of that name, the last one counts."""


def _setting_keywords(name: str, keywords: Mapping[str, Any]) -> dict[str, Any]:
    """Return help and choices of the option for the setting `name`."""
    field = _FIELDS[name]
    text, _, empty = str(field.description).partition("; empty: ")
    text += "; several by commas" * (keywords.get("type") == "words")
    text += "; may be repeated" * (keywords.get("action") in {"append", "extend"})
    found = {"choices": names} if (names := choices(field)) else {}
    default = field.default.value if isinstance(field.default, Enum) else field.default
    if isinstance(default, (int, float)) and not isinstance(default, bool):
        empty = f"{default:g}"
    elif isinstance(default, str):
        empty = empty or default
    return {**found, "help": f"{text}{f' (default: {empty})' * bool(empty)}".replace("%", "%%")}


def number(rule: str, is_valid: Callable[[float], bool], kind: type[float] = float) -> Callable[[str], float]:
    """Return an argparse type: a number for which `is_valid` holds; `rule` says what it must be."""

    def parse(text: str) -> float:
        hint = ""
        try:
            value = kind(text)
            if is_valid(value):
                return value
        except ValueError:
            hint = number_rule(text).removeprefix("must be a number") if kind is float else ""
        raise argparse.ArgumentTypeError(f"{text}: must be {rule}{hint}")

    return parse


def _plane(text: str) -> tuple[int, float]:
    """Return axis number and value [m] of a plane such as z=0.3."""
    axis, _, value = text.partition("=")
    if axis not in {"x", "y", "z"}:
        raise argparse.ArgumentTypeError(f"{text}: must be x=M, y=M or z=M")
    return "xyz".index(axis), number("AXIS=M with a number M", math.isfinite)(value)


def _path(text: str, kind: Callable[[str], Path] = Path) -> Path:
    """Return a path of a `kind`; an empty one would be the current folder."""
    if not text:
        raise argparse.ArgumentTypeError("must not be empty")
    return kind(text)


def _name(text: str) -> str:
    """Return a name that can be a folder."""
    if not re.fullmatch(r"[\w.-]+", text):
        raise argparse.ArgumentTypeError(f"{text}: must be letters, digits, '_', '.' and '-'")
    return text


MAX_COUNT, MAX_WHOLE = 10_000_000, 2**63 - 1
"""Largest counts, such as samples and impacts, and largest random seed."""
NUMBER = number("a number", lambda _: True)
TYPES: Mapping[str, Callable[[str], object]] = {
    "int": int,
    "float": float,
    "path": _path,
    "location": partial(_path, kind=location),
    "name": _name,
    "words": lambda text: text.split(","),
    "plane": _plane,
    "velocity": lambda text: text.replace("-", "_"),
    "number": NUMBER,
    "offset": number(f"a number from {-MAX_SEC} to {MAX_SEC}", lambda seconds: abs(seconds) <= MAX_SEC),
    "not_negative": number("a number >= 0", lambda value: 0.0 <= value < math.inf),
    "rate": number("a number > 0", lambda value: 0.0 < value < math.inf),
    "positive": number("a number > 0", lambda value: value > 0.0),
    "whole": number(f"a whole number from 0 to {MAX_WHOLE}", lambda count: 0 <= count <= MAX_WHOLE, int),
    "count": number(f"a whole number from 1 to {MAX_COUNT}", lambda count: 1 <= count <= MAX_COUNT, int),
    "samples": number(f"a whole number from 100 to {MAX_COUNT}", lambda count: 100 <= count <= MAX_COUNT, int),
    "port": number("a whole number from 0 to 65535", lambda port: 0 <= port <= 65535, int),
    "mass": number("a number from 0.001 to 1000", lambda mass: 1e-3 <= mass <= 1e3),
    "effective_mass": number(
        f"a number >= {MIN_EFFECTIVE_MASS:g} kg", lambda mass: MIN_EFFECTIVE_MASS <= mass < math.inf
    ),
}
"""Types of options by their name in the YAML files."""


_GROUPS = read_table(__file__, "options.yaml")


def options_of(*items: str | Mapping[str, Mapping[str, Any]]) -> Iterator[Option]:
    """Yield the options of `items`: groups of options.yaml by name, and options with their keywords."""
    for item in items:
        if isinstance(item, str):
            yield from options_of(*_GROUPS[item])
        else:
            yield from (Option(names, keywords) for names, keywords in item.items())


SHOWN = ["robot", "joint_map", "joint_names", "contact_points", "payload_mass", "payload_com", "payload_inertia"]
SHOWN += ["payload_shape", "tool_links", "armature", "locked_joints", "contact_links", "package_dirs"]
"""Parameters of the monitor that change the markers of the robot."""
OUTPUTS = {"output", "out", "report", "hulls"}
"""Paths that a command writes."""


def inputs_of(args: argparse.Namespace) -> Iterator[Path]:
    """Yield the files and folders that a command reads, with --force also the recordings in the folders."""
    read = {name: value for name, value in vars(args).items() if name not in OUTPUTS}
    if args.command == "protocol fill":
        del read["protocol"]  # rewritten
    robots = read.pop("robot", None) or []
    for value in (*read.values(), [Path(robot) for robot in ([robots] if isinstance(robots, str) else robots)]):
        for path in value if isinstance(value, list) else [value]:
            if isinstance(path, Path):
                yield path
                if getattr(args, "force", False) and not isinstance(path, Url) and path.is_dir():
                    from scara_effmass.bags.files import is_bag_name  # noqa: PLC0415 - loads rosbags

                    yield from (file for file in path.rglob("*") if is_bag_name(file))


def shell_path(path: Path) -> str:
    """Return `path` as a word of a command line, which is no option."""
    return quote(f"./{path}" if str(path).startswith("-") else str(path))


def monitor_settings(
    args: argparse.Namespace,
    others: Collection[str] = (),
    **overrides: Any,  # noqa: ANN401 - any setting
) -> MonitorSettings:
    """Return the monitor's settings: those of --params, overridden by the other options and by `overrides`.

    A parameter file with sections of the nodes `others` only leaves the defaults. Raises SettingsError.
    """
    chosen = {name: getattr(args, name, None) for name in MonitorSettings.model_fields}
    settings = override(load_settings(MonitorSettings, args.params, "monitor", others), chosen | overrides)
    protect_inputs(Path(settings.robot_path))
    return settings


def selected(args: argparse.Namespace, *groups: str) -> dict[str, Any]:
    """Return the values of the options in `groups` by the name of the setting."""
    return {option.dest: getattr(args, option.dest) for option in options_of(*groups)}


def override(settings: Settings, chosen: dict[str, Any]) -> Settings:
    """Return `settings` changed to the `chosen` values that are not None. Raises SettingsError."""
    changes = {name: value for name, value in chosen.items() if value is not None}
    return checked(type(settings), {**settings.model_dump(exclude_unset=True), **changes}, "options")


def load_dynamics(settings: MonitorSettings) -> RobotDynamics:
    """Return the robot of `settings` with its mass models. Raises RobotError, SettingsError."""
    if settings.await_robot_description and not settings.robot:  # the default would be another robot
        rule = "must be false where no topic is read, or come with the robot file by --robot"
        raise SettingsError(f"await_robot_description = true: {rule}")
    from scara_effmass.model.load import load_robot  # noqa: PLC0415
    from scara_effmass.reference import RobotDynamics  # noqa: PLC0415 - loads Pinocchio

    return RobotDynamics(load_robot(settings.robot_path, settings))


def robot_line(robot: Robot, settings: MonitorSettings) -> tuple[str, str]:
    """Return subject and text of the line of a summary that names `robot` and its file, and whether it was chosen."""
    default = "" if settings.robot else ", the default: give --robot for another one"
    return "robot", f"{robot.name} ({robot.origin}){default}"


def require_no_payload_topic(settings: MonitorSettings, purpose: str) -> None:
    """Raise SettingsError if the payload comes by topic, because `purpose` needs it beforehand."""
    if settings.payload_topic:
        rule = f"must be empty for {purpose}: give --payload-topic ''"
        raise SettingsError(f"payload_topic = {settings.payload_topic!r}: {rule}")

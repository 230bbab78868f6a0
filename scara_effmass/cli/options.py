"""Options shared by several commands, and the settings made from them."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scara_effmass.settings import ContactType, MassModel, MonitorSettings, checked, load_settings

if TYPE_CHECKING:
    from scara_effmass.model.dynamics import RobotDynamics


def number(
    *, minimum: float = -math.inf, above: float = -math.inf, finite: bool = True, unit: str = ""
) -> Callable[[str], float]:
    """Return an argparse type: a number of at least `minimum` and greater than `above`."""
    rule = f"> {above:g}" if above > -math.inf else f">= {minimum:g}"

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not (value >= minimum and value > above) or (finite and math.isinf(value)):
            raise argparse.ArgumentTypeError(f"{text}: must be a number {rule} {unit}".rstrip())
        return value

    return parse


def add_params(parser: argparse.ArgumentParser, node: str = "monitor_node") -> None:
    """Add --params, a parameter file that the other options override."""
    parser.add_argument("--params", type=Path, metavar="FILE", help=f"YAML file with the parameters of {node}")


def add_robot(parser: argparse.ArgumentParser) -> None:
    """Add --robot and --model."""
    parser.add_argument("--robot", metavar="FILE", help="robot: URDF or DH YAML (default: the shipped Omron i4-550L)")
    parser.add_argument(
        "--model",
        dest="effective_mass_model",
        choices=[model.value for model in MassModel],
        help="effective mass that decides the verdict (default: lumped)",
    )


def add_limits(parser: argparse.ArgumentParser) -> None:
    """Add --region and --contact."""
    parser.add_argument(
        "--region",
        dest="body_regions",
        action="append",
        metavar="NAME",
        help="body region that the robot can hit; may be repeated (default: all with a limit)",
    )
    parser.add_argument(
        "--contact", choices=[contact.value for contact in ContactType], help="type of contact (default: transient)"
    )


def add_topic(parser: argparse.ArgumentParser) -> None:
    """Add --topic."""
    parser.add_argument("--topic", help="topic of the joint states (default: joint_states, else the only one)")


def add_json(parser: argparse.ArgumentParser) -> None:
    """Add --json."""
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def add_force(parser: argparse.ArgumentParser) -> None:
    """Add --force."""
    parser.add_argument("--force", action="store_true", help="replace existing output")


def settings_from(
    args: argparse.Namespace,
    others: Collection[str] = (),
    **overrides: Any,  # noqa: ANN401 - any setting
) -> MonitorSettings:
    """Return the monitor's settings: those of --params, overridden by the other options and by `overrides`.

    A parameter file for the nodes `others` alone leaves the defaults. Raises SettingsError.
    """
    settings = load_settings(MonitorSettings, args.params, "monitor", others) if args.params else MonitorSettings()
    options = {name: getattr(args, name, None) for name in MonitorSettings.model_fields} | overrides
    changes = {name: value for name, value in options.items() if value is not None}
    return checked(MonitorSettings, {**settings.model_dump(), **changes}, "options")


def node_arguments(params: Path | None, parameters: Mapping[str, Any], ros_arguments: Sequence[str]) -> list[str]:
    """Return ROS arguments: parameter file, `parameters`, and the arguments of the user, which override both."""
    arguments = ["--ros-args"]
    if params:
        arguments += ["--params-file", str(params)]
    for name, value in parameters.items():
        if value is not None and value != "":
            # ROS parses the value as YAML: unquoted, some file names would become numbers.
            arguments += ["-p", f"{name}:={json.dumps(value)}"]
    return [*arguments, "--", *ros_arguments]


def load_dynamics(settings: MonitorSettings) -> RobotDynamics:
    """Return the robot of `settings` with its mass models. Raises RobotError."""
    from scara_effmass.model.dynamics import RobotDynamics  # noqa: PLC0415 - not needed for --help
    from scara_effmass.model.load import load_robot  # noqa: PLC0415

    return RobotDynamics(load_robot(settings.robot_path, settings))

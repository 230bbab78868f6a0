"""Options that several commands share, and the settings they make."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scara_effmass.cli.console import printer as printer  # noqa: PLC0414 - moved
from scara_effmass.settings import ContactType, MassModel, MonitorSettings, checked, load_settings

if TYPE_CHECKING:
    import argparse
    from collections.abc import Collection, Mapping, Sequence

    from scara_effmass.model.dynamics import RobotDynamics


def add_params(parser: argparse.ArgumentParser, node: str = "monitor_node") -> None:
    """Add --params, the file that the other options override."""
    parser.add_argument("--params", type=Path, metavar="FILE", help=f"YAML file of the parameters of {node}")


def add_robot(parser: argparse.ArgumentParser) -> None:
    """Add --robot and --model."""
    parser.add_argument("--robot", metavar="FILE", help="robot: URDF or DH YAML (default: the shipped Omron i4-550L)")
    parser.add_argument(
        "--model",
        dest="effective_mass_model",
        choices=[model.value for model in MassModel],
        help="effective mass behind the verdict (default: lumped)",
    )


def add_limits(parser: argparse.ArgumentParser) -> None:
    """Add --region and --contact."""
    parser.add_argument(
        "--region",
        dest="body_regions",
        action="append",
        metavar="NAME",
        help="body region that can be hit; may be given several times (default: all with a limit)",
    )
    parser.add_argument(
        "--contact", choices=[contact.value for contact in ContactType], help="kind of contact (default: transient)"
    )


def add_topic(parser: argparse.ArgumentParser) -> None:
    """Add --topic."""
    parser.add_argument("--topic", help="topic of the joint states (default: joint_states, or the only one)")


def add_json(parser: argparse.ArgumentParser) -> None:
    """Add --json."""
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def add_force(parser: argparse.ArgumentParser) -> None:
    """Add --force."""
    parser.add_argument("--force", action="store_true", help="replace output that exists already")


def settings_from(
    args: argparse.Namespace,
    others: Collection[str] = (),
    **more: Any,  # noqa: ANN401 - any setting
) -> MonitorSettings:
    """Return the settings of --params, which may be for `others` alone, with the other options over them.

    Raises SettingsError.
    """
    settings = load_settings(MonitorSettings, args.params, "monitor", others) if args.params else MonitorSettings()
    given = {name: getattr(args, name, None) for name in MonitorSettings.model_fields} | more
    changes = {name: value for name, value in given.items() if value is not None}
    return checked(MonitorSettings, {**settings.model_dump(), **changes}, "options")


def node_arguments(params: Path | None, given: Mapping[str, Any], ros_arguments: Sequence[str]) -> list[str]:
    """Return everything as ROS arguments: the file first, then `given`, then the user's own; the last one wins."""
    words = ["--ros-args"]
    if params:
        words += ["--params-file", str(params)]
    for name, value in given.items():
        if value is not None and value != "":
            # In quotes, because ROS reads the value as YAML and would take some file names for numbers.
            words += ["-p", f"{name}:={json.dumps(value)}"]
    return [*words, "--", *ros_arguments]


def load_dynamics(settings: MonitorSettings) -> RobotDynamics:
    """Return the robot that `settings` mean, with its models. Raises RobotError."""
    from scara_effmass.model.dynamics import RobotDynamics  # noqa: PLC0415 - not needed for --help
    from scara_effmass.model.load import load_robot  # noqa: PLC0415

    return RobotDynamics(load_robot(settings.robot_path, settings))

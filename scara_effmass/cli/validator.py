"""`scara-effmass validator`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scara_effmass.cli.options import add_params, node_arguments
from scara_effmass.settings import MonitorSettings, ValidatorSettings, checked, load_settings

if TYPE_CHECKING:
    import argparse
    from pathlib import Path

    from scara_effmass.impacts.result import Result
    from scara_effmass.nodes.validator_node import NodeSettings

EXAMPLES = """\
ROS arguments stand behind -- or --ros-args; they win over the options. What is hit may change while it runs:
set its parameter obstacle_mass, or let the bench or a replayed recording say it on run_info.

examples:
  scara-effmass validator --obstacle-mass 2.39
  scara-effmass validator --params my_cell.yaml -- -p stiffness:=2000.0
"""


def add_to(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = EXAMPLES
    parser.add_argument("--obstacle-mass", type=float, metavar="KG", help="mass of what is hit, m_H [kg]")
    add_params(parser, "validator_node")
    parser.set_defaults(run=run, ros_arguments=[])


def run(args: argparse.Namespace) -> int:
    """Run the node until it is told to stop."""
    from scara_effmass.nodes.validator_node import NodeSettings, main  # noqa: PLC0415 - rclpy, only when the node runs

    if args.params:
        load_settings(NodeSettings, args.params, "validator")  # says in one line what ROS would say in ten
    words = node_arguments(args.params, {"obstacle_mass": args.obstacle_mass}, args.ros_arguments)
    return main(words, write_report)


def node() -> int:
    """Run the node as a ROS executable, with the arguments of the process."""
    from scara_effmass.nodes.validator_node import main  # noqa: PLC0415

    return main(None, write_report)


def write_report(result: Result, settings: NodeSettings, folder: Path) -> Path:
    """Write the report of a live series; return its page. Raises OutputError, RobotError."""
    from scara_effmass.analysis import validation_report  # noqa: PLC0415 - draws, only when it is asked for
    from scara_effmass.analysis.validation import Validation, ValidationSettings  # noqa: PLC0415
    from scara_effmass.model.load import load_robot  # noqa: PLC0415

    monitor = checked(MonitorSettings, {"robot": settings.robot}, "validator")
    shown = checked(ValidatorSettings, settings.model_dump(include=set(ValidatorSettings.model_fields)), "validator")
    about = ValidationSettings(monitor=monitor, validator=shown, detection=settings.detection)
    robot = load_robot(monitor.robot_path, monitor)
    validation_report.write_report(Validation(result, ()), about, robot, folder, overwrite=False)
    return folder / validation_report.PAGE

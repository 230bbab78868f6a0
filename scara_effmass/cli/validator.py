"""`scara-effmass validator`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from scara_effmass.cli.options import add_params, node_arguments
from scara_effmass.settings import MonitorSettings, ValidatorSettings, checked, load_settings

if TYPE_CHECKING:
    from scara_effmass.impacts.validator import Result
    from scara_effmass.nodes.validator_node import NodeSettings

EXAMPLES = """\
ROS arguments follow -- or --ros-args and override the options. To change the obstacle mass at run time, set the
parameter obstacle_mass; sim_node and replayed recordings publish it on run_info.

examples:
  scara-effmass validator --obstacle-mass 2.39
  scara-effmass validator --params my_cell.yaml -- -p stiffness:=2000.0
"""


def add_to(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = EXAMPLES
    parser.add_argument("--obstacle-mass", type=float, metavar="KG", help="mass of the obstacle, m_H [kg]")
    add_params(parser, "validator_node")
    parser.set_defaults(run=run, ros_arguments=[])


def run(args: argparse.Namespace) -> int:
    """Run the node until shutdown."""
    from scara_effmass.nodes.validator_node import NodeSettings, main  # noqa: PLC0415 - rclpy, only when the node runs

    if args.params:
        load_settings(NodeSettings, args.params, "validator")  # a shorter error message than that of ROS
    node_args = node_arguments(args.params, {"obstacle_mass": args.obstacle_mass}, args.ros_arguments)
    return main(node_args, write_report)


def node() -> int:
    """Run the node as a ROS executable, with the arguments of the process."""
    from scara_effmass.nodes.validator_node import main  # noqa: PLC0415

    return main(None, write_report)


def write_report(result: Result, settings: NodeSettings, folder: Path) -> Path:
    """Write the report of a live series; return the path of its page. Raises OutputError, RobotError."""
    from scara_effmass.analysis import validation_report  # noqa: PLC0415 - draws, only when it is asked for
    from scara_effmass.analysis.validation import Validation, ValidationSettings  # noqa: PLC0415
    from scara_effmass.model.load import load_robot  # noqa: PLC0415

    monitor = checked(MonitorSettings, {"robot": settings.robot}, "validator")
    validator = checked(
        ValidatorSettings, settings.model_dump(include=set(ValidatorSettings.model_fields)), "validator"
    )
    report_settings = ValidationSettings(monitor=monitor, validator=validator, detection=settings.detection)
    robot = load_robot(monitor.robot_path, monitor)
    validation_report.write_report(Validation(result, ()), report_settings, robot, folder, overwrite=False)
    return folder / validation_report.PAGE

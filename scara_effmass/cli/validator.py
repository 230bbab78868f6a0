"""`scara-effmass validator`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scara_effmass.cli.options import add_params, node_arguments
from scara_effmass.settings import ValidatorSettings, load_settings

if TYPE_CHECKING:
    import argparse

EXAMPLES = """\
ROS arguments stand behind -- or --ros-args; they win over the options. What is hit may change while it runs:
set its parameter obstacle_mass, or let the bench or a replayed recording say it on recording_info.

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
    from scara_effmass.nodes.validator_node import main  # noqa: PLC0415 - rclpy, only when the node runs

    if args.params:
        load_settings(ValidatorSettings, args.params, "validator")  # says in one line what ROS would say in ten
    return main(node_arguments(args.params, {"obstacle_mass": args.obstacle_mass}, args.ros_arguments))

"""`scara-effmass monitor`."""

import argparse

from scara_effmass.cli.options import add_params, add_robot, node_arguments
from scara_effmass.settings import load_settings

EXAMPLES = """\
ROS arguments follow -- or --ros-args and take precedence over the options.

examples:
  scara-effmass monitor
  scara-effmass monitor --robot my_robot.urdf --model full
  scara-effmass monitor --params my_cell.yaml -- -r joint_states:=/cell/joint_states -p timeout:=0.1
"""


def add_to(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = EXAMPLES
    add_robot(parser)
    add_params(parser)
    parser.set_defaults(run=run, ros_arguments=[])


def run(args: argparse.Namespace) -> int:
    """Run the node until a signal ends it."""
    from scara_effmass.nodes.monitor_node import NodeSettings, main  # noqa: PLC0415 - loads rclpy

    if args.params:
        load_settings(NodeSettings, args.params, "monitor")  # one error line; ROS would print ten
    overrides = {name: getattr(args, name) for name in ("robot", "effective_mass_model")}
    return main(node_arguments(args.params, overrides, args.ros_arguments))

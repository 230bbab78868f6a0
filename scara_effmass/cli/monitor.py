"""`scara-effmass monitor`."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from scara_effmass.cli.options import add_params, add_robot
from scara_effmass.settings import MonitorSettings, load_settings

if TYPE_CHECKING:
    import argparse

EXAMPLES = """\
ROS arguments stand behind -- or --ros-args; they win over the options.

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
    """Run the node until it is told to stop."""
    from scara_effmass.nodes.monitor_node import main  # noqa: PLC0415 - rclpy, only when the node runs

    return main(node_arguments(args))


def node_arguments(args: argparse.Namespace) -> list[str]:
    """Return everything as ROS arguments: the file first, then the options, then the user's own; the last one wins."""
    words = ["--ros-args"]
    if args.params:
        load_settings(MonitorSettings, args.params, "monitor")  # says in one line what ROS would say in ten
        words += ["--params-file", str(args.params)]
    for name in ("robot", "effective_mass_model"):
        if value := getattr(args, name):
            # In quotes, because ROS reads the value as YAML and would take some file names for numbers.
            words += ["-p", f"{name}:={json.dumps(value)}"]
    return [*words, "--", *args.ros_arguments]

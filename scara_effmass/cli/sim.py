"""`scara-effmass sim`."""

import argparse

from scara_effmass.cli.options import node_arguments

EXAMPLES = """\
A simulated robot repeatedly hits simulated carts. The node publishes joint states at 1 kHz and, on run_info, the
cart in place. A force node with the same start publishes the force of the same impacts.

examples:
  scara-effmass sim --start 1800000000
  scara-effmass daq --source sim -- -p sim.scene:=cell -p sim.start:=1800000000.0
"""


def add_to(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = EXAMPLES
    parser.add_argument("--start", type=float, metavar="S", help="ROS time of the start [s] (default: now)")
    parser.add_argument("--seed", type=int, help="random seed of the noise (default: 0)")
    parser.add_argument("--clock", action="store_true", help="publish /clock and wait for nodes that fall behind")
    parser.set_defaults(run=run, ros_arguments=[])


def run(args: argparse.Namespace) -> int:
    """Run the node until it is stopped."""
    from scara_effmass.nodes.sim_node import main  # noqa: PLC0415 - rclpy, only when the node runs

    parameters = {"start": args.start, "seed": args.seed, "clock": args.clock or None}
    return main(node_arguments(None, parameters, args.ros_arguments))

"""`scara-effmass sim`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scara_effmass.cli.options import node_arguments

if TYPE_CHECKING:
    import argparse

EXAMPLES = """\
A simulated robot drives into simulated carts, again and again: joint states at 1 kHz, and on run_info which
cart waits. Start the force node with the same --start, and it has the force of the same impacts.

examples:
  scara-effmass sim --start 1800000000
  scara-effmass daq --source sim -- -p sim.scene:=cell -p sim.start:=1800000000.0
"""


def add_to(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = EXAMPLES
    parser.add_argument("--start", type=float, metavar="S", help="ROS time at which it begins [s] (default: now)")
    parser.add_argument("--seed", type=int, help="of its noise (default: 0)")
    parser.add_argument(
        "--clock", action="store_true", help="make the time, on /clock, and wait for nodes that fall behind"
    )
    parser.set_defaults(run=run, ros_arguments=[])


def run(args: argparse.Namespace) -> int:
    """Run the node until it is told to stop."""
    from scara_effmass.nodes.sim_node import main  # noqa: PLC0415 - rclpy, only when the node runs

    return main(
        node_arguments(None, {"start": args.start, "seed": args.seed, "clock": args.clock or None}, args.ros_arguments)
    )

"""`scara-effmass daq`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scara_effmass.cli.options import add_params, node_arguments
from scara_effmass.settings import ForceSourceKind, load_settings

if TYPE_CHECKING:
    import argparse

EXAMPLES = """\
ROS arguments stand behind -- or --ros-args; they win over the options. Force is positive in compression.

examples:
  scara-effmass daq --sensitivity 2.31
  scara-effmass daq --source bag --path recording.mcap
  scara-effmass daq --source bag --path load_cell.csv --topic "Force (N)" -- -p sensor.invert:=true
  scara-effmass daq --source sim -- -p sim.impact_period:=1.0
"""

OPTIONS = {
    "source": "source",
    "path": "bag.path",
    "topic": "bag.topic",
    "sensitivity": "sensor.sensitivity",
}
"""The parameter that each option sets."""


def add_to(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = EXAMPLES
    parser.add_argument(
        "--source",
        type=lambda text: "sim" if text == "bench" else text,  # its former name
        choices=[kind.value for kind in ForceSourceKind],
        help="where force comes from (default: ni9230); bag: a recording, sim: simulated",
    )
    parser.add_argument("--path", metavar="FILE", help="recording, for the source bag: rosbag2, .mcap, .csv, .tdms")
    parser.add_argument("--topic", help="its topic, CSV column or TDMS channel (default: the only one)")
    parser.add_argument(
        "--sensitivity", type=float, metavar="MV_PER_N", help="from the sensor's certificate [mV/N] (default: 2.248)"
    )
    add_params(parser, "daq_node")
    parser.set_defaults(run=run, ros_arguments=[])


def run(args: argparse.Namespace) -> int:
    """Run the node until it is told to stop."""
    from scara_effmass.nodes.daq_node import NodeSettings, main  # noqa: PLC0415 - rclpy, only when the node runs

    if args.params:
        load_settings(NodeSettings, args.params, "daq")  # says in one line what ROS would say in ten
    given = {parameter: getattr(args, option) for option, parameter in OPTIONS.items()}
    return main(node_arguments(args.params, given, args.ros_arguments))

"""`scara-effmass daq`."""

import argparse

from scara_effmass.cli.options import add_params, node_arguments
from scara_effmass.settings import ForceSourceKind, load_settings

EXAMPLES = """\
ROS arguments follow -- or --ros-args and override the options. Force is positive in compression. Force from CSV and
TDMS files and from wrench topics is converted to a bag first: see `scara-effmass import --help`.

examples:
  scara-effmass daq --sensitivity 2.31
  scara-effmass daq --source bag --path recording.mcap
  scara-effmass daq --source sim -- -p sim.impact_period:=1.0
"""

OPTIONS = {"source": "source", "path": "bag.path", "topic": "bag.topic", "sensitivity": "sensor.sensitivity"}
"""Parameter of each option."""


def add_to(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = EXAMPLES
    parser.add_argument(
        "--source",
        type=lambda text: "sim" if text == "bench" else text,  # its former name
        choices=[kind.value for kind in ForceSourceKind],
        help="force source (default: ni9230); bag: a recording, sim: simulated force",
    )
    parser.add_argument("--path", metavar="BAG", help="bag with ForceBlocks, for the source bag")
    parser.add_argument("--topic", help="topic of the ForceBlocks (default: the only one)")
    parser.add_argument(
        "--sensitivity", type=float, metavar="MV_PER_N", help="from the sensor's certificate [mV/N] (default: 2.248)"
    )
    add_params(parser, "daq_node")
    parser.set_defaults(run=run, ros_arguments=[])


def run(args: argparse.Namespace) -> int:
    """Run the node until it is stopped."""
    from scara_effmass.nodes.daq_node import NodeSettings, main  # noqa: PLC0415 - rclpy, only when the node runs

    if args.params:
        load_settings(NodeSettings, args.params, "daq")  # reports errors in one line, unlike ROS
    parameters = {parameter: getattr(args, option) for option, parameter in OPTIONS.items()}
    return main(node_arguments(args.params, parameters, args.ros_arguments))

"""`scara-effmass import`."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from scara_effmass.cli.console import print_json, print_lines
from scara_effmass.cli.options import add_force, add_json
from scara_effmass.settings import ImportSettings, checked

if TYPE_CHECKING:
    from scara_effmass.importers.force import ImportedTopic

EXAMPLES = """\
FILE is a CSV file (.csv, .tsv, .txt), a TDMS file, or a bag with a topic of WrenchStamped, Wrench or Float64. BAG is a
rosbag2 folder, or a file if it ends in .mcap; it holds ForceBlocks for `daq --source bag` and `validate`. The first
FILE is on the topic force, the next ones are on force/file1, force/file2 and so on.

examples:
  scara-effmass import load_cell.csv -o load_cell
  scara-effmass import run.csv --topic "Force (lbf)" --time-column "Time (ms)" --invert -o run.mcap
  scara-effmass import bridge.tdms --topic cell/ai0 --sensitivity 2.31 -o bridge
  scara-effmass import wrist.mcap --topic /ft_sensor/wrench --axis x -o wrist_force
"""
OPTIONS = {
    "topic": "topic",
    "axis": "axis",
    "unit": "unit",
    "time_column": "time_column",
    "frame_id": "frame_id",
    "sensitivity": "sensor.sensitivity",
    "range": "sensor.range",
    "invert": "sensor.invert",
}
"""Setting of each option."""


def add_to(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = EXAMPLES
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE", help="CSV file, TDMS file or bag")
    parser.add_argument("-o", "--output", required=True, type=Path, metavar="BAG", help="bag to write")
    parser.add_argument("--topic", help="topic, CSV column or TDMS channel of the force (default: the only one)")
    parser.add_argument("--axis", choices=["x", "y", "z"], help="component of a wrench (default: z)")
    parser.add_argument("--unit", help="N, kN, lbf, kgf, V or mV (default: as the file states, N for messages)")
    parser.add_argument("--time-column", metavar="NAME", help="CSV column of the times (default: the first one)")
    parser.add_argument("--frame", dest="frame_id", help="frame of the sensor (default: force_sensor)")
    parser.add_argument("--invert", action="store_true", default=None, help="compression is negative in the file")
    parser.add_argument(
        "--sensitivity", type=float, metavar="MV_PER_N", help="sensitivity behind V or mV [mV/N] (default: 2.248)"
    )
    parser.add_argument(
        "--range", type=float, metavar="N", help="end of the measuring range; marks saturation (default: 2224)"
    )
    add_force(parser)
    add_json(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Write the bag, and print what it holds."""
    from scara_effmass.importers.force import write_force_bag  # noqa: PLC0415 - not needed for --help

    values = {setting: getattr(args, option) for option, setting in OPTIONS.items()}
    stated = {setting: value for setting, value in values.items() if value is not None}
    settings = checked(ImportSettings, stated, "options")
    topics = write_force_bag(args.files, args.output, settings, overwrite=args.force)
    if args.json:
        print_json({"output": str(args.output), "topics": [asdict(topic) for topic in topics]})
    else:
        print_lines(_result_lines(topics, args.output))
    return 0


def _result_lines(topics: Sequence[ImportedTopic], output: Path) -> Iterator[tuple[str, str]]:
    for topic in topics:
        counts = f"{topic.samples} samples at {topic.sample_rate_hz:.9g} Hz, {topic.lost_samples} lost"
        yield topic.topic, f"{topic.source}: {counts}, {topic.saturated_samples} saturated"
        for loss in topic.losses:
            yield "not read", loss
    yield "written", str(output)

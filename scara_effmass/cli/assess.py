"""`scara-effmass assess`."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scara_effmass.analysis.time_series import TimeSeriesBuilder
from scara_effmass.cli.console import print_json, print_lines, progress_bar
from scara_effmass.cli.options import (
    add_force,
    add_json,
    add_limits,
    add_params,
    add_robot,
    add_topic,
    load_dynamics,
    settings_from,
)
from scara_effmass.settings import MonitorSettings

if TYPE_CHECKING:
    from scara_effmass.analysis.run_report import RunReport
    from scara_effmass.analysis.tables import AssessmentWriter
    from scara_effmass.bags.bag import Bag
    from scara_effmass.model.dynamics import RobotDynamics

EXAMPLES = """\
FILE must end in .parquet, .csv or .mcap. Each bag is assessed by a fresh monitor, whose clock is the log time of the
joint states. DIR gets report.html, summary.json, and a figure of each bag and contact point as PNG and SVG.

examples:
  scara-effmass assess bags/tour -o tour.parquet --report out/tour
  scara-effmass assess monday.mcap tuesday.mcap -o week.csv --robot my_robot.urdf --model full
  scara-effmass assess bags/tour -o tour.mcap --region hand_fingers --json
"""


class Assessor:
    """Assesses recordings in turn and sums up the results."""

    def __init__(self, dynamics: RobotDynamics, settings: MonitorSettings) -> None:
        """Start without a recording."""
        from scara_effmass.analysis.summary import Summary  # noqa: PLC0415 - not needed for --help

        self.dynamics = dynamics
        self.settings = settings
        self.summary = Summary(round(settings.timeout * 1e9))
        self.joint_states = self.foreign = self.rejected = 0
        self.losses: list[str] = []

    def assess(
        self,
        bag: Bag,
        topic: str,
        table: AssessmentWriter,
        advance: Callable[[], object],
        series: Mapping[str, TimeSeriesBuilder],
    ) -> None:
        """Assess every joint state on `topic`; add it to `table` and, if present, to the `series` of its contact point.

        Raises EffmassError.
        """
        from scara_effmass.analysis.assessment import assess_joint_states  # noqa: PLC0415
        from scara_effmass.safety import Monitor  # noqa: PLC0415

        monitor = Monitor(self.dynamics, self.settings)
        self.summary.new_recording()
        name = str(bag.path)
        for log_time_ns, state, decision in assess_joint_states(bag, topic, monitor):
            self.joint_states += 1
            advance()
            if decision is None:
                continue
            table.add(name, log_time_ns, decision.contacts)
            self.summary.add(decision.contacts, log_time_ns, state, name)
            if series:
                for contact in decision.contacts:
                    series[contact.contact_point].add(contact, log_time_ns)
        self.foreign += monitor.ignored
        self.rejected += monitor.rejected
        self.losses += bag.losses

    def as_dict(self) -> dict[str, Any]:
        """Return the result for JSON."""
        return {
            "joint_states": self.joint_states,
            "foreign": self.foreign,
            "refused": self.rejected,
            **self.summary.as_dict(),
            "losses": self.losses,
        }

    def lines(self) -> list[tuple[str, str]]:
        """Return the result as subjects and texts."""
        foreign = f", {self.foreign} of other devices ignored" if self.foreign else ""
        lines = [("joint states", f"{self.joint_states}{foreign}"), *self.summary.lines()]
        if self.rejected:
            lines.append(("rejected", f"{self.rejected} joint states (UNKNOWN)"))
        return lines + [("not read", loss) for loss in self.losses]


def add_to(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = EXAMPLES
    parser.add_argument("bags", nargs="+", type=Path, metavar="BAG", help="recording, or folder of recordings")
    parser.add_argument("-o", "--output", required=True, type=Path, metavar="FILE", help=".parquet, .csv or .mcap")
    parser.add_argument("--report", type=Path, metavar="DIR", help="folder for figures, episodes and summary")
    add_topic(parser)
    add_robot(parser)
    add_limits(parser)
    add_params(parser)
    add_force(parser)
    add_json(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Assess the recordings, write table and report, and print the summary."""
    from scara_effmass.analysis.assessment import joint_state_topic  # noqa: PLC0415
    from scara_effmass.analysis.tables import open_writer, provenance  # noqa: PLC0415
    from scara_effmass.analysis.time_series import TimeSeriesBuilder  # noqa: PLC0415
    from scara_effmass.bags.files import find_bags, open_bag  # noqa: PLC0415
    from scara_effmass.safety import Monitor  # noqa: PLC0415

    settings = settings_from(args)
    dynamics = load_dynamics(settings)
    Monitor(dynamics, settings)  # raises for missing limits before any file is written
    paths = [path for folder in args.bags for path in find_bags(folder)]
    assessor = Assessor(dynamics, settings)
    origin = provenance(settings, dynamics.robot.origin, paths)
    with ExitStack() as stack:
        report = None
        if args.report:
            from scara_effmass.analysis.run_report import RunReport  # noqa: PLC0415 - loads matplotlib

            report = RunReport(args.report, len(paths) * len(dynamics.contact_points), settings, overwrite=args.force)
        table = stack.enter_context(open_writer(args.output, origin, dynamics.robot.base_frame, overwrite=args.force))
        progress = stack.enter_context(progress_bar())
        for path in paths:
            with open_bag(path) as bag:
                topic = joint_state_topic(bag, args.topic)
                count = next(info.count for info in bag.topics if info.name == topic)
                task = progress.add_task(path.name, total=count)
                series = {point: TimeSeriesBuilder() for point in dynamics.contact_points} if report else {}
                assessor.assess(bag, topic, table, lambda task=task: progress.advance(task), series)  # type: ignore[misc]
                if report:
                    _add_to_report(report, bag, dynamics.robot.name, series)
        result = {"output": str(args.output), **assessor.as_dict()}
        if report:
            result = report.write(f"{dynamics.robot.name}: assessment", assessor.lines(), result)
    written = [("written", args.output), *([("open", args.report / "report.html")] if report else [])]
    if args.json:
        print_json(result)
    else:
        print_lines([*assessor.lines(), *written])
    return 0


def _add_to_report(report: RunReport, bag: Bag, robot: str, series: Mapping[str, TimeSeriesBuilder]) -> None:
    from scara_effmass.analysis.assessment import generated_description  # noqa: PLC0415
    from scara_effmass.analysis.recorded_run import read_force  # noqa: PLC0415

    forces = read_force(bag)
    generated = bool(generated_description(bag))
    for point, builder in series.items():
        report.add(builder.build(), point, f"{robot}: {bag.path.name}", generated=generated, forces=forces)

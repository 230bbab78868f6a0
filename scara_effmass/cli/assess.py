"""`scara-effmass assess`."""

import argparse
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from typing import Any

from scara_effmass.analysis.assessment import assess_joint_states, generated_description, joint_state_topic
from scara_effmass.analysis.recorded_run import read_force
from scara_effmass.analysis.summary import Summary
from scara_effmass.analysis.tables import AssessmentWriter, open_writer, provenance
from scara_effmass.analysis.time_series import TimeSeriesBuilder
from scara_effmass.bags.bag import Bag
from scara_effmass.bags.files import find_bags, open_bag
from scara_effmass.cli.console import print_result, progress_bar
from scara_effmass.cli.settings import load_dynamics, monitor_settings
from scara_effmass.model.dynamics import RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.settings import MonitorSettings


class Assessor:
    """Assesses recordings in turn and sums up the results."""

    def __init__(self, dynamics: RobotDynamics, settings: MonitorSettings) -> None:
        """Start without a recording."""
        self._dynamics, self._settings = dynamics, settings
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
        monitor = Monitor(self._dynamics, self._settings)
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
        counts = {"joint_states": self.joint_states, "foreign": self.foreign, "refused": self.rejected}
        notes = list(self._dynamics.robot.notes)
        return {**counts, **self.summary.as_dict(), "losses": self.losses, "robot_notes": notes}

    def lines(self) -> list[tuple[str, str]]:
        """Return the result as subjects and texts."""
        foreign = f", {self.foreign} of other devices ignored" if self.foreign else ""
        lines = [("joint states", f"{self.joint_states}{foreign}"), *self.summary.lines()]
        if self.rejected:
            lines.append(("rejected", f"{self.rejected} joint states (UNKNOWN)"))
        if warning := self._dynamics.robot.rotors.warning:
            lines.append(("robot", warning))
        return lines + [("not read", loss) for loss in self.losses]


def run(args: argparse.Namespace) -> int:
    """Assess the recordings, write table and report, and print the summary."""
    settings = monitor_settings(args)
    dynamics = load_dynamics(settings)
    robot = dynamics.robot
    Monitor(dynamics, settings)  # raises for missing limits before any file is written
    paths = [path for folder in args.bags for path in find_bags(folder)]
    assessor = Assessor(dynamics, settings)
    report = None
    if args.report:
        from scara_effmass.analysis.run_report import RunReport  # noqa: PLC0415 - loads matplotlib

        report = RunReport(args.report, len(paths) * len(dynamics.contact_points), settings, overwrite=args.force)
    with ExitStack() as stack:
        origin = provenance(settings, robot.origin, paths)
        table = stack.enter_context(open_writer(args.output, origin, robot.base_frame, overwrite=args.force))
        progress = stack.enter_context(progress_bar())
        for path in paths:
            with open_bag(path) as bag:
                topic = joint_state_topic(bag, args.topic)
                task = progress.add_task(path.name, total=next(t.count for t in bag.topics if t.name == topic))
                series = {point: TimeSeriesBuilder() for point in dynamics.contact_points} if report else {}
                assessor.assess(bag, topic, table, lambda task=task: progress.advance(task), series)  # type: ignore[misc]
                if report:
                    forces, generated = read_force(bag), bool(generated_description(bag))
                    for point, builder in series.items():
                        title = f"{robot.name}: {bag.path.name}"
                        report.add(builder.build(), point, title, generated=generated, forces=forces)
        result = {"output": str(args.output), **assessor.as_dict()}
        if report:
            result = report.write(f"{robot.name}: assessment", assessor.lines(), result)
    written = [("written", args.output), *([("open", args.report / "report.html")] if report else [])]
    print_result(result, [*assessor.lines(), *written], as_json=args.json)
    return 0

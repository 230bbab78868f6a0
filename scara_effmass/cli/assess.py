# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass assess`."""

import argparse
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from scara_effmass.analysis.assessment import (
    ClockSkew,
    Time,
    assess_joint_states,
    generated_description,
    input_lines,
    joint_state_topic,
    open_velocities,
)
from scara_effmass.analysis.pages import PageOptions
from scara_effmass.analysis.recorded_run import read_force
from scara_effmass.analysis.summary import Summary
from scara_effmass.analysis.tables import open_writer, provenance
from scara_effmass.analysis.time_series import TimeSeriesBuilder
from scara_effmass.bags.files import find_bags, open_bag
from scara_effmass.cli.console import print_result, progress_bar, tracked
from scara_effmass.cli.settings import load_dynamics, monitor_settings
from scara_effmass.errors import BagError, SettingsError
from scara_effmass.safety import Monitor
from scara_effmass.settings import MonitorSettings


def run(args: argparse.Namespace) -> int:
    """Assess the recordings, write table and report, and print the summary."""
    settings = monitor_settings(args)
    dynamics = load_dynamics(settings)
    robot = dynamics.robot
    Monitor(dynamics, settings)  # raises for missing limits before any file is written
    paths = [path for folder in args.bags for path in find_bags(folder)]
    summary = Summary(round(settings.timeout * 1e9))
    counts = dict.fromkeys(("joint_states", "foreign", "refused"), 0)
    losses: list[str] = []
    unreadable: list[str] = []
    time = Time(args.time)
    input_notes = _input_notes(settings, time, args.velocity_bag, len(paths))
    report = None
    if args.report:
        from scara_effmass.analysis.run_report import RunReport  # noqa: PLC0415 - loads matplotlib

        figures, page = len(paths) * len(dynamics.contact_points), PageOptions(args.language, args.pdf)
        report = RunReport(args.report, figures, settings, page, overwrite=args.force)
    with ExitStack() as stack:
        origin = provenance(settings, robot.origin, paths) | {"input": json.dumps(input_notes)}
        table = stack.enter_context(open_writer(args.output, origin, robot.base_frame, overwrite=args.force))
        progress = stack.enter_context(progress_bar())
        for path in paths:
            with (
                _noted(unreadable, len(paths)),
                open_bag(path) as bag,
                open_velocities(args.velocity_bag, args.topic, settings) as velocities,
            ):
                topic = joint_state_topic(bag, args.topic)
                series = {point: TimeSeriesBuilder() for point in dynamics.contact_points} if report else {}
                monitor, name = Monitor(dynamics, settings), str(bag.path)
                summary.new_recording()
                skew = ClockSkew()
                assessed = assess_joint_states(bag, topic, monitor, time, velocities)
                for log_time_ns, state, decision in map(skew.add, tracked(progress, bag, topic, assessed)):
                    counts["joint_states"] += 1
                    if decision is not None:
                        table.add(name, log_time_ns, decision.contacts)
                        summary.add(decision.contacts, log_time_ns, state, name)
                        for contact in decision.contacts if series else ():
                            series[contact.contact_point].add(contact, log_time_ns, state)
                counts["foreign"] += monitor.ignored
                counts["refused"] += monitor.rejected
                losses += bag.losses
                input_notes += skew.lines(settings, time)
                if report:
                    forces, generated = read_force(bag), bool(generated_description(bag))
                    for point, builder in series.items():
                        title = f"{robot.name}: {bag.path.name}"
                        report.add(builder.build(), point, title, generated=generated, forces=forces)
        lines = list(_lines(counts, input_notes, summary, robot.rotors.warning, losses, unreadable))
        notes = {"losses": losses, "robot_notes": list(robot.notes), "unreadable": unreadable, "input": input_notes}
        result = {"output": str(args.output), **counts, **summary.as_dict(), **notes}
        if report:
            others = f" + {len(paths) - 1}" if len(paths) > 1 else ""
            result = report.write(f"{robot.name}: {paths[0].name}{others}", lines, result, paths)
    written = [("written", args.output), *([("open", args.report / "report.html")] if report else [])]
    print_result(result, [*lines, *written], as_json=args.json)
    return 1 if unreadable or summary.only_unknown else 0


@contextmanager
def _noted(errors: list[str], recordings: int) -> Iterator[None]:
    """Add a BagError to `errors`: the other recordings are assessed. Raises BagError if there are none."""
    try:
        yield
    except BagError as error:
        errors.append(str(error))
        if len(errors) == recordings:
            raise BagError("; ".join(errors)) from None


def _input_notes(
    settings: MonitorSettings, time: Time, velocity_bag: Path | None, recordings: int
) -> list[tuple[str, str]]:
    """Return how the assessed joint states differ from the recorded ones. Raises SettingsError."""
    if velocity_bag and recordings > 1:
        raise SettingsError(f"--velocity-bag = {velocity_bag}: must belong to one recording, not to {recordings}")
    return list(input_lines(settings, time, velocity_bag))


def _lines(
    counts: Mapping[str, int],
    input_notes: Sequence[tuple[str, str]],
    summary: Summary,
    robot_warning: str,
    losses: Sequence[str],
    unreadable: Sequence[str],
) -> Iterator[tuple[str, str]]:
    foreign = f", {counts['foreign']} of other devices ignored" if counts["foreign"] else ""
    yield "joint states", f"{counts['joint_states']}{foreign}"
    yield from input_notes
    yield from summary.lines()
    if summary.only_unknown:
        problem = "every joint state is UNKNOWN: the reasons say why; `scara-effmass doctor` checks the robot"
        yield "no verdict", problem if counts["joint_states"] else "there was no joint state to read"
    if counts["refused"]:
        yield "rejected", f"{counts['refused']} joint states (UNKNOWN)"
    if robot_warning:
        yield "robot", robot_warning
    for loss in losses:
        yield "not read", loss
    for error in unreadable:
        yield "not assessed", error

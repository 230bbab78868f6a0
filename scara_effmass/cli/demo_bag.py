# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass demo --bag`: replay a recording to the live monitor and report its verdicts."""

import argparse
import json
import math
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from scara_effmass.analysis.assessed_states import states_of
from scara_effmass.analysis.assessment import (
    generated_description,
    input_lines,
    joint_state_topic,
    payload_topics,
)
from scara_effmass.analysis.pages import PageOptions
from scara_effmass.analysis.recorded_run import read_force
from scara_effmass.analysis.run_report import PAGE, RunReport
from scara_effmass.analysis.summary import Summary
from scara_effmass.analysis.time_series import TimeSeriesBuilder
from scara_effmass.bags.files import open_bag
from scara_effmass.cli import processes
from scara_effmass.cli.console import live_status, print_lines, print_result, printer
from scara_effmass.errors import EffmassError
from scara_effmass.nodes.cell_client import CellClient
from scara_effmass.nodes.replay_topics import JOINT_STATES
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import Decision
from scara_effmass.wire.message_types import FORCE_BLOCK, RUN_INFO

ANSWER_TIMEOUT_S = 10.0
"""Maximum wait for the last messages of the monitor after the end of the replay."""
FORCE_END_TIMEOUT_S = 3.0


class ReplayedBag(NamedTuple):
    """The recording to replay; `more_topics` (payload, run information) pass unchanged.

    `more_topics`, `force_topic` and `description` are empty where it has none.
    """

    path: Path
    topic: str
    more_topics: list[str]
    force_topic: str
    duration_s: float
    description: str


@dataclass
class LiveRun:
    """Verdicts of one replay through the live monitor, and the reports of replay and recorder.

    `foreign` counts joint states of other devices, `lost` those of this robot without an answer.
    """

    summary: Summary
    series: dict[str, TimeSeriesBuilder]
    foreign: int = 0
    answered: int = 0
    watchdog_messages: int = 0
    replayed: dict[str, Any] = field(default_factory=dict)
    recorded: dict[str, Any] = field(default_factory=dict)
    decisions: list[Decision] = field(default_factory=list)

    def count_decisions(self) -> None:
        """Add the decisions to summary and series."""
        if self.decisions:
            states = states_of([decision.assessed_ns for decision in self.decisions], self.decisions)
            self.decisions.clear()
            self.summary.add(states)
            for point, builder in enumerate(self.series.values()):
                builder.add(states, point)

    @property
    def sent(self) -> int:
        """Number of joint states sent."""
        return int(self.replayed["sent"][JOINT_STATES])

    @property
    def lost(self) -> int:
        """Number of this robot's joint states that the monitor did not answer."""
        return self.sent - self.foreign - self.answered

    def read_back(self, bag: ReplayedBag, duration_s: float, monitor: Monitor) -> None:
        """Read from `bag` the count of joint states of other devices and the pose of the tightest margin."""
        tightest = self.summary.tightest
        with open_bag(bag.path) as opened:
            stop_ns = opened.start_ns + round(duration_s * 1e9) if duration_s < math.inf else opened.end_ns + 1
            for block in opened.joint_state_blocks(bag.topic, stop_ns=stop_ns):
                names = monitor.names_of(block.names)
                if names and set(names).isdisjoint(monitor.dynamics.robot.joint_names):
                    self.foreign += len(block)
                elif tightest and (block.stamp_ns == tightest.stamp_ns).any():
                    row = int((block.stamp_ns == tightest.stamp_ns).argmax())
                    positions = dict(zip(names, block.position[row].tolist(), strict=True))
                    self.summary.tightest = tightest._replace(positions=positions)

    def lines(self) -> Iterator[tuple[str, str]]:
        """Yield subject and text of each line about recorder and replay."""
        yield "recorded", processes.recorded_line(self.recorded)
        for name, topic in self.recorded["topics"].items():
            yield "", f"{name}: {topic['recorded']}"
        if self.replayed["late"]:
            worst = f"at worst {self.replayed['worst_lateness_s']:.3f} s: this machine was too busy"
            yield "late", f"{self.replayed['late']} messages were sent late, {worst}"
        for warning in self.replayed["warnings"]:
            yield "recording", warning


def run_bag(args: argparse.Namespace, dynamics: RobotDynamics, settings: MonitorSettings) -> int:
    """Replay the recording live and write the report."""
    robot = dynamics.robot
    with open_bag(args.bag) as opened:
        bag = ReplayedBag(
            path=opened.path,
            topic=joint_state_topic(opened, args.topic),
            more_topics=[
                *payload_topics(opened, settings.payload_topic),
                *(topic.name for topic in opened.topics if topic.type == RUN_INFO),
            ],
            force_topic=next((topic.name for topic in opened.topics if topic.type == FORCE_BLOCK), ""),
            duration_s=min(opened.duration_ns / 1e9, args.duration),
            description=generated_description(opened),
        )
    page = PageOptions(args.language, args.pdf)
    report = RunReport(args.out, len(dynamics.contact_points), settings, page, overwrite=args.force)
    introduction = _introduction(bag, dynamics, settings, args.rate)
    if not args.json:
        print_lines(introduction)
    with processes.removed_on_failure(args.out / processes.RECORDING):
        live = _run_live(args, bag, dynamics, settings)
        if not live.answered:
            hint = f"does {robot.name} fit the recording?"
            raise EffmassError(f"{bag.path}: the monitor answered none of {live.sent} joint states; {hint}")
        with open_bag(args.out / processes.RECORDING) as recording:
            forces = read_force(recording)
        title = f"{robot.name}: {bag.path.name} through the live monitor"
        for point, builder in live.series.items():
            report.add(builder.build(), point, title, generated=bool(bag.description), forces=forces)
        ignored = f", {live.foreign} of other devices" if live.foreign else ""
        counts = f"{live.sent} joint states sent{ignored}, {live.answered} answered, {live.lost} lost"
        force_lines = forces.lines() if forces else ()
        lines = [("joint states", counts), *live.summary.lines(), *force_lines, *live.lines()]
        result = {
            "bag": str(bag.path),
            "topic": bag.topic,
            "generated": bool(bag.description),
            "robot": robot.origin,
            "effective_mass_model": settings.effective_mass_model.value,
            "sent": live.sent,
            "foreign": live.foreign,
            "received": live.answered,
            "lost": live.lost,
            "watchdog_messages": live.watchdog_messages,
            **live.summary.as_dict(),
            **{key: live.replayed[key] for key in ("late", "worst_lateness_s", "warnings")},
            "force": forces and forces.as_dict(),
            "recording": live.recorded,
        }
        result = report.write(title, [*introduction, *lines], result, [bag.path])
    print_result(result, [*lines, ("open", args.out / PAGE)], as_json=args.json)
    return 0


def _run_live(
    args: argparse.Namespace, bag: ReplayedBag, dynamics: RobotDynamics, settings: MonitorSettings
) -> LiveRun:
    """Start the nodes, replay, and receive until the end. Raises EffmassError when a process fails."""
    live = LiveRun(
        Summary(round(settings.timeout * 1e9)), {name: TimeSeriesBuilder() for name in dynamics.contact_points}
    )
    # Plays the force on the clock of the replay and ends with it.
    force_command = ["daq", "--source", "bag", "--path", str(bag.path), "--topic", bag.force_topic]
    force_command += [*processes.SIM_TIME, "-p", "stop_at_end:=true"]
    replay_command = ["replay", str(bag.path), "--topic", bag.topic, "--rate", str(args.rate)]
    replay_command += ["--topics", bag.topic, *bag.more_topics]
    replay_command += ["--duration", str(args.duration), "--wait", str(processes.START_TIMEOUT_S), "--json"]
    replay_command += ["--subscribers", "3"]  # monitor, visualization and recorder
    first_ns = 0

    def on_decision(decision: Decision) -> None:
        nonlocal first_ns
        if decision.watchdog:
            live.watchdog_messages += 1
        elif [contact.contact_point for contact in decision.contacts] == list(live.series):
            first_ns = first_ns or decision.assessed_ns
            live.answered += 1
            live.decisions.append(decision)
        if live.decisions:
            show_status(decision, (live.decisions[-1].assessed_ns - first_ns) / 1e9)

    processes.isolate_ros_domain()
    with ExitStack() as stack:
        commands = (processes.monitor_command(args, settings), processes.visualization_command(settings))
        nodes = [stack.enter_context(processes.ChildProcess(command)) for command in commands]
        force = stack.enter_context(processes.ChildProcess(force_command)) if bag.force_topic else None
        recorder = stack.enter_context(processes.ChildProcess(processes.record_command(args)))
        nodes.append(recorder)
        client = stack.enter_context(CellClient("demo", on_decision=on_decision))
        if not processes.spin_until(
            lambda: client.connected, client, [*nodes, *([force] if force else [])], processes.START_TIMEOUT_S
        ):
            raise EffmassError(f"monitor: not running after {processes.START_TIMEOUT_S:g} s")
        replay = stack.enter_context(processes.ChildProcess(replay_command))
        show_status = stack.enter_context(live_status(printer(), visible=not args.json))
        processes.spin_until(lambda: replay.ended, client, nodes, math.inf)
        live.replayed = json.loads(replay.output())
        live.count_decisions()
        live.read_back(bag, args.duration, Monitor(dynamics, settings))
        client.spin(ANSWER_TIMEOUT_S, lambda: live.answered >= live.sent - live.foreign)
        live.count_decisions()
        if force:
            client.spin(FORCE_END_TIMEOUT_S, lambda: force.ended)
            force.interrupt()
            force.output()
        live.recorded = recorder.recording()
    return live


def _introduction(
    bag: ReplayedBag, dynamics: RobotDynamics, settings: MonitorSettings, rate: float
) -> list[tuple[str, str]]:
    speed = f"{rate:g} times the original speed" if rate else "as fast as the monitor answers"
    generated = f"generated, no real robot: {bag.description}" if bag.description else ""
    return [
        ("recording", f"{bag.path}, {bag.topic}, {bag.duration_s:.1f} s, {speed}"),
        ("motion", generated or "as recorded; the recording does not state that it was generated"),
        ("live", "the monitor node computes all verdicts now, from that motion"),
        ("not measured", "masses and permissible forces come from the robot's model and ISO/TS 15066"),
        ("robot", f"{dynamics.robot.name}, {dynamics.robot.origin}"),
        ("mass model", settings.effective_mass_model.value),
        *input_lines(settings),
        *(("robot file", note) for note in dynamics.robot.notes),
    ]

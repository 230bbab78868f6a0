"""`scara-effmass demo --bag`: replay a recording to the live monitor and report its verdicts."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from scara_effmass.cli.console import print_json, print_lines, printer
from scara_effmass.cli.live import StatusLine
from scara_effmass.cli.processes import (
    RECORDING,
    SIM_TIME,
    START_TIMEOUT_S,
    ChildProcess,
    isolate_ros_domain,
    monitor_command,
    record_command,
    removed_on_failure,
    require_running,
)
from scara_effmass.errors import EffmassError
from scara_effmass.values import ContactAssessment

if TYPE_CHECKING:
    from scara_effmass.model.dynamics import RobotDynamics
    from scara_effmass.settings import MonitorSettings

ANSWER_TIMEOUT_S = 10.0
"""Maximum wait for the last messages of the monitor after the end of the replay."""
FORCE_END_TIMEOUT_S = 3.0


class ReplayedBag(NamedTuple):
    """The recording to replay; `force_topic` and `description` are empty where it has none."""

    path: Path
    topic: str
    force_topic: str
    duration_s: float
    description: str


class LiveRun:
    """One replay through the live monitor, and the messages of the monitor."""

    def __init__(self, dynamics: RobotDynamics, settings: MonitorSettings) -> None:
        """Prepare for the contact points of `dynamics`."""
        from scara_effmass.analysis.summary import Summary  # noqa: PLC0415 - not needed for --help
        from scara_effmass.analysis.time_series import TimeSeriesBuilder  # noqa: PLC0415

        self._joints = frozenset(dynamics.robot.joint_names)
        self._settings = settings
        self.summary = Summary(round(settings.timeout * 1e9))
        self.series = {name: TimeSeriesBuilder() for name in dynamics.contact_points}
        self.sent = self.answered = self.foreign = self.watchdog_messages = 0
        self.replay_report: dict[str, Any] = {}
        self.record_report: dict[str, Any] = {}

    @property
    def lost(self) -> int:
        """Number of this robot's joint states that the monitor did not answer."""
        return self.sent - self.foreign - self.answered

    def run(self, args: argparse.Namespace, bag: ReplayedBag) -> None:
        """Start the nodes, replay, and receive until the end. Raises EffmassError when a process fails."""
        isolate_ros_domain()
        from scara_effmass.nodes.monitor_client import MonitorClient  # noqa: PLC0415 - reads the domain at import

        with ExitStack() as stack:
            monitor = stack.enter_context(ChildProcess(monitor_command(args, self._settings)))
            force = stack.enter_context(ChildProcess(_force_command(bag))) if bag.force_topic else None
            recorder = stack.enter_context(ChildProcess(record_command(args)))
            nodes = [node for node in (monitor, force, recorder) if node]
            status = StatusLine(printer(), visible=not args.json)
            first_ns: list[int] = []

            def on_cycle(contacts: tuple[ContactAssessment, ...], at_ns: int) -> None:
                if not first_ns:
                    first_ns.append(at_ns)
                self.summary.add(contacts, at_ns)
                for contact in contacts:
                    self.series[contact.contact_point].add(contact, at_ns)
                status.show(contacts, (at_ns - first_ns[0]) / 1e9, client.speed_scaling)

            def node_ended() -> bool:
                return any(node.ended for node in nodes)

            with MonitorClient(tuple(self.series), on_cycle) as client:
                if not client.spin(START_TIMEOUT_S, lambda: client.connected or node_ended()):
                    raise EffmassError(f"monitor: not running after {START_TIMEOUT_S:g} s")
                require_running(nodes)
                with ChildProcess(_replay_command(args, bag)) as replay, status:
                    if force:
                        nodes.remove(force)
                    client.spin(math.inf, lambda: replay.ended or node_ended())
                    require_running(nodes)
                    self.replay_report = json.loads(replay.output())
                    self.sent = sum(self.replay_report["sent"].values())
                    self._read_back(bag, args.duration)
                    client.spin(ANSWER_TIMEOUT_S, lambda: client.cycles >= self.sent - self.foreign)
                    self.answered, self.watchdog_messages = client.cycles, client.watchdog_decisions
                    if force:
                        client.spin(FORCE_END_TIMEOUT_S, lambda: force.ended)
                        force.finish()
                    self.record_report = json.loads(recorder.finish())

    def _read_back(self, bag: ReplayedBag, duration_s: float) -> None:
        """Read from the bag the count of joint states of other devices and the pose of the tightest margin."""
        from scara_effmass.bags.files import open_bag  # noqa: PLC0415

        tightest = self.summary.tightest
        with open_bag(bag.path) as opened:
            stop_ns = opened.start_ns + round(duration_s * 1e9) if duration_s < math.inf else opened.end_ns + 1
            for block in opened.joint_state_blocks(bag.topic, stop_ns=stop_ns):
                if block.names and self._joints.isdisjoint(block.names):
                    self.foreign += len(block)
                elif tightest and (block.stamp_ns == tightest.contact.stamp_ns).any():
                    row = int((block.stamp_ns == tightest.contact.stamp_ns).argmax())
                    positions = dict(zip(block.names, block.position[row].tolist(), strict=True))
                    self.summary.tightest = tightest._replace(positions=positions)


def run_bag(args: argparse.Namespace, dynamics: RobotDynamics, settings: MonitorSettings, note: str) -> int:
    """Replay the recording live and write the report; `note` states why another mass model is used."""
    from scara_effmass.analysis.recorded_run import read_force  # noqa: PLC0415 - not needed for --help
    from scara_effmass.analysis.run_report import PAGE, RunReport  # noqa: PLC0415
    from scara_effmass.bags.files import open_bag  # noqa: PLC0415

    bag = _inspect(args)
    live = LiveRun(dynamics, settings)
    report = RunReport(args.out, len(dynamics.contact_points), settings, overwrite=args.force)
    with removed_on_failure(args.out / RECORDING):
        introduction = _introduction(bag, dynamics, note or settings.effective_mass_model.value, args.rate)
        if not args.json:
            print_lines(introduction)
        live.run(args, bag)
        if not live.answered:
            hint = f"does {dynamics.robot.name} fit the recording?"
            raise EffmassError(f"{bag.path}: the monitor answered none of {live.sent} joint states; {hint}")
        with open_bag(args.out / RECORDING) as recording:
            forces = read_force(recording)
        title = f"{dynamics.robot.name}: {bag.path.name} through the live monitor"
        for point, builder in live.series.items():
            report.add(builder.build(), point, title, generated=bool(bag.description), forces=forces)
        lines = [*_lines(live), *live.summary.lines(), *(forces.lines() if forces else ()), *_process_lines(live)]
        result = report.write(
            title,
            [*introduction, *lines],
            {
                "bag": str(bag.path),
                "topic": bag.topic,
                "generated": bool(bag.description),
                "robot": dynamics.robot.origin,
                "effective_mass_model": settings.effective_mass_model.value,
                "sent": live.sent,
                "foreign": live.foreign,
                "received": live.answered,
                "lost": live.lost,
                "watchdog_messages": live.watchdog_messages,
                **live.summary.as_dict(),
                **{key: live.replay_report[key] for key in ("late", "worst_lateness_s", "warnings")},
                "force": forces and forces.as_dict(),
                "recording": live.record_report,
            },
        )
    if args.json:
        print_json(result)
    else:
        print_lines([*lines, ("open", args.out / PAGE)])
    return 0


def _force_command(bag: ReplayedBag) -> list[str]:
    """Return the command that plays the force on the clock of the replay and ends with it."""
    command = ["daq", "--source", "bag", "--path", str(bag.path), "--topic", bag.force_topic]
    return [*command, *SIM_TIME, "-p", "stop_at_end:=true"]


def _replay_command(args: argparse.Namespace, bag: ReplayedBag) -> list[str]:
    """Return the command that replays the joint states once monitor and recorder subscribe."""
    command = ["replay", str(bag.path), "--topic", bag.topic, "--topics", bag.topic]
    command += ["--rate", str(args.rate), "--duration", str(args.duration)]
    return [*command, "--subscribers", "2", "--wait", str(START_TIMEOUT_S), "--json"]


def _inspect(args: argparse.Namespace) -> ReplayedBag:
    from scara_effmass.analysis.assessment import generated_description, joint_state_topic  # noqa: PLC0415
    from scara_effmass.bags.files import open_bag  # noqa: PLC0415
    from scara_effmass.wire.message_types import FORCE_BLOCK  # noqa: PLC0415

    with open_bag(args.bag) as bag:
        return ReplayedBag(
            path=bag.path,
            topic=joint_state_topic(bag, args.topic),
            force_topic=next((topic.name for topic in bag.topics if topic.type == FORCE_BLOCK), ""),
            duration_s=min(bag.duration_ns / 1e9, args.duration),
            description=generated_description(bag),
        )


def _introduction(bag: ReplayedBag, dynamics: RobotDynamics, mass_model: str, rate: float) -> list[tuple[str, str]]:
    speed = f"{rate:g} times the original speed" if rate else "as fast as the monitor answers"
    generated = f"generated, no real robot: {bag.description}" if bag.description else ""
    return [
        ("recording", f"{bag.path}, {bag.topic}, {bag.duration_s:.1f} s, {speed}"),
        ("motion", generated or "as recorded; the recording does not state that it was generated"),
        ("live", "the monitor node computes all verdicts now, from that motion"),
        ("not measured", "masses and permissible forces come from the robot's model and ISO/TS 15066"),
        ("robot", f"{dynamics.robot.name}, {dynamics.robot.origin}"),
        ("mass model", mass_model),
        *(("robot file", note) for note in dynamics.robot.notes),
    ]


def _lines(live: LiveRun) -> Iterator[tuple[str, str]]:
    ignored = f", {live.foreign} of other devices" if live.foreign else ""
    yield "joint states", f"{live.sent} joint states sent{ignored}, {live.answered} answered, {live.lost} lost"


def _process_lines(live: LiveRun) -> Iterator[tuple[str, str]]:
    """Yield the results of the recorder and the replay."""
    recorded, replayed = live.record_report, live.replay_report
    yield "recorded", f"{recorded['messages']} messages, {recorded['lost']} lost: {recorded['bag']}"
    for name, topic in recorded["topics"].items():
        yield "", f"{name}: {topic['recorded']}"
    if replayed["late"]:
        worst = f"at worst {replayed['worst_lateness_s']:.3f} s: this machine was too busy"
        yield "late", f"{replayed['late']} messages were sent late, {worst}"
    for warning in replayed["warnings"]:
        yield "recording", warning

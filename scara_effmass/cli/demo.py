# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass demo`: run all nodes live, and write a report.

On the simulated cell, the report compares its impacts with their predictions. With --bag, `replay` plays a recording to
the nodes, `record` records them, and `assess` reports the recording.
"""

import argparse
import json
import math
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

from scara_effmass.analysis.assessment import (
    generated_description,
    joint_state_topic,
    payload_topics,
    require_stated_robot,
)
from scara_effmass.analysis.forces import recorded_contacts
from scara_effmass.analysis.output import check_output_files
from scara_effmass.analysis.report import PAGE, PageOptions
from scara_effmass.analysis.run_report import RunReport
from scara_effmass.analysis.validation import ValidationSettings, validate, with_motion
from scara_effmass.analysis.validation_report import FILES, summary_lines, write_report
from scara_effmass.bags.bag import Bag
from scara_effmass.bags.files import open_bag
from scara_effmass.bags.writer import BagWriter, check_output
from scara_effmass.cell.status import Validation
from scara_effmass.cli import processes
from scara_effmass.cli.assess import assess
from scara_effmass.cli.console import live_status, print_lines, print_result, printer
from scara_effmass.cli.options import load_dynamics, monitor_settings
from scara_effmass.errors import EffmassError, SettingsError
from scara_effmass.nodes.cell_client import CellClient
from scara_effmass.nodes.replay import JOINT_STATES
from scara_effmass.reference import RobotDynamics
from scara_effmass.settings import DetectionSettings, ImportSettings, MonitorSettings, ValidatorSettings
from scara_effmass.values import Decision, Verdict
from scara_effmass.wire.message_types import FORCE_BLOCK, RUN_INFO

MAX_SLOWDOWN = 10.0
"""Longest run in times its simulated duration: the simulation waits for nodes that fall behind."""
IMPACTS = 12
"""Three configurations with four obstacle masses each."""
FIRST_IMPACT_S = 4.0
IMPACT_PERIOD_S = 3.5
LISTENERS = ("monitor", "visualization", "recorder", "demo")
"""Nodes whose subscription of the joint states the simulation waits for."""
RECORDER_DELAY_S = 60.0
"""Largest delay of recorded log times: simulated time waits for monitor and force node, not for the recorder."""
VALIDATION_DELAY_S = 3.0
"""Time from an impact to its validation, which follows once the rebounds are over."""
ENDPOINTS = (
    *(("contact_states", 1, 3), ("force", 1, 1), ("impact", 1, 1), ("impact_validation", 1, 1)),
    *(("joint_states", 0, 2), ("effective_mass_markers", 1, 0)),
)
"""Topic, publishers and subscribers (this process included) that must exist before the simulation starts."""
INTRODUCTION = (
    ("simulated", "robot, carts and force: the simulated cell (MuJoCo), no real robot, nothing is measured"),
    ("live", "monitor, force and validator nodes compute their messages and verdicts now, over DDS"),
    ("clock", "simulated, at most real time; it waits for the monitor and force nodes when they fall behind"),
    ("experiment", "an i4-550L drives into four carts (0.50 to 7.35 kg) in three configurations, at 0.25 m/s"),
)
QUIET_S = 2.0
"""Time without an answer after which the monitor has answered all joint states of a finished replay."""
FORCE_END_TIMEOUT_S = 3.0
TABLE, PART = "assessed.parquet", "replayed.mcap"
"""Files below the output folder: table of the assessed joint states; the part of the recording that was replayed."""


def run(args: argparse.Namespace) -> int:
    """Run the simulated cell or a replay live, and write the report."""
    check_output(args.out / processes.RECORDING, overwrite=args.force)
    settings = monitor_settings(args)
    dynamics = load_dynamics(settings)
    if args.bag:
        return _run_bag(args, dynamics, settings)
    if settings.robot:
        raise SettingsError("demo: --robot: the simulated cell has its own robot, an i4-550L; --robot needs --bag")
    if settings.payload_mass or settings.payload_topic:
        raise SettingsError("demo: payload: the simulated robot carries none; it needs --bag")
    return _run_sim(args, dynamics, settings)


def _run_sim(args: argparse.Namespace, dynamics: RobotDynamics, settings: MonitorSettings) -> int:
    """Run the simulated cell; return 0 when the series of impacts is accepted, else 1. Raises EffmassError."""
    page = PageOptions(args.language, args.pdf)
    check_output_files(args.out, [*FILES, *page.files()], overwrite=args.force)
    dashboard, address = processes.dashboard_command(args)
    if not args.json:
        print_lines((*INTRODUCTION, ("dashboard", address)))
    with processes.removed_on_failure(args.out / processes.RECORDING):
        live, recorded = _live_sim(args, settings, dashboard)
        validation_settings = ValidationSettings(
            monitor=settings.model_copy(update={"timeout": RECORDER_DELAY_S}),
            validator=ValidatorSettings(clock_tolerance=RECORDER_DELAY_S),
        )
        validation = validate([args.out / processes.RECORDING], dynamics, validation_settings)
        validation = with_motion(validation, dynamics, validation_settings)
        results = write_report(validation, validation_settings, dynamics.robot, args.out, page, overwrite=args.force)
    offline = {impact.stamp_ns for impact in validation.result.impacts}
    counts = {"live": len(live), "offline": len(offline), "both": len(live & offline)}
    lines = [
        ("impacts", f"{len(live)} validated live, {len(offline)} offline, {len(live & offline)} the same"),
        *summary_lines(validation),
        ("recorded", processes.recorded_line(recorded)),
        ("open", args.out / PAGE),
    ]
    print_result({**counts, "recording": recorded, **results}, lines, as_json=args.json)
    return 0 if validation.result.accepted else 1


def _live_sim(
    args: argparse.Namespace, settings: MonitorSettings, dashboard: list[str]
) -> tuple[set[int], dict[str, Any]]:
    """Start all nodes and receive until the last impact.

    Returns the stamps of the impacts that the validator has answered, and the recorder's report.
    """
    start_s = float(round(time.time()))
    duration_s = min(args.duration, FIRST_IMPACT_S + IMPACTS * IMPACT_PERIOD_S)
    cell = ["-p", "sim.scene:=cell", "-p", f"sim.start:={start_s}"]
    commands = processes.commands(args, settings)
    commands += [["daq", "--source", "sim", *processes.SIM_TIME, *cell], ["validator", *processes.SIM_TIME]]
    sim_command = ["sim", "--start", str(start_s), "--clock", "--ros-args", "-p", f"listeners:={json.dumps(LISTENERS)}"]
    stamps_ns: set[int] = set()
    console = printer(live=True)
    assessed_s = -math.inf

    def on_decision(decision: Decision) -> None:
        nonlocal assessed_s
        if not decision.watchdog:
            assessed_s = decision.assessed_ns / 1e9
        if assessed_s > start_s:
            show_status(decision, assessed_s - start_s)

    def on_validation(impact: Validation) -> None:
        stamps_ns.add(impact.stamp_ns)
        if not args.json:
            console.print(
                f"{impact.stamp_ns / 1e9 - start_s:6.1f} s  impact {impact.series.count}: {impact.speed:.3f} m/s, "
                f"{impact.reduced_mass:.3f} kg reduced mass: {impact.measured_force:.1f} N simulated, "
                f"{impact.predicted_force:.1f} N predicted ({impact.relative_error:+.1%})"
            )

    def finished() -> bool:
        # By what has been received: on a busy machine /clock is far ahead of it, and the validator behind the monitor.
        is_over = assessed_s > start_s + duration_s + VALIDATION_DELAY_S
        return len(stamps_ns) >= IMPACTS or (is_over and bool(stamps_ns))

    processes.isolate_ros_domain()
    with ExitStack() as stack:
        children = [stack.enter_context(processes.ChildProcess(command)) for command in commands]
        if dashboard:  # not one of the children, whose end would end the demo
            stack.enter_context(processes.ChildProcess(dashboard))
        client = stack.enter_context(CellClient("demo", on_decision=on_decision, on_validation=on_validation))
        show_status = stack.enter_context(live_status(console, visible=not args.json))
        processes.spin_until(
            lambda: all(client.has_peers(*end) for end in ENDPOINTS),
            client,
            children,
            processes.START_TIMEOUT_S,
            "nodes",
        )
        # The recorder subscribes once it receives the first /clock message, which the waiting simulation publishes.
        children.append(stack.enter_context(processes.ChildProcess(sim_command)))
        processes.spin_until(finished, client, children, processes.START_TIMEOUT_S + MAX_SLOWDOWN * duration_s)
        recorded = children[0].recording()
    if not stamps_ns:
        raise EffmassError("no impact was validated: this machine may be too busy for the simulation")
    return stamps_ns, recorded


class LiveRun(NamedTuple):
    """Joint states by the live verdict, messages of the watchdog, and the reports of the commands."""

    verdicts: Counter[Verdict]
    watchdog_messages: int
    replayed: dict[str, Any]
    recorded: dict[str, Any]


def _run_bag(args: argparse.Namespace, dynamics: RobotDynamics, settings: MonitorSettings) -> int:
    """Replay the recording live and write the report."""
    with open_bag(args.bag) as bag:
        require_stated_robot(bag, settings)
        topic = joint_state_topic(bag, args.topic)
        topics = [topic, *payload_topics(bag, settings.payload_topic)]
        topics += [topic.name for topic in bag.topics if topic.type == RUN_INFO]
        force_topic = next((topic.name for topic in bag.topics if topic.type == FORCE_BLOCK), "")
        introduction = list(_bag_introduction(bag, topic, settings, args))
    check_output_files(args.out, [TABLE, PART], overwrite=args.force)
    page = PageOptions(args.language, args.pdf)
    RunReport(args.out, len(dynamics.contact_points), settings, page, overwrite=args.force)  # refuses existing files
    if not args.json:
        print_lines(introduction)
    recording = args.out / processes.RECORDING
    with processes.removed_on_failure(recording):
        live = _live_bag(args, topics, force_topic, settings)
        sent = int(live.replayed["sent"][JOINT_STATES])
        answered = live.verdicts.total()
        if not answered:
            hint = f"does {dynamics.robot.name} fit the recording?"
            raise EffmassError(f"{args.bag}: the monitor answered none of {sent} joint states; {hint}")
        with open_bag(recording) as bag:
            has_force = any(topic.type == FORCE_BLOCK and topic.count for topic in bag.topics)
        force = recorded_contacts(recording, ImportSettings(), DetectionSettings()) if has_force else None

        def supplement(counts: Mapping[str, int]) -> tuple[list[tuple[str, str]], dict[str, Any]]:
            foreign = counts["foreign"]
            lost = sent - foreign - answered
            text = f"{sent} joint states sent, {foreign} of other devices, {answered} answered, {lost} lost"
            verdicts = {verdict.name: live.verdicts[verdict] for verdict in Verdict}
            lines = [
                ("sent", text),
                ("live", ", ".join(f"{count} {name}" for name, count in verdicts.items() if count)),
            ]
            result = {"bag": str(args.bag), "sent": sent, "received": answered, "lost": lost}
            result |= {"live_cycles_by_verdict": verdicts}
            result |= {"watchdog_messages": live.watchdog_messages, "force": force and force.as_dict()}
            result |= {key: live.replayed[key] for key in ("late", "worst_lateness_s", "warnings")}
            if force:
                contacts = (("  contact", text) for text in force.texts())
                lines += [("force", force.force_text), *contacts, *force.lines()]
            return [*introduction, *lines, *_bag_lines(live)], {**result, "recording": live.recorded}

        # Not the new recording, whose log times are those of the recorder, which may lag behind the monitor.
        bag_path = _part(args, topics) if args.duration < math.inf else args.bag
        options = {"bags": [bag_path], "output": args.out / TABLE, "report": args.out}
        options |= {"time": "live", "jobs": 1, "properties": False, "cross_check": False}
        options |= dict.fromkeys(("cell", "scheduler", "velocity_bag", "memory_limit"))
        name = f"{args.bag.name} through the live monitor"
        assessment = assess(argparse.Namespace(**{**vars(args), **options}), name, supplement)
    print_result(assessment.result, assessment.lines[len(introduction) :], as_json=args.json)
    return 0


def _part(args: argparse.Namespace, topics: list[str]) -> Path:
    """Write the part of the recording that was replayed, and return its path. Raises OutputError."""
    path: Path = args.out / PART
    with open_bag(args.bag) as bag, BagWriter(path, overwrite=args.force, types=bag.types) as writer:
        for message in bag.messages(topics, stop_ns=bag.start_ns + round(args.duration * 1e9)):
            writer.write(*message)
    return path


def _bag_introduction(
    bag: Bag, topic: str, settings: MonitorSettings, args: argparse.Namespace
) -> Iterator[tuple[str, str]]:
    note = generated_description(bag)
    duration_s = min(bag.duration_ns / 1e9, args.duration)
    yield "recording", f"{bag.path}, {topic}, {duration_s:.1f} s, {args.rate:g} times the original speed"
    yield "motion", f"generated, no real robot: {note}" if note else "as recorded"
    yield "live", "the monitor node computes all verdicts now, from that motion"
    yield "not measured", "masses and permissible forces come from the robot's model and ISO/TS 15066"
    yield "mass model", settings.effective_mass_model.value


def _bag_lines(live: LiveRun) -> Iterator[tuple[str, str]]:
    """Yield subject and text of each line about recorder and replay."""
    yield "recorded", processes.recorded_line(live.recorded)
    for name, topic in live.recorded["topics"].items():
        yield "", f"{name}: {topic['recorded']}"
    if live.replayed["late"]:
        worst = f"at worst {live.replayed['worst_lateness_s']:.3f} s: this machine was too busy"
        yield "late", f"{live.replayed['late']} messages were sent late, {worst}"
    for warning in live.replayed["warnings"]:
        yield "recording", warning


def _live_bag(args: argparse.Namespace, topics: list[str], force_topic: str, settings: MonitorSettings) -> LiveRun:
    """Start the nodes, replay `topics`, of which the first has the joint states, and receive until the end.

    Raises EffmassError when a process fails.
    """
    commands = processes.commands(args, settings)
    if force_topic:  # plays the force on the clock of the replay and ends with it
        source = ["--source", "bag", "--path", str(args.bag), "--topic", force_topic]
        commands.append(["daq", *source, *processes.SIM_TIME, "-p", "stop_at_end:=true"])
    replay_command = ["replay", str(args.bag), "--topic", topics[0], "--topics", *topics, "--rate", str(args.rate)]
    replay_command += ["--duration", str(args.duration), "--wait", str(processes.START_TIMEOUT_S), "--json"]
    replay_command += ["--subscribers", "4"]  # this process, monitor, visualization and recorder
    first_ns = last_ns = 0
    verdicts = Counter[Verdict]()

    watchdog_messages = 0

    def on_decision(decision: Decision) -> None:
        nonlocal first_ns, last_ns, watchdog_messages
        if decision.watchdog:
            watchdog_messages += 1
        else:
            last_ns = decision.assessed_ns
            first_ns = first_ns or last_ns
            verdicts[decision.verdict] += 1
        if first_ns:
            show_status(decision, (last_ns - first_ns) / 1e9)

    processes.isolate_ros_domain()
    with ExitStack() as stack:
        children = [stack.enter_context(processes.ChildProcess(command)) for command in commands]
        client = stack.enter_context(CellClient("demo", on_decision=on_decision))
        processes.spin_until(lambda: client.connected, client, children, processes.START_TIMEOUT_S, "monitor")
        force = children.pop() if force_topic else None
        replay = stack.enter_context(processes.ChildProcess(replay_command))
        show_status = stack.enter_context(live_status(printer(live=True), visible=not args.json))
        processes.spin_until(lambda: replay.ended, client, children, math.inf)
        replayed = json.loads(replay.output())
        answered, sent = -1, replayed["sent"][JOINT_STATES]
        while answered < verdicts.total() < sent:
            answered = verdicts.total()
            client.spin(QUIET_S, lambda: verdicts.total() == sent)
        if force:
            client.spin(FORCE_END_TIMEOUT_S, lambda: force.ended)
            force.interrupt()
            force.output()
        return LiveRun(verdicts, watchdog_messages, replayed, children[0].recording())

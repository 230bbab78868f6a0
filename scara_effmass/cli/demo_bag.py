# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass demo --bag`: replay a recording to the live nodes, record them, and assess it offline."""

import argparse
import json
import math
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

from scara_effmass.analysis.assessment import generated_description, joint_state_topic, payload_topics
from scara_effmass.analysis.forces import read_force
from scara_effmass.analysis.output import check_output_files
from scara_effmass.analysis.report import PageOptions
from scara_effmass.analysis.run_report import RunReport
from scara_effmass.bags.bag import Bag
from scara_effmass.bags.files import open_bag
from scara_effmass.bags.writer import BagWriter
from scara_effmass.cli import processes
from scara_effmass.cli.assess import assess
from scara_effmass.cli.console import live_status, print_lines, print_result, printer
from scara_effmass.errors import EffmassError
from scara_effmass.nodes.cell_client import CellClient
from scara_effmass.nodes.replay_topics import JOINT_STATES
from scara_effmass.reference import RobotDynamics
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import Decision, Verdict
from scara_effmass.wire.message_types import FORCE_BLOCK, RUN_INFO

QUIET_S = 2.0
"""Time without an answer after which the monitor has answered all joint states of a finished replay."""
FORCE_END_TIMEOUT_S = 3.0
TABLE, PART = "assessed.parquet", "replayed.mcap"
"""Files below the output folder: table of the assessed joint states; the part of the recording that was replayed."""


class LiveRun(NamedTuple):
    """Joint states by the live verdict, messages of the watchdog, and the reports of the commands."""

    verdicts: Counter[Verdict]
    watchdog_messages: int
    replayed: dict[str, Any]
    recorded: dict[str, Any]


def run_bag(args: argparse.Namespace, dynamics: RobotDynamics, settings: MonitorSettings) -> int:
    """Replay the recording live and write the report."""
    with open_bag(args.bag) as bag:
        topic = joint_state_topic(bag, args.topic)
        topics = [topic, *payload_topics(bag, settings.payload_topic)]
        topics += [topic.name for topic in bag.topics if topic.type == RUN_INFO]
        force_topic = next((topic.name for topic in bag.topics if topic.type == FORCE_BLOCK), "")
        introduction = list(_introduction(bag, topic, dynamics, settings, args))
    check_output_files(args.out, [TABLE, PART], overwrite=args.force)
    page = PageOptions(args.language, args.pdf)
    RunReport(args.out, len(dynamics.contact_points), settings, page, overwrite=args.force)  # refuses existing files
    if not args.json:
        print_lines(introduction)
    recording = args.out / processes.RECORDING
    with processes.removed_on_failure(recording):
        live = _run_live(args, topics, force_topic, settings)
        sent = int(live.replayed["sent"][JOINT_STATES])
        answered = live.verdicts.total()
        if not answered:
            hint = f"does {dynamics.robot.name} fit the recording?"
            raise EffmassError(f"{args.bag}: the monitor answered none of {sent} joint states; {hint}")
        with open_bag(recording) as bag:
            forces = read_force(bag)

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
            result |= {"watchdog_messages": live.watchdog_messages, "force": forces and forces.as_dict()}
            result |= {key: live.replayed[key] for key in ("late", "worst_lateness_s", "warnings")}
            force_lines = forces.lines() if forces else ()
            return [*introduction, *lines, *force_lines, *_lines(live)], {**result, "recording": live.recorded}

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


def _introduction(
    bag: Bag, topic: str, dynamics: RobotDynamics, settings: MonitorSettings, args: argparse.Namespace
) -> Iterator[tuple[str, str]]:
    note = generated_description(bag)
    duration_s = min(bag.duration_ns / 1e9, args.duration)
    yield "recording", f"{bag.path}, {topic}, {duration_s:.1f} s, {args.rate:g} times the original speed"
    yield "motion", f"generated, no real robot: {note}" if note else "as recorded"
    yield "live", "the monitor node computes all verdicts now, from that motion"
    yield "not measured", "masses and permissible forces come from the robot's model and ISO/TS 15066"
    yield "robot", f"{dynamics.robot.name}, {dynamics.robot.origin}"
    yield "mass model", settings.effective_mass_model.value


def _lines(live: LiveRun) -> Iterator[tuple[str, str]]:
    """Yield subject and text of each line about recorder and replay."""
    yield "recorded", processes.recorded_line(live.recorded)
    for name, topic in live.recorded["topics"].items():
        yield "", f"{name}: {topic['recorded']}"
    if live.replayed["late"]:
        worst = f"at worst {live.replayed['worst_lateness_s']:.3f} s: this machine was too busy"
        yield "late", f"{live.replayed['late']} messages were sent late, {worst}"
    for warning in live.replayed["warnings"]:
        yield "recording", warning


def _run_live(args: argparse.Namespace, topics: list[str], force_topic: str, settings: MonitorSettings) -> LiveRun:
    """Start the nodes, replay `topics`, of which the first has the joint states, and receive until the end.

    Raises EffmassError when a process fails.
    """
    commands = [processes.monitor_command(args, settings), processes.visualization_command(settings)]
    if force_topic:  # plays the force on the clock of the replay and ends with it
        source = ["--source", "bag", "--path", str(args.bag), "--topic", force_topic]
        commands.append(["daq", *source, *processes.SIM_TIME, "-p", "stop_at_end:=true"])
    commands.append(processes.record_command(args))
    replay_command = ["replay", str(args.bag), "--topic", topics[0], "--topics", *topics, "--rate", str(args.rate)]
    replay_command += ["--duration", str(args.duration), "--wait", str(processes.START_TIMEOUT_S), "--json"]
    replay_command += ["--subscribers", "3"]  # monitor, visualization and recorder
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
        if not processes.spin_until(lambda: client.connected, client, children, processes.START_TIMEOUT_S):
            raise EffmassError(f"monitor: not running after {processes.START_TIMEOUT_S:g} s")
        force = children.pop(2) if force_topic else None
        replay = stack.enter_context(processes.ChildProcess(replay_command))
        show_status = stack.enter_context(live_status(printer(), visible=not args.json))
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
        return LiveRun(verdicts, watchdog_messages, replayed, children[-1].recording())

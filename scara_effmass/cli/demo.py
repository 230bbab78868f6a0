# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass demo`: run all nodes on the simulated cell, and report its impacts, or on a recording."""

import argparse
import math
import time
from contextlib import ExitStack
from typing import Any

from scara_effmass.analysis.output import check_output_files
from scara_effmass.analysis.report import PAGE, PageOptions
from scara_effmass.analysis.validation import ValidationSettings, validate
from scara_effmass.analysis.validation_report import FILES, summary_lines, write_report
from scara_effmass.bags.files import check_output
from scara_effmass.cell.status import Validation
from scara_effmass.cli import processes
from scara_effmass.cli.console import live_status, print_lines, print_result, printer
from scara_effmass.cli.demo_bag import run_bag
from scara_effmass.cli.settings import load_dynamics, monitor_settings
from scara_effmass.errors import EffmassError, SettingsError
from scara_effmass.nodes.cell_client import CellClient
from scara_effmass.reference import RobotDynamics
from scara_effmass.settings import MonitorSettings, ValidatorSettings
from scara_effmass.values import Decision

MAX_SLOWDOWN = 10.0
"""Longest run in times its simulated duration: the simulation waits for nodes that fall behind."""
IMPACTS = 12
"""Three configurations with four obstacle masses each."""
FIRST_IMPACT_S = 4.0
IMPACT_PERIOD_S = 3.5
RECORDER_DELAY_S = 5.0
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


def run(args: argparse.Namespace) -> int:
    """Run the simulated cell or a replay live, and write the report."""
    check_output(args.out / processes.RECORDING, overwrite=args.force)
    settings = monitor_settings(args)
    dynamics = load_dynamics(settings)
    if args.bag:
        return run_bag(args, dynamics, settings)
    if settings.robot:
        raise SettingsError("demo: --robot: the simulated cell has its own robot, an i4-550L; --robot needs --bag")
    if args.topic:
        raise SettingsError(f"demo: --topic = {args.topic}: the simulated cell has its own topic; it needs --bag")
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
        live, recorded = _run_live(args, settings, dashboard)
        validation_settings = ValidationSettings(
            monitor=settings.model_copy(update={"timeout": RECORDER_DELAY_S}),
            validator=ValidatorSettings(clock_tolerance=RECORDER_DELAY_S),
        )
        validation = validate([args.out / processes.RECORDING], dynamics, validation_settings)
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


def _run_live(
    args: argparse.Namespace, settings: MonitorSettings, dashboard: list[str]
) -> tuple[set[int], dict[str, Any]]:
    """Start all nodes and receive until the last impact.

    Returns the stamps of the impacts that the validator has answered, and the recorder's report.
    """
    start_s = float(round(time.time()))
    duration_s = min(args.duration, FIRST_IMPACT_S + IMPACTS * IMPACT_PERIOD_S)
    cell = ["-p", "sim.scene:=cell", "-p", f"sim.start:={start_s}"]
    commands = (
        processes.record_command(args),
        ["daq", "--source", "sim", *processes.SIM_TIME, *cell],
        ["validator", *processes.SIM_TIME],
        processes.monitor_command(args, settings),
        processes.visualization_command(settings),
    )
    sim_command = ["sim", "--start", str(start_s), "--clock", "--ros-args", "-p", "listeners:=3"]
    stamps_ns: set[int] = set()
    console = printer()
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
        is_ready = processes.spin_until(
            lambda: all(client.has_peers(*end) for end in ENDPOINTS), client, children, processes.START_TIMEOUT_S
        )
        if not is_ready:
            raise EffmassError(f"nodes: not running after {processes.START_TIMEOUT_S:g} s")
        # The recorder subscribes once it receives the first /clock message, which the simulation publishes.
        children.append(stack.enter_context(processes.ChildProcess(sim_command)))
        processes.spin_until(finished, client, children, processes.START_TIMEOUT_S + MAX_SLOWDOWN * duration_s)
        recorded = children[0].recording()
    if not stamps_ns:
        raise EffmassError("no impact was validated: this machine may be too busy for the simulation")
    return stamps_ns, recorded

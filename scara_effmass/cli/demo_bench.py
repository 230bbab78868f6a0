"""The demo without a recording: the simulated cell, all nodes on it, and the report of its impacts."""

from __future__ import annotations

import json
import time
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

from scara_effmass.cli.demo import BAG, SIMULATED_TIME, monitor_words, record_words
from scara_effmass.cli.live import StatusLine
from scara_effmass.cli.processes import child_process, keep_to_this_machine, require_running
from scara_effmass.cli.report import validation_lines
from scara_effmass.errors import EffmassError
from scara_effmass.settings import ValidatorSettings

if TYPE_CHECKING:
    import argparse

    from rich.console import Console
    from scara_effmass_msgs.msg import ImpactValidation

    from scara_effmass.model.dynamics import RobotDynamics
    from scara_effmass.settings import MonitorSettings
    from scara_effmass.values import ContactAssessment

START_WITHIN_S = 60.0
SLOWEST = 10.0
"""Times real time that it may take: the simulation waits for nodes that fall behind."""
IMPACTS = 12
"""Three configurations with four masses each."""
FIRST_AFTER_S = 4.0
PER_IMPACT_S = 3.5
RECORDED_LATE_S = 5.0
"""Time waits for the nodes, not for the recorder: on a busy machine it hears of them so much later."""
FORCE_TOPIC_IS_LATE_S = 3.0
"""An impact is told once its rebounds are over, and validated then."""
WIRES = (("contact_state", 1, 2), ("force", 1, 1), ("impact", 1, 1), ("impact_validation", 1, 1))
"""Topics of the nodes, and how many publish and listen there, the demo included, before time begins."""
INTRODUCTION = (
    ("simulated", "robot, carts and force: the simulated cell (MuJoCo), no real robot, nothing is measured"),
    ("live", "monitor, force and validator nodes, their messages and verdicts: computed now, over DDS"),
    ("its time", "simulated: real time at most, and it waits for monitor and force node where they fall behind"),
    ("experiment", "an i4-550L drives into four carts (0.50 to 7.35 kg) in three configurations, at 0.25 m/s"),
)


def run_bench(args: argparse.Namespace, arm: RobotDynamics, settings: MonitorSettings, console: Console) -> int:
    """Run it; return 0 when the series is accepted, else 1. Raises EffmassError."""
    from scara_effmass.analysis.validation import ValidationSettings, validate  # noqa: PLC0415
    from scara_effmass.analysis.validation_record import record  # noqa: PLC0415
    from scara_effmass.analysis.validation_report import PAGE, require_room, write_report  # noqa: PLC0415

    require_room(args.out, overwrite=args.force)
    if not args.json:
        for subject, text in INTRODUCTION:
            console.print(f"{subject:<16}{text}")
    live, recorded = _run_live(args, arm, settings, console)
    validation_settings = ValidationSettings(
        monitor=settings.model_copy(update={"timeout": RECORDED_LATE_S}),
        validator=ValidatorSettings(clock_tolerance=RECORDED_LATE_S),
    )
    validation = validate([args.out / BAG], arm, validation_settings)
    write_report(validation, validation_settings, arm.robot, args.out, overwrite=args.force)
    result = validation.result
    told = {_stamp_ns(message) for message in live}
    found = {impact.stamp_ns for impact in result.impacts}
    summary: dict[str, Any] = {
        "live": len(told),
        "offline": len(found),
        "both": len(told & found),
        "recording": recorded,
        **record(validation, validation_settings, arm.robot),
    }
    code = 0 if result.accepted else 1
    if args.json:
        console.print_json(json.dumps(summary, allow_nan=False))
        return code
    console.print(f"{'impacts':<16}{len(told)} validated live, {len(found)} offline, {len(told & found)} the same")
    for subject, text in validation_lines(validation):
        console.print(f"{subject:<16}{text}")
    console.print(f"{'recorded':<16}{recorded['messages']} messages, {recorded['lost']} lost: {recorded['bag']}")
    console.print(f"{'open':<16}{args.out / PAGE}")
    return code


def _run_live(
    args: argparse.Namespace, arm: RobotDynamics, settings: MonitorSettings, console: Console
) -> tuple[list[ImpactValidation], dict[str, Any]]:
    """Start everything, watch until the impacts are over; return what the validator said and the recorder's report."""
    keep_to_this_machine()
    from scara_effmass.nodes.monitor_client import MonitorClient  # noqa: PLC0415 - reads the domain when it is made

    start_s = float(round(time.time()))
    span_s = min(args.duration, FIRST_AFTER_S + IMPACTS * PER_IMPACT_S)
    cell = ["-p", "sim.scene:=cell", "-p", f"sim.start:={start_s}"]
    words = {
        "daq": ["daq", "--source", "sim", *SIMULATED_TIME, *cell],
        "validator": ["validator", *SIMULATED_TIME],
        "monitor": monitor_words(args, settings),
        "record": record_words(args),
    }
    bench = ["sim", "--start", str(start_s), "--clock", "--ros-args", "-p", "listeners:=2"]
    heard: list[ImpactValidation] = []
    with ExitStack() as running:
        processes = {name: running.enter_context(child_process(each)) for name, each in words.items()}
        display = StatusLine(console, span_s)

        def on_cycle(contacts: tuple[ContactAssessment, ...], at_ns: int) -> None:
            if not args.json:
                display.show(contacts, at_ns / 1e9 - start_s, watch.speed_scaling)

        def on_validation(message: ImpactValidation) -> None:
            heard.append(message)
            if not args.json:
                console.print(_line(message, start_s))

        def over() -> bool:
            late = watch.now_ns / 1e9 > start_s + span_s + FORCE_TOPIC_IS_LATE_S
            return late or len(heard) >= IMPACTS or any(process.ended for process in processes.values())

        with MonitorClient(arm.contact_points, on_cycle, on_validation) as watch, display:
            if not watch.spin(START_WITHIN_S, lambda: all(watch.has_ends(*each) for each in WIRES) or over()):
                raise EffmassError(f"the nodes have not come up within {START_WITHIN_S:g} s")
            require_running(processes.values())
            # With the first clock, which the bench gives, the recorder comes to them.
            processes["bench"] = running.enter_context(child_process(bench))
            watch.spin(START_WITHIN_S + SLOWEST * span_s, over)
            require_running(processes.values())
            recorded: dict[str, Any] = json.loads(processes["record"].finish())
    if not heard:
        raise EffmassError("no impact was validated: this machine may be too busy for the simulation")
    return heard, recorded


def _line(message: ImpactValidation, start_s: float) -> str:
    return (
        f"{_stamp_ns(message) / 1e9 - start_s:6.1f} s  impact {message.count}: {message.speed:.3f} m/s, "
        f"{message.reduced_mass:.3f} kg reduced: {message.measured_force:.1f} N simulated, "
        f"{message.predicted_force:.1f} N predicted ({message.relative_error:+.1%})"
    )


def _stamp_ns(message: ImpactValidation) -> int:
    return int(message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec)

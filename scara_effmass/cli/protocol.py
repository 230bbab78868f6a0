# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass protocol`: write, fill in and render a measurement protocol."""

import argparse
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from shlex import quote
from typing import Any

from scara_effmass.analysis.assessment import assessed_rows, joint_state_topic
from scara_effmass.analysis.output import atomic_file, check_output_files, check_output_path
from scara_effmass.analysis.protocol import Plan, Protocol, Repetition, nearest_turn, protocol_yaml, read_protocol
from scara_effmass.analysis.protocol_evaluation import (
    MAX_CONTACT_S,
    MISSING,
    RECORD,
    device_of,
    evaluated,
    filled,
    record,
    write_report,
)
from scara_effmass.analysis.report import PAGE, PageOptions
from scara_effmass.analysis.workspace_map import AS_SAMPLED, Plane, sample_workspace
from scara_effmass.bags.files import open_bag
from scara_effmass.cli.console import print_json, print_result, shown_progress
from scara_effmass.cli.options import (
    load_dynamics,
    monitor_settings,
    override,
    require_no_payload_topic,
    robot_line,
    shell_path,
)
from scara_effmass.cli.validate import validated, validation_settings
from scara_effmass.errors import RobotError, SettingsError
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.settings import ContactType, MonitorSettings
from scara_effmass.values import Verdict, at_least

NOT_OK = 1
MARK = b"tests:"
"""What a protocol holds."""
GAPS_SHOWN = 3
"""Most missing values of a test point that are printed."""
BASE_AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def run_schema(_: argparse.Namespace) -> int:
    """Print the JSON schema of a protocol."""
    print_json(Protocol.model_json_schema())
    return 0


def run_init(args: argparse.Namespace) -> int:
    """Write a protocol with proposed test points, and print them."""
    check_output_path(args.output, overwrite=args.force, mark=MARK)
    settings = monitor_settings(args)
    if args.map:
        if args.recording:
            raise SettingsError("--map: must be without --from: the speeds of one cannot be compared with the other's")
        require_no_payload_topic(settings, "a map")
    plan = Plan(settings, args.points)
    dynamics = load_dynamics(settings)
    if args.recording:
        _add_recording(plan, args, settings, dynamics)
    if args.map:
        _add_workspace(plan, args, monitor_settings(args, **AS_SAMPLED), dynamics)
    protocol = plan.protocol(dynamics.robot.name)
    with atomic_file(args.output, overwrite=args.force, mark=MARK) as path:
        path.write_text(protocol_yaml(protocol), encoding="utf-8")
    lines = [robot_line(dynamics.robot, settings)]
    lines += [("test", f"{test.id}: {test.note}") for test in protocol.tests if test.note]
    lines += [("left out", f"{plan.unknown} contacts that are UNKNOWN")] if plan.unknown else []
    lines += [("left out", f"{plan.at_rest} contacts at rest")] if plan.at_rest else []
    # The recordings come first: argparse would take --test for the end of them.
    test = f" --test {quote(protocol.tests[0].id)}" if len(protocol.tests) > 1 else ""
    next_step = f"fill in the file, then: scara-effmass protocol fill {shell_path(args.output)} BAG{test}"
    result = {"output": str(args.output), **protocol.model_dump(mode="json")}
    print_result(result, [*lines, ("written", args.output), ("next", next_step)], as_json=args.json)
    return 0


def _add_recording(plan: Plan, args: argparse.Namespace, settings: MonitorSettings, dynamics: RobotDynamics) -> None:
    with open_bag(args.recording) as bag, shown_progress(bag.path.name) as advance:
        topic, monitor = joint_state_topic(bag, args.topic), Monitor(dynamics, settings)
        for _, state, decision in assessed_rows(bag, topic, monitor, advance=advance):
            if state is not None:
                pose = dict(zip(monitor.names_of(state.names), state.position.tolist(), strict=False))
                pose = nearest_turn(pose, dynamics.robot.turns)
                for contact in decision.contacts:
                    plan.add(contact, pose)


def _add_workspace(plan: Plan, args: argparse.Namespace, settings: MonitorSettings, dynamics: RobotDynamics) -> None:
    """Add configurations that move along the axes of the base. Raises RobotError if none of them can."""
    samples = []
    with shown_progress("configurations", len(BASE_AXES) * args.samples) as advance:
        for axis in BASE_AXES:
            monitor = Monitor(dynamics, settings)
            with suppress(RobotError):  # a robot need not move along every axis
                samples.append(sample_workspace(monitor, axis, "", Plane(), args.samples, advance))
    if not samples:
        raise RobotError(f"{dynamics.robot.origin}: must move along an axis of the base")
    for sample in samples:
        for q, contact in zip(sample.q.tolist(), sample.assessments(), strict=True):
            plan.add(contact, dict(zip(dynamics.robot.joint_names, q, strict=True)), at_limit=True)


def run_fill(args: argparse.Namespace) -> int:
    """Enter the contacts of recordings, evaluate, and print the verdicts."""
    target, folder = args.output or args.protocol, args.protocol.parent
    overwrite = args.force or target == args.protocol
    check_output_path(target, overwrite=overwrite, mark=MARK)
    protocol, losses = read_protocol(args.protocol), list[str]()
    if args.bags:
        protocol, losses = _filled(args, protocol)
    protocol = evaluated(protocol, folder)
    with atomic_file(target, overwrite=overwrite, mark=MARK) as path:
        path.write_text(protocol_yaml(protocol.moved(folder, target.parent)), encoding="utf-8")
    return _printed(protocol, {"output": str(target), "losses": losses}, target, as_json=args.json)


def run_report(args: argparse.Namespace) -> int:
    """Evaluate, write the report, and print the verdicts."""
    options = PageOptions(args.language, args.pdf)
    check_output_files(args.output, [PAGE, RECORD, *options.files()], overwrite=args.force)
    protocol = evaluated(read_protocol(args.protocol), args.protocol.parent)
    write_report(protocol, args.protocol, args.output, options, overwrite=args.force)
    return _printed(protocol, {"output": str(args.output)}, args.output / PAGE, as_json=args.json)


def _printed(protocol: Protocol, result: dict[str, Any], written: Path, *, as_json: bool) -> int:
    """Print the verdicts; return the exit status."""
    content = record(protocol)
    lines: list[tuple[str, object]] = [("not read", loss) for loss in result.get("losses", ())]
    lines += [("verdict", content["verdict"])]
    for test in protocol.tests:
        for item in test.results.left_out:
            size = "" if item.peak_n is None else f" (up to {at_least(item.peak_n, 1)} N)"
            lines += [("left out", f"{test.id}: {item.count}: {item.reason}{size} in {item.raw_data or 'all'}")]
        if evaluation := test.results.evaluation:
            lines += [(evaluation.verdict, f"{test.id}: {reason}") for reason in _shortened(evaluation.reasons)]
    print_result({**result, **content}, [*lines, ("written", written)], as_json=as_json)
    return 0 if content["verdict"] == Verdict.OK.name else NOT_OK


def _shortened(reasons: Sequence[str]) -> list[str]:
    """Return `reasons` with the values that are missing in one of them."""
    gaps = [reason.removeprefix(MISSING) for reason in reasons if reason.startswith(MISSING)]
    more = f" and {len(gaps) - GAPS_SHOWN} more (--json lists them)" if len(gaps) > GAPS_SHOWN else ""
    others = [reason for reason in reasons if not reason.startswith(MISSING)]
    return [f"{MISSING}{', '.join(gaps[:GAPS_SHOWN])}{more}", *others] if gaps else others


def _filled(args: argparse.Namespace, protocol: Protocol) -> tuple[Protocol, list[str]]:
    """Return `protocol` with the contacts of the recordings in one test, and what could not be read.

    Raises EffmassError.
    """
    origin = str(args.protocol)
    if not protocol.tests:
        raise SettingsError(f"{origin}: tests: must state a test for the contacts")
    if args.test is None and len(protocol.tests) > 1:
        raise SettingsError(f"--test: must be one of {', '.join(test.id for test in protocol.tests)}")
    test = protocol.test(args.test or protocol.tests[0].id)
    if any(item != Repetition() for item in test.results.repetitions) and not args.force:
        raise SettingsError(f"{origin}: tests.{test.id}: already filled in; use --force to replace its contacts")
    device = device_of(protocol, test, origin)
    args.stiffness_n_m, args.obstacle_fixed = device.stiffness_n_m, device.fixed
    args.obstacle_mass = device.moving_mass_kg
    args.body_regions, args.contact = [test.point.body_region], test.point.contact
    args.contact_area_m2 = test.point.contact_area_m2
    settings = validation_settings(args)
    if test.point.contact is ContactType.QUASI_STATIC:  # a held contact is to be one impact
        validator = override(settings.validator, {"impact_delay": 3.0 * MAX_CONTACT_S, "history": 6.0 * MAX_CONTACT_S})
        detection = override(settings.detection, {"longest": MAX_CONTACT_S})
        settings = replace(settings, validator=validator, detection=detection)
    dynamics = load_dynamics(settings.monitor)
    if test.point.contact_point in dynamics.contact_points:
        validator = override(settings.validator, {"contact_point": test.point.contact_point})
        settings = replace(settings, validator=validator)
    validation = validated(args, settings)
    names_of = Monitor(dynamics, settings.monitor).names_of
    test = filled(test, validation, settings.force, args.protocol.parent, settings.time, names_of, dynamics.robot.turns)
    losses = [loss for recording in validation.recordings for loss in recording.losses]
    return protocol.replaced(test), losses

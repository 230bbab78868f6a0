# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass init`: write the parameter file of a cell."""

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from textwrap import wrap
from typing import Any

import yaml
from pydantic import BaseModel

from scara_effmass import __version__
from scara_effmass.analysis.assessment import assess_joint_states, joint_state_topic
from scara_effmass.analysis.assumption_worth import POSES, TYPICAL_SPEED, worth_of
from scara_effmass.analysis.output import atomic_file, check_output_path
from scara_effmass.analysis.summary import Summary
from scara_effmass.bags.files import open_bag
from scara_effmass.cli.console import print_lines, print_table, shown_progress
from scara_effmass.cli.doctor import cell_results, tightest
from scara_effmass.cli.options import SHOWN, Option, monitor_settings, options_of, robot_line, shell_path
from scara_effmass.errors import EffmassError, SettingsError
from scara_effmass.iso15066 import BODY_REGIONS
from scara_effmass.model.urdf import CHAIN_NOTES
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.safety.assumptions import assumptions_of
from scara_effmass.settings import DaqSettings, MonitorSettings, ValidatorSettings
from scara_effmass.settings.loading import flat_fields
from scara_effmass.wire.topics import JOINT_STATES

MARK = b"ros__parameters:"
"""What a parameter file holds."""
ASKED = {"robot", "bag", "effective_mass_model", "joint_map", "contact_points", "payload_mass", "payload_com"}
ASKED |= {"payload_inertia", "body_regions", "contact", "contact_area_m2", "max_acceleration", "person_speed"}
"""Options that most cells need."""


def run(args: argparse.Namespace) -> int:
    """Ask for what is missing if stdin is a terminal, assess the recording, and write the file."""
    check_output_path(args.output, overwrite=args.force, mark=MARK)
    args.params = None
    settings, dynamics = _checked(args)
    if sys.stdin.isatty():
        settings, dynamics = _interview(args, settings, dynamics)
    assumptions = assumptions_of(dynamics.robot, settings)
    lines = [robot_line(dynamics.robot, settings), ("contact points", ", ".join(dynamics.contact_points))]
    lines += [("", note) for note in dynamics.robot.notes if note.startswith(CHAIN_NOTES)]
    lines += [("tightest", text) for *_, text in tightest(dynamics, settings)]
    unknown = False
    notes = [
        "Parameters of a cell, for nodes and commands: --params FILE, launch argument params_file.",
        f"Written by scara-effmass {__version__} from {dynamics.robot.origin}.",
    ]
    if args.bag:
        topic, summary = _recording(args, settings, dynamics)
        lines += [("recording", f"{args.bag}, {topic}"), *summary.lines()]
        unknown = summary.only_unknown
        if topic.lstrip("/") != JOINT_STATES:
            notes.append(f"Joint states of {args.bag}: monitor --params FILE -- -r joint_states:={topic}")
    with atomic_file(args.output, overwrite=args.force, mark=MARK) as path:
        path.write_text(_cell(settings, notes), encoding="utf-8")
    lines += [("assumed", text) for _, text in assumptions.lines]
    next_step = f"scara-effmass doctor --params {shell_path(args.output)}"
    if dynamics.robot.hulls:
        next_step += f" --hulls {shell_path(args.output.with_name('hulls.png'))}"
    print_lines([*lines, ("written", args.output), ("next", next_step)])
    usual, worth = worth_of(settings, dynamics, assumptions)
    rows = [(*row[:3], "unknown" if row.change is None else f"{row.change:+.3f}") for row in worth if row.other]
    print_table(
        f"Allowable speed at {TYPICAL_SPEED:g} m/s, mean of {POSES} poses: {usual:.3f} m/s; change with another value:",
        ("assumption", "is", "with another value", "m/s"),
        rows,
    )
    return 1 if unknown else 0


def _checked(args: argparse.Namespace) -> tuple[MonitorSettings, RobotDynamics]:
    """Return the settings of the options and their robot. Raises EffmassError where `doctor` finds something wrong."""
    robot = args.robot and str(Path(args.robot).resolve())  # the nodes may start elsewhere
    settings = monitor_settings(args, robot=robot)
    results, dynamics = cell_results(settings)
    wrong = [f"{result.subject}: {result.text}" for result in results if result.level == "wrong"]
    if wrong or dynamics is None:
        raise SettingsError(wrong[0])
    Monitor(dynamics, settings)  # raises for a joint_map that names other joints
    return settings, dynamics


def _interview(
    args: argparse.Namespace, settings: MonitorSettings, dynamics: RobotDynamics
) -> tuple[MonitorSettings, RobotDynamics]:
    """Ask for each missing option until the answer is valid; return settings and robot, as `_checked`.

    Enter states nothing: whoever skips a question has not said that a person stands still.
    """
    for option in options_of("robot", "bag", "situation"):
        name = option.dest
        is_load = name in {"payload_com", "payload_inertia"}
        if name not in ASKED or getattr(args, name) is not None or (is_load and not args.payload_mass):
            continue
        if name == "joint_map":
            if not (problem := args.bag and _misfit(args, settings, dynamics)):
                continue
            print_lines([("", problem)])
        links = [frame.name for frame in dynamics.robot.model.frames if frame.type.name == "BODY"]
        choices = {"body_regions": BODY_REGIONS, "contact_points": links or dynamics.contact_points}
        names = choices.get(name, option.keywords.get("choices"))
        print_lines([(f"{name}: ", option.keywords["help"]), *([("", f"of {', '.join(names)}")] if names else [])])
        several = "several by commas; " if option.keywords.get("action") else ""
        while text := _answer(f"  ({several}Enter: not stated) "):
            try:
                setattr(args, name, _value(option, text))
                checked = _checked(args)
                if name == "joint_map" and (problem := _misfit(args, *checked)):
                    raise SettingsError(problem)
                settings, dynamics = checked
                break
            except (EffmassError, ValueError, argparse.ArgumentTypeError) as error:
                setattr(args, name, None)
                print_lines([("", error)])
    return settings, dynamics


def _answer(prompt: str) -> str:
    """Return the line that the user enters. Raises KeyboardInterrupt at the end of the input."""
    try:
        line = input(prompt)
    except EOFError:
        print()  # noqa: T201 - ends the line of the prompt
        raise KeyboardInterrupt from None
    return line.encode(errors="surrogateescape").decode(errors="replace").strip()


def _value(option: Option, text: str) -> Any:  # noqa: ANN401 - as argparse
    """Return the answer `text` as argparse would; several values are separated by commas, numbers by spaces."""
    kind, nargs, repeated = (option.keywords.get(key) for key in ("type", "nargs", "action"))
    if repeated == "extend":  # its type splits the words
        return [word.strip() for word in text.split(",")]
    words = text.split(",") if repeated else text.split() if nargs else [text]
    values = [(kind or str)(word.strip()) for word in words]
    return values if repeated or nargs else values[0]


def _misfit(args: argparse.Namespace, settings: MonitorSettings, dynamics: RobotDynamics) -> str:
    """Return why the recording cannot be assessed, such as other joint names; empty if it can."""
    try:
        _recording(args, settings, dynamics)
    except EffmassError as error:
        return str(error)
    return ""


def _recording(args: argparse.Namespace, settings: MonitorSettings, dynamics: RobotDynamics) -> tuple[str, Summary]:
    """Return the topic of the joint states, and the summary of their assessment. Raises BagError."""
    summary = Summary(round(settings.timeout * 1e9))
    with open_bag(args.bag) as bag, shown_progress(bag.path.name) as advance:
        topic = joint_state_topic(bag, args.topic)
        for states in assess_joint_states(bag, topic, Monitor(dynamics, settings), advance=advance):
            summary.add(states)
        summary.end(bag.end_ns)
    return topic, summary


def _cell(settings: MonitorSettings, notes: Sequence[str]) -> str:
    """Return the file: `notes`, and a section per node with each parameter below its description.

    A parameter of the monitor that neither options nor answers state is a comment: a default states nothing.
    """
    values = settings.model_dump(mode="json")
    values["sensor.sensitivity"] = DaqSettings().sensor.sensitivity
    cell = [*(option.dest for option in options_of("cell")), "tool_links"]
    sections: dict[str, tuple[type[BaseModel], list[str]]] = {
        "monitor": (MonitorSettings, cell),
        "validator": (ValidatorSettings, ["robot", *(name for name in cell if name in ValidatorSettings.model_fields)]),
        "daq": (DaqSettings, ["sensor.sensitivity"]),
        "visualization": (MonitorSettings, SHOWN),
    }
    lines = [f"# {note}" for note in notes]
    for node, (kind, names) in sections.items():
        fields, defaults = flat_fields(MonitorSettings) | flat_fields(kind), kind().model_dump(mode="json")
        lines += [f"/**/{node}:", "  ros__parameters:"]
        for name in names:
            lines += wrap(fields[name].description or "", 118, initial_indent="    # ", subsequent_indent="    # ")
            is_stated = name in {*settings.model_fields_set, "robot", "sensor.sensitivity"}
            shown = (values if is_stated else defaults)[name]
            value = yaml.safe_dump([shown], default_flow_style=True, width=math.inf, allow_unicode=True)
            lines.append(f"    {'' if is_stated else '# '}{name}: {value.strip()[1:-1]}")
    return "\n".join(lines) + "\n"

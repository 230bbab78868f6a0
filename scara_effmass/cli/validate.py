"""`scara-effmass validate`."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from pydantic import BaseModel

from scara_effmass.cli.console import print_json, print_lines, progress_bar
from scara_effmass.cli.options import add_force, add_json, add_params, add_robot, add_topic, load_dynamics
from scara_effmass.errors import SettingsError
from scara_effmass.settings import DaqSettings, MonitorSettings, ValidatorSettings, checked, load_settings

if TYPE_CHECKING:
    from scara_effmass.analysis.validation import ValidationSettings

EXAMPLES = """\
Impacts are detected in the force blocks of a recording; without force blocks, recorded impacts or wrenches are used.
The obstacle mass is --obstacle-mass, else the run information of the recording, else obstacle_mass in section
validator of FILE. All recordings form one series. DIR receives report.html, report.json, and figures as PNG and SVG.
Exit status 1: the series does not meet the acceptance criterion; the report is written anyway.

examples:
  scara-effmass validate bags/campaign -o out/validation
  scara-effmass validate monday.mcap -o out/monday --obstacle-mass 2.39 --model full
  scara-effmass validate bags/campaign -o out/validation --params cell.yaml --force --json
"""
NOT_ACCEPTED = 1
SECTIONS = ("monitor", "validator", "daq")

Settings = TypeVar("Settings", bound=BaseModel)


def add_to(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = EXAMPLES
    parser.add_argument("bags", nargs="+", type=Path, metavar="BAG", help="recording, or folder of recordings")
    parser.add_argument("-o", "--output", required=True, type=Path, metavar="DIR", help="folder for the report")
    add_topic(parser)
    parser.add_argument(
        "--force-topic",
        metavar="TOPIC",
        help="topic of force blocks, impacts or wrenches (default: force, or the only one)",
    )
    parser.add_argument(
        "--obstacle-mass",
        dest="mass_of_obstacle",
        type=float,
        metavar="KG",
        help="mass of the obstacle in all recordings",
    )
    parser.add_argument(
        "--stiffness",
        dest="contact_stiffness",
        type=float,
        metavar="N_PER_MM",
        help="contact stiffness for the predictions (default: fitted to the series)",
    )
    add_robot(parser)
    add_params(parser, "monitor_node, validator_node and daq_node (its detection)")
    add_force(parser)
    add_json(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Validate the recordings, write the report and print a summary."""
    from scara_effmass.analysis.validation import validate  # noqa: PLC0415 - not needed for --help
    from scara_effmass.analysis.validation_report import (  # noqa: PLC0415
        PAGE,
        check_report_folder,
        summary_lines,
        write_report,
    )
    from scara_effmass.bags.files import find_bags  # noqa: PLC0415

    settings = validation_settings(args)
    dynamics = load_dynamics(settings.monitor)
    check_report_folder(args.output, overwrite=args.force)
    paths = [path for argument in args.bags for path in find_bags(argument)]
    _check_unique(paths)
    with progress_bar() as progress:
        task = progress.add_task("recordings", total=len(paths))
        validation = validate(paths, dynamics, settings, lambda share: progress.advance(task, share))
    result = write_report(validation, settings, dynamics.robot, args.output, overwrite=args.force)
    if args.json:
        print_json({**result, "output": str(args.output)})
    else:
        print_lines([*summary_lines(validation), ("written", args.output / PAGE)])
    return 0 if validation.result.accepted else NOT_ACCEPTED


def _check_unique(paths: Sequence[Path]) -> None:
    """Raise SettingsError for a duplicate recording: its impacts would count twice."""
    unique_paths: set[Path] = set()
    for path in paths:
        resolved_path = path.resolve()
        if resolved_path in unique_paths:
            raise SettingsError(f"{path}: must be given only once")
        unique_paths.add(resolved_path)


def validation_settings(args: argparse.Namespace) -> ValidationSettings:
    """Return the settings of --params, overridden by the other options. Raises SettingsError."""
    from scara_effmass.analysis.validation import ValidationSettings  # noqa: PLC0415

    path, model = args.params, args.effective_mass_model

    def section(kind: type[Settings], name: str) -> Settings:
        return load_settings(kind, path, name, SECTIONS) if path else kind()

    validator = _with_options(
        section(ValidatorSettings, "validator"),
        stiffness=args.contact_stiffness,
        effective_mass_model=model,
        obstacle_mass=args.mass_of_obstacle,
    )
    return ValidationSettings(
        monitor=_with_options(section(MonitorSettings, "monitor"), robot=args.robot, effective_mass_model=model),
        validator=validator,
        detection=section(DaqSettings, "daq").detection,
        obstacle_mass=args.mass_of_obstacle,
        topic=args.topic,
        force_topic=args.force_topic,
    )


def _with_options(settings: Settings, **options: Any) -> Settings:  # noqa: ANN401 - any setting
    changes = {name: value for name, value in options.items() if value is not None}
    return checked(type(settings), {**settings.model_dump(), **changes}, "options")

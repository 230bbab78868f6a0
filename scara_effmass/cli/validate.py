"""`scara-effmass validate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from pydantic import BaseModel

from scara_effmass.cli.console import print_json, print_lines, progress_bar
from scara_effmass.cli.options import add_force, add_json, add_params, add_robot, add_topic, load_dynamics
from scara_effmass.cli.report import validation_lines
from scara_effmass.errors import SettingsError
from scara_effmass.settings import DaqSettings, MonitorSettings, ValidatorSettings, checked, load_settings

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    from scara_effmass.analysis.validation import ValidationSettings

EXAMPLES = """\
Impacts are found anew in the force blocks of a recording; without these, the recorded impacts are taken. The mass
of what is hit comes from --obstacle-mass, else from what the recording says of itself, else from validator:
obstacle_mass in FILE. All recordings are one series. DIR gets report.html, report.json, and figures as PNG and SVG.
Exits with 1 when the series fails the acceptance criterion; the report is written all the same.

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
        help="mass of what is hit, in all recordings",
    )
    parser.add_argument(
        "--stiffness",
        dest="contact_stiffness",
        type=float,
        metavar="N_PER_MM",
        help="contact stiffness to predict with (default: the one that fits best)",
    )
    add_robot(parser)
    add_params(parser, "monitor_node, validator_node and daq_node (its detection)")
    add_force(parser)
    add_json(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Validate, write the report, and print what it comes down to."""
    from scara_effmass.analysis.validation import validate  # noqa: PLC0415 - not needed for --help
    from scara_effmass.analysis.validation_record import record  # noqa: PLC0415
    from scara_effmass.analysis.validation_report import PAGE, require_room, write_report  # noqa: PLC0415
    from scara_effmass.bags.files import find_bags  # noqa: PLC0415

    settings = validation_settings(args)
    arm = load_dynamics(settings.monitor)
    require_room(args.output, overwrite=args.force)
    paths = [path for given in args.bags for path in find_bags(given)]
    _require_different(paths)
    with progress_bar() as progress:
        task = progress.add_task("recordings", total=len(paths))
        validation = validate(paths, arm, settings, lambda share: progress.advance(task, share))
    write_report(validation, settings, arm.robot, args.output, overwrite=args.force)
    if args.json:
        print_json({**record(validation, settings, arm.robot), "output": str(args.output)})
    else:
        print_lines([*validation_lines(validation), ("written", args.output / PAGE)])
    return 0 if validation.result.accepted else NOT_ACCEPTED


def _require_different(paths: Sequence[Path]) -> None:
    """Raise SettingsError for a recording that is given twice: its impacts would count as repetitions."""
    places: set[Path] = set()
    for path in paths:
        place = path.resolve()
        if place in places:
            raise SettingsError(f"{path}: must be given only once")
        places.add(place)


def validation_settings(args: argparse.Namespace) -> ValidationSettings:
    """Return the settings of --params with the other options over them. Raises SettingsError."""
    from scara_effmass.analysis.validation import ValidationSettings  # noqa: PLC0415

    path, model = args.params, args.effective_mass_model

    def section(kind: type[Settings], name: str) -> Settings:
        return load_settings(kind, path, name, SECTIONS) if path else kind()

    validator = _changed(
        section(ValidatorSettings, "validator"),
        stiffness=args.contact_stiffness,
        effective_mass_model=model,
        obstacle_mass=args.mass_of_obstacle,
    )
    return ValidationSettings(
        monitor=_changed(section(MonitorSettings, "monitor"), robot=args.robot, effective_mass_model=model),
        validator=validator,
        detection=section(DaqSettings, "daq").detection,
        obstacle_mass=args.mass_of_obstacle,
        topic=args.topic,
        force_topic=args.force_topic,
    )


def _changed(settings: Settings, **given: Any) -> Settings:  # noqa: ANN401 - any setting
    changes = {name: value for name, value in given.items() if value is not None}
    return checked(type(settings), {**settings.model_dump(), **changes}, "options")

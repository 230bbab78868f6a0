# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass validate`."""

import argparse
from functools import partial
from pathlib import Path

from scara_effmass.analysis.assessment import Time, input_lines
from scara_effmass.analysis.dataset import without_copies
from scara_effmass.analysis.output import check_output_files
from scara_effmass.analysis.report import PAGE, PageOptions
from scara_effmass.analysis.validation import (
    ValidatedRecording,
    Validation,
    ValidationSettings,
    joined,
    validate_recording,
    with_motion,
)
from scara_effmass.analysis.validation_report import FILES, summary_lines, write_report
from scara_effmass.bags.files import bag_bytes, find_bags
from scara_effmass.cli.console import print_result
from scara_effmass.cli.options import load_dynamics, override, robot_line, selected
from scara_effmass.cli.tasks import SMALL_BYTES, Advance, open_run, sound
from scara_effmass.errors import BagError, SettingsError
from scara_effmass.impacts.validator import Validator
from scara_effmass.settings import DaqSettings, ImportSettings, MonitorSettings, ValidatorSettings, load_settings

NOT_ACCEPTED = 1
SECTIONS = ("monitor", "validator", "daq")


def run(args: argparse.Namespace) -> int:
    """Validate the recordings, write the report and print a summary."""
    if args.obstacle_fixed and args.obstacle_mass is not None:
        raise SettingsError(f"argument --fixed: must not come with --obstacle-mass {args.obstacle_mass:g}")
    settings = validation_settings(args)
    dynamics = load_dynamics(settings.monitor)
    page = PageOptions(args.language, args.pdf)
    check_output_files(args.output, [*FILES, *page.files()], overwrite=args.force)
    validation = with_motion(validated(args, settings), dynamics, settings)
    result = write_report(validation, settings, dynamics.robot, args.output, page, overwrite=args.force)
    notes = [robot_line(dynamics.robot, settings.monitor), *input_lines(settings.monitor, settings.time)]
    notes += [("no effect", line) for line in settings.validator.without_effect()]
    lines = [*summary_lines(validation), *notes, ("written", args.output / PAGE)]
    print_result({**result, "output": str(args.output)}, lines, as_json=args.json)
    return 0 if validation.result.accepted and validation.result.within_limits else NOT_ACCEPTED


def validated(args: argparse.Namespace, settings: ValidationSettings) -> Validation:
    """Validate the recordings of `args` as one series. Raises EffmassError that names every bad recording."""
    paths = _recordings(args)
    force_of = dict(zip(paths, settings.force_from, strict=False))
    unreadable: list[str] = []
    with open_run(args, "recordings", is_small=sum(map(bag_bytes, paths)) < SMALL_BYTES) as run_tasks:
        outcomes = run_tasks(partial(_validated, settings, force_of), paths)
        parts = [part for _, part in sound(paths, outcomes, unreadable)]
    if unreadable:  # the verdict on the others alone would be that on another series
        raise BagError("; ".join(unreadable))
    return joined(parts, settings)


def _validated(
    settings: ValidationSettings, force_of: dict[Path, Path], path: Path, advance: Advance
) -> tuple[ValidatedRecording, Validator]:
    return validate_recording(path, force_of.get(path), load_dynamics(settings.monitor), settings, advance)


def _recordings(args: argparse.Namespace) -> list[Path]:
    """Return the recordings, of which none counts twice. Raises BagError, SettingsError."""
    paths = [path for argument in args.bags for path in find_bags(argument)]
    for _, copy in without_copies(paths, "series")[1]:  # its impacts would count twice
        raise SettingsError(f"{copy}: must be given only once")
    if len(args.force_from) not in {0, len(paths)}:
        raise SettingsError(
            f"argument --force-from: {len(args.force_from)} files: must be {len(paths)}, as many as BAGs"
        )
    return paths


def validation_settings(args: argparse.Namespace) -> ValidationSettings:
    """Return the settings of --params, overridden by the other options. Raises SettingsError."""
    # The limits are those of the measured forces: a clamping monitor could give no prediction.
    names = ("stiffness_n_m", "obstacle_mass", "obstacle_fixed", "plate_normal", "effective_mass_model")
    options = selected(args, "limits") | {name: getattr(args, name) for name in names}
    return ValidationSettings(
        monitor=override(load_settings(MonitorSettings, args.params, "monitor", SECTIONS), selected(args, "arm")),
        validator=override(load_settings(ValidatorSettings, args.params, "validator", SECTIONS), options),
        detection=load_settings(DaqSettings, args.params, "daq", SECTIONS).detection,
        obstacle_mass=args.obstacle_mass,
        topic=args.topic,
        time=Time(args.time),
        force=override(ImportSettings(topic=args.force_topic or ""), selected(args, "import")),
        force_from=tuple(args.force_from),
        force_offset=args.force_offset,
    )

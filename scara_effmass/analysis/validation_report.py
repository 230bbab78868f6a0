"""Write the validation report (page, figures, JSON) completely or not at all."""

from __future__ import annotations

import json
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl

from scara_effmass.analysis.figure import FORMATS, write
from scara_effmass.analysis.output import atomic_file, check_output_path
from scara_effmass.analysis.plot_style import STYLE
from scara_effmass.analysis.report import EmbeddedFigure
from scara_effmass.analysis.validation_figures import PLOTS
from scara_effmass.analysis.validation_page import page
from scara_effmass.analysis.validation_record import record

if TYPE_CHECKING:
    from scara_effmass.analysis.validation import Validation, ValidationSettings
    from scara_effmass.model.robot import Robot

PAGE, RECORD = "report.html", "report.json"
NAMES = (PAGE, RECORD, *(f"{plot.name}{suffix}" for plot in PLOTS for suffix in FORMATS))
"""Names of all files of a report."""


def check_report_folder(folder: Path, *, overwrite: bool) -> None:
    """Raise OutputError if a file of the report cannot be written into `folder`."""
    if folder.exists() and not folder.is_dir():
        check_output_path(folder, overwrite=False)
    for name in NAMES:
        check_output_path(folder / name, overwrite=overwrite)


def write_report(
    validation: Validation, settings: ValidationSettings, robot: Robot, folder: Path, *, overwrite: bool
) -> None:
    """Write `NAMES` into `folder`. Raises OutputError."""
    with ExitStack() as stack:
        paths = {name: stack.enter_context(atomic_file(folder / name, overwrite=overwrite)) for name in NAMES}
        for plot in PLOTS:
            with mpl.rc_context(STYLE):
                write(plot.draw(validation.result), *(paths[f"{plot.name}{suffix}"] for suffix in FORMATS))
        pictures = [
            EmbeddedFigure(plot.name, plot.title, plot.caption, paths[f"{plot.name}.png"].read_bytes())
            for plot in PLOTS
        ]
        paths[PAGE].write_text(page(validation, pictures, settings, robot), encoding="utf-8")
        numbers = json.dumps(record(validation, settings, robot), indent=1, ensure_ascii=False, allow_nan=False)
        paths[RECORD].write_text(f"{numbers}\n", encoding="utf-8")

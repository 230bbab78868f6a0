# SPDX-License-Identifier: Apache-2.0
"""Write all figures, the page and the claims, or nothing."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

from scara_effmass import __version__
from scara_effmass.analysis.output import check_output_files
from scara_effmass.analysis.report import STYLE, figure_files, render, report_figure, write_report_files
from scara_effmass.input_files import read_table
from scara_effmass.studies.claims import Claim, Outcome, all_claims
from scara_effmass.studies.figures import (
    figure_6,
    figure_7,
    figure_8,
    figure_9,
    figure_10,
    figure_11,
    figure_12,
    figure_14,
    figure_15,
    figure_17,
    figure_18,
    figure_19,
)
from scara_effmass.studies.runs import FigureInputs
from scara_effmass.studies.scara import ModelAgreement, compare_models, equal_area_poses

PAGE, CLAIMS = "index.html", "claims.json"

DrawFigure = Callable[[FigureInputs], Figure]
_DRAW = (
    *(figure_6, figure_7, figure_8, figure_9, figure_10, figure_11),
    *(figure_12, figure_14, figure_15, figure_17, figure_18, figure_19),
)
_CAPTIONS = read_table(__file__, "captions.yaml")
FIGURES: dict[DrawFigure, str] = {draw: _CAPTIONS[draw.__name__] for draw in _DRAW}
"""Captions by the functions that draw the figures; the files have the names of the functions."""
STEPS = len(FIGURES) + 1
"""Number of calls of `advance` in `make_figure_set`."""


@dataclass(frozen=True, slots=True)
class FigureSet:
    """Names of the figures, the claims, and the agreement of the two models."""

    figures: tuple[str, ...]
    claims: tuple[Claim, ...]
    agreement: ModelAgreement

    @property
    def counts(self) -> dict[str, int]:
        """Number of claims by outcome."""
        return {outcome.value: sum(claim.outcome is outcome for claim in self.claims) for outcome in Outcome}

    def as_dict(self) -> dict[str, Any]:
        """Return the content of `claims.json`."""
        claims = [
            {**asdict(claim), "basis": claim.basis and claim.basis.value, "outcome": claim.outcome.value}
            for claim in self.claims
        ]
        return {
            "scara_effmass": __version__,
            "figures": list(self.figures),
            "counts": self.counts,
            "closed_form_check": self.agreement._asdict(),
            "claims": claims,
        }


def make_figure_set(
    inputs: FigureInputs,
    folder: Path,
    *,
    overwrite: bool,
    advance: Callable[[], object],
    captions: dict[DrawFigure, str] = FIGURES,
) -> FigureSet:
    """Write figures (PNG and SVG), `index.html` and `claims.json` into `folder`; call `advance` after each step.

    Raises OutputError, before anything is drawn, where a file exists.
    """
    names = tuple(draw.__name__ for draw in captions)
    check_output_files(folder, [PAGE, CLAIMS, *figure_files(names)], overwrite=overwrite)
    figures = []
    for name, (draw, caption) in zip(names, captions.items(), strict=True):
        with mpl.rc_context(STYLE):
            figures.append(report_figure(name, name.replace("figure_", "Fig. "), caption, draw(inputs)))
        advance()
    # Not on the joint grid: with a stretched arm the tool cannot move along n.
    agreement = compare_models(inputs.dynamics, inputs.scara, *equal_area_poses(inputs.scara))
    claims = tuple(all_claims(inputs.dynamics, inputs.scara, inputs.shown_run, inputs.runs))
    figure_set = FigureSet(names, claims, agreement)
    advance()
    page = render("paper.html", version=__version__, figures=figures, figure_set=figure_set)
    write_report_files(folder, {PAGE: page, CLAIMS: figure_set.as_dict()}, figures, overwrite=overwrite)
    return figure_set

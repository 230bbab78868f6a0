# SPDX-License-Identifier: Apache-2.0
"""All figures, the page and the claims: what they need, and how they are written, all or nothing."""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

from scara_effmass import __version__
from scara_effmass.analysis.output import check_output_files
from scara_effmass.analysis.pages import render
from scara_effmass.analysis.plot_style import STYLE
from scara_effmass.analysis.report import figure_files, report_figure, write_report_files
from scara_effmass.paper.claims import Claim, Outcome, all_claims
from scara_effmass.paper.density import figure_8
from scara_effmass.paper.experiment import figure_17, figure_18, figure_19
from scara_effmass.paper.maps import (
    figure_6,
    figure_7,
    figure_9,
    figure_10,
    figure_11,
    figure_12,
    figure_14,
    figure_15,
)
from scara_effmass.paper.runs import FigureInputs
from scara_effmass.paper.scara import ModelAgreement, compare_models, equal_area_poses

PAGE, CLAIMS = "index.html", "claims.json"


DrawFigure = Callable[[FigureInputs], Figure]
GRID_NOTE = "50 by 50 angles over the joint ranges, as in the paper."
FIGURES: dict[DrawFigure, str] = {
    figure_6: (
        "Effective mass of the simplified model (Eq. 28) over the workspace (a) and over q₁ and q₂ (b). Red: contour "
        f"of the standard's m_R. {GRID_NOTE} The mass is unbounded towards the stretched arm along n; the colours end "
        "at 6 kg."
    ),
    figure_7: (
        "A pose of smallest effective mass (a), and one of largest effective mass at its q₂ (b), with M₂ at the elbow "
        "and M₃ at the tool. The angles are chosen here."
    ),
    figure_8: (
        "Effective mass at 2500 positions that each represent the same area of the workspace; the line is the whole "
        "workspace. The mean depends on the few largest values, hence on the number of positions."
    ),
    figure_9: (
        f"Error of the simplified model (Eq. 28) against the full one (Eq. 27) in effective mass. {GRID_NOTE} The full "
        "model's inertias are fitted to the paper's numbers, so the pattern is one of several possible."
    ),
    figure_10: (
        "Reduced mass of the simplified model, one slice per obstacle mass, evenly spaced. Red: µ_ISO. The colours end "
        "at 4 kg; µ itself ends at m_H."
    ),
    figure_11: "Error of the simplified model against the full one in reduced mass, one slice per obstacle mass.",
    figure_12: (
        "Reduced mass along y (a) and along (0.6, 0.8, 0) (b). Red: µ_ISO. The values turn with the normal, the "
        "outline of the workspace does not."
    ),
    figure_14: (
        "Reduced mass of the left arm: the right arm's, mirrored in the x axis. The paper's text does not give m_H "
        "here; 2.39 kg is its representative case."
    ),
    figure_15: (
        "The smaller reduced mass of both arms; where only one arm reaches, that of this arm, hence the edges in the "
        "colours. Positions on 200 circles and 721 rays."
    ),
    figure_17: (
        "Position and velocity of the tool along x around the impact. The velocity drops again "
        "where the robot, which follows its planned path, catches up with the cart and hits it again."
    ),
    figure_18: "Force over time in each configuration, one line per repetition, from the first contact of each run.",
    figure_19: (
        "Mean peak force (a) and √µ of the simplified model (b) by configuration, one curve per obstacle mass. Of the "
        "three impact points only (300, 200) mm is in the paper's text; the others are chosen here."
    ),
}
"""Captions by the functions that draw the figures, whose names are those of the files.

Parts (a) and (b) are in one figure. Figs. 1 to 5, 13 and 16 of the paper are drawings and photographs.
"""
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
    # Not on the joint grid: its stretched arm has no velocity along n.
    agreement = compare_models(inputs.dynamics, inputs.scara, *equal_area_poses(inputs.scara))
    claims = tuple(all_claims(inputs.dynamics, inputs.scara, inputs.shown_run, inputs.runs))
    figure_set = FigureSet(names, claims, agreement)
    advance()
    page = render("paper.html", version=__version__, figures=figures, figure_set=figure_set)
    texts = {PAGE: page, CLAIMS: json.dumps(figure_set.as_dict(), indent=1, ensure_ascii=False) + "\n"}
    write_report_files(folder, texts, figures, overwrite=overwrite)
    return figure_set

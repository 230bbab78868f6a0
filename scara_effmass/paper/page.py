"""HTML page with the paper's claims beside ours, and all figures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from scara_effmass import __version__
from scara_effmass.analysis.report import ReportFigure, render
from scara_effmass.paper.claim import Basis, Outcome

if TYPE_CHECKING:
    from scara_effmass.paper.figure_set import FigureSet

SIGNS = {Outcome.MATCH: "✓", Outcome.NO_MATCH: "✗", Outcome.NOT_CHECKED: "○"}
MEANINGS = (
    (Basis.GIVEN, "the shipped files or settings state the paper's number, so they must agree"),
    (Basis.FITTED, "masses and inertias of the shipped robot were fitted to this number: agreement shows the fit"),
    (Basis.RESULT, "the number follows from the model without a fit to it"),
)
CITATION = (
    "The paper: authors AC, MB, MT, AD and GR (initials as in its author contributions), on a simplified "
    "lumped-parameter effective-mass model of robot impacts, validated with an Omron i4-550L SCARA that hits a cart; "
    "funded by the European Union, NextGenerationEU, PRIN 2022, project 2022XXH9JZ_001/ERC. Title, full names, "
    "journal, year and DOI are not in our copy, which lacks the title page; see CITATION.cff."
)


def page(figures: Sequence[ReportFigure], figure_set: FigureSet) -> str:
    """Return the page as HTML."""
    return render(
        "paper.html",
        version=__version__,
        citation=CITATION,
        summary=", ".join(f"{count} {outcome}" for outcome, count in figure_set.counts.items()),
        meanings=MEANINGS,
        signs=SIGNS,
        figures=figures,
        figure_set=figure_set,
    )

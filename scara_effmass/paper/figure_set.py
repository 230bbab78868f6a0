"""Write all figures, the page and the claims, or nothing."""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl

from scara_effmass import __version__
from scara_effmass.analysis.output import check_output_files
from scara_effmass.analysis.plot_style import STYLE
from scara_effmass.analysis.report import figure_files, report_figure, write_report_files
from scara_effmass.paper.claim import Claim, Outcome
from scara_effmass.paper.experiment_claims import motion_claims, run_claims
from scara_effmass.paper.figure_specs import FIGURE_SPECS, FigureInputs, FigureSpec
from scara_effmass.paper.mass_claims import mass_claims, reduced_mass_claims
from scara_effmass.paper.page import page
from scara_effmass.paper.robot_claims import robot_claims
from scara_effmass.paper.scara import ModelAgreement, compare_models
from scara_effmass.paper.workspace import equal_area_poses

PAGE, CLAIMS = "index.html", "claims.json"
STEPS = len(FIGURE_SPECS) + 1
"""Largest number of calls of `advance` in `make_figure_set`."""


@dataclass(frozen=True, slots=True)
class FigureSet:
    """Names of the figures, what is left out and why, the claims, and the agreement of the two models."""

    figures: tuple[str, ...]
    left_out: tuple[str, ...]
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
            "left_out": list(self.left_out),
            "counts": self.counts,
            "closed_form_check": {
                "poses": self.agreement.poses,
                "lumped_relative_difference": self.agreement.lumped,
                "full_relative_difference": self.agreement.full,
            },
            "claims": claims,
        }


def make_figure_set(
    inputs: FigureInputs,
    folder: Path,
    *,
    overwrite: bool,
    advance: Callable[[], object],
    specs: Sequence[FigureSpec] = FIGURE_SPECS,
) -> FigureSet:
    """Write figures (PNG and SVG), `index.html` and `claims.json` into `folder`; call `advance` after each step.

    Raises OutputError, before anything is drawn, where a file exists.
    """
    left_out = [f"Fig. {spec.number}: {reason}" for spec in specs if (reason := spec.missing(inputs))]
    specs = [spec for spec in specs if not spec.missing(inputs)]
    left_out += [f"Fig. {spec.number} {reason}" for spec in specs if (reason := spec.part_missing(inputs))]
    check_output_files(folder, [PAGE, CLAIMS, *figure_files(spec.name for spec in specs)], overwrite=overwrite)
    figures = []
    for spec in specs:
        with mpl.rc_context(STYLE):
            figures.append(report_figure(spec.name, f"Fig. {spec.number}", spec.caption, spec.draw(inputs)))
        advance()
    # Not on the joint grid: its stretched arm has no velocity along n.
    agreement = compare_models(inputs.dynamics, inputs.scara, *equal_area_poses(inputs.scara))
    figure_set = FigureSet(tuple(spec.name for spec in specs), tuple(left_out), _claims(inputs), agreement)
    advance()
    claims = json.dumps(figure_set.as_dict(), indent=1, ensure_ascii=False)
    texts = {PAGE: page(figures, figure_set), CLAIMS: f"{claims}\n"}
    write_report_files(folder, texts, figures, overwrite=overwrite)
    return figure_set


def _claims(inputs: FigureInputs) -> tuple[Claim, ...]:
    scara = inputs.scara
    return (
        *robot_claims(scara),
        *mass_claims(inputs.dynamics, scara),
        *reduced_mass_claims(scara),
        *motion_claims(inputs.motion),
        *run_claims(scara, inputs.runs),
    )

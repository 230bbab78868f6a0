"""All figures, the page and the claims: written together or not at all."""

from __future__ import annotations

import json
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import matplotlib as mpl

from scara_effmass import __version__
from scara_effmass.analysis.figure import FORMATS, write
from scara_effmass.analysis.output import atomic_file
from scara_effmass.analysis.page import Picture
from scara_effmass.analysis.plot_style import STYLE
from scara_effmass.paper.claim import Outcome
from scara_effmass.paper.experiment_claims import motion_claims, run_claims
from scara_effmass.paper.figure_specs import FIGURE_SPECS
from scara_effmass.paper.mass_claims import mass_claims
from scara_effmass.paper.page import page
from scara_effmass.paper.reduced_mass_claims import reduced_mass_claims
from scara_effmass.paper.robot_claims import robot_claims
from scara_effmass.paper.scara import agreement
from scara_effmass.paper.workspace import spread_positions

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from scara_effmass.paper.claim import Claim
    from scara_effmass.paper.figure_specs import FigureSpec, Material
    from scara_effmass.paper.scara import Agreement

PAGE, CLAIMS = "index.html", "claims.json"


@dataclass(frozen=True, slots=True)
class FigureSet:
    """What was made: names of the figures, what is left out and why, the claims, and how well two ways agree."""

    figures: tuple[str, ...]
    left_out: tuple[str, ...]
    claims: tuple[Claim, ...]
    agreement: Agreement

    @property
    def counts(self) -> dict[str, int]:
        """How many claims have which outcome."""
        return {each.value: sum(claim.outcome is each for claim in self.claims) for each in Outcome}

    def as_dict(self) -> dict[str, Any]:
        """Return it as JSON takes it."""
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
    material: Material,
    folder: Path,
    *,
    overwrite: bool,
    advance: Callable[[], object],
    plates: Sequence[FigureSpec] = FIGURE_SPECS,
) -> FigureSet:
    """Draw and compare, and write figures (PNG and SVG), `index.html` and `claims.json` into `folder`.

    `advance` is called after each of `STEPS`. Raises OutputError, before anything is drawn, where a file is in the way.
    """
    left_out = [f"Fig. {plate.number}: {why}" for plate in plates if (why := plate.whole_missing(material))]
    plates = [plate for plate in plates if not plate.whole_missing(material)]
    left_out += [f"Fig. {plate.number} {why}" for plate in plates if (why := plate.part_missing(material))]
    names = [f"{plate.name}{suffix}" for plate in plates for suffix in FORMATS] + [PAGE, CLAIMS]
    with ExitStack() as stack:
        paths = {name: stack.enter_context(atomic_file(folder / name, overwrite=overwrite)) for name in names}
        for plate in plates:
            with mpl.rc_context(STYLE):
                write(plate.draw(material), *(paths[f"{plate.name}{suffix}"] for suffix in FORMATS))
            advance()
        album = FigureSet(tuple(plate.name for plate in plates), tuple(left_out), _claims(material), _checked(material))
        advance()
        pictures = [
            Picture(plate.name, f"Fig. {plate.number}", plate.caption, paths[f"{plate.name}.png"].read_bytes())
            for plate in plates
        ]
        text = page(pictures, album.claims, album.left_out, album.agreement)
        paths[PAGE].write_text(text, encoding="utf-8")
        paths[CLAIMS].write_text(json.dumps(album.as_dict(), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return album


STEPS = len(FIGURE_SPECS) + 1
"""How often `make_album` advances, at most."""


def _claims(material: Material) -> tuple[Claim, ...]:
    scara = material.scara
    return (
        *robot_claims(scara),
        *mass_claims(material.dynamics, scara),
        *reduced_mass_claims(scara),
        *motion_claims(material.motion),
        *run_claims(scara, material.runs),
    )


def _checked(material: Material) -> Agreement:
    # Not on the grid of angles: the stretched arm on it moves across itself only, so along n it has no velocity.
    return agreement(material.dynamics, material.scara, *spread_positions(material.scara))

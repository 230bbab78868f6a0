"""The page: the paper's claims beside ours, and all figures; one file that loads nothing else."""

from __future__ import annotations

from base64 import b64encode
from collections import Counter
from html import escape
from typing import TYPE_CHECKING, NamedTuple

from scara_effmass import __version__
from scara_effmass.analysis.paper.claim import Basis, Outcome

if TYPE_CHECKING:
    from collections.abc import Sequence

    from scara_effmass.analysis.paper.claim import Claim
    from scara_effmass.analysis.paper.scara import Agreement

STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #222; background: #fff }
body { max-width: 1150px; margin: 2rem auto; padding: 0 1rem }
h1 { line-height: 1.2 } h2 { margin-top: 2.5rem }
.wide { overflow-x: auto }
table { border-collapse: collapse; font-size: 14px; width: 100% }
th, td { text-align: left; vertical-align: top; padding: .45rem .6rem; border-bottom: 1px solid #ddd }
th { background: #f3f5f8 } td small { display: block; color: #555 }
.outcome { white-space: nowrap; font-weight: 600 }
.match { color: #00664a } .no-match { color: #b03a00 } .not-checked { color: #555 }
figure { margin: 2rem 0 } img { max-width: 100%; height: auto } figcaption { color: #444; font-size: 15px }
"""
HEADS = ("where", "the paper", "here", "counts as match", "basis", "outcome")
SIGNS = {Outcome.MATCH: "✓", Outcome.NO_MATCH: "✗", Outcome.NOT_CHECKED: "○"}
MEANINGS = {
    Basis.GIVEN: "the shipped files or settings state the paper's number: agreement is bookkeeping",
    Basis.FITTED: "masses and inertias of the shipped robot were fitted to this number: agreement shows the fit",
    Basis.RESULT: "follows from the model; nothing was fitted to it",
}


class Picture(NamedTuple):
    """A figure's name, its caption, and its PNG file."""

    name: str
    caption: str
    png: bytes


def page(pictures: Sequence[Picture], claims: Sequence[Claim], left_out: Sequence[str], agreement: Agreement) -> str:
    """Return the page as HTML."""
    counts = Counter(claim.outcome for claim in claims)
    summary = ", ".join(f"{counts[outcome]} {outcome.value}" for outcome in Outcome)
    heads = "".join(f"<th>{head}</th>" for head in HEADS)
    rows = "\n".join(map(_row, claims))
    meanings = "".join(f"<li><b>{basis.value}</b>: {escape(meaning)}</li>" for basis, meaning in MEANINGS.items())
    missing = "".join(f"<li>{escape(line)}</li>" for line in left_out)
    missing = f"<h2>Left out</h2><ul>{missing}</ul>" if missing else ""
    figures = "\n".join(map(_figure, pictures))
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>The paper's figures and numbers, made anew</title>
<style>{STYLE}</style>
</head>
<body>
<h1>The paper's figures and numbers, made anew</h1>
<p>Effective mass of a SCARA robot (Omron i4-550L) by lumped parameters: everything on this page is computed by
scara_effmass {escape(__version__)} from its own models and recordings. Nothing is measured on a robot, unless a figure
says so.</p>
<h2>Claims: {summary}</h2>
<p>What an agreement is worth:</p><ul>{meanings}</ul>
<div class="wide"><table>
<thead><tr>{heads}</tr></thead>
<tbody>
{rows}
</tbody></table></div>
<h2>Two ways to the same mass</h2>
<p>The figures use the closed forms, Eqs. 27 and 28. At the {agreement.poses} positions of Fig. 8, along x, the mass
matrices (Eqs. 3 to 8 and 14, over Pinocchio) give masses whose largest relative difference from these is
{agreement.lumped:.1e} for the simplified and {agreement.full:.1e} for the full model. The two ways
share the robot's parameters, no formula.</p>
{missing}
<h2>Figures</h2>
{figures}
</body>
</html>
"""


def _row(claim: Claim) -> str:
    note = f"<small>{escape(claim.note)}</small>" if claim.note else ""
    basis = claim.basis.value if claim.basis else ""
    kind = claim.outcome.value.replace(" ", "-")
    outcome = f'<td class="outcome {kind}">{SIGNS[claim.outcome]} {claim.outcome.value}</td>'
    cells = (claim.where, claim.paper, claim.ours, claim.rule, basis)
    where, paper, ours, rule, basis = map(escape, cells)
    return f"<tr><td>{where}</td><td>{paper}</td><td>{ours}{note}</td><td>{rule}</td><td>{basis}</td>{outcome}</tr>"


def _figure(picture: Picture) -> str:
    data = b64encode(picture.png).decode("ascii")
    caption = escape(picture.caption)
    title = escape(picture.name.replace("figure_", "Fig. "))
    return (
        f'<figure id="{picture.name}"><img src="data:image/png;base64,{data}" alt="{title}: {caption}">'
        f"<figcaption><b>{title}</b> {caption}</figcaption></figure>"
    )

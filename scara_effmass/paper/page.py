"""The page: the paper's claims beside ours, and all figures; one file that loads nothing else."""

from __future__ import annotations

from collections import Counter
from html import escape
from typing import TYPE_CHECKING

from scara_effmass import __version__
from scara_effmass.analysis.page import document, figure
from scara_effmass.paper.claim import Basis, Outcome

if TYPE_CHECKING:
    from collections.abc import Sequence

    from scara_effmass.analysis.page import Picture
    from scara_effmass.paper.claim import Claim
    from scara_effmass.paper.scara import Agreement

STYLE = """
.outcome { white-space: nowrap; font-weight: 600 }
.match { color: #00664a } .no-match { color: #b03a00 } .not-checked { color: #555 }
"""
HEADS = ("where", "the paper", "here", "counts as match", "basis", "outcome")
SIGNS = {Outcome.MATCH: "✓", Outcome.NO_MATCH: "✗", Outcome.NOT_CHECKED: "○"}
MEANINGS = {
    Basis.GIVEN: "the shipped files or settings state the paper's number: agreement is bookkeeping",
    Basis.FITTED: "masses and inertias of the shipped robot were fitted to this number: agreement shows the fit",
    Basis.RESULT: "follows from the model; nothing was fitted to it",
}


def page(pictures: Sequence[Picture], claims: Sequence[Claim], left_out: Sequence[str], agreement: Agreement) -> str:
    """Return the page as HTML."""
    counts = Counter(claim.outcome for claim in claims)
    summary = ", ".join(f"{counts[outcome]} {outcome.value}" for outcome in Outcome)
    heads = "".join(f"<th>{head}</th>" for head in HEADS)
    rows = "\n".join(map(_row, claims))
    meanings = "".join(f"<li><b>{basis.value}</b>: {escape(meaning)}</li>" for basis, meaning in MEANINGS.items())
    missing = "".join(f"<li>{escape(line)}</li>" for line in left_out)
    missing = f"<h2>Left out</h2><ul>{missing}</ul>" if missing else ""
    figures = "\n".join(map(figure, pictures))
    body = f"""<p>Effective mass of a SCARA robot (Omron i4-550L) by lumped parameters: everything on this page is
computed by scara_effmass {escape(__version__)} from its own models and recordings. Nothing is measured on a robot,
unless a figure says so.</p>
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
{figures}"""
    return document("The paper's figures and numbers, made anew", body, STYLE)


def _row(claim: Claim) -> str:
    note = f"<small>{escape(claim.note)}</small>" if claim.note else ""
    basis = claim.basis.value if claim.basis else ""
    kind = claim.outcome.value.replace(" ", "-")
    outcome = f'<td class="outcome {kind}">{SIGNS[claim.outcome]} {claim.outcome.value}</td>'
    cells = (claim.where, claim.paper, claim.ours, claim.rule, basis)
    where, paper, ours, rule, basis = map(escape, cells)
    return f"<tr><td>{where}</td><td>{paper}</td><td>{ours}{note}</td><td>{rule}</td><td>{basis}</td>{outcome}</tr>"

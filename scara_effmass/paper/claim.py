"""One statement of the paper beside what comes out here."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Basis(Enum):
    """How much an agreement proves."""

    GIVEN = "given"
    """The shipped files or settings state the paper's number: agreement is bookkeeping."""
    FITTED = "fitted"
    """The robot's masses and inertias were fitted to this number: agreement shows the fit, not the claim."""
    RESULT = "result"
    """It follows from the model, with nothing fitted to it."""


class Outcome(Enum):
    """What the comparison says."""

    MATCH = "match"
    NO_MATCH = "no match"
    NOT_CHECKED = "not checked"


@dataclass(frozen=True, slots=True)
class Claim:
    """A claim.

    `value` [`unit`] is the number behind `ours`, None where there is none; `rule` says when the claim counts as met.
    `basis` is None where nothing was checked.
    """

    key: str
    where: str
    paper: str
    ours: str
    value: float | None
    unit: str
    rule: str
    basis: Basis | None
    outcome: Outcome
    note: str = ""


def near(
    key: str,
    where: str,
    paper: str,
    printed: float,
    value: float,
    tolerance: float,
    unit: str,
    basis: Basis,
    note: str = "",
) -> Claim:
    """Return the claim that `value` is `printed`, to within `tolerance`."""
    rule = f"within {_quantity(tolerance, unit)} of {_quantity(printed, unit)}"
    return _judged(key, where, paper, value, unit, rule, basis, note, met=abs(value - printed) <= tolerance)


def at_most(
    key: str, where: str, paper: str, bound: float, value: float, unit: str, basis: Basis, note: str = ""
) -> Claim:
    """Return the claim that `value` does not exceed `bound`."""
    return _judged(key, where, paper, value, unit, f"at most {_quantity(bound, unit)}", basis, note, met=value <= bound)


def more_than(
    key: str, where: str, paper: str, bound: float, value: float, unit: str, basis: Basis, note: str = ""
) -> Claim:
    """Return the claim that `value` exceeds `bound`."""
    return _judged(
        key, where, paper, value, unit, f"more than {_quantity(bound, unit)}", basis, note, met=value > bound
    )


def holds(key: str, where: str, paper: str, ours: str, rule: str, basis: Basis, note: str = "", *, met: bool) -> Claim:
    """Return a claim that is no single number."""
    return Claim(key, where, paper, ours, None, "", rule, basis, _outcome(met=met), note)


def not_checked(key: str, where: str, paper: str, why: str) -> Claim:
    """Return a claim that cannot be compared here."""
    return Claim(key, where, paper, "", None, "", "", None, Outcome.NOT_CHECKED, why)


def _judged(
    key: str, where: str, paper: str, value: float, unit: str, rule: str, basis: Basis, note: str, *, met: bool
) -> Claim:
    return Claim(key, where, paper, _quantity(value, unit), value, unit, rule, basis, _outcome(met=met), note)


def _outcome(*, met: bool) -> Outcome:
    return Outcome.MATCH if met else Outcome.NO_MATCH


def _quantity(value: float, unit: str) -> str:
    number = f"{value:.0f}" if abs(value) >= 1e4 else f"{value:.4g}"
    return f"{number} {unit}".rstrip()

"""One claim: a statement of the paper beside this project's result."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Basis(Enum):
    """How much an agreement proves."""

    GIVEN = "given"
    """The shipped files or settings state the paper's number."""
    FITTED = "fitted"
    """Masses and inertias of the shipped robot were fitted to this number."""
    RESULT = "result"
    """The number follows from the model without a fit to it."""


class Outcome(Enum):
    """Result of the comparison."""

    MATCH = "match"
    NO_MATCH = "no match"
    NOT_CHECKED = "not checked"


@dataclass(frozen=True, slots=True)
class Claim:
    """A statement `paper` at `where` in the paper, our result `ours`, and the `rule` for a match.

    `value` [`unit`] is the number in `ours`, None without one; `basis` is None where nothing was checked.
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


@dataclass(frozen=True, slots=True)
class Statement:
    """A statement of the paper; its methods compare it with a result. NaN never matches."""

    key: str
    where: str
    text: str
    basis: Basis = Basis.RESULT

    def near(self, value: float, expected: float, tolerance: float, unit: str = "", note: str = "") -> Claim:
        """Return the claim that `value` is within `tolerance` of `expected`."""
        rule = f"within {_quantity(tolerance, unit)} of {_quantity(expected, unit)}"
        return self._compared(value, unit, rule, note, met=abs(value - expected) <= tolerance)

    def at_most(self, value: float, bound: float, unit: str = "", note: str = "") -> Claim:
        """Return the claim that `value` does not exceed `bound`."""
        return self._compared(value, unit, f"at most {_quantity(bound, unit)}", note, met=value <= bound)

    def more_than(self, value: float, bound: float, unit: str = "", note: str = "") -> Claim:
        """Return the claim that `value` exceeds `bound`."""
        return self._compared(value, unit, f"more than {_quantity(bound, unit)}", note, met=value > bound)

    def holds(self, ours: str, rule: str, note: str = "", *, met: bool) -> Claim:
        """Return a claim without a single number."""
        return self._claim(ours, None, "", rule, self.basis, _outcome(met=met), note)

    def not_checked(self, reason: str) -> Claim:
        """Return a claim that cannot be checked here."""
        return self._claim("", None, "", "", None, Outcome.NOT_CHECKED, reason)

    def _compared(self, value: float, unit: str, rule: str, note: str, *, met: bool) -> Claim:
        return self._claim(_quantity(value, unit), value, unit, rule, self.basis, _outcome(met=met), note)

    def _claim(
        self, ours: str, value: float | None, unit: str, rule: str, basis: Basis | None, outcome: Outcome, note: str
    ) -> Claim:
        return Claim(
            key=self.key,
            where=self.where,
            paper=self.text,
            ours=ours,
            value=value,
            unit=unit,
            rule=rule,
            basis=basis,
            outcome=outcome,
            note=note,
        )


def _outcome(*, met: bool) -> Outcome:
    return Outcome.MATCH if met else Outcome.NO_MATCH


def _quantity(value: float, unit: str) -> str:
    number = f"{value:.0f}" if abs(value) >= 1e4 else f"{value:.4g}"
    return f"{number} {unit}".rstrip()

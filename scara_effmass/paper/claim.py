"""One claim: a statement of the paper beside this project's result."""

from __future__ import annotations

from dataclasses import dataclass, replace
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

    A new claim is not checked; its methods return it compared with a result. NaN never matches. `value` [`unit`] is
    the number in `ours`, None without one; `basis` is None where nothing was checked.
    """

    key: str
    where: str
    paper: str
    basis: Basis | None = Basis.RESULT
    ours: str = ""
    value: float | None = None
    unit: str = ""
    rule: str = ""
    outcome: Outcome = Outcome.NOT_CHECKED
    note: str = ""

    def near(self, value: float, expected: float, tolerance: float, unit: str = "", note: str = "") -> Claim:
        """Compare: `value` is within `tolerance` of `expected`."""
        rule = f"within {_quantity(tolerance, unit)} of {_quantity(expected, unit)}"
        return self._compared(value, unit, rule, note, met=abs(value - expected) <= tolerance)

    def at_most(self, value: float, bound: float, unit: str = "", note: str = "") -> Claim:
        """Compare: `value` does not exceed `bound`."""
        return self._compared(value, unit, f"at most {_quantity(bound, unit)}", note, met=value <= bound)

    def more_than(self, value: float, bound: float, unit: str = "", note: str = "") -> Claim:
        """Compare: `value` exceeds `bound`."""
        return self._compared(value, unit, f"more than {_quantity(bound, unit)}", note, met=value > bound)

    def holds(self, ours: str, rule: str, note: str = "", *, met: bool) -> Claim:
        """Compare without a single number."""
        return replace(self, ours=ours, rule=rule, note=note, outcome=Outcome.MATCH if met else Outcome.NO_MATCH)

    def not_checked(self, reason: str) -> Claim:
        """Return the claim as one that cannot be checked here."""
        return replace(self, basis=None, note=reason)

    def _compared(self, value: float, unit: str, rule: str, note: str, *, met: bool) -> Claim:
        return replace(self.holds(_quantity(value, unit), rule, note, met=met), value=value, unit=unit)


def _quantity(value: float, unit: str) -> str:
    number = f"{value:.0f}" if abs(value) >= 1e4 else f"{value:.4g}"
    return f"{number} {unit}".rstrip()

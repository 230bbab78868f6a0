"""Summary of a run: cycles and time per verdict, the tightest margin, and the reasons of UNKNOWN."""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from scara_effmass.safety.debounce import severity
from scara_effmass.values import ContactAssessment, JointState, Verdict

NUMBER = re.compile(r"(?<![\w.])-?\d+(\.\d+)?(e[-+]?\d+)?(?![\w])")
"""Numbers in a reason, except digits in names; reasons are counted without them."""
MAX_REASONS = 200
"""Maximum number of different reasons; further ones count as `OTHER_REASONS`, which bounds the memory."""
OTHER_REASONS = "other reasons"
REASONS_SHOWN = 5


class TightestMargin(NamedTuple):
    """The assessment with the smallest margin, its recording and joint positions. UNKNOWN has no margin."""

    contact: ContactAssessment
    source: str
    positions: dict[str, float]

    def lines(self) -> Iterator[tuple[str, str]]:
        """Yield subject and text of each line."""
        contact = self.contact
        speeds = f"{contact.speed:.3f} m/s where {contact.allowable_speed:.3f} m/s is allowable"
        yield "tightest margin", f"{contact.margin:+.3f} m/s ({contact.verdict.name}): {speeds}"
        source = f" in {self.source}" if self.source else ""
        yield "  where", f"{contact.contact_point} at stamp {contact.stamp_ns / 1e9:.3f} s{source}"
        if self.positions:
            yield "  pose", ", ".join(f"{name} {position:.3f}" for name, position in self.positions.items())
        components = ", ".join(f"{round(component, 2) + 0.0:.2f}" for component in contact.direction)
        direction = "in its worst direction" if contact.worst_direction_used else f"along ({components})"
        mass = f"{contact.effective_mass:.3g} kg {direction}"
        yield "  why", f"{contact.criterion} limit of {contact.body_region}; {mass}"

    def as_dict(self) -> dict[str, Any]:
        """Return the margin for JSON, units in the names."""
        contact = self.contact
        return {
            "margin_m_s": contact.margin,
            "speed_m_s": contact.speed,
            "allowable_speed_m_s": contact.allowable_speed,
            "effective_mass_kg": contact.effective_mass,
            "stamp_ns": contact.stamp_ns,
            "contact_point": contact.contact_point,
            "direction": list(contact.direction),
            "criterion": contact.criterion,
            "body_region": contact.body_region,
            "verdict": contact.verdict.name,
            "bag": self.source,
            "positions": self.positions,
        }


class Summary:
    """Counts cycles in bounded memory. The verdict of a cycle is the worst of its contact points.

    A verdict lasts until the next joint state, at most for `timeout_ns`; the rest of the gap is UNKNOWN.
    """

    def __init__(self, timeout_ns: int) -> None:
        """Start at zero."""
        self._timeout_ns = timeout_ns
        self._last: tuple[int, Verdict] | None = None
        self.cycles: Counter[Verdict] = Counter()
        self.time_ns: Counter[Verdict] = Counter()
        self.reasons: Counter[str] = Counter()
        self.mass_models: Counter[str] = Counter()
        self.gaps = 0
        self.max_gap_ns = 0
        self.tightest: TightestMargin | None = None

    def add(
        self, contacts: Sequence[ContactAssessment], at_ns: int, state: JointState | None = None, source: str = ""
    ) -> None:
        """Count one cycle, assessed at `at_ns`; `state` is its joint state and `source` its recording, if known."""
        worst = contacts[0]
        for contact in contacts:
            if severity(contact.verdict) > severity(worst.verdict):
                worst = contact
            if contact.verdict is not Verdict.UNKNOWN and (
                self.tightest is None or contact.margin < self.tightest.contact.margin
            ):
                positions = {} if state is None else dict(zip(state.names, state.position.tolist(), strict=True))
                self.tightest = TightestMargin(contact, source, positions)
        self.cycles[worst.verdict] += 1
        if worst.verdict is Verdict.UNKNOWN:
            reason = NUMBER.sub("…", worst.reason)
            known = reason in self.reasons or len(self.reasons) < MAX_REASONS
            self.reasons[reason if known else OTHER_REASONS] += 1
        elif worst.mass_model:
            self.mass_models[f"{worst.mass_model}: {worst.mass_model_reason}"] += 1
        self._pass_time(at_ns)
        self._last = (at_ns, worst.verdict)

    @property
    def only_unknown(self) -> bool:
        """Whether no cycle has a verdict."""
        return self.cycles[Verdict.UNKNOWN] == self.cycles.total()

    def new_recording(self) -> None:
        """Start a new recording; the time since the last cycle is not counted."""
        self._last = None

    def as_dict(self) -> dict[str, Any]:
        """Return all counts for JSON, units in the names."""
        return {
            "cycles": sum(self.cycles.values()),
            "cycles_by_verdict": {verdict.name: self.cycles[verdict] for verdict in Verdict},
            "seconds_by_verdict": {verdict.name: self.time_ns[verdict] / 1e9 for verdict in Verdict},
            "gaps": self.gaps,
            "longest_gap_s": self.max_gap_ns / 1e9,
            "unknown_reasons": dict(self.reasons.most_common()),
            "mass_models": dict(self.mass_models.most_common()),
            "tightest": self.tightest and self.tightest.as_dict(),
        }

    def lines(self) -> Iterator[tuple[str, str]]:
        """Yield subject and text of each line."""
        cycles = sum(self.cycles.values())
        total_ns = sum(self.time_ns.values())
        for verdict in (Verdict.OK, Verdict.WARN, Verdict.VIOLATION, Verdict.UNKNOWN):
            if count := self.cycles[verdict]:
                share = self.time_ns[verdict] / total_ns if total_ns else count / cycles
                yield verdict.name, f"{count} cycles, {self.time_ns[verdict] / 1e9:.2f} s ({share:.1%})"
        if self.gaps:
            yield "gaps", f"{self.gaps} longer than the timeout, the longest {self.max_gap_ns / 1e9:.3f} s"
        if self.tightest is not None:
            yield from self.tightest.lines()
        for model, count in self.mass_models.most_common():
            yield "mass model", f"{model} ({count / self.mass_models.total():.1%})"
        reasons = self.reasons.most_common()
        for reason, count in reasons[:REASONS_SHOWN]:
            yield "UNKNOWN because", f"{reason} ({count} cycles)"
        if reasons[REASONS_SHOWN:]:
            yield "UNKNOWN because", f"{len(reasons) - REASONS_SHOWN} other reasons (--json lists them)"

    def _pass_time(self, at_ns: int) -> None:
        if self._last is None:
            return
        last_ns, verdict = self._last
        # Stamps may be out of order; no time is counted twice.
        elapsed_ns = max(0, at_ns - last_ns)
        self.time_ns[verdict] += min(elapsed_ns, self._timeout_ns)
        if elapsed_ns > self._timeout_ns:
            self.time_ns[Verdict.UNKNOWN] += elapsed_ns - self._timeout_ns
            self.gaps += 1
            self.max_gap_ns = max(self.max_gap_ns, elapsed_ns)

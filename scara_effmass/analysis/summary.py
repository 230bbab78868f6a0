# SPDX-License-Identifier: Apache-2.0
"""Summary of a run: cycles and time per verdict, the tightest margin, and the reasons of UNKNOWN."""

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from datetime import datetime, timezone
from typing import Any, NamedTuple

from scara_effmass.analysis.time_series import NO_JOINT_STATE
from scara_effmass.safety.debounce import severity
from scara_effmass.safety.remedies import remedy
from scara_effmass.values import ContactAssessment, JointState, Verdict

NUMBER = re.compile(r"(?<![\w.])-?\d+(\.\d+)?(e[-+]?\d+)?(?![\w])")
"""Numbers in a reason, except digits in names; reasons are counted without them."""
MAX_REASONS = 200
"""Maximum number of different reasons; further ones count as `OTHER_REASONS`, which bounds the memory."""
OTHER_REASONS = "other reasons"
REASONS_SHOWN = 5
MAX_UNKNOWN_SHARE = 0.05
"""Share of UNKNOWN above which the summary states a remedy."""


_ORDER = (Verdict.OK, Verdict.WARN, Verdict.UNKNOWN, Verdict.VIOLATION)


def iso_time(stamp_ns: int) -> str:
    """Return a ROS time [ns] as ISO 8601 in UTC, to the microsecond."""
    seconds, rest_ns = divmod(stamp_ns, 1_000_000_000)
    time = datetime.fromtimestamp(seconds, timezone.utc).replace(microsecond=rest_ns // 1000)
    return time.isoformat(timespec="microseconds").replace("+00:00", "Z")


def worst(verdicts: Iterable[Verdict]) -> Verdict:
    """Return the verdict on several intervals or tests: one VIOLATION outweighs what is UNKNOWN. None is UNKNOWN."""
    return max(verdicts, key=_ORDER.index, default=Verdict.UNKNOWN)


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
        yield "  where", f"{contact.contact_point} at {iso_time(contact.stamp_ns)}{source}"
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
        self._numbers: dict[str, list[tuple[float, float]]] = {}
        self.mass_models: Counter[str] = Counter()
        self.gaps = 0
        self.max_gap_ns = self._gaps_ns = 0
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
            if reason not in self.reasons and len(self.reasons) >= MAX_REASONS:
                reason = OTHER_REASONS
            self.reasons[reason] += 1
            numbers = [float(number.group()) for number in NUMBER.finditer(worst.reason)]
            ranges = self._numbers.setdefault(reason, [(number, number) for number in numbers])
            if reason != OTHER_REASONS:
                pairs = zip(ranges, numbers, strict=True)
                self._numbers[reason] = [(min(low, number), max(high, number)) for (low, high), number in pairs]
        elif worst.mass_model:
            self.mass_models[worst.mass_model_text] += 1
        self._pass_time(at_ns)
        self._last = (at_ns, worst.verdict)

    @property
    def only_unknown(self) -> bool:
        """Whether no cycle has a verdict."""
        return self.cycles[Verdict.UNKNOWN] == self.cycles.total()

    @property
    def remedy(self) -> str:
        """What to do about the leading reason if more than MAX_UNKNOWN_SHARE is UNKNOWN, else empty."""
        total_ns, unknown_ns = self.time_ns.total(), self.time_ns[Verdict.UNKNOWN]
        shares = self.cycles[Verdict.UNKNOWN] / (self.cycles.total() or 1), unknown_ns / (total_ns or 1)
        if max(shares) <= MAX_UNKNOWN_SHARE:
            return ""
        in_gaps = not self.reasons or 2 * self._gaps_ns > unknown_ns
        return remedy(NO_JOINT_STATE if in_gaps else self.reasons.most_common(1)[0][0])

    def reason_counts(self) -> dict[str, int]:
        """Return the number of UNKNOWN cycles by reason, most frequent first, with the ranges of its numbers."""
        counts = {}
        for reason, count in self.reasons.most_common():
            first, *others = reason.split("…")
            ends = (
                f"{low:.10g}" if low == high else f"{low:.10g} to {high:.10g}" for low, high in self._numbers[reason]
            )
            counts[first + "".join(map(str.__add__, ends, others))] = count
        return counts

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
            "unknown_reasons": self.reason_counts(),
            "remedy": self.remedy,
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
        reasons = list(self.reason_counts().items())
        for reason, count in reasons[:REASONS_SHOWN]:
            yield "UNKNOWN because", f"{reason} ({count} cycles)"
        if reasons[REASONS_SHOWN:]:
            yield "UNKNOWN because", f"{len(reasons) - REASONS_SHOWN} other reasons (--json lists them)"
        if self.remedy:
            yield "remedy", self.remedy

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
            self._gaps_ns += elapsed_ns - self._timeout_ns
            self.max_gap_ns = max(self.max_gap_ns, elapsed_ns)

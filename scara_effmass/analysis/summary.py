# SPDX-License-Identifier: Apache-2.0
"""Summary of a run: cycles and time per verdict, the tightest margin, and the reasons of UNKNOWN."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timezone
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from scara_effmass.analysis.assessment import AssessedStates
from scara_effmass.bags.batches import IntArray
from scara_effmass.codes import Reason
from scara_effmass.kernel.state import CODE
from scara_effmass.safety.assessments import Records
from scara_effmass.safety.remedies import remedy
from scara_effmass.values import BoolArray, ContactAssessment, Verdict, at_most, speed_texts

NUMBER = re.compile(r"(?<![\w.])-?\d+(\.\d+)?(e[-+]?\d+)?(?![\w])")
"""Numbers in a reason, but no digits in names; reasons that differ only in numbers are counted together."""
MAX_REASONS = 200
"""Maximum number of different reasons; further ones count as `OTHER_REASONS`, which bounds the memory."""
OTHER_REASONS = "other reasons"
REASONS_SHOWN = 5
"""Reasons in the lines of a summary; the JSON has all of them."""
MAX_UNKNOWN_SHARE = 0.05
"""Share of UNKNOWN above which the summary states a remedy."""

WORST_FIRST = (Verdict.VIOLATION, Verdict.UNKNOWN, Verdict.WARN, Verdict.OK)
"""Order of the verdicts on several intervals or tests; for one joint state UNKNOWN outweighs VIOLATION (`severity`)."""


def iso_time(stamp_ns: int) -> str:
    """Return a ROS time [ns] as ISO 8601 in UTC, to the microsecond."""
    seconds, rest_ns = divmod(stamp_ns, 1_000_000_000)
    time = datetime.fromtimestamp(seconds, timezone.utc).replace(microsecond=rest_ns // 1000)
    return time.isoformat(timespec="microseconds").replace("+00:00", "Z")


def signed(margin: float) -> str:
    """Return a margin [m/s] with its sign, rounded down."""
    return f"{'+' * (margin >= 0.0)}{at_most(margin, 3)}"


def worst(verdicts: Iterable[Verdict]) -> Verdict:
    """Return the verdict on several intervals or tests: VIOLATION outweighs UNKNOWN. Without any it is UNKNOWN."""
    return min(verdicts, key=WORST_FIRST.index, default=Verdict.UNKNOWN)


def mass_model_counts(
    contacts: Records, labels: Mapping[str, Sequence[str]], chosen: BoolArray | None = None
) -> Counter[str]:
    """Count the mass models that decide `contacts` (m,) or the `chosen` ones, with the reasons for them.

    `labels` are the texts of codes.
    """
    models, whys = labels["mass_model"], labels["mass_model_reason"]
    pairs = contacts["mass_model"].astype(np.int64) * len(whys) + contacts["mass_model_reason"].astype(np.int64)
    counts: Counter[str] = Counter()
    for pair, count in _counts(pairs if chosen is None else pairs[chosen]):
        model, why = divmod(pair, len(whys))
        if models[model]:
            counts[f"{models[model]}: {whys[why]}"] += count
    return counts


def shares(counts: Mapping[str, int]) -> str:
    """Return names with their shares of all `counts`, the largest first, without those of 0; empty if all are 0."""
    total = sum(counts.values())
    most_common = sorted(counts.items(), key=lambda item: -item[1])
    return ", ".join(f"{name} {count / total:.1%}" for name, count in most_common if count)


class TightestMargin(NamedTuple):
    """The assessment with the smallest margin, which is never UNKNOWN, its stamp, recording and joint positions."""

    stamp_ns: int
    contact: ContactAssessment
    source: str
    positions: dict[str, float]

    def lines(self) -> Iterator[tuple[str, str]]:
        """Yield subject and text of each line."""
        contact = self.contact
        speeds = "{} m/s where {} m/s is allowable".format(*speed_texts(contact.speed, contact.allowable_speed))
        yield "tightest margin", f"{signed(contact.margin)} m/s ({contact.verdict.name}): {speeds}"
        source = f" in {self.source}" if self.source else ""
        yield "  where", f"{contact.contact_point} at {iso_time(self.stamp_ns)}{source}"
        if self.positions:
            yield "  pose", ", ".join(f"{name} {position:.3f}" for name, position in self.positions.items())
        components = ", ".join(f"{round(component, 2) + 0.0:.2f}" for component in contact.direction)
        direction = "in its worst direction" if contact.worst_direction_used else f"along ({components})"
        limit = f"{contact.criterion} limit of {contact.body_region}"
        if contact.reason_code in {Reason.PERSON_TOO_FAST, Reason.CLAMPED}:  # at any speed
            limit = contact.reason
        yield "  why", f"{limit}; {contact.effective_mass:.3g} kg {direction}"

    def as_dict(self) -> dict[str, Any]:
        """Return the margin for JSON, units in the names."""
        contact = self.contact
        return {
            "margin_m_s": contact.margin,
            "speed_m_s": contact.speed,
            "allowable_speed_m_s": contact.allowable_speed,
            "effective_mass_kg": contact.effective_mass,
            "stamp_ns": self.stamp_ns,
            "contact_point": contact.contact_point,
            "direction": list(contact.direction),
            "criterion": contact.criterion,
            "body_region": contact.body_region,
            "verdict": contact.verdict.name,
            "bag": self.source,
            "positions": self.positions,
        }


@dataclass
class Summary:
    """Count cycles in bounded memory. The verdict of a cycle is that of its worst contact point.

    A verdict lasts until the next joint state, at most for `timeout_ns`; the rest of a longer gap is UNKNOWN. `last` is
    the time and verdict of the last cycle; `silence_ns` is the longest time from it to the end of a recording, 0 up to
    the timeout. In `reasons` "…" stands for each number; `codes` and `numbers` hold the code
    of each reason and the ranges of its numbers. `deciding` counts the cycles that are not UNKNOWN by that contact.
    """

    timeout_ns: int
    last: tuple[int, Verdict] | None = None
    cycles: Counter[Verdict] = field(default_factory=Counter)
    time_ns: Counter[Verdict] = field(default_factory=Counter)
    reasons: Counter[str] = field(default_factory=Counter)
    codes: dict[str, Reason] = field(default_factory=dict)
    numbers: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    mass_models: Counter[str] = field(default_factory=Counter)
    deciding: Counter[str] = field(default_factory=Counter)
    gaps: int = 0
    max_gap_ns: int = 0
    gaps_ns: int = 0
    silence_ns: int = 0
    tightest: TightestMargin | None = None

    def add(self, states: AssessedStates, source: str = "") -> None:
        """Count `states`, from the recording `source` if its name is known."""
        contacts, records = states.assessments.contacts, states.assessments.states
        deciding, shown = records["contact"], records["verdict"].astype(np.int8)
        self.cycles.update({verdict: count for verdict in Verdict if (count := int((shown == verdict).sum()))})
        self._find_tightest(states, source)
        for point in range(contacts.shape[1]):
            decides, unknown = deciding == point, shown == Verdict.UNKNOWN
            if (decides & unknown).any():
                indices, texts = states.assessments.reasons(point)
                for index, count in _counts(indices[decides & unknown]):
                    text = texts[index].replace("…", "...")  # "…" will stand for a number
                    numbers = [float(number.group()) for number in NUMBER.finditer(text)]
                    code = Reason(int(contacts["reason"][int(np.argmax(indices == index)), point, CODE]))
                    self._count_reason(NUMBER.sub("…", text), code, count, [(number, number) for number in numbers])
            self.mass_models += mass_model_counts(contacts[:, point], states.assessments.labels, decides & ~unknown)
            self.deciding[states.assessments.points[point]] += int((decides & ~unknown).sum())
        self._pass_time(states.log_time_ns, shown)

    def end(self, end_ns: int) -> None:
        """Note how long the recording, which ends at `end_ns`, goes on after its last cycle."""
        silence_ns = end_ns - self.last[0] if self.last is not None else 0
        self.silence_ns = silence_ns if silence_ns > self.timeout_ns else 0

    def _find_tightest(self, states: AssessedStates, source: str) -> None:
        contacts = states.assessments.contacts
        margins = np.where(contacts["verdict"] == Verdict.UNKNOWN, np.inf, contacts["margin"])
        row, point = divmod(int(np.argmin(margins)), margins.shape[1])
        if margins[row, point] < (self.tightest.contact.margin if self.tightest else np.inf):
            decision = states.assessments.decision(row)
            place = source, states.positions(row)
            self.tightest = TightestMargin(decision.stamp_ns, decision.contacts[point], *place)

    @property
    def only_unknown(self) -> bool:
        """Whether the verdict of every cycle is UNKNOWN."""
        return self.cycles[Verdict.UNKNOWN] == self.cycles.total()

    @property
    def remedy(self) -> str:
        """Remedy for the most frequent reason if more than MAX_UNKNOWN_SHARE is UNKNOWN, else empty."""
        total_ns, unknown_ns = self.time_ns.total(), self.time_ns[Verdict.UNKNOWN]
        shares = self.cycles[Verdict.UNKNOWN] / (self.cycles.total() or 1), unknown_ns / (total_ns or 1)
        if max(shares) <= MAX_UNKNOWN_SHARE:
            return ""
        in_gaps = not self.reasons or 2 * self.gaps_ns > unknown_ns
        return remedy(Reason.GAP if in_gaps else self.codes[self.reasons.most_common(1)[0][0]])

    def reason_counts(self) -> dict[str, int]:
        """Return the number of UNKNOWN cycles by reason, most frequent first, with the ranges of its numbers."""
        counts = {}
        for reason, count in self.reasons.most_common():
            first, *others = reason.split("…")
            ends = (
                f"{low:.10g}" if low == high else f"{low:.10g} to {high:.10g}" for low, high in self.numbers[reason]
            )
            counts[first + "".join(map(str.__add__, ends, others))] = count
        return counts

    def merge(self, other: Summary) -> None:
        """Add the counts of another recording; the time between the two is not counted."""
        self.cycles += other.cycles
        self.time_ns += other.time_ns
        self.mass_models += other.mass_models
        self.deciding += other.deciding
        for reason, count in other.reasons.items():
            self._count_reason(reason, other.codes[reason], count, other.numbers[reason])
        self.gaps += other.gaps
        self.max_gap_ns = max(self.max_gap_ns, other.max_gap_ns)
        self.gaps_ns += other.gaps_ns
        self.silence_ns = max(self.silence_ns, other.silence_ns)
        margins = [tightest for tightest in (self.tightest, other.tightest) if tightest is not None]
        self.tightest = min(margins, key=lambda tightest: tightest.contact.margin, default=None)

    def _count_reason(self, reason: str, code: Reason, count: int, ranges: list[tuple[float, float]]) -> None:
        """Add `count` to a `reason` of UNKNOWN, in which "…" stands for each number; the numbers lie in `ranges`."""
        if reason not in self.reasons and len(self.reasons) >= MAX_REASONS:
            reason, code = OTHER_REASONS, Reason.STATED
        self.reasons[reason] += count
        self.codes[reason] = code
        before = self.numbers.setdefault(reason, ranges if reason != OTHER_REASONS else [])
        if reason != OTHER_REASONS:
            pairs = zip(before, ranges, strict=True)
            self.numbers[reason] = [(min(a, c), max(b, d)) for (a, b), (c, d) in pairs]

    def as_dict(self) -> dict[str, Any]:
        """Return all counts for JSON, units in the names."""
        return {
            "cycles": sum(self.cycles.values()),
            "cycles_by_verdict": {verdict.name: self.cycles[verdict] for verdict in Verdict},
            "seconds_by_verdict": {verdict.name: self.time_ns[verdict] / 1e9 for verdict in Verdict},
            "gaps": self.gaps,
            "longest_gap_s": self.max_gap_ns / 1e9,
            "silence_at_end_s": self.silence_ns / 1e9,
            "unknown_reasons": self.reason_counts(),
            "remedy": self.remedy,
            "mass_models": dict(self.mass_models.most_common()),
            "deciding_contacts": dict(self.deciding.most_common()),
            "tightest": self.tightest and self.tightest.as_dict(),
        }

    def lines(self) -> Iterator[tuple[str, str]]:
        """Yield subject and text of each line."""
        cycles = sum(self.cycles.values())
        total_ns = sum(self.time_ns.values())
        for verdict in (Verdict.OK, Verdict.WARN, Verdict.VIOLATION, Verdict.UNKNOWN):
            if count := self.cycles[verdict]:
                share = self.time_ns[verdict] / total_ns if total_ns else count / cycles
                yield verdict.name, f"{_cycles(count)}, {self.time_ns[verdict] / 1e9:.2f} s ({share:.1%})"
        yield from self._gap_lines()
        if self.tightest is not None:
            yield from self.tightest.lines()
        if len(self.deciding) > 1 and (deciding := shares(self.deciding)):
            yield "decided by", deciding
        for model, count in self.mass_models.most_common():
            yield "mass model", f"{model} ({count / self.mass_models.total():.1%})"
        reasons = list(self.reason_counts().items())
        for reason, count in reasons[:REASONS_SHOWN]:
            yield "UNKNOWN because", f"{reason} ({_cycles(count)})"
        if reasons[REASONS_SHOWN:]:
            yield "UNKNOWN because", f"{len(reasons) - REASONS_SHOWN} other reasons (--json lists them)"
        if self.remedy:
            yield "remedy", self.remedy

    def _gap_lines(self) -> Iterator[tuple[str, str]]:
        if self.gaps:
            yield "gaps", f"{self.gaps} longer than the timeout, the longest {self.max_gap_ns / 1e9:.3f} s"
        if self.silence_ns:
            silence = f"{self.silence_ns / 1e9:.2f} s of the recording"
            yield "silent", f"no joint state of the arm in the last {silence}: UNKNOWN live"

    def _pass_time(self, at_ns: IntArray, verdicts: NDArray[np.int8]) -> None:
        if self.last is not None:
            at_ns, verdicts = np.append(self.last[0], at_ns), np.append(self.last[1], verdicts)
        self.last = int(at_ns[-1]), Verdict(verdicts[-1])
        # Stamps may be out of order; no time is counted twice.
        elapsed_ns = np.maximum(np.diff(at_ns), 0)
        counted_ns = np.minimum(elapsed_ns, self.timeout_ns)
        gaps_ns = int((elapsed_ns - counted_ns).sum())
        for verdict in Verdict:
            self.time_ns[verdict] += int(counted_ns[verdicts[:-1] == verdict].sum())
        self.time_ns[Verdict.UNKNOWN] += gaps_ns
        self.gaps_ns += gaps_ns
        is_gap = elapsed_ns > self.timeout_ns
        self.gaps += int(is_gap.sum())
        self.max_gap_ns = max(self.max_gap_ns, int(elapsed_ns[is_gap].max(initial=0)))


def _cycles(count: int) -> str:
    return f"{count} cycle{'s' * (count != 1)}"


def _counts(values: NDArray[Any]) -> Iterator[tuple[int, int]]:
    """Yield each distinct value and how often it occurs, in the order of first occurrence."""
    counted = pa.array(values).value_counts()
    return zip(counted.field("values").to_pylist(), counted.field("counts").to_pylist(), strict=True)

# SPDX-License-Identifier: Apache-2.0
"""Status of a cell as displays show it: verdict, speeds of the last minute, episodes, impacts and diagnostics.

Times `at_ns` and `now_ns` are monotonic and those of arrival [ns]: no sender's clock can make an old state look fresh.
"""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple, final

import numpy as np

from scara_effmass.codes import Reason
from scara_effmass.safety.assumptions import Assumptions
from scara_effmass.safety.reasons import LOAD_ENTRY, plain_text
from scara_effmass.values import (
    ContactAssessment,
    Decision,
    FloatArray,
    ForceBlock,
    Impact,
    JointState,
    RunInfo,
    SeriesStatistics,
    Verdict,
)

HISTORY_NS = 60_000_000_000
BIN_NS = 50_000_000
"""Bin width of the history [ns]; each bin keeps its worst sample."""
DEFAULT_TIMEOUT_NS = 400_000_000
"""Deadline that a monitor with default settings offers [ns]."""
MAX_EPISODES = 1000
MAX_LOADS = 100
MAX_IMPACTS = 20
MAX_VALIDATIONS = 500
FORCE_BUFFER_NS = 5_000_000_000
TRACE_BEFORE_NS, TRACE_AFTER_NS = 2_000_000, 6_000_000
"""Force shown before the onset and after the end of an impact."""
_LOST_FORCE_NS = 2_000_000_000
"""Longest wait for the force of an impact [ns]."""


class SpeedSample(NamedTuple):
    """Speed, not known under UNKNOWN, and allowable speed [m/s] of the contact point with the smallest margin."""

    at_ns: int
    verdict: Verdict
    speed: float
    allowable_speed: float


class LoadSample(NamedTuple):
    """What displays show of a `PayloadEstimate.msg`."""

    at_ns: int
    mass: float
    mass_lower: float
    mass_upper: float
    stated_mass: float
    is_observable: bool
    text: str


@dataclass
class Episode:
    """Period with one verdict other than OK; contact point and cause are those at its start.

    `end_ns` is None while it lasts. `simulated` is `CellStatus.simulated` during the episode.
    """

    verdict: Verdict
    contact_point: str
    cause: str
    start_ns: int
    end_ns: int | None = None
    simulated: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Validation:
    """What displays show of an `ImpactValidation.msg`."""

    stamp_ns: int
    predicted_force: float
    measured_force: float
    relative_error: float
    reduced_mass: float
    speed: float
    conservative: bool
    body_region: str
    region_force: float
    limit_force: float
    exceeds_limit: bool
    series: SeriesStatistics
    held_force: float = 0.0
    held_limit: float = 0.0
    held_region: str = ""


@dataclass
class ImpactRecord:
    """A primary impact with its rebounds, its validation and the force around it, at most 400 samples.

    `left_out` is why the validator leaves it out of the series; empty if it does not.
    `time_s` [s] counts from the onset. `force` [N] is empty until it has arrived completely.
    """

    impact: Impact
    at_ns: int
    rebounds: int = 0
    validation: Validation | None = None
    left_out: str = ""
    time_s: FloatArray = field(default_factory=lambda: np.empty(0))
    force: FloatArray = field(default_factory=lambda: np.empty(0))


class Diagnostic(NamedTuple):
    """Last diagnostic status of this name; `level` is 0 OK, 1 WARN, 2 ERROR, 3 STALE."""

    name: str
    level: int
    message: str
    values: Mapping[str, str]
    at_ns: int


def left_out_entry(stamp_ns: int) -> str:
    """Return the entry of the validator's diagnostics that says why it left out the impact with this stamp."""
    seconds, rest_ns = divmod(stamp_ns, 1_000_000_000)
    return f"left out: impact at {seconds}.{rest_ns:09d} s"


def _no_verdict(code: Reason, *values: float) -> tuple[Reason, str]:
    """Return code and text of a reason that the display concludes by itself."""
    return code, plain_text(code, *values)


@final
class CellStatus:
    """What is known about a cell at the time of the last `update`.

    `verdict` is that of the latest `decision`, with `contact_point`, `reason` and `reason_code`. It is UNKNOWN before
    the first one, with no or two monitors, and when the monitor is silent for longer than `timeout_ns`.
    `allowable_speed` [m/s] and `speed_scaling` [0-1] are then 0. `lost` counts the messages that did not arrive.
    """

    def __init__(self, now_ns: int) -> None:
        self.timeout_ns = DEFAULT_TIMEOUT_NS
        self.has_monitor = True
        self.decision: Decision | None = None
        self.lost = 0
        self.verdict, self.contact_point = Verdict.UNKNOWN, ""
        self.reason_code, self.reason = _no_verdict(Reason.NO_CONTACT_STATES)
        self.verdict_since_ns = now_ns
        self.allowable_speed = self.speed_scaling = 0.0
        self.joint_state: JointState | None = None
        self.joint_state_at_ns = 0
        self.speeds: deque[SpeedSample] = deque(maxlen=HISTORY_NS // BIN_NS + 1)
        self.loads: deque[LoadSample] = deque(maxlen=MAX_LOADS)
        self.episodes: deque[Episode] = deque([Episode(self.verdict, "", self.reason, now_ns)], maxlen=MAX_EPISODES)
        self.impacts: deque[ImpactRecord] = deque(maxlen=MAX_IMPACTS)
        self.validations: deque[Validation] = deque(maxlen=MAX_VALIDATIONS)
        self.diagnostics: dict[str, Diagnostic] = {}
        self.run_info: RunInfo | None = None
        self._force: deque[ForceBlock] = deque()
        self._arrived_ns = self._conflict_ns = -(2**62)

    @property
    def simulated(self) -> list[str]:
        """Parts that are reported as simulated, of "robot" and "force"."""
        force = [block.simulated for block in self._force] + [record.impact.simulated for record in self.impacts]
        robot = self.run_info is not None and self.run_info.simulated
        return [name for name, simulated in (("robot", robot), ("force", any(force))) if simulated]

    @property
    def unknown_force(self) -> str:
        """Why the latest force is not known, so that an impact would not show; empty if it is."""
        is_unknown = self._force and self._force[-1].is_unknown
        return "force not known: sensor open, shorted or overloaded" if is_unknown else ""

    @property
    def no_impact_reason(self) -> str:
        """Why no impact is shown; empty if there is one."""
        if self.impacts:
            return ""
        if self.unknown_force:
            return self.unknown_force
        return "no impact yet" if self._force else "no impact: no force is received, so no daq node runs in this cell"

    @property
    def no_validation_reason(self) -> str:
        """Why no impact is compared with its prediction; empty if one is."""
        if self.validations:
            return ""
        return (
            self.no_impact_reason
            or "no impact is validated: no validator runs, or it rejects them (see its diagnostics)"
        )

    def load_text(self, now_ns: int) -> str:
        """Return what the last estimate of the load says, and its age; without one, what the monitor says of it."""
        if self.loads:
            last = self.loads[-1]
            return f"{last.text}; {(now_ns - last.at_ns) / 1e9:.0f} s ago"
        texts = (entry.values[LOAD_ENTRY] for entry in self.diagnostics.values() if LOAD_ENTRY in entry.values)
        return next(texts, "unknown: no monitor of this cell has published diagnostics")

    @property
    def contacts(self) -> tuple[ContactAssessment, ...]:
        """The contacts of the latest decision."""
        return self.decision.contacts if self.decision is not None else ()

    @property
    def scope(self) -> str:
        """What an OK covers; empty without a decision."""
        return self.decision.scope if self.decision is not None else ""

    @property
    def assumed(self) -> str:
        """What the monitor assumes and which options state it, and what its settings accept, in one line."""
        if self.decision is None or self.verdict is Verdict.UNKNOWN:
            return ""
        assumptions = Assumptions(self.decision.assumptions, self.decision.accepted_assumptions)
        return "; ".join(text for _, text in assumptions.lines)

    def take_decision(self, decision: Decision, at_ns: int) -> None:
        """Take a decision; a number that does not increase is that of another monitor.

        It is a successor, or a second monitor unless the first one is silent.
        """
        last = self.decision.sequence_number if self.decision is not None else 0
        if 0 < decision.sequence_number <= last:
            if at_ns - self._arrived_ns <= self.timeout_ns:
                self._conflict_ns = at_ns
        elif last and decision.sequence_number and at_ns - self._conflict_ns > self.timeout_ns:
            self.lost += decision.sequence_number - last - 1
        self.decision, self._arrived_ns = decision, at_ns
        self._take_speed(min(decision.contacts, key=lambda contact: contact.margin), at_ns)
        self.update(at_ns)

    def _take_speed(self, contact: ContactAssessment, at_ns: int) -> None:
        sample = SpeedSample(at_ns, contact.verdict, contact.speed, contact.allowable_speed)
        last = self.speeds[-1] if self.speeds else None
        if last is None or last.at_ns // BIN_NS < at_ns // BIN_NS:
            self.speeds.append(sample)
        elif contact.margin < last.allowable_speed - last.speed:
            self.speeds[-1] = sample

    def take_joint_state(self, state: JointState, at_ns: int) -> None:
        """Take the latest joint state."""
        self.joint_state, self.joint_state_at_ns = state, at_ns

    def take_run_info(self, info: RunInfo, _at_ns: int = 0) -> None:
        """Take the information on the run."""
        self.run_info = info

    def take_force(self, block: ForceBlock, _at_ns: int = 0) -> None:
        """Take a block of force; the last seconds are kept."""
        self._force.append(block)
        while block.stamp_ns - self._force[0].stamp_ns > FORCE_BUFFER_NS or block.stamp_ns < self._force[0].stamp_ns:
            self._force.popleft()

    def take_impact(self, impact: Impact, at_ns: int) -> None:
        """Take an impact; a rebound is counted with its primary impact."""
        if not impact.rebound:
            self.impacts.append(ImpactRecord(impact, at_ns))
        elif self.impacts:
            self.impacts[-1].rebounds = max(self.impacts[-1].rebounds, impact.rebound)

    def take_validation(self, validation: Validation) -> None:
        """Take the validation of an impact; one with count 1 starts a new series."""
        if validation.series.count == 1:
            self.validations.clear()
        self.validations.append(validation)
        for record in self.impacts:
            if record.impact.stamp_ns == validation.stamp_ns:
                record.validation = validation

    def take_diagnostic(self, entry: Diagnostic) -> None:
        """Take a diagnostic status, and why a validator left out impacts."""
        self.diagnostics[entry.name] = entry
        for record in self.impacts:
            record.left_out = entry.values.get(left_out_entry(record.impact.stamp_ns), record.left_out)

    def take_publisher(self, timeout_ns: int, *, exists: bool) -> None:
        """Take whether contact_states has a publisher, and the time within which it promises a message."""
        self.has_monitor, self.timeout_ns = exists, timeout_ns
        if not exists:
            self.decision = None

    def take_second_publisher(self, now_ns: int) -> None:
        """Take that contact_states has got a second publisher: another monitor, unless the first one is silent."""
        if self.decision is not None and now_ns - self._arrived_ns <= self.timeout_ns:
            self._conflict_ns = now_ns

    def update(self, now_ns: int) -> None:
        """Judge silence at `now_ns`, log the verdict, and cut out the force of new impacts."""
        verdict, point, (code, reason) = self._judge(now_ns)
        if verdict is not self.verdict:
            at_ns = max(now_ns, self.verdict_since_ns)  # a message that waited is older than what was judged meanwhile
            if self.episodes and self.episodes[-1].end_ns is None:
                self.episodes[-1].end_ns = at_ns
            if verdict is not Verdict.OK:
                self.episodes.append(Episode(verdict, point, reason, at_ns))
            self.verdict_since_ns = at_ns
        self.verdict, self.contact_point, self.reason_code, self.reason = verdict, point, code, reason
        self.allowable_speed = self.speed_scaling = 0.0
        if self.decision is not None and verdict is not Verdict.UNKNOWN:
            self.allowable_speed, self.speed_scaling = self.decision.allowable_speed, self.decision.speed_scaling
        if self.episodes and self.episodes[-1].end_ns is None:  # which may have begun before the report of a simulation
            self.episodes[-1].simulated = self.simulated or self.episodes[-1].simulated
        for record in self.impacts:
            if not len(record.force) and now_ns - record.at_ns < _LOST_FORCE_NS:
                self._cut_trace(record)

    def _judge(self, now_ns: int) -> tuple[Verdict, str, tuple[Reason, str]]:
        """Return the verdict of the cell, the contact point that decides, and code and text of the reason."""
        if not self.has_monitor:
            return Verdict.UNKNOWN, "", _no_verdict(Reason.NO_MONITOR)
        if now_ns - self._conflict_ns <= self.timeout_ns:
            return Verdict.UNKNOWN, "", _no_verdict(Reason.TWO_MONITORS)
        if self.decision is None:
            return Verdict.UNKNOWN, "", _no_verdict(Reason.NO_CONTACT_STATES)
        silence_ns = now_ns - self._arrived_ns
        if silence_ns > self.timeout_ns:
            return Verdict.UNKNOWN, "", _no_verdict(Reason.MONITOR_SILENT, silence_ns / 1e9)
        worst = self.decision.worst
        return worst.verdict, worst.contact_point, (worst.reason_code, worst.reason)

    def _cut_trace(self, record: ImpactRecord) -> None:
        """Copy the force around an impact once it has arrived completely."""
        start_ns = record.impact.stamp_ns - TRACE_BEFORE_NS
        end_ns = record.impact.stamp_ns + round(record.impact.duration * 1e9) + TRACE_AFTER_NS
        times, forces = [], []
        for block in self._force:
            if block.stamp_ns > end_ns or block.stamp_ns + len(block.force) / block.sample_rate * 1e9 < start_ns:
                continue
            stamps_ns = block.stamp_ns + np.arange(len(block.force)) * (1e9 / block.sample_rate)
            inside = (stamps_ns >= start_ns) & (stamps_ns <= end_ns)
            times.append(stamps_ns[inside])
            forces.append(block.force[inside])
            if len(stamps_ns) and stamps_ns[-1] >= end_ns:
                time_s = (np.concatenate(times) - record.impact.stamp_ns) / 1e9
                force = np.concatenate(forces)
                # Keep the largest sample of each group, and so the peak.
                step = max(1, math.ceil(len(force) / 400))
                kept = [at + int(force[at : at + step].argmax()) for at in range(0, len(force), step)]
                record.time_s, record.force = time_s[kept], force[kept]
                return

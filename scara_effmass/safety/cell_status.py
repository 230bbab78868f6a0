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

from scara_effmass.safety.debounce import severity
from scara_effmass.safety.monitor import unknown_contact
from scara_effmass.values import ContactAssessment, FloatArray, ForceBlock, Impact, JointState, RunInfo, Verdict

HISTORY_NS = 60_000_000_000
BIN_NS = 50_000_000
"""Bin width of the history [ns]; each bin keeps its worst sample."""
DEFAULT_TIMEOUT_NS = 400_000_000
"""Deadline that a monitor with default settings offers [ns]."""
MAX_EPISODES = 1000
MAX_IMPACTS = 20
MAX_VALIDATIONS = 500
FORCE_BUFFER_NS = 5_000_000_000
TRACE_BEFORE_NS, TRACE_AFTER_NS = 2_000_000, 6_000_000
"""Force shown before the onset and after the end of an impact."""
_LOST_FORCE_NS = 2_000_000_000
"""Longest wait for the force of an impact [ns]."""
_NO_STATE = "no contact state yet"


class SpeedSample(NamedTuple):
    """Speed and allowable speed [m/s] of the contact point with the smallest margin."""

    at_ns: int
    contact_point: str
    speed: float
    allowable_speed: float


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
    """Fields of `ImpactValidation.msg` that displays show."""

    stamp_ns: int
    predicted_force: float
    measured_force: float
    relative_error: float
    conservative: bool
    body_region: str
    limit_force: float
    exceeds_limit: bool
    count: int
    correlation: float
    accepted: bool
    decidable: bool
    reason: str


@dataclass
class ImpactRecord:
    """A primary impact with its rebounds, its validation and the force around it, at most 400 samples.

    `time_s` [s] counts from the onset. `force` [N] is empty until it has arrived completely.
    """

    impact: Impact
    at_ns: int
    rebounds: int = 0
    validation: Validation | None = None
    time_s: FloatArray = field(default_factory=lambda: np.empty(0))
    force: FloatArray = field(default_factory=lambda: np.empty(0))


class Diagnostic(NamedTuple):
    """Last diagnostic status of this name; `level` is 0 OK, 1 WARN, 2 ERROR, 3 STALE."""

    name: str
    level: int
    message: str
    values: Mapping[str, str]
    at_ns: int


@final
class CellStatus:
    """What is known about a cell at the time of the last `update`.

    `verdict` is the worst of the contact points, with `contact_point` and `reason`. It is UNKNOWN before the first
    contact state, with no or two monitors, and when a contact point is silent for longer than `timeout_ns`.
    `allowable_speed` [m/s] and `speed_scaling` [0-1] are then 0. `contacts` holds the latest state of each point.
    """

    def __init__(self, now_ns: int) -> None:
        self.timeout_ns = DEFAULT_TIMEOUT_NS
        self.has_monitor = True
        self.contacts: dict[str, ContactAssessment] = {}
        self.verdict, self.contact_point, self.reason = Verdict.UNKNOWN, "", _NO_STATE
        self.verdict_since_ns = now_ns
        self.allowable_speed = self.speed_scaling = 0.0
        self.joint_state: JointState | None = None
        self.joint_state_at_ns = 0
        self.speeds: deque[SpeedSample] = deque(maxlen=HISTORY_NS // BIN_NS + 1)
        self.episodes: deque[Episode] = deque([Episode(self.verdict, "", _NO_STATE, now_ns)], maxlen=MAX_EPISODES)
        self.impacts: deque[ImpactRecord] = deque(maxlen=MAX_IMPACTS)
        self.validations: deque[Validation] = deque(maxlen=MAX_VALIDATIONS)
        self.diagnostics: dict[str, Diagnostic] = {}
        self.run_info: RunInfo | None = None
        self._force: deque[ForceBlock] = deque()
        self._arrived_ns: dict[str, int] = {}
        self._conflict_ns = -(2**62)
        self._scalars: dict[str, tuple[float, int]] = {}

    @property
    def simulated(self) -> list[str]:
        """Parts that are reported as simulated, of "robot" and "force"."""
        force = [block.simulated for block in self._force] + [record.impact.simulated for record in self.impacts]
        robot = self.run_info is not None and self.run_info.simulated
        return [name for name, simulated in (("robot", robot), ("force", any(force))) if simulated]

    @property
    def deciding(self) -> ContactAssessment | None:
        """The contact point with the smallest margin among those with the worst verdict; None without any."""
        points = self.contacts.values()
        return max(points, key=lambda c: (severity(c.verdict), c.speed - c.allowable_speed), default=None)

    def take_contact(self, contact: ContactAssessment, at_ns: int) -> None:
        """Take the state of one contact point; numbers that are not finite make it UNKNOWN."""
        if not (math.isfinite(contact.speed) and math.isfinite(contact.allowable_speed)):
            reason = "the contact state has a speed that is not a number"
            contact = unknown_contact(contact.contact_point, reason, contact.stamp_ns, contact.input_age)
        name = contact.contact_point
        if name not in self.contacts and (not name or "" in self.contacts):
            self._forget_contacts()  # a monitor without a robot names no contact point
        self.contacts[name] = contact
        self.take_speed(name, contact.speed, contact.allowable_speed, at_ns)
        self.update(at_ns)

    def take_speed(self, contact_point: str, speed: float, allowable_speed: float, at_ns: int) -> None:
        """Take the speeds [m/s] of one contact point whose verdict has not changed."""
        self._arrived_ns[contact_point] = at_ns
        sample = SpeedSample(at_ns, contact_point, speed, allowable_speed)
        last = self.speeds[-1] if self.speeds else None
        if last is None or last.at_ns // BIN_NS < at_ns // BIN_NS:
            self.speeds.append(sample)
        elif allowable_speed - speed < last.allowable_speed - last.speed:
            self.speeds[-1] = sample

    def take_scalar(self, name: str, value: float, at_ns: int) -> None:
        """Take `allowable_speed` [m/s] or `speed_scaling` [0-1]."""
        self._scalars[name] = (value if math.isfinite(value) else 0.0, at_ns)

    def take_joint_state(self, state: JointState, at_ns: int) -> None:
        """Take the latest joint state."""
        self.joint_state, self.joint_state_at_ns = state, at_ns

    def take_force(self, block: ForceBlock) -> None:
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
        if validation.count == 1:
            self.validations.clear()
        self.validations.append(validation)
        for record in self.impacts:
            if record.impact.stamp_ns == validation.stamp_ns:
                record.validation = validation

    def take_publisher(self, timeout_ns: int, *, exists: bool) -> None:
        """Take whether contact states have a publisher, and the time within which it promises a message."""
        self.has_monitor, self.timeout_ns = exists, timeout_ns
        if not exists:
            self._forget_contacts()  # the next monitor may have other contact points

    def take_other_monitor(self, at_ns: int) -> None:
        """Note that another monitor publishes: a successor, or a second one unless the first is silent."""
        if any(at_ns - arrived_ns <= self.timeout_ns for arrived_ns in self._arrived_ns.values()):
            self._conflict_ns = at_ns
        self._forget_contacts()

    def update(self, now_ns: int) -> None:
        """Judge silence at `now_ns`, log the verdict, and cut out the force of new impacts."""
        verdict, point, reason = self._judge(now_ns)
        if verdict is not self.verdict:
            if self.episodes and self.episodes[-1].end_ns is None:
                self.episodes[-1].end_ns = max(now_ns, self.episodes[-1].start_ns)
            if verdict is not Verdict.OK:
                self.episodes.append(Episode(verdict, point, reason, now_ns))
            self.verdict_since_ns = now_ns
        self.verdict, self.contact_point, self.reason = verdict, point, reason
        self.allowable_speed, self.speed_scaling = (
            value if verdict is not Verdict.UNKNOWN and now_ns - at_ns <= self.timeout_ns else 0.0
            for value, at_ns in (self._scalars.get(name, (0.0, 0)) for name in ("allowable_speed", "speed_scaling"))
        )
        if self.episodes and self.episodes[-1].end_ns is None:  # which may have begun before the report of a simulation
            self.episodes[-1].simulated = self.simulated or self.episodes[-1].simulated
        for record in self.impacts:
            if not len(record.force) and now_ns - record.at_ns < _LOST_FORCE_NS:
                self._cut_trace(record)

    def _judge(self, now_ns: int) -> tuple[Verdict, str, str]:
        """Return the verdict of the cell, the contact point that decides, and the reason."""
        if not self.has_monitor:
            return Verdict.UNKNOWN, "", "no monitor: contact_state has no publisher"
        if now_ns - self._conflict_ns <= self.timeout_ns:
            return Verdict.UNKNOWN, "", "two monitors publish contact_state: must be one"
        deciding = self.deciding
        if deciding is None:
            return Verdict.UNKNOWN, "", _NO_STATE
        name, silence_ns = max(((name, now_ns - at) for name, at in self._arrived_ns.items()), key=lambda pair: pair[1])
        if silence_ns > self.timeout_ns:
            return Verdict.UNKNOWN, name, f"the monitor is silent: no contact state for {silence_ns / 1e9:.1f} s"
        return deciding.verdict, deciding.contact_point, deciding.reason

    def _forget_contacts(self) -> None:
        self.contacts.clear()
        self._arrived_ns.clear()

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

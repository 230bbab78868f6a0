# SPDX-License-Identifier: Apache-2.0
"""Match impacts with the contact states at their onsets.

Impacts are matched in the order of arrival, each as soon as the states around its onset have arrived. The result
depends only on stamps and arrival times, not on the interleaving of the two streams.
"""

import math
from collections import deque
from collections.abc import Iterator
from statistics import median
from typing import Any, NamedTuple

from scara_effmass.errors import SettingsError
from scara_effmass.impacts.state_history import NANOSECONDS, WINDOW, Kink, OnsetState, Rejection, StateHistory, dot
from scara_effmass.iso15066 import MIN_EFFECTIVE_MASS, reduced_mass
from scara_effmass.settings import ValidatorSettings
from scara_effmass.settings.validator import MAX_OBSTACLE_MASS
from scara_effmass.values import ForceBlock, Impact, RefusedImpact, RunInfo, Vector3

MAX_STAMP_NS = 2**63 - 1
MIN_PEAK_FORCE = 1e-6
"""Smaller peak forces [N] are rounding errors, and the squares of much smaller ones are zero."""
MAX_CLOCK_RESIDUAL_S = 60.0
"""Maximum uncertainty of a stamp [s]; beyond it, no contact state can be matched."""
MIN_NORMAL_COMPONENT = 0.1
"""Minimum component of the velocity, or of the sensor's axis, along the normal of the plate."""
REBOUND = "rebound of an earlier impact"
LARGER_REBOUND = "rebound of an earlier impact, but larger"
CLIPPED = "clipped: the force reached the end of the measuring range"
INCOMPLETE = "incomplete: samples are lost or doubtful, or the recording ends during it"
DUPLICATE = "duplicate: an impact of this source with this stamp came before"
PRESS = "press: the force rose slowly, or stayed near its peak"
APART = "their clocks differ, or the machine is overloaded"
MAX_LAGS = 1000
"""Maximum number of lags that are kept, each for force blocks and for impacts."""


class Run(NamedTuple):
    """Conditions from `since_ns` on: obstacle mass [kg] (0: unknown) and name of the robot configuration.

    `normal` is that of the plate; None: along the velocity. `guide` is the direction in which the obstacle moves and
    the sensor measures; None: along `normal`. Both are unit vectors in the base frame.
    """

    since_ns: int
    obstacle_mass: float
    configuration: str
    normal: Vector3 | None = None
    guide: Vector3 | None = None

    @property
    def force_share(self) -> float:
        """Component of the normal along the axis of the sensor, that is, measured force / force along the normal."""
        return abs(dot(self.normal, self.guide)) if self.normal and self.guide else 1.0

    @property
    def usable_share(self) -> float:
        """The force share; 1 if the guide lies in the plate."""
        return self.force_share if self.force_share >= MIN_NORMAL_COMPONENT else 1.0


def check_run_info(info: RunInfo) -> None:
    """Raise SettingsError for an invalid stamp, configuration, obstacle mass, or direction."""
    if abs(info.stamp_ns) > MAX_STAMP_NS:
        raise SettingsError(f"stamp = {info.stamp_ns} ns: must be ROS time")
    if not info.configuration.isprintable():
        raise SettingsError(f"configuration = {info.configuration!r}: must be printable")
    if not 0.0 <= info.obstacle_mass <= MAX_OBSTACLE_MASS:
        limits = f"0 (not stated) to {MAX_OBSTACLE_MASS:g} kg"
        raise SettingsError(f"obstacle_mass = {info.obstacle_mass!r}: must be {limits}")
    for name in ("plate_normal", "guide_direction"):
        if not all(map(math.isfinite, getattr(info, name))):
            raise SettingsError(f"{name} = {getattr(info, name)}: must be finite")
    normal, guide = _unit(info.plate_normal), _unit(info.guide_direction)
    if normal and guide and not abs(dot(normal, guide)) >= MIN_NORMAL_COMPONENT:
        raise SettingsError(f"guide_direction = {info.guide_direction}: must not lie in the plate")


class RunHistory:
    """Obstacle mass, robot configuration and plate over time."""

    def __init__(self, obstacle_mass: float, configuration: str, normal: Vector3 | None = None) -> None:
        self._runs = [Run(0, obstacle_mass, configuration, normal)]
        self._defaults = self._runs[0]
        self._forgotten_ns = 0

    def set(
        self,
        since_ns: int,
        obstacle_mass: float | None = None,
        configuration: str | None = None,
        normal: Vector3 | None = None,
    ) -> None:
        """Begin a run with changed settings; None keeps a value. Raises SettingsError."""
        check_run_info(RunInfo(obstacle_mass=obstacle_mass or 0.0))
        stated = {"obstacle_mass": obstacle_mass, "configuration": configuration, "normal": normal}
        changes: dict[str, Any] = {name: value for name, value in stated.items() if value is not None}
        self._defaults = self._defaults._replace(**changes)
        self._insert(self.at(since_ns)._replace(since_ns=since_ns, **changes))

    def begin(self, info: RunInfo, received_ns: int) -> int:
        """Begin the run that `info` describes and return since when [ns]; the settings have what it does not state.

        It begins no earlier than the obstacle was forgotten. Raises SettingsError for an invalid value; then the
        obstacle mass is unknown.
        """
        try:
            check_run_info(info)
        except SettingsError:
            self.forget_obstacle(received_ns)
            raise
        defaults, since_ns = self._defaults, max(info.stamp_ns or received_ns, self._forgotten_ns)
        mass, configuration = info.obstacle_mass or defaults.obstacle_mass, info.configuration or defaults.configuration
        normal = _unit(info.plate_normal) or defaults.normal
        self._insert(Run(since_ns, mass, configuration, normal, _unit(info.guide_direction)))
        return since_ns

    def forget_obstacle(self, since_ns: int) -> None:
        """Begin a run with an unknown obstacle mass."""
        self._forgotten_ns = since_ns
        self._insert(self.at(since_ns)._replace(since_ns=since_ns, obstacle_mass=0.0))

    def at(self, stamp_ns: int) -> Run:
        """Return the run at `stamp_ns`."""
        return next((run for run in reversed(self._runs) if run.since_ns <= stamp_ns), self._runs[0])

    @property
    def latest(self) -> Run:
        """The run that began last."""
        return self._runs[-1]

    def restart(self) -> None:
        """Keep only the latest run, valid from time 0, because the clock restarts."""
        self._runs, self._forgotten_ns = [self._runs[-1]._replace(since_ns=0)], 0

    def _insert(self, run: Run) -> None:
        run = run._replace(since_ns=max(run.since_ns, 0))
        self._runs = sorted([other for other in self._runs if other.since_ns != run.since_ns] + [run])


class ForceClock:
    """Detect that force and contact states are stamped by different clocks.

    Both are stamped in ROS time and arrive soon after, so the difference of their lags (arrival - stamp) is bounded.
    Without arrival times, different clocks only show if the stamps do not overlap at all.
    """

    def __init__(self, settings: ValidatorSettings) -> None:
        self._tolerance_ns = settings.clock_tolerance * NANOSECONDS
        self._delay_ns = settings.impact_delay * NANOSECONDS
        self.clear()

    def clear(self) -> None:
        """Drop all lags."""
        self._block_lags: deque[float] = deque(maxlen=MAX_LAGS)
        self._impact_lags: deque[float] = deque(maxlen=MAX_LAGS)
        self._impact_stamps: list[int] = []  # first and last one

    def add_block(self, block: ForceBlock, received_ns: int) -> None:
        """Add the lag of a force block, counted from its last sample."""
        if received_ns and block.sample_rate > 0.0:
            self._block_lags.append(received_ns - block.stamp_ns - block.force.size / block.sample_rate * NANOSECONDS)

    def add_impact(self, impact: Impact, received_ns: int) -> None:
        """Add the lag of an impact, which may arrive up to `settings.impact_delay` after `Impact.reported_ns`."""
        stamps = [*self._impact_stamps, impact.stamp_ns]
        self._impact_stamps = [min(stamps), max(stamps)]
        if received_ns:
            self._impact_lags.append(received_ns - impact.reported_ns)

    def problem(self, states: StateHistory) -> str:
        """Return the problem with the clocks in one sentence; empty if there is none."""
        lag = states.lag_ns
        if lag is not None and (self._block_lags or self._impact_lags):
            # Blocks are preferred: impacts arrive with an unknown delay.
            offset = median(self._block_lags or self._impact_lags) - lag
            max_delay_ns = self._tolerance_ns if self._block_lags else self._delay_ns
            if not -self._tolerance_ns <= offset <= max_delay_ns:
                return f"force and contact states are {abs(offset) / NANOSECONDS:.2f} s apart: {APART}"
        if self._impact_stamps and len(states):
            first_ns, last_ns = self._impact_stamps
            gap = max(states.first_ns - last_ns, first_ns - states.last_ns)
            if gap > self._tolerance_ns + self._delay_ns:
                return (
                    f"impacts and contact states are at least {gap / NANOSECONDS:.2f} s apart: "
                    "their clocks differ, or they were not recorded together"
                )
        return ""


class MatchedImpact(NamedTuple):
    """An impact, the robot state along the normal of the plate at its onset, and its run."""

    impact: Impact
    state: OnsetState
    run: Run
    kink: Kink | None = None

    @property
    def force_share(self) -> float:
        """See `Run.force_share`."""
        return self.run.force_share

    @property
    def obstacle_mass(self) -> float:
        """Mass of the obstacle along the normal [kg]; on an oblique guide, it is larger."""
        return self.run.obstacle_mass / self.force_share**2

    @property
    def impulse(self) -> float:
        """Impulse along the normal up to the peak [N s], 0 if unknown."""
        return self.impact.compression_impulse / self.force_share

    @property
    def measured_mass(self) -> float:
        """Effective mass of the robot from impulse and speed [kg]; 0: unknown, infinite: too large to be measured."""
        if not self.impulse > 0.0:
            return 0.0
        mobility = self.state.speed / self.impulse - 1.0 / self.obstacle_mass
        return 1.0 / mobility if mobility > 0.0 else math.inf

    def has_mass(self, model: str) -> bool:
        """Return whether `model` has an effective mass at the onset."""
        return MIN_EFFECTIVE_MASS <= self.state.masses[model] < math.inf

    def reduced_mass(self, model: str) -> float:
        """Return (1 / m_n + 1 / m_H)^-1 [kg] along the normal."""
        return reduced_mass(self.state.masses[model], self.obstacle_mass)


class ImpactMatcher:
    """Match each impact with the robot state at its onset, or record why this is impossible.

    Every impact is either matched, or in `refused`, or in `waiting`.
    """

    def __init__(self, settings: ValidatorSettings) -> None:
        self._settings = settings
        self._max_wait_ns = round(settings.clock_tolerance * NANOSECONDS)
        self._max_delay_ns = round(settings.impact_delay * NANOSECONDS)
        self.states = StateHistory(settings)
        self.clock = ForceClock(settings)
        self.runs = RunHistory(settings.obstacle_mass, settings.configuration, settings.normal)
        self.reset()

    def reset(self) -> None:
        """Begin a new series; contact states and runs are kept."""
        self.waiting: deque[tuple[Impact, int]] = deque()  # impacts and their times of arrival
        self.clock.clear()
        self.states.late = 0
        self.seen = 0
        self._known: set[tuple[int, str, str]] = set()
        self._primary_peaks: dict[tuple[str, str], float] = {}
        self.refused: list[RefusedImpact] = []

    def begin_recording(self) -> None:
        """Discard everything that depends on the stamps of the previous recording."""
        self.states.clear()
        self.clock.clear()
        self._known.clear()
        self._primary_peaks.clear()
        self.runs.restart()

    def add_impact(self, impact: Impact, received_ns: int) -> None:
        """Queue an impact that arrived at `received_ns` (0: unknown)."""
        self.seen += 1
        if not _invalid_reason(impact):
            self.clock.add_impact(impact, received_ns)
        self.waiting.append((impact, received_ns))

    def refuse(self, impact: Impact, rejection: Rejection, speed: float = 0.0, *, excluded: bool = False) -> None:
        """Record an impact that is left out of the series, and its `speed` [m/s] if it is known."""
        self.refused.append(
            RefusedImpact(
                stamp_ns=impact.stamp_ns,
                peak_force=impact.peak_force,
                excluded=excluded,
                reason=rejection.reason,
                detail=rejection.detail,
                held_force=impact.held_force and impact.held_force + impact.load_force,
                speed=speed,
                simulated=impact.simulated,
                load_force=impact.load_force,
                force_share=self.runs.at(impact.stamp_ns).usable_share,
            )
        )

    def matches(self, *, flush: bool) -> Iterator[MatchedImpact]:
        """Yield in order the impacts that can be matched now. `flush`: no more states will arrive."""
        while self.waiting and (flush or self._ready(*self.waiting[0])):
            impact, received_ns = self.waiting.popleft()
            reason, run = _invalid_reason(impact), self.runs.at(impact.stamp_ns)
            key = impact.stamp_ns, impact.frame_id, impact.source
            if impact.stamp_ns > 0 and key in self._known:
                self.refuse(impact._replace(held_force=0.0), Rejection(DUPLICATE), excluded=True)
                continue
            self._known.add(key)
            if not impact.rebound:
                self._primary_peaks[key[1:]] = impact.peak_force
            elif reason == REBOUND and not impact.peak_force <= self._primary_peaks.get(key[1:], 0.0):
                reason = LARGER_REBOUND
            if reason:
                state = self._onset_state(impact, received_ns, run.normal) if reason == PRESS else Rejection("")
                speed = 0.0 if isinstance(state, Rejection) else state.speed
                self.refuse(impact, Rejection(reason), speed, excluded=True)
                continue
            if self._settings.obstacle_fixed:
                run = run._replace(obstacle_mass=math.inf)
            state = self._onset_state(impact, received_ns, run.normal)
            kink = self.states.kink(impact.stamp_ns, impact.duration, self._deadline_ns(received_ns))
            if not run.force_share >= MIN_NORMAL_COMPONENT:  # normal and guide can come from different sources
                self.refuse(impact, Rejection("the guide lies in the plate", "check plate_normal and guide_direction"))
            elif isinstance(state, Rejection):
                self.refuse(impact, state.with_clock(kink))
            elif not run.obstacle_mass:
                self.refuse(impact, Rejection("obstacle_mass is not given", "set it to the mass of the obstacle [kg]"))
            else:
                yield MatchedImpact(impact, state, run, kink)

    def _ready(self, impact: Impact, received_ns: int) -> bool:
        """Return whether all relevant states have arrived, judged by their stamps, or the maximum wait is over."""
        if _invalid_reason(impact):
            return True
        covered_ns = max(self._uncertainty_ns(impact), round(WINDOW * NANOSECONDS))
        if self.states.last_ns >= impact.stamp_ns + covered_ns:
            return True
        return received_ns > 0 and self.states.last_arrival_ns > received_ns + self._max_wait_ns

    def _deadline_ns(self, received_ns: int) -> int:
        """Return the latest arrival time of states that count for an impact; 0: all states count."""
        return received_ns + self._max_wait_ns if received_ns and self.states.last_arrival_ns else 0

    def _onset_state(self, impact: Impact, received_ns: int, normal: Vector3 | None) -> OnsetState | Rejection:
        onset_ns, deadline_ns = impact.stamp_ns, self._deadline_ns(received_ns)
        lag_ns = self.states.lag_at(onset_ns, deadline_ns)
        if lag_ns is None:
            return Rejection("no contact state")
        offset_ns = received_ns - impact.reported_ns - lag_ns
        if deadline_ns and not -self._max_wait_ns <= offset_ns <= self._max_delay_ns:
            reason = f"force and contact states are seconds apart: {APART}"
            return Rejection(reason, f"by {abs(offset_ns) / NANOSECONDS:.2f} s")
        state = self.states.at(onset_ns, self._uncertainty_ns(impact), deadline_ns, normal)
        if normal is None or isinstance(state, Rejection):
            return state
        along = state.along(normal)
        if not along.speed >= MIN_NORMAL_COMPONENT * state.speed:
            return Rejection("the robot moves along the plate, not against it", "check plate_normal")
        return along

    def _uncertainty_ns(self, impact: Impact) -> int:
        return round((self._settings.clock_uncertainty + abs(impact.clock_residual)) * NANOSECONDS)


def _unit(vector: Vector3) -> Vector3 | None:
    """Return the unit vector along a finite `vector`, None for zero."""
    length = math.hypot(*vector)
    return (vector[0] / length, vector[1] / length, vector[2] / length) if length > 0.0 else None


def _invalid_reason(impact: Impact) -> str:
    """Return why `impact` is not a valid measurement of a collision; empty if it is."""
    has_stamp = impact.stamp_ns > 0 and abs(impact.clock_residual) <= MAX_CLOCK_RESIDUAL_S
    reasons = {
        CLIPPED: impact.clipped,
        INCOMPLETE: impact.incomplete,
        REBOUND: impact.rebound > 0,
        PRESS: impact.is_press,
        "no positive peak force": not MIN_PEAK_FORCE <= impact.peak_force < math.inf,
        "no usable stamp": not has_stamp,
    }
    return next((reason for reason, applies in reasons.items() if applies), "")

"""Impacts and the robot's state at their onset.

Impacts are decided in the order in which they come, each as soon as the states around its onset are there. What is
decided depends on the stamps and arrival times of both streams alone, not on which of them came first.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from typing import TYPE_CHECKING, NamedTuple

from scara_effmass.errors import SettingsError
from scara_effmass.impacts.clocks import ForceClock
from scara_effmass.impacts.robot_track import NANOSECONDS, RobotTrack, Unusable
from scara_effmass.impacts.run_info import check_obstacle_mass, check_run_info
from scara_effmass.values import RefusedImpact

if TYPE_CHECKING:
    from collections.abc import Iterator

    from scara_effmass.impacts.robot_track import OnsetState
    from scara_effmass.settings import ValidatorSettings
    from scara_effmass.values import Impact, RunInfo

APART = "force and contact states are seconds apart: their clocks differ"
NO_OBSTACLE = "obstacle_mass is not given"


class Run(NamedTuple):
    """What held from `since_ns` on: mass of the obstacle [kg], 0 where it is not known; name of the configuration."""

    since_ns: int
    obstacle_mass: float
    configuration: str


class Runs:
    """The runs of a series: what is hit, and in which configuration of the robot."""

    def __init__(self, obstacle_mass: float, configuration: str) -> None:
        self._runs = [Run(0, obstacle_mass, configuration)]
        self._setting = self._runs[0]

    def set(self, since_ns: int, obstacle_mass: float | None, configuration: str | None) -> None:
        """Begin a run by a setting; None: as before. Raises SettingsError."""
        if obstacle_mass is not None:
            check_obstacle_mass(obstacle_mass)
        self._setting = _changed(self._setting, obstacle_mass, configuration)
        self._begin(_changed(self.at(since_ns), obstacle_mass, configuration)._replace(since_ns=since_ns))

    def begin(self, info: RunInfo, received_ns: int) -> None:
        """Begin the run that `info`, received then, states; for what it does not state, the settings hold.

        Raises SettingsError for a value that cannot be used: then the obstacle mass is not known from then on.
        """
        try:
            check_run_info(info)
        except SettingsError:
            self.forget_obstacle(received_ns)
            raise
        mass = info.obstacle_mass or self._setting.obstacle_mass
        self._begin(Run(info.stamp_ns or received_ns, mass, info.configuration or self._setting.configuration))

    def forget_obstacle(self, since_ns: int) -> None:
        """Begin a run whose obstacle mass is not known."""
        self._begin(self.at(since_ns)._replace(since_ns=since_ns, obstacle_mass=0.0))

    def _begin(self, run: Run) -> None:
        run = run._replace(since_ns=max(run.since_ns, 0))
        self._runs = sorted([other for other in self._runs if other.since_ns != run.since_ns] + [run])

    def at(self, onset_ns: int) -> Run:
        """Return the run at that time."""
        i = bisect_right([run.since_ns for run in self._runs], onset_ns)
        return self._runs[max(i - 1, 0)]

    @property
    def latest(self) -> Run:
        """The run that began last."""
        return self._runs[-1]

    def forget(self) -> None:
        """Let the latest run hold from the beginning of time on: the clock begins anew."""
        self._runs = [self._runs[-1]._replace(since_ns=0)]


def _changed(run: Run, obstacle_mass: float | None, configuration: str | None) -> Run:
    if obstacle_mass is not None:
        run = run._replace(obstacle_mass=float(obstacle_mass))
    return run if configuration is None else run._replace(configuration=configuration)


class Paired(NamedTuple):
    """An impact, the robot at its onset, and the run it belongs to."""

    impact: Impact
    state: OnsetState
    run: Run


class Pairing:
    """Brings impacts and states together. Every impact seen is paired, refused for a reason, or still waiting."""

    def __init__(self, settings: ValidatorSettings) -> None:
        self._settings = settings
        self._patience_ns = round(settings.clock_tolerance * NANOSECONDS)
        self.track = RobotTrack(settings)
        self.clock = ForceClock(settings)
        self.runs = Runs(settings.obstacle_mass, settings.configuration)
        self.reset()

    def reset(self) -> None:
        """Begin a new series; what is known of the robot's motion and the run stays."""
        self._waiting: deque[tuple[Impact, int]] = deque()
        self.clock.forget()
        self.track.late = 0
        self.seen = 0
        self.refused: list[RefusedImpact] = []

    def forget(self) -> None:
        """Begin a new recording: its stamps have nothing to do with earlier ones."""
        self.track.forget()
        self.clock.forget()
        self.runs.forget()

    @property
    def waiting(self) -> int:
        """Number of impacts that wait for a state after their onset, or for an impact that does."""
        return len(self._waiting)

    def add_impact(self, impact: Impact, received_ns: int) -> None:
        """Take an impact that arrived at `received_ns` (0: not known)."""
        self.seen += 1
        if not _spoilt(impact):
            self.clock.add_impact(impact, received_ns)
        self._waiting.append((impact, received_ns))

    def refuse(self, impact: Impact, why: Unusable, *, excluded: bool = False) -> None:
        """Count an impact that is not in the series."""
        self.refused.append(RefusedImpact(impact.stamp_ns, impact.peak_force, excluded, why.reason, why.detail))

    def decided(self, *, all_of_them: bool = False) -> Iterator[Paired]:
        """Yield the impacts that can now be paired, deciding one after the other.

        `all_of_them`: no more states will come.
        """
        while self._waiting and (all_of_them or self._ready(*self._waiting[0])):
            impact, received_ns = self._waiting.popleft()
            if reason := _spoilt(impact):
                self.refuse(impact, Unusable(reason), excluded=True)
                continue
            run = self.runs.at(impact.stamp_ns)
            state = self._state(impact, received_ns)
            if isinstance(state, Unusable):
                self.refuse(impact, state)
            elif not run.obstacle_mass:
                self.refuse(impact, Unusable(NO_OBSTACLE, "set it to the mass of what is hit [kg]"))
            else:
                yield Paired(impact, state, run)

    def _ready(self, impact: Impact, received_ns: int) -> bool:
        """Return whether all states that matter are here: by their stamps, or by the time it has taken."""
        if _spoilt(impact) or self.track.last_ns >= impact.stamp_ns + self._uncertainty_ns(impact):
            return True
        return received_ns > 0 and self.track.heard_ns > received_ns + self._patience_ns

    def _state(self, impact: Impact, received_ns: int) -> OnsetState | Unusable:
        onset_ns = impact.stamp_ns
        by_ns = received_ns + self._patience_ns if received_ns and self.track.heard_ns else 0
        lag_ns = self.track.lag_at(onset_ns, by_ns)
        if lag_ns is None:
            return Unusable("no contact state")
        if apart_ns := self.clock.apart_ns(impact, received_ns, lag_ns if by_ns else None):
            return Unusable(APART, f"by {abs(apart_ns) / NANOSECONDS:.2f} s")
        return self.track.at(onset_ns, self._uncertainty_ns(impact), by_ns)

    def _uncertainty_ns(self, impact: Impact) -> int:
        return round((self._settings.clock_uncertainty + abs(impact.clock_residual)) * NANOSECONDS)


def _spoilt(impact: Impact) -> str:
    """Return why `impact` is no measurement of a collision; empty when it is one."""
    if impact.clipped:
        return "clipped: the force reached the end of the measuring range"
    if impact.incomplete:
        return "incomplete: samples were lost during it"
    if impact.rebound > 0:
        return "rebound of an earlier impact"
    if not 0.0 < impact.peak_force < math.inf:
        return "no positive peak force"
    if impact.stamp_ns <= 0 or not math.isfinite(impact.clock_residual):
        return "no usable stamp"
    return ""

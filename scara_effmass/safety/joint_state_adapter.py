# SPDX-License-Identifier: Apache-2.0
"""Turn joint states as published or recorded into those that the validator expects."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from difflib import SequenceMatcher

import numpy as np

from scara_effmass.errors import SettingsError
from scara_effmass.settings import MonitorSettings, VelocitySource
from scara_effmass.settings.loading import nearest
from scara_effmass.values import FloatArray, JointState

MIN_SIMILARITY = 0.3
"""Smallest ratio of difflib at which two names count as similar."""
MAX_NAMES = 64
"""Number of names up to which similar ones are searched."""
_NO_VELOCITY = np.empty(0)


class JointStateAdapter:
    """Renames joints, names joint states without names, and filters the velocity or computes it from positions.

    Over `velocity_window`, the velocity is the mean of the reported ones, or the slope of the least-squares line
    through the positions (without a window: through the last two). Both lag by `delay_s`, the mean age of the samples,
    and may be off by `velocity_change`.
    """

    def __init__(self, joints: tuple[str, ...], settings: MonitorSettings) -> None:
        """Expect the `joints` of a robot. Raises SettingsError for a `joint_map` or `joint_names` that miss them."""
        self._joints = joints
        self._map, self._joint_names = settings.joint_renames, settings.joint_names
        self._samples: deque[tuple[int, FloatArray]] = deque()
        self._sampled_names: tuple[str, ...] = ()
        self._order: list[int] = []
        self._reported_names: tuple[str, ...] | None = None
        self._names: tuple[str, ...] | str = ()
        self.delay_s = 0.0
        self.velocity_change: list[float] = []
        """Change of the velocity (n,) within the delay, in the order of the robot's joints [rad/s or m/s]."""
        for entry, (_, name) in zip(settings.joint_map, self._map, strict=True):
            if "\\" not in name and name not in self._joints:
                raise SettingsError(f"joint_map = {entry!r}: {name}: {nearest(name, joints)}")
        if self._joint_names:
            names = self.names_of(())
            missing = ", ".join(joint for joint in joints if joint not in names)
            if isinstance(names, str) or missing:
                problem = names if isinstance(names, str) else f"must hold {missing}"
                raise SettingsError(f"joint_names = {', '.join(self._joint_names)}: {problem}")
        self.apply(settings)

    def apply(self, settings: MonitorSettings) -> None:
        """Apply a changed velocity source, window or timeout."""
        self._from_positions = settings.velocity_source is VelocitySource.FROM_POSITIONS
        self._window_ns = round(settings.velocity_window * 1e9)
        self._timeout_ns = round(settings.timeout * 1e9)
        self._filters = settings.filters_velocity
        self.is_needed = self._filters or bool(self._map or self._joint_names)
        self.reset()

    def reset(self) -> None:
        """Discard the samples behind the velocity."""
        self._samples.clear()
        self.delay_s = 0.0
        self.velocity_change = [0.0] * len(self._joints)

    def names_of(self, reported: tuple[str, ...]) -> tuple[str, ...] | str:
        """Return the robot's names for the `reported` ones, or why these are ambiguous."""
        if reported is not self._reported_names:
            self._reported_names, self._names = reported, self._renamed(reported or self._joint_names)
        return self._names

    def positions(self, state: JointState) -> FloatArray | str:
        """Return the positions (n,) of the robot's joints in `state` [rad, m], or why there are none."""
        names = self.names_of(state.names)
        missing = [joint for joint in self._joints if joint not in names]
        if isinstance(names, str) or missing:
            return names if isinstance(names, str) else f"joint {missing[0]} is missing"
        if len(state.position) != len(names):
            return f"{len(state.position)} positions for {len(names)} names"
        q = state.position[[names.index(joint) for joint in self._joints]]
        return q if np.isfinite(q).all() else "a position is not finite"

    def adapt(self, state: JointState) -> JointState | str:
        """Return `state` with the robot's names and the velocity of the settings, or why its names are ambiguous.

        A velocity from positions is empty while there are too few positions.
        """
        names = self.names_of(state.names)
        if isinstance(names, str):
            return names
        is_whole = len(state.position) == len(names) and len(state.velocity) in {0, len(names)}
        if not self._filters or not is_whole or not set(names).issuperset(self._joints):
            return state._replace(names=names)
        samples, stamp_ns = self._samples, state.stamp_ns
        values = state.position if self._from_positions else state.velocity
        if samples and not (
            0 < stamp_ns - samples[-1][0] <= self._timeout_ns
            and values.size == samples[-1][1].size
            and names == self._sampled_names
        ):
            self.reset()
        if names != self._sampled_names:
            self._sampled_names, self._order = names, [names.index(joint) for joint in self._joints]
        samples.append((stamp_ns, values))
        while len(samples) > 1 + self._from_positions and stamp_ns - samples[0][0] > self._window_ns:
            samples.popleft()
        times = np.array([sample_ns - stamp_ns for sample_ns, _ in samples]) / 1e9
        self.delay_s = -float(times.mean())
        if len(samples) < 2 or not values.size:
            self.velocity_change = [0.0] * len(self._joints)
            return JointState(stamp_ns, names, state.position, _NO_VELOCITY if self._from_positions else state.velocity)
        stacked = np.array([sample for _, sample in samples])
        with np.errstate(over="ignore", invalid="ignore"):  # the validator refuses numbers that are not finite
            if self._from_positions:
                # At constant acceleration, the slope over the newer half lags half as much.
                half = min(len(samples) // 2, len(samples) - 2)
                velocity = _slope(times, stacked)
                change = 2.0 * (_slope(times[half:], stacked[half:]) - velocity)
            else:
                velocity = stacked.mean(axis=0)
                change = stacked[-1] - velocity
        self.velocity_change = np.abs(change[self._order]).tolist()
        return JointState(stamp_ns, names, state.position, velocity)

    def _renamed(self, names: Sequence[str]) -> tuple[str, ...] | str:
        renamed = []
        for name in names:
            matches = [(match, new) for pattern, new in self._map if (match := pattern.fullmatch(name))]
            choices = sorted({match.expand(new) for match, new in matches} or {name})
            if len(choices) > 1:
                return f"joint_map gives joint {name} several names: {', '.join(choices)}"
            renamed += choices
        return tuple(renamed)


def _slope(times: FloatArray, values: FloatArray) -> FloatArray:
    """Return the slope (n,) of the least-squares line through `values` (m, n) at `times` (m,)."""
    centred = times - times.mean()
    # Values that rest have the slope 0 exactly, however the processor rounds the sum.
    return np.asarray(centred @ (values - values[-1]) / (centred @ centred))


def suggested_map(reported: Sequence[str], joints: Sequence[str]) -> str:
    """Return "; try joint_map a=b,..." from the most similar names; empty unless each joint has one of its own."""
    if not reported or len(reported) > MAX_NAMES:
        return ""
    pairs: dict[str, str] = {}
    for joint in joints:
        ranked = sorted(((SequenceMatcher(None, name, joint).ratio(), name) for name in reported), reverse=True)
        (ratio, best), (second, _) = (*ranked, (0.0, ""))[:2]
        if ratio < MIN_SIMILARITY or ratio == second or best in pairs:
            return ""
        pairs[best] = joint
    return f"; try joint_map {','.join(f'{name}={joint}' for name, joint in pairs.items() if name != joint)}"

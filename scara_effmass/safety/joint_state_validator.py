"""What a joint state must be before anything is computed from it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from scara_effmass.model.robot import Robot
    from scara_effmass.settings import MonitorSettings
    from scara_effmass.values import FloatArray, JointState

IndexArray = NDArray[np.intp]

NANOSECONDS = 1_000_000_000
CONFIRMATION_NS = NANOSECONDS // 10
"""How long a joint must be seen to stand still before a velocity of exactly zero is believed of it."""
WINDOW_NS = NANOSECONDS // 2
"""After this time the travel of a joint, and what its velocity accounts for, are counted anew."""
FASTEST_JOINT = (60.0, 10.0)
"""Largest believable speed [rad/s, m/s] of a joint whose description gives none."""


class Motion(NamedTuple):
    """A joint state that passed: positions and velocities (n,) in the model's joint order [rad, m]."""

    q: FloatArray
    qd: FloatArray


class OtherDevice(NamedTuple):
    """A joint state that names none of the robot's joints: another device on the same topic."""


class _Window:
    """Since when and from where a joint's travel is counted, and how far its velocity accounts for."""

    __slots__ = ("accounted", "first", "since_ns", "speed")

    def __init__(self, since_ns: int, first: float, speed: float) -> None:
        self.since_ns = since_ns
        self.first = first
        self.accounted = 0.0
        self.speed = speed


class JointStateValidator:
    """Checks joint states against the robot, the clock and one another.

    Everything it remembers is keyed to header stamps, so the same messages give the same answers live and offline.
    """

    def __init__(self, robot: Robot) -> None:
        """Expect the joints of `robot`; `apply` must follow."""
        self._robot = robot
        self._joints = robot.joint_names
        self._units = ["rad" if turns else "m" for turns in robot.revolute]
        self._names: tuple[str, ...] | None = None
        self._layout: IndexArray | str | OtherDevice | None = None
        self.forget()

    def apply(self, settings: MonitorSettings) -> None:
        """Take over changed settings."""
        robot = self._robot
        slack = settings.joint_limit_tolerance
        self._lower = (robot.model.lowerPositionLimit - slack).tolist()
        self._upper = (robot.model.upperPositionLimit + slack).tolist()
        fastest = [
            speed if 0.0 < speed < math.inf else FASTEST_JOINT[0 if turns else 1]
            for speed, turns in zip(robot.model.velocityLimit.tolist(), robot.revolute, strict=True)
        ]
        self._fastest = [speed * (1.0 + settings.joint_speed_tolerance) for speed in fastest]
        self.timeout_ns = round(settings.timeout * NANOSECONDS)
        self.future_ns = round(settings.future_tolerance * NANOSECONDS)
        self._differentiate = settings.differentiate_velocity
        self._still_travel = settings.still_tolerance
        self._still_speed = settings.still_speed
        self._travel_margin = settings.travel_margin
        self._travel_factor = 1.0 + settings.travel_tolerance

    def forget(self) -> None:
        """Drop all that was remembered of earlier joint states, as after a jump of the clock."""
        self.last_stamp_ns = 0
        self._last_q: FloatArray | None = None
        self._believed = [False] * len(self._joints)
        self._windows: list[_Window | None] = [None] * len(self._joints)

    def check(self, state: JointState, now_ns: int) -> Motion | OtherDevice | str:
        """Return the motion in `state`, or why it cannot be used; `now_ns` is the node's clock."""
        if state.names is not self._names:
            self._layout = self._laid_out(state.names)
            self._names = state.names
        layout = self._layout
        if isinstance(layout, (str, OtherDevice)):
            return layout
        return self._wrong_length(state) or self._wrong_stamp(state.stamp_ns, now_ns) or self._motion(state, layout)

    def _laid_out(self, names: tuple[str, ...]) -> IndexArray | str | OtherDevice | None:
        """Return the indices of the robot's joints in `names`; None where they are its first ones, in order."""
        if not names:
            return "the joint state has no names"
        if "" in names:
            return f"name {names.index('')} of the joint state is empty"
        if len(set(names)) != len(names):
            twice = next(name for name in names if names.count(name) > 1)
            return f"joint {twice} is named twice"
        missing = [name for name in self._joints if name not in names]
        if len(missing) == len(self._joints):
            return OtherDevice()
        if missing:
            return f"joint {missing[0]} is missing"
        indices = [names.index(name) for name in self._joints]
        return None if indices == list(range(len(names))) else np.array(indices)

    def _wrong_length(self, state: JointState) -> str:
        n = len(state.names)
        if len(state.position) != n:
            return f"{len(state.position)} positions for {n} names"
        if len(state.velocity) == n:
            return ""
        if len(state.velocity):
            return f"{len(state.velocity)} velocities for {n} names"
        return "" if self._differentiate else "the velocity is empty"

    def _wrong_stamp(self, stamp_ns: int, now_ns: int) -> str:
        last = self.last_stamp_ns
        if last < stamp_ns <= now_ns + self.future_ns and now_ns - stamp_ns <= self.timeout_ns and stamp_ns > 0:
            return ""
        if stamp_ns <= 0:
            return "the header stamp is zero"
        if stamp_ns > now_ns + self.future_ns:
            return f"the header stamp is {(stamp_ns - now_ns) / 1e9:.3f} s in the future"
        if now_ns - stamp_ns > self.timeout_ns:
            return f"the joint state is {(now_ns - stamp_ns) / 1e9:.3f} s old"
        if stamp_ns == last:
            return "the header stamp is repeated"
        return f"the header stamp goes back by {(last - stamp_ns) / 1e9:.6f} s"

    def _motion(self, state: JointState, layout: IndexArray | None) -> Motion | str:
        q, qd = state.position, state.velocity
        if layout is not None:
            q = q[layout]
            qd = qd[layout] if len(qd) else qd
        stamp_ns = state.stamp_ns
        elapsed_ns = stamp_ns - self.last_stamp_ns if self.last_stamp_ns else 0
        last_q, self._last_q, self.last_stamp_ns = self._last_q, q, stamp_ns
        if not len(qd):
            if last_q is None or elapsed_ns > self.timeout_ns:
                return "the velocity is empty, and one joint state alone cannot be differentiated"
            qd = (q - last_q) / (elapsed_ns / 1e9)
        positions, velocities = q.tolist(), qd.tolist()
        for x, v, lower, upper, fastest in zip(
            positions, velocities, self._lower, self._upper, self._fastest, strict=True
        ):
            # Written so that NaN fails it.
            if not (lower <= x <= upper and -fastest <= v <= fastest):
                return self._out_of_range(positions, velocities)
        return self._contradiction(positions, velocities, stamp_ns, elapsed_ns) or Motion(q, qd)

    def _out_of_range(self, positions: list[float], velocities: list[float]) -> str:
        for i, (name, x, v, unit) in enumerate(zip(self._joints, positions, velocities, self._units, strict=True)):
            if not math.isfinite(x):
                return f"the position of {name} is {x}"
            if not math.isfinite(v):
                return f"the velocity of {name} is {v}"
            if not self._lower[i] <= x <= self._upper[i]:
                return f"{name} at {x:.4f} {unit} lies outside its limits {self._lower[i]:.4f} to {self._upper[i]:.4f}"
            if abs(v) > self._fastest[i]:
                return f"{name} at {v:.4f} {unit}/s is faster than it can be ({self._fastest[i]:.4f})"
        raise AssertionError("unreachable: one joint failed the same comparisons before")

    def _contradiction(self, positions: list[float], velocities: list[float], stamp_ns: int, elapsed_ns: int) -> str:
        """Return why the velocities are not believed: a joint moves further than its velocity accounts for.

        Some senders never fill velocities in; two senders on one topic make the arm leap to and fro.
        """
        reason = ""
        seconds = elapsed_ns / 1e9
        believed = self._believed
        windows = self._windows
        gap = not 0 < elapsed_ns <= self.timeout_ns
        for i, (x, v) in enumerate(zip(positions, velocities, strict=True)):
            speed = v if v >= 0.0 else -v
            window = windows[i]
            if window is None or gap:
                windows[i] = window = _Window(stamp_ns, x, speed)
            else:
                before = window.speed
                window.accounted += max(before, speed) * seconds
                if speed > 0.0 and before > 0.0:
                    # The usual case first: it moves, as it did before, and no further than it should.
                    limit = window.accounted * self._travel_factor + self._travel_margin
                    if -limit <= x - window.first <= limit and stamp_ns - window.since_ns <= WINDOW_NS:
                        window.speed = speed
                        believed[i] = True
                        continue
            started_or_stopped = (speed > 0.0) is not (window.speed > 0.0)
            window.speed = speed
            accounted = window.accounted
            travel, time_ns = abs(x - window.first), stamp_ns - window.since_ns
            margin = self._travel_margin if accounted else max(self._still_travel, self._still_speed * time_ns / 1e9)
            if travel > accounted * self._travel_factor + margin:
                believed[i] = False
                windows[i] = _Window(stamp_ns, x, speed)
                how = (
                    f"where its velocity accounts for {accounted:.4f}" if accounted else "while its velocity read zero"
                )
                reason = f"{self._joints[i]} moved {travel:.4f} {self._units[i]} {how}"
                continue
            if speed > 0.0:
                believed[i] = True
            elif not believed[i]:
                believed[i] = time_ns >= CONFIRMATION_NS
                if not believed[i] and not reason:
                    reason = f"the velocity of {self._joints[i]} reads zero, not yet confirmed by its position"
            if started_or_stopped or (believed[i] and time_ns > WINDOW_NS):
                windows[i] = _Window(stamp_ns, x, speed)
        return reason

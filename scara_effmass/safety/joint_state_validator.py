"""Check joint states before anything is computed from them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scara_effmass.settings import MonitorSettings
from scara_effmass.values import FloatArray, JointState

if TYPE_CHECKING:
    from scara_effmass.model.robot import Robot

IndexArray = NDArray[np.intp]

NANOSECONDS = 1_000_000_000
CONFIRMATION_NS = NANOSECONDS // 10
"""Time for which a joint must keep its position before its velocity of exactly zero is accepted."""
WINDOW_NS = NANOSECONDS // 2
"""Time over which the travel of a joint is compared with the integral of its speed."""
DEFAULT_MAX_SPEED = (60.0, 10.0)
"""Maximum speed of a revolute [rad/s] and of a prismatic joint [m/s] whose description states none."""


class Motion(NamedTuple):
    """Positions and velocities (n,) of a valid joint state, in the model's joint order [rad, m]."""

    q: FloatArray
    qd: FloatArray


class OtherDevice(NamedTuple):
    """Result for a joint state that names none of the robot's joints: another device on the same topic."""


class _TravelWindow:
    """Start of a joint's travel window, the travel that its velocities explain, and its last speed."""

    __slots__ = ("explained_travel", "speed", "start_ns", "start_position")

    def __init__(self, start_ns: int, start_position: float, speed: float) -> None:
        self.start_ns = start_ns
        self.start_position = start_position
        self.explained_travel = 0.0
        self.speed = speed


class JointStateValidator:
    """Validates joint states against the robot, the clock and the joint states before them.

    All its state is keyed to header stamps, so the same messages give the same results live and offline.
    """

    def __init__(self, robot: Robot) -> None:
        """Expect the joints of `robot`. Call `apply` before `validate`."""
        self._robot = robot
        self._joints = robot.joint_names
        self._units = ["rad" if revolute else "m" for revolute in robot.revolute]
        self._names: tuple[str, ...] | None = None
        self._layout: IndexArray | str | OtherDevice | None = None
        self.reset()

    def apply(self, settings: MonitorSettings) -> None:
        """Apply changed settings from the next joint state on."""
        robot = self._robot
        tolerance = settings.joint_limit_tolerance
        self._lower = (robot.model.lowerPositionLimit - tolerance).tolist()
        self._upper = (robot.model.upperPositionLimit + tolerance).tolist()
        max_speeds = [
            speed if 0.0 < speed < math.inf else DEFAULT_MAX_SPEED[0 if revolute else 1]
            for speed, revolute in zip(robot.model.velocityLimit.tolist(), robot.revolute, strict=True)
        ]
        self._max_speeds = [speed * (1.0 + settings.joint_speed_tolerance) for speed in max_speeds]
        self.timeout_ns = round(settings.timeout * NANOSECONDS)
        self.future_tolerance_ns = round(settings.future_tolerance * NANOSECONDS)
        self._differentiate = settings.differentiate_velocity
        self._still_travel = settings.still_tolerance
        self._still_speed = settings.still_speed
        self._travel_margin = settings.travel_margin
        self._travel_factor = 1.0 + settings.travel_tolerance

    def reset(self) -> None:
        """Discard the history of joint states, as after a jump of the clock."""
        self.last_stamp_ns = 0
        self._last_q: FloatArray | None = None
        self._confirmed = [False] * len(self._joints)
        self._windows: list[_TravelWindow | None] = [None] * len(self._joints)

    def validate(self, state: JointState, now_ns: int) -> Motion | OtherDevice | str:
        """Return the motion in `state`, or the reason why it is invalid; `now_ns` is the node's clock."""
        if state.names is not self._names:
            self._layout = self._joint_indices(state.names)
            self._names = state.names
        layout = self._layout
        if isinstance(layout, (str, OtherDevice)):
            return layout
        return self._length_error(state) or self._stamp_error(state.stamp_ns, now_ns) or self._motion(state, layout)

    def _joint_indices(self, names: tuple[str, ...]) -> IndexArray | str | OtherDevice | None:
        """Return the indices of the robot's joints in `names`; None if `names` are exactly these, in order."""
        if not names:
            return "the joint state has no names"
        if "" in names:
            return f"name {names.index('')} of the joint state is empty"
        if len(set(names)) != len(names):
            duplicate = next(name for name in names if names.count(name) > 1)
            return f"joint {duplicate} is named twice"
        missing = [name for name in self._joints if name not in names]
        if len(missing) == len(self._joints):
            return OtherDevice()
        if missing:
            return f"joint {missing[0]} is missing"
        indices = [names.index(name) for name in self._joints]
        return None if indices == list(range(len(names))) else np.array(indices)

    def _length_error(self, state: JointState) -> str:
        n = len(state.names)
        if len(state.position) != n:
            return f"{len(state.position)} positions for {n} names"
        if len(state.velocity) == n:
            return ""
        if len(state.velocity):
            return f"{len(state.velocity)} velocities for {n} names"
        return "" if self._differentiate else "the velocity is empty"

    def _stamp_error(self, stamp_ns: int, now_ns: int) -> str:
        last_ns, latest_ns = self.last_stamp_ns, now_ns + self.future_tolerance_ns
        if last_ns < stamp_ns <= latest_ns and now_ns - stamp_ns <= self.timeout_ns:
            return ""
        if stamp_ns <= 0:
            return "the header stamp is zero"
        if stamp_ns > latest_ns:
            return f"the header stamp is {(stamp_ns - now_ns) / 1e9:.3f} s in the future"
        if now_ns - stamp_ns > self.timeout_ns:
            return f"the joint state is {(now_ns - stamp_ns) / 1e9:.3f} s old"
        if stamp_ns == last_ns:
            return "the header stamp is repeated"
        return f"the header stamp goes back by {(last_ns - stamp_ns) / 1e9:.6f} s"

    def _motion(self, state: JointState, layout: IndexArray | None) -> Motion | str:
        """Return the motion in `state` if its values are within limits and consistent, else the reason."""
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
        for x, v, lower, upper, max_speed in zip(
            positions, velocities, self._lower, self._upper, self._max_speeds, strict=True
        ):
            # A comparison with NaN is false, so this form also catches NaN.
            if not (lower <= x <= upper and -max_speed <= v <= max_speed):
                return self._range_error(positions, velocities)
        return self._velocity_mismatch(positions, velocities, stamp_ns, elapsed_ns) or Motion(q, qd)

    def _range_error(self, positions: list[float], velocities: list[float]) -> str:
        for i, (name, x, v, unit) in enumerate(zip(self._joints, positions, velocities, self._units, strict=True)):
            if not math.isfinite(x):
                return f"the position of {name} is {x}"
            if not math.isfinite(v):
                return f"the velocity of {name} is {v}"
            if not self._lower[i] <= x <= self._upper[i]:
                return f"{name} at {x:.4f} {unit} lies outside its limits {self._lower[i]:.4f} to {self._upper[i]:.4f}"
            if abs(v) > self._max_speeds[i]:
                return f"{name} at {v:.4f} {unit}/s exceeds its maximum speed of {self._max_speeds[i]:.4f} {unit}/s"
        raise AssertionError("unreachable: the caller found a value out of range")

    def _velocity_mismatch(
        self, positions: list[float], velocities: list[float], stamp_ns: int, elapsed_ns: int
    ) -> str:
        """Return why the velocities contradict the positions, or an empty string.

        A joint that travels further than its velocities explain has velocities that are never filled in, or
        two publishers at different poses.
        """
        reason = ""
        seconds = elapsed_ns / 1e9
        confirmed = self._confirmed
        windows = self._windows
        gap = not 0 < elapsed_ns <= self.timeout_ns
        for i, (x, v) in enumerate(zip(positions, velocities, strict=True)):
            speed = v if v >= 0.0 else -v
            window = windows[i]
            if window is None or gap:
                windows[i] = window = _TravelWindow(stamp_ns, x, speed)
            else:
                last_speed = window.speed
                window.explained_travel += max(last_speed, speed) * seconds
                if speed > 0.0 and last_speed > 0.0:
                    # Fast path: the joint keeps moving, no further than its velocities explain.
                    limit = window.explained_travel * self._travel_factor + self._travel_margin
                    if -limit <= x - window.start_position <= limit and stamp_ns - window.start_ns <= WINDOW_NS:
                        window.speed = speed
                        confirmed[i] = True
                        continue
            started_or_stopped = (speed > 0.0) is not (window.speed > 0.0)
            window.speed = speed
            explained = window.explained_travel
            travel, duration_ns = abs(x - window.start_position), stamp_ns - window.start_ns
            still_travel = max(self._still_travel, self._still_speed * duration_ns / 1e9)
            if travel > explained * self._travel_factor + (self._travel_margin if explained else still_travel):
                confirmed[i] = False
                windows[i] = _TravelWindow(stamp_ns, x, speed)
                how = (
                    f"where its velocity accounts for {explained:.4f}" if explained else "while its velocity read zero"
                )
                reason = f"{self._joints[i]} moved {travel:.4f} {self._units[i]} {how}"
                continue
            if speed > 0.0:
                confirmed[i] = True
            elif not confirmed[i]:
                confirmed[i] = duration_ns >= CONFIRMATION_NS
                if not confirmed[i] and not reason:
                    reason = f"the velocity of {self._joints[i]} reads zero, not yet confirmed by its position"
            if started_or_stopped or (confirmed[i] and duration_ns > WINDOW_NS):
                windows[i] = _TravelWindow(stamp_ns, x, speed)
        return reason

# SPDX-License-Identifier: Apache-2.0
"""Speed scaling factor for a robot controller, from the decisions of the monitor.

The controller scales the programmed speed v by its factor s, so the measured speed is s v, and the largest allowed
factor is

    s* = allowable speed / v = s_applied (allowable speed) / (measured speed)

s_applied was in force when the joint state was measured, which is known only up to the latency of the loop. The factor
therefore falls to s* of the largest factor that may have been in force, and rises up to s* of the smallest one. It
falls no lower and rises no higher than the true s*, and reaches a constant s* without oscillation (docs/consuming.md).
"""

import math
from collections import deque

from scara_effmass.values import Decision, Verdict

OBEY_NS = 1_000_000_000
"""Time within which a controller that obeys has slowed the robot down."""
MAX_PROGRAMMED_SPEED = 20.0
"""Speed [m/s] that no robot is programmed for."""
MAX_RATIO = 1e6
"""Of allowable and measured speed; larger ones count as this."""


class SpeedScaler:
    """Turns decisions into a factor from 0 to 1, which falls at once and rises slowly.

    It is 0 before the first decision, and while the last one is UNKNOWN or allows nothing at any contact point, was too
    old, or is followed by silence. Times are steady, in [ns], and do not decrease.
    """

    def __init__(self, timeout_ns: int, now_ns: int) -> None:
        """Start at 0; refuse decisions on joint states older than `timeout_ns`, and silence of twice as long."""
        self.timeout_ns = timeout_ns
        self.rise_rate = 1.0
        """Largest increase of the factor [1/s]."""
        self.latency_ns = 0
        """Longest time from `factor` to its effect on the joint states."""
        self.speed_ratio = 1.0
        """Share of the allowable speed to use."""
        self.reason = "no contact states yet"
        """Why the factor is 0; empty if it may rise."""
        self.disobedience = ""
        """Why the controller does not seem to obey the factor; empty if it may."""
        self._obeyed_ns = now_ns
        self._taken_ns = now_ns
        self._bound = 0.0
        """Factor up to which the last decision lets the factor rise."""
        self._sent = deque([(now_ns, 0.0)])
        """Factors by the time from which they were in force."""
        self._factor = 0.0

    def stop(self, reason: str) -> None:
        """Make the factor 0 until the next decision that allows a speed."""
        self.reason, self._bound, self._factor = reason, 0.0, 0.0

    def take(self, decision: Decision, now_ns: int, age_ns: int = 0) -> bool:
        """Take a decision that was received at `now_ns`, `age_ns` after its joint state was measured.

        Return whether the factor falls, which should be sent at once.
        """
        self._taken_ns = now_ns
        refusal = _refusal(decision)
        if not refusal and age_ns > self.timeout_ns:
            refusal = f"the joint state is {age_ns / 1e9:.3f} s old"
        elif not refusal and age_ns < -self.timeout_ns:  # the clocks differ, or use_sim_time has no /clock
            refusal = f"the joint state is stamped {-age_ns / 1e9:.3f} s after the time of this node's clock"
        # A contact point at rest says nothing about the programmed speed.
        moving = [one for one in decision.contacts if one.speed > 0.0 and not one.worst_direction_used]
        self._judge_controller(max((one.speed for one in moving), default=0.0), now_ns, age_ns)
        if refusal:
            self.stop(refusal)
        else:
            self.reason = ""
            self._bound = 1.0
            if moving:
                ratio = min(MAX_RATIO, *(self.speed_ratio * one.allowable_speed / one.speed for one in moving))
                in_force = self._in_force(now_ns - max(age_ns, 0))
                self._bound = min(in_force) * ratio
                self._factor = min(self._factor, max(in_force) * ratio)
        return self._factor < self._sent[-1][1]

    def factor(self, now_ns: int) -> float:
        """Return the factor to send at `now_ns`."""
        silence_ns = now_ns - self._taken_ns
        if not self.reason and silence_ns > 2 * self.timeout_ns:
            self.stop(f"no contact states for {silence_ns / 1e9:.3f} s")
        sent_ns, sent = self._sent[-1]
        risen = min(1.0, sent + self.rise_rate * (now_ns - sent_ns) / 1e9)
        self._factor = min(risen, max(self._factor, self._bound))
        self._sent.append((now_ns, self._factor))
        while self._sent[1][0] < now_ns - self.timeout_ns - self.latency_ns:
            self._sent.popleft()
        return self._factor

    def _judge_controller(self, speed: float, now_ns: int, age_ns: int) -> None:
        """Doubt a controller under which the robot goes on at a `speed` that the factor in force does not explain."""
        factor = max(self._in_force(now_ns - max(age_ns, 0)))
        if not speed > factor * MAX_PROGRAMMED_SPEED:
            self._obeyed_ns, self.disobedience = now_ns, ""
        elif now_ns - self._obeyed_ns > OBEY_NS:
            self.disobedience = f"the robot moves at {speed:.2f} m/s at a factor of {factor:.2g}: nothing obeys it"

    def _in_force(self, measured_ns: int) -> list[float]:
        """Return the factors of which one was in force at `measured_ns`."""
        ends_ns = [*(from_ns for from_ns, _ in self._sent), math.inf][1:]
        in_force = [
            factor
            for (from_ns, factor), end_ns in zip(self._sent, ends_ns, strict=True)
            if from_ns <= measured_ns and end_ns > measured_ns - self.latency_ns
        ]
        return in_force or [self._sent[0][1]]


def _refusal(decision: Decision) -> str:
    """Return why `decision` allows no motion, empty if it does."""
    for contact in decision.contacts:
        is_known = contact.verdict is not Verdict.UNKNOWN and 0.0 <= contact.speed < math.inf
        if not (is_known and 0.0 < contact.allowable_speed < math.inf):
            reason = contact.reason or "no speed is allowed"
            return f"{contact.contact_point}: {reason}".removeprefix(": ")
    if decision.watchdog or not (decision.allowable_speed > 0.0 and decision.speed_scaling > 0.0):
        return "no speed is allowed"
    return ""

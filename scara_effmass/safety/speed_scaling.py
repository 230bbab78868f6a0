# SPDX-License-Identifier: Apache-2.0
"""Speed scaling factor for a robot controller, from the contact states of the monitor.

The controller scales the programmed speed v by its factor s, so the measured speed is s v, and the largest allowed
factor is

    s* = allowable speed / v = s_applied (allowable speed) / (measured speed)

s_applied was in force when the joint state was measured, which is known only up to the latency of the loop. The factor
therefore falls to s* of the largest factor that may have been in force, and rises up to s* of the smallest one. It
falls no lower and rises no higher than the true s*, and reaches a constant s* without oscillation (docs/consuming.md).
"""

import math
from collections import deque

from scara_effmass.values import ContactAssessment, Verdict

MAX_RATIO = 1e6
"""Of allowable and measured speed; larger ones count as this."""


class SpeedScaler:
    """Turns contact states into a factor from 0 to 1, which falls at once and rises slowly.

    It is 0 before the first contact state, and while the last one of any contact point is UNKNOWN, allows nothing, was
    too old or does not come. A contact point counts until `forget`, or until the monitor publishes a state without a
    contact point: it has no robot, or gets another one.
    Times are steady, in [ns], and do not decrease.
    """

    def __init__(self, timeout_ns: int, now_ns: int) -> None:
        """Start at 0; refuse contact states older than `timeout_ns`, and silence of twice as long."""
        self.timeout_ns = timeout_ns
        self.rise_rate = 1.0
        """Largest increase of the factor [1/s]."""
        self.latency_ns = 0
        """Longest time from `factor` to its effect on the joint states."""
        self.speed_ratio = 1.0
        """Share of the allowable speed to use."""
        self.reason = "no contact state yet"
        """Why the factor is 0; empty if it may rise."""
        self._bounds: dict[str, tuple[int, float]] = {}
        """Receipt of the last state of each contact point, and the factor up to which it lets the factor rise."""
        self._refusals: dict[str, str] = {}
        """Why a contact point lets the factor not rise at all."""
        self._sent = deque([(now_ns, 0.0)])
        """Factors by the time from which they were in force."""
        self._factor = 0.0

    def stop(self, reason: str) -> None:
        """Make the factor 0 until each contact point has a valid contact state again."""
        self.reason, self._factor = reason, 0.0
        self._bounds = {name: (taken_ns, 0.0) for name, (taken_ns, _) in self._bounds.items()}
        self._refusals = dict.fromkeys(self._bounds, reason)

    def forget(self, reason: str) -> None:
        """Make the factor 0 until the next valid contact state, of whatever contact point."""
        self._bounds.clear()
        self.stop(reason)

    def take(self, contact: ContactAssessment, now_ns: int, age_ns: int = 0) -> bool:
        """Take a contact state that was received at `now_ns`, `age_ns` after its joint state was measured.

        Return whether the factor falls, which should be sent at once.
        """
        name, speed, allowable_speed = contact.contact_point, contact.speed, contact.allowable_speed
        if name not in self._bounds and (not name or "" in self._bounds):
            self.forget("")
        refusal = ""
        if contact.verdict is Verdict.UNKNOWN or not (0.0 <= speed < math.inf and 0.0 < allowable_speed < math.inf):
            refusal = contact.reason or "no speed is allowed"
        elif age_ns > self.timeout_ns:
            refusal = f"the state is {age_ns / 1e9:.3f} s old"
        self._refusals.pop(name, None)
        if refusal:
            self._refusals[name] = f"{name}: {refusal}".removeprefix(": ")
            self._bounds[name], self._factor = (now_ns, 0.0), 0.0
        elif speed == 0.0 or contact.worst_direction_used:  # at rest, which says nothing about the programmed speed
            self._bounds[name] = (now_ns, 1.0)
        else:
            ratio = min(self.speed_ratio * allowable_speed / speed, MAX_RATIO)
            in_force = self._in_force(now_ns - max(age_ns, 0))
            self._bounds[name] = (now_ns, min(in_force) * ratio)
            self._factor = min(self._factor, max(in_force) * ratio)
        return self._factor < self._sent[-1][1]

    def factor(self, now_ns: int) -> float:
        """Return the factor to send at `now_ns`."""
        for name, (taken_ns, _) in self._bounds.items():
            if now_ns - taken_ns > 2 * self.timeout_ns and name not in self._refusals:
                self._refusals[name] = f"{name}: no contact state for {(now_ns - taken_ns) / 1e9:.3f} s"
                self._bounds[name], self._factor = (taken_ns, 0.0), 0.0
        if self._bounds:
            self.reason = next(iter(self._refusals.values()), "")
            sent_ns, sent = self._sent[-1]
            risen = min(1.0, sent + self.rise_rate * (now_ns - sent_ns) / 1e9)
            self._factor = min(risen, max(self._factor, min(bound for _, bound in self._bounds.values())))
        self._sent.append((now_ns, self._factor))
        while self._sent[1][0] < now_ns - self.timeout_ns - self.latency_ns:
            self._sent.popleft()
        return self._factor

    def _in_force(self, measured_ns: int) -> list[float]:
        """Return the factors of which one was in force at `measured_ns`."""
        ends_ns = [*(from_ns for from_ns, _ in self._sent), math.inf][1:]
        in_force = [
            factor
            for (from_ns, factor), end_ns in zip(self._sent, ends_ns, strict=True)
            if from_ns <= measured_ns and end_ns > measured_ns - self.latency_ns
        ]
        return in_force or [self._sent[0][1]]

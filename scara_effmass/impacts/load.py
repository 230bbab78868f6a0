# SPDX-License-Identifier: Apache-2.0
"""Force that stays, and force that is in no impact: contacts that last, loads on the baseline, and counts by reason."""

import math
from collections.abc import Iterator

import numpy as np

from scara_effmass.impacts.segment import RELEASE, lone_samples
from scara_effmass.iso15066 import TRANSIENT_S
from scara_effmass.values import FloatArray, Impact, LeftOut

MAX_HELD_S = 5.0
"""Time after the onset at which a contact is reported although its force still moves [s]."""
DRIFT_TIME_S = 10.0
"""A change by less than the threshold in this time is drift, no force [s]."""
LOW_TIME_S = 5.0
"""Force that is lower for this time [s] is the new level without load; undershoot after a contact is shorter."""

NO_BASELINE = "no steady baseline"
EARLIER_LOAD = "load from before the recording, or a zero that shifted"
LATER_LOAD = "load that goes on after its contact was reported"
SLOW_CHANGE = "slow change: drift, or a press that comes and goes slowly"
IN_NOISE = "within the noise: less than noise_factor times its standard deviation"
TENSION = "below the baseline: tension, an earlier load that goes, or a wrong sign"
NO_SIGNAL = "no valid sample: sensor open, shorted or overloaded"
AC_COUPLED = "AC coupl"
"""In the source of a force whose constant part the converter removes: what stays decays within seconds."""
READS_LOW = (
    "AC coupling removes a force that stays or rises slowly: such peaks and held forces are larger than measured"
)
SLOW_RISE_S = 0.05
"""Impulse up to the peak over the peak, from which AC coupling takes 3 % of it: that over the time constant, 1.6 s at
0.1 Hz. A half-sine of 0.16 s has it."""
LOADS = {EARLIER_LOAD, LATER_LOAD, SLOW_CHANGE}
"""Reasons of force that stays or changes slowly."""


class LeftOuts:
    """Count force that is in no impact, by reason."""

    def __init__(self) -> None:
        self._by_reason: dict[str, LeftOut] = {}
        self._unknown_end = -1

    def add(self, reason: str, peak: float, stamp_ns: int, count: int = 1, load: float = 0.0) -> None:
        """Count an event with its `peak` and the `load` in it [N]; a `count` of 0 continues the latest one."""
        known = self._by_reason.get(reason, LeftOut(reason, 0, -math.inf, 0))
        if peak > known.peak_force:
            known = known._replace(peak_force=peak, stamp_ns=stamp_ns, load_force=load)
        self._by_reason[reason] = known._replace(occurrences=max(known.occurrences + count, 1))

    def add_unknown(self, stamp_ns: int, start: int, stop: int) -> None:
        """Count the samples [start, stop), whose force is not known; together with those before them if adjacent."""
        self.add(NO_SIGNAL, 0.0, stamp_ns, start != self._unknown_end)
        self._unknown_end = stop

    def __iter__(self) -> Iterator[LeftOut]:
        """Yield the counts, the largest peak first."""
        return iter(sorted(self._by_reason.values(), key=lambda item: -item.peak_force))


def left_out_text(item: LeftOut) -> str:
    """Return how often force was left out, and the largest one."""
    return f"{item.occurrences}: {item.reason} ({item.size_text})"


def reads_low(impact: Impact) -> bool:
    """Return whether AC coupling removed a part of the force."""
    rises_slowly = impact.compression_impulse > SLOW_RISE_S * impact.peak_force
    return AC_COUPLED in impact.source and (impact.held_force > 0.0 or rises_slowly)


def peak_text(impact: Impact) -> str:
    """Return the peak of an impact, the load beneath it, and what stayed."""
    decays = " at least" if reads_low(impact) else ""
    bound = " at least" if impact.clipped or impact.incomplete else "" if impact.held_force else decays
    load = f" on a load of {impact.load_force:.1f} N" if impact.load_force else ""
    held = f", held {impact.held_force:.1f} N{decays}" if impact.held_force else ""
    return f"{impact.peak_force:.1f} N{bound}{load}{held}"


class HeldContact:
    """A contact whose force stays. It begins as `impact`, which was measured up to some sample; `extend` adds the rest.

    `level` is the baseline and `threshold` the force above it [N] with which a contact begins; it ends below the share
    RELEASE of that. `sample_rate` is in [Hz]. Single samples far from both neighbours do not count.
    """

    def __init__(self, impact: Impact, level: float, threshold: float, sample_rate: float) -> None:
        self._impact = impact
        self._level, self._threshold, self._rate = level, threshold, sample_rate
        self._transient_end = math.ceil(impact.onset_sample + TRANSIENT_S * sample_rate)
        self._seen = math.ceil(impact.onset_sample + impact.duration * sample_rate)
        self._latest = np.full(1, math.nan)
        """Latest sample that was added, and the one after it, which waits for its successor."""

    def extend(self, samples: FloatArray, first: int) -> list[tuple[int, float]]:
        """Add those of `samples` (n,) [N] that are new; the first one has the number `first`.

        Returns number and force [N] of each single sample above the threshold that was left out.
        """
        missing = np.full(max(first - self._seen, 0), math.nan)
        new = samples[max(self._seen - first, 0) :] - self._level
        force = np.concatenate((self._latest, missing, new))
        self._seen += missing.size + new.size
        first = self._seen - force.size
        if force.size < 3:
            self._latest = force
            return []
        single = lone_samples(force, self._threshold)
        left_out = [(first + i, float(force[i])) for i in single.tolist() if force[i] > self._threshold]
        self._latest = force[-2:].copy()
        force[single] = 0.5 * (force[single - 1] + force[single + 1])
        self._impact = self._with(force[1:-1], first + 1)
        return left_out

    def _with(self, force: FloatArray, first: int) -> Impact:
        """Return the contact with `force` (n,) [N] above the level, whose first sample has the number `first`."""
        impact, force = self._impact, np.nan_to_num(force)
        contact = np.flatnonzero(force > RELEASE * self._threshold)
        if not contact.size:
            return impact
        stop = int(contact[-1]) + 1
        late = min(max(self._transient_end - first, 0), stop)
        return impact._replace(
            peak_force=float(force[:late].max(initial=impact.peak_force)),
            held_force=float(force[late:stop].max(initial=impact.held_force)),
            impulse=impact.impulse + float(force[:stop].clip(0.0).sum()) / self._rate,
            duration=max(impact.duration, (first + stop - impact.onset_sample) / self._rate),
        )

    def takes_long(self, index: int) -> bool:
        """Return whether the contact still lasts at sample `index`, MAX_HELD_S after its onset."""
        return index - self._impact.onset_sample > MAX_HELD_S * self._rate

    @property
    def impact(self) -> Impact:
        """The contact so far."""
        return self._with(self._latest[1:], self._seen - 1)

    @property
    def largest(self) -> float:
        """Largest force so far [N]."""
        return max(self.impact.peak_force, self.impact.held_force)


class LoadLevel:
    """Level of the force without load, and the load on it [N], from the baseline over time.

    `zero` is NaN until `settle`. Both follow drift by less than `threshold` [N] in DRIFT_TIME_S.
    """

    def __init__(self, threshold: float) -> None:
        self._threshold = threshold
        self.zero = math.nan
        self.load = 0.0
        self._low_s = 0.0

    def settle(self, level: float) -> None:
        """Take a new baseline: what it is above `zero` is the load of a contact."""
        if math.isnan(self.zero):
            self.zero = level
        above = level - self.zero
        self.load = above if above > self._threshold else 0.0

    def tare(self) -> None:
        """Take the load as part of the level without load, because the sensor was tared."""
        self.zero, self.load = self.zero + self.load, 0.0

    def follow(self, level: float, seconds: float) -> float:
        """Follow the quiet force, which was at `level` for `seconds`; return how far it is above zero and load [N].

        Beyond the threshold, that is a slow change. Returns a negative number, once, for an earlier load that went.
        """
        change = level - self.zero - self.load
        self._low_s = self._low_s + seconds if change < -self._threshold else 0.0
        if self.load and level < self.zero + self._threshold:
            self.load = 0.0
        elif self._low_s > LOW_TIME_S:
            self.zero, self.load, self._low_s = level, 0.0, 0.0
            return change
        if abs(change) > self._threshold:
            return max(change, 0.0)
        step = self._threshold * seconds / DRIFT_TIME_S
        if self.load:
            self.load += min(max(change, -step), step)
        else:
            self.zero += min(max(change, -step), step)
        return max(change, 0.0)

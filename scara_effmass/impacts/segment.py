"""A stretch of force in which something happened, judged as a whole: contacts, drop-outs, glitches."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from scara_effmass.impacts.background import centre_and_spread
from scara_effmass.impacts.contact import measure, separate
from scara_effmass.impacts.faults import lone_samples, stuck_runs

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from scara_effmass.impacts.background import Background
    from scara_effmass.impacts.contact import DetectedContact
    from scara_effmass.values import BoolArray, FloatArray

CREDIBLE = 3
"""A contact that is not complete needs so many samples to be believed."""


class Segment(NamedTuple):
    """What a stretch of force holds, in samples from its beginning."""

    contacts: list[DetectedContact]
    pulls: list[DetectedContact]
    """What would be contacts if the sign of the force were changed."""
    dropouts: NDArray[np.intp]
    glitches: NDArray[np.intp]


def classify(samples: FloatArray, saturated: BoolArray, background: Background, gap: int, before: int) -> Segment:
    """Return what is in `samples` (n,) [N] beside their `background`.

    Contacts are apart when `gap` samples between them are without force. The force in the last `before` samples
    ahead of a contact has to be the baseline, or else its numbers are not above what was there.
    """
    force = samples - background.baseline
    stuck, stuck_end = stuck_runs(samples, background.flat_run, background.zero_run, saturated)
    valid = np.ones(samples.size, dtype=np.bool_)
    for start, stop in zip(stuck, stuck_end, strict=True):
        valid[start:stop] = False
    force[~valid] = 0.0
    level, release = _levels(force, valid, background, gap)
    glitches = lone_samples(force, level)
    force[glitches] = 0.5 * (force[glitches - 1] + force[glitches + 1])

    contacts = _contacts(force, _Known(valid, saturated, level, release, gap, before))
    pulls: list[DetectedContact] = []
    if force.min() < -background.level:
        level, release = _levels(-force, valid, background, gap)
        pulls = _contacts(-force, _Known(valid, saturated, level, release, gap, before))
    return Segment(contacts, pulls, stuck, glitches)


class _Known(NamedTuple):
    """What contacts are found by: the masks (n,), the levels [N], and the numbers of samples of `judge`."""

    valid: BoolArray
    saturated: BoolArray
    level: float
    release: float
    gap: int
    before: int


def _contacts(force: FloatArray, known: _Known) -> list[DetectedContact]:
    """Return the contacts in `force` (n,) [N] above baseline."""
    valid, saturated, level, release, gap, before = known
    spans = separate(force, valid, level, release, gap)
    contacts: list[DetectedContact] = []
    for number, (first, last) in enumerate(spans):
        earliest = spans[number - 1][1] + 1 if number else 0
        latest = spans[number + 1][0] - 1 if number + 1 < len(spans) else force.size - 1
        clipped = bool(saturated[first : last + 1].any())
        whole = not clipped and bool(valid[first : last + 1].all())
        contact = measure(force, first, last, earliest, latest, whole=whole)
        ahead = force[max(earliest, first - before) : first]
        complete = (
            contact.complete
            and first > 0
            and last < force.size - 1
            and bool(valid[max(math.floor(contact.onset), 0) : math.ceil(contact.end) + 1].all())
            and (ahead.size < CREDIBLE or abs(float(np.median(ahead))) <= level)
        )
        if contact.area > 0.0 and (complete or last - first + 1 >= CREDIBLE):  # a contact pushes, noise does not
            contacts.append(contact._replace(complete=complete, clipped=clipped))
    return contacts


def _levels(force: FloatArray, valid: BoolArray, background: Background, gap: int) -> tuple[float, float]:
    """Return above which force a contact is, and below which it is over [N].

    They are those of the background, unless what is left without the contacts is wilder than that was: where noise
    has set in, or the structure rings, its crests are no contacts.
    """
    outside = valid.copy()
    for first, last in separate(force, valid, background.level, background.release, gap):
        outside[first : last + 1] = False
    rest = force[outside]
    times = background.level_of(centre_and_spread(rest)[1]) / background.level if rest.size else 1.0
    return times * background.level, times * background.release

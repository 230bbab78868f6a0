"""The true contacts between tip and plate, from the contact samples of all steps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from scara_effmass.sim.collision_sim import ContactSample


class TrueContact(NamedTuple):
    """One contact, in the axis of the force cell: `peak_force` [N], `impulse` [N s], `duration` [s].

    `speed` is the closing speed of tip and plate along the normal of the plate [m/s].
    """

    onset_ns: int
    speed: float
    peak_force: float
    duration: float
    impulse: float


def find_contacts(samples: Sequence[ContactSample]) -> tuple[TrueContact, ...]:
    """Return the complete contacts in `samples`, which are in time order."""
    pressed = np.array([False, *(sample.force > 0.0 for sample in samples), False])
    begins = np.flatnonzero(~pressed[:-1] & pressed[1:]).tolist()
    ends = np.flatnonzero(pressed[:-1] & ~pressed[1:]).tolist()
    return tuple(
        _contact(samples[begin - 1 : end + 1])
        for begin, end in zip(begins, ends, strict=True)
        if begin > 0 and end < len(samples)
    )


def _contact(samples: Sequence[ContactSample]) -> TrueContact:
    """Return the contact that fills `samples` except for the first and the last one."""
    before, first, last = samples[0], samples[1], samples[-1]
    step_s = (first.time_ns - before.time_ns) / 1e9
    speed = (first.depth - before.depth) / step_s
    onset_ns = first.time_ns - round(first.depth / speed * 1e9)
    return TrueContact(
        onset_ns=onset_ns,
        speed=speed,
        peak_force=max(sample.measured for sample in samples),
        duration=(last.time_ns - onset_ns) / 1e9,
        impulse=sum(sample.measured for sample in samples) * step_s,
    )

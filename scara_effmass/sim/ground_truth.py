"""What truly happened between tip and plate: every contact, from the forces of all steps."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from scara_effmass.sim.collision_sim import ContactSample


class TrueContact(NamedTuple):
    """One contact, as the axis of the force cell has it: `peak_force` [N], `impulse` [N s], `duration` [s].

    `speed` is that at which plate and tip closed, along the normal of the plate [m/s].
    """

    onset_ns: int
    speed: float
    peak_force: float
    duration: float
    impulse: float


def true_contacts(touches: Sequence[ContactSample]) -> tuple[TrueContact, ...]:
    """Return the contacts in `touches`, which are in order of time, but for one that is cut off at either end."""
    pressed = np.array([False, *(touch.force > 0.0 for touch in touches), False])
    begins = np.flatnonzero(~pressed[:-1] & pressed[1:]).tolist()
    ends = np.flatnonzero(pressed[:-1] & ~pressed[1:]).tolist()
    return tuple(
        _contact(touches[begin - 1 : end + 1])
        for begin, end in zip(begins, ends, strict=True)
        if begin > 0 and end < len(touches)
    )


def _contact(touches: Sequence[ContactSample]) -> TrueContact:
    """Return the contact from the second of `touches` to the one before the last."""
    before, first, last = touches[0], touches[1], touches[-1]
    step_s = (first.time_ns - before.time_ns) / 1e9
    speed = (first.depth - before.depth) / step_s
    onset_ns = first.time_ns - round(first.depth / speed * 1e9)
    return TrueContact(
        onset_ns=onset_ns,
        speed=speed,
        peak_force=max(touch.measured for touch in touches),
        duration=(last.time_ns - onset_ns) / 1e9,
        impulse=sum(touch.measured for touch in touches) * step_s,
    )

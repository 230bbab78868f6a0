"""How the tool moved during a run: from recorded joint states."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from scara_effmass.analysis.assessment import joint_state_topic
from scara_effmass.bags.files import open_bag
from scara_effmass.errors import BagError

if TYPE_CHECKING:
    from pathlib import Path

    from scara_effmass.paper.scara import Scara
    from scara_effmass.values import FloatArray


@dataclass(frozen=True, slots=True)
class ToolMotion:
    """Tool position and velocity along x, (n,) each, over the time since the first joint state.

    `contact_s` is when the tool is at the impact point, by a clock that may be off by `contact_doubt_s`; `contact` is
    what there is then, and `about` says whose motion it is.
    """

    time_s: FloatArray
    x_m: FloatArray
    speed_m_s: FloatArray
    contact_s: float
    contact: str
    about: str
    contact_doubt_s: float = 0.0

    @property
    def contact_x_m(self) -> float:
        """Where the tool is then."""
        return float(np.interp(self.contact_s, self.time_s, self.x_m))

    @property
    def contact_speed_m_s(self) -> float:
        """How fast the tool is right before: by the last joint state that surely is."""
        after = int(np.searchsorted(self.time_s, self.contact_s - self.contact_doubt_s, side="right"))
        return float(self.speed_m_s[max(after - 1, 0)])

    @property
    def share_of_path(self) -> float:
        """Which part of its way the tool has gone then."""
        return (self.contact_x_m - float(self.x_m[0])) / float(self.x_m[-1] - self.x_m[0])


def tool_motion(
    path: Path,
    scara: Scara,
    joints: tuple[str, str],
    about: str,
    *,
    contact_x: float | None = None,
    contact_ns: int = 0,
    contact_doubt_s: float = 0.0,
) -> ToolMotion:
    """Return the tool's motion in the recording at `path`, whose first two joints are named `joints`.

    The contact is where x first reaches `contact_x` [m], or if that is None at the stamp `contact_ns`,
    give or take `contact_doubt_s`. Raises BagError.
    """
    stamps, rows = [], []
    with open_bag(path) as bag:
        for block in bag.joint_state_blocks(joint_state_topic(bag, None)):
            for state in block.states():
                if not set(joints) <= set(state.names) or len(state.velocity) != len(state.names):
                    raise BagError(f"{path}: a joint state without position and velocity of {' and '.join(joints)}")
                first, second = (state.names.index(joint) for joint in joints)
                stamps.append(state.stamp_ns)
                rows.append((*state.position[[first, second]], *state.velocity[[first, second]]))
    if len(rows) < 2:
        raise BagError(f"{path}: {len(rows)} joint states; a motion has at least 2")
    q1, q2, rate1, rate2 = np.array(rows).T
    x, y = scara.tool(q1, q2)
    speed = -rate1 * y - rate2 * scara.inertia.l2 * np.sin(q1 + q2)
    time = (np.array(stamps) - stamps[0]) / 1e9
    contact = (contact_ns - stamps[0]) / 1e9 if contact_x is None else _first_at(time, x, contact_x, path)
    if not time[0] <= contact <= time[-1]:
        raise BagError(f"{path}: the contact, {contact:.3f} s after the first joint state, is not in the recording")
    meaning = "instant of impact" if contact_x is None else "at the impact point (nothing is hit)"
    return ToolMotion(time, x, speed, contact, meaning, about, contact_doubt_s)


def _first_at(time: FloatArray, x: FloatArray, value: float, path: Path) -> float:
    """Return when `x` first reaches `value` from below or above, by linear interpolation."""
    side = np.sign(x - value)
    crossing = np.flatnonzero(side[:-1] != side[1:])
    if not len(crossing):
        raise BagError(f"{path}: the tool never is at x = {value:g} m: it goes from {x.min():.4f} to {x.max():.4f} m")
    at = crossing[0]
    share = (value - x[at]) / (x[at + 1] - x[at])
    return float(time[at] + share * (time[at + 1] - time[at]))

"""Motion of the tool along x during a run, from recorded joint states."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scara_effmass.analysis.assessment import joint_state_topic
from scara_effmass.bags.files import open_bag
from scara_effmass.errors import BagError
from scara_effmass.paper.scara import Scara
from scara_effmass.values import FloatArray


@dataclass(frozen=True, slots=True)
class ToolMotion:
    """Tool position and velocity along x, (n,) each, over the time since the first joint state.

    The tool reaches the impact point at `contact_s`, give or take `contact_uncertainty_s` of the clock. `source`
    names the recording.
    """

    time_s: FloatArray
    x_m: FloatArray
    speed_m_s: FloatArray
    contact_s: float
    contact_label: str
    source: str
    contact_uncertainty_s: float = 0.0

    @property
    def contact_x_m(self) -> float:
        """Tool position at the contact."""
        return float(np.interp(self.contact_s, self.time_s, self.x_m))

    @property
    def contact_speed_m_s(self) -> float:
        """Tool speed of the last joint state that is certainly before the contact."""
        index = int(np.searchsorted(self.time_s, self.contact_s - self.contact_uncertainty_s, side="right"))
        return float(self.speed_m_s[max(index - 1, 0)])

    @property
    def path_share(self) -> float:
        """Share of the path before the contact."""
        return (self.contact_x_m - float(self.x_m[0])) / float(self.x_m[-1] - self.x_m[0])


def tool_motion(
    path: Path,
    scara: Scara,
    joints: tuple[str, str],
    source: str,
    *,
    contact_x: float | None = None,
    contact_ns: int = 0,
    contact_uncertainty_s: float = 0.0,
) -> ToolMotion:
    """Return the tool motion in the recording at `path`, whose first two joints are named `joints`.

    The contact is where x first reaches `contact_x` [m], or if that is None at the stamp `contact_ns`. Raises BagError.
    """
    stamps, rows = [], []
    with open_bag(path) as bag:
        for block in bag.joint_state_blocks(joint_state_topic(bag, None)):
            for state in block.states():
                if not set(joints) <= set(state.names) or len(state.velocity) != len(state.names):
                    names = " and ".join(joints)
                    raise BagError(f"{path}: a joint state must have position and velocity of {names}")
                i, j = (state.names.index(joint) for joint in joints)
                stamps.append(state.stamp_ns)
                rows.append((*state.position[[i, j]], *state.velocity[[i, j]]))
    if len(rows) < 2:
        raise BagError(f"{path}: {len(rows)} joint states: must be at least 2")
    q1, q2, rate1, rate2 = np.array(rows).T
    x, y = scara.tool(q1, q2)
    speed = -rate1 * y - rate2 * scara.inertia.l2 * np.sin(q1 + q2)
    time = (np.array(stamps) - stamps[0]) / 1e9
    contact = (contact_ns - stamps[0]) / 1e9 if contact_x is None else _first_time_at(time, x, contact_x, path)
    if not time[0] <= contact <= time[-1]:
        raise BagError(f"{path}: contact {contact:.3f} s after the first joint state: must be within the recording")
    label = "instant of impact" if contact_x is None else "at the impact point (nothing is hit)"
    return ToolMotion(time, x, speed, contact, label, source, contact_uncertainty_s)


def _first_time_at(time: FloatArray, x: FloatArray, value: float, path: Path) -> float:
    """Return the first time with x = `value`, by linear interpolation."""
    sign = np.sign(x - value)
    crossings = np.flatnonzero(sign[:-1] != sign[1:])
    if not len(crossings):
        raise BagError(f"{path}: tool from x = {x.min():.4f} to {x.max():.4f} m: must reach x = {value:g} m")
    i = crossings[0]
    return float(time[i] + (value - x[i]) / (x[i + 1] - x[i]) * (time[i + 1] - time[i]))

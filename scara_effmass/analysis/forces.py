"""Read the force of a recording and the impacts detected live."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scara_effmass.values import FloatArray, Impact
from scara_effmass.wire.force import decode_impact
from scara_effmass.wire.message_types import FORCE_BLOCK, IMPACT

if TYPE_CHECKING:
    from scara_effmass.bags.bag import Bag


class RecordedForce(NamedTuple):
    """Force (n,) [N] at the ROS times `stamp_ns` (n,), with one NaN in each gap, and its impacts."""

    stamp_ns: NDArray[np.int64]
    force: FloatArray
    blocks: int
    lost: int
    simulated: bool
    source: str
    impacts: tuple[Impact, ...]

    @property
    def samples(self) -> int:
        """Number of samples."""
        return int(np.isfinite(self.force).sum())


def read_force(bag: Bag) -> RecordedForce | None:
    """Return the first force topic of `bag`, or None without force. Raises BagError and DecodeError."""
    topic, impact_topic = (
        next((topic.name for topic in bag.topics if topic.type == kind), "") for kind in (FORCE_BLOCK, IMPACT)
    )
    stamps: list[NDArray[np.int64]] = []
    forces: list[FloatArray] = []
    blocks = lost = 0
    for block in bag.force_blocks(topic) if topic else ():
        # The first block may count samples lost before the recording began.
        if block.lost_samples and blocks:
            lost += block.lost_samples
            stamps.append(np.array([block.stamp_ns], np.int64))
            forces.append(np.array([np.nan]))
        blocks += 1
        stamps.append(block.stamp_ns + np.rint(np.arange(len(block.force)) / block.sample_rate * 1e9).astype(np.int64))
        forces.append(block.force)
    if not blocks:
        return None
    impacts = [decode_impact(message.data) for message in bag.messages([impact_topic])] if impact_topic else []
    return RecordedForce(
        np.concatenate(stamps), np.concatenate(forces), blocks, lost, block.simulated, block.source, tuple(impacts)
    )

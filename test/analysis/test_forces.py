# SPDX-License-Identifier: Apache-2.0
"""Force and impacts read from a recording."""

from pathlib import Path

import numpy as np

from scara_effmass.analysis.recorded_run import read_force
from scara_effmass.bags.files import open_bag
from scara_effmass.bags.writer import BagWriter
from scara_effmass.share import share
from scara_effmass.values import ForceBlock, Impact
from scara_effmass.wire.force import force_block_message, impact_message
from scara_effmass.wire.message_types import FORCE_BLOCK, IMPACT

START_NS = 1_800_000_000_000_000_000
MS = 1_000_000


def block(number: int, first: int, lost: int = 0) -> ForceBlock:
    force = np.arange(first, first + 10.0)
    return ForceBlock(START_NS + number * MS, "cell", first, 1e4, force, lost, source="test")


def test_lost_samples_give_a_nan_between_blocks(tmp_path: Path) -> None:
    impact = Impact(START_NS, "cell", 9.0, 1e-3, 0.01, 3.0, *(False, False, 0, 0.0, 0.1, 0.0, "test", False))
    with BagWriter(tmp_path / "bag") as bag:
        for message in (block(0, 100, lost=7), block(1, 110), block(3, 130, lost=10)):
            bag.write("/force", FORCE_BLOCK, message.stamp_ns, force_block_message(message))
        bag.write("/impact", IMPACT, START_NS + 4 * MS, impact_message(impact))
    with open_bag(tmp_path / "bag") as bag:
        forces = read_force(bag)
    assert forces is not None
    assert (forces.blocks, forces.lost, forces.simulated, forces.source) == (3, 10, False, "test")
    assert forces.impacts == (impact,)
    assert np.flatnonzero(np.isnan(forces.force)).tolist() == [20]
    assert (np.diff(forces.stamp_ns) >= 0).all()
    assert forces.stamp_ns[-1] == START_NS + 3 * MS + 900_000


def test_recording_without_force_gives_none() -> None:
    with open_bag(share("bags", "straight_300_200")) as bag:
        assert read_force(bag) is None

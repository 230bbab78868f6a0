# SPDX-License-Identifier: Apache-2.0
"""Force and impacts read from a recording."""

from pathlib import Path

import numpy as np
import pytest

from scara_effmass.analysis.forces import ForceTrace, file_traces, read_force, shown
from scara_effmass.bags.files import open_bag
from scara_effmass.bags.writer import BagWriter
from scara_effmass.settings import ImportSettings
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


def test_one_simulated_block_makes_the_force_simulated(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        for message in (block(0, 100)._replace(simulated=True), block(1, 110)):
            bag.write("/force", FORCE_BLOCK, message.stamp_ns, force_block_message(message))
    with open_bag(tmp_path / "bag") as bag:
        forces = read_force(bag)
    assert forces is not None
    assert forces.simulated


def test_trace_ends_at_the_next_impact(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        for number in range(10):
            message = block(number, 10 * number)
            bag.write("/force", FORCE_BLOCK, message.stamp_ns, force_block_message(message))
    onsets_ns = [START_NS + 5 * MS, START_NS + 2 * MS]  # the contacts of a protocol can be in any order
    later, earlier = file_traces(tmp_path / "bag", ImportSettings(), onsets_ns, 10.0)
    assert (earlier.time[0], earlier.time[-1]) == pytest.approx((-2e-3, 3e-3))
    assert (later.time[0], later.time[-1]) == pytest.approx((-5e-3, 4.9e-3))
    assert np.ptp(earlier.force) == 50.0


@pytest.mark.parametrize("end", [-1e-3, 0.0])
def test_trace_that_ends_before_its_impact_is_not_shown(end: float) -> None:
    trace = ForceTrace(np.linspace(end - 5e-3, end, 6), np.zeros(6))
    assert not shown("", START_NS, trace, simulated=True, peak=10.0)


def test_recording_without_force_gives_none() -> None:
    with open_bag(share("bags", "straight_300_200")) as bag:
        assert read_force(bag) is None

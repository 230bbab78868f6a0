# SPDX-License-Identifier: Apache-2.0
"""Force and impacts read from a recording."""

from pathlib import Path

import numpy as np
import pytest

from scara_effmass.analysis.forces import ForceTrace, ShownTrace, file_traces, read_force
from scara_effmass.bags.batches import LossLog
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
    assert not forces.simulated
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
    later, earlier = file_traces(tmp_path / "bag", ImportSettings(), onsets_ns, 10.0, LossLog())
    assert (earlier.time[0], earlier.time[-1]) == pytest.approx((-2e-3, 3e-3))
    assert (later.time[0], later.time[-1]) == pytest.approx((-5e-3, 4.9e-3))
    assert np.ptp(earlier.force) == 50.0


@pytest.mark.parametrize("missing", [None, 5])
def test_a_trace_across_a_lost_block_is_not_complete(tmp_path: Path, missing: int | None) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        for number in range(10):
            message = block(number, 10 * number)
            if number != missing:
                bag.write("/force", FORCE_BLOCK, message.stamp_ns, force_block_message(message))
    (trace,) = file_traces(tmp_path / "bag", ImportSettings(), [START_NS + 2 * MS], 10.0, LossLog())
    assert trace.complete == (missing is None)
    with open_bag(tmp_path / "bag") as bag:
        forces = read_force(bag)
    assert forces is not None
    assert np.isnan(forces.force).sum() == (1 if missing else 0)


def test_no_trace_of_a_file_is_complete_of_which_a_part_cannot_be_read(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        for number in range(10):
            data = force_block_message(block(number, 10 * number))
            bag.write("/force", FORCE_BLOCK, START_NS + number * MS, data if number < 9 else data[:20])
    losses = LossLog()
    (trace,) = file_traces(tmp_path / "bag", ImportSettings(), [START_NS + 2 * MS], 10.0, losses)
    assert not trace.complete
    assert ["left out" in loss for loss in losses] == [True]


@pytest.mark.parametrize("end", [-1e-3, 0.0])
def test_trace_that_ends_before_its_impact_is_not_shown(end: float) -> None:
    assert not ForceTrace(np.linspace(end - 5e-3, end, 6), np.zeros(6)).reaches_onset


@pytest.mark.parametrize(("late_n", "held", "end_ms"), [(0.0, 9.0, 390.0), (80.0, None, 880.0)])
def test_a_drawing_reaches_its_peak_and_a_force_that_is_held(late_n: float, held: float | None, end_ms: float) -> None:
    time = np.arange(-10, 2000) / 1e3
    force = 100.0 * np.clip(1.0 - np.abs(time - 0.01) / 0.01, 0.0, 1.0) + 200.0 * (np.abs(time - 0.34) < 5e-3)
    force += late_n * (np.abs(time - 0.8) < 5e-4)
    drawing = ShownTrace("", 0, ForceTrace(time, force), simulated=False, peak=200.0, held=held).drawing()
    assert float(drawing.end) == pytest.approx(end_ms, rel=0.05)
    assert len(drawing.marks) == (2 if late_n else 1)
    for x, y in drawing.marks:
        assert f" {x}," in drawing.points
        assert drawing.zero < x < 314.0
        assert y < drawing.base


@pytest.mark.parametrize(("samples", "loss"), [(2, 1.0), (3, 1.0 - np.cos(np.pi / 4)), (41, 1.0 - np.cos(np.pi / 80))])
def test_the_sampling_loss_is_that_of_the_shortest_contact_with_these_samples(samples: int, loss: float) -> None:
    force = np.concatenate([np.zeros(5), np.full(samples, 9.0), np.zeros(5)])
    trace = ForceTrace(np.arange(force.size) / 1e3 - 4e-3, force)
    assert trace.sampling_loss == pytest.approx(loss)


def test_recording_without_force_gives_none() -> None:
    with open_bag(share("bags", "straight_300_200")) as bag:
        assert read_force(bag) is None

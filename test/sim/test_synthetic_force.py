from __future__ import annotations

import numpy as np
import pytest

from scara_effmass.sim.recordings import TOUR_HITS
from scara_effmass.sim.synthetic_force import NOISE, SAMPLE_RATE, Pulse, synthetic_force

START_NS = 5_000_000_000


def test_blocks_follow_each_other_and_say_that_they_are_simulated() -> None:
    blocks = list(synthetic_force(TOUR_HITS, 2.05, START_NS, seed=1))
    assert len(blocks) == 20  # only whole ones
    assert [block.first_sample for block in blocks] == [number * 1280 for number in range(20)]
    assert [block.stamp_ns for block in blocks] == [START_NS + number * 100_000_000 for number in range(20)]
    assert {len(block.force) for block in blocks} == {1280}
    assert all(block.simulated and block.source.startswith("simulated") for block in blocks)
    assert not any(block.force.flags.writeable for block in blocks)


def test_the_force_is_noise_and_the_hits() -> None:
    hits = (Pulse(0.25001, 300.0, 2e-3), Pulse(0.2999, 50.0, 1e-3, rebound=1))  # the second one reaches into two blocks
    force = np.concatenate([block.force for block in synthetic_force(hits, 1.0, START_NS, seed=1)])
    expected = np.zeros(len(force))
    for hit in hits:
        times = np.arange(len(force)) / SAMPLE_RATE - hit.seconds
        during = (times >= 0.0) & (times <= hit.duration)
        expected += np.where(during, hit.peak_force * np.sin(np.pi * times / hit.duration), 0.0)
    noise = force - expected
    assert np.abs(noise).max() < 6.0 * NOISE
    assert noise.std() == pytest.approx(NOISE, rel=0.03)


def test_a_seed_gives_the_same_force_again() -> None:
    one, same, other = (next(synthetic_force((), 1.0, START_NS, seed)).force for seed in (1, 1, 2))
    assert np.array_equal(one, same)
    assert not np.array_equal(one, other)


def test_the_hits_of_the_tour_do_not_overlap_and_leave_time_for_a_tare() -> None:
    ends = [0.6, *(hit.seconds + hit.duration for hit in TOUR_HITS)]
    assert all(hit.seconds > end for hit, end in zip(TOUR_HITS, ends, strict=False))
    assert [hit.rebound for hit in TOUR_HITS].count(1) == 1

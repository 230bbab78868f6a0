# SPDX-License-Identifier: Apache-2.0
"""Conversion of stamped samples to blocks of uniform sampling."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from scara_effmass.errors import BagError
from scara_effmass.importers.force_file import BLOCK_TIME_S, CHUNK, MAX_BURST, uniform_samples
from scara_effmass.values import ForceBlock

NS = 10**9
T0 = 1_700_000_000 * NS


def sampled(times_ns: np.ndarray) -> tuple[float, list[ForceBlock]]:
    """Return the rate and the blocks of samples whose values are their indices, with the samples lost before each."""
    sample_rate, blocks = uniform_samples("cell.csv", times_ns, np.arange(len(times_ns), dtype=np.float64))
    counted, end = [], 0
    for block in blocks:
        counted.append(block._replace(lost_samples=block.first_sample - end))
        end = block.first_sample + len(block.force)
    return sample_rate, counted


@settings(max_examples=40)
@given(
    rate=st.floats(0.5, 20_000.0),
    count=st.integers(300, 6000),
    gaps=st.dictionaries(st.integers(1, 5999), st.integers(1, 1000), max_size=3),
)
def test_uniform_stamps_stay_and_every_gap_is_counted(rate: float, count: int, gaps: dict[int, int]) -> None:
    numbers = np.arange(count)
    for at, lost in gaps.items():
        numbers[at:] += lost
    assume(numbers[-1] < 1.9 * count)
    times_ns = T0 + np.round(numbers * NS / rate).astype(np.int64)
    sample_rate, blocks = sampled(times_ns)
    assert sample_rate == pytest.approx(rate, rel=1e-4)
    assert np.concatenate([block.force for block in blocks]).tolist() == list(range(count))
    assert {int(block.force[0]): block.lost_samples for block in blocks if block.lost_samples} == {
        at: lost for at, lost in gaps.items() if at < count
    }
    size = max(1, round(BLOCK_TIME_S * sample_rate))
    for block in blocks:
        assert len(block.force) <= size
        assert block.stamp_ns == pytest.approx(times_ns[int(block.force[0])], abs=2)
        assert block.clock_residual == pytest.approx(0.0, abs=2e-9)


@pytest.mark.parametrize("burst", [10, 30, 50, 100, 120, 500])
def test_more_samples_with_the_same_time_than_show_the_rate_are_refused(burst: int) -> None:
    times_ns = T0 + np.arange(20 * burst) // burst * (NS // 100)
    if burst > MAX_BURST:
        with pytest.raises(BagError, match=f"has {burst} samples with the same time: must have at most {MAX_BURST}"):
            sampled(times_ns)
        return
    sample_rate, blocks = sampled(times_ns)
    assert sample_rate == pytest.approx(100.0 * burst)
    assert not any(block.lost_samples for block in blocks)


@pytest.mark.parametrize("count", [100, 1000, 9000])
@pytest.mark.parametrize("jitter", [0.02, 0.1, 0.2, 0.3, 0.5])
def test_jitter_is_averaged_and_loses_no_sample(jitter: float, count: int) -> None:
    period_ns = 1_000_000
    true_ns = T0 + np.arange(count) * period_ns
    for seed in range(5):
        noise_ns = np.random.default_rng(seed).normal(0.0, jitter * period_ns, count).astype(np.int64)
        sample_rate, blocks = sampled(np.sort(true_ns + noise_ns))
        assert sample_rate == pytest.approx(1000.0, rel=0.2 * jitter / count**0.5 + 1e-6)
        assert sum(block.lost_samples for block in blocks) == 0
        assert sum(len(block.force) for block in blocks) == count
        first = 0
        for block in blocks:
            # of the median of 100 normal numbers, five standard deviations; sorting them takes a little away
            assert abs(block.stamp_ns - true_ns[first]) < 6.5 * jitter / 10 * period_ns
            assert 0.5 * jitter < block.clock_residual * 1e3 < 1.5 * jitter
            first += len(block.force)


def test_samples_of_a_burst_are_spread_over_their_time() -> None:
    """A driver that forwards ten samples at once stamps all of them with the time of the last one."""
    count, period_ns = 10 * CHUNK // 4, 1_000_000
    true_ns = T0 + np.arange(count) * period_ns
    sample_rate, blocks = sampled(true_ns[9::10].repeat(10))
    assert sample_rate == pytest.approx(1000.0, rel=1e-3)
    assert sum(block.lost_samples for block in blocks) == 0
    assert max(abs(block.stamp_ns - true_ns[100 * n]) for n, block in enumerate(blocks)) < 10 * period_ns
    assert 2e-3 < max(block.clock_residual for block in blocks) < 6e-3


def test_a_burst_every_50_ms_is_no_rate_of_1_mhz() -> None:
    numbers = np.arange(4000)
    sample_rate, blocks = sampled(T0 + numbers // 50 * 50_000_000 + numbers % 50 * 1000)
    assert sample_rate == pytest.approx(1000.0, rel=1e-3)
    assert sum(block.lost_samples for block in blocks) == 0


@pytest.mark.parametrize("pause_s", [2.0, 30.0, 3600.0])
@pytest.mark.parametrize(("parts", "size"), [(2, 2000), (20, 300)])
def test_pause_longer_than_the_samples_is_a_gap(parts: int, size: int, pause_s: float) -> None:
    """A triggered recording, or one that was paused: most of the time is lost, but not of the samples."""
    numbers = np.arange(parts * size)
    sample_rate, blocks = sampled(T0 + numbers * 1_000_000 + numbers // size * round(pause_s * NS))
    assert sample_rate == pytest.approx(1000.0, rel=1e-4)
    lost = [block.lost_samples for block in blocks if block.lost_samples]
    assert lost == pytest.approx([pause_s * 1000.0] * (parts - 1), rel=1e-3)


@pytest.mark.parametrize("size", [20, 50])
def test_short_events_are_no_bursts_of_a_lower_rate(size: int) -> None:
    """50 ms of an impact at 1 kHz, every 5 s, were 10 Hz without a loss: an impact lasted 100 times as long."""
    numbers = np.arange(20 * size)
    with pytest.raises(BagError, match=r"no constant rate: 1000 Hz from 0.000 s on, .* Hz on average"):
        sampled(T0 + numbers % size * 1_000_000 + numbers // size * 5 * NS)


def test_stall_is_not_a_gap() -> None:
    period_ns = 1_000_000
    true_ns = T0 + np.arange(3000) * period_ns
    stalled_ns = true_ns.copy()
    stalled_ns[1000:1040] = true_ns[1040]
    _, blocks = sampled(stalled_ns)
    assert sum(block.lost_samples for block in blocks) == 0
    gone_ns = np.delete(true_ns, slice(1000, 1040))
    _, blocks = sampled(gone_ns)
    (gap,) = [block for block in blocks if block.lost_samples]
    assert (gap.lost_samples, gap.force[0], gap.stamp_ns) == (40, 1000.0, true_ns[1040])


def test_gap_at_the_edge_of_a_chunk_is_found() -> None:
    period_ns = 100_000
    for at in (CHUNK - 1, CHUNK, CHUNK + 1, 2 * CHUNK + 63):
        times_ns = T0 + np.arange(3 * CHUNK) * period_ns
        times_ns[at:] += 7 * period_ns
        _, blocks = sampled(times_ns)
        assert [(block.lost_samples, block.force[0]) for block in blocks if block.lost_samples] == [(7, float(at))]


@pytest.mark.parametrize(("counts", "start_s"), [((190, 400, 660), 1.893), ((9000, 300), 89.999)])
def test_part_of_a_higher_rate_is_refused(counts: tuple[int, ...], start_s: float) -> None:
    """As of a logger that records events faster, at 1000 Hz in place of 100 Hz."""
    steps_ns = np.repeat([10_000_000, 1_000_000, 10_000_000][: len(counts)], counts)
    with pytest.raises(BagError, match=f"cell.csv: has no constant rate: 1000 Hz from {start_s} s on"):
        sampled(T0 + np.cumsum(steps_ns))


@pytest.mark.parametrize(
    ("times", "message"),
    [
        ([], "has 0 samples; must have at least 2"),
        ([1], "has 1 samples; must have at least 2"),
        ([5, 5, 5, 5], "its times do not advance; must be times at a constant rate"),
        (
            [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 100],
            "has no constant rate: of 101 samples at 1 Hz, 90 are missing",
        ),
    ],
)
def test_samples_without_a_constant_rate_are_refused(times: list[int], message: str) -> None:
    with pytest.raises(BagError, match=f"cell.csv: {message}"):
        sampled(np.array(times, np.int64) * NS)

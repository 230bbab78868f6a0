"""Stamped samples become blocks of a constant rate: late stamps stay where they belong, missing samples are counted."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from scara_effmass.daq.even_time import CHUNK, EvenBlocks
from scara_effmass.daq.force_file import NS

if TYPE_CHECKING:
    from scara_effmass.daq.force_file import RecordedBlock

T0 = 1_700_000_000 * NS


def stamped(times_ns: np.ndarray) -> list[tuple[int, float]]:
    """Return samples that say their own number."""
    return [(int(time), float(number)) for number, time in enumerate(times_ns)]


def cut(samples: list[tuple[int, float]], block_time: float = 0.1) -> tuple[EvenBlocks, list[RecordedBlock]]:
    even = EvenBlocks(samples, block_time, 1.0)
    return even, list(even)


@settings(max_examples=40)
@given(
    rate=st.floats(0.5, 20_000.0),
    count=st.integers(300, 6000),
    block_time=st.floats(0.005, 2.0),
    gaps=st.dictionaries(st.integers(1, 5999), st.integers(1, 1000), max_size=3),
)
def test_even_stamps_keep_their_times_and_every_gap_is_counted(
    rate: float, count: int, block_time: float, gaps: dict[int, int]
) -> None:
    numbers = np.arange(count)
    for at, lost in gaps.items():
        numbers[at:] += lost
    assume(numbers[-1] < 1.9 * count)
    times_ns = T0 + np.round(numbers * NS / rate).astype(np.int64)
    even, blocks = cut(stamped(times_ns), block_time)
    assert even.sample_rate == pytest.approx(rate, rel=1e-4)
    assert np.concatenate([block.samples for block in blocks]).tolist() == list(range(count))
    assert {int(block.samples[0]): block.lost for block in blocks if block.lost} == {
        at: lost for at, lost in gaps.items() if at < count
    }
    size = max(1, round(block_time * even.sample_rate))
    for block in blocks:
        assert len(block.samples) <= size
        assert block.stamp_ns == pytest.approx(times_ns[int(block.samples[0])], abs=2)
        assert block.clock_residual == pytest.approx(0.0, abs=2e-9)


@pytest.mark.parametrize("count", [100, 1000, 9000])
@pytest.mark.parametrize("jitter", [0.02, 0.1, 0.2, 0.3, 0.5])
def test_jitter_is_averaged_and_takes_no_samples_away(jitter: float, count: int) -> None:
    period_ns = 1_000_000
    right_ns = T0 + np.arange(count) * period_ns
    for seed in range(5):
        noise_ns = np.random.default_rng(seed).normal(0.0, jitter * period_ns, count).astype(np.int64)
        even, blocks = cut(stamped(np.sort(right_ns + noise_ns)))
        assert even.sample_rate == pytest.approx(1000.0, rel=0.2 * jitter / count**0.5 + 1e-6)
        assert sum(block.lost for block in blocks) == 0
        assert sum(len(block.samples) for block in blocks) == count
        first = 0
        for block in blocks:
            # of the median of 100 normal numbers, five standard deviations; sorting them takes a little away
            assert abs(block.stamp_ns - right_ns[first]) < 6.5 * jitter / 10 * period_ns
            assert 0.5 * jitter < block.clock_residual * 1e3 < 1.5 * jitter
            first += len(block.samples)


def test_bursts_are_spread_over_the_time_in_which_they_were_taken() -> None:
    """A driver that hands on ten samples at once stamps them all with the time of the last."""
    count, period_ns = 10 * CHUNK // 4, 1_000_000
    right_ns = T0 + np.arange(count) * period_ns
    even, blocks = cut(stamped(right_ns[9::10].repeat(10)))
    assert even.sample_rate == pytest.approx(1000.0, rel=1e-3)
    assert sum(block.lost for block in blocks) == 0
    assert max(abs(block.stamp_ns - right_ns[100 * n]) for n, block in enumerate(blocks)) < 10 * period_ns
    assert 2e-3 < max(block.clock_residual for block in blocks) < 6e-3


def test_a_stall_is_no_gap_and_a_gap_is_no_stall() -> None:
    period_ns = 1_000_000
    right_ns = T0 + np.arange(3000) * period_ns
    stalled_ns = right_ns.copy()
    stalled_ns[1000:1040] = right_ns[1040]
    _, blocks = cut(stamped(stalled_ns))
    assert sum(block.lost for block in blocks) == 0
    gone_ns = np.delete(right_ns, slice(1000, 1040))
    _, blocks = cut(stamped(gone_ns))
    (gap,) = [block for block in blocks if block.lost]
    assert (gap.lost, gap.samples[0], gap.stamp_ns) == (40, 1000.0, right_ns[1040])


def test_a_gap_far_into_a_long_stream_is_found_where_chunks_meet() -> None:
    period_ns = 100_000
    for at in (CHUNK - 1, CHUNK, CHUNK + 1, 2 * CHUNK + 63):
        times_ns = T0 + np.arange(3 * CHUNK) * period_ns
        times_ns[at:] += 7 * period_ns
        _, blocks = cut(stamped(times_ns))
        assert [(block.lost, block.samples[0]) for block in blocks if block.lost] == [(7, float(at))]


@pytest.mark.parametrize(
    ("times", "message"),
    [
        ([], "holds 0 samples; at least 2 would be right"),
        ([1], "holds 1 samples; at least 2 would be right"),
        ([5, 5, 5, 5], "its times do not advance; times at a constant rate would be right"),
        (
            [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 100],
            "is not sampled at a constant rate: of 101 samples at 1 Hz, 90 are missing",
        ),
    ],
)
def test_what_has_no_rate_is_refused(times: list[int], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        cut(stamped(np.array(times, np.int64) * NS))

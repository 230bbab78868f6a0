# SPDX-License-Identifier: Apache-2.0
"""Tests of the clock fit against simulated clocks."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.daq.clock_fit import JUMP_S, JUMP_TIME_S, SETTLED_READS, ClockFit
from scara_effmass.values import FloatArray

START_NS = 1_700_000_000_123_456_789
MS = 1_000_000
FLOOR_S = 0.2e-3


@dataclass
class Device:
    """Converter whose clock and ROS time deviate from true time by some ppm."""

    device_ppm: float = 0.0
    ros_ppm: float = 0.0
    rate: float = 12_800.0
    jumps: dict[float, float] = field(default_factory=dict)
    """Jump of ROS time [s] by true time [s]."""

    def taken_s(self, sample: int) -> float:
        return sample / (self.rate * (1.0 + self.device_ppm * 1e-6))

    def ros_ns(self, true_s: float) -> int:
        jumped = sum(jump for at, jump in self.jumps.items() if true_s >= at)
        return START_NS + round((true_s * (1.0 + self.ros_ppm * 1e-6) + jumped) * 1e9)

    def error_s(self, fit: ClockFit, sample: int) -> float:
        return (fit.stamp_ns(sample) - self.ros_ns(self.taken_s(sample))) / 1e9

    def follow(self, fit: ClockFit, delays: Sequence[float] | FloatArray, block: int = 1280) -> list[Read]:
        """Read one block per delay [s], in order."""
        reads, now_s = [], 0.0
        for i, delay in enumerate(delays):
            first, count = i * block, (i + 1) * block
            now_s = max(now_s, self.taken_s(count - 1) + delay)
            before = fit.restarts
            fit.update(count, self.ros_ns(now_s))
            errors = (self.error_s(fit, first), self.error_s(fit, count - 1))
            stamps = (fit.stamp_ns(first), fit.stamp_ns(count - 1))
            reads.append(Read(*stamps, max(errors, key=abs), fit.residual, fit.restarts > before, fit.settled))
        return reads


@dataclass
class Read:
    """Result of the fit after a read: stamps of its first and last sample, and their largest error."""

    first_ns: int
    last_ns: int
    error: float
    residual: float
    restarted: bool
    settled: bool


def usual_delays(n: int, seed: int) -> FloatArray:
    """Return delays of 0.2 ms plus 1 ms on average; one in a hundred is longer by 50 to 200 ms."""
    rng = np.random.default_rng(seed)
    delays = FLOOR_S + rng.exponential(1e-3, n)
    held_up = rng.random(n) < 0.01
    delays[held_up] += rng.uniform(0.05, 0.2, int(held_up.sum()))
    return delays


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("device_ppm", "ros_ppm"), [(50.0, 0.0), (0.0, 50.0), (50.0, -50.0), (-50.0, 50.0)])
def test_stamps_stay_within_a_millisecond_of_drifting_clocks(device_ppm: float, ros_ppm: float, seed: int) -> None:
    device = Device(device_ppm, ros_ppm)
    fit = ClockFit(12_800.0)
    reads = device.follow(fit, usual_delays(4000, seed))
    errors = np.abs([read.error for read in reads])
    assert errors[SETTLED_READS - 1 :].max() < 1e-3
    assert np.median(errors) == pytest.approx(FLOOR_S, abs=0.1e-3)  # the smallest delay cannot be observed
    assert fit.restarts == 0
    true_rate = 12_800.0 * (1.0 + device_ppm * 1e-6) / (1.0 + ros_ppm * 1e-6)
    assert fit.sample_rate == pytest.approx(true_rate, rel=10e-6)


def test_first_stamps_are_as_late_as_the_earliest_read() -> None:
    late = 0
    for seed in range(300):
        delays = usual_delays(SETTLED_READS, seed)
        device = Device(50.0, -50.0)
        reads = device.follow(ClockFit(12_800.0), delays)
        taken = np.array([device.taken_s((i + 1) * 1280 - 1) for i in range(SETTLED_READS)])
        earliest = np.minimum.accumulate(np.maximum.accumulate(taken + delays) - taken)
        # Within 1 s, the clocks diverge by 0.1 ms.
        assert all(abs(read.error) <= bound + 0.1e-3 for read, bound in zip(reads, earliest, strict=True))
        late += abs(reads[0].error) > 1e-3
        assert abs(reads[-1].error) < 1e-3
    assert late > 50  # a single read is not enough


@pytest.mark.parametrize("seed", range(3))
def test_residual_covers_the_error_of_stamps(seed: int) -> None:
    reads = Device(50.0, -50.0).follow(ClockFit(12_800.0), usual_delays(2000, seed))
    covered = [abs(read.error - FLOOR_S) <= read.residual for read in reads]
    assert np.mean(covered) > 0.95
    settled = [read.residual for read in reads[100:]]
    assert 0.02e-3 < np.median(settled) < 0.5e-3
    assert reads[0].residual == pytest.approx(10e-3)


@pytest.mark.parametrize("delay_s", [1e-3, 10e-3, 30e-3])
def test_residual_at_the_start_covers_the_delays_of_a_busy_host(delay_s: float) -> None:
    covered = []
    for seed in range(200):
        delays = np.random.default_rng(seed).exponential(delay_s, 4 * SETTLED_READS)
        reads = Device(50.0, -50.0).follow(ClockFit(12_800.0), delays)
        covered += [abs(read.error) <= read.residual for read in reads[SETTLED_READS // 2 :]]
    assert np.mean(covered) > 0.9


@given(
    rate=st.floats(1.0, 1e6),
    ppm=st.floats(-100.0, 100.0),
    block_s=st.floats(0.05, 2.0),
)
def test_reads_without_delay_give_exact_stamps_at_any_rate(rate: float, ppm: float, block_s: float) -> None:
    device = Device(device_ppm=ppm, rate=rate)
    fit = ClockFit(rate)
    block = max(1, round(rate * block_s))
    # Until the rate is known, the offset may be as old as six bins, each longer than 1 s by up to a block.
    oldest_s = 6.0 * (1.0 + block / rate) + block / rate
    # The fit moves back by at most one sample per read.
    made_up = round(abs(ppm) * 1e-6 * oldest_s * rate)
    reads = device.follow(fit, [0.0] * (max(10, round(35.0 * rate / block)) + made_up), block)
    assert max(abs(read.error) for read in reads) <= abs(ppm) * 1e-6 * oldest_s + 1e-8
    assert abs(reads[-1].error) < 1e-7
    assert fit.sample_rate == pytest.approx(rate * (1.0 + ppm * 1e-6), rel=1e-7)
    assert fit.restarts == 0


@given(
    delays=st.lists(st.floats(0.0, 0.3), min_size=1, max_size=100),
    samples=st.integers(0, 10**15),
    nanoseconds=st.integers(0, 4 * 10**18),
)
def test_fit_does_not_depend_on_sample_numbers_and_epoch(delays: list[float], samples: int, nanoseconds: int) -> None:
    plain, moved = ClockFit(12_800.0), ClockFit(12_800.0)
    for i, delay in enumerate(delays):
        count, host_ns = (i + 1) * 1280, round(((i + 1) * 0.1 + delay) * 1e9)
        plain.update(count, host_ns)
        moved.update(count + samples, host_ns + nanoseconds)
        for sample in (i * 1280, count - 1):
            assert moved.stamp_ns(sample + samples) == plain.stamp_ns(sample) + nanoseconds
    assert (plain.sample_rate, plain.residual, plain.restarts) == (moved.sample_rate, moved.residual, moved.restarts)


@given(
    delays=st.lists(st.floats(0.0, 0.02), min_size=60, max_size=200), rate=st.sampled_from([1.0, 100.0, 12_800.0, 1e6])
)
def test_no_sample_comes_before_the_previous_one(delays: list[float], rate: float) -> None:
    reads = Device(rate=rate).follow(ClockFit(rate), delays, max(1, round(rate * 0.1)))
    assert any(read.settled for read in reads)
    for before, read in pairwise(reads):
        assert read.first_ns >= before.last_ns - 1 or not read.settled  # 1 ns of rounding


def test_a_late_start_is_made_up_for_one_sample_per_read_and_told_of_meanwhile() -> None:
    late_s, reads_late = 0.5e-3, 15
    fit = ClockFit(1e6)
    reads = Device(rate=1e6).follow(fit, [late_s] * reads_late + [0.0] * 600, 100_000)
    for i, (before, read) in enumerate(pairwise(reads[reads_late - 1 :]), start=1):
        assert read.error == pytest.approx(max(0.0, late_s - i * 1e-6), abs=0.05e-6)
        assert read.first_ns >= before.last_ns - 1
        assert read.residual >= read.error
    assert reads[reads_late + 10].residual > 0.9 * late_s
    assert reads[-1].residual < 0.1e-3


@pytest.mark.parametrize(("ppm", "bound"), [(100.0, 1e-3), (-100.0, 1e-3), (500.0, 4e-3), (-500.0, 4e-3)])
def test_a_clock_that_is_slewed_is_followed(ppm: float, bound: float) -> None:
    # As NTP does it, 500 ppm at most: ROS time runs faster or slower from the 60th second on.
    fit = ClockFit(12_800.0)
    errors = []
    for i, delay in enumerate(usual_delays(2000, 4)):
        taken, read = ((t + max(0.0, t - 60.0) * ppm * 1e-6) * 1e9 for t in ((i + 1) * 0.1, (i + 1) * 0.1 + delay))
        fit.update((i + 1) * 1280, START_NS + round(read))
        errors.append(abs(fit.stamp_ns((i + 1) * 1280 - 1) - START_NS - taken) / 1e9)
    assert max(errors[SETTLED_READS:]) < bound
    assert max(errors[1200:]) < 1e-3
    assert fit.restarts == 0


@given(st.lists(st.floats(0.0, 0.1), min_size=4, max_size=4), st.floats(-100.0, 100.0))
def test_late_reads_do_not_matter_while_some_are_prompt(lateness: list[float], ppm: float) -> None:
    device = Device(device_ppm=ppm)
    fit = ClockFit(12_800.0)
    delays = [0.0, *lateness] * 80
    errors = [abs(read.error) for read in device.follow(fit, delays)]
    assert max(errors) < 1e-3
    assert max(errors[-20:]) < 0.02e-3
    assert fit.restarts == 0


def test_stamps_are_exact_after_a_year_at_1_mhz() -> None:
    fit = ClockFit(1e6)
    year = 365 * 86_400 * 10**6
    for sample in [*range(0, 40_000_000, 100_000), *range(year, year + 40_000_000, 100_000)]:
        fit.update(sample + 1, START_NS + sample * 1000)
        assert abs(fit.stamp_ns(sample) - (START_NS + sample * 1000)) < 100
    assert fit.restarts == 0


@pytest.mark.parametrize("jump", [-3600.0, -1.0, -0.02, 0.02, 1.0, 3600.0])
def test_jump_of_ros_time_restarts_the_fit(jump: float) -> None:
    device = Device(50.0, -50.0, jumps={30.0: jump})
    fit = ClockFit(12_800.0)
    reads = device.follow(fit, usual_delays(1000, 7))
    restart = next(i for i, read in enumerate(reads) if read.restarted)
    assert 30.0 <= (restart + 1) * 0.1 <= (30.2 if jump < 0.0 else 32.5)
    assert fit.restarts == 1
    assert max(abs(read.error) for read in reads[restart + SETTLED_READS :]) < 1e-3
    assert reads[restart].residual >= 0.9 * abs(jump)
    unnoticed = reads[round(30.0 / 0.1) + 2 : restart]
    assert all(read.residual >= jump - JUMP_S for read in unnoticed)
    assert reads[restart + 20].residual < 1e-3


def test_fit_follows_a_small_jump() -> None:
    for jump in (-JUMP_S / 2, JUMP_S / 2):
        fit = ClockFit(12_800.0)
        reads = Device(jumps={30.0: jump}).follow(fit, usual_delays(1000, 3))
        assert max(abs(read.error) for read in reads[300:]) < JUMP_S
        assert max(abs(read.error) for read in reads[700:]) < 1e-3


@pytest.mark.parametrize("stall_s", [1.0, 3.0, 8.0])
@pytest.mark.parametrize("late_s", [0.2e-3, 4e-3, 6e-3, 20e-3])
def test_stall_after_a_late_read_is_no_jump(late_s: float, stall_s: float) -> None:
    held_up, read_s = 199, 1e-3
    fit = ClockFit(12_800.0)
    for n in range(1, 400):
        host_s = 0.1 * n + (late_s if n == held_up else FLOOR_S)
        if n > held_up:
            host_s = max(host_s, 0.1 * held_up + stall_s + (n - held_up - 1) * read_s)
        fit.update(1280 * n, START_NS + round(host_s * 1e9))
        error_s = (fit.stamp_ns(1280 * (n - 1)) - START_NS) / 1e9 - 0.1 * (n - 1)
        assert abs(error_s) < 1e-3
    assert fit.restarts == 0


@given(
    block=st.sampled_from([320, 640, 1280, 2560]),
    before_s=st.floats(0.0, 12.0),
    late=st.lists(st.floats(0.0, 0.02), max_size=60) | st.floats(0.0, 0.02).map(lambda late_s: [late_s] * 80),
    phase=st.floats(0.0, 1.0),
    stall_s=st.floats(0.2, 10.0),
    speed=st.floats(20.0, 1000.0),
)
def test_any_stall_is_no_jump(
    block: int, before_s: float, late: list[float], phase: float, stall_s: float, speed: float
) -> None:
    block_s = block / 12_800.0
    # Reads that are late by the same amount for JUMP_TIME_S cannot be told from a jump.
    late = late[: int((JUMP_TIME_S - 2.0 * JUMP_S) / block_s) - 1]
    prompt = max(SETTLED_READS, round(before_s / block_s))
    from_s = block_s * (prompt + len(late) + phase)
    delays = [FLOOR_S] * prompt + late
    now_s = from_s + stall_s
    while (taken_s := (len(delays) + 1) * block_s) < now_s:
        delays.append(now_s - taken_s)
        now_s += block_s / speed
    fit = ClockFit(12_800.0)
    reads = Device().follow(fit, delays + [FLOOR_S] * 20, block)
    assert max(abs(read.error) for read in reads) < 25e-3
    assert fit.restarts == 0


def test_lower_sample_number_restarts_the_fit() -> None:
    fit = ClockFit(12_800.0)
    Device().follow(fit, [0.0] * 50)
    fit.update(1280, START_NS + 3600 * 10**9)
    assert fit.stamp_ns(1279) == START_NS + 3600 * 10**9
    assert fit.restarts == 1
    assert not fit.settled


def test_reset_fit_equals_a_new_fit() -> None:
    fit, fresh = ClockFit(12_800.0), ClockFit(12_800.0)
    Device(device_ppm=80.0).follow(fit, [0.0] * 100)
    fit.reset()
    assert (fit.sample_rate, fit.residual, fit.restarts, fit.settled) == (12_800.0, 10e-3, 0, False)
    slower = Device(device_ppm=-80.0)
    assert slower.follow(fit, usual_delays(100, 1)) == slower.follow(fresh, usual_delays(100, 1))


def test_first_read_gives_the_nominal_rate() -> None:
    fit = ClockFit(1000.0)
    with pytest.raises(RuntimeError, match="before the first read"):
        fit.stamp_ns(0)
    fit.update(100, START_NS)
    assert fit.stamp_ns(99) == START_NS
    assert fit.stamp_ns(0) == START_NS - 99 * MS
    assert fit.sample_rate == 1000.0


def test_memory_does_not_grow() -> None:
    fit = ClockFit(10.0)
    sizes = []
    for first in range(0, 20_000, 1000):
        for i in range(first, first + 1000):
            fit.update(i + 1, START_NS + i * 100 * MS)
        sizes.append(len(pickle.dumps(fit)))
    assert max(sizes) < 1.1 * sizes[0]

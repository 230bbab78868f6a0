# SPDX-License-Identifier: Apache-2.0
import math
import tracemalloc
from itertools import pairwise
from statistics import NormalDist

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.sim.measurement import (
    CHANNEL_SPACING,
    DURATIONS,
    MAX_COUNT,
    NOISE_SAMPLES,
    PEAKS,
    REBOUND_GAPS,
    REBOUND_PEAKS,
    ForceSensor,
    Pulse,
    RandomPulses,
    SyntheticSignal,
)
from scara_effmass.studies.shipped_bags import NOISE, TOUR_PULSES, synthetic_force

RATE = 12_800.0
START_NS = 5_000_000_000


def signal(
    *, channels: int = 1, noise: float = 0.1, seed: int = 7, period: float | None = 0.3, pulses: tuple[Pulse, ...] = ()
) -> SyntheticSignal:
    schedule = (lambda *_: pulses) if period is None or pulses else RandomPulses(seed, RATE, period)
    return SyntheticSignal(channels, ForceSensor(noise=noise, seed=seed), schedule)


SIGNAL = signal(channels=3)
WHOLE = SIGNAL.samples(0, 40_000)


@given(st.lists(st.integers(0, 40_000), max_size=20))
def test_samples_do_not_depend_on_the_block_size(cuts: list[int]) -> None:
    bounds = sorted({0, *cuts, 40_000})
    blocks = [SIGNAL.samples(first, end - first) for first, end in pairwise(bounds)]
    assert np.array_equal(np.concatenate(blocks, axis=1), WHOLE)


def test_equal_seeds_give_equal_samples_and_different_seeds_independent_ones() -> None:
    assert np.array_equal(signal(channels=3).samples(0, 40_000), WHOLE)
    other = signal(channels=3, seed=8).samples(0, 40_000)
    assert abs(float(np.corrcoef(other[0], WHOLE[0])[0, 1])) < 0.05


def test_samples_never_change() -> None:
    # If they do, increase REVISION of the recordings, which contain such samples.
    counts = np.rint(WHOLE[:2, :4] / SIGNAL.sensor.step).astype(int).tolist()
    assert counts == [[-107, 16, -15, -25], [-66, 29, -133, 111]]


def test_samples_are_whole_counts_of_24_bits_over_60_v_and_read_only() -> None:
    assert pytest.approx(60.0 / 2**24 / 2.248e-3, rel=1e-6) == SIGNAL.sensor.step
    counts = WHOLE / SIGNAL.sensor.step
    assert np.abs(counts - np.rint(counts)).max() < 1e-9
    with pytest.raises(ValueError, match="read-only"):
        WHOLE[0, 0] = 0.0


def test_without_noise_and_pulses_the_force_is_zero() -> None:
    assert not signal(noise=0.0, period=None).samples(12, 1000).any()


def test_noise_is_normal_and_white() -> None:
    (noise,) = signal(noise=2.0, period=None).samples(0, NOISE_SAMPLES) / 2.0
    # Bounds are five standard errors of two million numbers.
    error = 5.0 / math.sqrt(NOISE_SAMPLES)
    assert abs(noise.mean()) < error
    assert noise.std() == pytest.approx(1.0, abs=error)
    for sigma in (-3.0, -1.0, 0.5, 2.0, 4.0):
        share = NormalDist().cdf(sigma)
        assert np.mean(noise < sigma) == pytest.approx(share, abs=error * math.sqrt(share * (1.0 - share)) + 2e-7)
    for lag in (1, 2, 3, 2**15):
        assert abs(np.mean(noise[lag:] * noise[:-lag])) < error


def test_noise_is_periodic_and_shared_by_the_channels() -> None:
    quiet = signal(channels=2, period=None)
    start = quiet.samples(0, 1000)
    assert np.array_equal(quiet.samples(NOISE_SAMPLES, 1000), start)
    assert np.array_equal(quiet.samples(CHANNEL_SPACING, 1000)[0], start[1])
    # A block may be longer than the noise.
    long = quiet.samples(NOISE_SAMPLES - 10, NOISE_SAMPLES + 20)
    assert np.array_equal(long[:, 10:1010], start)
    assert np.array_equal(long[:, NOISE_SAMPLES + 10 :], start[:, :10])


pulses = st.builds(
    Pulse, onset_s=st.floats(1e-3, 2e-3), peak_force=st.floats(1.0, 1000.0), duration=st.floats(0.5e-3, 4e-3)
)


@given(pulses)
def test_pulse_is_sampled_at_its_onset(pulse: Pulse) -> None:
    first, force = pulse.sample(RATE)
    times = np.arange(first, first + len(force)) / RATE - pulse.onset_s
    assert -1e-12 <= times[0] < 1.0 / RATE
    assert pulse.duration - 1.0 / RATE < times[-1] <= pulse.duration * (1.0 + 1e-9)
    assert force == pytest.approx(pulse.peak_force * np.sin(np.pi * times / pulse.duration), abs=1e-8)


@given(pulses)
def test_impulse_is_the_integral(pulse: Pulse) -> None:
    _, force = pulse._replace(onset_s=0.0).sample(1e6)
    assert pulse.impulse == pytest.approx(float(force.sum()) * 1e-6, rel=1e-4)


def test_samples_are_noise_plus_pulses() -> None:
    end = 60 * int(RATE)
    expected = np.zeros(2 * end)
    schedule = list(signal().pulses(0, 0, end))
    for pulse in schedule:
        first, force = pulse.sample(RATE)
        expected[first : first + len(force)] += force
    difference = signal().samples(0, end)[0] - signal(period=None).samples(0, end)[0]
    assert np.abs(difference - expected[:end]).max() < 0.51 * SIGNAL.sensor.step
    assert len(schedule) > 190
    assert sum(pulse.rebound for pulse in schedule) > 20


def test_random_pulses_have_the_stated_frequency_and_ranges() -> None:
    schedule = list(RandomPulses(seed=1, sample_rate=RATE, period=2.0)(0, 0, int(2000 * 2.0 * RATE)))
    first = [pulse for pulse in schedule if not pulse.rebound]
    assert len(first) == pytest.approx(2000, abs=2)
    assert first[0].onset_s >= 0.75 * 2.0  # leaves time for a tare
    apart = np.diff([pulse.onset_s for pulse in first])
    assert 1.0 <= apart.min() <= apart.max() <= 3.0
    assert apart.std() > 0.3
    peaks, durations = (np.array([getattr(pulse, name) for pulse in first]) for name in ("peak_force", "duration"))
    assert PEAKS[0] <= peaks.min() < 21.0
    assert 780.0 < peaks.max() <= PEAKS[1]
    assert DURATIONS[0] <= durations.min() < 0.51e-3
    assert 3.99e-3 < durations.max() <= DURATIONS[1]
    # Onsets are uniform between two samples.
    assert np.mean([pulse.onset_s * RATE % 1.0 for pulse in first]) == pytest.approx(0.5, abs=0.03)
    pairs = [(pulse, rebound) for pulse, rebound in pairwise(schedule) if rebound.rebound]
    assert len(pairs) == pytest.approx(400, abs=80)
    for pulse, rebound in pairs:
        assert (pulse.rebound, rebound.rebound) == (0, 1)
        gap = rebound.onset_s - pulse.onset_s - pulse.duration
        assert REBOUND_GAPS[0] - 1e-9 <= gap <= REBOUND_GAPS[1] + 1e-9
        assert REBOUND_PEAKS[0] <= rebound.peak_force / pulse.peak_force <= REBOUND_PEAKS[1]


@given(st.floats(0.1, 5.0), st.sampled_from([1000.0, RATE, 128_000.0]), st.integers(0, 3))
def test_random_pulses_never_overlap(period: float, rate: float, seed: int) -> None:
    schedule = RandomPulses(seed, rate, period)(0, 0, int(50 * period * rate))
    for pulse, following in pairwise(schedule):
        assert pulse.onset_s + pulse.duration < following.onset_s


@given(st.integers(0, 10**9), st.integers(1, 200_000), st.integers(0, 2))
def test_schedule_gives_the_pulses_that_reach_into_the_block(first: int, count: int, channel: int) -> None:
    schedule = RandomPulses(3, RATE, 0.5)
    around = schedule(channel, max(0, first - 100_000), first + count + 100_000)
    reaching = {p for p in around if p.onset_s * RATE < first + count and (p.onset_s + p.duration) * RATE >= first}
    assert reaching <= set(schedule(channel, first, first + count))


def test_channels_have_different_pulses() -> None:
    onsets = [{pulse.onset_s for pulse in SIGNAL.pulses(channel, 0, 40_000)} for channel in (0, 1)]
    assert onsets[0].isdisjoint(onsets[1])


def test_force_beyond_the_range_is_clipped() -> None:
    # 30 V at 2.248 mV/N are 13 345 N.
    high = signal(noise=0.0, pulses=(Pulse(100.5 / RATE, 26_690.0, 2e-3),))
    (force,) = high.samples(0, 200)
    assert force.max() == high.limit == high.sensor.step * MAX_COUNT == pytest.approx(13_345.2, abs=0.1)
    assert np.count_nonzero(force == high.limit) == pytest.approx(2e-3 * RATE * 2.0 / 3.0, abs=1)


def test_eight_channels_need_no_more_memory_than_one_noise() -> None:
    tracemalloc.start()
    many = signal(channels=8)
    for number in range(20):
        many.samples(number * 1280, 1280)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 20_000_000


def test_blocks_are_consecutive_and_marked_simulated() -> None:
    blocks = list(synthetic_force(TOUR_PULSES, 2.05, START_NS, seed=1))
    assert len(blocks) == 20  # whole blocks only
    assert [block.first_sample for block in blocks] == [number * 1280 for number in range(20)]
    assert [block.stamp_ns for block in blocks] == [START_NS + number * 100_000_000 for number in range(20)]
    assert {len(block.force) for block in blocks} == {1280}
    assert all(block.simulated and block.source.startswith("simulated") for block in blocks)
    assert not any(block.force.flags.writeable for block in blocks)


def test_recorded_force_is_noise_plus_the_chosen_pulses() -> None:
    # The second pulse spans two blocks.
    chosen = (Pulse(0.25001, 300.0, 2e-3), Pulse(0.2999, 50.0, 1e-3, rebound=1))
    force = np.concatenate([block.force for block in synthetic_force(chosen, 1.0, START_NS, seed=1)])
    expected = np.zeros(len(force))
    for pulse in chosen:
        times = np.arange(len(force)) / RATE - pulse.onset_s
        during = (times >= 0.0) & (times <= pulse.duration)
        expected += np.where(during, pulse.peak_force * np.sin(np.pi * times / pulse.duration), 0.0)
    noise = force - expected
    assert np.abs(noise).max() < 6.0 * NOISE
    assert noise.std() == pytest.approx(NOISE, rel=0.03)


def test_pulses_of_the_tour_do_not_overlap_and_leave_time_for_a_tare() -> None:
    ends = [0.6, *(pulse.onset_s + pulse.duration for pulse in TOUR_PULSES)]
    assert all(pulse.onset_s > end for pulse, end in zip(TOUR_PULSES, ends, strict=False))
    assert [pulse.rebound for pulse in TOUR_PULSES].count(1) == 1

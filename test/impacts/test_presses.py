# SPDX-License-Identifier: Apache-2.0
"""Slow presses and loads are contacts that stay, no impacts, whichever samples are missing or held."""

from collections.abc import Callable, Iterable
from itertools import accumulate, pairwise

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from scara_effmass.impacts.detector import Detector
from scara_effmass.settings import DetectionSettings
from scara_effmass.values import BoolArray, FloatArray, Impact
from test.impacts.conftest import AddPulse, Detect, MakeBlock

RATES = (100.0, 500.0, 1_000.0)
NOISE = 0.1
PRESSES = 7
PERIOD = 5.0
"""Time from one press to the next [s]; a press takes 3 s."""
BURSTS = st.lists(st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 0.1)), max_size=60)
"""Start (as a share of the signal) and duration [s] of missing or held samples."""


def presses(rate: float, seed: int) -> FloatArray:
    """Return seven presses of 20 to 60 N, in noise, that rise within 0.2 s and swing by 30 %."""
    rng = np.random.default_rng(seed)
    time = np.arange(round((PRESSES * PERIOD + 2.0) * rate)) / rate
    force = rng.normal(0.0, NOISE, time.size)
    for start in 2.0 + PERIOD * np.arange(PRESSES):
        at = time - start
        shape = np.clip(at / 0.2, 0.0, 1.0) * np.clip((3.0 - at) / 0.2, 0.0, 1.0)
        swing = 1.0 + 0.3 * np.sin(2.0 * np.pi * rng.uniform(0.5, 3.0) * at)
        force += rng.uniform(20.0, 60.0) * shape * swing
    return force


def marks(force: FloatArray, rate: float, bursts: list[tuple[float, float]]) -> BoolArray:
    """Return a mask of the samples of `force` in any of the `bursts`."""
    marked = np.zeros(force.size, dtype=np.bool_)
    for start, duration in bursts:
        first = 1 + int(start * (force.size - 2))
        marked[first : first + 1 + int(duration * rate)] = True
    return marked


def quick(impacts: Iterable[Impact]) -> list[Impact]:
    """Return those of `impacts` that are no presses."""
    return [impact for impact in impacts if not impact.is_press]


def detect_present(make_block: MakeBlock, force: FloatArray, rate: float, present: BoolArray) -> tuple[int, Detector]:
    """Return the number of quick impacts in the `present` samples; the blocks state the others as lost."""
    detector, impacts, end = Detector(DetectionSettings()), 0, 0
    edges = np.flatnonzero(np.diff(present.astype(np.int8), prepend=0, append=0)).reshape(-1, 2)
    for first, stop in edges.tolist():
        impacts += len(quick(detector.feed(make_block(force[first:stop], first, rate, lost=first - end))))
        end = stop
    return impacts + len(quick(detector.finish())), detector


@pytest.mark.parametrize("duration", [0.2, 0.4, 0.8])
@pytest.mark.parametrize("corner", [0.1, 0.5])
def test_undershoot_of_ac_coupling_is_no_noise_that_hides_its_press(
    detect: Detect, corner: float, duration: float
) -> None:
    """The undershoot of up to 90 N decays within the segment of the press."""
    rate, rng = 2_000.0, np.random.default_rng(0)
    time = np.arange(round(8.0 * rate)) / rate
    force = 100.0 * np.clip((time - 2.0) / 0.01, 0.0, 1.0) * np.clip((2.0 + duration - time) / 0.01, 0.0, 1.0)
    keep = np.exp(-2.0 * np.pi * corner / rate)
    mean = np.array(list(accumulate(force, lambda mean, sample: keep * mean + (1.0 - keep) * sample)))
    impacts, detector = detect(force - mean + rng.normal(0.0, NOISE, force.size), rate)
    (impact,) = impacts
    assert impact.peak_force == pytest.approx(100.0, abs=2.5)
    assert impact.duration == pytest.approx(duration, abs=0.05)
    assert all(item.peak_force < 15.0 for item in detector.left_out)


@pytest.mark.parametrize("rate", [*RATES, 12_800.0])
def test_presses_are_contacts_with_a_held_force_and_no_impacts(detect: Detect, rate: float) -> None:
    force = presses(rate, 1)
    impacts, detector = detect(force, rate)
    assert (quick(impacts), detector.sustained_contacts) == ([], PRESSES)
    starts = 2.0 + PERIOD * np.arange(PRESSES)
    assert [impact.onset_sample / rate for impact in impacts] == pytest.approx(starts.tolist(), abs=0.1)
    assert [impact.duration for impact in impacts] == pytest.approx([3.0] * PRESSES, abs=0.2)
    assert [impact.load_force for impact in impacts] == [0.0] * PRESSES
    for start, impact in zip(starts, impacts, strict=True):
        later = force[round((start + 0.55) * rate) : round((start + 3.0) * rate)]
        assert impact.held_force == pytest.approx(later.max(), abs=4.0 * NOISE)
        early = force[round(start * rate) :][: round(0.52 * rate)]
        assert impact.peak_force == pytest.approx(early.max(), abs=2.0)
    assert list(detector.left_out) == []


@pytest.mark.parametrize("rate", [*RATES, 12_800.0])
def test_every_fiftieth_sample_missing_makes_no_impact(make_block: MakeBlock, rate: float) -> None:
    force = presses(rate, 1)
    present = np.random.default_rng(2).random(force.size) > 0.02
    impacts, detector = detect_present(make_block, force, rate, present)
    assert (impacts, detector.sustained_contacts) == (0, PRESSES)


@settings(max_examples=15)
@given(st.sampled_from(RATES), st.integers(0, 2**32), BURSTS)
def test_no_impact_comes_out_of_a_gap(
    make_block: MakeBlock, rate: float, seed: int, bursts: list[tuple[float, float]]
) -> None:
    force = presses(rate, seed)
    impacts, detector = detect_present(make_block, force, rate, ~marks(force, rate, bursts))
    assert (impacts, detector.sustained_contacts) == (0, PRESSES)


@settings(max_examples=15)
@given(st.sampled_from(RATES), st.integers(0, 2**32), BURSTS)
def test_no_impact_comes_out_of_a_held_value(
    detect: Detect, rate: float, seed: int, bursts: list[tuple[float, float]]
) -> None:
    """A press whose beginning was held rises like an impact."""
    force = presses(rate, seed)
    held = marks(force, rate, bursts)
    latest = np.maximum.accumulate(np.where(held, 0, np.arange(force.size)))
    impacts, detector = detect(force[latest], rate)
    onsets = [round(impact.onset_sample) for impact in quick(impacts)]
    assert all(held[onset - 2 : onset + 2].any() for onset in onsets)
    assert detector.sustained_contacts == PRESSES


@settings(max_examples=10)
@given(st.sampled_from((*RATES[1:], 12_800.0)), st.integers(0, 2**32), st.floats(0.02, 0.2))
def test_scattered_zeros_make_no_impact(detect: Detect, rate: float, seed: int, share: float) -> None:
    force = presses(rate, seed)
    force[np.random.default_rng(seed).random(force.size) < share] = 0.0
    impacts, detector = detect(force, rate)
    assert (quick(impacts), detector.sustained_contacts) == ([], PRESSES)


@settings(max_examples=10)
@given(st.sampled_from((*RATES[1:], 12_800.0)), st.integers(0, 2**32), st.floats(0.02, 0.2))
def test_zeros_only_under_load_make_no_impact(detect: Detect, rate: float, seed: int, share: float) -> None:
    force = presses(rate, seed)
    force[(np.random.default_rng(seed).random(force.size) < share) & (force > 1.0)] = 0.0
    impacts, detector = detect(force, rate)
    assert (quick(impacts), detector.sustained_contacts) == ([], PRESSES)


@pytest.mark.parametrize("rate", [500.0, 1_000.0])
def test_presses_of_a_slow_and_coarse_sensor(detect: Detect, rate: float) -> None:
    """Each sample of the sensor is recorded five times, in steps of 0.5 N."""
    force = np.round(presses(rate, 1) / 0.5) * 0.5
    impacts, detector = detect(np.repeat(force[::5], 5), rate)
    assert (quick(impacts), detector.sustained_contacts) == ([], PRESSES)


@settings(max_examples=30)
@given(
    rate=st.sampled_from((1_000.0, 12_800.0)),
    load=st.floats(10.0, 200.0),
    swing=st.floats(0.0, 1.2),
    frequency=st.floats(5.0, 60.0),
    damping=st.floats(0.01, 0.3),
    shaking=st.floats(0.0, 0.4),
)
def test_a_load_step_is_no_series_of_rebounds(
    detect: Detect, rate: float, load: float, swing: float, frequency: float, damping: float, shaking: float
) -> None:
    """A load shakes and rings, also below zero."""
    rng, time = np.random.default_rng(0), np.arange(-2.0, 4.0, 1.0 / rate)
    since = np.maximum(time, 0.0)
    ringing = np.exp(-damping * 2.0 * np.pi * frequency * since) * np.cos(2.0 * np.pi * frequency * since)
    force = np.where(time >= 0.0, load * (1.0 - swing * ringing), 0.0) + rng.normal(0.0, NOISE, time.size)
    force[time >= 0.0] += rng.normal(0.0, shaking * load, int(np.count_nonzero(time >= 0.0)))
    impacts, detector = detect(force, rate)
    assert [impact.rebound for impact in impacts] == [0]
    assert detector.sustained_contacts == 1


@settings(max_examples=20)
@given(
    rate=st.sampled_from((1_000.0, 12_800.0)),
    noise=st.floats(0.1, 0.5),
    level=st.floats(1.0, 1.5),
    seed=st.integers(0, 2**32),
)
def test_a_noisy_load_step_near_the_threshold_is_one_contact(
    detect: Detect, rate: float, noise: float, level: float, seed: int
) -> None:
    """The noise under load is five times that of the baseline, and falls below the threshold."""
    rng, time = np.random.default_rng(seed), np.arange(-2.0, 4.0, 1.0 / rate)
    force = rng.normal(0.0, noise, time.size)
    loaded = int(np.count_nonzero(time >= 0.0))
    force[-loaded:] = level * DetectionSettings().threshold + rng.normal(0.0, 5.0 * noise, loaded)
    impacts, detector = detect(force, rate)
    assert (len(impacts), detector.sustained_contacts) == (1, 1)


Signal = Callable[[float, int], FloatArray]


@pytest.fixture(scope="module")
def impacts_and_presses(add_pulse: AddPulse) -> Signal:
    """Return the function that makes presses, each after an impact of 20 to 300 ms and 20 to 100 N."""

    def make(rate: float, seed: int) -> FloatArray:
        rng, force = np.random.default_rng(seed), presses(rate, seed)
        for start in 1.0 + PERIOD * np.arange(PRESSES):
            duration = max(rng.uniform(0.02, 0.3), 6.0 / rate)
            add_pulse(force, (start - rng.uniform(0.0, 0.3)) * rate, duration, rng.uniform(20.0, 100.0), rate)
        return force

    return make


def assert_same(impacts: list[Impact], others: list[Impact], offset: int) -> None:
    assert len(impacts) == len(others)
    for impact, other in zip(impacts, others, strict=True):
        assert other.onset_sample + offset == pytest.approx(impact.onset_sample, abs=1.5)
        assert other.peak_force == pytest.approx(impact.peak_force, abs=2.0 * NOISE)
        assert (other.incomplete, other.rebound) == (impact.incomplete, impact.rebound)


@settings(max_examples=15)
@given(st.sampled_from(RATES), st.integers(0, 2**32), st.integers(0, 20), st.integers(0, 20))
def test_a_signal_some_samples_shorter_has_the_same_impacts(
    detect: Detect, impacts_and_presses: Signal, rate: float, seed: int, at_start: int, at_end: int
) -> None:
    force = impacts_and_presses(rate, seed)
    whole, detector = detect(force, rate)
    assert (len(whole), detector.sustained_contacts) == (2 * PRESSES, PRESSES)  # the presses are contacts, too
    shorter, _ = detect(force[at_start : force.size - at_end], rate)
    assert_same(whole, shorter, at_start)


@settings(max_examples=15)
@example(500.0, 63, [(0.0814, 0.094)])  # a gap one second after the begin of a press
@given(st.sampled_from(RATES), st.integers(0, 2**32), BURSTS)
def test_a_gap_changes_only_the_impact_that_it_meets(
    make_block: MakeBlock,
    detect: Detect,
    impacts_and_presses: Signal,
    rate: float,
    seed: int,
    bursts: list[tuple[float, float]],
) -> None:
    force = impacts_and_presses(rate, seed)
    missing = marks(force, rate, bursts)
    whole, _ = detect(force, rate)
    for impact in whole:  # an impact that is gone in part, or whose surroundings are, has another test
        around = slice(int(impact.onset_sample - 0.3 * rate), int(impact.onset_sample + (impact.duration + 0.3) * rate))
        missing[around] = False
    detector, impacts = Detector(DetectionSettings()), []
    edges = [0, *(np.flatnonzero(np.diff(missing)) + 1).tolist(), force.size]
    for first, stop in pairwise(edges):
        if not missing[first]:
            impacts += detector.feed(make_block(force[first:stop], first, rate))
    assert_same(whole, [*impacts, *detector.finish()], 0)

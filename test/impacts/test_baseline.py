# SPDX-License-Identifier: Apache-2.0
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.impacts.segment import (
    BASELINE_FRAMES,
    Baseline,
    Frame,
    improbable_run_length,
    longest_flat_run,
    median_and_deviation,
    quantisation_deviation,
)
from scara_effmass.settings import DetectionSettings


def test_the_spread_of_gaussian_noise_is_its_standard_deviation_whatever_the_outliers() -> None:
    samples = np.random.default_rng(0).normal(3.0, 0.2, 100_000)
    samples[:5_000] = 1e3
    centre, spread = median_and_deviation(samples)
    assert centre == pytest.approx(3.0, abs=0.02)
    assert spread == pytest.approx(0.2, rel=0.1)


@pytest.mark.parametrize("noise", [0.25, 0.3, 0.4, 0.7])
def test_the_spread_of_rounded_noise_is_not_less_than_its_standard_deviation(noise: float) -> None:
    samples = np.round(np.random.default_rng(0).normal(0.0, noise, (BASELINE_FRAMES, 1_000)))
    baseline = Baseline(DetectionSettings(), map(Frame, samples))
    assert 0.9 * noise <= baseline.noise <= max(0.75, 1.2 * noise)  # 0.74 steps where most samples are equal


def test_a_constant_has_no_spread() -> None:
    assert median_and_deviation(np.full(9, 7.0)) == (7.0, 0.0)
    assert quantisation_deviation(np.full(9, 7.0), 7.0) == 0.0


@pytest.mark.parametrize(("missing", "is_present"), [(0, True), (20, True), (21, False), (39, False), (40, False)])
def test_a_frame_is_present_if_half_of_its_samples_are(missing: int, *, is_present: bool) -> None:
    samples = np.arange(40.0)
    samples[:missing] = np.nan
    assert Frame(samples).is_present == is_present


@pytest.mark.parametrize("share", [0.3, 0.7])
def test_a_run_is_as_improbable_as_asked(share: float) -> None:
    length = improbable_run_length(share, 1e-6)
    assert share**length <= 1e-6 < share ** (length - 1)
    assert improbable_run_length(1.0, 1e-6) == sys.maxsize


@pytest.mark.parametrize(("size", "flat_run"), [(100, 5), (640, 4), (6_400, 3)])
def test_fewer_equal_samples_are_a_dropout_the_more_samples_show_that_they_are_rare(size: int, flat_run: int) -> None:
    samples = np.random.default_rng(0).normal(0.0, 0.1, (BASELINE_FRAMES, size))
    assert Baseline(DetectionSettings(), map(Frame, samples)).flat_run == flat_run


@pytest.mark.parametrize("size", [8, 128, 129, 640, 6400])
def test_a_frame_keeps_little(size: int) -> None:
    assert 8 <= Frame(np.arange(float(size))).subsamples.size <= 128


def test_levels_follow_from_the_last_quiet_frames() -> None:
    noise = np.random.default_rng(0)
    baseline = Baseline(DetectionSettings(threshold=1.0, noise_factor=10.0))
    assert baseline.threshold == np.inf
    baseline = baseline.extended([Frame(noise.normal(5.0, 0.01, 640)) for _ in range(BASELINE_FRAMES)])
    assert baseline.force == pytest.approx(5.0, abs=0.01)
    assert baseline.threshold == 1.0
    assert baseline.zero_run == 2  # 5 N from zero, which quiet samples therefore never are
    baseline = baseline.extended([Frame(noise.normal(0.0, 1.0, 640)) for _ in range(BASELINE_FRAMES)])
    assert baseline.noise == pytest.approx(1.0, rel=0.2)
    assert baseline.threshold == pytest.approx(10.0 * baseline.noise)


def test_a_ramp_is_not_steady() -> None:
    baseline = Baseline(DetectionSettings())
    noise = np.random.default_rng(0).normal(0.0, 0.1, (BASELINE_FRAMES, 640))
    assert baseline.is_steady([Frame(frame) for frame in noise])
    ramp = noise + np.linspace(0.0, 50.0, noise.size).reshape(noise.shape)
    assert not baseline.is_steady([Frame(frame) for frame in ramp])
    noise[0] += 20.0
    frames = [Frame(frame) for frame in noise]
    assert not baseline.is_steady(frames)
    assert baseline.is_steady(frames, 0.8)


@pytest.mark.parametrize(("step", "steady"), [(2.0, True), (2.8, True), (3.2, False)])
def test_steady_levels_differ_by_at_most_three_standard_deviations(step: float, *, steady: bool) -> None:
    frame = np.random.default_rng(0).normal(0.0, 10.0, 640)
    deviation = median_and_deviation(Frame(frame).subsamples)[1]
    frames = [Frame(frame) for _ in range(4)] + [Frame(frame + step * deviation)]
    assert Baseline(DetectionSettings()).is_steady(frames) == steady


@given(
    st.lists(st.floats(-8.0, 8.0), min_size=BASELINE_FRAMES, max_size=BASELINE_FRAMES),
    st.floats(-16.0, 16.0),
    st.floats(0.01, 3.0),
    st.sampled_from((0.0, 1e-3, 1.0)),
)
def test_quiet_is_what_is_within_the_level_and_not_stuck(
    centres: list[float], force: float, noise: float, step: float
) -> None:
    draws = np.random.default_rng(0).normal(0.0, noise, (BASELINE_FRAMES + 1, 40))
    samples = draws + np.array([*centres, force])[:, np.newaxis]
    samples = np.round(samples / step) * step if step else samples
    baseline = Baseline(DetectionSettings(), map(Frame, samples[:-1]))
    within = bool(np.all(np.abs(samples[-1] - baseline.force) <= baseline.threshold))
    expected = within and longest_flat_run(samples[-1]) < baseline.flat_run
    assert Baseline(DetectionSettings(), map(Frame, samples[:-1])).is_quiet(Frame(samples[-1])) == expected

from __future__ import annotations

import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.impacts.background import (
    FRAMES,
    Background,
    Frame,
    centre_and_spread,
    median,
    rounded_spread,
    run_beyond_chance,
)
from scara_effmass.impacts.faults import has_flat_run
from scara_effmass.settings import DetectionSettings


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=50))
def test_median_is_numpys(values: list[float]) -> None:
    assert median(np.array(values)) == np.median(values)


def test_the_spread_of_gaussian_noise_is_its_standard_deviation_whatever_the_outliers() -> None:
    samples = np.random.default_rng(0).normal(3.0, 0.2, 100_000)
    samples[:5_000] = 1e3
    centre, spread = centre_and_spread(samples)
    assert centre == pytest.approx(3.0, abs=0.02)
    assert spread == pytest.approx(0.2, rel=0.1)


@pytest.mark.parametrize("noise", [0.25, 0.3, 0.4, 0.7])
def test_the_spread_of_rounded_noise_is_not_less_than_its_standard_deviation(noise: float) -> None:
    samples = np.round(np.random.default_rng(0).normal(0.0, noise, (FRAMES, 1_000)))
    background = Background(DetectionSettings(), map(Frame, samples))
    assert background.noise >= 0.9 * noise


def test_a_constant_has_no_spread() -> None:
    assert centre_and_spread(np.full(9, 7.0)) == (7.0, 0.0)
    assert rounded_spread(np.full(9, 7.0), 7.0) == 0.0


def test_a_run_is_as_improbable_as_asked() -> None:
    length = run_beyond_chance(0.3, 1e-6)
    assert 0.3**length <= 1e-6 < 0.3 ** (length - 1)
    assert run_beyond_chance(1.0, 1e-6) == sys.maxsize


@pytest.mark.parametrize("size", [8, 128, 129, 640, 6400])
def test_a_frame_keeps_little(size: int) -> None:
    samples = np.arange(float(size))
    samples[3] = samples[2]
    frame = Frame(samples)
    assert 8 <= frame.kept.size <= 128
    assert (frame.samples.size, frame.equal, frame.zero) == (size, 1, 1)


def test_levels_follow_from_the_last_quiet_frames() -> None:
    noise = np.random.default_rng(0)
    background = Background(DetectionSettings(threshold=1.0, noise_factor=10.0))
    assert background.level == np.inf
    background = background.followed_by([Frame(noise.normal(5.0, 0.01, 640)) for _ in range(FRAMES)])
    assert background.baseline == pytest.approx(5.0, abs=0.01)
    assert background.level == 1.0
    assert background.zero_run == 2  # 5 N from zero, which quiet samples therefore never are
    background = background.followed_by([Frame(noise.normal(0.0, 1.0, 640)) for _ in range(FRAMES)])
    assert background.noise == pytest.approx(1.0, rel=0.2)
    assert background.level == pytest.approx(10.0 * background.noise)


def test_a_ramp_is_not_steady() -> None:
    background = Background(DetectionSettings())
    noise = np.random.default_rng(0).normal(0.0, 0.1, (FRAMES, 640))
    assert background.steady([Frame(frame) for frame in noise])
    ramp = noise + np.linspace(0.0, 50.0, noise.size).reshape(noise.shape)
    assert not background.steady([Frame(frame) for frame in ramp])
    noise[0] += 20.0
    frames = [Frame(frame) for frame in noise]
    assert not background.steady(frames)
    assert background.steady(frames, 0.8)


@given(
    st.lists(st.floats(-8.0, 8.0), min_size=FRAMES, max_size=FRAMES),
    st.floats(-16.0, 16.0),
    st.floats(0.01, 3.0),
    st.sampled_from((0.0, 1e-3, 1.0)),
)
def test_quiet_is_what_is_within_the_level_and_not_stuck(
    centres: list[float], force: float, noise: float, step: float
) -> None:
    draws = np.random.default_rng(0).normal(0.0, noise, (FRAMES + 1, 40))
    samples = draws + np.array([*centres, force])[:, np.newaxis]
    samples = np.round(samples / step) * step if step else samples
    background = Background(DetectionSettings(), map(Frame, samples[:-1]))
    within = bool(np.all(np.abs(samples[-1] - background.baseline) <= background.level))
    expected = within and not has_flat_run(samples[-1], background.flat_run)
    assert Background(DetectionSettings(), map(Frame, samples[:-1])).is_quiet(Frame(samples[-1])) == expected

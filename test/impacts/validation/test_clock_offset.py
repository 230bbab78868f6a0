# SPDX-License-Identifier: Apache-2.0
"""The kink in the velocity is found to a fraction of the state period, and only where there is one."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scara_effmass.impacts.state_history import LONGEST_CONTACT_S, Kink, clock_offset, recording_offset, velocity_kink
from scara_effmass.values import FloatArray

DURATION = 2e-3


def velocity_at(times: FloatArray, onset: float, loss: float = 0.2, slope: float = 0.0) -> FloatArray:
    """Return the velocity (n, 3) of a contact point at 0.25 m/s that a half-sine force slows by `loss` [m/s]."""
    phase = np.clip((times - onset) / DURATION, 0.0, 1.0)
    speed = 0.25 + slope * times - 0.5 * loss * (1.0 - np.cos(np.pi * phase))
    return np.asarray(speed[:, None] * np.array([0.6, -0.8, 0.0]))


@given(st.floats(-0.03, 0.03), st.sampled_from([1e-3, 2e-3, 4e-3]), st.floats(0.0, 1.0), st.floats(0.03, 0.45))
def test_an_offset_is_found_within_the_resolution(onset: float, period: float, phase: float, loss: float) -> None:
    times = np.arange(-0.05 + phase * period, 0.05, period)
    noise = np.random.default_rng(0).normal(0.0, 1e-4, (times.size, 3))
    kink = velocity_kink(times, velocity_at(times, onset, loss, slope=0.5) + noise, DURATION)
    assert kink is not None
    assert kink.resolution == pytest.approx(0.5 * period, rel=1e-6)
    assert kink.delay == pytest.approx(onset, abs=kink.resolution + 1e-4)


@pytest.mark.parametrize("period", [1e-3, 2e-3, 4e-3, 8e-3, 1e-2])
@pytest.mark.parametrize("phase", [0.0, 0.3, 0.6, 0.9])
def test_the_longest_contact_shows_a_kink(period: float, phase: float) -> None:
    times = np.arange(-0.05 + phase * period, 0.05, period)
    speed = 0.25 - 0.1 * (1.0 - np.cos(np.pi * np.clip(times / LONGEST_CONTACT_S, 0.0, 1.0)))
    kink = velocity_kink(times, speed[:, None] * np.array([0.6, -0.8, 0.0]), LONGEST_CONTACT_S)
    assert kink is not None
    assert abs(kink.delay) <= kink.resolution


def test_a_larger_rebound_does_not_count() -> None:
    times = np.arange(-0.05, 0.05, 1e-3)
    velocity = velocity_at(times, 0.0, 0.1) + velocity_at(times, 0.03, 0.15) - velocity_at(times, 1.0, 0.0)
    kink = velocity_kink(times, velocity, DURATION)
    assert kink is not None
    assert kink.delay == pytest.approx(0.0, abs=5e-4)


@pytest.mark.parametrize(
    "velocity",
    [
        lambda times: velocity_at(times, 1.0),
        lambda times: velocity_at(times, 1.0, slope=2.5),
        lambda times: 0.0 * velocity_at(times, 0.0),
        lambda times: velocity_at(times, 0.0, loss=0.003),
        lambda times: velocity_at(times, 1.0) + np.random.default_rng(1).normal(0.0, 0.01, (times.size, 3)),
    ],
    ids=["steady", "speeding up", "at rest", "small loss", "noise"],
)
def test_no_kink(velocity: object) -> None:
    times = np.arange(-0.05, 0.05, 1e-3)
    assert callable(velocity)
    assert velocity_kink(times, velocity(times), DURATION) is None


def test_too_few_states() -> None:
    times = np.arange(-0.05, 0.05, 0.02)
    assert velocity_kink(times, velocity_at(times, 0.0), DURATION) is None


def test_offset_of_a_series() -> None:
    kinks = [Kink(0.001, 5e-4), Kink(0.002, 5e-4), Kink(-0.006, 1e-3)]
    assert clock_offset(kinks, 0.005) == (3, 0.001, -0.006, 0.002, 1e-3, 1)
    nothing = clock_offset([], 0.005)
    assert nothing.impacts == 0
    assert math.isnan(nothing.offset)
    assert nothing.resolution == math.inf


def motion(times: FloatArray, onsets: FloatArray, losses: FloatArray) -> FloatArray:
    """Return the velocity (n, 3) of strokes of 0.5 s at 0.25 m/s that lose a share of it at `onsets` and then brake."""
    speed = 0.25 * np.clip(4.0 * np.sin(2.0 * np.pi * times), 0.0, 1.0)
    for onset, loss in zip(onsets, losses, strict=True):
        speed *= 1.0 - loss * np.clip((times - onset) / DURATION, 0.0, 1.0) * (times < np.floor(onset) + 0.75)
    return np.asarray(speed[:, None] * np.array([0.6, -0.8, 0.0]))


@settings(max_examples=30)
@given(
    strokes=st.lists(st.integers(0, 28), min_size=1, max_size=8, unique=True).map(sorted),
    offset=st.floats(-1e4, 1e4),
    period=st.sampled_from([1e-3, 2e-3, 4e-3]),
    seed=st.integers(0, 2**32),
)
def test_the_offset_of_a_recording_is_found(strokes: list[int], offset: float, period: float, seed: int) -> None:
    """The force clock is behind by any time; a stroke may end without an impact."""
    rng = np.random.default_rng(seed)
    onsets = np.array(strokes) + rng.uniform(0.15, 0.3, len(strokes))
    losses = rng.uniform(0.2, 0.9, len(strokes))
    times = np.arange(0.0, 30.0, period)
    velocity = motion(times, onsets, losses) + rng.normal(0.0, 1e-4, (times.size, 3))
    kink = recording_offset(onsets - offset, 2.0 * losses, np.full(len(strokes), DURATION), times, velocity)
    assert kink is not None
    assert kink.delay == pytest.approx(offset, abs=kink.resolution + 1e-3)


def test_no_offset_where_none_or_several_fit() -> None:
    times = np.arange(0.0, 30.0, 1e-3)
    onsets = 0.2 + np.arange(20.0)
    equal = np.full(20, 0.4)
    strokes = motion(times, onsets, equal)
    durations = np.full(20, DURATION)
    assert recording_offset(onsets, equal, durations, times, strokes) is None  # a stroke later fits 19 of 20
    assert recording_offset(onsets[:1], equal[:1], durations[:1], times, strokes) is None
    assert recording_offset(onsets, equal, durations, times, 0.0 * strokes) is None
    assert recording_offset(onsets[:0], equal[:0], durations[:0], times, strokes) is None

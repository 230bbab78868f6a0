"""Kink of the velocity at an impact: found to a fraction of the state period, and not where there is none."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.impacts.clock_offset import Kink, clock_offset, velocity_kink
from scara_effmass.values import FloatArray

DURATION = 2e-3


def velocity_at(times: FloatArray, onset: float, loss: float = 0.2, slope: float = 0.0) -> FloatArray:
    """Return the velocity (n, 3) of a contact point at 0.25 m/s that a half-sine of force slows by `loss` [m/s]."""
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

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.impacts.contact import measure, rise, separate, top


@given(st.floats(-0.5, 0.5), st.floats(1.0, 1e3), st.floats(0.1, 10.0))
def test_the_top_of_a_parabola_is_exact(shift: float, peak: float, curvature: float) -> None:
    force = peak - curvature * np.square(np.arange(5.0) - 2.0 - shift)
    assert top(force, 2) == pytest.approx(peak, rel=1e-12)


def test_the_top_at_an_end_or_of_a_plateau_is_the_sample() -> None:
    assert top(np.array([3.0, 2.0]), 0) == 3.0
    assert top(np.array([2.0, 3.0]), 1) == 3.0
    assert top(np.array([3.0, 3.0, 3.0]), 1) == 3.0


@given(st.floats(1.0, 9.0), st.floats(2.0, 30.0), st.floats(1.0, 30.0), st.floats(5.0, 500.0))
def test_a_triangle_is_exact(onset: float, up: float, down: float, peak: float) -> None:
    # Sampled where it bends, so that straight lines between samples are the triangle itself.
    up, onset = np.ceil(up) * 10, np.ceil(onset)
    down = np.ceil(down) * 10
    force = np.interp(np.arange(700), [onset, onset + up, onset + up + down], [0.0, peak, 0.0])
    ((first, last),) = separate(force, np.ones(700, dtype=np.bool_), 0.5 * peak, 0.25 * peak, 2)
    contact = measure(force, first, last, 0, 699, whole=False)
    assert contact.complete
    assert contact.peak == pytest.approx(peak)
    assert contact.onset == pytest.approx(onset, abs=1e-6)
    assert contact.end == pytest.approx(onset + up + down, abs=1e-6)
    assert contact.area == pytest.approx(0.5 * peak * (up + down))


def test_an_unseen_flank_is_told() -> None:
    assert rise(np.array([8.0, 9.0, 10.0, 4.0, 0.0]), 0, 10.0) == (0.0, False)
    onset, seen = rise(np.array([0.0, 2.0, 4.0, 6.0, 8.0, 10.0]), 2, 10.0)
    assert seen
    assert onset == pytest.approx(0.0)


def test_contacts_are_apart_after_a_gap() -> None:
    force = np.array([0, 9, 9, 0, 9, 0, 0, 9, 0, 2, 2, 0, 0, 0, 9], dtype=float)
    valid = np.ones(force.size, dtype=np.bool_)
    assert separate(force, valid, 5.0, 1.0, 2) == [(1, 4), (7, 10), (14, 14)]
    valid[5:7] = False  # nothing is known of the gap
    assert separate(force, valid, 5.0, 1.0, 2) == [(1, 10), (14, 14)]
    assert separate(np.zeros(4), np.ones(4, dtype=np.bool_), 5.0, 1.0, 2) == []
    assert separate(np.full(4, 2.0), np.ones(4, dtype=np.bool_), 5.0, 1.0, 2) == []

from itertools import groupby

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.impacts.baseline import longest_flat_run, runs
from scara_effmass.impacts.segment import flat_runs, lone_samples


@given(st.lists(st.booleans(), max_size=40))
def test_runs_are_those_of_groupby(mask: list[bool]) -> None:
    expected = [list(group) for value, group in groupby(range(len(mask)), mask.__getitem__) if value]
    first, stop = runs(np.array(mask, dtype=np.bool_))
    assert [list(range(i, k)) for i, k in zip(first, stop, strict=True)] == expected


@given(st.lists(st.integers(0, 2), min_size=1, max_size=40), st.integers(2, 6), st.integers(2, 6))
def test_stuck_runs_are_those_of_groupby(values: list[int], flat_run: int, zero_run: int) -> None:
    samples = np.array(values, dtype=float)
    groups = [(value, list(group)) for value, group in groupby(range(len(values)), values.__getitem__)]
    expected = [group for value, group in groups if len(group) >= (zero_run if value == 0 else flat_run)]
    first, stop = flat_runs(samples, flat_run, zero_run, np.zeros(samples.size, dtype=np.bool_))
    assert [list(range(i, k)) for i, k in zip(first, stop, strict=True)] == expected
    assert longest_flat_run(samples) == max(len(group) for _, group in groups)


def test_saturated_samples_are_not_stuck() -> None:
    first, _ = flat_runs(np.full(9, 2224.0), 3, 2, np.ones(9, dtype=np.bool_))
    assert not first.size


def test_lone_samples() -> None:
    force = np.array([0, 50, 0, -50, 1, 8, 30, 60, 5, 62, 40, 7, 0, 0, 50, 50, 0], dtype=float)
    assert lone_samples(force, 10.0).tolist() == [1, 3, 8]

# SPDX-License-Identifier: Apache-2.0
from statistics import NormalDist

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.sim.measurement import normal, uniform

WHOLE = normal((7, 3), 0, 20_000)


@given(st.integers(0, 19_999), st.integers(0, 9_000))
def test_any_part_of_a_stream_equals_that_of_the_whole(first: int, count: int) -> None:
    part = normal((7, 3), first, min(count, 20_000 - first))
    assert np.array_equal(part, WHOLE[first : first + count])


def test_numbers_are_normal_and_uncorrelated() -> None:
    numbers = normal((1,), 0, 200_000)
    deciles = np.quantile(numbers, np.arange(1, 10) / 10)
    assert np.abs(deciles - [NormalDist().inv_cdf(p / 10) for p in range(1, 10)]).max() < 0.01
    for lag in (1, 2, 2048, 4096):
        assert abs(float(np.corrcoef(numbers[:-lag], numbers[lag:])[0, 1])) < 0.01


def test_different_keys_give_independent_streams() -> None:
    assert np.array_equal(uniform((1, 2), 9), uniform((1, 2), 9))
    assert not np.array_equal(uniform((1, 2), 9), uniform((2, 2), 9))
    assert abs(float(np.corrcoef(normal((8, 3), 0, 20_000), WHOLE)[0, 1])) < 0.03
    numbers = uniform((3,), 10_000)
    assert 0.0 <= numbers.min() < 0.001
    assert 0.999 < numbers.max() < 1.0


def test_numbers_never_change() -> None:
    # To be renewed with the REVISION of the campaign, whose noise they are.
    assert np.round(WHOLE[:4], 12).tolist() == [1.597020686078, -1.707222194274, 0.529102105538, -0.912417739428]

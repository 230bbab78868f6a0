# SPDX-License-Identifier: Apache-2.0
"""Lost messages are counted by their numbers, of one publisher exactly."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.nodes.ros import SequenceGaps


@given(st.lists(st.integers(1, 5), min_size=1, max_size=50))
def test_every_missing_number_counts_once(steps: list[int]) -> None:
    gaps, number, lost = SequenceGaps(lambda: 1), 0, 0
    for step in steps:
        number += step
        lost += gaps.lost_before(number)
    assert lost == sum(steps) - len(steps) - steps[0] + 1  # what was sent before the first one is not lost


@pytest.mark.parametrize(
    ("publishers", "numbers", "lost"),
    [
        (1, [7, 8, 11, 1, 2, 4], 3),  # starts again
        (2, [100, 1, 101, 2, 102, 3], 0),
        (2, [100, 1, 103, 2, 104, 5], 4),
        (2, [5, 5, 6, 6, 8, 7], 1),
        (0, [5, 7], 1),  # it has gone meanwhile
        (1, [None, None], 0),  # a middleware without numbers
    ],
)
def test_publishers(publishers: int, numbers: list[int | None], lost: int) -> None:
    gaps = SequenceGaps(lambda: publishers)
    assert sum(map(gaps.lost_before, numbers)) == lost

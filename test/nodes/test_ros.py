# SPDX-License-Identifier: Apache-2.0
"""Under overload the newest message of each device is kept, and every other one is counted."""

from collections import deque

import pytest

from scara_effmass.nodes.ros import newest_waiting


@pytest.mark.parametrize(
    ("messages", "kept", "skipped"),
    [
        (["arm 1"], ["arm 1"], 0),
        (["arm 1", "arm 2", "arm 3"], ["arm 3"], 2),
        (["arm 1", "gripper 1", "arm 2"], ["gripper 1", "arm 2"], 1),
        (["arm 1", "gripper 1", "arm 2", "gripper 2"], ["arm 2", "gripper 2"], 2),
    ],
)
def test_the_newest_of_each_device_is_kept(messages: list[str], kept: list[str], skipped: int) -> None:
    waiting = deque(messages[1:])
    take = lambda: waiting.popleft() if waiting else None  # noqa: E731
    assert newest_waiting(messages[0], take, lambda message: message.split()[0], 100) == (kept, skipped)
    assert not waiting


def test_a_queue_that_fills_faster_than_it_is_read_ends() -> None:
    numbers = iter(range(10**9))
    assert newest_waiting(-1, lambda: next(numbers), lambda _: "arm", 50) == ([49], 50)

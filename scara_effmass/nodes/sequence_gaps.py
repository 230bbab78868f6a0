# SPDX-License-Identifier: Apache-2.0
"""Count lost messages by their sequence numbers.

The middleware also has an event for them, but no node may take it: `rcl_take_event` holds Python's lock and waits for a
lock of the middleware, whose thread may hold that one and wait for Python's (https://github.com/ros2/rmw_fastrtps/pull/890).
Under load the process then stands still for ever.
"""

from collections.abc import Callable


class SequenceGaps:
    """Counts what is missing between the messages of one topic.

    Each publisher numbers its messages from 1, but a message does not name its publisher. With several, a message that
    continues none of them is assigned to the one with the closest number, so their count is approximate. A publisher
    that starts again, with smaller numbers, loses nothing.
    """

    def __init__(self, count_publishers: Callable[[], int]) -> None:
        """`count_publishers` returns how many publishers the topic has; it is called only where a number is missing."""
        self._count_publishers = count_publishers
        self._last: list[int] = []
        """Last number of each publisher, the one that sent last at the end."""

    def lost_before(self, number: int | None) -> int:
        """Return how many messages are missing before the message with this number, None if it has none."""
        if number is None:
            return 0
        last, lost = self._last, 0
        closest = max((value for value in last if value < number), default=None)
        # Otherwise it is the first message of another publisher.
        if closest == number - 1 or len(last) >= max(self._count_publishers(), 1):
            before = last[0] if closest is None else closest
            last.remove(before)
            lost = max(number - before - 1, 0)
        last.append(number)
        return lost

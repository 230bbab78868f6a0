# SPDX-License-Identifier: Apache-2.0
"""Skip what waits in a queue behind something newer."""

from collections.abc import Callable, Hashable
from typing import TypeVar

Message = TypeVar("Message")


def newest_waiting(
    first: Message, take: Callable[[], Message | None], key: Callable[[Message], Hashable], limit: int
) -> tuple[list[Message], int]:
    """Return the newest message of each `key` in the order of arrival, and how many older ones were skipped.

    `take` gives the next message that waits behind `first`, None without one; at most `limit` are taken.
    """
    newest = {key(first): first}
    count = 1
    while count <= limit and (message := take()) is not None:
        newest.pop(key(message), None)  # keeps the order of arrival
        newest[key(message)] = message
        count += 1
    return list(newest.values()), count - len(newest)

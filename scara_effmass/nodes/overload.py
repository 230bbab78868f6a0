# SPDX-License-Identifier: Apache-2.0
"""Skip what waits in a queue behind something newer."""

import time
from collections.abc import Callable, Hashable, Mapping
from typing import Any, TypeVar

Message = TypeVar("Message")
_MAX_WAIT = 0.5
"""Share of the timeout that a message may wait; later, only the newest ones are taken."""


def received_ns(info: Mapping[str, Any]) -> int:
    """Return when the middleware received a message [ns]; now, where it does not say so, as some do by a 0."""
    return int(info["received_timestamp"]) or time.time_ns()


def is_late(info: Mapping[str, Any], age_ns: float, timeout_s: float) -> bool:
    """Return whether a message with a state of this age has waited too long to be worth its turn."""
    return time.time_ns() - received_ns(info) > _MAX_WAIT * timeout_s * 1e9 or age_ns > timeout_s * 1e9


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

"""When what of a recording is due: its messages, and steps of the clock between them."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from scara_effmass.bags.bag import RawMessage

CLOCK_STEP_NS = 10_000_000
"""The clock of a replay never stands still for longer than this, in time of the recording."""


class Due(NamedTuple):
    """At this time of the recording the clock is to be set, and this message, if any, to be sent."""

    time_ns: int
    message: RawMessage | None


def timeline(messages: Iterable[RawMessage], start_ns: int, end_ns: int) -> Iterator[Due]:
    """Yield what is due from `start_ns` to `end_ns`, in order: at the start, at each message, and in the gaps."""
    now_ns = start_ns
    yield Due(now_ns, None)
    for message in messages:
        yield from _steps(now_ns, message.log_time_ns)
        now_ns = max(now_ns, message.log_time_ns)
        yield Due(now_ns, message)
    yield from _steps(now_ns, end_ns)


def _steps(now_ns: int, until_ns: int) -> Iterator[Due]:
    return (Due(time_ns, None) for time_ns in range(now_ns + CLOCK_STEP_NS, until_ns, CLOCK_STEP_NS))

"""What a recording says of itself on `recording_info`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scara_effmass.errors import DecodeError
from scara_effmass.wire.topics import RECORDING_INFO

if TYPE_CHECKING:
    from collections.abc import Iterator

    from scara_effmass.bags.bag import Bag


def recording_infos(bag: Bag) -> Iterator[tuple[int, str]]:
    """Yield each text that `bag` holds there, with its log time [ns]; JSON, if the suite wrote it."""
    if all(topic.name != RECORDING_INFO for topic in bag.topics):
        return
    for message in bag.messages([RECORDING_INFO]):
        try:
            text = str(bag.deserialize(message).data)
        except (DecodeError, AttributeError):
            continue
        yield message.log_time_ns, text

# SPDX-License-Identifier: Apache-2.0
"""Run information in a bag."""

from collections.abc import Iterator
from contextlib import suppress

from scara_effmass.bags.bag import Bag
from scara_effmass.bags.definitions import check_definition
from scara_effmass.errors import BagError, DecodeError
from scara_effmass.values import RunInfo
from scara_effmass.wire.message_types import RUN_INFO
from scara_effmass.wire.run_info import decode_run_info


def run_infos(bag: Bag) -> Iterator[tuple[int, RunInfo]]:
    """Yield log time [ns] and content of each run information in `bag`, unchecked.

    Raises BagError for a RunInfo that cannot be decoded or has another definition.
    """
    topics = [topic.name for topic in bag.topics if topic.type == RUN_INFO]
    if not topics:
        return
    check_definition(bag.types, RUN_INFO, str(bag.path))
    for message in bag.messages(topics):
        if message.type != RUN_INFO:
            continue
        try:
            info = decode_run_info(message.data)
        except DecodeError as error:
            raise BagError(f"{bag.path}: {message.topic}: {error}") from None
        yield message.log_time_ns, info


def first_run_info(bag: Bag) -> RunInfo | None:
    """Return the first run information in `bag`, unchecked; None if none can be read."""
    with suppress(BagError):
        return next((info for _, info in run_infos(bag)), None)
    return None

# SPDX-License-Identifier: Apache-2.0
"""Run information in a bag: `RunInfo` messages, or the JSON text of older recordings."""

from collections.abc import Iterator
from contextlib import suppress

from scara_effmass.bags.bag import Bag
from scara_effmass.bags.definitions import check_definition
from scara_effmass.errors import BagError, DecodeError
from scara_effmass.values import RunInfo
from scara_effmass.wire.message_types import RUN_INFO
from scara_effmass.wire.run_info import decode_run_info, run_info_from_json
from scara_effmass.wire.topics import RECORDING_INFO


def run_infos(bag: Bag) -> Iterator[tuple[int, RunInfo]]:
    """Yield log time [ns] and content of each run information in `bag`, unchecked; text that is not JSON is skipped.

    Raises BagError for a RunInfo that cannot be decoded or has another definition.
    """
    topics = [topic.name for topic in bag.topics if topic.type == RUN_INFO or topic.name.endswith(f"/{RECORDING_INFO}")]
    if not topics:
        return
    if any(topic.type == RUN_INFO for topic in bag.topics):
        check_definition(bag.types, RUN_INFO, str(bag.path))
    for message in bag.messages(topics):
        info: RunInfo | None = None
        if message.type == RUN_INFO:
            try:
                info = decode_run_info(message.data)
            except DecodeError as error:
                raise BagError(f"{bag.path}: {message.topic}: {error}") from None
        else:
            with suppress(DecodeError, AttributeError):
                info = run_info_from_json(str(bag.deserialize(message).data))
        if info is not None:
            yield message.log_time_ns, info


def first_run_info(bag: Bag) -> RunInfo | None:
    """Return the first run information in `bag`, unchecked; None if none can be read."""
    with suppress(BagError):
        return next((info for _, info in run_infos(bag)), None)
    return None

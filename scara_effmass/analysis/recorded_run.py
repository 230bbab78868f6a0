"""What the validator needs from one recording, in the order in which it was recorded."""

from __future__ import annotations

from heapq import merge
from typing import TYPE_CHECKING, NamedTuple

from scara_effmass.bags import run_info
from scara_effmass.bags.definitions import check_definition
from scara_effmass.errors import BagError, DecodeError, SettingsError
from scara_effmass.impacts.run_info import check_run_info
from scara_effmass.wire.force import decode_force_block, decode_impact
from scara_effmass.wire.message_types import FORCE_BLOCK, IMPACT

if TYPE_CHECKING:
    from collections import Counter
    from collections.abc import Iterator

    from scara_effmass.analysis.assessment import Cycle
    from scara_effmass.bags.bag import Bag
    from scara_effmass.bags.batches import Topic
    from scara_effmass.values import ForceBlock, Impact, RunInfo

USUAL = {FORCE_BLOCK: "force", IMPACT: "impact"}
"""Where the suite publishes what is measured, the surer kind first: impacts can be found anew in force blocks."""


class Measured(NamedTuple):
    """A force block or an impact, and when it was recorded."""

    log_time_ns: int
    value: ForceBlock | Impact


def run_infos(bag: Bag) -> list[RunInfo]:
    """Return the run information in `bag`; a stamp that is not stated becomes the log time.

    The first one holds from the beginning on if it states no stamp. Raises BagError for a value that cannot be used.
    """
    infos: list[RunInfo] = []
    for log_time_ns, info in run_info.run_infos(bag):
        try:
            check_run_info(info)
        except SettingsError as error:
            raise BagError(f"{bag.path}: run information: {error}") from None
        infos.append(info._replace(stamp_ns=info.stamp_ns or (log_time_ns if infos else 0)))
    return infos


def measured_topic(bag: Bag, asked: str | None) -> Topic:
    """Return the topic of the force blocks, or else of the impacts: the one asked for, else `force` (`impact`).

    Raises BagError, with those there are, when that leaves none or several.
    """
    found = [topic for kind in USUAL for topic in bag.topics if topic.type == kind and topic.count]
    if not found:
        raise BagError(f"{bag.path}: must hold {FORCE_BLOCK} or {IMPACT}, as daq publishes them")
    surest = [topic for topic in found if topic.type == found[0].type]
    if asked is not None:
        chosen = [topic for topic in found if topic.name.lstrip("/") == asked.lstrip("/")]
    else:
        chosen = [topic for topic in surest if topic.name.lstrip("/") == USUAL[topic.type]] or surest
    if len(chosen) == 1:
        return chosen[0]
    problem = "several topics hold the force" if asked is None else f"no force on {asked}"
    raise BagError(f"{bag.path}: {problem}; give --force-topic one of {', '.join(topic.name for topic in found)}")


def measured(bag: Bag, topic: Topic, unreadable: Counter[str]) -> Iterator[Measured]:
    """Yield the force blocks or impacts of `topic`; what cannot be decoded is counted, by why, in `unreadable`.

    Raises BagError when the recording has another definition of the type.
    """
    check_definition(bag.types, topic.type, str(bag.path))
    for message in bag.messages([topic.name]):
        if message.type != topic.type:
            continue
        try:
            decode = decode_force_block if topic.type == FORCE_BLOCK else decode_impact
            yield Measured(message.log_time_ns, decode(message.data))
        except DecodeError as error:
            unreadable[f"{bag.path}: {topic.name}: left out: {error}"] += 1


def in_order(states: Iterator[Cycle], forces: Iterator[Measured]) -> Iterator[Cycle | Measured]:
    """Yield both as they were recorded."""
    return merge(forces, states, key=lambda each: each.log_time_ns)

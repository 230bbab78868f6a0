"""Read the ForceBlocks of a bag and count the samples that are missing between them."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

from scara_effmass.bags.bag import Bag
from scara_effmass.bags.batches import Topic
from scara_effmass.bags.files import open_bag
from scara_effmass.errors import BagError
from scara_effmass.importers import IMPORTERS
from scara_effmass.settings import BagSettings
from scara_effmass.values import ForceBlock
from scara_effmass.wire.cdr import NS
from scara_effmass.wire.message_types import FORCE_BLOCK

MAX_RATE_DRIFT = 0.01
"""Largest relative difference between the sample rates of two blocks of one recording."""
MAX_OVERLAP_NS = NS
"""A block that overlaps by less is a repetition and left out; if stamps go back further, a clock was set."""


@dataclass(frozen=True, slots=True)
class BagBlocks:
    """Blocks of one topic in the order of their stamps; `lost_samples` counts the samples missing before a block."""

    bag: Bag
    topic: str
    source: str
    """Source that the first block states."""
    sample_rate: float
    start_ns: int
    end_ns: int
    blocks: Iterator[ForceBlock]


def open_blocks(settings: BagSettings) -> BagBlocks:
    """Open the bag and find its topic of ForceBlocks. Raises BagError."""
    path = Path(settings.path)
    convert = f"convert its force first: scara-effmass import {path} -o BAG"
    if path.is_file() and path.suffix.lower() in IMPORTERS:
        raise BagError(f"{path}: is not a bag; {convert}")
    bag = open_bag(path)
    try:
        topic = _topic(bag, settings.topic, convert)
        origin = f"{bag.path}: {topic.name}"
        blocks = (block for block in bag.force_blocks(topic.name) if len(block.force))
        first = _checked_first(next(blocks, None), origin, bag)
    except BaseException:
        bag.close()
        raise
    return BagBlocks(
        bag=bag,
        topic=topic.name,
        source=first.source,
        sample_rate=first.sample_rate,
        start_ns=min(first.stamp_ns, bag.start_ns),
        end_ns=max(first.stamp_ns + bag.duration_ns, bag.end_ns),
        blocks=_ordered(chain([first], blocks), first.sample_rate, origin),
    )


def _topic(bag: Bag, name: str, convert: str) -> Topic:
    """Return the topic `name`, or the only one with ForceBlocks."""
    topics = [topic for topic in bag.topics if topic.type == FORCE_BLOCK and topic.count]
    candidates = [topic for topic in topics if not name or topic.name in {name, f"/{name}"}]
    if len(candidates) == 1:
        return candidates[0]
    if not topics:
        raise BagError(f"{bag.path}: has no topic of type {FORCE_BLOCK}; {convert}")
    setting = f"bag.topic = {name}" if name else "bag.topic is empty"
    raise BagError(f"{bag.path}: {setting}: must be one of {', '.join(topic.name for topic in topics)}")


def _checked_first(block: ForceBlock | None, origin: str, bag: Bag) -> ForceBlock:
    if block is None:
        raise BagError("; ".join([f"{origin}: has no force that can be read", *bag.losses]))
    _check_block(block, block.sample_rate, origin)
    return block


def _ordered(blocks: Iterator[ForceBlock], sample_rate: float, origin: str) -> Iterator[ForceBlock]:
    """Yield the blocks with their number of missing samples; repeated and late ones are left out."""
    last: ForceBlock | None = None
    for block in blocks:
        _check_block(block, sample_rate, origin)
        lost = 0
        if last is not None:
            end_ns = last.stamp_ns + len(last.force) * NS / sample_rate
            if block.stamp_ns < end_ns - MAX_OVERLAP_NS:
                stamps = f"{block.stamp_ns / NS:.6f} s follows {end_ns / NS:.6f} s"
                raise BagError(f"{origin}: time goes back, {stamps}; must be recorded without a clock step")
            if block.stamp_ns <= last.stamp_ns:
                continue
            lost = block.first_sample - last.first_sample - len(last.force)
            if lost < 0:  # the measurement was restarted: only the stamps tell
                lost = max(0, round((block.stamp_ns - end_ns) / NS * sample_rate))
            lost = max(lost, block.lost_samples)
        last = block
        yield block._replace(lost_samples=lost)


def _check_block(block: ForceBlock, sample_rate: float, origin: str) -> None:
    rate, stamp = block.sample_rate, f"at {block.stamp_ns / NS:.6f} s"
    if not 0.0 < rate < math.inf:
        raise BagError(f"{origin}: sample_rate = {rate:g} {stamp}: must be > 0 Hz")
    for name in ("clock_residual", "relative_uncertainty"):
        if not 0.0 <= getattr(block, name) < math.inf:
            raise BagError(f"{origin}: {name} = {getattr(block, name):g} {stamp}: must be a number >= 0")
    if abs(rate / sample_rate - 1.0) > MAX_RATE_DRIFT:
        raise BagError(f"{origin}: sample_rate = {rate:g} {stamp}: must be {sample_rate:g} Hz, as before")

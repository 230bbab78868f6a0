"""Force from the topics of a bag: which of them has it, and what it says."""

from __future__ import annotations

import math
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from scara_effmass.bags.files import open_bag
from scara_effmass.bags.run_info import first_run_info
from scara_effmass.daq.even_time import EvenBlocks
from scara_effmass.daq.force_file import NS, UNITS, ForceFile, RecordedBlock
from scara_effmass.daq.source import Unit
from scara_effmass.daq.stamped_topic import stamped_samples
from scara_effmass.errors import BagError, SettingsError
from scara_effmass.wire.message_types import FLOAT64, FORCE_BLOCK, WRENCH, WRENCH_STAMPED

if TYPE_CHECKING:
    from collections.abc import Iterator

    from scara_effmass.bags.bag import Bag
    from scara_effmass.bags.batches import Topic
    from scara_effmass.settings import BagSettings
    from scara_effmass.values import ForceBlock

KINDS = (FORCE_BLOCK, WRENCH_STAMPED, WRENCH, FLOAT64)
"""What can be force, the surest first: of several topics, the only one of the first of these kinds is taken."""

LARGEST_DRIFT = 0.01
"""Relative difference between the sample rates of two blocks, beyond which they are not of one recording."""

LARGEST_STEP_BACK_NS = NS
"""A block that is late by less is left out; if the stamps go further back, their clock was set."""


def open_bag_force(settings: BagSettings, block_time: float) -> ForceFile:
    """Open the force topic of a bag; blocks other than our own are cut to `block_time` [s].

    Raises BagError or SettingsError.
    """
    bag = open_bag(Path(settings.path))
    try:
        topic = _topic(bag, settings.topic)
        if topic.type == FORCE_BLOCK:
            return _force_blocks(bag, topic, settings)
        return _samples(bag, topic, settings, block_time)
    except BaseException:
        bag.close()
        raise


def _topic(bag: Bag, asked: str) -> Topic:
    """Return the topic that is asked for, or the only one that can be it."""
    topics = [topic for topic in bag.topics if topic.type in KINDS and topic.count]
    if asked:
        candidates = [topic for topic in topics if topic.name in {asked, f"/{asked}"}]
    else:
        kinds = [kind for kind in KINDS if any(topic.type == kind for topic in topics)]
        candidates = [topic for topic in topics if topic.type == kinds[0]]
    if len(candidates) == 1:
        return candidates[0]
    found = ", ".join(f"{topic.name} ({topic.type})" for topic in (topics if asked else candidates))
    right = f"one of {found} would be right" if found else f"none of its topics is a {', '.join(KINDS)}"
    said = f"bag.topic = {asked}: there is no force" if asked else "bag.topic is empty"
    raise BagError(f"{bag.path}: {said}; {right}")


def _force_blocks(bag: Bag, topic: Topic, settings: BagSettings) -> ForceFile:
    origin = f"{bag.path}: {topic.name}"
    if settings.unit not in {"", "N"}:
        raise SettingsError(f"{origin}: bag.unit = {settings.unit}, but a ForceBlock is in N; leave bag.unit empty")
    blocks = (block for block in bag.force_blocks(topic.name) if len(block.force))
    first = next(blocks, None)
    if first is None:
        raise BagError("; ".join([f"{origin}: holds no force that can be read", *bag.losses]))
    _check_block(first, first.sample_rate, origin)
    return ForceFile(
        description=f"{bag.path.name}, {topic.name}" + (f", of {first.source}" if first.source else ""),
        channel=topic.name.rpartition("/")[2],
        unit=Unit.NEWTON,
        sample_rate=first.sample_rate,
        start_ns=min(first.stamp_ns, bag.start_ns),
        end_ns=max(first.stamp_ns + bag.duration_ns, bag.end_ns),
        blocks=_continuous(chain([first], blocks), first.sample_rate, origin),
        losses=lambda: bag.losses,
        close=bag.close,
    )


def _continuous(blocks: Iterator[ForceBlock], sample_rate: float, origin: str) -> Iterator[RecordedBlock]:
    """Yield the blocks with the samples that are missing between them; repeated and late ones are left out."""
    last: ForceBlock | None = None
    for block in blocks:
        _check_block(block, sample_rate, origin)
        lost = 0
        if last is not None:
            end_ns = last.stamp_ns + len(last.force) * NS / sample_rate
            if block.stamp_ns < end_ns - LARGEST_STEP_BACK_NS:
                back = f"{block.stamp_ns / NS:.6f} s follows on {end_ns / NS:.6f} s"
                raise BagError(f"{origin}: time goes back, {back}; a recording without that would be right")
            if block.stamp_ns <= last.stamp_ns:
                continue
            lost = block.first_sample - last.first_sample - len(last.force)
            if lost < 0:  # the measurement was started again, so only the time can tell
                lost = max(0, round((block.stamp_ns - end_ns) / NS * sample_rate))
            lost = max(lost, block.lost_samples)
        last = block
        saturated = None
        if len(block.saturated_samples):
            saturated = np.zeros(len(block.force), np.bool_)
            saturated[block.saturated_samples] = True
        yield RecordedBlock(block.stamp_ns, block.force, lost, block.clock_residual, saturated, block.simulated)


def _check_block(block: ForceBlock, sample_rate: float, origin: str) -> None:
    rate = block.sample_rate
    if not (0.0 < rate < math.inf and math.isfinite(block.clock_residual)):
        found = f"sample_rate = {rate:g}, clock_residual = {block.clock_residual:g}"
        raise BagError(f"{origin}: {found} at {block.stamp_ns / NS:.6f} s; a rate above 0 and a number would be right")
    if abs(rate / sample_rate - 1.0) > LARGEST_DRIFT:
        changed = f"sample_rate changes from {sample_rate:g} to {rate:g} Hz at {block.stamp_ns / NS:.6f} s"
        raise BagError(f"{origin}: {changed}; a recording of one rate would be right")


def _samples(bag: Bag, topic: Topic, settings: BagSettings, block_time: float) -> ForceFile:
    origin = f"{bag.path}: {topic.name}"
    unit, scale = UNITS[settings.unit or "N"]
    stream = stamped_samples(bag, topic, settings.axis)
    try:
        even = EvenBlocks(stream.samples, block_time, scale)
    except BagError:
        raise
    except ValueError as error:
        raise BagError("; ".join([f"{origin}: {error}", *bag.losses])) from None
    info = first_run_info(bag)
    simulated = info is not None and info.simulated
    return ForceFile(
        description=f"{bag.path.name}, {topic.name}{stream.description}",
        channel=topic.name.rpartition("/")[2],
        unit=unit,
        sample_rate=even.sample_rate,
        start_ns=min(even.start_ns, bag.start_ns),
        end_ns=max(even.start_ns + bag.duration_ns, bag.end_ns),
        blocks=(block._replace(simulated=simulated) for block in even),
        losses=lambda: bag.losses,
        close=bag.close,
    )

# SPDX-License-Identifier: Apache-2.0
"""Force from a topic of wrenches or numbers in a bag, one sample per message."""

import math
from array import array
from pathlib import Path
from typing import Any

import numpy as np

from scara_effmass.bags.bag import Bag, first_run_info
from scara_effmass.bags.batches import IntArray, Topic
from scara_effmass.bags.files import open_bag
from scara_effmass.errors import BagError, DecodeError
from scara_effmass.importers.force_file import ForceFile, uniform_samples
from scara_effmass.settings import ImportSettings
from scara_effmass.values import FloatArray, true_runs
from scara_effmass.wire.cdr import NS
from scara_effmass.wire.message_types import FLOAT64, FORCE_BLOCK, WRENCH, WRENCH_STAMPED

TYPES = (WRENCH_STAMPED, WRENCH, FLOAT64)
"""Message types that can hold force, by priority."""
HEAD = 1000
"""Number of messages that determine the usual difference of stamp and log time."""
MAX_DELAY_NS = 5 * NS
"""A stamp whose difference to the log time deviates by more than this from the usual one is invalid."""
CLOCK_STEP_RUN = 100
"""Number of consecutive invalid stamps that shows a clock step."""
MIN_STEP_RUN = 5
"""Number of stamps on each side of a jump that can show a clock step."""
MIN_STEP_NS, MIN_STEP_PERIODS = 10_000_000, 3.0
"""A smaller jump of the stamps, also in sampling periods, is jitter."""
STEP_AGREEMENT = 0.5
"""Share of a jump by which the change of the usual delay may differ from it."""


def open_wrench_topic(path: Path, settings: ImportSettings) -> ForceFile:
    """Read the force (along `settings.axis`, or its norm) from a topic of wrenches, or from a topic of Float64.

    Times are those of the headers, or the log times if the headers have no stamps. Raises BagError.
    """
    with open_bag(path) as bag:
        topic = _topic(bag, settings.topic)
        origin = f"{bag.path}: {topic.name}"
        log_times_ns, stamps_ns, values = _read(bag, topic, settings.axis)
        component = "" if topic.type == FLOAT64 else f" force.{settings.axis}"
        if stamps_ns[:HEAD].any():
            _check_clock(log_times_ns, stamps_ns, origin)
            stamps_ns, values = _sort(log_times_ns, stamps_ns, values, origin)
        else:
            stamps_ns = log_times_ns
            component += ", at log times"
        try:
            sample_rate, blocks = uniform_samples(stamps_ns, values)
        except ValueError as error:
            raise BagError("; ".join([f"{origin}: {error}", *bag.losses])) from None
        info = first_run_info(bag)
        return ForceFile(
            description=f"{bag.path.name}, {topic.name}{component}",
            unit=settings.unit or "N",
            sample_rate=sample_rate,
            blocks=blocks,
            simulated=info is not None and info.simulated,
            losses=lambda: bag.losses,
        )


def _topic(bag: Bag, name: str) -> Topic:
    """Return the topic `name`; if empty, the only one that can be force."""
    topics = [topic for topic in bag.topics if topic.type in TYPES and topic.count]
    if name:
        candidates = [topic for topic in topics if topic.name in {name, f"/{name}"}]
    else:
        types = [kind for kind in TYPES if any(topic.type == kind for topic in topics)]
        candidates = [topic for topic in topics if topic.type == types[0]]
        if force := [topic.name for topic in bag.topics if topic.type == FORCE_BLOCK and topic.count]:
            raise BagError(f"{bag.path}: already has ForceBlocks on {', '.join(force)}; needs no import")
    if len(candidates) == 1:
        return candidates[0]
    choices = ", ".join(f"{topic.name} ({topic.type})" for topic in (topics if name else candidates))
    rule = f"must be one of {choices}" if choices else f"must have a topic of type {', '.join(TYPES)}"
    raise BagError(f"{bag.path}: {f'topic = {name}' if name else 'topic is empty'}: {rule}")


def _read(bag: Bag, topic: Topic, axis: str) -> tuple[IntArray, IntArray, FloatArray]:
    """Return log times, header stamps (0 if the type has none) [ns], and values (n,).

    Messages that cannot be decoded are left out and leave a gap in the times.
    """
    log_times_ns, stamps_ns, values = array("q"), array("q"), array("d")
    reason = ""
    for message in bag.messages([topic.name]):
        if message.type != topic.type:
            continue
        try:
            stamp_ns, value = _sample(bag.deserialize(message), topic.type, axis)
        except (DecodeError, AttributeError, TypeError, ValueError) as error:
            reason = str(error)
            continue
        log_times_ns.append(message.log_time_ns)
        stamps_ns.append(stamp_ns)
        values.append(value)
    if reason and not values:
        raise BagError(f"{bag.path}: {topic.name}: no message can be decoded: {reason}")
    return np.frombuffer(log_times_ns, np.int64), np.frombuffer(stamps_ns, np.int64), np.frombuffer(values)


def _sample(message: Any, kind: str, axis: str) -> tuple[int, float]:  # noqa: ANN401 - a class that the bag defines
    if kind == FLOAT64:
        return 0, float(message.data)
    if kind == WRENCH:
        return 0, _component(message.force, axis)
    stamp = message.header.stamp
    return int(stamp.sec) * NS + int(stamp.nanosec), _component(message.wrench.force, axis)


def _component(force: Any, axis: str) -> float:  # noqa: ANN401 - a class that the bag defines
    return math.hypot(force.x, force.y, force.z) if axis == "norm" else float(getattr(force, axis))


def _check_clock(log_times_ns: IntArray, stamps_ns: IntArray, origin: str) -> None:
    """Raise BagError if the clock of the stamps steps: they jump, and keep that distance to the log times.

    Without the step, a jump is a loss (the log times jump, too) or a late message (the next stamp jumps back).
    """
    delays_ns = stamps_ns - log_times_ns
    steps_ns = np.diff(stamps_ns)
    period_ns = max(0.0, float(np.median(steps_ns[:HEAD]))) if len(steps_ns) else 0.0
    even_ns = stamps_ns - np.arange(len(stamps_ns)) * period_ns
    min_jump_ns = max(MIN_STEP_NS, MIN_STEP_PERIODS * period_ns)
    for first in (np.flatnonzero(np.abs(steps_ns - period_ns) > min_jump_ns) + 1).tolist():
        if MIN_STEP_RUN <= first <= len(stamps_ns) - MIN_STEP_RUN:
            jump_ns = _shift_ns(even_ns, first, MIN_STEP_RUN)  # of the usual stamp: not that of a late message
            shift_ns = _shift_ns(delays_ns, first, CLOCK_STEP_RUN)
            if abs(jump_ns) > min_jump_ns and abs(shift_ns - jump_ns) < STEP_AGREEMENT * abs(jump_ns):
                raise BagError(f"{origin}: {_step_text(log_times_ns[first], jump_ns)}")


def _shift_ns(values: FloatArray | IntArray, first: int, count: int) -> float:
    """Return by how much the median of `count` values from number `first` on exceeds that of those before."""
    return float(np.median(values[first : first + count]) - np.median(values[max(0, first - count) : first]))


def _step_text(log_time_ns: int, step_ns: float) -> str:
    line = f"from {log_time_ns / NS:.6f} s on, its stamps deviate by {step_ns / NS:.3f} s"
    return f"{line}; must be recorded without a clock step"


def _sort(log_times_ns: IntArray, stamps_ns: IntArray, values: FloatArray, origin: str) -> tuple[IntArray, FloatArray]:
    """Return stamps and values in the order of the stamps; invalid stamps are left out."""
    differences_ns = stamps_ns - log_times_ns
    head_ns = np.sort(differences_ns[:HEAD])
    deviation_ns = differences_ns - head_ns[(len(head_ns) - 1) // 2]
    valid = np.abs(deviation_ns) <= MAX_DELAY_NS
    for start, stop in true_runs(~valid).tolist():
        if stop - start >= CLOCK_STEP_RUN:
            at = start + CLOCK_STEP_RUN - 1
            raise BagError(f"{origin}: {_step_text(log_times_ns[at], deviation_ns[at])}")
    order = np.argsort(stamps_ns[valid], kind="stable")
    return stamps_ns[valid][order], values[valid][order]

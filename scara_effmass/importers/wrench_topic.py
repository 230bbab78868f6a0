# SPDX-License-Identifier: Apache-2.0
"""Force from a topic of wrenches or numbers in a bag, one sample per message."""

from array import array
from functools import partial
from typing import NamedTuple

import numpy as np

from scara_effmass.bags.bag import Bag, RawMessage, first_run_info
from scara_effmass.bags.batches import IntArray, Topic
from scara_effmass.errors import BagError, DecodeError
from scara_effmass.importers.force_file import (
    NEWTON_PER_UNIT,
    TABLE_SETTINGS,
    ForceFile,
    refuse_settings,
    uniform_samples,
)
from scara_effmass.settings import DetectionSettings, ImportSettings
from scara_effmass.values import BoolArray, FloatArray, true_runs
from scara_effmass.wire.cdr import NS
from scara_effmass.wire.message_types import FLOAT64, FORCE_BLOCK, WRENCH, WRENCH_STAMPED

TYPES = (WRENCH_STAMPED, WRENCH, FLOAT64)
"""Message types that can hold force, by priority."""
HEAD = 1000
"""Number of messages that determine the usual difference of stamp and log time."""
MAX_DELAY_NS = 5 * NS
"""A stamp whose difference to the log time deviates by more than this from the usual one is invalid."""
MIN_FROZEN_RUN, FROZEN_FACTOR = 5, 4.0
"""Messages have a frozen stamp if more than this number share it, and more than this multiple of the usual number."""
UNLOADED_NS = NS
"""Time from the first message on, whose median force is that without load."""
OTHER_AXES_SHARE, OTHER_AXES_FORCE = 1.1, DetectionSettings().threshold
"""A norm above this multiple of the peak along the axis, and above this force [N], shows a contact on other axes."""
CLOCK_STEP_RUN = 100
"""Number of consecutive invalid stamps that shows a clock step."""
MIN_STEP_RUN = 5
"""Number of stamps on each side of a jump that can show a clock step."""
MIN_STEP_NS, MIN_STEP_PERIODS = 10_000_000, 3.0
"""A smaller jump of the stamps, also in sampling periods, is jitter."""
STEP_AGREEMENT = 0.5
"""Share of a jump by which the change of the usual delay may differ from it."""


class _Messages(NamedTuple):
    """Log times, header stamps (0 if the type has none) [ns] and force, each (n,)."""

    log_times_ns: IntArray
    stamps_ns: IntArray
    force: FloatArray

    def without(self, invalid: BoolArray, problem: str, bag: Bag) -> "_Messages":
        """Return the messages that are not `invalid` (n,); the `bag` notes number and largest force of the others."""
        if invalid.any():
            peak = _peak(self.force[invalid])
            first_s = self.log_times_ns[invalid][0] / NS
            count = np.count_nonzero(invalid)
            bag.add_loss(f"{problem}: messages left out: {count}, from {first_s:.6f} s on, values up to {peak:.1f}")
        return _Messages(self.log_times_ns[~invalid], self.stamps_ns[~invalid], self.force[~invalid])


def read_wrench_topic(bag: Bag, settings: ImportSettings) -> ForceFile:
    """Read the force (along `settings.axis`, or a norm) from a topic of wrenches, or from a topic of Float64.

    Times are those of the headers, or the log times if the headers have no stamps. The norm is that of the difference
    to the median force of the first second, so the sensor must not turn. Raises BagError or SettingsError.
    """
    force_blocks = [topic.name for topic in bag.topics if topic.type == FORCE_BLOCK and topic.count]
    if force_blocks and not settings.topic:
        raise BagError(f"{bag.path}: already has ForceBlocks on {', '.join(force_blocks)}; needs no import")
    topic = bag.find_topic(settings.topic, TYPES)
    origin = f"{bag.path}: {topic.name}"
    refuse_settings(settings, TABLE_SETTINGS, origin, "messages have times")
    if topic.type == FLOAT64:
        refuse_settings(settings, ("axis",), origin, "a number has no axes")
    if settings.axis == "norm":
        refuse_settings(settings, ("sensor.invert",), origin, "a norm has no sign")
    messages, zero = _read(bag, topic, settings)
    component = "" if topic.type == FLOAT64 else f" force.{settings.axis}{zero}"
    stamps_ns, force = messages.log_times_ns, messages.force
    if messages.stamps_ns[:HEAD].any():
        messages = messages.without(_frozen(messages.stamps_ns), f"{topic.name}: the stamp is frozen", bag)
        _check_clock(messages.log_times_ns, messages.stamps_ns, origin)
        stamps_ns, force = _sort(messages, bag, topic)
    else:
        component += ", at log times"
    try:
        sample_rate, blocks = uniform_samples(origin, stamps_ns, force)
    except BagError as error:
        raise BagError("; ".join([str(error), *bag.losses])) from None
    info = first_run_info(bag)
    return ForceFile(
        description=f"{bag.path.name}, {topic.name}{component}",
        unit=settings.unit or "N",
        sample_rate=sample_rate,
        blocks=blocks,
        simulated=info is not None and info.simulated,
        losses=lambda: bag.losses,
    )


def _read(bag: Bag, topic: Topic, settings: ImportSettings) -> tuple[_Messages, str]:
    """Return the messages that can be decoded, and as text the force that was subtracted before the norm was taken."""
    log_times_ns, stamps_ns, values = array("q"), array("q"), array("d")
    frames: set[str] = set()
    for log_time_ns, (stamp_ns, frame_id, sample) in bag.decoded(topic.name, topic.type, partial(_sample, bag)):
        log_times_ns.append(log_time_ns)
        stamps_ns.append(stamp_ns)
        values.extend(sample)
        frames.add(frame_id)
    if not values:
        raise BagError("; ".join([f"{bag.path}: {topic.name}: no message can be decoded", *bag.losses]))
    if len(frames) > 1:
        rule = "must be one, because several sensors cannot share a topic"
        raise BagError(f"{bag.path}: {topic.name}: frame_id = {', '.join(sorted(frames))}: {rule}")
    times_ns, force = np.frombuffer(log_times_ns, np.int64), np.frombuffer(values)
    zero = ""
    if topic.type != FLOAT64:
        vectors = force.reshape(-1, 3)
        unloaded = vectors[(times_ns <= times_ns[:1] + UNLOADED_NS) & np.isfinite(vectors).all(axis=1)]
        offset = np.median(unloaded, axis=0) if len(unloaded) else np.zeros(3)
        with np.errstate(over="ignore", invalid="ignore"):  # damaged bags hold huge numbers
            norm = np.linalg.norm(vectors - offset, axis=1)
        if settings.axis == "norm":
            zero = " less ({:.1f}, {:.1f}, {:.1f})".format(*np.round(offset, 1) + 0.0)
            force = norm
        else:
            number = "xyz".index(settings.axis)
            force = vectors[:, number]
            along, largest = (_peak(values) for values in (force - offset[number], norm))
            unit = settings.unit or "N"
            if largest > OTHER_AXES_SHARE * along and largest * NEWTON_PER_UNIT.get(unit, 1.0) > OTHER_AXES_FORCE:
                problem = f"up to {along:.1f} {unit}, with the other axes up to {largest:.1f} {unit}: --axis norm"
                bag.add_loss(f"{topic.name} force.{settings.axis}: {problem}")
    return _Messages(times_ns, np.frombuffer(stamps_ns, np.int64), force), zero


def _peak(force: FloatArray) -> float:
    """Return the largest size of the finite samples of `force` (n,)."""
    return float(np.abs(force[np.isfinite(force)]).max(initial=0.0))


def _sample(bag: Bag, message: RawMessage) -> tuple[int, str, list[float]]:
    """Return stamp [ns], frame and force of a message; three components of a wrench. Raises DecodeError."""
    decoded = bag.deserialize(message)
    try:
        if message.type == FLOAT64:
            return 0, "", [float(decoded.data)]
        force = decoded.force if message.type == WRENCH else decoded.wrench.force
        sample = [float(getattr(force, name)) for name in "xyz"]
        if message.type == WRENCH:
            return 0, "", sample
        stamp = decoded.header.stamp
        return int(stamp.sec) * NS + int(stamp.nanosec), str(decoded.header.frame_id), sample
    except (AttributeError, TypeError, ValueError) as error:
        raise DecodeError(str(error)) from None


def _frozen(stamps_ns: IntArray) -> BoolArray:
    """Return a mask (n,) of the messages that repeat the stamp of the one before much longer than usual."""
    is_new = np.diff(stamps_ns, prepend=stamps_ns[:1] - 1) != 0
    run = np.cumsum(is_new) - 1
    lengths = np.bincount(run)
    is_long = lengths[run] > max(MIN_FROZEN_RUN, FROZEN_FACTOR * float(np.median(lengths)))
    frozen: BoolArray = ~is_new & is_long & (stamps_ns != 0)
    return frozen


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


def _sort(messages: _Messages, bag: Bag, topic: Topic) -> tuple[IntArray, FloatArray]:
    """Return stamps and force in the order of the stamps; messages with invalid stamps are left out."""
    differences_ns = messages.stamps_ns - messages.log_times_ns
    head_ns = np.sort(differences_ns[:HEAD])
    deviation_ns = differences_ns - head_ns[(len(head_ns) - 1) // 2]
    invalid = np.abs(deviation_ns) > MAX_DELAY_NS
    for start, stop in true_runs(invalid).tolist():
        if stop - start >= CLOCK_STEP_RUN:
            at = start + CLOCK_STEP_RUN - 1
            raise BagError(f"{bag.path}: {topic.name}: {_step_text(messages.log_times_ns[at], deviation_ns[at])}")
    problem = f"{topic.name}: the stamp deviates from the log time by more than {MAX_DELAY_NS / NS:g} s"
    _, stamps_ns, force = messages.without(invalid, problem, bag)
    order = np.argsort(stamps_ns, kind="stable")
    return stamps_ns[order], force[order]

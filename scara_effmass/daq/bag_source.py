# SPDX-License-Identifier: Apache-2.0
"""Force from a bag: read its ForceBlocks or wrenches, count missing samples, and play them at their recorded pace."""

import math
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from shlex import quote
from typing import final

import numpy as np

from scara_effmass.bags.bag import Bag
from scara_effmass.bags.files import open_bag
from scara_effmass.daq.source import ForceSource, Reading
from scara_effmass.errors import BagError, SettingsError
from scara_effmass.importers.force import IMPORTERS, MAX_VALUE, import_wrenches
from scara_effmass.settings import DaqSettings, ImportSettings
from scara_effmass.values import ForceBlock
from scara_effmass.wire.cdr import NS
from scara_effmass.wire.message_types import FORCE_BLOCK, WRENCH, WRENCH_STAMPED

TYPES = (FORCE_BLOCK, WRENCH_STAMPED, WRENCH)
"""Types of topics that can be played, by priority."""
POLL_S = 0.005
"""Polling period of the clock, which may be a simulated one."""
MAX_LEAD_NS = 10 * NS
"""A clock that starts at most this much before the bag is that of a replay of the bag."""
RELATIVE_NS = 10**8 * NS
"""Earlier stamps (before 1973) are relative to the start of the recording."""
CLOCK_STEP_NS = NS // 10
"""A clock that goes back by more has been set back; clocks that are adjusted go back by less."""
MAX_RATE_DRIFT = 0.01
"""Largest relative difference between the sample rates of two blocks of one recording."""
MAX_OVERLAP_NS = NS
"""A block that overlaps by less is a repetition and is left out; if stamps go back further, a clock was set back."""


def _ordered(blocks: Iterator[ForceBlock], origin: str) -> Iterator[ForceBlock]:
    """Yield the blocks in the order of their stamps, each with the number of samples missing before it.

    Empty, repeated and late blocks are left out.
    """
    sample_rate = 0.0
    last: ForceBlock | None = None
    for block in blocks:
        if not len(block.force):
            continue
        sample_rate = sample_rate or block.sample_rate
        _check_block(block, sample_rate, origin)
        if last is not None:
            end_ns = last.stamp_ns + len(last.force) * NS / sample_rate
            if block.stamp_ns < end_ns - MAX_OVERLAP_NS:
                stamps = f"{block.stamp_ns / NS:.6f} s follows {end_ns / NS:.6f} s"
                raise BagError(f"{origin}: time goes back, {stamps}; must be recorded without a clock step")
            if block.stamp_ns <= last.stamp_ns:
                continue
        yield block._replace(lost_samples=block.lost_since(last))
        last = block


def _check_block(block: ForceBlock, sample_rate: float, origin: str) -> None:
    rate, stamp = block.sample_rate, f"at {block.stamp_ns / NS:.6f} s"
    if not 0.0 <= block.clock_residual < math.inf:
        raise BagError(f"{origin}: clock_residual = {block.clock_residual:g} {stamp}: must be a number >= 0")
    if abs(rate / sample_rate - 1.0) > MAX_RATE_DRIFT:
        raise BagError(f"{origin}: sample_rate = {rate:g} {stamp}: must be {sample_rate:g} Hz, as before")


@final
class BagSource(ForceSource):
    """Play the ForceBlocks or wrenches of a bag by the ROS clock; each block is due at the time of its last sample.

    If the clock starts within the time span of the bag, or up to 10 s before it, the bag is being replayed on that
    clock: stamps are times of the clock, and blocks that are already due come at once. Otherwise, and with the stamps
    `now`, the first sample is due at the start, and the others follow at `bag.rate` times the original speed. A clock
    at 0 has not started yet. With a rate of 0, each block is due at once.

    With the stamps `now`, or if the bag has relative stamps, stamps are shifted such that the first one is the start.
    Samples that are not finite or absurdly large become NaN.

    When the clock of a replay goes back, as in a loop, playing continues there as a new run; the samples that were due
    before and not returned, at least one, count as lost. When any other clock goes back, playing continues without a
    pause; if the stamps move with the clock, as a new run. A bag that has ended stays ended.
    """

    filter_delay = 0.0  # recorded stamps are those of the force
    limit = float("inf")
    uses_ros_time = True

    def __init__(self, settings: DaqSettings, now_ns: Callable[[], int]) -> None:
        self.simulated = False
        self.channels = ("",)
        self.description = f"recorded: {settings.bag.path}"
        self.sample_rate = self.requested_rate = 0.0
        self.is_unpaced = settings.bag.rate == 0.0
        self.subscriber_timeout = settings.bag.subscriber_timeout
        self._settings = settings.bag
        self._sensor = settings.sensor
        if settings.bag.axis != "norm":  # with which the import refuses it
            self._sensor = self._sensor.model_copy(update={"invert": False})  # the signal conditioner inverts the sign
        self._now_ns = now_ns
        self._reading = threading.Lock()
        self._closing = threading.Event()
        self._bag: Bag | None = None
        self._blocks: Iterator[ForceBlock] = iter(())
        self._block: ForceBlock | None = None
        """The next block."""
        self._begin_ns: int | None = None
        """Time on the clock at which the first sample is due; None before the clock has started."""
        self._is_replay = False
        """Whether the clock is that of a replay of this bag."""
        self._latest_ns = 0
        """Latest time on the clock since it was last set back."""
        self._next_sample = self._run = 0
        self._ended = False

    @property
    def ended(self) -> bool:
        """Whether all blocks were returned."""
        return self._ended

    @property
    def losses(self) -> tuple[str, ...]:
        """One line for each part of the open bag that could not be read so far."""
        return self._bag.losses if self._bag else ()

    @property
    def waiting_for(self) -> str:
        """Time on the clock that the next block waits for."""
        begin_ns, block, now = self._begin_ns, self._block, f"now {self._latest_ns / NS:.3f} s"
        if begin_ns is None or block is None:
            return f"the clock to start ({now})"
        return f"the clock to reach {self._due_ns(block, begin_ns) / NS:.3f} s ({now})"

    def start(self) -> None:
        """Open the bag. Raises BagError or SettingsError."""
        if not self._settings.path:
            raise SettingsError("bag.path is empty: must be the bag to play")
        self.close()
        self._closing.clear()
        try:
            with self._reading:
                self._next_sample = self._run = 0
                self._begin_ns, self._is_replay = None, False
                self._block = self._open()
                self._latest_ns = self._now_ns()
                self._find_begin(self._latest_ns)
        except BaseException:
            self.close()
            raise

    def read(self, timeout_s: float) -> Reading | None:
        """Return the next block when it is due; None if it is not due within `timeout_s` [s], or at the end.

        Raises BagError if the bag is damaged.
        """
        deadline = time.monotonic() + timeout_s
        with self._reading:
            if self._bag is None:
                return None
            self._block = self._block or next(self._blocks, None)
            self._ended = self._block is None
            while self._block is not None and not self._closing.is_set():
                now_ns = self._now_ns()
                self._find_begin(now_ns)
                self._follow_clock(now_ns)
                begin_ns, block = self._begin_ns, self._block
                if begin_ns is not None and (self.is_unpaced or now_ns >= self._due_ns(block, begin_ns)):
                    self._block = None
                    return self._converted(block, now_ns, begin_ns - self._first_ns if self._is_shifted else 0)
                left_s = deadline - time.monotonic()
                if left_s <= 0.0:
                    break
                self._closing.wait(min(POLL_S, left_s))
        return None

    def close(self) -> None:
        """End a `read` that is waiting, and close the bag."""
        self._closing.set()
        with self._reading:
            self._block = None
            if self._bag is not None:
                self._bag.close()
                self._bag = None

    def _open(self) -> ForceBlock:
        """Open the bag, find its topic of force and return the first block. Raises BagError or SettingsError."""
        path = Path(self._settings.path)
        convert = f"convert its force first: scara-effmass import {quote(str(path))} -o BAG"
        if path.is_file() and path.suffix.lower() in IMPORTERS:
            raise BagError(f"{path}: is not a bag; {convert}")
        bag = self._bag = open_bag(path)
        found = bag.find_topic(self._settings.topic, TYPES, "bag.topic", f"; {convert}")
        topic = found.name
        origin = f"{bag.path}: {topic}"
        wrench = ImportSettings(topic=topic, axis=self._settings.axis, unit=self._settings.unit, sensor=self._sensor)
        recorded = bag.force_blocks(topic) if found.type == FORCE_BLOCK else import_wrenches(bag, wrench)[1]
        self._blocks = _ordered(recorded, origin)
        block = next(self._blocks, None)
        if block is None:
            raise BagError("; ".join([f"{origin}: has no force that can be read", *bag.losses]))
        self._is_shifted = self._settings.stamps == "now" or block.stamp_ns < RELATIVE_NS
        self._first_ns = block.stamp_ns
        self._ended = False
        self.channels = (topic.rpartition("/")[2],)
        self.sample_rate = self.requested_rate = block.sample_rate
        self.simulated = block.simulated
        source = f", of {block.source}" * bool(block.source)
        stated = ", simulated" * (self.simulated and "simulated" not in source)
        self.description = f"recorded{stated}: {bag.path.name}, {topic}{source}"
        return block

    def _find_begin(self, now_ns: int) -> None:
        """Determine, once the clock has started, when the first sample is due."""
        bag, rate = self._bag, self._settings.rate
        if self._begin_ns is not None or bag is None:
            return
        if now_ns == 0 and (self._is_shifted or rate > 0.0):
            return
        self._begin_ns = now_ns
        earliest_ns = min(self._first_ns, bag.start_ns) - MAX_LEAD_NS
        latest_ns = max(self._first_ns + bag.duration_ns, bag.end_ns)
        if self._is_shifted or not earliest_ns <= now_ns <= latest_ns:
            return
        if rate not in {0.0, 1.0}:
            rule = "must be 1, the bag is replayed on this clock"
            raise SettingsError(f"{self._settings.path}: bag.rate = {rate:g}: {rule}")
        self._begin_ns = self._first_ns
        self._is_replay = True

    def _follow_clock(self, now_ns: int) -> None:
        """Continue from `now_ns` if the clock has been set back."""
        latest_ns = self._latest_ns
        back_ns = latest_ns - now_ns
        if back_ns <= CLOCK_STEP_NS:
            self._latest_ns = max(now_ns, latest_ns)
            return
        self._latest_ns = now_ns
        if self._begin_ns is None or self.is_unpaced:
            return
        if self._is_replay:
            self._seek(latest_ns, now_ns)
            return
        self._begin_ns -= back_ns
        self._run += self._is_shifted

    def _seek(self, latest_ns: int, now_ns: int) -> None:
        """Open the bag again, and continue with the first block that ends at `now_ns` or later."""
        lost, waiting = 0, self._block
        if waiting is not None and self._next_sample:
            lost = max(1, 1 + int((latest_ns - waiting.stamp_ns) / NS * self.sample_rate))
        if self._bag is not None:
            self._bag.close()
        block: ForceBlock | None = self._open()
        while block is not None and self._last_ns(block) < now_ns:
            block = next(self._blocks, None)
        self._block = block and block._replace(lost_samples=lost)
        self._run += 1

    def _last_ns(self, block: ForceBlock) -> int:
        return block.stamp_ns + round((len(block.force) - 1) / self.sample_rate * NS)

    def _due_ns(self, block: ForceBlock, begin_ns: int) -> int:
        return begin_ns + round((self._last_ns(block) - self._first_ns) / self._settings.rate)

    def _converted(self, block: ForceBlock, now_ns: int, shift_ns: int) -> Reading:
        force = block.force + block.tare
        samples = np.where(np.abs(force) <= MAX_VALUE, force, np.nan)[np.newaxis]
        samples.flags.writeable = False
        saturated = None
        if len(block.saturated_samples):
            saturated = np.zeros(samples.shape, np.bool_)
            saturated[0, block.saturated_samples] = True
            saturated.flags.writeable = False
        self.simulated = self.simulated or block.simulated
        first = self._next_sample + block.lost_samples
        self._next_sample = first + len(block.force)
        return Reading(
            first_sample=first,
            samples=samples,
            lost=block.lost_samples,
            read_ns=now_ns,
            stamp_ns=block.stamp_ns + shift_ns,
            clock_residual=block.clock_residual,
            saturated=saturated,
            run=self._run,
            relative_uncertainty=block.relative_uncertainty,
            sample_rate=block.sample_rate,
            tare=block.tare,
            tare_stamp_ns=block.tare_stamp_ns and block.tare_stamp_ns + shift_ns,
        )

"""Force from a recording, at its own pace."""

from __future__ import annotations

import threading
import time
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, final

import numpy as np

from scara_effmass.daq.force_file import NS
from scara_effmass.daq.source import Reading, Unit
from scara_effmass.errors import SettingsError
from scara_effmass.settings import Stamps

if TYPE_CHECKING:
    from collections.abc import Callable

    from scara_effmass.daq.force_file import ForceFile, RecordedBlock
    from scara_effmass.settings import DaqSettings

CSV = "scara_effmass.daq.csv_force:open_csv_force"
FORMATS = {
    ".csv": CSV,
    ".tsv": CSV,
    ".txt": CSV,
    ".tdms": "scara_effmass.daq.tdms_force:open_tdms_force",
}
"""What opens files with these suffixes; anything else is a bag."""
BAG = "scara_effmass.daq.bag_force:open_bag_force"

POLL_S = 0.005
"""How often the clock is looked at: it may be a simulated one, which nobody can wait for."""

EARLY_NS = 10 * NS
"""A clock this little before a recording is on its way into it."""

RELATIVE_NS = 10**8 * NS
"""Times before this, in 1973, count from a start of their own."""

BACK_NS = NS // 10
"""A clock that is this much earlier than it was has been set back; clocks that are being adjusted are so by less."""

LARGEST = 1e9
"""[N] or [V]. No sensor reads that; greater numbers are none of force."""


@final
class RecordedForce:
    """A recording as the source of force.

    A block comes when the clock reaches the time of its last sample. If at the start the clock stands in the span of
    the recording or up to 10 s before, the recording is being replayed on that very clock: its stamps are the clock's
    times, and a source that comes late first catches up. Otherwise, and whenever stamps are `now`, the first sample
    is taken at the start, and the others follow at `bag.rate` times the original speed. A clock that stands at 0 has
    not begun, and is waited for. With a rate of 0 every block comes at once.

    With stamps `now`, and where the recording has no absolute time, stamps are moved so that the first one is that of
    the start. Samples that are no numbers, or absurdly large, come as NaN.

    When the clock of a replay is set back, as in a loop, the recording goes on from there, as another run: what was
    due on the old clock but had not come, at least one sample, is lost. On another clock that is set back, what
    follows goes on without a pause, another run as well if the stamps leap with the clock. A recording that came to
    its end before is over.
    """

    requested_rate: float
    filter_delay = 0.0
    """The stamps of a recording are those of the force."""
    limit = float("inf")

    def __init__(self, settings: DaqSettings, now_ns: Callable[[], int]) -> None:
        """Take the settings, and the clock by which to play."""
        self.unit = Unit.NEWTON
        self.simulated = False
        self.channels: tuple[str, ...] = ("",)
        self.description = f"recorded: {settings.bag.path}"
        self.sample_rate = self.requested_rate = 0.0
        self._settings = settings
        self._now_ns = now_ns
        self._reading = threading.Lock()
        self._closing = threading.Event()
        self._recording: ForceFile | None = None
        self._block: RecordedBlock | None = None
        """The next one."""
        self._begin_ns: int | None = None
        """The time on the clock at which the first sample is played; None while the clock has not begun."""
        self._replayed = False
        """Whether the clock is that of a replay of this very recording."""
        self._latest_ns = 0
        """The latest time on the clock since it was last set back."""
        self._shift_ns = 0
        self._next = self._run = 0
        self._ended = False

    @property
    def ended(self) -> bool:
        """Whether the recording is over."""
        return self._ended

    @property
    def losses(self) -> tuple[str, ...]:
        """What of the open recording could not be read so far, a line each."""
        return self._recording.losses() if self._recording else ()

    @property
    def awaited(self) -> str:
        """What the next block is waiting for, for people."""
        begin_ns, block, at = self._begin_ns, self._block, f"it is at {self._latest_ns / NS:.3f} s"
        if begin_ns is None or block is None:
            return f"waiting for the clock to begin: {at}"
        return f"waiting for the clock to reach {self._due_ns(block, begin_ns) / NS:.3f} s: {at}"

    def start(self) -> None:
        """Open the recording; raises BagError or SettingsError."""
        bag = self._settings.bag
        if not bag.path:
            raise SettingsError("bag.path: is empty; the recording to take force from would be right")
        self.close()
        self._closing.clear()
        try:
            with self._reading:
                self._next = self._run = 0
                self._begin_ns, self._replayed, self._shift_ns = None, False, 0
                self._block = self._open()
                self._latest_ns = self._now_ns()
                self._find_begin(self._latest_ns)
        except BaseException:
            self.close()
            raise

    def read(self, timeout_s: float) -> Reading | None:
        """Return the next block when it is due; None when that is not within `timeout_s`, or there is no more.

        Raises BagError where the recording turns out to be damaged.
        """
        until = time.monotonic() + timeout_s
        with self._reading:
            if self._recording is None:
                return None
            self._block = self._block or next(self._recording.blocks, None)
            self._ended = self._block is None
            while self._block is not None and not self._closing.is_set():
                now_ns = self._now_ns()
                self._find_begin(now_ns)
                self._follow(now_ns)
                if self._is_due(self._block, now_ns):
                    return self._taken(self._block, now_ns)
                left = until - time.monotonic()
                if left <= 0.0:
                    break
                self._closing.wait(min(POLL_S, left))
        return None

    def close(self) -> None:
        """End a read that is waiting, and close the recording."""
        self._closing.set()
        with self._reading:
            self._block = None
            if self._recording is not None:
                self._recording.close()
                self._recording = None

    def _open(self) -> RecordedBlock:
        """Open the recording, and return its first block."""
        bag = self._settings.bag
        module, _, name = FORMATS.get(Path(bag.path).suffix.lower(), BAG).partition(":")
        recording: ForceFile = getattr(import_module(module), name)(bag, self._settings.block_time)
        self._recording = recording
        block = next(recording.blocks)
        self._moved = bag.stamps is Stamps.NOW or block.stamp_ns < RELATIVE_NS
        self._first_ns = block.stamp_ns
        self._ended = False
        self.unit, self.channels = recording.unit, (recording.channel,)
        self.sample_rate = self.requested_rate = recording.sample_rate
        self.simulated = block.simulated
        self.description = f"recorded{', simulated' if self.simulated else ''}: {recording.description}"
        return block

    def _find_begin(self, now_ns: int) -> None:
        """Find out from the clock, once it has begun, when to play the first sample."""
        bag, recording = self._settings.bag, self._recording
        if self._begin_ns is not None or recording is None:
            return
        if now_ns == 0 and (self._moved or bag.rate > 0.0):
            return
        self._begin_ns = now_ns
        if self._moved:
            self._shift_ns = now_ns - self._first_ns
        elif recording.start_ns - EARLY_NS <= now_ns <= recording.end_ns:
            if bag.rate not in {0.0, 1.0}:
                reason = "the clock stands in the span of the recording, which is replayed at a speed of its own"
                raise SettingsError(f"{bag.path}: bag.rate = {bag.rate:g}: {reason}; 1 would be right")
            self._begin_ns = self._first_ns
            self._replayed = True

    def _follow(self, now_ns: int) -> None:
        """Go on, now, after the clock has been set back."""
        before_ns = self._latest_ns
        back_ns = before_ns - now_ns
        self._latest_ns = max(now_ns, before_ns) if back_ns <= BACK_NS else now_ns
        if back_ns <= BACK_NS or self._begin_ns is None or self._settings.bag.rate == 0.0:
            return
        if self._replayed:
            self._go_back(before_ns, now_ns)
            return
        self._begin_ns -= back_ns
        if self._moved:
            self._shift_ns -= back_ns
            self._run += 1

    def _go_back(self, before_ns: int, now_ns: int) -> None:
        """Open the recording again, and go on with the first block that is not yet over at `now_ns`."""
        lost, waiting = 0, self._block
        if waiting is not None and self._next:
            lost = max(1, 1 + int((before_ns - waiting.stamp_ns) / NS * self.sample_rate))
        if self._recording is not None:
            self._recording.close()
        block: RecordedBlock | None = self._open()
        while block is not None and self._last_ns(block) < now_ns:
            block = next(self._recording.blocks, None) if self._recording else None
        self._block = block and block._replace(lost=lost)
        self._run += 1

    def _last_ns(self, block: RecordedBlock) -> int:
        return block.stamp_ns + round((len(block.samples) - 1) / self.sample_rate * NS)

    def _due_ns(self, block: RecordedBlock, begin_ns: int) -> int:
        return begin_ns + round((self._last_ns(block) - self._first_ns) / self._settings.bag.rate)

    def _is_due(self, block: RecordedBlock, now_ns: int) -> bool:
        begin_ns = self._begin_ns
        if begin_ns is None:
            return False
        return self._settings.bag.rate == 0.0 or now_ns >= self._due_ns(block, begin_ns)

    def _taken(self, block: RecordedBlock, now_ns: int) -> Reading:
        samples = np.where(np.abs(block.samples) <= LARGEST, block.samples, np.nan)[np.newaxis]
        saturated = None if block.saturated is None else block.saturated[np.newaxis]
        for array in (samples, saturated):
            if array is not None:
                array.flags.writeable = False
        self.simulated = self.simulated or block.simulated
        first = self._next + block.lost
        self._next = first + len(block.samples)
        self._block = None
        stamp_ns = block.stamp_ns + self._shift_ns
        return Reading(first, samples, block.lost, now_ns, stamp_ns, block.clock_residual, saturated, self._run)

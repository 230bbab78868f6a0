"""From what a source reads to blocks of newtons with a time."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

import numpy as np

from scara_effmass.daq.clock import ClockFit
from scara_effmass.daq.source import Unit
from scara_effmass.daq.tare import Tare
from scara_effmass.settings import FilterKind
from scara_effmass.values import ForceBlock

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from scara_effmass.daq.lowpass import Lowpass
    from scara_effmass.daq.source import ForceSource, Reading
    from scara_effmass.settings import DaqSettings
    from scara_effmass.values import BoolArray, FloatArray

RANGE_TOLERANCE = 1e-3
"""A sample is at the end of the range so much below it: the last codes of a converter are not exactly at its limit."""
MOST_LOST = 2**32 - 1
"""What `ForceBlock.lost_samples` can say."""
NO_FORCE: FloatArray = np.empty(0)
NO_FORCE.flags.writeable = False
NONE_SATURATED: NDArray[np.uint32] = np.empty(0, np.uint32)
NONE_SATURATED.flags.writeable = False


class ForceSignal:
    """Turns the readings of one source into blocks of force, for all of its channels.

    Readings of a device are timed by the `clock` all channels share; recordings bring their own time. The delays of
    the source's filter and of the low-pass are taken off the stamps and declared.
    """

    def __init__(self, source: ForceSource, settings: DaqSettings) -> None:
        """Expect readings of `source`, which has been started. Raises SettingsError when it cannot be filtered so."""
        volts = source.unit is Unit.VOLT
        newton_per_unit = 1e3 / settings.sensor.sensitivity if volts else 1.0
        self._limit = min(source.limit * newton_per_unit, settings.sensor.range) * (1.0 - RANGE_TOLERANCE)
        self._source = source
        self._scale = -newton_per_unit if settings.sensor.invert else newton_per_unit
        self._uncertainty = 0.0 if source.simulated else settings.sensor.sensitivity_uncertainty
        self._volts = volts
        self._end: int | None = None
        self._run = 0
        self.clock = ClockFit(source.sample_rate)
        """Of no use for recordings."""
        self.channels = tuple(
            # Each sensor has a place of its own; the first has the frame that was set.
            ForceChannel(name, f"{settings.frame_id}_{name}" if i else settings.frame_id, settings, source)
            for i, name in enumerate(source.channels)
        )

    @property
    def taring(self) -> bool:
        """Whether a tare is under way in any channel."""
        return any(channel.taring for channel in self.channels)

    def begin_tare(self) -> None:
        """Take the force from now on for zero, once there is enough of it."""
        for channel in self.channels:
            channel.begin_tare()

    def blocks(self, reading: Reading) -> list[list[ForceBlock]]:
        """Return for each channel the blocks in `reading`: one, none, or several around samples that are not finite."""
        n = reading.samples.shape[1]
        first = reading.first_sample
        # Numbers that begin anew say nothing about what is missing; the source does.
        lost = reading.lost if self._end is None else max(reading.lost, first - self._end)
        self._end = first + n
        sample_rate = self._source.sample_rate
        residual = reading.clock_residual
        uncertainty = self._uncertainty
        if reading.stamp_ns is not None:
            stamp_ns = reading.stamp_ns
            uncertainty = uncertainty if self._volts else 0.0  # nobody knows what sensor recorded the newtons
        elif n:
            if reading.run != self._run:
                self._run = reading.run
                self.clock.reset()
            self.clock.update(self._end, reading.read_ns)
            stamp_ns = self.clock.stamp_ns(first) - round(self._source.filter_delay * 1e9)
            sample_rate = self.clock.sample_rate
            residual = self.clock.residual
        else:
            stamp_ns = reading.read_ns
        force = reading.samples * self._scale
        common = ForceBlock(
            stamp_ns=stamp_ns,
            frame_id="",
            first_sample=first,
            sample_rate=sample_rate,
            force=NO_FORCE,
            lost_samples=lost,
            saturated_samples=NONE_SATURATED,
            clock_residual=residual,
            filter_delay=self._source.filter_delay,
            source=self._source.description,
            simulated=self._source.simulated,
            tare=0.0,
            tare_stamp_ns=0,
            relative_uncertainty=uncertainty,
        )
        beyond: Sequence[BoolArray | None] = [None] * len(self.channels)
        # False with NaN, too, so this one comparison tells the usual case.
        if reading.saturated is not None or not (n and -self._limit < force.min() and force.max() < self._limit):
            marked = np.abs(force) >= self._limit
            beyond = list(marked if reading.saturated is None else marked | reading.saturated)
        return [
            list(channel.blocks(common, row, saturated))
            for channel, row, saturated in zip(self.channels, force, beyond, strict=True)
        ]


class ForceChannel:
    """One channel: its low-pass, its tare, and what became of its samples so far.

    Nothing is held back: until the first tare is complete, blocks carry a tare of 0 with a stamp of 0, and a new tare
    holds from the next reading on. That is a step in the force, but none in force plus tare, which is what the sensor
    read. A tare that is refused leaves things as they were, with the reason in `tare_problem`.
    """

    def __init__(self, name: str, frame_id: str, settings: DaqSettings, source: ForceSource) -> None:
        """Expect samples of `source`."""
        self.name = name
        self.frame_id = frame_id
        self.samples = 0
        """published so far"""
        self.saturated = 0
        """of those"""
        self.tare = 0.0
        """[N]"""
        self.tare_stamp_ns = 0
        self.tare_problem = ""
        """why the latest tare was refused; empty when it was not"""
        self._settings = settings
        self._sample_rate = source.sample_rate
        self._lowpass = _lowpass(settings, source.sample_rate)
        self._memory = self._lowpass.memory if self._lowpass else 0
        self.lowpass_delay = self._lowpass.delay / source.sample_rate if self._lowpass else 0.0
        """[s], taken off the stamps"""
        self._next: int | None = None
        self._lost = 0
        self._missing = 0
        self._since_saturated = self._memory + 1
        self._tare: Tare | None = None
        if settings.tare.at_start:
            self.begin_tare()

    @property
    def lost(self) -> int:
        """Samples that never came, or were not finite."""
        return self._lost + self._missing

    @property
    def taring(self) -> bool:
        """Whether a tare is under way."""
        return self._tare is not None

    def begin_tare(self) -> None:
        """Take the force from now on for zero, once there is enough of it."""
        self._tare = Tare(self._settings.tare, self._sample_rate)
        self.tare_problem = ""

    def blocks(self, reading: ForceBlock, force: FloatArray, saturated: BoolArray | None) -> Iterator[ForceBlock]:
        """Cut one reading into finished blocks.

        `reading` has what is the same for all channels, `force` (n,) is in [N] as the sensor gave it, `saturated` (n,)
        marks samples at the end of the range; None when there is none, and none that is not finite.
        """
        self._missing += reading.lost_samples
        end = 0
        for start, stop in [(0, force.size)] if saturated is None else _finite_runs(force):
            self._missing += start - end
            yield self._block(reading, start, force[start:stop], None if saturated is None else saturated[start:stop])
            end = stop
        self._missing += force.size - end

    def _block(self, reading: ForceBlock, start: int, force: FloatArray, saturated: BoolArray | None) -> ForceBlock:
        first = reading.first_sample + start
        if self._missing or first != self._next:
            self._forget()
        if self._lowpass:
            force = self._lowpass(force)
        marks = self._marks(saturated, force.size)
        block = reading._replace(
            frame_id=self.frame_id,
            stamp_ns=reading.stamp_ns + round((start / reading.sample_rate - self.lowpass_delay) * 1e9),
            first_sample=first,
            force=force - self.tare,
            lost_samples=min(self._missing, MOST_LOST),
            saturated_samples=marks,
            filter_delay=reading.filter_delay + self.lowpass_delay,
            tare=self.tare,
            tare_stamp_ns=self.tare_stamp_ns,
        )
        block.force.flags.writeable = False
        self.samples += force.size
        self._lost += self._missing
        self.saturated += marks.size
        self._missing = 0
        self._next = first + force.size
        if self._tare:
            self._go_on_taring(self._tare, force, block)
        return block

    def _forget(self) -> None:
        self._since_saturated = self._memory + 1
        if self._lowpass:
            self._lowpass.reset()

    def _marks(self, saturated: BoolArray | None, n: int) -> NDArray[np.uint32]:
        """Return the indices of the outputs that a saturated sample has influenced."""
        if saturated is None and self._since_saturated > self._memory:
            return NONE_SATURATED
        index = np.arange(n)
        latest = np.full(n, -self._since_saturated)
        if saturated is not None:
            latest = np.maximum.accumulate(np.where(saturated, index, latest))
        self._since_saturated = n - int(latest[-1])
        marks = np.flatnonzero(index - latest <= self._memory).astype(np.uint32)
        marks.flags.writeable = False
        return marks

    def _go_on_taring(self, tare: Tare, force: FloatArray, block: ForceBlock) -> None:
        tare.add(force, block.saturated_samples)
        if not tare.done:
            return
        self._tare = None
        result = tare.result()
        if isinstance(result, str):
            self.tare_problem = result
        else:
            self.tare = result
            self.tare_stamp_ns = block.stamp_ns + round((force.size - 1) / block.sample_rate * 1e9)


def _lowpass(settings: DaqSettings, sample_rate: float) -> Lowpass | None:
    if settings.filter.kind is FilterKind.NONE:
        return None
    # Its scipy takes a second to load and 80 MB, so only for those who filter.
    lowpass: Lowpass = import_module("scara_effmass.daq.lowpass").make_lowpass(settings.filter, sample_rate)
    return lowpass


def _finite_runs(force: FloatArray) -> Iterator[tuple[int, int]]:
    """Yield the bounds of each run of finite samples."""
    finite = np.concatenate(([False], np.isfinite(force), [False]))
    edges = np.flatnonzero(finite[1:] != finite[:-1])
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)

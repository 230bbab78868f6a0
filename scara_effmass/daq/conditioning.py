# SPDX-License-Identifier: Apache-2.0
"""Convert the samples of a force source to ForceBlocks: sign, filter, tare, stamps and saturation."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from scara_effmass.daq.clock_fit import ClockFit
from scara_effmass.daq.source import ForceSource, Reading
from scara_effmass.settings import DaqSettings, TareSettings
from scara_effmass.values import (
    NONE_SATURATED,
    RANGE_TOLERANCE,
    BoolArray,
    FloatArray,
    ForceBlock,
    true_runs,
)
from scara_effmass.wire.cdr import NS

if TYPE_CHECKING:
    from scara_effmass.daq.lowpass import Lowpass

NO_FORCE: FloatArray = np.empty(0)
NO_FORCE.flags.writeable = False
PARTS = 10
"""Number of parts of a tare; a short disturbance affects one or two of them."""
MIN_PARTS = 7
"""Minimum number of valid parts; the median then lies among valid ones."""


class SignalConditioner:
    """Convert the readings of one source to the force blocks of each channel.

    A `ClockFit` stamps the readings of a device, equally for all channels; recordings have their own stamps. The delays
    of the source and of the low-pass are subtracted from the stamps and stated in the blocks.
    """

    def __init__(self, source: ForceSource, settings: DaqSettings) -> None:
        """Prepare for readings of `source`, which has been started. Raises SettingsError for an impossible filter."""
        self._source = source
        self._limit = min(source.limit, settings.sensor.range) * (1.0 - RANGE_TOLERANCE)
        self._sign = -1.0 if settings.sensor.invert else 1.0
        self._uncertainty = 0.0 if source.simulated else settings.sensor.sensitivity_uncertainty
        self._end: int | None = None
        self._run = 0
        lowpass = settings.filter
        applied = "" if lowpass.kind == "none" else f", {lowpass.kind} low-pass {lowpass.cutoff:g} Hz"
        self._description = source.description + applied
        self.clock = ClockFit(source.sample_rate)
        """Unused for recordings."""
        self.channels = tuple(
            # Each sensor has its own frame; that of the first one is in the settings.
            ForceChannel(name, f"{settings.frame_id}_{name}" if number else settings.frame_id, settings, source)
            for number, name in enumerate(source.channels)
        )

    @property
    def taring(self) -> bool:
        """Whether a tare is in progress in any channel."""
        return any(channel.taring for channel in self.channels)

    def begin_tare(self) -> None:
        """Start a tare of all channels."""
        for channel in self.channels:
            channel.begin_tare()

    def blocks(self, reading: Reading) -> list[list[ForceBlock]]:
        """Return the blocks of each channel: usually one; none or several if some samples are not finite."""
        n = reading.samples.shape[1]
        first = reading.first_sample
        # If the sample numbers restart, only the source knows what is missing.
        lost = reading.lost if self._end is None else max(reading.lost, first - self._end)
        self._end = first + n
        sample_rate, residual = reading.sample_rate or self._source.sample_rate, reading.clock_residual
        if reading.stamp_ns is not None:
            stamp_ns = reading.stamp_ns
        elif n:
            if reading.run != self._run:
                self._run = reading.run
                self.clock.reset()
            self.clock.update(self._end, reading.read_ns)
            stamp_ns = self.clock.stamp_ns(first) - round(self._source.filter_delay * NS)
            sample_rate, residual = self.clock.sample_rate, self.clock.residual
        else:
            stamp_ns = reading.read_ns
        for channel, fault in zip(self.channels, reading.faults or [""] * len(self.channels), strict=True):
            channel.fault = fault
        force = reading.samples * self._sign
        stated = reading.relative_uncertainty
        common = ForceBlock(
            stamp_ns=stamp_ns,
            frame_id="",
            first_sample=first,
            sample_rate=sample_rate,
            force=NO_FORCE,
            lost_samples=lost,
            clock_residual=residual,
            filter_delay=self._source.filter_delay,
            source=self._description,
            simulated=self._source.simulated,
            relative_uncertainty=self._uncertainty if stated is None else stated,
            tare=reading.tare * self._sign,
            tare_stamp_ns=reading.tare_stamp_ns,
        )
        saturated: Sequence[BoolArray | None] = [None] * len(self.channels)
        # With NaN the comparisons are false, so they alone recognize the usual case.
        if reading.saturated is not None or not (n and -self._limit < force.min() and force.max() < self._limit):
            beyond = np.abs(force) >= self._limit
            saturated = list(beyond if reading.saturated is None else beyond | reading.saturated)
        return [
            list(channel.blocks(common, row, marks))
            for channel, row, marks in zip(self.channels, force, saturated, strict=True)
        ]


class ForceChannel:
    """Filter and tare the samples of one channel, and count them.

    Blocks are never held back: until the first tare is complete, they state a tare of 0 with the stamp 0. A new tare
    applies from the next reading on; force plus tare, which is what the sensor read, has no step there. A refused tare
    changes nothing and sets `tare_problem`. Of the tares of a recording and of this node, the latest one applies.
    """

    def __init__(self, name: str, frame_id: str, settings: DaqSettings, source: ForceSource) -> None:
        """Prepare for samples of `source`."""
        self.name = name
        self.frame_id = frame_id
        self.samples = 0
        """Published samples."""
        self.saturated = 0
        """Published samples that are saturated."""
        self.fault = ""
        """What is wrong with the sensor; empty if nothing is."""
        self.tare = 0.0
        """[N]"""
        self.tare_stamp_ns = 0
        self.tare_problem = ""
        """Why the latest tare was refused; empty if it was not."""
        self._settings = settings
        self._sample_rate = source.sample_rate
        self._lowpass = _lowpass(settings, source.sample_rate)
        self._memory = self._lowpass.memory if self._lowpass else 0
        self.lowpass_delay = self._lowpass.delay / source.sample_rate if self._lowpass else 0.0
        """[s], subtracted from the stamps."""
        self._next: int | None = None
        self._lost = 0
        self._missing = 0
        """Lost samples that the next block will state."""
        self._since_saturated = self._memory + 1
        self._tare: Tare | None = None
        if settings.tare.at_start:
            self.begin_tare()

    @property
    def lost(self) -> int:
        """Samples that never arrived or were not finite."""
        return self._lost + self._missing

    @property
    def taring(self) -> bool:
        """Whether a tare is in progress."""
        return self._tare is not None

    def begin_tare(self) -> None:
        """Start a tare."""
        self._tare = Tare(self._settings.tare, self._sample_rate)
        self.tare_problem = ""

    def blocks(self, common: ForceBlock, force: FloatArray, saturated: BoolArray | None) -> Iterator[ForceBlock]:
        """Yield the finished blocks of one reading.

        `common` holds the fields that all channels share. `force` (n,) is in [N], as the sensor measured it.
        `saturated` (n,) marks samples at the end of the range; None if there are none, and all samples are finite.
        """
        self._missing += common.lost_samples
        end = 0
        for start, stop in [(0, force.size)] if saturated is None else true_runs(np.isfinite(force)).tolist():
            self._missing += start - end
            yield self._block(common, start, force[start:stop], None if saturated is None else saturated[start:stop])
            end = stop
        self._missing += force.size - end

    def _block(self, common: ForceBlock, start: int, force: FloatArray, saturated: BoolArray | None) -> ForceBlock:
        first = common.first_sample + start
        if self._missing or first != self._next:
            self._since_saturated = self._memory + 1
            if self._lowpass:
                self._lowpass.reset()
        if self._lowpass:
            force = self._lowpass(force)
        marks = self._influenced(saturated, force.size)
        if common.tare_stamp_ns >= self.tare_stamp_ns:
            self.tare, self.tare_stamp_ns = common.tare, common.tare_stamp_ns
        block = common._replace(
            frame_id=self.frame_id,
            stamp_ns=common.stamp_ns + round((start / common.sample_rate - self.lowpass_delay) * NS),
            first_sample=first,
            force=force - self.tare,
            lost_samples=self._missing,
            saturated_samples=marks,
            filter_delay=common.filter_delay + self.lowpass_delay,
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
            self._continue_tare(self._tare, force, block)
        return block

    def _influenced(self, saturated: BoolArray | None, n: int) -> NDArray[np.uint32]:
        """Return the indices of the outputs that saturated samples influence through the low-pass."""
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

    def _continue_tare(self, tare: Tare, force: FloatArray, block: ForceBlock) -> None:
        tare.add(force, block.saturated_samples)
        if not tare.done:
            return
        self._tare = None
        result = tare.result()
        if isinstance(result, str):
            self.tare_problem = result
        else:
            self.tare = result
            self.tare_stamp_ns = block.stamp_ns + round((force.size - 1) / block.sample_rate * NS)


class Tare:
    """Median of the means of ten consecutive parts of a signal.

    An impact falls into one or two parts, which move the median by no more than the noise. The sensor was at rest if at
    least seven parts have no saturated sample and are within the tolerance of the median; otherwise there is no result.
    """

    def __init__(self, settings: TareSettings, sample_rate: float) -> None:
        """Use `settings.time` of samples at `sample_rate` [Hz], at least ten."""
        self._tolerance = settings.tolerance
        self._length = PARTS * max(1, round(settings.time * sample_rate / PARTS))
        self._force: FloatArray = np.empty(0)
        self._saturated: BoolArray = np.empty(0, np.bool_)

    @property
    def done(self) -> bool:
        """Whether all samples were added."""
        return self._force.size == self._length

    def add(self, force: FloatArray, saturated_samples: NDArray[np.uint32]) -> None:
        """Add the next samples [N], all finite; those after the end are ignored. Indices are as in `ForceBlock`."""
        saturated = np.isin(np.arange(force.size), saturated_samples)
        self._force = np.concatenate((self._force, force))[: self._length]
        self._saturated = np.concatenate((self._saturated, saturated))[: self._length]

    def result(self) -> float | str:
        """Return the zero force [N], or the reason why there is none. Requires `done`."""
        valid = ~self._saturated.reshape(PARTS, -1).any(axis=1)
        means = self._force.reshape(PARTS, -1)[valid].mean(axis=1)
        if means.size < MIN_PARTS:
            return "refused: the force was at the end of the measuring range, or the sensor open or shorted"
        zero = float(np.median(means))
        if np.count_nonzero(np.abs(means - zero) <= self._tolerance) < MIN_PARTS:
            return f"refused: the force moved by {np.ptp(means):.3g} N, tare.tolerance is {self._tolerance:g} N"
        return zero


def _lowpass(settings: DaqSettings, sample_rate: float) -> Lowpass | None:
    if settings.filter.kind == "none":
        return None
    from scara_effmass.daq.lowpass import make_lowpass  # noqa: PLC0415 - scipy takes a second and 80 MB to load

    return make_lowpass(settings.filter, sample_rate)

# SPDX-License-Identifier: Apache-2.0
"""The source `ni9230`: IEPE force sensors on an NI-9230, or another module with IEPE supply, through NI-DAQmx."""

import math
import re
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any, final

import numpy as np
from nidaqmx import Task, constants, errors
from nidaqmx.stream_readers import AnalogMultiChannelReader

from scara_effmass.daq.ni_driver import SAMPLES_NOT_YET_AVAILABLE, daq_error, optional, translated
from scara_effmass.daq.source import ForceSource, Reading
from scara_effmass.errors import DaqError
from scara_effmass.settings import DaqSettings
from scara_effmass.values import BoolArray, FloatArray

OVERLOAD = "overloaded"
SENSOR_FAULTS = {
    "open": "the sensor is open",
    "open_current_loop": "the sensor is open",
    "overcurrent": "the sensor is shorted",
}
"""Faults of a sensor, by the driver's name of its channels. Each module detects some of them, or none."""
BUFFER_TIME_S = 10.0
"""Size of the driver's buffer: reading may pause for this time without a loss."""


@final
class Ni9230Source(ForceSource):
    """Samples of the channels in `settings.ni9230`, one block every `settings.block_time`.

    The driver returns samples without a gap or fails, so `Reading.lost` is 0; after an OverrunError or a
    DeviceLostError, the caller determines from the time what is missing. The driver states that a channel was
    overloaded, but not when: its samples at the limit are marked as saturated or, if there are none, all of them. An
    open or shorted sensor reads zero as at rest: all samples of its channel are marked, and `Reading.faults` names it.
    """

    def __init__(self, settings: DaqSettings, now_ns: Callable[[], int]) -> None:
        self._settings = settings
        self._now_ns = now_ns
        self.requested_rate = self.sample_rate = settings.ni9230.sample_rate
        self.channels = _topic_names(settings.ni9230.channels)
        self.simulated = False
        self.limit = math.inf
        self.filter_delay = settings.ni9230.filter_delay_samples / self.sample_rate
        self.description = f"{', '.join(settings.ni9230.channels)}, IEPE, {settings.ni9230.coupling} coupling"

        self._subject = f"ni9230.channels = {', '.join(settings.ni9230.channels)}"
        self._was_connected = False
        self._lock = threading.RLock()
        """Held during all calls of the driver except the one that aborts a task."""
        self._closing = False
        self._task: Any = None
        self._next = 0
        self._failure: DaqError | None = None
        """Error that came with the samples of the last reading; the next `read` raises it."""

    @property
    def ended(self) -> bool:
        """Whether all samples of a finite acquisition were read."""
        return 0 < self._settings.ni9230.samples <= self._next

    def start(self) -> None:
        """Reserve and configure the device and start to acquire. Raises DaqError, also while it is disconnected."""
        with self._lock:
            self._clear()
            self._closing = False
            self._next, self._failure = 0, None
            try:
                with translated(self._subject, was_connected=self._was_connected):
                    self._configure()
                    self._task.start()
            except BaseException:
                self._clear()
                raise
            self._was_connected = True

    def read(self, timeout_s: float) -> Reading | None:
        """Return the next block, or the part of it that came within `timeout_s` [s]; None if no sample came."""
        with self._lock:
            if self._task is None or self._closing or self.ended:
                return None
            if self._failure is not None:
                raise self._failure
            count = self._fill(timeout_s)
            if not count:
                return None
            # After a partial read, the channels directly follow each other in the buffer.
            samples = self._buffer[: len(self.channels) * count].reshape(len(self.channels), count).copy()
            faults = self._faults()
            saturated = self._saturated(samples, faults)
            samples.flags.writeable = False
            first, self._next = self._next, self._next + count
            return Reading(first, samples, 0, self._read_ns, saturated=saturated, faults=faults)

    def close(self) -> None:
        """Stop acquiring and release the device; a `read` in progress returns None."""
        self._closing = True
        task = self._task
        if task is not None:
            with suppress(errors.Error):
                task.control(constants.TaskMode.TASK_ABORT)
        with self._lock:
            self._clear()

    def _configure(self) -> None:
        sensor, converter = self._settings.sensor, self._settings.ni9230
        task = self._task = Task()
        inputs = []
        for name in converter.channels:
            channel = task.ai_channels.add_ai_force_iepe_chan(
                name,
                min_val=-sensor.range,
                max_val=sensor.range,
                units=constants.ForceUnits.NEWTONS,
                sensitivity=sensor.sensitivity,
                sensitivity_units=constants.ForceIEPESensorSensitivityUnits.MILLIVOLTS_PER_NEWTON,
                current_excit_source=constants.ExcitationSource["INTERNAL" if converter.current else "NONE"],
                current_excit_val=converter.current,
            )
            channel.ai_coupling = constants.Coupling[converter.coupling]
            inputs.append(channel)
        mode = constants.AcquisitionType.FINITE if converter.samples else constants.AcquisitionType.CONTINUOUS
        task.timing.cfg_samp_clk_timing(
            converter.sample_rate,
            sample_mode=mode,
            samps_per_chan=converter.samples or math.ceil(BUFFER_TIME_S * converter.sample_rate),
        )
        self.sample_rate = float(task.timing.samp_clk_rate)
        self.limit = min(optional(channel, "ai_max") or math.inf for channel in inputs)
        self.filter_delay = max(self._delay(channel) for channel in inputs)
        modules = task.devices
        self.simulated = any(module.is_simulated for module in modules)
        products = ", ".join(sorted({module.product_type for module in modules}))
        self.description = (
            f"{products} {', '.join(converter.channels)}, {'simulated by its driver, ' * self.simulated}"
            f"IEPE {converter.current * 1e3:g} mA, {converter.coupling} coupling, {sensor.sensitivity:g} mV/N"
        )
        self._block = max(1, round(self._settings.block_time * self.sample_rate))
        self._buffer = np.empty(len(inputs) * self._block)
        self._reader = AnalogMultiChannelReader(task.in_stream)
        self._reader.verify_array_shape = False  # saves a call of the driver
        self._detected = {OVERLOAD, *SENSOR_FAULTS}

    def _delay(self, channel: Any) -> float:  # noqa: ANN401 - nidaqmx has no types
        """Return the delay of the converter's filter [s] from the driver or, if it states none, from the settings."""
        delay: float | None = optional(channel, "ai_filter_delay")
        per_second = {
            constants.DigitalWidthUnits.SECONDS: 1.0,
            constants.DigitalWidthUnits.SAMPLE_CLOCK_PERIODS: self.sample_rate,
        }.get(optional(channel, "ai_filter_delay_units"))
        if delay is None or per_second is None:
            return self._settings.ni9230.filter_delay_samples / self.sample_rate
        return delay / per_second

    def _fill(self, timeout_s: float) -> int:
        """Read up to a block into the buffer and return the number of samples per channel."""
        requested = self._block
        if self._settings.ni9230.samples:
            requested = min(requested, self._settings.ni9230.samples - self._next)
        part = self._buffer[: len(self.channels) * requested].reshape(len(self.channels), requested)
        try:
            count = int(self._reader.read_many_sample(part, requested, max(0.0, timeout_s)))
        except errors.Error as error:
            if self._closing:
                return 0
            count = int(getattr(error, "samps_per_chan_read", 0))
            if getattr(error, "error_code", 0) != SAMPLES_NOT_YET_AVAILABLE:
                self._failure = daq_error(error, self._subject, was_connected=True, addition=self._unread(count))
                if not count:
                    raise self._failure from error
        self._read_ns = self._now_ns()
        return count

    def _unread(self, count: int) -> str:
        acquired = optional(self._task.in_stream, "total_samp_per_chan_acquired")
        missing = 0 if acquired is None else int(acquired) - self._next - count
        return f"; {missing} samples were acquired and not read" if missing > 0 else ""

    def _faults(self) -> tuple[str, ...]:
        """Return the fault of each channel's sensor since the last read; () if there is none."""
        faults = [""] * len(self.channels)
        for status, fault in SENSOR_FAULTS.items():
            for row in np.flatnonzero(self._affected(status)):
                faults[row] = f"{fault}: check sensor and cable"
        return tuple(faults) if any(faults) else ()

    def _saturated(self, samples: FloatArray, faults: tuple[str, ...]) -> BoolArray | None:
        overloaded, at_limit = self._affected(OVERLOAD)[:, np.newaxis], np.abs(samples) >= self.limit
        marks: BoolArray = overloaded & (at_limit | ~at_limit.any(axis=1, keepdims=True))
        if faults:
            marks[np.array(faults) != ""] = True
        marks.flags.writeable = False
        return marks if marks.any() else None

    def _affected(self, status: str) -> BoolArray:
        """Return a mask of the channels for which the driver states `status`; it does so once for each event."""
        rows = np.zeros(len(self.channels), np.bool_)
        if status not in self._detected:
            return rows
        stream = self._task.in_stream
        try:
            exist = getattr(stream, f"{status}_chans_exist")
        except errors.Error:
            # Not every module detects each status. If the device is lost instead, the next read raises.
            self._detected.remove(status)
            return rows
        if exist:
            with suppress(errors.Error):
                rows |= np.isin(self._task.channel_names, getattr(stream, f"{status}_chans"))
            if not rows.any():  # the driver does not state which
                rows[:] = True
        return rows

    def _clear(self) -> None:
        task, self._task = self._task, None
        if task is not None:
            with suppress(errors.Error):  # a lost device has released itself
                task.close()


def _topic_names(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return names for the ends of topics: that of the channel; with that of the device if two channels are alike."""
    short = [name.rpartition("/")[2] for name in names]
    unique = short if len(set(short)) == len(short) else names
    return tuple(re.sub(r"\W", "_", name) for name in unique)

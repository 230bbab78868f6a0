"""Force from an IEPE sensor on a NI-9230, or another module that can supply one, through NI-DAQmx."""

from __future__ import annotations

import math
import re
import threading
from contextlib import suppress
from typing import TYPE_CHECKING, Any, final

import numpy as np

from scara_effmass.daq.ni_driver import AnalogMultiChannelReader, Task, constants, errors, optional, told, translated
from scara_effmass.daq.ni_errors import NOT_YET_AVAILABLE
from scara_effmass.daq.source import Reading, Unit

if TYPE_CHECKING:
    from collections.abc import Callable

    from scara_effmass.errors import DaqError
    from scara_effmass.settings import DaqSettings
    from scara_effmass.values import BoolArray, FloatArray

BUFFER_TIME_S = 10.0
"""What the driver's buffer holds of a continuous acquisition: how long reading may pause without a loss."""


@final
class Ni9230:
    """Samples in newtons of the channels in `settings.ni9230`, `settings.block_time` at a time; see `ForceSource`.

    The driver numbers samples without a gap or fails, so `Reading.lost` is 0; what is missing after an OverrunError or
    a DeviceLostError is for the caller to find from the time that passed. `close` may come from another thread and
    ends a `read` that waits. Where the driver says that a channel was overloaded but not when, its samples at the
    limit are marked, or all of the reading if none is.
    """

    unit = Unit.NEWTON

    def __init__(self, settings: DaqSettings, now_ns: Callable[[], int]) -> None:
        self._settings = settings
        self._now_ns = now_ns
        self.requested_rate = self.sample_rate = settings.ni9230.sample_rate
        self.channels = _short(settings.ni9230.channels)
        self.simulated = False
        self.limit = math.inf
        self.filter_delay = settings.ni9230.filter_delay_samples / self.sample_rate
        self.description = f"{', '.join(settings.ni9230.channels)}, IEPE, {settings.ni9230.coupling.value} coupling"

        self._subject = f"ni9230.channels = {', '.join(settings.ni9230.channels)}"
        self._was_there = False
        self._lock = threading.RLock()
        """Held during calls of the driver; only aborting a task is allowed without."""
        self._closing = False
        self._task: Any = None
        self._next = 0
        self._failure: DaqError | None = None
        """Came with the samples of the last reading, and is raised by the next one."""

    @property
    def ended(self) -> bool:
        """Whether all samples of a finite acquisition have been read."""
        return 0 < self._settings.ni9230.samples <= self._next

    def start(self) -> None:
        """Reserve the device, configure it and begin to acquire. Raises DaqError, also as long as it is unplugged."""
        with self._lock:
            self._clear()
            self._closing = False
            self._next, self._failure = 0, None
            try:
                with translated(self._subject, was_there=self._was_there):
                    self._configure()
                    self._task.start()
            except BaseException:
                self._clear()
                raise
            self._was_there = True

    def read(self, timeout_s: float) -> Reading | None:
        """Return the next block, or the part of it that came within `timeout_s` [s]; None if nothing did."""
        with self._lock:
            if self._task is None or self._closing or self.ended:
                return None
            if self._failure is not None:
                raise self._failure
            got = self._fill(timeout_s)
            if not got:
                return None
            # The driver leaves no gaps: of a partial read, the channels follow each other more closely.
            samples = self._buffer[: len(self.channels) * got].reshape(len(self.channels), got).copy()
            saturated = self._saturated(samples)
            samples.flags.writeable = False
            first, self._next = self._next, self._next + got
            return Reading(first, samples, 0, self._read_ns, saturated=saturated)

    def close(self) -> None:
        """Stop acquiring and give the device back; a `read` under way returns None."""
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
            channel.ai_coupling = constants.Coupling[converter.coupling.value]
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
            f"IEPE {converter.current * 1e3:g} mA, {converter.coupling.value} coupling, {sensor.sensitivity:g} mV/N"
        )
        self._block = max(1, round(self._settings.block_time * self.sample_rate))
        self._buffer = np.empty(len(inputs) * self._block)
        self._reader = AnalogMultiChannelReader(task.in_stream)
        self._reader.verify_array_shape = False  # ours is right, and asking the driver each time costs
        self._tells_overload = True

    def _delay(self, channel: Any) -> float:  # noqa: ANN401 - nidaqmx has no types
        """Return the delay of the converter's filter [s]: what the driver says, or else what the settings do."""
        delay: float | None = optional(channel, "ai_filter_delay")
        per_second = {
            constants.DigitalWidthUnits.SECONDS: 1.0,
            constants.DigitalWidthUnits.SAMPLE_CLOCK_PERIODS: self.sample_rate,
        }.get(optional(channel, "ai_filter_delay_units"))
        if delay is None or per_second is None:
            return self._settings.ni9230.filter_delay_samples / self.sample_rate
        return delay / per_second

    def _fill(self, timeout_s: float) -> int:
        """Read up to a block into the buffer and return how many samples per channel came."""
        wanted = self._block
        if self._settings.ni9230.samples:
            wanted = min(wanted, self._settings.ni9230.samples - self._next)
        part = self._buffer[: len(self.channels) * wanted].reshape(len(self.channels), wanted)
        try:
            got = int(self._reader.read_many_sample(part, wanted, max(0.0, timeout_s)))
        except errors.Error as error:
            if self._closing:
                return 0
            got = int(getattr(error, "samps_per_chan_read", 0))
            if getattr(error, "error_code", 0) != NOT_YET_AVAILABLE:
                self._failure = told(error, self._subject, was_there=True, addition=self._unread(got))
                if not got:
                    raise self._failure from error
        self._read_ns = self._now_ns()
        return got

    def _unread(self, got: int) -> str:
        acquired = optional(self._task.in_stream, "total_samp_per_chan_acquired")
        missing = 0 if acquired is None else int(acquired) - self._next - got
        return f"; {missing} samples were acquired and not read" if missing > 0 else ""

    def _saturated(self, samples: FloatArray) -> BoolArray | None:
        if not self._tells_overload:
            return None
        stream = self._task.in_stream
        try:
            overloaded = stream.overloaded_chans if stream.overloaded_chans_exist else ()
        except errors.Error:
            # Not every module can tell; if the device is gone instead, the next read says so.
            self._tells_overload = False
            return None
        rows = np.isin(self._task.channel_names, overloaded)
        if not rows.any():
            return None
        at_limit = np.abs(samples) >= self.limit
        marks: BoolArray = rows[:, np.newaxis] & (at_limit | ~at_limit.any(axis=1, keepdims=True))
        marks.flags.writeable = False
        return marks

    def _clear(self) -> None:
        task, self._task = self._task, None
        if task is not None:
            with suppress(errors.Error):  # of a device that is gone, there is nothing to give back
                task.close()


def _short(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return names that a topic can end with: that of the channel, or of device and channel where two are alike."""
    short = [name.rpartition("/")[2] for name in names]
    unique = short if len(set(short)) == len(short) else names
    return tuple(re.sub(r"\W", "_", name) for name in unique)

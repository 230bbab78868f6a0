# SPDX-License-Identifier: Apache-2.0
"""Simulated NI-9230: NI's client on a simulated driver with its own clock."""

import math
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from nidaqmx._base_interpreter import BaseInterpreter
from nidaqmx.constants import ChannelType, DigitalWidthUnits, TaskMode, UsageTypeAI
from nidaqmx.errors import DaqError, DaqReadError
from numpy.typing import NDArray

Signal = Callable[[int, NDArray[np.int64]], NDArray[np.float64]]

START_NS = 1_767_225_600_000_000_000
MAX_RATE = 12_800.0
FULL_SCALE_V = 30.0
PATIENCE_S = 120.0

OVERLOADED, OPEN, OPEN_LOOP, OVERCURRENT = 0x2174, 0x3100, 0x2A09, 0x29E6
"""Numbers of the statuses of channels."""

MESSAGES = {
    -200430: "I/O type of the physical channel cannot do that.",
    -200431: "Selected physical channel does not support the measurement type.",
    -200489: "Specified channel is in the task already.",
    -200220: "Device identifier is invalid.\n\nDevice Specified: elsewhere",
    -200170: "Physical channel specified does not exist on this device.",
    -200284: "Some or all of the samples requested have not yet been acquired.",
    -200279: "The application is not able to keep up with the hardware acquisition.",
    -201003: "Device cannot be accessed. Possible causes: it is not connected, or not powered.",
    -50103: "The specified resource is reserved.",
    -88709: "Measurement: Task was aborted.",
    -200452: "Specified property is not supported by the device.",
    -200362: "Read the property that tells whether there are overloaded channels before.",
    -200088: "Task specified is invalid or does not exist.",
    -200077: "Requested value is not a supported value for this property. It may conflict with another one.\n"
    "Property: DAQmx_SampClk_Rate\nRequested Value:  20.0e3\nMaximum Value:  12.8e3\n\nTask Name: t",
}


def ramp(channel: int, numbers: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return samples that encode their channel and number."""
    return np.asarray(1e6 * channel + numbers, dtype=np.float64)


class NiTask:
    """State of a task in the driver."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.channels: list[dict[str, Any]] = []
        self.requested_rate = 1000.0
        self.finite = False
        self.samples = 1000
        self.started_ns: int | None = None
        self.stopped_by = 0
        self.read = 0
        self.aborted = threading.Event()


class NiDevice(BaseInterpreter):  # type: ignore[misc]  # untyped
    """Chassis with an NI 9230 and a module without sensor supply; tests inject faults.

    Waiting advances the clock without sleeping. Calls that are not implemented raise NotImplementedError.
    """

    def __init__(self) -> None:
        self.now_ns = START_NS
        self.signal: Signal = ramp
        self.plugged = True
        self.known = True
        """Whether the driver remembers the modules."""
        self.simulated = False
        self.reserved = False
        self.overloaded: set[str] = set()
        self.undetected: set[int] = set()
        """Numbers of the statuses that the module does not support."""
        self.open: set[str] = set()
        self.shorted: set[str] = set()
        self.queries: Counter[int] = Counter()
        self.filter_delay: tuple[float, DigitalWidthUnits] | None = None
        self.states_limit = True
        self.tasks: dict[int, NiTask] = {}
        self.created: list[NiTask] = []
        self.blocking = False
        """Whether a read blocks until its task is aborted."""
        self.waiting = threading.Event()
        self._faults: list[tuple[str, int, int]] = []
        self._statuses_asked: set[int] = set()

    def clock(self) -> int:
        """Return the time [ns]."""
        return self.now_ns

    def advance(self, seconds: float) -> None:
        """Advance the clock."""
        self.now_ns += round(seconds * 1e9)

    def fail(self, call: str, code: int, samples: int = 0) -> None:
        """Let the next `call` of the driver fail with `code`; a read returns `samples` first."""
        self._faults.append((call, code, samples))

    def unplug(self, *, forget: bool = False) -> None:
        """Disconnect the device."""
        self.plugged = False
        self.known = not forget
        self._stop(-201003)

    def plug(self) -> None:
        """Connect the device again; its tasks stay aborted."""
        self.plugged = self.known = True

    def reset(self) -> None:
        """Abort all tasks, as a test panel could."""
        self._stop(-88709)

    def _stop(self, code: int) -> None:
        for task in self.tasks.values():
            task.stopped_by = task.stopped_by or code

    @property
    def task(self) -> NiTask:
        """The only task."""
        (task,) = self.tasks.values()
        return task

    # System and devices

    @property
    def driver_version(self) -> tuple[int, int, int]:
        return (24, 5, 1)

    def get_system_info_attribute_uint32(self, attribute: int) -> int:
        return {0x1272: 24, 0x1923: 5, 0x2F22: 1}[attribute]

    def get_system_info_attribute_string(self, attribute: int) -> str:
        assert attribute == 0x193B
        return "cDAQ1, cDAQ1Mod1, cDAQ1Mod2" if self.known else ""

    def get_device_attribute_string(self, device: str, attribute: int) -> str:
        self._reach()
        return {
            (0x631, "cDAQ1"): "cDAQ-9174",
            (0x631, "cDAQ1Mod1"): "NI 9230",
            (0x631, "cDAQ1Mod2"): "NI 9201",
            (0x231E, "cDAQ1"): "",
            (0x231E, "cDAQ1Mod1"): "cDAQ1Mod1/ai0, cDAQ1Mod1/ai1, cDAQ1Mod1/ai2",
            (0x231E, "cDAQ1Mod2"): "cDAQ1Mod2/ai0, cDAQ1Mod2/ai1",
        }[attribute, device]

    def get_device_attribute_bool(self, device: str, attribute: int) -> bool:
        assert (device[:5], attribute) == ("cDAQ1", 0x22CA)
        return self.simulated

    def get_physical_chan_attribute_int32_array(self, channel: str, attribute: int) -> list[int]:
        assert attribute == 0x2FD7
        kinds = [UsageTypeAI.VOLTAGE] + [UsageTypeAI.FORCE_IEPE_SENSOR] * channel.startswith("cDAQ1Mod1/")
        return [kind.value for kind in kinds]

    # Tasks

    def create_task(self, name: str) -> tuple[int, bool]:
        handle = len(self.created) + 1
        self.tasks[handle] = NiTask(name or f"_unnamedTask<{handle}>")
        self.created.append(self.tasks[handle])
        return handle, True

    def clear_task(self, task: int) -> None:
        self._known(task).aborted.set()
        del self.tasks[task]
        self._check("clear_task")

    def task_control(self, task: int, action: int) -> None:
        assert TaskMode(action) is TaskMode.TASK_ABORT
        ni_task = self._known(task)
        ni_task.stopped_by = ni_task.stopped_by or -88709
        ni_task.aborted.set()

    def get_task_attribute_string(self, task: int, attribute: int) -> str:
        ni_task = self._known(task)
        self._check("get_task_attribute_string")
        names = [channel["name"] for channel in ni_task.channels]
        return {
            0x1276: ni_task.name,
            0x1273: ", ".join(names),
            0x230E: ", ".join(dict.fromkeys(name.partition("/")[0] for name in names)),
        }[attribute]

    def start_task(self, task: int) -> None:
        ni_task = self._known(task)
        self._reach()
        self._check("start_task")
        if self.reserved:
            raise error(-50103)
        self._rate(ni_task)
        ni_task.started_ns = self.now_ns

    # Channels

    def create_ai_force_iepe_chan(
        self,
        task: int,
        physical_channel: str,
        name_to_assign_to_channel: str,
        terminal_config: int,
        min_val: float,
        max_val: float,
        units: int,
        sensitivity: float,
        sensitivity_units: int,
        current_excit_source: int,
        current_excit_val: float,
        custom_scale_name: str,
    ) -> None:
        self._check("create_ai_force_iepe_chan")
        device = physical_channel.partition("/")[0]
        if not self.known or device not in {"cDAQ1Mod1", "cDAQ1Mod2"}:
            raise error(-200220)
        if physical_channel not in {f"{device}/ai{number}" for number in range(3)}:
            raise error(-200170)
        if device != "cDAQ1Mod1":
            raise error(-200431)
        self._known(task).channels.append(
            {
                "name": name_to_assign_to_channel or physical_channel,
                "min_val": min_val,
                "max_val": max_val,
                "units": units,
                "sensitivity": sensitivity,
                "sensitivity_units": sensitivity_units,
                "source": current_excit_source,
                "current": current_excit_val,
                "terminal": terminal_config,
                "scale": custom_scale_name,
            }
        )

    def internal_get_last_created_chan(self) -> str:
        return str(self.created[-1].channels[-1]["name"])

    def set_chan_attribute_int32(self, task: int, channel: str, attribute: int, value: int) -> None:
        assert attribute == 0x64
        self._channel(task, channel)["coupling"] = value

    def get_chan_attribute_double(self, task: int, channel: str, attribute: int) -> float:
        properties = self._channel(task, channel)
        if attribute == 0x17DD and self.states_limit:
            return float(FULL_SCALE_V / (properties["sensitivity"] * 1e-3))
        if attribute == 0x2FED and self.filter_delay is not None:
            return self.filter_delay[0]
        raise error(-200452)

    def get_chan_attribute_int32(self, task: int, channel: str, attribute: int) -> int:
        self._channel(task, channel)
        if attribute == 0x187F:
            return int(ChannelType.ANALOG_INPUT.value)
        if attribute == 0x3071 and self.filter_delay is not None:
            return int(self.filter_delay[1].value)
        raise error(-200452)

    # Timing

    def cfg_samp_clk_timing(
        self, task: int, rate: float, source: str, active_edge: int, sample_mode: int, samps_per_chan: int
    ) -> None:
        assert source == ""
        assert active_edge == 10280
        ni_task = self._known(task)
        ni_task.requested_rate, ni_task.finite, ni_task.samples = rate, sample_mode == 10178, samps_per_chan

    def get_timing_attribute_double(self, task: int, attribute: int) -> float:
        assert attribute == 0x1344
        return self._rate(self._known(task))

    def _rate(self, task: NiTask) -> float:
        """Return the next higher rate that the converter has."""
        if task.requested_rate > MAX_RATE:
            raise error(-200077)
        return MAX_RATE / math.floor(MAX_RATE / task.requested_rate)

    # Reading

    def read_analog_f64(
        self, task: int, samples: int, timeout: float, fill_mode: int, array: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], int]:
        assert fill_mode == 0  # grouped by channel
        assert array.flags.c_contiguous
        assert array.dtype == np.float64
        ni_task = self._known(task)
        assert array.size >= samples * len(ni_task.channels)
        if self.blocking:
            self.waiting.set()
            assert ni_task.aborted.wait(PATIENCE_S), "the task was not aborted"
        fault = next((fault for fault in self._faults if fault[0] == "read_analog_f64"), None)
        if fault is not None:
            self._faults.remove(fault)
            self._take(ni_task, fault[2], array)
            raise error(fault[1], fault[2])
        if ni_task.stopped_by:
            raise error(ni_task.stopped_by, 0)
        if not ni_task.finite and self._acquired(ni_task) - ni_task.read > max(ni_task.samples, 100_000):
            ni_task.stopped_by = -200279
            raise error(ni_task.stopped_by, 0)
        assert ni_task.started_ns is not None
        missing = ni_task.read + samples - self._acquired(ni_task)
        wait_ns = ni_task.started_ns + math.ceil((ni_task.read + samples) * 1e9 / self._rate(ni_task)) - self.now_ns
        if missing > 0:
            self.now_ns += min(wait_ns, round(timeout * 1e9))
        there = min(samples, self._acquired(ni_task) - ni_task.read)
        self._take(ni_task, there, array)
        if there < samples:
            raise error(-200284, there)
        return array, there

    def _take(self, task: NiTask, count: int, array: NDArray[np.float64]) -> None:
        """Write `count` samples of each channel to the start of `array`, without gaps, as the driver does."""
        numbers = np.arange(task.read, task.read + count)
        values = [self.signal(channel, numbers) for channel in range(len(task.channels))]
        array.reshape(-1)[: count * len(values)] = np.concatenate(values)
        task.read += count

    def _acquired(self, task: NiTask) -> int:
        assert task.started_ns is not None
        acquired = math.floor((self.now_ns - task.started_ns) * self._rate(task) / 1e9 + 1e-6)
        return min(acquired, task.samples) if task.finite else acquired

    def get_read_attribute_uint64(self, task: int, attribute: int) -> int:
        assert attribute == 0x192A
        return self._acquired(self._known(task))

    def get_read_attribute_bool(self, task: int, attribute: int) -> bool:
        self._known(task)
        self.queries[attribute] += 1
        if attribute in self.undetected:
            raise error(-200452)
        self._statuses_asked.add(attribute)
        return bool(self._status(attribute))

    def get_read_attribute_string(self, task: int, attribute: int, size_hint: int = 0) -> str:
        self._known(task)
        if attribute - 1 not in self._statuses_asked:
            raise error(-200362)
        names = ", ".join(sorted(self._status(attribute - 1)))
        assert len(names) < size_hint
        self._statuses_asked.discard(attribute - 1)
        self._status(attribute - 1).clear()
        self._check("get_read_attribute_string")
        return names

    def _status(self, attribute: int) -> set[str]:
        """Return the channels with the status of this number, which a query of their names clears."""
        return {OVERLOADED: self.overloaded, OPEN: self.open, OPEN_LOOP: self.open, OVERCURRENT: self.shorted}[
            attribute
        ]

    def _known(self, task: int) -> NiTask:
        if task not in self.tasks:
            raise error(-200088)
        return self.tasks[task]

    def _channel(self, task: int, name: str) -> dict[str, Any]:
        return next(channel for channel in self._known(task).channels if channel["name"] == name)

    def _reach(self) -> None:
        if not self.plugged:
            raise error(-201003)

    def _check(self, call: str) -> None:
        for fault in self._faults:
            if fault[0] == call:
                self._faults.remove(fault)
                raise error(fault[1])


NiDevice.__abstractmethods__ = frozenset()


def error(code: int, samples_read: int | None = None) -> DaqError:
    """Return the error that NI's client raises for `code`."""
    text = f"{MESSAGES.get(code, 'Unknown error.')}\n\nStatus Code: {code}"
    return DaqError(text, code) if samples_read is None else DaqReadError(text, code, samples_read)


@pytest.fixture
def ni_device(monkeypatch: pytest.MonkeyPatch) -> Iterator[NiDevice]:
    """Let NI's client use this device instead of NI's library; at the end, no task may be open."""
    device = NiDevice()
    monkeypatch.setattr("nidaqmx.utils._select_interpreter", lambda *_, **__: device)
    yield device
    assert not device.tasks, "a task was left open"

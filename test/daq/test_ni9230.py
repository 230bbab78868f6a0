# SPDX-License-Identifier: Apache-2.0
"""Tests of the source ni9230, with NI's client on a simulated driver that has faults."""

import math
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from ctypes.util import find_library
from typing import Any

import hypothesis
import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import HealthCheck, given
from nidaqmx.constants import (
    Coupling,
    DigitalWidthUnits,
    ExcitationSource,
    ForceIEPESensorSensitivityUnits,
    ForceUnits,
)
from nidaqmx.errors import DaqFunctionNotSupportedError, DaqNotSupportedError

from scara_effmass.daq import make_source
from scara_effmass.daq.ni9230 import Ni9230Source
from scara_effmass.daq.ni_driver import devices, driver_version
from scara_effmass.daq.source import Reading
from scara_effmass.errors import (
    DaqError,
    DeviceLostError,
    DeviceMissingError,
    DeviceReservedError,
    DriverMissingError,
    OverrunError,
    SettingsError,
)
from scara_effmass.impacts.load import AC_COUPLED
from scara_effmass.settings import DaqSettings, checked
from scara_effmass.values import FloatArray
from test.daq.conftest import OPEN, OPEN_LOOP, OVERCURRENT, OVERLOADED, NiDevice

Open = Callable[..., Ni9230Source]

BLOCK = 1280


def settings(**values: object) -> DaqSettings:
    """Return settings; "__" in a name stands for a dot."""
    return checked(DaqSettings, {name.replace("__", "."): value for name, value in values.items()}, "test")


@pytest.fixture
def make(ni_device: NiDevice) -> Iterator[Open]:
    """Make a source, which is closed at the end."""
    with ExitStack() as stack:

        def make_source(**values: object) -> Ni9230Source:
            source = Ni9230Source(settings(**values), ni_device.clock)
            stack.callback(source.close)
            return source

        yield make_source


@pytest.fixture
def started(make: Open) -> Open:
    def make_started(**values: object) -> Ni9230Source:
        source = make(**values)
        source.start()
        return source

    return make_started


def got(reading: Reading | None) -> Reading:
    assert reading is not None
    return reading


def test_channel_is_configured_for_the_sensor(ni_device: NiDevice, started: Open) -> None:
    started(sensor__sensitivity=2.31, sensor__range=2000.0)
    (channel,) = ni_device.task.channels
    assert channel == {
        "name": "cDAQ1Mod1/ai0",
        "min_val": -2000.0,
        "max_val": 2000.0,
        "units": ForceUnits.NEWTONS.value,
        "sensitivity": 2.31,
        "sensitivity_units": ForceIEPESensorSensitivityUnits.MILLIVOLTS_PER_NEWTON.value,
        "source": ExcitationSource.INTERNAL.value,
        "current": 0.004,
        "coupling": Coupling.AC.value,
        "terminal": channel["terminal"],
        "scale": "",
    }
    assert not ni_device.task.finite
    assert ni_device.task.samples >= 128_000


def test_excitation_can_be_off_and_coupling_dc(ni_device: NiDevice, started: Open) -> None:
    started(ni9230__current=0.0, ni9230__coupling="DC")
    (channel,) = ni_device.task.channels
    assert channel["source"] == ExcitationSource.NONE.value
    assert channel["coupling"] == Coupling.DC.value


def test_started_source_knows_the_device(started: Open) -> None:
    source = started()
    assert source.channels == ("ai0",)
    assert source.simulated is False
    assert source.limit == pytest.approx(30.0 / 2.248e-3)
    assert source.description == "NI 9230 cDAQ1Mod1/ai0, IEPE 4 mA, AC coupling, 2.248 mV/N"
    assert AC_COUPLED in source.description


def test_device_simulated_by_the_driver_is_simulated(ni_device: NiDevice, started: Open) -> None:
    ni_device.simulated = True
    source = started()
    assert source.simulated is True
    assert "simulated by its driver" in source.description


def test_blocks_are_consecutive(ni_device: NiDevice, started: Open) -> None:
    source = started()
    begin_ns = ni_device.now_ns
    for number in range(5):
        reading = got(source.read(1.0))
        assert reading.first_sample == number * BLOCK
        np.testing.assert_array_equal(reading.samples[0], np.arange(BLOCK) + number * BLOCK)
        assert reading.lost == 0
        assert reading.stamp_ns is None
        assert reading.saturated is None
        assert reading.read_ns == ni_device.now_ns == begin_ns + (number + 1) * 100_000_000
    assert not source.ended


def test_channels_share_one_task(ni_device: NiDevice, started: Open) -> None:
    source = started(ni9230__channels=("cDAQ1Mod1/ai0", "cDAQ1Mod1/ai2"))
    assert source.channels == ("ai0", "ai2")
    assert len(ni_device.created) == 1
    samples = got(source.read(1.0)).samples
    assert samples.shape == (2, BLOCK)
    np.testing.assert_array_equal(samples, np.arange(BLOCK) + 1e6 * np.arange(2)[:, np.newaxis])


def test_channels_with_one_name_include_their_device(make: Open) -> None:
    source = make(ni9230__channels=("cDAQ9185-1Mod1/ai0", "cDAQ9185-1Mod2/ai0"))
    assert source.channels == ("cDAQ9185_1Mod1_ai0", "cDAQ9185_1Mod2_ai0")


@pytest.mark.parametrize(
    "names", [(), ("ai0",), ("cDAQ1Mod1/ai0:2",), ("cDAQ1Mod1/ai0, cDAQ1Mod1/ai1",), ("a/ai0", "A/ai0")]
)
def test_invalid_channels_are_refused(names: tuple[str, ...]) -> None:
    with pytest.raises(SettingsError, match=r"^test: ni9230\.channels = .*: must .*$"):
        settings(ni9230__channels=names)


@pytest.mark.parametrize(("requested", "actual"), [(12_800.0, 12_800.0), (5_000.0, 6_400.0), (10_000.0, 12_800.0)])
def test_sample_rate_is_that_of_the_device(requested: float, actual: float, started: Open, ni_device: NiDevice) -> None:
    source = started(ni9230__sample_rate=requested)
    assert source.requested_rate == requested
    assert source.sample_rate == actual
    assert source.filter_delay == pytest.approx(38.0 / actual)
    begin_ns = ni_device.now_ns
    assert got(source.read(1.0)).samples.shape == (1, round(0.1 * actual))
    assert ni_device.now_ns - begin_ns == pytest.approx(1e8)


@pytest.mark.parametrize(
    ("stated", "expected"),
    [
        ((2.9e-3, DigitalWidthUnits.SECONDS), 2.9e-3),
        ((39.5, DigitalWidthUnits.SAMPLE_CLOCK_PERIODS), 39.5 / 12_800.0),
        ((5000.0, DigitalWidthUnits.TICKS), 34.0 / 12_800.0),
        ((0.0, DigitalWidthUnits.SECONDS), 34.0 / 12_800.0),
        ((math.nan, DigitalWidthUnits.SECONDS), 34.0 / 12_800.0),
        (None, 34.0 / 12_800.0),
    ],
)
def test_filter_delay_is_that_of_the_driver_or_the_settings(
    stated: tuple[float, Any] | None, expected: float, ni_device: NiDevice, started: Open
) -> None:
    ni_device.filter_delay = stated
    assert started(ni9230__filter_delay_samples=34.0).filter_delay == pytest.approx(expected)


def test_unknown_limit_is_infinite(ni_device: NiDevice, started: Open) -> None:
    ni_device.states_limit = False
    assert started().limit == math.inf


def test_finite_acquisition_ends(ni_device: NiDevice, started: Open) -> None:
    source = started(ni9230__samples=10_000, ni9230__channels=("cDAQ1Mod1/ai0", "cDAQ1Mod1/ai1"))
    assert ni_device.task.finite
    begin_ns = ni_device.now_ns
    parts: list[FloatArray] = []
    while not source.ended:
        parts.append(got(source.read(1.0)).samples)
    assert [part.shape[1] for part in parts] == [BLOCK] * 7 + [1040]
    np.testing.assert_array_equal(np.concatenate(parts, axis=1)[1], 1e6 + np.arange(10_000))
    assert ni_device.now_ns - begin_ns == 781_250_000
    assert source.read(1.0) is None
    source.start()
    again = got(source.read(1.0))
    assert (again.first_sample, source.ended) == (0, False)


@given(
    channels=st.integers(1, 3),
    finite=st.sampled_from((0, 2, 3333)),
    calls=st.lists(st.tuples(st.floats(0.0, 0.3), st.floats(0.0, 0.4)), max_size=20),
)
@hypothesis.settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60)
def test_each_sample_is_read_once_and_in_order_with_any_timeouts(
    channels: int, finite: int, calls: list[tuple[float, float]], ni_device: NiDevice, make: Open
) -> None:
    names = tuple(f"cDAQ1Mod1/ai{number}" for number in range(channels))
    source = make(ni9230__channels=names, ni9230__samples=finite)
    source.start()
    end = 0
    for pause_s, timeout_s in calls:
        ni_device.advance(pause_s)
        reading = source.read(timeout_s)
        if reading is not None:
            assert reading.first_sample == end
            end += reading.samples.shape[1]
            numbers = np.arange(reading.first_sample, end)
            np.testing.assert_array_equal(reading.samples, numbers + 1e6 * np.arange(channels)[:, np.newaxis])
        assert source.ended == (0 < finite <= end)
    source.close()


def test_late_read_within_the_buffer_loses_nothing(ni_device: NiDevice, started: Open) -> None:
    source = started()
    ni_device.advance(9.9)
    assert got(source.read(0.0)).first_sample == 0
    assert got(source.read(0.0)).first_sample == BLOCK


def test_read_after_the_buffer_is_an_overrun_with_its_count(ni_device: NiDevice, started: Open) -> None:
    source = started()
    source.read(1.0)
    ni_device.advance(20.0)
    with pytest.raises(OverrunError, match=r"256000 samples were acquired and not read \(NI-DAQmx -200279: The"):
        source.read(1.0)
    source.close()
    source.start()
    np.testing.assert_array_equal(got(source.read(1.0)).samples[0], np.arange(BLOCK))


@pytest.mark.parametrize("code", [-200279, -200010, -200361, -200222])
def test_samples_before_an_error_are_returned_first(code: int, ni_device: NiDevice, started: Open) -> None:
    source = started(ni9230__channels=("cDAQ1Mod1/ai0", "cDAQ1Mod1/ai1"))
    ni_device.advance(1.0)
    ni_device.fail("read_analog_f64", code, samples=100)
    np.testing.assert_array_equal(got(source.read(1.0)).samples, [np.arange(100), 1e6 + np.arange(100)])
    for _ in range(2):
        with pytest.raises(OverrunError, match=f"NI-DAQmx {code}:"):
            source.read(1.0)


def test_unplugged_device_is_lost_and_comes_back(ni_device: NiDevice, started: Open) -> None:
    source = started()
    source.read(1.0)
    ni_device.unplug()
    with pytest.raises(DeviceLostError, match="was disconnected; check cable and power") as lost:
        source.read(1.0)
    assert str(lost.value).startswith("ni9230.channels = cDAQ1Mod1/ai0: ")
    source.close()
    for _ in range(3):
        with pytest.raises(DeviceLostError):
            source.start()
        assert source.read(0.1) is None
    ni_device.plug()
    source.start()
    assert got(source.read(1.0)).first_sample == 0


def test_device_that_was_never_connected_is_missing(ni_device: NiDevice, make: Open) -> None:
    ni_device.unplug()
    with pytest.raises(DeviceMissingError, match="does not answer; connect and power it"):
        make().start()


@pytest.mark.parametrize("code", [-88709, -88710, -200088, -200194, -50405, -50413, -50803, -50808])
def test_reset_device_is_lost(code: int, ni_device: NiDevice, started: Open) -> None:
    source = started()
    ni_device.fail("read_analog_f64", code)
    with pytest.raises(DeviceLostError, match="was reset"):
        source.read(1.0)
    source.start()
    assert got(source.read(1.0)).first_sample == 0


def test_reserved_device_is_refused_until_it_is_free(ni_device: NiDevice, make: Open) -> None:
    ni_device.reserved = True
    source = make()
    with pytest.raises(DeviceReservedError, match="another program uses the device"):
        source.start()
    ni_device.reserved = False
    source.start()


@pytest.mark.parametrize(
    ("values", "advice"),
    [
        ({"ni9230__channels": ("Dev7/ai0",)}, "cDAQ1Mod1/ai0, cDAQ1Mod1/ai1, cDAQ1Mod1/ai2 (NI-DAQmx -200220"),
        ({"ni9230__channels": ("cDAQ1Mod1/ai7",)}, "cDAQ1Mod1/ai0, cDAQ1Mod1/ai1, cDAQ1Mod1/ai2 (NI-DAQmx -200170"),
        ({"ni9230__channels": ("cDAQ1Mod2/ai0",)}, "cannot supply an IEPE force sensor"),
        ({"ni9230__sample_rate": 20_000.0}, "correct ni9230.sample_rate (NI-DAQmx -200077: Requested"),
        ({"ni9230__sample_rate": 20_000.0}, "Requested Value:  20.0e3; Maximum Value:  12.8e3)"),
    ],
)
def test_unsupported_setting_is_named(values: dict[str, object], advice: str, make: Open) -> None:
    with pytest.raises(DeviceMissingError, match=re.escape(advice)):
        make(**values).start()


@pytest.mark.parametrize(
    ("code", "kind"),
    [
        (-200430, DeviceMissingError),
        (-200489, DeviceMissingError),
        (-201172, DeviceMissingError),
        (-200332, DeviceMissingError),
        (-201003, DeviceMissingError),
        (-50103, DeviceReservedError),
        (-201420, DeviceReservedError),
        (-209999, DaqError),
    ],
)
@pytest.mark.parametrize("call", ["create_ai_force_iepe_chan", "start_task"])
def test_error_at_the_start_is_one_line(
    call: str, code: int, kind: type[DaqError], ni_device: NiDevice, make: Open
) -> None:
    ni_device.fail(call, code)
    source = make()
    with pytest.raises(kind) as raised:
        source.start()
    assert type(raised.value) is kind
    assert re.fullmatch(rf"ni9230\.channels = cDAQ1Mod1/ai0: .+ \(NI-DAQmx {code}: .+\)", str(raised.value))
    assert not ni_device.tasks
    source.start()


def test_overload_marks_the_samples_at_the_limit(ni_device: NiDevice, started: Open) -> None:
    source = started(ni9230__channels=("cDAQ1Mod1/ai0", "cDAQ1Mod1/ai1"))
    ni_device.signal = lambda channel, numbers: np.where(numbers % 7 == channel, 2e4, 1.0)
    ni_device.overloaded = {"cDAQ1Mod1/ai1"}
    marks = got(source.read(1.0)).saturated
    assert marks is not None
    assert not marks[0].any()
    np.testing.assert_array_equal(np.flatnonzero(marks[1]), np.arange(1, BLOCK, 7))
    assert not marks.flags.writeable
    assert got(source.read(1.0)).saturated is None


def test_overload_without_samples_at_the_limit_marks_all(ni_device: NiDevice, started: Open) -> None:
    source = started(ni9230__channels=("cDAQ1Mod1/ai0", "cDAQ1Mod1/ai1"))
    ni_device.signal = lambda _, numbers: np.zeros(len(numbers))
    ni_device.overloaded = {"cDAQ1Mod1/ai0"}
    marks = got(source.read(1.0)).saturated
    assert marks is not None
    np.testing.assert_array_equal(marks.sum(axis=1), [BLOCK, 0])


@pytest.mark.parametrize("status", [OPEN, OPEN_LOOP])
def test_open_sensor_marks_all_samples_of_its_channel(status: int, ni_device: NiDevice, started: Open) -> None:
    source = started(ni9230__channels=("cDAQ1Mod1/ai0", "cDAQ1Mod1/ai1"))
    ni_device.signal = lambda _, numbers: np.zeros(len(numbers))
    ni_device.undetected = {OPEN, OPEN_LOOP} - {status}
    ni_device.open = {"cDAQ1Mod1/ai1"}
    reading = got(source.read(1.0))
    assert reading.faults == ("", "the sensor is open: check sensor and cable")
    assert reading.saturated is not None
    np.testing.assert_array_equal(reading.saturated.sum(axis=1), [0, BLOCK])
    reading = got(source.read(1.0))
    assert (reading.faults, reading.saturated) == ((), None)


def test_fault_of_an_unnamed_channel_is_that_of_all(ni_device: NiDevice, started: Open) -> None:
    source = started(ni9230__channels=("cDAQ1Mod1/ai0", "cDAQ1Mod1/ai1"))
    ni_device.shorted = {"cDAQ1Mod1/ai1"}
    ni_device.fail("get_read_attribute_string", -200452)
    reading = got(source.read(1.0))
    assert reading.faults == ("the sensor is shorted: check sensor and cable",) * 2
    assert reading.saturated is not None
    assert reading.saturated.all()


def test_module_without_overload_detection_is_read(ni_device: NiDevice, started: Open) -> None:
    ni_device.undetected = {OVERLOADED, OPEN, OPEN_LOOP, OVERCURRENT}
    source = started()
    for number in range(3):
        reading = got(source.read(1.0))
        assert reading.first_sample == number * BLOCK
        assert reading.saturated is None
        assert reading.faults == ()
    assert ni_device.queries == dict.fromkeys(ni_device.undetected, 1)


def test_device_lost_after_an_overload_is_lost_at_the_next_read(ni_device: NiDevice, started: Open) -> None:
    source = started()
    ni_device.overloaded = {"cDAQ1Mod1/ai0"}
    ni_device.fail("get_task_attribute_string", -88709)
    assert got(source.read(1.0)).first_sample == 0
    ni_device.reset()
    with pytest.raises(DeviceLostError):
        source.read(1.0)


def test_lost_device_is_closed(ni_device: NiDevice, started: Open) -> None:
    source = started()
    ni_device.fail("clear_task", -201003)
    source.close()
    assert not ni_device.tasks


def test_devices_are_listed(ni_device: NiDevice) -> None:
    assert driver_version() == "24.5.1"
    names = {device.name: device for device in devices()}
    assert list(names) == ["cDAQ1", "cDAQ1Mod1", "cDAQ1Mod2"]
    assert names["cDAQ1"].product == "cDAQ-9174"
    assert names["cDAQ1Mod1"].channels == ("cDAQ1Mod1/ai0", "cDAQ1Mod1/ai1", "cDAQ1Mod1/ai2")
    assert names["cDAQ1Mod2"].channels == ()
    ni_device.unplug()
    assert all("does not answer" in device.problem for device in devices())
    ni_device.unplug(forget=True)
    assert devices() == ()


@pytest.mark.skipif(find_library("nidaqmx") is not None, reason="NI-DAQmx is installed here")
@pytest.mark.parametrize("ask", [driver_version, devices, lambda: Ni9230Source(DaqSettings(), lambda: 0).start()])
def test_missing_driver_is_stated_in_one_line(ask: Callable[[], object]) -> None:
    with pytest.raises(DriverMissingError) as missing:
        ask()
    assert str(missing.value) == (
        "the driver NI-DAQmx is not installed; install it from ni.com/downloads, or set source to bag or sim"
    )


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (OSError("libnidaqmx.so.1: wrong ELF class"), "cannot be used; reinstall it: libnidaqmx.so.1: wrong"),
        (DaqFunctionNotSupportedError("no such function in\nthis version"), "no such function in this version"),
        (DaqNotSupportedError("darwin"), "does not exist for this system; install"),
    ],
)
def test_unusable_driver_is_missing(error: Exception, words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("nidaqmx.utils._select_interpreter", broken)
    for ask in (driver_version, devices, Ni9230Source(DaqSettings(), lambda: 0).start):
        with pytest.raises(DriverMissingError, match=words):
            ask()


@pytest.mark.parametrize("module", ["nidaqmx", "nidaqmx.stream_readers"])
def test_missing_client_is_stated_when_the_source_is_chosen(module: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    for ours in ("ni9230", "ni_driver"):
        monkeypatch.delitem(sys.modules, f"scara_effmass.daq.{ours}")
    with pytest.raises(DriverMissingError, match=r"pip install 'scara_effmass\[daq\]'"):
        make_source(DaqSettings(), lambda: 0)

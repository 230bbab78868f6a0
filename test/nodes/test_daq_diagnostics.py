# SPDX-License-Identifier: Apache-2.0
"""Diagnostic statuses of the force measurement."""

import threading
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from scara_effmass.daq import make_source
from scara_effmass.daq.acquisition import Acquisition, AcquisitionState
from scara_effmass.daq.conditioning import SignalConditioner
from scara_effmass.daq.source import Reading
from scara_effmass.impacts.detector import Detector
from scara_effmass.nodes.daq_node import daq_statuses
from scara_effmass.settings import DaqSettings, checked
from test.daq.conftest import NiDevice
from test.daq.force_bag import force_block, write_blocks

WAIT_S = 20.0


def statuses(acquisition: Acquisition, signal: SignalConditioner, settings: DaqSettings) -> list[DiagnosticStatus]:
    return daq_statuses(acquisition, signal, [(Detector(settings.detection), 1, 4)])


def test_channel_status_has_the_filter_delay_of_the_blocks() -> None:
    settings = checked(DaqSettings, {"source": "sim", "filter.kind": "zero_phase"}, "test")
    source = make_source(settings, lambda: 0)
    source.start()
    signal = SignalConditioner(source, settings)
    both = statuses(Acquisition(source, settings, lambda: None), signal, settings)
    assert {status.hardware_id for status in both} == {source.description}
    _, channel = both
    assert channel.message == "1 impact, rebounds: 4"
    values = {pair.key: pair.value for pair in channel.values}
    ((block,),) = signal.blocks(Reading(0, np.zeros((1, 100)), 0, 0))
    source.close()
    assert float(values["delay of the low-pass [ms]"]) == pytest.approx(1e3 * block.filter_delay, abs=1e-3)
    assert block.filter_delay > 0.0


def test_open_sensor_is_an_error_of_its_channel(monkeypatch: pytest.MonkeyPatch) -> None:
    ni_device = NiDevice()
    monkeypatch.setattr("nidaqmx.utils._select_interpreter", lambda *_, **__: ni_device)
    settings = checked(DaqSettings, {"ni9230.channels": ["cDAQ1Mod1/ai0", "cDAQ1Mod1/ai1"]}, "test")
    source = make_source(settings, ni_device.clock)
    source.start()
    ni_device.signal = lambda _, numbers: np.zeros(len(numbers))
    signal = SignalConditioner(source, settings)
    acquisition = Acquisition(source, settings, lambda: None)
    levels = []
    for is_open in (True, False):
        ni_device.open = {"cDAQ1Mod1/ai1"} if is_open else set()
        reading = source.read(1.0)
        assert reading is not None
        _, (block,) = signal.blocks(reading)
        assert block.is_unknown is is_open
        detections = [(Detector(settings.detection), 0, 0)] * 2
        _, sound, other = daq_statuses(acquisition, signal, detections)
        levels += [sound.level, other.level]
        assert ("the sensor is open" in other.message) is is_open
    source.close()
    assert levels == [DiagnosticStatus.WARN, DiagnosticStatus.ERROR, DiagnosticStatus.WARN, DiagnosticStatus.WARN]


def test_truncated_recording_gives_a_warning(tmp_path: Path) -> None:
    noise = np.random.default_rng(5).normal(size=2000)
    path = write_blocks(tmp_path / "run.mcap", (force_block(2000 * n, 2000, force=noise + n) for n in range(100)))
    path.write_bytes(path.read_bytes()[: int(0.9 * path.stat().st_size)])
    settings = checked(DaqSettings, {"source": "bag", "bag.path": str(path), "bag.rate": 0.0, "backlog": 600.0}, "test")
    ended = threading.Event()

    def notify() -> None:
        if acquisition.statistics().state is AcquisitionState.ENDED:
            ended.set()

    acquisition = Acquisition(make_source(settings, lambda: 1), settings, notify)
    acquisition.start()
    assert ended.wait(WAIT_S)
    status, _ = statuses(acquisition, SignalConditioner(acquisition.source, settings), settings)
    acquisition.stop()
    assert (status.level, status.message) == (DiagnosticStatus.WARN, acquisition.statistics().reason)
    assert "cut off" in status.message

"""What the force node says on /diagnostics of the numbers that the rooms below give it."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from nptdms import ChannelObject, TdmsWriter

from scara_effmass.daq.acquisition import Acquisition, AcquisitionState
from scara_effmass.daq.channel import ForceSignal
from scara_effmass.daq.source import Reading, make_source
from scara_effmass.impacts.detector import Detector
from scara_effmass.nodes.daq_health import DaqHealth
from scara_effmass.settings import DaqSettings, checked

if TYPE_CHECKING:
    from pathlib import Path

WAIT_S = 20.0


def statuses(acquisition: Acquisition, signal: ForceSignal, settings: DaqSettings) -> list[DiagnosticStatus]:
    return DaqHealth("daq").statuses(acquisition, signal, [(Detector(settings.detection), 0)])


def test_the_delay_of_the_low_pass_is_that_which_blocks_declare() -> None:
    settings = checked(DaqSettings, {"source": "sim", "filter.kind": "zero_phase"}, "test")
    source = make_source(settings, lambda: 0)
    source.start()
    signal = ForceSignal(source, settings)
    _, channel = statuses(Acquisition(source, settings, lambda: None), signal, settings)
    values = {pair.key: pair.value for pair in channel.values}
    ((block,),) = signal.blocks(Reading(0, np.zeros((1, 100)), 0, 0))
    source.close()
    assert float(values["delay of the low-pass [ms]"]) == pytest.approx(1e3 * block.filter_delay, abs=1e-3)
    assert block.filter_delay > 0.0


def test_a_recording_of_which_not_all_could_be_read_is_a_warning(tmp_path: Path) -> None:
    path = tmp_path / "cell.tdms"
    with TdmsWriter(path) as writer:
        writer.write_segment([ChannelObject("g", "c", np.arange(100.0), {"wf_increment": 0.01, "unit_string": "N"})])
    path.write_bytes(path.read_bytes()[:-80])
    settings = checked(DaqSettings, {"source": "bag", "bag.path": str(path), "bag.rate": 0.0}, "test")
    ended = threading.Event()

    def look() -> None:
        if acquisition.statistics().state is AcquisitionState.ENDED:
            ended.set()

    acquisition = Acquisition(make_source(settings, lambda: 1), settings, look)
    acquisition.start()
    assert ended.wait(WAIT_S)
    status, _ = statuses(acquisition, ForceSignal(acquisition.source, settings), settings)
    acquisition.stop()
    assert (status.level, status.message) == (DiagnosticStatus.WARN, acquisition.statistics().reason)
    assert "is cut off in its last segment" in status.message

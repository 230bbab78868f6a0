# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from scara_effmass.daq import make_source
from scara_effmass.daq.sim_source import HalfSineSource, SimCellSource
from scara_effmass.daq.source import Reading
from scara_effmass.settings import DaqSettings, SensorSettings, SimSettings
from scara_effmass.sim.collision_sim import CONTROL_PERIOD_NS
from scara_effmass.sim.measurement import ForceSensor, RandomPulses, SyntheticSignal
from test.daq.force_bag import Clock

NS = 1_000_000_000
NOW_NS = 1_767_225_600 * NS
SETTINGS = DaqSettings(source="sim", sim=SimSettings(channels=2, seed=5, impact_period=0.2, clock_error=0.0))
BLOCK = 1280


def started(settings: DaqSettings = SETTINGS) -> tuple[HalfSineSource, Clock]:
    clock = Clock(77_000_000_000_000)
    source = HalfSineSource(settings, lambda: NOW_NS, clock)
    source.start()
    return source, clock


def block(source: HalfSineSource | SimCellSource, timeout_s: float = 0.0) -> Reading:
    reading = source.read(timeout_s)
    assert reading is not None
    return reading


def test_sim_source_declares_that_it_is_simulated() -> None:
    source = make_source(SETTINGS, lambda: 0)
    assert isinstance(source, HalfSineSource)
    assert source.simulated
    assert "simulated" in source.description
    assert source.channels == ("sim0", "sim1")
    assert source.sample_rate == source.requested_rate == 12_800.0
    assert source.filter_delay == 0.0


def test_samples_are_those_of_the_synthetic_signal() -> None:
    source, clock = started()
    clock.now_ns += NS
    sensor = ForceSensor(sensitivity=SETTINGS.sensor.sensitivity, noise=SETTINGS.sim.noise, seed=5)
    signal = SyntheticSignal(2, sensor, RandomPulses(5, 12_800.0, 0.2))
    readings = [block(source) for _ in range(10)]
    assert [reading.first_sample for reading in readings] == [number * BLOCK for number in range(10)]
    assert {reading.lost for reading in readings} == {0}
    samples = np.concatenate([reading.samples for reading in readings], axis=1)
    assert np.array_equal(samples, signal.samples(0, 10 * BLOCK))
    assert samples.max() > 15.0
    assert source.limit == signal.limit


def test_block_is_due_after_its_last_sample() -> None:
    source, clock = started()
    assert source.read(0.0) is None
    clock.now_ns += 99_999_999
    assert source.read(0.0) is None
    clock.now_ns += 1
    assert block(source).first_sample == 0
    assert source.read(0.0) is None


def test_late_reads_lose_nothing() -> None:
    source, clock = started()
    clock.now_ns += 550_000_000
    readings = [block(source) for _ in range(5)]
    assert [reading.first_sample for reading in readings] == [0, 1280, 2560, 3840, 5120]
    assert {reading.read_ns for reading in readings} == {NOW_NS}
    assert source.read(0.0) is None


@pytest.mark.parametrize("known_ns", [0, NOW_NS])
def test_simulated_cell_that_is_late_is_measured_from_then_on(known_ns: int) -> None:
    clock = Clock(known_ns)
    sim = SimSettings(scene="cell", start=NOW_NS / NS - 3.0)
    source = SimCellSource(DaqSettings(source="sim", sim=sim), clock)
    source.start()
    assert source.read(0.0) is None
    clock.now_ns = NOW_NS
    assert source.read(0.0) is None
    readings = []
    for _ in range(3):
        clock.now_ns += 100 * CONTROL_PERIOD_NS
        readings.append(block(source))
        assert source.read(0.0) is None
    firsts = [reading.first_sample for reading in readings]
    assert firsts[0] == 0
    assert firsts[1:] == np.cumsum([reading.samples.size for reading in readings])[:-1].tolist()
    assert [reading.read_ns for reading in readings] == [clock.now_ns - 100 * CONTROL_PERIOD_NS * i for i in (2, 1, 0)]
    assert {reading.lost for reading in readings} == {0}


@pytest.mark.parametrize("error", [-1e-3, 50e-6])
def test_simulated_converter_has_the_clock_error(error: float) -> None:
    source, clock = started(DaqSettings(source="sim", sim=SimSettings(sample_rate=1000.0, clock_error=error)))
    start_ns = clock.now_ns
    for number in range(1, 401):
        clock.now_ns = start_ns + round(number * 0.1 * NS / (1.0 + error)) - 1
        assert source.read(0.0) is None
        clock.now_ns += 1
        assert block(source).samples.shape == (1, 100)
    assert source.sample_rate == 1000.0  # the nominal rate


def test_inverted_sensor_changes_the_sign() -> None:
    source, clock = started(SETTINGS.model_copy(update={"sensor": SensorSettings(invert=True)}))
    plain, plain_clock = started()
    clock.now_ns += NS
    plain_clock.now_ns += NS
    inverted = block(source).samples
    assert np.array_equal(inverted, -block(plain).samples)
    assert not inverted.flags.writeable


def test_samples_at_the_end_of_the_range_are_marked() -> None:
    # At 1 V/N the converter ends at 30 N, and most impacts are stronger than that.
    source, clock = started(SETTINGS.model_copy(update={"sensor": SensorSettings(sensitivity=1000.0)}))
    clock.now_ns += 100 * NS
    readings = [block(source) for _ in range(20)]
    marked = [reading for reading in readings if reading.saturated is not None]
    assert source.limit == pytest.approx(30.0)
    assert 0 < len(marked) < len(readings)
    for reading in readings:
        at_end = np.abs(reading.samples) >= source.limit
        assert at_end.any() == (reading.saturated is not None)
        if reading.saturated is not None:
            assert np.array_equal(reading.saturated, at_end)
            assert not reading.saturated.flags.writeable

# SPDX-License-Identifier: Apache-2.0
"""From readings to force blocks: no sample is invented, each loss is stated, and each stamp is right."""

import math
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import ArrayLike

from scara_effmass.daq.conditioning import SignalConditioner
from scara_effmass.daq.source import ForceSource, Reading
from scara_effmass.errors import SettingsError
from scara_effmass.settings import DaqSettings, FilterKind, checked
from scara_effmass.values import BoolArray, FloatArray, ForceBlock

NOW = 1_700_000_000_000_000_000
RATE = 1000.0
NAN, INF = math.nan, math.inf


@dataclass
class StartedSource(ForceSource):
    """Attributes of a started source; the tests make its readings."""

    simulated: bool = False
    channels: tuple[str, ...] = ("ai0",)
    description: str = "a load cell"
    requested_rate: float = RATE
    sample_rate: float = RATE
    limit: float = INF
    filter_delay: float = 0.0

    def start(self) -> None:
        raise AssertionError

    def read(self, timeout_s: float) -> Reading | None:
        raise AssertionError(timeout_s)

    def close(self) -> None:
        raise AssertionError


def signal(settings: Mapping[str, object] | None = None, source: StartedSource | None = None) -> SignalConditioner:
    """Return a conditioner, by default without a tare at the start."""
    values = {"tare.at_start": False, **(settings or {})}
    return SignalConditioner(source or StartedSource(), checked(DaqSettings, values, "test"))


def reading(
    samples: ArrayLike,
    first: int = 0,
    lost: int = 0,
    stamp_ns: int | None = None,
    saturated: BoolArray | None = None,
    rate: float = RATE,
) -> Reading:
    """Return a reading of a device, read right after its last sample, or of a recording."""
    array = np.atleast_2d(np.asarray(samples, float))
    array.flags.writeable = False
    read_ns = NOW + round((first + array.shape[1] - 1) / rate * 1e9)
    return Reading(first, array, lost, read_ns, stamp_ns, 0.0, saturated)


def only_block(blocks: list[list[ForceBlock]]) -> ForceBlock:
    ((block,),) = blocks
    return block


def test_inverted_sensor_changes_the_sign() -> None:
    assert only_block(signal().blocks(reading([1.0, -2.0]))).force.tolist() == [1.0, -2.0]
    assert only_block(signal({"sensor.invert": True}).blocks(reading([1.0, -2.0]))).force.tolist() == [-1.0, 2.0]


@pytest.mark.parametrize(
    ("kind", "source"), [("none", "a load cell"), ("causal", "a load cell, causal low-pass 30 Hz")]
)
def test_the_source_states_the_low_pass(kind: str, source: str) -> None:
    conditioner = signal({"filter.kind": kind, "filter.cutoff": 30.0})
    assert only_block(conditioner.blocks(reading([1.0, 2.0]))).source == source


def test_block_states_its_source_and_is_read_only() -> None:
    source = StartedSource(channels=("ai0", "ai1"), simulated=True)
    blocks = signal({"frame_id": "cell"}, source).blocks(reading([[1.0, 2.0], [3.0, 4.0]], first=7, lost=2))
    for (block,), frame_id in zip(blocks, ("cell", "cell_ai1"), strict=True):
        assert (block.frame_id, block.source, block.simulated) == (frame_id, "a load cell", True)
        assert (block.first_sample, block.lost_samples) == (7, 2)
        assert not block.force.flags.writeable
        assert not block.saturated_samples.flags.writeable
        assert block.saturated_samples.dtype == np.uint32
    assert blocks[1][0].force.tolist() == [3.0, 4.0]


@pytest.mark.parametrize(
    ("simulated", "stated", "uncertainty"), [(False, None, 0.15), (True, None, 0.0), (False, 0.02, 0.02)]
)
def test_uncertainty_is_that_of_the_sensitivity_or_the_recording(
    *, simulated: bool, stated: float | None, uncertainty: float
) -> None:
    made = reading([1.0])._replace(relative_uncertainty=stated)
    assert (
        only_block(signal(source=StartedSource(simulated=simulated)).blocks(made)).relative_uncertainty == uncertainty
    )


holes = arrays(np.float64, st.integers(0, 40), elements=st.sampled_from([1.0, 2.0, 3.0, math.nan, INF, -INF]))


@given(st.lists(st.tuples(st.integers(0, 5), holes), min_size=1, max_size=6))
def test_every_sample_is_published_or_counted_as_lost(readings: list[tuple[int, FloatArray]]) -> None:
    force = signal()
    (channel,) = force.channels
    taken: dict[int, float] = {}
    published: dict[int, float] = {}
    first = 0
    end = 0  # of the samples published or counted as lost
    for lost, samples in readings:
        first += lost
        taken |= {first + i: value for i, value in enumerate(samples.tolist()) if math.isfinite(value)}
        for block in force.blocks(reading(samples, first, lost))[0]:
            assert block.force.size
            assert block.first_sample == end + block.lost_samples
            published |= {block.first_sample + i: value for i, value in enumerate(block.force.tolist())}
            end = block.first_sample + block.force.size
        first += samples.size
    assert published == taken
    assert channel.samples == len(published)
    assert channel.samples + channel.lost == first


def test_gap_in_the_sample_numbers_is_counted() -> None:
    force = signal()
    force.blocks(reading([1.0] * 10))
    assert only_block(force.blocks(reading([1.0] * 10, first=15, lost=2))).lost_samples == 5
    block = only_block(force.blocks(reading([1.0] * 10, first=0, lost=3)))  # restarted
    assert (block.first_sample, block.lost_samples) == (0, 3)
    assert force.channels[0].lost == 8


def test_stamps_of_a_device_are_those_of_the_fit_less_the_delays() -> None:
    source = StartedSource(filter_delay=3e-3, channels=("ai0", "ai1"))
    force = signal(source=source)
    settings: dict[str, object] = {"filter.kind": "zero_phase", "filter.cutoff": 100.0}
    filtered = signal(settings, source)
    delay = filtered.channels[0].lowpass_delay
    assert delay > 0.0
    for i in range(5):
        block = force.blocks(reading(np.zeros((2, 100)), first=i * 100))[1][0]
        assert block.stamp_ns == NOW + round((i * 0.1 - 3e-3) * 1e9)
        assert block.filter_delay == 3e-3
        assert block.clock_residual == force.clock.residual
        assert block.sample_rate == force.clock.sample_rate
        block = filtered.blocks(reading(np.zeros((2, 100)), first=i * 100))[1][0]
        assert block.stamp_ns == NOW + round((i * 0.1 - 3e-3 - delay) * 1e9)
        assert block.filter_delay == pytest.approx(3e-3 + delay)


def test_restarted_device_restarts_the_fit() -> None:
    force = signal()
    for i in range(20):
        force.blocks(reading([1.0] * 100, first=i * 100))
    late = reading([1.0] * 100, first=2500, lost=500)
    late = late._replace(read_ns=late.read_ns + 3_000_000, run=1)  # less than a jump
    assert only_block(force.blocks(late)).stamp_ns == NOW + 2_500_000_000 + 3_000_000
    assert force.clock.residual == pytest.approx(10e-3)
    assert force.clock.restarts == 0


def test_sample_rate_is_measured_for_a_device_and_stated_for_a_recording() -> None:
    force, recorded = signal(), signal()
    true_rate = RATE * (1.0 + 80e-6)
    for i in range(100):
        made = reading([1.0] * 100, first=i * 100, rate=true_rate)
        block = only_block(force.blocks(made))
        of_recording = only_block(recorded.blocks(made._replace(stamp_ns=made.read_ns)))
    assert block.sample_rate == pytest.approx(true_rate, rel=1e-7)
    assert of_recording.sample_rate == RATE


def test_stamps_of_a_recording_are_less_the_delay_of_the_low_pass() -> None:
    source = StartedSource(filter_delay=3e-3)
    recorded = reading([1.0, math.nan, 2.0], first=10, stamp_ns=5_000_000_000)._replace(clock_residual=2e-4)
    before, after = signal(source=source).blocks(recorded)[0]
    assert (before.stamp_ns, after.stamp_ns) == (5_000_000_000, 5_002_000_000)
    assert (before.filter_delay, before.clock_residual, before.sample_rate) == (3e-3, 2e-4, RATE)
    block = signal({"filter.kind": "causal", "filter.cutoff": 100.0}, source).blocks(recorded)[0][0]
    assert block.filter_delay > 3e-3
    assert block.stamp_ns == 5_000_000_000 - round((block.filter_delay - 3e-3) * 1e9)


@given(
    kind=st.sampled_from(get_args(FilterKind)),
    onset=st.floats(0.02, 0.06),
    duration=st.floats(0.008, 0.02),
    blocks=st.integers(1, 9),
)
def test_filter_does_not_move_an_impact_in_time(kind: FilterKind, onset: float, duration: float, blocks: int) -> None:
    # A converter whose filter delays by 38 samples, and an impact whose peak is known.
    rate, delay = 12_800.0, 38.0 / 12_800.0
    t = np.arange(1280) / rate - delay
    phase = np.clip((t - onset) / duration, 0.0, 1.0)
    samples = 100.0 * np.sin(math.pi * phase)
    source = StartedSource(sample_rate=rate, filter_delay=delay)
    force = signal({"filter.kind": kind, "filter.cutoff": 1000.0}, source)
    weighted = total = 0.0
    for portion in np.array_split(np.arange(1280), blocks):
        made = reading(samples[portion], int(portion[0]), rate=rate)
        block = only_block(force.blocks(made))
        stamps_s = (block.stamp_ns - NOW) / 1e9 + np.arange(block.force.size) / block.sample_rate
        weighted += float(stamps_s @ block.force)
        total += float(block.force.sum())
    # The centre of the impulse; ROS time NOW is that of sample 0, before the delay.
    assert weighted / total == pytest.approx(onset + duration / 2.0, abs=0.1 / rate)
    assert total / rate == pytest.approx(100.0 * 2.0 / math.pi * duration, rel=1e-3)


@pytest.mark.parametrize(
    ("limit", "settings", "expected"),
    [
        (INF, {"sensor.range": 2.5}, [2, 3]),
        (1.5, {}, [1, 2, 3]),
        (3.0, {"sensor.range": 2.0}, [1, 2, 3]),
        (INF, {}, []),
    ],
)
def test_samples_at_the_end_of_the_range_are_marked(
    limit: float, settings: dict[str, object], expected: list[int]
) -> None:
    force = signal(settings, StartedSource(limit=limit))
    block = only_block(force.blocks(reading([1.0, -2.0, 3.0, -3.0])))
    assert block.saturated_samples.tolist() == expected
    assert force.channels[0].saturated == len(expected)


def test_range_applies_before_the_tare() -> None:
    force = signal({"sensor.range": 100.0, "tare.at_start": True, "tare.time": 0.1})
    force.blocks(reading([50.0] * 100))
    block = only_block(force.blocks(reading([60.0, 99.95], first=100)))
    assert block.force == pytest.approx([10.0, 49.95])
    assert block.saturated_samples.tolist() == [1]


def test_samples_marked_by_the_source_are_saturated() -> None:
    marks = np.array([[False, True, False], [False, False, False]])
    blocks = signal(source=StartedSource(channels=("a", "b"))).blocks(reading(np.ones((2, 3)), saturated=marks))
    assert [block.saturated_samples.tolist() for (block,) in blocks] == [[1], []]


def test_samples_beyond_the_range_are_saturated_beside_those_marked_by_the_source() -> None:
    marks = np.array([[False, True, False, False]])
    force = signal({"sensor.range": 100.0}, StartedSource(limit=500.0))
    block = only_block(force.blocks(reading([1.0, 1.0, 101.0, 1.0], saturated=marks)))
    assert block.saturated_samples.tolist() == [1, 2]


@given(st.sets(st.integers(0, 399), max_size=4), st.lists(st.integers(1, 399), max_size=6))
def test_outputs_influenced_by_a_saturated_sample_are_marked(at: set[int], cuts: list[int]) -> None:
    settings: dict[str, object] = {"filter.kind": "zero_phase", "filter.cutoff": 100.0}
    plain, saturated = np.zeros(400), np.zeros(400)
    saturated[list(at)] = 1.0
    force = signal({**settings, "sensor.range": 0.5})
    marked: list[int] = []
    for portion in np.split(np.arange(400), sorted(set(cuts))):
        block = only_block(force.blocks(reading(saturated[portion], int(portion[0]))))
        marked += (block.saturated_samples + block.first_sample).tolist()
    influenced = only_block(signal(settings).blocks(reading(saturated))).force != plain
    # The filter extends the first sample to the past; this extension is not a sample.
    assert marked == np.flatnonzero(influenced).tolist()


def test_low_pass_restarts_after_a_gap() -> None:
    force = signal({"filter.kind": "causal", "filter.cutoff": 10.0, "sensor.range": 500.0})
    force.blocks(reading([1000.0] * 10))
    block = only_block(force.blocks(reading([3.0] * 10, first=20, lost=10)))
    assert block.force == pytest.approx([3.0] * 10)
    assert not block.saturated_samples.size
    before, after = force.blocks(reading([1000.0, math.nan, 3.0], first=30))[0]
    assert before.saturated_samples.size
    assert after.force == pytest.approx([3.0])
    assert not after.saturated_samples.size
    assert only_block(force.blocks(reading([4.0] * 3, first=0))).force == pytest.approx([4.0] * 3)
    block = only_block(force.blocks(reading([5.0] * 3, first=3, lost=2)))  # lost although the numbers continue
    assert block.force == pytest.approx([5.0] * 3)


def test_first_tare_applies_after_its_samples() -> None:
    force = signal({"tare.at_start": True, "tare.time": 0.15})
    (channel,) = force.channels
    for first in (0, 100):
        assert force.taring
        block = only_block(force.blocks(reading([5.0] * 100, first)))
        assert (block.tare, block.tare_stamp_ns) == (0.0, 0)
        assert block.force == pytest.approx([5.0] * 100)
    assert not force.taring
    assert channel.tare == pytest.approx(5.0)
    block = only_block(force.blocks(reading([6.0] * 100, first=200)))
    assert block.force == pytest.approx([1.0] * 100)
    assert block.tare == channel.tare
    assert block.tare_stamp_ns == channel.tare_stamp_ns == NOW + 199_000_000
    assert channel.tare_problem == ""


def test_new_tare_replaces_the_old_one() -> None:
    force = signal({"tare.at_start": True, "tare.time": 0.1})
    force.blocks(reading([5.0] * 100))
    force.begin_tare()
    assert force.taring
    block = only_block(force.blocks(reading([7.0] * 100, first=100)))
    assert block.force == pytest.approx([2.0] * 100)
    assert only_block(force.blocks(reading([7.0] * 100, first=200))).force == pytest.approx([0.0] * 100)
    assert force.channels[0].tare == pytest.approx(7.0)


def test_refused_tare_keeps_the_old_one_and_states_the_reason() -> None:
    force = signal({"tare.at_start": True, "tare.time": 0.1})
    (channel,) = force.channels
    force.blocks(reading([5.0] * 100))
    stamp_ns = channel.tare_stamp_ns
    force.begin_tare()
    force.blocks(reading(np.linspace(0.0, 50.0, 100), first=100))
    assert not force.taring
    assert channel.tare == pytest.approx(5.0)
    assert channel.tare_stamp_ns == stamp_ns
    assert channel.tare_problem.startswith("refused: the force moved")
    force.begin_tare()
    assert channel.tare_problem == ""


def test_no_tare_without_a_request() -> None:
    force = signal()
    block = only_block(force.blocks(reading([5.0] * 2000)))
    assert (block.tare, block.tare_stamp_ns, force.taring) == (0.0, 0, False)


def test_tare_uses_finite_samples_only() -> None:
    force = signal({"tare.at_start": True, "tare.time": 0.1})
    force.blocks(reading([5.0, math.nan] * 99))
    assert force.taring
    force.blocks(reading([5.0], first=198))
    assert force.channels[0].tare == pytest.approx(5.0)


def test_filter_that_does_not_fit_is_refused_in_one_line() -> None:
    with pytest.raises(SettingsError, match=r"^filter.cutoff = 2000: must be below 500 Hz, half of the sample rate$"):
        signal({"filter.kind": "causal"})


@pytest.mark.live
def test_conditioning_does_not_import_scipy() -> None:
    program = "import sys, scara_effmass.daq.conditioning; sys.exit('scipy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0

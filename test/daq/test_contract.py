# SPDX-License-Identifier: Apache-2.0
"""Contract of all force sources."""

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import chain, pairwise, repeat
from pathlib import Path

import numpy as np
import pytest

import scara_effmass.sim.experiment  # noqa: F401 - importing MuJoCo starts a process, which a test must not
from scara_effmass.daq import make_source
from scara_effmass.daq.sim_source import HalfSineSource, SimCellSource
from scara_effmass.daq.source import ForceSource, Reading
from scara_effmass.errors import BagError, DaqError, EffmassError, SettingsError
from scara_effmass.settings import DaqSettings, checked
from test.daq.conftest import NiDevice
from test.daq.force_bag import force_block, write_blocks

NS = 1_000_000_000
NOW_NS = 1_767_225_600 * NS
SAMPLES = 3000
SOON_S = 120.0


@dataclass
class Subject:
    """A source under test."""

    settings: dict[str, object]
    make: Callable[[DaqSettings, Callable[[], int]], ForceSource]
    finite: bool
    recorded: bool = False
    missing: dict[str, object] = field(default_factory=dict)
    """Settings with which the source cannot start."""
    slow: dict[str, object] = field(default_factory=dict)
    """Settings with which the first block is late."""
    hold: Callable[[], None] = lambda: None
    """Let reads block."""
    waiting: threading.Event = field(default_factory=threading.Event)
    """Set when a read waits."""
    made: list[ForceSource] = field(default_factory=list)
    now_ns: int = NOW_NS

    def clock(self) -> int:
        """Return the ROS time, which advances by 1 µs per call."""
        self.waiting.set()
        self.now_ns += 1000
        return self.now_ns

    def source(self, **values: object) -> ForceSource:
        """Create a source that is closed at the end of the test."""
        settings = checked(DaqSettings, {**self.settings, **values}, "test")
        made = self.make(settings, self.clock)
        self.made.append(made)
        return made

    def started(self, **values: object) -> ForceSource:
        """Create and start a source."""
        source = self.source(**values)
        source.start()
        return source


def half_sines(_: pytest.FixtureRequest, __: Path) -> Subject:
    subject = Subject(
        settings={"source": "sim", "sim.channels": 3, "sim.impact_period": 0.5},
        make=make_source,
        finite=False,
        slow={"block_time": 2.0},
    )
    steady = [0]

    def fast_ns() -> int:
        """Return a steady time that advances by 1 s per call, so that all blocks are due."""
        steady[0] += NS
        return steady[0]

    times_ns = chain([3600 * NS], repeat(0))

    def stopped_ns() -> int:
        """Return a constant steady time, 1 h before the start, so that no block is ever due."""
        subject.waiting.set()
        return next(times_ns)

    def make(settings: DaqSettings, now_ns: Callable[[], int]) -> ForceSource:
        assert isinstance(make_source(settings, now_ns), HalfSineSource)
        return HalfSineSource(settings, now_ns, stopped_ns if settings.block_time == 2.0 else fast_ns)

    subject.make = make
    return subject


def sim_cell(_: pytest.FixtureRequest, __: Path) -> Subject:
    subject = Subject(
        settings={"source": "sim", "sim.scene": "cell", "block_time": 0.02},
        make=make_source,
        finite=False,
        slow={"block_time": 1.0},
    )

    def make(settings: DaqSettings, _: Callable[[], int]) -> ForceSource:
        def fast_ns() -> int:
            subject.now_ns += NS // 10
            return subject.now_ns

        source = make_source(settings, subject.clock if settings.block_time == 1.0 else fast_ns)
        assert isinstance(source, SimCellSource)
        return source

    subject.make = make
    return subject


def ni9230(request: pytest.FixtureRequest, _: Path, samples: int = 0) -> Subject:
    device: NiDevice = request.getfixturevalue("ni_device")
    return Subject(
        settings={"source": "ni9230", "ni9230.channels": ["cDAQ1Mod1/ai0", "cDAQ1Mod1/ai2"], "ni9230.samples": samples},
        make=lambda settings, _: make_source(settings, device.clock),
        finite=bool(samples),
        missing={"ni9230.channels": ["cDAQ7Mod1/ai0"]},
        hold=lambda: setattr(device, "blocking", True),
        waiting=device.waiting,
    )


def ni9230_finite(request: pytest.FixtureRequest, folder: Path) -> Subject:
    return ni9230(request, folder, samples=SAMPLES)


def bag_blocks(_: pytest.FixtureRequest, folder: Path) -> Subject:
    marks = np.array([3], np.uint32)
    blocks = [
        force_block(0, 1000),
        force_block(1000, 1000),
        force_block(2050, 1000, lost_samples=50, saturated_samples=marks),
    ]
    path = write_blocks(folder / "blocks.mcap", blocks)
    return Subject(
        settings={"source": "bag", "bag.path": str(path), "bag.rate": 0.0, "block_time": 0.5},
        make=make_source,
        finite=True,
        recorded=True,
        missing={"bag.path": str(folder / "missing.mcap")},
        slow={"bag.rate": 1.0},
    )


DEPENDENT = (ni9230, ni9230_finite, bag_blocks)
"""Sources that need a device or a file."""


def name_of(build: Callable[..., Subject]) -> str:
    return build.__name__


@pytest.fixture(params=(half_sines, sim_cell, *DEPENDENT), ids=name_of)
def subject(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Subject]:
    made: Subject = request.param(request, tmp_path)
    yield made
    for source in made.made:
        source.close()


def block(source: ForceSource) -> Reading:
    reading = source.read(SOON_S)
    assert reading is not None
    return reading


def read_all(source: ForceSource, max_readings: int) -> list[Reading]:
    """Return the readings up to the end, at most `max_readings`."""
    readings: list[Reading] = []
    while len(readings) < max_readings and (reading := source.read(SOON_S)) is not None:
        readings.append(reading)
    return readings


def test_constructor_opens_nothing(subject: Subject) -> None:
    threads = set(threading.enumerate())
    subject.source(**subject.missing)
    assert set(threading.enumerate()) <= threads


def test_source_before_start_has_no_reading_and_can_be_closed(subject: Subject) -> None:
    source = subject.source()
    assert source.read(0.0) is None
    assert not source.ended
    source.close()
    source.close()


def test_started_source_describes_itself(subject: Subject) -> None:
    source = subject.started()
    assert source.channels
    assert all(source.channels)
    assert len(set(source.channels)) == len(source.channels)
    assert source.description.strip() == source.description != ""
    assert "\n" not in source.description
    assert ("simulated" in source.description) is source.simulated
    assert 0.0 < source.sample_rate < np.inf
    assert 0.0 < source.requested_rate < np.inf
    assert source.limit > 0.0
    assert 0.0 <= source.filter_delay < 1.0


def test_samples_are_read_only_rows_of_channels(subject: Subject) -> None:
    source = subject.started()
    readings = read_all(source, 5)
    assert readings
    for reading in readings:
        channels, count = reading.samples.shape
        assert channels == len(source.channels)
        assert count > 0
        assert reading.samples.dtype == np.float64
        assert not reading.samples.flags.writeable
        assert np.isfinite(reading.samples).all()
        assert np.abs(reading.samples).max() > 0.0
        if reading.saturated is not None:
            assert reading.saturated.shape == reading.samples.shape
            assert reading.saturated.dtype == np.bool_
            assert not reading.saturated.flags.writeable


def test_next_readings_leave_a_reading_unchanged(subject: Subject) -> None:
    source = subject.started()
    first = block(source)
    before = first.samples.copy()
    read_all(source, 5)
    source.close()
    assert np.array_equal(first.samples, before)


def test_sample_numbers_have_gaps_only_for_lost_samples(subject: Subject) -> None:
    source = subject.started()
    readings = read_all(source, 20)
    assert readings
    end = 0
    for reading in readings:
        assert reading.lost >= 0
        assert reading.first_sample == end + reading.lost
        assert reading.run == 0
        end = reading.first_sample + reading.samples.shape[1]
    assert len(readings) == 20 or end >= SAMPLES


def test_reading_has_its_time(subject: Subject) -> None:
    source = subject.started()
    readings = read_all(source, 20)
    assert readings[0].read_ns >= NOW_NS
    assert all(after.read_ns >= before.read_ns for before, after in pairwise(readings))
    if not subject.recorded:
        assert {reading.stamp_ns for reading in readings} == {None}
        return
    stamps_ns = [reading.stamp_ns for reading in readings if reading.stamp_ns is not None]
    assert len(stamps_ns) == len(readings)
    for reading, stamp_ns in zip(readings, stamps_ns, strict=True):
        expected_ns = (reading.first_sample - readings[0].first_sample) / source.sample_rate * NS
        assert stamp_ns - stamps_ns[0] == pytest.approx(expected_ns, abs=1000.0)


def test_only_a_finite_source_ends(subject: Subject) -> None:
    source = subject.started()
    ended, readings = [source.ended], read_all(source, 200)
    ended.append(source.ended)
    assert ended == [False, subject.finite]
    if subject.finite:
        assert sum(reading.samples.shape[1] for reading in readings) == SAMPLES
        assert source.read(0.0) is None
        assert source.read(SOON_S) is None
    else:
        assert len(readings) == 200


def test_restart_begins_at_sample_zero(subject: Subject) -> None:
    source = subject.started()
    first = block(source)
    read_all(source, 2)
    source.close()
    source.start()
    again = block(source)
    assert not source.ended
    assert again.first_sample == first.first_sample == 0
    assert np.array_equal(again.samples, first.samples)


def test_closed_source_has_no_reading_and_can_be_closed_again(subject: Subject) -> None:
    source = subject.started()
    block(source)
    source.close()
    source.close()
    assert source.read(0.0) is None


def test_read_returns_after_its_timeout(subject: Subject) -> None:
    source = subject.started(**subject.slow)
    began = time.monotonic()
    reading = source.read(0.05)
    assert time.monotonic() - began < SOON_S
    if subject.slow:
        assert reading is None
        assert not source.ended


def test_close_ends_a_read_in_another_thread(subject: Subject) -> None:
    source = subject.started(**subject.slow)
    subject.hold()
    subject.waiting.clear()
    answers: list[Reading | None] = []
    reader = threading.Thread(target=lambda: answers.append(source.read(600.0)))
    reader.start()
    assert subject.waiting.wait(SOON_S)
    began = time.monotonic()
    source.close()
    reader.join(SOON_S)
    assert not reader.is_alive()
    assert time.monotonic() - began < SOON_S
    assert answers == [None]


@pytest.mark.parametrize("subject", DEPENDENT, indirect=True, ids=name_of)
def test_missing_device_or_file_is_refused_in_one_line(subject: Subject) -> None:
    source = subject.source(**subject.missing)
    with pytest.raises(EffmassError) as caught:
        source.start()
    assert isinstance(caught.value, (DaqError, BagError, SettingsError))
    text = str(caught.value)
    assert "\n" not in text
    assert any(str(part) in text for value in subject.missing.values() for part in np.ravel(np.asarray(value)))
    assert source.read(0.0) is None
    source.close()

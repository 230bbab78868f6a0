"""What every source of force must do, whatever is behind it."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field
from itertools import chain, pairwise, repeat
from typing import TYPE_CHECKING

import numpy as np
import pytest
from nptdms import ChannelObject, TdmsWriter

from scara_effmass.bags.messages import header, message, serialized
from scara_effmass.bags.writer import BagWriter
from scara_effmass.daq.simulated import SimulatedForce
from scara_effmass.daq.source import Unit, make_source
from scara_effmass.daq.virtual_cell import VirtualCellForce
from scara_effmass.errors import BagError, DaqError, EffmassError, SettingsError
from scara_effmass.settings import DaqSettings, checked
from scara_effmass.values import ForceBlock
from scara_effmass.wire.force import force_block_message
from scara_effmass.wire.message_types import FORCE_BLOCK, WRENCH_STAMPED

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from scara_effmass.daq.source import ForceSource, Reading
    from test.daq.conftest import NiDevice

NS = 1_000_000_000
NOW_NS = 1_767_225_600 * NS
RECORDED_NS = NOW_NS - 1000 * NS
RATE = 1000.0
SAMPLES = 3000
SOON_S = 120.0


@dataclass
class Subject:
    """A source under test."""

    settings: dict[str, object]
    make: Callable[[DaqSettings, Callable[[], int]], ForceSource]
    finite: bool
    recorded: bool = False
    elsewhere: dict[str, object] = field(default_factory=dict)
    """Settings under which it cannot start."""
    slow: dict[str, object] = field(default_factory=dict)
    """Settings under which the first block takes a while."""
    hold: Callable[[], None] = lambda: None
    """Let reads wait for real."""
    waiting: threading.Event = field(default_factory=threading.Event)
    """Set when a read has begun to wait."""
    made: list[ForceSource] = field(default_factory=list)
    now_ns: int = NOW_NS

    def clock(self) -> int:
        """ROS time, which goes on by a microsecond whenever somebody looks."""
        self.waiting.set()
        self.now_ns += 1000
        return self.now_ns

    def source(self, **values: object) -> ForceSource:
        """Make a source; it is closed at the end of the test."""
        settings = checked(DaqSettings, {**self.settings, **values}, "test")
        made = self.make(settings, self.clock)
        self.made.append(made)
        return made

    def started(self, **values: object) -> ForceSource:
        """Make and start one."""
        source = self.source(**values)
        source.start()
        return source


def bench(_: pytest.FixtureRequest, __: Path) -> Subject:
    subject = Subject(
        settings={"source": "sim", "sim.channels": 3, "sim.impact_period": 0.5},
        make=make_source,
        finite=False,
        slow={"block_time": 2.0},
    )
    steady = [0]

    def hasty_ns() -> int:
        """Return a steady time that is a second on whenever somebody looks: every block is there already."""
        steady[0] += NS
        return steady[0]

    begun_ns = chain([3600 * NS], repeat(0))

    def standing_ns() -> int:
        """Return a steady time that stands, an hour before the start: however long a read waits, nothing comes."""
        subject.waiting.set()
        return next(begun_ns)

    def make(settings: DaqSettings, now_ns: Callable[[], int]) -> ForceSource:
        assert isinstance(make_source(settings, now_ns), SimulatedForce)
        return SimulatedForce(settings, now_ns, standing_ns if settings.block_time == 2.0 else hasty_ns)

    subject.make = make
    return subject


def virtual_cell(_: pytest.FixtureRequest, __: Path) -> Subject:
    subject = Subject(
        settings={"source": "sim", "sim.scene": "cell", "block_time": 0.02},
        make=make_source,
        finite=False,
        slow={"block_time": 1.0},
    )

    def make(settings: DaqSettings, _: Callable[[], int]) -> ForceSource:
        def hasty_ns() -> int:
            subject.now_ns += NS // 10
            return subject.now_ns

        source = make_source(settings, subject.clock if settings.block_time == 1.0 else hasty_ns)
        assert isinstance(source, VirtualCellForce)
        return source

    subject.make = make
    return subject


def ni9230(request: pytest.FixtureRequest, _: Path, samples: int = 0) -> Subject:
    device: NiDevice = request.getfixturevalue("ni_device")
    return Subject(
        settings={"source": "ni9230", "ni9230.channels": ["cDAQ1Mod1/ai0", "cDAQ1Mod1/ai2"], "ni9230.samples": samples},
        make=lambda settings, _: make_source(settings, device.clock),
        finite=bool(samples),
        elsewhere={"ni9230.channels": ["cDAQ7Mod1/ai0"]},
        hold=lambda: setattr(device, "blocking", True),
        waiting=device.waiting,
    )


def ni9230_finite(request: pytest.FixtureRequest, folder: Path) -> Subject:
    return ni9230(request, folder, samples=SAMPLES)


def recorded(path: Path, folder: Path, **more: object) -> Subject:
    return Subject(
        settings={"source": "bag", "bag.path": str(path), "bag.rate": 0.0, "block_time": 0.5} | more,
        make=make_source,
        finite=True,
        recorded=True,
        elsewhere={"bag.path": str(folder / f"elsewhere{path.suffix}")},
        slow={"bag.rate": 1.0},
    )


def force_samples() -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return 100.0 * np.sin(np.arange(SAMPLES) / 50.0)


def blocks_file(folder: Path, *, simulated: bool) -> Path:
    path = folder / "blocks.mcap"
    with BagWriter(path) as bag:
        for first, lost in ((0, 0), (1000, 0), (2050, 50)):
            block = ForceBlock(
                stamp_ns=RECORDED_NS + first * 1_000_000,
                frame_id="sensor",
                first_sample=first,
                sample_rate=RATE,
                force=force_samples()[:1000],
                lost_samples=lost,
                saturated_samples=np.array([3] * bool(lost), np.uint32),
                clock_residual=1e-4,
                filter_delay=0.0,
                source="",
                simulated=simulated,
                tare=0.0,
                tare_stamp_ns=0,
                relative_uncertainty=0.15,
            )
            bag.write("/force", FORCE_BLOCK, block.stamp_ns + NS, force_block_message(block))
    return path


def bag_blocks(_: pytest.FixtureRequest, folder: Path) -> Subject:
    return recorded(blocks_file(folder, simulated=False), folder)


def simulated_bag_blocks(_: pytest.FixtureRequest, folder: Path) -> Subject:
    return recorded(blocks_file(folder, simulated=True), folder)


def bag_wrench(_: pytest.FixtureRequest, folder: Path) -> Subject:
    path = folder / "wrench"
    vector = "geometry_msgs/msg/Vector3"
    torque = message(vector, {"x": 0.0, "y": 0.0, "z": 0.0})
    with BagWriter(path) as bag:
        for number, force in enumerate(force_samples()):
            stamp_ns = RECORDED_NS + number * 1_000_000
            wrench = {"force": message(vector, {"x": 1.0, "y": 2.0, "z": force}), "torque": torque}
            fields = {"header": header(stamp_ns, "f"), "wrench": message("geometry_msgs/msg/Wrench", wrench)}
            bag.write("/wrench", WRENCH_STAMPED, stamp_ns, serialized(WRENCH_STAMPED, fields))
    return recorded(path, folder)


def csv_file(_: pytest.FixtureRequest, folder: Path) -> Subject:
    path = folder / "cell.csv"
    rows = [f"{number / RATE:.3f},{force:.6f}\n" for number, force in enumerate(force_samples())]
    path.write_text("".join(["time,force\n", *rows]), encoding="utf-8")
    return recorded(path, folder, **{"bag.unit": "N"})


def tdms_file(_: pytest.FixtureRequest, folder: Path) -> Subject:
    path = folder / "cell.tdms"
    properties = {"wf_increment": 1.0 / RATE, "wf_start_offset": 0.0, "unit_string": "kN"}
    with TdmsWriter(path) as file:
        file.write_segment([ChannelObject("cell", "force", force_samples() / 1e3, properties)])
    return recorded(path, folder)


NEEDY = (
    ni9230,
    ni9230_finite,
    bag_blocks,
    simulated_bag_blocks,
    bag_wrench,
    csv_file,
    tdms_file,
)
"""What needs a device or a file."""


def name_of(build: Callable[..., Subject]) -> str:
    return build.__name__


@pytest.fixture(params=(bench, virtual_cell, *NEEDY), ids=name_of)
def subject(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Subject]:
    made: Subject = request.param(request, tmp_path)
    yield made
    for source in made.made:
        source.close()


def block(source: ForceSource) -> Reading:
    reading = source.read(SOON_S)
    assert reading is not None
    return reading


def all_of(source: ForceSource, most: int) -> list[Reading]:
    """Read to the end, or `most` readings."""
    readings: list[Reading] = []
    while len(readings) < most and (reading := source.read(SOON_S)) is not None:
        readings.append(reading)
    return readings


def test_making_one_opens_nothing(subject: Subject) -> None:
    threads = set(threading.enumerate())
    subject.source(**subject.elsewhere)
    assert set(threading.enumerate()) <= threads


def test_before_the_start_there_is_nothing_to_read_and_closing_is_allowed(subject: Subject) -> None:
    source = subject.source()
    assert source.read(0.0) is None
    assert not source.ended
    source.close()
    source.close()


def test_from_the_start_on_it_says_what_it_is(subject: Subject) -> None:
    source = subject.started()
    assert isinstance(source.unit, Unit)
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
    readings = all_of(source, 5)
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


def test_a_reading_stays_as_it_was_when_others_follow(subject: Subject) -> None:
    source = subject.started()
    first = block(source)
    before = first.samples.copy()
    all_of(source, 5)
    source.close()
    assert np.array_equal(first.samples, before)


def test_samples_are_numbered_without_a_gap_but_for_those_lost(subject: Subject) -> None:
    source = subject.started()
    readings = all_of(source, 20)
    assert readings
    end = 0
    for reading in readings:
        assert reading.lost >= 0
        assert reading.first_sample == end + reading.lost
        assert reading.run == 0
        end = reading.first_sample + reading.samples.shape[1]
    assert len(readings) == 20 or end >= SAMPLES


def test_a_reading_tells_its_time(subject: Subject) -> None:
    source = subject.started()
    readings = all_of(source, 20)
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


def test_a_finite_source_ends_and_an_endless_one_does_not(subject: Subject) -> None:
    source = subject.started()
    ended, readings = [source.ended], all_of(source, 200)
    ended.append(source.ended)
    assert ended == [False, subject.finite]
    if subject.finite:
        assert sum(reading.samples.shape[1] for reading in readings) == SAMPLES
        assert source.read(0.0) is None
        assert source.read(SOON_S) is None
    else:
        assert len(readings) == 200


def test_started_again_it_begins_anew(subject: Subject) -> None:
    source = subject.started()
    first = block(source)
    all_of(source, 2)
    source.close()
    source.start()
    again = block(source)
    assert again.first_sample == first.first_sample == 0
    assert again.samples.shape == first.samples.shape


def test_closed_it_gives_nothing_and_may_be_closed_again(subject: Subject) -> None:
    source = subject.started()
    block(source)
    source.close()
    source.close()
    assert source.read(0.0) is None


def test_a_read_is_over_in_time(subject: Subject) -> None:
    source = subject.started(**subject.slow)
    began = time.monotonic()
    reading = source.read(0.05)
    assert time.monotonic() - began < SOON_S
    if subject.slow:
        assert reading is None
        assert not source.ended


def test_closing_ends_a_read_in_another_thread(subject: Subject) -> None:
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


@pytest.mark.parametrize("subject", NEEDY, indirect=True, ids=name_of)
def test_what_is_not_there_is_refused_in_one_line(subject: Subject) -> None:
    source = subject.source(**subject.elsewhere)
    with pytest.raises(EffmassError) as caught:
        source.start()
    assert isinstance(caught.value, (DaqError, BagError, SettingsError))
    text = str(caught.value)
    assert "\n" not in text
    assert any(str(part) in text for value in subject.elsewhere.values() for part in np.ravel(np.asarray(value)))
    assert source.read(0.0) is None
    source.close()

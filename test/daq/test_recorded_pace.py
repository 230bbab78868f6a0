"""When the blocks of a recording come: by the clock, whatever kind of clock it is."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from scara_effmass.bags.writer import BagWriter
from scara_effmass.daq.recorded import EARLY_NS, RecordedForce
from scara_effmass.errors import SettingsError
from scara_effmass.settings import BagSettings, DaqSettings, Stamps
from scara_effmass.values import ForceBlock
from scara_effmass.wire.force import force_block_message
from scara_effmass.wire.message_types import FORCE_BLOCK

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from scara_effmass.daq.source import Reading

    Play = Callable[..., RecordedForce]

NS = 10**9
MS = 10**6
T0 = 1_700_000_000 * NS
NOW = 1_800_000_000 * NS
LAST_MS = 99
"""From the first sample of a block to its last."""


class Clock:
    def __init__(self, now_ns: int) -> None:
        self.now_ns = now_ns

    def __call__(self) -> int:
        return self.now_ns


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Return a recording of ten blocks of 100 ms."""
    with BagWriter(tmp_path / "run") as bag:
        for n in range(10):
            stamp_ns = T0 + n * 100 * MS
            block = ForceBlock(
                stamp_ns, "", 100 * n, 1000.0, np.zeros(100), 0, np.empty(0, np.uint32), 0.0, 0.0, "test",
                simulated=False, tare=0.0, tare_stamp_ns=0, relative_uncertainty=0.0,
            )  # fmt: skip
            bag.write("/force", FORCE_BLOCK, stamp_ns + 100 * MS, force_block_message(block))
    return tmp_path / "run"


@pytest.fixture
def play(path: Path) -> Iterator[Play]:
    """Return what starts the recording by a clock."""
    started: list[RecordedForce] = []

    def start(clock: Callable[[], int], **bag: Any) -> RecordedForce:  # noqa: ANN401 - of any setting
        started.append(RecordedForce(DaqSettings(bag=BagSettings(path=str(path), **bag)), clock))
        started[-1].start()
        return started[-1]

    yield start
    for each in started:
        each.close()


def taken(recorded: RecordedForce) -> list[Reading]:
    """Return what is due."""
    return list(iter(lambda: recorded.read(0.0), None))


def due(recorded: RecordedForce) -> list[int]:
    """Return the stamps of all blocks that are due, in [ms] after the first one as recorded."""
    stamps = []
    while (reading := recorded.read(0.0)) is not None:
        assert reading.stamp_ns is not None
        stamps.append((reading.stamp_ns - T0) // MS)
    return stamps


@pytest.mark.parametrize("rate", [0.5, 1.0, 4.0])
def test_on_a_wall_clock_it_begins_at_the_start_and_keeps_its_stamps(play: Play, rate: float) -> None:
    clock = Clock(NOW)
    recorded = play(clock, rate=rate)
    assert due(recorded) == []
    clock.now_ns = NOW + int(LAST_MS * MS / rate) - 1
    assert due(recorded) == []
    clock.now_ns = NOW + int(LAST_MS * MS / rate) + 1
    assert due(recorded) == [0]
    clock.now_ns = NOW + int((300 + LAST_MS) * MS / rate) + 1
    assert due(recorded) == [100, 200, 300]
    assert not recorded.ended
    clock.now_ns = NOW + int(1000 * MS / rate)
    assert due(recorded) == [400, 500, 600, 700, 800, 900]
    assert recorded.ended


@pytest.mark.parametrize("lead_ns", [0, NS, EARLY_NS])
def test_on_the_clock_of_its_own_replay_blocks_come_at_their_stamps(play: Play, lead_ns: int) -> None:
    clock = Clock(T0 - lead_ns)
    recorded = play(clock)
    assert due(recorded) == []
    clock.now_ns = T0 + 98 * MS
    assert due(recorded) == []
    clock.now_ns = T0 + 199 * MS
    assert due(recorded) == [0, 100]
    reading_at = T0 + 299 * MS
    clock.now_ns = reading_at
    reading = recorded.read(0.0)
    assert reading is not None
    assert (reading.read_ns, reading.stamp_ns) == (reading_at, T0 + 200 * MS)


def test_one_that_comes_late_to_a_replay_catches_up(play: Play) -> None:
    clock = Clock(T0 + 450 * MS)
    assert due(play(clock)) == [0, 100, 200, 300]


def test_a_clock_far_before_or_behind_the_recording_is_another_one(play: Play) -> None:
    for now_ns in (T0 - EARLY_NS - 1, T0 + 2 * NS):
        clock = Clock(now_ns)
        recorded = play(clock)
        assert due(recorded) == []
        clock.now_ns += LAST_MS * MS
        assert due(recorded) == [0]


def test_simulated_time_that_has_not_begun_is_waited_for(play: Play) -> None:
    clock = Clock(0)
    recorded = play(clock)
    assert due(recorded) == []
    clock.now_ns = T0 - NS
    assert due(recorded) == []
    clock.now_ns = T0 + 100 * MS
    assert due(recorded) == [0]


def test_a_replay_has_its_own_speed(play: Play) -> None:
    with pytest.raises(SettingsError, match=r"run: bag.rate = 2: the clock stands in the span .*; 1 would be right"):
        play(Clock(T0), rate=2.0)


@pytest.mark.parametrize("now_ns", [0, T0, NOW])
def test_without_pace_everything_comes_at_once(play: Play, now_ns: int) -> None:
    recorded = play(Clock(now_ns), rate=0.0)
    assert due(recorded) == list(range(0, 1000, 100))
    assert recorded.ended


def test_stamps_of_now_begin_at_the_start(play: Play) -> None:
    for rate in (0.0, 1.0):
        clock = Clock(T0 + 300 * MS)  # in the span of the recording, which does not matter then
        recorded = play(clock, stamps=Stamps.NOW, rate=rate)
        clock.now_ns += NS
        assert due(recorded) == list(range(300, 1300, 100))


def test_stamps_of_now_need_a_clock_that_has_begun(play: Play) -> None:
    clock = Clock(0)
    recorded = play(clock, stamps=Stamps.NOW, rate=0.0)
    assert due(recorded) == []
    assert not recorded.ended
    clock.now_ns = T0
    assert due(recorded) == list(range(0, 1000, 100))


def test_a_read_waits_for_the_clock(play: Play) -> None:
    calls = 0

    def ticking() -> int:
        nonlocal calls
        calls += 1
        return T0 - NS if calls < 4 else T0 + LAST_MS * MS

    recorded = play(ticking)
    reading = recorded.read(600.0)
    assert reading is not None
    assert (reading.stamp_ns, calls) == (T0, 4)


def test_closing_ends_a_read_and_can_be_done_again(play: Play) -> None:
    looked = threading.Event()

    def standing() -> int:
        looked.set()
        return T0

    recorded = play(standing)
    looked.clear()
    answers: list[object] = []
    reader = threading.Thread(target=lambda: answers.append(recorded.read(600.0)))
    reader.start()
    assert looked.wait(120.0)
    recorded.close()
    reader.join(120.0)
    assert answers == [None]
    recorded.close()
    assert recorded.read(0.0) is None
    assert not recorded.ended


def test_it_can_be_started_again(play: Play) -> None:
    recorded = play(Clock(NOW), rate=0.0)
    first = due(recorded)
    recorded.start()
    assert not recorded.ended
    reading = recorded.read(0.0)
    assert reading is not None
    assert (reading.first_sample, reading.lost, first) == (0, 0, list(range(0, 1000, 100)))


def test_a_replay_that_is_set_back_goes_on_from_there(play: Play) -> None:
    clock = Clock(T0)
    recorded = play(clock)
    clock.now_ns = T0 + 450 * MS
    readings = taken(recorded)
    # 50 ms of the next block were due when the clock was set back into the third.
    clock.now_ns = T0 + 250 * MS
    assert taken(recorded) == []
    assert recorded.awaited == "waiting for the clock to reach 1700000000.299 s: it is at 1700000000.250 s"
    clock.now_ns = T0 + NS
    readings += taken(recorded)
    assert [(r.first_sample, r.lost, r.run, (r.stamp_ns or 0) - T0) for r in readings] == [
        *((100 * n, 0, 0, 100 * n * MS) for n in range(4)),
        (451, 51, 1, 200 * MS),
        *((251 + 100 * n, 0, 1, 100 * n * MS) for n in range(3, 10)),
    ]
    assert recorded.ended


def test_a_replay_in_a_loop_begins_again(play: Play) -> None:
    clock = Clock(T0 - NS)
    recorded = play(clock)
    for run in range(3):
        clock.now_ns = T0 + 899 * MS
        readings = taken(recorded)
        assert {reading.run for reading in readings} == {run}
        assert [(reading.stamp_ns or 0) - T0 for reading in readings] == [100 * n * MS for n in range(9)]
        # What was due is all there: the gap of one sample says that it does not go on.
        assert [reading.lost for reading in readings] == [1 if run else 0, *[0] * 8]
        assert readings[0].first_sample == 901 * run
        clock.now_ns = T0 - NS
        assert taken(recorded) == []


def test_a_clock_that_falters_is_not_set_back(play: Play) -> None:
    clock = Clock(T0)
    recorded = play(clock)
    for ms in (250, 150, 199, 299):
        clock.now_ns = T0 + ms * MS
        assert {reading.run for reading in taken(recorded)} <= {0}
    assert due(recorded) == []
    clock.now_ns = T0 + 399 * MS
    assert due(recorded) == [300]


@pytest.mark.parametrize("stamps", list(Stamps))
def test_on_another_clock_that_is_set_back_it_goes_on(play: Play, stamps: Stamps) -> None:
    clock = Clock(NOW)
    recorded = play(clock, stamps=stamps)
    clock.now_ns = NOW + 150 * MS
    before = taken(recorded)
    clock.now_ns -= 30 * NS
    assert taken(recorded) == []
    clock.now_ns += 150 * MS
    after = taken(recorded)
    assert [reading.first_sample for reading in before + after] == [0, 100, 200]
    assert {reading.lost for reading in before + after} == {0}
    moved = stamps is Stamps.NOW
    assert {reading.run for reading in after} == {int(moved)}
    first_ns = NOW - 30 * NS if moved else T0
    assert [reading.stamp_ns for reading in after] == [first_ns + 100 * MS, first_ns + 200 * MS]


def test_what_it_waits_for_is_said(play: Play) -> None:
    clock = Clock(0)
    recorded = play(clock)
    assert due(recorded) == []
    assert recorded.awaited == "waiting for the clock to begin: it is at 0.000 s"
    clock.now_ns = T0
    assert due(recorded) == []
    assert recorded.awaited == "waiting for the clock to reach 1700000000.099 s: it is at 1700000000.000 s"


def test_a_source_that_was_never_started_has_nothing(path: Path) -> None:
    recorded = RecordedForce(DaqSettings(bag=BagSettings(path=str(path))), Clock(NOW))
    assert recorded.read(0.0) is None
    recorded.close()

# SPDX-License-Identifier: Apache-2.0
"""Pace of a played bag on wall clocks and replay clocks."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from scara_effmass.daq.bag_source import MAX_LEAD_NS, BagSource
from scara_effmass.daq.source import Reading
from scara_effmass.errors import SettingsError
from scara_effmass.settings import BagSettings, DaqSettings
from test.daq.force_bag import MS, START_NS, Clock, force_block, write_blocks

Play = Callable[..., BagSource]

NS = 10**9
NOW = 1_800_000_000 * NS
LAST_MS = 99
"""Time from the first to the last sample of a block [ms]."""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Return a bag with ten blocks of 100 ms."""
    return write_blocks(tmp_path / "run", (force_block(100 * n) for n in range(10)))


@pytest.fixture
def play(path: Path) -> Iterator[Play]:
    """Return a function that plays the bag by a clock."""
    started: list[BagSource] = []

    def start(clock: Callable[[], int], **bag: Any) -> BagSource:  # noqa: ANN401 - of any setting
        started.append(BagSource(DaqSettings(bag=BagSettings(path=str(path), **bag)), clock))
        started[-1].start()
        return started[-1]

    yield start
    for source in started:
        source.close()


def due_readings(source: BagSource) -> list[Reading]:
    """Return the readings that are due."""
    return list(iter(lambda: source.read(0.0), None))


def due_stamps_ms(source: BagSource) -> list[int]:
    """Return the stamps of the due blocks in [ms] after the recorded first one."""
    stamps = []
    while (reading := source.read(0.0)) is not None:
        assert reading.stamp_ns is not None
        stamps.append((reading.stamp_ns - START_NS) // MS)
    return stamps


@pytest.mark.parametrize("rate", [0.5, 1.0, 4.0])
def test_wall_clock_starts_the_bag_and_keeps_its_stamps(play: Play, rate: float) -> None:
    clock = Clock(NOW)
    source = play(clock, rate=rate)
    assert due_stamps_ms(source) == []
    clock.now_ns = NOW + int(LAST_MS * MS / rate) - 1
    assert due_stamps_ms(source) == []
    clock.now_ns = NOW + int(LAST_MS * MS / rate) + 1
    assert due_stamps_ms(source) == [0]
    clock.now_ns = NOW + int((300 + LAST_MS) * MS / rate) + 1
    assert due_stamps_ms(source) == [100, 200, 300]
    assert not source.ended
    clock.now_ns = NOW + int(1000 * MS / rate)
    assert due_stamps_ms(source) == [400, 500, 600, 700, 800, 900]
    assert source.ended


@pytest.mark.parametrize("lead_ns", [0, NS, MAX_LEAD_NS])
def test_replay_clock_releases_blocks_at_their_stamps(play: Play, lead_ns: int) -> None:
    clock = Clock(START_NS - lead_ns)
    source = play(clock)
    assert due_stamps_ms(source) == []
    clock.now_ns = START_NS + 98 * MS
    assert due_stamps_ms(source) == []
    clock.now_ns = START_NS + 199 * MS
    assert due_stamps_ms(source) == [0, 100]
    reading_at = START_NS + 299 * MS
    clock.now_ns = reading_at
    reading = source.read(0.0)
    assert reading is not None
    assert (reading.read_ns, reading.stamp_ns) == (reading_at, START_NS + 200 * MS)


def test_late_start_catches_up_with_the_replay(play: Play) -> None:
    clock = Clock(START_NS + 450 * MS)
    assert due_stamps_ms(play(clock)) == [0, 100, 200, 300]


def test_clock_far_from_the_bag_is_not_a_replay(play: Play) -> None:
    for now_ns in (START_NS - MAX_LEAD_NS - 1, START_NS + 2 * NS):
        clock = Clock(now_ns)
        source = play(clock)
        assert due_stamps_ms(source) == []
        clock.now_ns += LAST_MS * MS
        assert due_stamps_ms(source) == [0]


def test_clock_at_zero_has_not_started(play: Play) -> None:
    clock = Clock(0)
    source = play(clock)
    assert due_stamps_ms(source) == []
    clock.now_ns = START_NS - NS
    assert due_stamps_ms(source) == []
    clock.now_ns = START_NS + 100 * MS
    assert due_stamps_ms(source) == [0]


def test_rate_on_a_replay_clock_is_refused(play: Play) -> None:
    with pytest.raises(SettingsError, match=r"run: bag.rate = 2: must be 1, the bag is replayed on this clock"):
        play(Clock(START_NS), rate=2.0)


@pytest.mark.parametrize("now_ns", [0, START_NS, NOW])
def test_rate_zero_releases_all_blocks_at_once(play: Play, now_ns: int) -> None:
    source = play(Clock(now_ns), rate=0.0)
    assert due_stamps_ms(source) == list(range(0, 1000, 100))
    assert source.ended


def test_stamps_now_move_to_the_start(play: Play) -> None:
    for rate in (0.0, 1.0):
        clock = Clock(START_NS + 300 * MS)  # in the span of the recording, which does not matter then
        source = play(clock, stamps="now", rate=rate)
        clock.now_ns += NS
        assert due_stamps_ms(source) == list(range(300, 1300, 100))


def test_stamps_now_wait_for_the_clock(play: Play) -> None:
    clock = Clock(0)
    source = play(clock, stamps="now", rate=0.0)
    assert due_stamps_ms(source) == []
    assert not source.ended
    clock.now_ns = START_NS
    assert due_stamps_ms(source) == list(range(0, 1000, 100))


def test_read_waits_for_the_clock(play: Play) -> None:
    calls = 0

    def ticking() -> int:
        nonlocal calls
        calls += 1
        return START_NS - NS if calls < 4 else START_NS + LAST_MS * MS

    source = play(ticking)
    reading = source.read(600.0)
    assert reading is not None
    assert (reading.stamp_ns, calls) == (START_NS, 4)


def test_replay_clock_set_back_continues_from_there(play: Play) -> None:
    clock = Clock(START_NS)
    source = play(clock)
    clock.now_ns = START_NS + 450 * MS
    readings = due_readings(source)
    # 50 ms of the next block were due when the clock was set back into the third.
    clock.now_ns = START_NS + 250 * MS
    assert due_readings(source) == []
    assert source.waiting_for == "the clock to reach 1700000000.299 s (now 1700000000.250 s)"
    clock.now_ns = START_NS + NS
    readings += due_readings(source)
    assert [(r.first_sample, r.lost, r.run, (r.stamp_ns or 0) - START_NS) for r in readings] == [
        *((100 * n, 0, 0, 100 * n * MS) for n in range(4)),
        (451, 51, 1, 200 * MS),
        *((251 + 100 * n, 0, 1, 100 * n * MS) for n in range(3, 10)),
    ]
    assert source.ended


def test_replay_in_a_loop_starts_again(play: Play) -> None:
    clock = Clock(START_NS - NS)
    source = play(clock)
    for run in range(3):
        clock.now_ns = START_NS + 899 * MS
        readings = due_readings(source)
        assert {reading.run for reading in readings} == {run}
        assert [(reading.stamp_ns or 0) - START_NS for reading in readings] == [100 * n * MS for n in range(9)]
        # What was due is all there: the gap of one sample says that it does not go on.
        assert [reading.lost for reading in readings] == [1 if run else 0, *[0] * 8]
        assert readings[0].first_sample == 901 * run
        clock.now_ns = START_NS - NS
        assert due_readings(source) == []


def test_small_step_back_is_ignored(play: Play) -> None:
    clock = Clock(START_NS)
    source = play(clock)
    for ms in (250, 150, 199, 299):
        clock.now_ns = START_NS + ms * MS
        assert {reading.run for reading in due_readings(source)} <= {0}
    assert due_stamps_ms(source) == []
    clock.now_ns = START_NS + 399 * MS
    assert due_stamps_ms(source) == [300]


@pytest.mark.parametrize("stamps", ["recorded", "now"])
def test_wall_clock_set_back_continues_without_a_pause(play: Play, stamps: str) -> None:
    clock = Clock(NOW)
    source = play(clock, stamps=stamps)
    clock.now_ns = NOW + 150 * MS
    before = due_readings(source)
    clock.now_ns -= 30 * NS
    assert due_readings(source) == []
    clock.now_ns += 150 * MS
    after = due_readings(source)
    assert [reading.first_sample for reading in before + after] == [0, 100, 200]
    assert {reading.lost for reading in before + after} == {0}
    moved = stamps == "now"
    assert {reading.run for reading in after} == {int(moved)}
    first_ns = NOW - 30 * NS if moved else START_NS
    assert [reading.stamp_ns for reading in after] == [first_ns + 100 * MS, first_ns + 200 * MS]


def test_source_states_the_time_that_it_waits_for(play: Play) -> None:
    clock = Clock(0)
    source = play(clock)
    assert due_stamps_ms(source) == []
    assert source.waiting_for == "the clock to start (now 0.000 s)"
    clock.now_ns = START_NS
    assert due_stamps_ms(source) == []
    assert source.waiting_for == "the clock to reach 1700000000.099 s (now 1700000000.000 s)"


def test_relative_stamps_move_to_the_start(tmp_path: Path) -> None:
    """Imported files without a date have relative stamps."""
    path = write_blocks(tmp_path / "relative", (force_block(100 * n, stamp_ns=n * 100 * MS) for n in range(3)))
    source = BagSource(DaqSettings(bag=BagSettings(path=str(path))), clock := Clock(NOW))
    source.start()
    clock.now_ns += NS
    assert [(reading.stamp_ns or 0) - NOW for reading in due_readings(source)] == [0, 100 * MS, 200 * MS]
    source.close()

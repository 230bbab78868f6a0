from __future__ import annotations

import math
import threading
from collections import deque
from itertools import chain, repeat
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.daq.acquisition import Acquisition, AcquisitionState
from scara_effmass.daq.sim_source import HalfSineSource
from scara_effmass.daq.source import ForceSource, Reading, make_source
from scara_effmass.errors import DaqError, DeviceLostError, DeviceMissingError, OverrunError
from scara_effmass.settings import BagSettings, DaqSettings, ForceSourceKind, Ni9230Settings, Stamps
from test.daq.force_bag import force_block, write_blocks

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from pathlib import Path

    from test.daq.conftest import NiDevice

RATE = 1000.0
BLOCK = 100
NS = 1_000_000_000
SETTINGS = DaqSettings(backlog=0.5, ni9230=Ni9230Settings(retry_time=0.001))
WAIT_S = 120.0


class Scripted(ForceSource):
    """A source that does one step of its script per read: samples of a count, a fault, or a call while it reads.

    Its steady clock goes on with its samples. At the end of the script it waits to be closed, or has ended.
    """

    simulated = True
    description = "a script"
    requested_rate = RATE
    limit = math.inf
    filter_delay = 0.0

    def __init__(
        self,
        script: Iterable[object],
        *,
        starts: Iterable[Exception | None] = (),
        ends: bool = True,
        stamped: bool = False,
    ) -> None:
        self.channels: tuple[str, ...] = ("a", "b")
        self.sample_rate = RATE
        self.awaited_time = ""
        self.scripted_losses: tuple[str, ...] = ()
        self.script = deque(script)
        self.starts = deque(starts)
        self.calls: list[str] = []
        self.steady_ns = 5 * NS
        self.has_ended = False
        self.idle = threading.Event()
        self._ends, self._stamped = ends, stamped
        self._closed = threading.Event()
        self._next = 0

    @property
    def ended(self) -> bool:
        return self.has_ended

    @property
    def losses(self) -> tuple[str, ...]:
        return self.scripted_losses

    @property
    def waiting_for(self) -> str:
        return self.awaited_time

    def start(self) -> None:
        self.calls.append("start")
        outcome = self.starts.popleft() if self.starts else None
        if outcome is not None:
            raise outcome
        self._next = 0
        self._closed.clear()

    def read(self, timeout_s: float) -> Reading | None:
        assert 0.0 < timeout_s < 10.0
        while self.script:
            step = self.script.popleft()
            if isinstance(step, Exception):
                raise step
            if callable(step):
                step()
                continue
            if step is None:
                return None
            assert isinstance(step, tuple)
            lost, count = step
            return self._reading(lost, count)
        self.has_ended = self._ends
        self.idle.set()
        if not self._ends:
            self._closed.wait(WAIT_S)
        return None

    def close(self) -> None:
        self.calls.append("close")
        self._closed.set()

    def wait(self, samples: int) -> Callable[[], None]:
        """Return a step that lets the time of so many samples pass."""

        def step() -> None:
            self.steady_ns += round(samples / RATE * NS)

        return step

    def _reading(self, lost: int, count: int) -> Reading:
        first = self._next + lost
        self._next = first + count
        self.steady_ns += round((lost + count) / RATE * NS)
        samples = np.arange(first, self._next, dtype=np.float64) + np.array([[0.0], [0.5]])
        return Reading(first, samples, lost, 42, stamp_ns=7 if self._stamped else None)


class Bell:
    """What a node would do to wake its executor; counts, and can be waited for."""

    def __init__(self) -> None:
        self.rung = threading.Condition()
        self.count = 0

    def __call__(self) -> None:
        with self.rung:
            self.count += 1
            self.rung.notify_all()

    def until(self, condition: Callable[[], bool]) -> None:
        with self.rung:
            assert self.rung.wait_for(condition, WAIT_S)


def acquisition(source: Scripted, settings: DaqSettings = SETTINGS) -> tuple[Acquisition, Bell]:
    bell = Bell()
    made = Acquisition(source, settings, bell, lambda: source.steady_ns)
    return made, bell


def over(made: Acquisition) -> Callable[[], bool]:
    return lambda: made.statistics().state not in {AcquisitionState.RUNNING, AcquisitionState.WAITING}


def all_of(source: Scripted, settings: DaqSettings = SETTINGS) -> tuple[Acquisition, list[Reading]]:
    """Run a script to its end; nothing is taken before."""
    made, bell = acquisition(source, settings)
    made.start()
    bell.until(over(made))
    readings = made.take()
    made.stop()
    return made, readings


def numbers(readings: Iterable[Reading]) -> list[tuple[int, int, int]]:
    return [(reading.first_sample, reading.samples.shape[1], reading.lost) for reading in readings]


def test_readings_come_through_as_they_are() -> None:
    source = Scripted([(0, BLOCK), (0, BLOCK), (7, 50)])
    made, readings = all_of(source)
    assert numbers(readings) == [(0, 100, 0), (100, 100, 0), (207, 50, 7)]
    assert np.array_equal(readings[1].samples[1], np.arange(100, 200) + 0.5)
    assert {(reading.read_ns, reading.run, reading.stamp_ns) for reading in readings} == {(42, 0, None)}
    assert made.ended
    assert made.failure is None
    statistics = made.statistics()
    assert statistics.state is AcquisitionState.ENDED
    assert (statistics.samples_read, statistics.samples_lost, statistics.samples_dropped) == (250, 7, 0)
    assert source.calls[0] == "start"
    assert source.calls[-1] == "close"


def test_it_has_ended_only_when_all_has_been_taken() -> None:
    made, bell = acquisition(Scripted([(0, BLOCK)]))
    made.start()
    bell.until(over(made))
    before, readings = made.ended, made.take()
    assert (before, len(readings), made.ended) == (False, 1, True)
    assert made.take() == []
    made.stop()


def test_each_reading_rings_the_bell() -> None:
    gate = threading.Event()
    made, bell = acquisition(Scripted([(0, BLOCK), lambda: gate.wait(WAIT_S), (0, BLOCK)], ends=False))
    made.start()
    bell.until(lambda: bell.count == 1)
    assert len(made.take()) == 1
    gate.set()
    bell.until(lambda: bell.count == 2)
    assert len(made.take()) == 1
    made.stop()


def test_a_slow_consumer_costs_samples_which_are_counted() -> None:
    # Half a second of 1 kS/s is room for five readings.
    gate, full = threading.Event(), threading.Event()
    source = Scripted([(0, BLOCK)] * 8 + [(3, BLOCK), full.set, lambda: gate.wait(WAIT_S), (0, BLOCK), (0, BLOCK)])
    made, bell = acquisition(source)
    made.start()
    assert full.wait(WAIT_S)
    assert made.statistics().samples_waiting == 500
    before = made.take()
    gate.set()
    bell.until(over(made))
    after = made.take()
    assert numbers(before) == [(number * 100, 100, 0) for number in range(5)]
    assert numbers(after) == [(903, 100, 403), (1003, 100, 0)]
    statistics = made.statistics()
    assert (statistics.samples_read, statistics.samples_dropped, statistics.readings_dropped) == (1100, 400, 4)
    assert statistics.samples_lost == 3
    assert statistics.samples_waiting == 0
    made.stop()


def test_a_reading_longer_than_the_backlog_still_finds_room_when_nothing_waits() -> None:
    _, readings = all_of(Scripted([(0, 900), (0, 10)]))
    assert numbers(readings) == [(0, 900, 0)]


def test_a_recording_played_as_fast_as_possible_waits_for_room() -> None:
    source = Scripted([(0, BLOCK)] * 50, stamped=True)
    source.is_unpaced = True
    made, bell = acquisition(source)
    made.start()
    taken: list[Reading] = []
    while not made.ended:
        bell.until(lambda: made.statistics().samples_waiting > 0 or made.ended)
        assert made.statistics().samples_waiting <= 500
        taken += made.take()
    assert numbers(taken) == [(number * 100, 100, 0) for number in range(50)]
    made.stop()


def test_waiting_for_room_ends_with_stop() -> None:
    source = Scripted([(0, BLOCK)] * 50)
    source.is_unpaced = True
    made, bell = acquisition(source)
    made.start()
    bell.until(lambda: made.statistics().samples_waiting == 500)
    made.stop()
    assert made.statistics().state is AcquisitionState.STOPPED


@pytest.mark.parametrize("fault", [DeviceLostError("unplugged"), OverrunError("overrun")])
def test_a_device_that_went_and_came_back_leaves_a_gap_of_the_right_size(fault: DaqError) -> None:
    source = Scripted([(0, BLOCK), (0, BLOCK), fault], ends=False)
    source.script.extend([source.wait(2345), (0, BLOCK), (5, BLOCK)])
    made, bell = acquisition(source)
    made.start()
    assert source.idle.wait(WAIT_S)
    readings = made.take()
    assert numbers(readings) == [(0, 100, 0), (100, 100, 0), (2545, 100, 2345), (2650, 100, 5)]
    assert [reading.run for reading in readings] == [0, 0, 1, 1]
    statistics = made.statistics()
    assert (statistics.reconnects, statistics.samples_lost) == (1, 2350)
    assert statistics.state is AcquisitionState.RUNNING
    made.stop()
    assert bell.count >= 5


def test_what_the_new_run_lost_at_its_start_is_not_counted_twice() -> None:
    source = Scripted([(0, BLOCK), DeviceLostError("unplugged")])
    source.script.extend([source.wait(1000), (20, BLOCK)])
    _, readings = all_of(source)
    assert numbers(readings) == [(0, 100, 0), (1120, 100, 1020)]


def test_the_gap_counts_from_when_samples_were_due_not_from_a_late_read() -> None:
    source = Scripted([(0, BLOCK)])
    # The last read came 300 samples late; then the device was lost, and is back at once.
    source.script.extend([source.wait(300), (0, BLOCK), OverrunError("overrun"), (0, BLOCK)])
    _, readings = all_of(source)
    assert numbers(readings)[-1] == (500, 100, 300)


def test_it_tries_until_the_device_is_back_and_says_why_it_waits() -> None:
    gate = threading.Event()
    missing = DeviceMissingError("no such device")
    source = Scripted([(0, BLOCK), DeviceLostError("unplugged")], starts=[None, missing, missing, missing], ends=False)
    source.script.extend([source.wait(5000), lambda: gate.wait(WAIT_S), (0, BLOCK)])
    made, bell = acquisition(source)
    made.start()
    bell.until(lambda: made.statistics().reason == "no such device")
    assert made.statistics().state is AcquisitionState.WAITING
    gate.set()
    bell.until(lambda: made.statistics().samples_waiting == 200)
    statistics = made.statistics()
    assert (statistics.state, statistics.reason, statistics.reconnects) == (AcquisitionState.RUNNING, "", 1)
    assert numbers(made.take()) == [(0, 100, 0), (5100, 100, 5000)]
    made.stop()
    assert source.calls[:9] == ["start", *["close", "start"] * 4]


def test_a_device_lost_again_before_it_gave_anything_makes_one_gap() -> None:
    source = Scripted([(0, BLOCK), DeviceLostError("unplugged")])
    source.script.extend([source.wait(100), OverrunError("again"), source.wait(200), OverrunError("again")])
    source.script.extend([source.wait(300), (0, BLOCK)])
    made, readings = all_of(source)
    assert numbers(readings) == [(0, 100, 0), (700, 100, 600)]
    assert [reading.run for reading in readings] == [0, 3]
    assert made.statistics().reconnects == 3


def test_a_device_lost_before_its_first_sample_loses_those_since_the_start() -> None:
    source = Scripted([])
    source.script.extend([source.wait(50), DeviceLostError("unplugged"), source.wait(100), (0, BLOCK)])
    _, readings = all_of(source)
    assert numbers(readings) == [(150, 100, 150)]


def test_stopping_ends_the_wait_for_a_lost_device() -> None:
    source = Scripted([(0, BLOCK), DeviceLostError("unplugged")], starts=[None, *[DeviceMissingError("gone")] * 3])
    settings = SETTINGS.model_copy(update={"ni9230": Ni9230Settings(retry_time=60.0)})
    made, bell = acquisition(source, settings)
    made.start()
    bell.until(lambda: made.statistics().reason == "gone")
    made.stop()
    assert made.statistics().state is AcquisitionState.STOPPED
    assert made.failure is None


def test_another_device_in_its_place_is_refused() -> None:
    source = Scripted([(0, BLOCK), DeviceLostError("unplugged")])
    source.script.append((0, BLOCK))
    made, bell = acquisition(source)
    starts = source.start

    def start_changed() -> None:
        starts()
        source.sample_rate = 2000.0 if len(source.calls) > 1 else RATE

    source.start = start_changed  # type: ignore[method-assign]
    made.start()
    bell.until(over(made))
    assert isinstance(made.failure, DeviceMissingError)
    assert "2000.0" in str(made.failure)
    assert "1000.0" in str(made.failure)
    made.stop()


@pytest.mark.parametrize("fault", [DaqError("current source broken"), ZeroDivisionError("a bug")])
def test_any_other_error_ends_it_and_is_kept(fault: Exception) -> None:
    source = Scripted([(0, BLOCK), fault, (0, BLOCK)])
    made, bell = acquisition(source)
    made.start()
    bell.until(over(made))
    assert source.calls == ["start", "close"]
    assert made.failure is fault
    assert numbers(made.take()) == [(0, 100, 0)]
    assert not made.ended
    assert made.statistics().state is AcquisitionState.FAILED
    assert made.statistics().reason == str(fault)
    made.stop()


def test_an_error_without_words_is_named() -> None:
    made, _ = all_of(Scripted([KeyError()]))
    assert made.statistics().reason == "KeyError"


def test_an_error_of_the_consumers_own_callback_is_not_swallowed() -> None:
    source = Scripted([(0, BLOCK)])
    heard = threading.Event()

    def notify() -> None:
        if heard.is_set():
            return
        heard.set()
        raise ValueError("no")

    made = Acquisition(source, SETTINGS, notify, lambda: source.steady_ns)
    made.start()
    assert heard.wait(WAIT_S)
    made.stop()
    assert isinstance(made.failure, ValueError)


@pytest.mark.parametrize(("awaited_time", "cause"), [("", ""), ("the clock", ": waiting for the clock")])
def test_missing_samples_make_it_wait(awaited_time: str, cause: str) -> None:
    gate = threading.Event()
    source = Scripted([(0, BLOCK), None, lambda: gate.wait(WAIT_S), (0, BLOCK)])
    source.awaited_time = awaited_time
    made, bell = acquisition(source)
    made.start()
    bell.until(lambda: made.statistics().state is AcquisitionState.WAITING)
    assert made.statistics().reason == f"no samples within 1.2 s{cause}"
    gate.set()
    bell.until(over(made))
    assert numbers(made.take()) == [(0, 100, 0), (100, 100, 0)]
    made.stop()


def test_end_of_a_damaged_recording_states_the_losses() -> None:
    source = Scripted([(0, BLOCK)], stamped=True)
    source.scripted_losses = ("a.mcap: is cut off", "b.mcap: is cut off")
    made, _ = all_of(source)
    statistics = made.statistics()
    assert (statistics.state, statistics.reason) == (AcquisitionState.ENDED, "a.mcap: is cut off; b.mcap: is cut off")
    assert made.failure is None


def test_runs_of_a_bag_whose_clock_was_set_back_are_passed_on(tmp_path: Path) -> None:
    path = write_blocks(tmp_path / "run", (force_block(500 * n, 500) for n in range(4)))
    settings = DaqSettings(source=ForceSourceKind.BAG, backlog=9.0, bag=BagSettings(path=str(path), stamps=Stamps.NOW))
    times = chain([500 * NS, 501 * NS, 501 * NS, 400 * NS], repeat(410 * NS))
    made = Acquisition(make_source(settings, lambda: next(times)), settings, bell := Bell())
    made.start()
    bell.until(over(made))
    readings = made.take()
    made.stop()
    assert numbers(readings) == [(500 * n, 500, 0) for n in range(4)]
    assert [reading.run for reading in readings] == [0, 0, 1, 1]
    assert (made.statistics().reconnects, made.statistics().samples_lost) == (0, 0)


def test_stopping_ends_a_read_that_waits_and_may_be_repeated() -> None:
    source = Scripted([(0, BLOCK)], ends=False)
    made, _ = acquisition(source)
    made.start()
    assert source.idle.wait(WAIT_S)
    made.stop()
    made.stop()
    assert made.statistics().state is AcquisitionState.STOPPED
    assert not made.ended
    assert numbers(made.take()) == [(0, 100, 0)]
    assert not any(thread.name == "acquisition" for thread in threading.enumerate())


def test_an_error_from_closing_under_a_read_is_none() -> None:
    source = Scripted([], ends=False)
    read = source.read

    def broken(timeout_s: float) -> Reading | None:
        read(timeout_s)
        raise DaqError("the task was cleared")

    source.read = broken  # type: ignore[method-assign]
    made, _ = acquisition(source)
    made.start()
    assert source.idle.wait(WAIT_S)
    made.stop()
    assert made.failure is None
    assert made.statistics().state is AcquisitionState.STOPPED


def test_stopping_what_never_started_closes_it() -> None:
    source = Scripted([])
    made, _ = acquisition(source)
    assert made.statistics().state is AcquisitionState.IDLE
    made.stop()
    assert source.calls == ["close"]


def test_a_source_that_does_not_start_tells_the_caller() -> None:
    made, _ = acquisition(Scripted([], starts=[DeviceMissingError("no such device")]))
    with pytest.raises(DeviceMissingError, match="no such device"):
        made.start()
    made.stop()


def test_it_starts_once() -> None:
    made, _ = acquisition(Scripted([]))
    made.start()
    with pytest.raises(RuntimeError, match="only once"):
        made.start()
    made.stop()


def test_late_reads_show_in_the_statistics() -> None:
    source = Scripted([(0, BLOCK), (0, BLOCK)])
    late = source.wait(40)

    def early() -> None:
        source.steady_ns -= round(40 / RATE * NS)

    source.script.extend([late, (0, BLOCK), early, (0, BLOCK)])
    made, _ = all_of(source)
    statistics = made.statistics()
    assert statistics.latency_p50_s == pytest.approx(0.0, abs=1e-6)
    assert statistics.latency_max_s == pytest.approx(0.04, abs=1e-6)


def test_reading_a_recording_has_no_latency() -> None:
    made, _ = all_of(Scripted([(0, BLOCK)], stamped=True))
    assert math.isnan(made.statistics().latency_max_s)


def test_the_simulated_converter_is_read_in_real_time() -> None:
    settings = DaqSettings(source=ForceSourceKind.SIM, block_time=0.005, backlog=600.0)
    bell = Bell()
    made = Acquisition(HalfSineSource(settings, lambda: 42), settings, bell)
    made.start()
    bell.until(lambda: made.statistics().samples_read >= 20 * 64)
    made.stop()
    readings = made.take()
    assert [reading.first_sample for reading in readings] == [number * 64 for number in range(len(readings))]
    assert {reading.lost for reading in readings} == {0}
    statistics = made.statistics()
    assert (statistics.samples_lost, statistics.samples_dropped) == (0, 0)
    assert 0.0 <= statistics.latency_p50_s <= statistics.latency_max_s < WAIT_S


def test_unplugging_and_plugging_in_the_converter_is_survived(ni_device: NiDevice) -> None:
    settings = DaqSettings(ni9230=Ni9230Settings(retry_time=0.001))
    bell = Bell()
    made = Acquisition(make_source(settings, ni_device.clock), settings, bell, ni_device.clock)
    made.start()
    bell.until(lambda: made.statistics().samples_read > 0)
    ni_device.unplug(forget=True)
    bell.until(lambda: made.statistics().state is AcquisitionState.WAITING)
    before = made.take()
    ni_device.advance(3.0)
    ni_device.plug()
    bell.until(lambda: bool(made.statistics().reconnects) and made.statistics().samples_waiting > 0)
    made.stop()
    assert made.failure is None
    after = made.take()
    assert {reading.run for reading in before} == {0}
    assert {reading.run for reading in after} == {1}
    assert made.statistics().samples_lost == pytest.approx(3.0 * 12_800.0, abs=1.0)
    assert after[0].lost >= made.statistics().samples_lost


readings_and_faults = st.one_of(
    st.tuples(st.just("samples"), st.integers(0, 200), st.integers(1, 300)),
    st.tuples(st.just("away"), st.integers(0, 2000), st.just(0)),
    st.just(("take", 0, 0)),
)


@given(st.lists(readings_and_faults, max_size=60))
def test_every_number_is_delivered_or_counted_as_lost(schedule: list[tuple[str, int, int]]) -> None:
    source = Scripted([])
    made, bell = acquisition(source)
    taken: list[Reading] = []
    # What is dropped or lost at the very end is told by no reading, so the last one finds room.
    schedule = [*schedule, ("take", 0, 0), ("samples", 0, 1)]
    for what, missing, count in schedule:
        if what == "take":
            # Taken from within a read: the schedule decides when, not the scheduler.
            source.script.append(lambda: taken.extend(made.take()))
        elif what == "away":
            source.script.extend([DeviceLostError("unplugged"), source.wait(missing)])
        else:
            source.script.append((missing, count))
    made.start()
    bell.until(over(made))
    taken += made.take()
    made.stop()
    assert made.failure is None
    end, run = 0, 0
    for reading in taken:
        assert reading.first_sample == end + reading.lost
        assert reading.run >= run
        end, run = reading.first_sample + reading.samples.shape[1], reading.run
    delivered, lost = (sum(column) for column in zip(*((r.samples.shape[1], r.lost) for r in taken), strict=True))
    total = sum(missing + count for _, missing, count in schedule)
    assert delivered + lost == end == total
    statistics = made.statistics()
    assert statistics.samples_read + statistics.samples_lost == total
    assert statistics.samples_read - statistics.samples_dropped == delivered
    assert statistics.reconnects == sum(what == "away" for what, _, _ in schedule)

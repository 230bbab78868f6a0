# SPDX-License-Identifier: Apache-2.0
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from itertools import chain, repeat
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.daq import make_source
from scara_effmass.daq.acquisition import Acquisition, AcquisitionState
from scara_effmass.daq.sim_source import HalfSineSource
from scara_effmass.daq.source import ForceSource, Reading
from scara_effmass.errors import DaqError, DeviceLostError, DeviceMissingError, OverrunError
from scara_effmass.settings import BagSettings, DaqSettings, Ni9230Settings
from test.daq.conftest import NiDevice
from test.daq.force_bag import force_block, write_blocks

RATE = 1000.0
BLOCK = 100
NS = 1_000_000_000
SETTINGS = DaqSettings(backlog=0.5, ni9230=Ni9230Settings(retry_time=0.001))
WAIT_S = 120.0


class Scripted(ForceSource):
    """Source with one step per read: (lost, count) samples, an error, a call, or None for a timeout.

    Samples advance its steady clock. After the last step it ends, or waits for `close`.
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
        self.waiting_for_text = ""
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
        return self.waiting_for_text

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
        """Return a step that advances the clock by the time of `samples`."""

        def step() -> None:
            self.steady_ns += round(samples / RATE * NS)

        return step

    def _reading(self, lost: int, count: int) -> Reading:
        first = self._next + lost
        self._next = first + count
        self.steady_ns += round((lost + count) / RATE * NS)
        samples = np.arange(first, self._next, dtype=np.float64) + np.array([[0.0], [0.5]])
        return Reading(first, samples, lost, 42, stamp_ns=7 if self._stamped else None)


class Notifications:
    """Counts the calls of `notify`."""

    def __init__(self) -> None:
        self.changed = threading.Condition()
        self.count = 0

    def __call__(self) -> None:
        with self.changed:
            self.count += 1
            self.changed.notify_all()

    def until(self, condition: Callable[[], bool]) -> None:
        with self.changed:
            assert self.changed.wait_for(condition, WAIT_S)


def make_acquisition(source: Scripted, settings: DaqSettings = SETTINGS) -> tuple[Acquisition, Notifications]:
    notifications = Notifications()
    acquisition = Acquisition(source, settings, notifications, lambda: source.steady_ns)
    return acquisition, notifications


@contextmanager
def running(source: Scripted, settings: DaqSettings = SETTINGS) -> Iterator[tuple[Acquisition, Notifications]]:
    """Start an acquisition and stop it at the end."""
    acquisition, notifications = make_acquisition(source, settings)
    acquisition.start()
    try:
        yield acquisition, notifications
    finally:
        acquisition.stop()


def is_over(acquisition: Acquisition) -> Callable[[], bool]:
    return lambda: acquisition.statistics().state not in {AcquisitionState.RUNNING, AcquisitionState.WAITING}


def run_script(source: Scripted, settings: DaqSettings = SETTINGS) -> tuple[Acquisition, list[Reading]]:
    """Run a script to its end, then take its readings."""
    with running(source, settings) as (acquisition, notifications):
        notifications.until(is_over(acquisition))
        readings = acquisition.take()
    return acquisition, readings


def numbers(readings: Iterable[Reading]) -> list[tuple[int, int, int]]:
    return [(reading.first_sample, reading.samples.shape[1], reading.lost) for reading in readings]


def test_readings_are_passed_on_unchanged() -> None:
    source = Scripted([(0, BLOCK), (0, BLOCK), (7, 50)])
    acquisition, readings = run_script(source)
    assert numbers(readings) == [(0, 100, 0), (100, 100, 0), (207, 50, 7)]
    assert np.array_equal(readings[1].samples[1], np.arange(100, 200) + 0.5)
    assert {(reading.read_ns, reading.run, reading.stamp_ns) for reading in readings} == {(42, 0, None)}
    assert acquisition.ended
    assert acquisition.failure is None
    statistics = acquisition.statistics()
    assert statistics.state is AcquisitionState.ENDED
    assert (statistics.samples_read, statistics.samples_lost, statistics.samples_dropped) == (250, 7, 0)
    assert source.calls[0] == "start"
    assert source.calls[-1] == "close"


def test_acquisition_ends_after_the_last_reading_is_taken() -> None:
    with running(Scripted([(0, BLOCK)])) as (acquisition, notifications):
        notifications.until(is_over(acquisition))
        before, readings = acquisition.ended, acquisition.take()
        assert (before, len(readings), acquisition.ended) == (False, 1, True)
        assert acquisition.take() == []


def test_each_reading_notifies() -> None:
    gate = threading.Event()
    acquisition, notifications = make_acquisition(
        Scripted([(0, BLOCK), lambda: gate.wait(WAIT_S), (0, BLOCK)], ends=False)
    )
    acquisition.start()
    notifications.until(lambda: notifications.count == 1)
    assert len(acquisition.take()) == 1
    gate.set()
    notifications.until(lambda: notifications.count == 2)
    assert len(acquisition.take()) == 1
    acquisition.stop()


def test_readings_beyond_the_backlog_are_dropped_and_counted() -> None:
    # The backlog of 0.5 s holds five readings.
    gate, full = threading.Event(), threading.Event()
    source = Scripted([(0, BLOCK)] * 8 + [(3, BLOCK), full.set, lambda: gate.wait(WAIT_S), (0, BLOCK), (0, BLOCK)])
    with running(source) as (acquisition, notifications):
        assert full.wait(WAIT_S)
        assert acquisition.statistics().samples_waiting == 500
        before = acquisition.take()
        gate.set()
        notifications.until(is_over(acquisition))
        after = acquisition.take()
        assert numbers(before) == [(number * 100, 100, 0) for number in range(5)]
        assert numbers(after) == [(903, 100, 403), (1003, 100, 0)]
        statistics = acquisition.statistics()
        assert (statistics.samples_read, statistics.samples_dropped) == (1100, 400)
        assert statistics.samples_lost == 3
        assert statistics.samples_waiting == 0


def test_empty_queue_accepts_a_reading_longer_than_the_backlog() -> None:
    _, readings = run_script(Scripted([(0, 900), (0, 10)]))
    assert numbers(readings) == [(0, 900, 0)]


def test_unpaced_source_waits_instead_of_dropping() -> None:
    source = Scripted([(0, BLOCK)] * 50, stamped=True)
    source.is_unpaced = True
    with running(source) as (acquisition, notifications):
        taken: list[Reading] = []
        while not acquisition.ended:
            notifications.until(lambda: acquisition.statistics().samples_waiting > 0 or acquisition.ended)
            assert acquisition.statistics().samples_waiting <= 500
            taken += acquisition.take()
        assert numbers(taken) == [(number * 100, 100, 0) for number in range(50)]


def test_stop_ends_the_wait_for_space() -> None:
    source = Scripted([(0, BLOCK)] * 50)
    source.is_unpaced = True
    with running(source) as (acquisition, notifications):
        notifications.until(lambda: acquisition.statistics().samples_waiting == 500)
        acquisition.stop()
        assert acquisition.statistics().state is AcquisitionState.STOPPED


@pytest.mark.parametrize("fault", [DeviceLostError("unplugged"), OverrunError("overrun")])
def test_reconnected_device_counts_the_gap(fault: DaqError) -> None:
    source = Scripted([(0, BLOCK), (0, BLOCK), fault], ends=False)
    source.script.extend([source.wait(2345), (0, BLOCK), (5, BLOCK)])
    with running(source) as (acquisition, notifications):
        assert source.idle.wait(WAIT_S)
        readings = acquisition.take()
        assert numbers(readings) == [(0, 100, 0), (100, 100, 0), (2545, 100, 2345), (2650, 100, 5)]
        assert [reading.run for reading in readings] == [0, 0, 1, 1]
        statistics = acquisition.statistics()
        assert (statistics.reconnects, statistics.samples_lost) == (1, 2350)
        assert statistics.state is AcquisitionState.RUNNING
        acquisition.stop()
        assert notifications.count >= 5


def test_gap_starts_when_the_next_sample_was_due() -> None:
    source = Scripted([(0, BLOCK)])
    # The last read is 300 samples late; then the device is lost and back at once.
    source.script.extend([source.wait(300), (0, BLOCK), OverrunError("overrun"), (0, BLOCK)])
    _, readings = run_script(source)
    assert numbers(readings)[-1] == (500, 100, 300)


def test_gap_counts_the_time_of_a_suspend_that_the_last_read_follows() -> None:
    # The computer sleeps for a minute; then come the samples from before, and the device is gone.
    source = Scripted([(0, BLOCK)])
    source.script.extend([source.wait(60_000), (0, BLOCK), DeviceLostError("unplugged"), (0, BLOCK)])
    _, readings = run_script(source)
    assert numbers(readings)[-1] == (60_200, 100, 60_000)


def test_steady_time_goes_on_during_a_suspend(monkeypatch: pytest.MonkeyPatch) -> None:
    suspended = [0]
    source = Scripted([(0, BLOCK), DeviceLostError("unplugged")])
    source.script.extend([lambda: suspended.append(60 * NS), (0, BLOCK)])
    monkeypatch.setattr(time, "monotonic_ns", lambda: source.steady_ns)
    monkeypatch.setattr(time, "clock_gettime_ns", lambda _: source.steady_ns + sum(suspended))
    notifications = Notifications()
    acquisition = Acquisition(source, SETTINGS, notifications)
    acquisition.start()
    notifications.until(is_over(acquisition))
    assert numbers(acquisition.take())[-1] == (60_100, 100, 60_000)
    acquisition.stop()


def test_gap_lasts_from_the_last_sample_of_a_lost_device_to_the_next_one() -> None:
    gate = threading.Event()
    missing = DeviceMissingError("no such device")
    source = Scripted([(0, BLOCK), DeviceLostError("unplugged")], starts=[None, missing, missing], ends=False)
    source.script.extend([lambda: gate.wait(WAIT_S), (0, BLOCK)])
    with running(source) as (acquisition, notifications):
        notifications.until(lambda: acquisition.statistics().reason == "no such device")
        assert acquisition.gap_s == 0.0
        source.wait(3000)()
        assert acquisition.gap_s == 3.0
        gate.set()
        notifications.until(lambda: acquisition.statistics().samples_waiting == 200)
        assert acquisition.gap_s == 0.0


def test_restart_is_repeated_and_its_error_stated() -> None:
    gate = threading.Event()
    missing = DeviceMissingError("no such device")
    source = Scripted([(0, BLOCK), DeviceLostError("unplugged")], starts=[None, missing, missing, missing], ends=False)
    source.script.extend([source.wait(5000), lambda: gate.wait(WAIT_S), (0, BLOCK)])
    with running(source) as (acquisition, notifications):
        notifications.until(lambda: acquisition.statistics().reason == "no such device")
        assert acquisition.statistics().state is AcquisitionState.WAITING
        gate.set()
        notifications.until(lambda: acquisition.statistics().samples_waiting == 200)
        statistics = acquisition.statistics()
        assert (statistics.state, statistics.reason, statistics.reconnects) == (AcquisitionState.RUNNING, "", 1)
        assert numbers(acquisition.take()) == [(0, 100, 0), (5100, 100, 5000)]
        acquisition.stop()
        assert source.calls[:9] == ["start", *["close", "start"] * 4]


def test_device_lost_again_before_a_sample_gives_one_gap() -> None:
    source = Scripted([(0, BLOCK), DeviceLostError("unplugged")])
    source.script.extend([source.wait(100), OverrunError("again"), source.wait(200), OverrunError("again")])
    source.script.extend([source.wait(300), (0, BLOCK)])
    acquisition, readings = run_script(source)
    assert numbers(readings) == [(0, 100, 0), (700, 100, 600)]
    assert [reading.run for reading in readings] == [0, 3]
    assert acquisition.statistics().reconnects == 3


def test_stop_ends_the_wait_for_a_lost_device() -> None:
    source = Scripted([(0, BLOCK), DeviceLostError("unplugged")], starts=[None, *[DeviceMissingError("gone")] * 3])
    settings = SETTINGS.model_copy(update={"ni9230": Ni9230Settings(retry_time=60.0)})
    with running(source, settings) as (acquisition, notifications):
        notifications.until(lambda: acquisition.statistics().reason == "gone")
        acquisition.stop()
        assert acquisition.statistics().state is AcquisitionState.STOPPED
        assert acquisition.failure is None


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("sample_rate", 2000.0, "a script (2000 Hz, up to inf N): must be a script (1000 Hz, up to inf N)"),
        ("limit", 500.0, "a script (1000 Hz, up to 500 N): must be a script (1000 Hz, up to inf N)"),
        ("description", "NI 9234", "NI 9234 (1000 Hz, up to inf N): must be a script (1000 Hz, up to inf N)"),
    ],
)
def test_another_device_in_the_place_of_the_first_is_refused(name: str, value: object, text: str) -> None:
    source = Scripted([(0, BLOCK), DeviceLostError("unplugged")])
    source.script.append((0, BLOCK))
    acquisition, notifications = make_acquisition(source)
    starts = source.start

    def start_changed() -> None:
        starts()
        if len(source.calls) > 1:
            setattr(source, name, value)

    source.start = start_changed  # type: ignore[method-assign]
    acquisition.start()
    notifications.until(is_over(acquisition))
    assert isinstance(acquisition.failure, DeviceMissingError)
    assert str(acquisition.failure) == f"the device came back as {text}"
    acquisition.stop()


@pytest.mark.parametrize("last", [None, DaqError("no current")])
def test_driver_that_hangs_in_a_read_or_after_an_error_is_stated(last: DaqError | None) -> None:
    hangs, answers = threading.Event(), threading.Event()
    source = Scripted([(0, BLOCK)], ends=False)

    def hang() -> None:
        hangs.set()
        answers.wait(WAIT_S)

    source.script.extend([hang, (0, BLOCK)] if last is None else [last])
    close = source.close

    def hang_and_close() -> None:
        hang()
        close()

    if last is not None:
        source.close = hang_and_close  # type: ignore[method-assign]
    with running(source) as (acquisition, notifications):
        assert hangs.wait(WAIT_S)
        before = acquisition.statistics()
        source.steady_ns += 3 * NS
        during = acquisition.statistics()
        answers.set()
        notifications.until(lambda: acquisition.statistics().state is not AcquisitionState.WAITING)
        after = acquisition.statistics()
    assert (before.state, before.reason) == (AcquisitionState.RUNNING, "")
    assert (during.state, during.samples_read) == (AcquisitionState.WAITING, 100)
    assert during.reason == "the source has not answered for more than 2.4 s"
    assert after.state is (AcquisitionState.FAILED if last else AcquisitionState.RUNNING)


@pytest.mark.parametrize("fault", [DaqError("current source broken"), ZeroDivisionError("a bug"), KeyError()])
def test_other_error_is_the_failure(fault: Exception) -> None:
    source = Scripted([(0, BLOCK), fault, (0, BLOCK)])
    with running(source) as (acquisition, notifications):
        notifications.until(is_over(acquisition))
        assert source.calls == ["start", "close"]
        assert acquisition.failure is fault
        assert numbers(acquisition.take()) == [(0, 100, 0)]
        assert not acquisition.ended
        assert acquisition.statistics().state is AcquisitionState.FAILED
        assert acquisition.statistics().reason == (str(fault) or "KeyError")


def test_error_of_notify_is_the_failure() -> None:
    source = Scripted([(0, BLOCK)])
    notified = threading.Event()

    def notify() -> None:
        if notified.is_set():
            return
        notified.set()
        raise ValueError("no")

    acquisition = Acquisition(source, SETTINGS, notify, lambda: source.steady_ns)
    acquisition.start()
    assert notified.wait(WAIT_S)
    acquisition.stop()
    assert isinstance(acquisition.failure, ValueError)


@pytest.mark.parametrize(("waiting_for_text", "cause"), [("", ""), ("the clock", ": waiting for the clock")])
def test_missing_samples_give_the_state_waiting(waiting_for_text: str, cause: str) -> None:
    gate = threading.Event()
    source = Scripted([(0, BLOCK), None, lambda: gate.wait(WAIT_S), (0, BLOCK)])
    source.waiting_for_text = waiting_for_text
    with running(source) as (acquisition, notifications):
        notifications.until(lambda: acquisition.statistics().state is AcquisitionState.WAITING)
        assert acquisition.statistics().reason == f"no samples within 1.2 s{cause}"
        gate.set()
        notifications.until(is_over(acquisition))
        assert numbers(acquisition.take()) == [(0, 100, 0), (100, 100, 0)]


def test_end_of_a_damaged_recording_states_the_losses() -> None:
    source = Scripted([(0, BLOCK)], stamped=True)
    source.scripted_losses = ("a.mcap: is cut off", "b.mcap: is cut off")
    acquisition, _ = run_script(source)
    statistics = acquisition.statistics()
    assert (statistics.state, statistics.reason) == (AcquisitionState.ENDED, "a.mcap: is cut off; b.mcap: is cut off")
    assert acquisition.failure is None


def test_runs_of_a_bag_are_passed_on(tmp_path: Path) -> None:
    path = write_blocks(tmp_path / "run", (force_block(500 * n, 500) for n in range(4)))
    settings = DaqSettings(source="bag", backlog=9.0, bag=BagSettings(path=str(path), stamps="now"))
    times = chain([500 * NS, 501 * NS, 501 * NS, 400 * NS], repeat(410 * NS))
    acquisition = Acquisition(make_source(settings, lambda: next(times)), settings, notifications := Notifications())
    acquisition.start()
    notifications.until(is_over(acquisition))
    readings = acquisition.take()
    acquisition.stop()
    assert numbers(readings) == [(500 * n, 500, 0) for n in range(4)]
    assert [reading.run for reading in readings] == [0, 0, 1, 1]
    assert (acquisition.statistics().reconnects, acquisition.statistics().samples_lost) == (0, 0)


def test_stop_ends_a_read_and_may_be_repeated() -> None:
    source = Scripted([(0, BLOCK)], ends=False)
    with running(source) as (acquisition, _):
        assert source.idle.wait(WAIT_S)
        acquisition.stop()
        acquisition.stop()
        assert acquisition.statistics().state is AcquisitionState.STOPPED
        assert not acquisition.ended
        assert numbers(acquisition.take()) == [(0, 100, 0)]
        assert not any(thread.name == "acquisition" for thread in threading.enumerate())


def test_error_of_a_read_during_close_is_ignored() -> None:
    source = Scripted([], ends=False)
    read = source.read

    def broken(timeout_s: float) -> Reading | None:
        read(timeout_s)
        raise DaqError("the task was cleared")

    source.read = broken  # type: ignore[method-assign]
    with running(source) as (acquisition, _):
        assert source.idle.wait(WAIT_S)
        acquisition.stop()
        assert acquisition.failure is None
        assert acquisition.statistics().state is AcquisitionState.STOPPED


def test_stop_before_start_closes_the_source() -> None:
    source = Scripted([])
    acquisition, _ = make_acquisition(source)
    assert acquisition.statistics().state is AcquisitionState.IDLE
    acquisition.stop()
    assert source.calls == ["close"]


def test_start_raises_the_error_of_the_source() -> None:
    acquisition, _ = make_acquisition(Scripted([], starts=[DeviceMissingError("no such device")]))
    with pytest.raises(DeviceMissingError, match="no such device"):
        acquisition.start()
    acquisition.stop()


def test_second_start_is_refused() -> None:
    with running(Scripted([])) as (acquisition, _), pytest.raises(RuntimeError, match="only once"):
        acquisition.start()


def test_late_read_gives_the_maximum_latency() -> None:
    source = Scripted([(0, BLOCK), (0, BLOCK)])
    late = source.wait(40)

    def early() -> None:
        source.steady_ns -= round(40 / RATE * NS)

    source.script.extend([late, (0, BLOCK), early, (0, BLOCK)])
    acquisition, _ = run_script(source)
    statistics = acquisition.statistics()
    assert statistics.latency_p50_s == pytest.approx(0.0, abs=1e-6)
    assert statistics.latency_max_s == pytest.approx(0.04, abs=1e-6)


def test_recording_has_no_latency() -> None:
    acquisition, _ = run_script(Scripted([(0, BLOCK)], stamped=True))
    assert math.isnan(acquisition.statistics().latency_max_s)


def test_half_sine_source_is_read_in_real_time() -> None:
    settings = DaqSettings(source="sim", block_time=0.005, backlog=600.0)
    notifications = Notifications()
    acquisition = Acquisition(HalfSineSource(settings, lambda: 42), settings, notifications)
    acquisition.start()
    notifications.until(lambda: acquisition.statistics().samples_read >= 20 * 64)
    acquisition.stop()
    readings = acquisition.take()
    assert [reading.first_sample for reading in readings] == [number * 64 for number in range(len(readings))]
    assert {reading.lost for reading in readings} == {0}
    statistics = acquisition.statistics()
    assert (statistics.samples_lost, statistics.samples_dropped) == (0, 0)
    assert 0.0 <= statistics.latency_p50_s <= statistics.latency_max_s < WAIT_S


def test_ni9230_reconnects_after_it_was_unplugged(ni_device: NiDevice) -> None:
    settings = DaqSettings(ni9230=Ni9230Settings(retry_time=0.001))
    notifications = Notifications()
    acquisition = Acquisition(make_source(settings, ni_device.clock), settings, notifications, ni_device.clock)
    acquisition.start()
    notifications.until(lambda: acquisition.statistics().samples_read > 0)
    ni_device.unplug(forget=True)
    notifications.until(lambda: acquisition.statistics().state is AcquisitionState.WAITING)
    before = acquisition.take()
    ni_device.advance(3.0)
    ni_device.plug()
    notifications.until(
        lambda: bool(acquisition.statistics().reconnects) and acquisition.statistics().samples_waiting > 0
    )
    acquisition.stop()
    assert acquisition.failure is None
    after = acquisition.take()
    assert {reading.run for reading in before} == {0}
    assert {reading.run for reading in after} == {1}
    assert acquisition.statistics().samples_lost == pytest.approx(3.0 * 12_800.0, abs=1.0)
    assert after[0].lost >= acquisition.statistics().samples_lost


def test_queue_takes_all_that_the_driver_kept_during_a_pause(ni_device: NiDevice) -> None:
    count = round(9.9 * 12_800.0)
    settings = DaqSettings(ni9230=Ni9230Settings(samples=count))
    notifications = Notifications()
    acquisition = Acquisition(make_source(settings, ni_device.clock), settings, notifications, ni_device.clock)
    acquisition.start()
    notifications.until(is_over(acquisition))
    statistics = acquisition.statistics()
    assert (statistics.samples_waiting, statistics.samples_dropped) == (count, 0)
    acquisition.stop()


readings_and_faults = st.one_of(
    st.tuples(st.just("samples"), st.integers(0, 200), st.integers(1, 300)),
    st.tuples(st.just("away"), st.integers(0, 2000), st.just(0)),
    st.just(("take", 0, 0)),
)


@given(st.lists(readings_and_faults, max_size=60))
def test_every_sample_number_is_delivered_or_lost(schedule: list[tuple[str, int, int]]) -> None:
    source = Scripted([])
    acquisition, notifications = make_acquisition(source)
    taken: list[Reading] = []
    # The last reading states what was dropped or lost before, so it must fit.
    schedule = [*schedule, ("take", 0, 0), ("samples", 0, 1)]
    for kind, missing, count in schedule:
        if kind == "take":
            # Taken during a read, so that the schedule decides when.
            source.script.append(lambda: taken.extend(acquisition.take()))
        elif kind == "away":
            source.script.extend([DeviceLostError("unplugged"), source.wait(missing)])
        else:
            source.script.append((missing, count))
    acquisition.start()
    notifications.until(is_over(acquisition))
    taken += acquisition.take()
    acquisition.stop()
    assert acquisition.failure is None
    end, run = 0, 0
    for reading in taken:
        assert reading.first_sample == end + reading.lost
        assert reading.run >= run
        end, run = reading.first_sample + reading.samples.shape[1], reading.run
    delivered, lost = (sum(column) for column in zip(*((r.samples.shape[1], r.lost) for r in taken), strict=True))
    total = sum(missing + count for _, missing, count in schedule)
    assert delivered + lost == end == total
    statistics = acquisition.statistics()
    assert statistics.samples_read + statistics.samples_lost == total
    assert statistics.samples_read - statistics.samples_dropped == delivered
    assert statistics.reconnects == sum(kind == "away" for kind, _, _ in schedule)

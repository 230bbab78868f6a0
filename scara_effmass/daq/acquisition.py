# SPDX-License-Identifier: Apache-2.0
"""Read a force source in a thread of its own."""

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from statistics import median
from typing import final

from scara_effmass.daq.source import ForceSource, Reading
from scara_effmass.errors import DaqError, DeviceLostError, DeviceMissingError, OverrunError
from scara_effmass.settings import DaqSettings
from scara_effmass.wire.cdr import NS

LATENCY_WINDOW_S = 10.0
"""Time of the samples that determine the latency; two clocks that differ by 100 ppm drift by 1 ms meanwhile."""

ANSWER_TIMEOUTS = 2.0
"""A call of the source that takes longer than so many timeouts of a read hangs, as in a driver."""


def steady_time_ns() -> int:
    """Return a steady time [ns] that goes on while the computer is suspended, where the system has one."""
    return time.clock_gettime_ns(getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC))


class AcquisitionState(Enum):
    """Current acquisition state."""

    IDLE = "not started"
    RUNNING = "running"
    WAITING = "waiting for samples"
    ENDED = "ended"
    FAILED = "failed"
    STOPPED = "stopped"


@dataclass(frozen=True, slots=True)
class AcquisitionStatistics:
    """State and counts since the start; samples are counted per channel."""

    state: AcquisitionState
    reason: str
    """Why the acquisition waits or has failed; after the end of a recording, what could not be read."""
    samples_read: int
    samples_dropped: int
    """Samples that were read, but did not fit into the queue."""
    samples_lost: int
    """Samples that never arrived: the device lost them or was disconnected."""
    samples_waiting: int
    reconnects: int
    latency_p50_s: float
    """See `ReadLatency`; NaN for a recording."""
    latency_max_s: float


@final
class SampleQueue:
    """Bounded queue between two threads.

    A reading that does not fit is dropped, and the next one that fits states its samples as lost. With `block`, `put`
    waits until the reading fits or the queue is closed.
    """

    def __init__(self, *, block: bool) -> None:
        self._block = block
        self._changed = threading.Condition()
        self._readings: deque[Reading] = deque()
        self._unreported = 0
        self._closed = False
        self.samples = 0
        """Samples per channel in the queue."""
        self.dropped_samples = 0

    def put(self, reading: Reading, max_samples: float) -> None:
        """Add a reading if the queue is empty, or if it fits into `max_samples`; otherwise drop it or wait."""
        count = reading.samples.shape[1]
        with self._changed:
            while self._block and not self._closed and not self._fits(count, max_samples):
                self._changed.wait()
            if self._fits(count, max_samples):
                self._readings.append(reading._replace(lost=reading.lost + self._unreported))
                self._unreported = 0
                self.samples += count
            else:
                self.dropped_samples += count
                self._unreported += reading.lost + count

    def take(self) -> list[Reading]:
        """Return all readings and empty the queue."""
        with self._changed:
            readings = list(self._readings)
            self._readings.clear()
            self.samples = 0
            self._changed.notify_all()
        return readings

    def close(self) -> None:
        """End a waiting `put`."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def _fits(self, count: int, max_samples: float) -> bool:
        return not self._readings or self.samples + count <= max_samples


@final
class ReadLatency:
    """Estimate the earliest time at which a sample can be read, and how much later each read was.

    A read can be late but never early. The earliest reads of the last 10 s of samples therefore show when samples are
    available, also after a computer was suspended for longer.
    """

    def __init__(self, sample_rate: float) -> None:
        self._sample_rate = sample_rate
        self._earliest: deque[tuple[int, int]] = deque()  # (end of the read, time of sample 0), both ascending
        self._latencies: deque[tuple[int, float]] = deque()

    def add(self, end: int, read_ns: int) -> None:
        """Add a read: at the steady time `read_ns`, all samples before number `end` had been read."""
        origin_ns = read_ns - self._span_ns(end)
        expired = end - round(LATENCY_WINDOW_S * self._sample_rate)
        while self._earliest and self._earliest[-1][1] >= origin_ns:
            self._earliest.pop()
        self._earliest.append((end, origin_ns))
        while self._earliest[0][0] < expired:
            self._earliest.popleft()
        self._latencies.append((end, (origin_ns - self._earliest[0][1]) / NS))
        while self._latencies[0][0] < expired:
            self._latencies.popleft()

    def time_ns(self, number: int) -> int:
        """Return the earliest steady time at which sample `number` can be read; requires an earlier read."""
        return self._earliest[0][1] + self._span_ns(number)

    def latencies(self) -> tuple[float, float]:
        """Return the median and the maximum latency [s]; NaN before the first read."""
        if not self._latencies:
            return float("nan"), float("nan")
        values = [latency for _, latency in self._latencies]
        return median(values), max(values)

    def _span_ns(self, samples: int) -> int:
        return round(samples * NS / self._sample_rate)


@final
class Acquisition:
    """Read a source and queue its readings; public members may be used from any thread.

    The queue holds `settings.backlog` [s]. A reading that does not fit is dropped, and the next one states its samples
    as lost; an unpaced source waits instead.

    After a lost device or an overrun, the acquisition restarts the source every `settings.ni9230.retry_time` until it
    returns samples. Then `Reading.run` increases, and the sample numbers continue after the gap. The gap is the time
    without samples on the steady clock, times the sample rate; it is as accurate as the latency of a read. Any other
    error ends the acquisition and becomes its `failure`.
    """

    def __init__(
        self,
        source: ForceSource,
        settings: DaqSettings,
        notify: Callable[[], None],
        steady_ns: Callable[[], int] = steady_time_ns,
    ) -> None:
        """Take over a source that has not been started.

        The acquisition thread calls `notify`, which must not block, when readings, state or failure may have changed.
        """
        self.source = source
        self._notify = notify
        self._steady_ns = steady_ns
        self._retry_s = settings.ni9230.retry_time
        self._timeout_s = 1.0 + 2.0 * settings.block_time
        self._backlog_s = settings.backlog
        self._queue = SampleQueue(block=source.is_unpaced)
        self._thread: threading.Thread | None = None
        self._stopping = threading.Event()

        self._lock = threading.Lock()
        """Guards all attributes below."""
        self.state, self._reason = AcquisitionState.IDLE, ""
        self.failure: Exception | None = None
        """Error that ended the acquisition."""
        self._called_ns: int | None = None
        """Steady time at which `source` was called for samples; None when it has answered."""
        self._samples_read = self._samples_lost = 0
        self._latency = ReadLatency(0.0)
        """That of this run; without reads for a recording, and before `start`."""
        self._end = 0
        """Number of the next sample if none is lost."""
        self._due_ns = 0
        """Steady time at which that sample was due at the start of the run."""
        self._run = 0
        self._run_first: int | None = None
        """Number of the first sample of this run, lost or not; None before its first reading."""
        self._is_lost = False
        """Whether a lost device has given no sample since."""

    def start(self) -> None:
        """Start the source and the thread. Raises DaqError, or RuntimeError when called twice."""
        if self._thread is not None:
            raise RuntimeError("an acquisition can start only once")
        self.source.start()
        self._first_setup = self._setup()
        self._latency = ReadLatency(self.source.sample_rate)
        self._due_ns = self._steady_ns()
        self.state = AcquisitionState.RUNNING
        self._thread = threading.Thread(target=self._acquire, name="acquisition", daemon=True)
        self._thread.start()

    def take(self) -> list[Reading]:
        """Return the readings since the last call."""
        return self._queue.take()

    @property
    def ended(self) -> bool:
        """Whether the source has ended and all of its readings were taken."""
        return self.state is AcquisitionState.ENDED and not self._queue.samples

    @property
    def gap_s(self) -> float:
        """How long a lost device has given no sample [s]; 0 while none is lost, and before the first sample."""
        with self._lock:
            return (self._steady_ns() - self._due_ns) / NS if self._is_lost and self._end else 0.0

    def statistics(self) -> AcquisitionStatistics:
        """Return the state and the counts."""
        with self._lock:
            p50_s, max_s = self._latency.latencies()
            state, reason = self.state, self._reason
            if state is AcquisitionState.RUNNING and self._is_overdue():
                state = AcquisitionState.WAITING
                reason = f"the source has not answered for more than {ANSWER_TIMEOUTS * self._timeout_s:g} s"
            return AcquisitionStatistics(
                state=state,
                reason=reason,
                samples_read=self._samples_read,
                samples_dropped=self._queue.dropped_samples,
                samples_lost=self._samples_lost,
                samples_waiting=self._queue.samples,
                reconnects=self._run,
                latency_p50_s=p50_s,
                latency_max_s=max_s,
            )

    def stop(self) -> None:
        """End the thread and close the source; queued readings can still be taken. May be called again."""
        self._stopping.set()
        self._queue.close()
        self.source.close()
        if self._thread is not None:
            self._thread.join()

    def _acquire(self) -> None:
        reason = ""
        try:
            state = self._read_all()
            if state is AcquisitionState.ENDED:
                reason = "; ".join(self.source.losses)
        except Exception as error:  # noqa: BLE001 - the consumer reports any failure
            state = AcquisitionState.STOPPED
            # A driver may raise when `stop` closes the source during a read.
            if not (isinstance(error, DaqError) and self._stopping.is_set()):
                self.failure = error
                state, reason = AcquisitionState.FAILED, str(error) or type(error).__name__
        self.source.close()
        self._set_state(state, reason)

    def _read_all(self) -> AcquisitionState:
        while not self._stopping.is_set():
            with self._lock:
                self._called_ns = self._steady_ns()
            try:
                reading = self.source.read(self._timeout_s)
            except (DeviceLostError, OverrunError) as error:
                self._restart(error)
                continue
            with self._lock:
                self._called_ns = None
            if reading is not None:
                self._add(reading, self._steady_ns())
            elif self._stopping.is_set():
                break
            elif self.source.ended:
                return AcquisitionState.ENDED
            else:
                cause = f": waiting for {self.source.waiting_for}" if self.source.waiting_for else ""
                self._set_state(AcquisitionState.WAITING, f"no samples within {self._timeout_s:g} s{cause}")
        return AcquisitionState.STOPPED

    def _add(self, reading: Reading, read_ns: int) -> None:
        count = reading.samples.shape[1]
        end_in_run = reading.first_sample + count
        with self._lock:
            if self._run_first is None:
                gap_ns = read_ns - round(end_in_run * NS / self.source.sample_rate) - self._due_ns
                gap = round(gap_ns / NS * self.source.sample_rate) if self._run else 0
                self._run_first = self._end + max(0, gap)
            if reading.stamp_ns is None:
                self._latency.add(end_in_run, read_ns)
            first = self._run_first + reading.first_sample
            lost = first - self._end
            self._end = first + count
            self._is_lost = False
            self._samples_read += count
            self._samples_lost += lost
        numbered = reading._replace(first_sample=first, lost=lost, run=self._run + reading.run)
        self._queue.put(numbered, max_samples=self._backlog_s * self.source.sample_rate)
        self._set_state(AcquisitionState.RUNNING)

    def _restart(self, error: DaqError) -> None:
        """Close and start the source until that succeeds; its next readings belong to a new run."""
        # A device that starts but returns no samples must not be restarted over and over without a pause.
        pause = self._run_first is None
        with self._lock:
            self._is_lost = True
            if self._run_first is not None:
                self._due_ns = self._latency.time_ns(self._end - self._run_first)
        while not self._stopping.is_set():
            self._set_state(AcquisitionState.WAITING, str(error))
            self.source.close()
            if pause and self._stopping.wait(self._retry_s):
                return
            pause = True
            try:
                self.source.start()
            except DaqError as next_error:
                error = next_error
                continue
            if (setup := self._setup()) != self._first_setup:
                raise DeviceMissingError(f"the device came back as {setup}: must be {self._first_setup}")
            with self._lock:
                self._run += 1
                self._run_first = None
                self._latency = ReadLatency(self.source.sample_rate)
            return

    def _is_overdue(self) -> bool:
        timeout_s = ANSWER_TIMEOUTS * self._timeout_s
        return self._called_ns is not None and self._steady_ns() - self._called_ns > timeout_s * NS

    def _setup(self) -> str:
        """Return what the blocks of an acquisition state once for all: device, rate and range."""
        source = self.source
        return f"{source.description} ({source.sample_rate:.9g} Hz, up to {source.limit:g} N)"

    def _set_state(self, state: AcquisitionState, reason: str = "") -> None:
        with self._lock:
            self.state, self._reason = state, reason
        self._notify()

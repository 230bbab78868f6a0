"""A source read in a thread of its own, which waits for nobody but the source."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, final

from scara_effmass.daq.read_latency import ReadLatency
from scara_effmass.daq.recorded import RecordedForce
from scara_effmass.daq.sample_queue import SampleQueue
from scara_effmass.errors import DaqError, DeviceLostError, DeviceMissingError, OverrunError
from scara_effmass.settings import ForceSourceKind

if TYPE_CHECKING:
    from collections.abc import Callable

    from scara_effmass.daq.source import ForceSource, Reading
    from scara_effmass.settings import DaqSettings

NS = 1_000_000_000


class AcquisitionState(Enum):
    """How it is with an acquisition."""

    IDLE = "not started"
    RUNNING = "running"
    WAITING = "waiting for samples"
    ENDED = "ended"
    FAILED = "failed"
    STOPPED = "stopped"


@dataclass(frozen=True, slots=True)
class AcquisitionStatistics:
    """What has happened since the start; samples are counted per channel.

    `samples_read` came off the source, and `samples_dropped` of them, in `readings_dropped`, found no room to wait in.
    `samples_lost` never came: the device lost them, or was away. A read is late by the time from when its samples
    could have been there, see `Pace`, to when they were; NaN where the source is a recording.
    """

    state: AcquisitionState
    reason: str
    """Why it is waiting or has failed; of a recording that has ended, what of it could not be read."""
    samples_read: int
    samples_dropped: int
    samples_lost: int
    samples_waiting: int
    readings_dropped: int
    reconnects: int
    latency_p50_s: float
    latency_max_s: float


@final
class Acquisition:
    """Reads a source and keeps what it gives until somebody takes it; public members may be used from any thread.

    Up to `settings.backlog` wait; a reading that finds no room is dropped and counted as lost in the next one. Only
    for a recording that is to be played as fast as possible the thread waits instead.

    A lost device and an overrun are survived: the source is started again, `settings.ni9230.retry_time` apart, until
    it gives samples. `Reading.run` then grows, and the numbers go on with the samples that are missing: the time for
    which there were none, on the steady clock, since ROS time may jump, times the sample rate. That is as good as the
    latency of a read. Any other error ends the acquisition and is its `failure`.
    """

    def __init__(
        self,
        source: ForceSource,
        settings: DaqSettings,
        notify: Callable[[], None],
        steady_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """Take a source that has not been started, and from now on leave it to the acquisition.

        `notify` is called in the thread of the acquisition whenever there may be something new, in `take`, `ended`,
        `failure` or the state; it must not block.
        """
        self.source = source
        self._notify = notify
        self._steady_ns = steady_ns
        self._retry_s = settings.ni9230.retry_time
        self._timeout_s = 1.0 + 2.0 * settings.block_time
        self._backlog_s = settings.backlog
        self._backlog = SampleQueue(patient=settings.source is ForceSourceKind.BAG and settings.bag.rate == 0.0)
        self._thread: threading.Thread | None = None
        self._stopping = threading.Event()

        self._lock = threading.Lock()
        """Guards all below."""
        self._state, self._reason = AcquisitionState.IDLE, ""
        self._failure: Exception | None = None
        self._read = self._lost = 0
        self._recorded = False
        self._end = 0
        """The number of the next sample, if none is missing."""
        self._due_ns = 0
        """When that sample was due as the run began."""
        self._run = 0
        self._run_first: int | None = None
        """The number of the first sample of this run, lost or not; None until it has given any."""

    def start(self) -> None:
        """Start the source, and then the thread; raises DaqError, and RuntimeError the second time."""
        if self._thread is not None:
            raise RuntimeError("an acquisition starts once; make a new one")
        self.source.start()
        self._as_started = (self.source.channels, self.source.sample_rate)
        self._pace = ReadLatency(self.source.sample_rate)
        self._due_ns = self._steady_ns()
        self._state = AcquisitionState.RUNNING
        self._thread = threading.Thread(target=self._acquire, name="acquisition", daemon=True)
        self._thread.start()

    def take(self) -> list[Reading]:
        """Return the readings that have come since the last call, none twice."""
        return self._backlog.take()

    @property
    def state(self) -> AcquisitionState:
        """How it is with it."""
        return self._state

    @property
    def failure(self) -> Exception | None:
        """What ended it, if an error did."""
        return self._failure

    @property
    def ended(self) -> bool:
        """Whether the source is over and all its readings have been taken."""
        return self._state is AcquisitionState.ENDED and not self._backlog.samples

    def statistics(self) -> AcquisitionStatistics:
        """Return what has happened so far."""
        with self._lock:
            live = self._thread is not None and not self._recorded
            p50, largest = self._pace.latencies() if live else (float("nan"), float("nan"))
            return AcquisitionStatistics(
                state=self._state,
                reason=self._reason,
                samples_read=self._read,
                samples_dropped=self._backlog.dropped_samples,
                samples_lost=self._lost,
                samples_waiting=self._backlog.samples,
                readings_dropped=self._backlog.dropped_readings,
                reconnects=self._run,
                latency_p50_s=p50,
                latency_max_s=largest,
            )

    def stop(self) -> None:
        """End the thread and close the source; may be called again. What was read can still be taken."""
        self._stopping.set()
        self._backlog.close()
        self.source.close()
        if self._thread is not None:
            self._thread.join()

    def _acquire(self) -> None:
        reason = ""
        try:
            over = self._read_all()
            if over is AcquisitionState.ENDED and isinstance(self.source, RecordedForce):
                reason = "; ".join(self.source.losses)
        except Exception as error:  # noqa: BLE001 - whatever it is, the consumer is told
            over = AcquisitionState.STOPPED
            # Closing a source under a read may be an error to its driver, but is none to us.
            if not (isinstance(error, DaqError) and self._stopping.is_set()):
                self._failure = error
                over, reason = AcquisitionState.FAILED, str(error) or type(error).__name__
        self.source.close()
        self._enter(over, reason)

    def _read_all(self) -> AcquisitionState:
        while not self._stopping.is_set():
            try:
                reading = self.source.read(self._timeout_s)
            except (DeviceLostError, OverrunError) as error:
                self._start_again(error)
                continue
            if reading is not None:
                self._add(reading, self._steady_ns())
            elif self._stopping.is_set():
                break
            elif self.source.ended:
                return AcquisitionState.ENDED
            else:
                self._enter(AcquisitionState.WAITING, self._why_none())
        return AcquisitionState.STOPPED

    def _why_none(self) -> str:
        reason = f"no samples within {self._timeout_s:g} s"
        return f"{reason}: {self.source.awaited}" if isinstance(self.source, RecordedForce) else reason

    def _add(self, reading: Reading, read_ns: int) -> None:
        count = reading.samples.shape[1]
        end_in_run = reading.first_sample + count
        with self._lock:
            if self._run_first is None:
                away_ns = read_ns - round(end_in_run * NS / self.source.sample_rate) - self._due_ns
                gap = round(away_ns / NS * self.source.sample_rate) if self._run else 0
                self._run_first = self._end + max(0, gap)
            self._pace.add(end_in_run, read_ns)
            self._recorded = reading.stamp_ns is not None
            first = self._run_first + reading.first_sample
            lost = first - self._end
            self._end = first + count
            self._read += count
            self._lost += lost
        numbered = reading._replace(first_sample=first, lost=lost, run=self._run + reading.run)
        self._backlog.put(numbered, room=self._backlog_s * self.source.sample_rate)
        self._enter(AcquisitionState.RUNNING)

    def _start_again(self, error: DaqError) -> None:
        """Close and start the source until that works; what it gives next is another run."""
        # A device that starts but then gives nothing is not to be tried again and again without a pause.
        pause = self._run_first is None
        if self._run_first is not None:
            self._due_ns = self._pace.time_ns(self._end - self._run_first)
        while not self._stopping.is_set():
            self._enter(AcquisitionState.WAITING, str(error))
            self.source.close()
            if pause and self._stopping.wait(self._retry_s):
                return
            pause = True
            try:
                self.source.start()
            except DaqError as again:
                error = again
                continue
            now_is = (self.source.channels, self.source.sample_rate)
            if now_is != self._as_started:
                raise DeviceMissingError(f"the device came back as {now_is}; {self._as_started} would be right")
            with self._lock:
                self._run += 1
                self._run_first = None
                self._pace = ReadLatency(self.source.sample_rate)
            return

    def _enter(self, state: AcquisitionState, reason: str = "") -> None:
        with self._lock:
            self._state, self._reason = state, reason
        self._notify()

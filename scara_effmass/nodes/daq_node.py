# SPDX-License-Identifier: Apache-2.0
"""`daq_node`: publish force blocks, impacts and their diagnostics. A thread of its own reads the source."""

import math
import threading
import time
import traceback
from collections.abc import Iterable, Sequence
from functools import partial
from importlib import import_module

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import WrenchStamped
from rcl_interfaces.msg import SetParametersResult
from rclpy.duration import Duration
from rclpy.parameter import Parameter
from scara_effmass_msgs.msg import ForceBlock, Impact

from scara_effmass import values
from scara_effmass.codes import Reason
from scara_effmass.daq import make_source
from scara_effmass.daq.acquisition import Acquisition, AcquisitionState
from scara_effmass.daq.conditioning import ForceChannel, SignalConditioner
from scara_effmass.daq.source import ForceSource, Reading
from scara_effmass.errors import DaqError, EffmassError, SettingsError
from scara_effmass.impacts.criterion import impact_count
from scara_effmass.impacts.detector import Detector
from scara_effmass.impacts.load import peak_text
from scara_effmass.nodes import parameters
from scara_effmass.nodes.diagnostics import Diagnostics, status
from scara_effmass.nodes.lifecycle import LifecycleBase, run
from scara_effmass.settings import DaqSettings
from scara_effmass.settings.loading import fixed
from scara_effmass.wire import topics
from scara_effmass.wire.cdr import NS
from scara_effmass.wire.force import force_block_message, impact_message

_POLL_S = 0.01
_ACK_TIMEOUT_NS = 5_000_000_000
"""Fast DDS requests acknowledgements every 3 s."""
_IMPACT_INTERVAL_S = 0.05
"""Time between two impacts: a burst of rebounds would push their primary impact out of a queue of 10."""
_IMPACTS_PER_INTERVAL = 40
"""One more impact is published per interval for so many that wait, so that the queue of a long rattle drains."""
_LEVELS = {
    AcquisitionState.RUNNING: DiagnosticStatus.OK,
    AcquisitionState.ENDED: DiagnosticStatus.OK,
    AcquisitionState.WAITING: DiagnosticStatus.ERROR,
    AcquisitionState.FAILED: DiagnosticStatus.ERROR,
}


class NodeSettings(parameters.NodeParameters, DaqSettings):
    """Settings of the measurement and of the node."""

    stop_at_end: bool = fixed(
        default=False, description="end the process when a recording or a finite acquisition is over"
    )


class DaqNode(LifecycleBase[NodeSettings]):
    """Publish `force`, `impact`, `wrench` and `/diagnostics`; further channels publish below these names."""

    def __init__(self) -> None:
        """Declare the parameters. Raises SettingsError."""
        super().__init__("daq", NodeSettings)
        self._outputs: list[_Output] = []
        self._acquisition: Acquisition | None = None
        self._state: AcquisitionState | None = None
        self._faults: tuple[str, ...] = ()
        self._drain_is_due = False
        self._is_over = False
        self.add_on_set_parameters_callback(self._on_set_clock)

    def configure(self) -> None:
        """Create the source and the endpoints. Raises EffmassError."""
        settings = self.settings
        self._source: ForceSource = make_source(settings, self.now_ns)
        if self.get_parameter("use_sim_time").value:
            self._require_ros_time()
        if settings.filter.kind != "none":
            import_module("scara_effmass.daq.lowpass")  # takes seconds, so not after the start
        self._outputs = [
            _Output(self, f"/{name}" if number else "", settings) for number, name in enumerate(self._source.channels)
        ]
        self.own(self._outputs, list.clear)
        self._diagnostics = Diagnostics(self, self._statuses)
        self.create_steady_timer(_IMPACT_INTERVAL_S, self._publish_waiting)
        self.create_owned_trigger("~/reset", self._reset)

    def _require_ros_time(self) -> None:
        """Raise SettingsError if the source measures in real time."""
        if not self._source.uses_ros_time:
            reason = f"must be false, {self.settings.source} measures in real time"
            raise SettingsError(f"{self.get_name()}: use_sim_time = true: {reason}")

    def _on_set_clock(self, changes: list[Parameter]) -> SetParametersResult:
        """Refuse simulated time at run time as at the start; called before ROS changes its clock."""
        try:
            if self._outputs and any(change.name == "use_sim_time" and change.value for change in changes):
                self._require_ros_time()
        except SettingsError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def activate(self) -> None:
        """Start the acquisition. Raises DaqError, BagError or SettingsError."""
        source = self._source
        if source.subscriber_timeout:
            self._await_subscriber()
        acquisition = Acquisition(source, self.settings, self._wake)
        acquisition.start()
        self._acquisition = acquisition
        self._signal = SignalConditioner(source, self.settings)
        self._faults = ()
        for output in self._outputs:
            output.reset()
        requested = "" if source.sample_rate == source.requested_rate else f" (requested: {source.requested_rate:.9g})"
        self.get_logger().info(f"acquiring {source.description} at {source.sample_rate:.9g} Hz{requested}")

    def _await_subscriber(self) -> None:
        """Wait for a subscriber, because a recording is published once. Raises EffmassError."""
        self._source.start()  # raises at once if the recording cannot be read
        self._source.close()
        deadline = time.monotonic() + self._source.subscriber_timeout
        publishers = [publisher for output in self._outputs for publisher in (output.force, output.impact)]
        while not any(publisher.get_subscription_count() for publisher in publishers):
            if time.monotonic() > deadline:
                self.get_logger().warning(f"{self._source.description}: no subscriber yet, playing")
                return
            if self.stopping.wait(_POLL_S):  # the middleware matches subscribers in threads of its own
                return

    def deactivate(self) -> None:
        """Stop the acquisition, and publish the contacts that have not ended."""
        if self._acquisition is not None:
            self._acquisition.stop()
            self._acquisition = None
            self._finish_detection()
        self.publish_last(Reason.NONE)

    def publish_last(self, reason: Reason, detail: str = "") -> None:  # noqa: ARG002 - impacts have none
        """Publish the impacts that wait."""
        if self.context.ok():
            for output in self._outputs:
                output.publish_waiting(at_once=True)

    def _publish_waiting(self) -> None:
        if not self.active:
            return
        if self._acquisition is not None and self._acquisition.gap_s > self.settings.detection.longest:
            self._drain()  # no contact goes on after so many lost samples
            self._finish_detection()
        for output in self._outputs:
            output.publish_waiting()
        if self._is_over and not any(output.waiting for output in self._outputs):
            end_ns = time.monotonic_ns() + _ACK_TIMEOUT_NS
            for output in self._outputs:
                for publisher in (output.force, output.impact):
                    publisher.wait_for_all_acked(Duration(nanoseconds=max(0, end_ns - time.monotonic_ns())))
            rclpy.try_shutdown()

    def _wake(self) -> None:
        """Schedule `_drain` in the executor; called in the acquisition thread."""
        if not self._drain_is_due and self.executor is not None:
            self._drain_is_due = True
            self.executor.create_task(self._drain)

    def _drain(self) -> None:
        self._drain_is_due = False
        try:
            self._publish_readings()
        except Exception as error:  # noqa: BLE001 - an error in a task would end the interpreter
            if not self.context.ok():
                return  # the context was shut down while publishing
            if not isinstance(error, EffmassError):
                self.get_logger().error(traceback.format_exc())
                error = DaqError(f"{type(error).__name__}: {error}")
            self.abort(error)

    def _publish_readings(self) -> None:
        acquisition = self._acquisition
        if acquisition is None or not self.active:
            return
        for reading in acquisition.take():
            self._publish_reading(reading)
        state = acquisition.state
        if state is not self._state:
            if AcquisitionState.WAITING in {state, self._state}:
                statistics = acquisition.statistics()
                lost = statistics.samples_lost + statistics.samples_dropped
                text = f"{statistics.state.value}, {statistics.reconnects} reconnects, {lost} samples lost"
                reason = f": {statistics.reason}" * bool(statistics.reason)
                self._diagnostics.log.event(f"{self._source.description}: {text}{reason}", DiagnosticStatus.WARN)
            self._state = state
            self._diagnostics.report()
        if acquisition.failure is not None:
            raise acquisition.failure
        if acquisition.ended:
            self._on_end(acquisition.statistics().reason)

    def _publish_reading(self, reading: Reading) -> None:
        channels = list(zip(self._outputs, self._signal.blocks(reading), strict=True))
        # Separate loops: a step takes half the time right after the same step of another channel.
        for output, blocks in channels:
            output.publish(blocks)
        for output, blocks in channels:
            for block in blocks:
                self._publish_impacts(output, output.detector.feed(block))
        if reading.faults != self._faults:
            self._faults = reading.faults
            self._diagnostics.report()

    def _finish_detection(self) -> None:
        if self.context.ok():
            for output in self._outputs:
                self._publish_impacts(output, output.detector.finish())

    def _on_end(self, losses: str) -> None:
        self._finish_detection()
        self._diagnostics.report()
        if not any(channel.samples for channel in self._signal.channels):
            raise DaqError(f"{self._source.description}: has no usable sample; must have finite numbers")
        self.get_logger().info(f"{self._source.description}: ended")
        if losses:
            self.get_logger().warning(losses)
        self._is_over = self.settings.stop_at_end

    def _publish_impacts(self, output: "_Output", impacts: Sequence[values.Impact]) -> None:
        output.publish_impacts(impacts)
        for impact in impacts:
            if not impact.rebound:
                self._diagnostics.log.event(impact_text(impact))

    def _statuses(self) -> list[DiagnosticStatus]:
        if self._acquisition is None:
            return []
        detections = [(output.detector, output.impacts, output.rebounds) for output in self._outputs]
        return daq_statuses(self._acquisition, self._signal, detections)

    def _reset(self) -> str:
        if self._acquisition is None or self._state is not AcquisitionState.RUNNING:
            raise DaqError("refused: no acquisition is running")
        self._signal.begin_tare()
        return f"taring over the next {self.settings.tare.time:g} s"


class _Output:
    """Topics and impact detection of one channel."""

    def __init__(self, node: DaqNode, suffix: str, settings: DaqSettings) -> None:
        self._settings = settings
        self._lock = threading.Lock()  # a signal has a thread of its own
        self.waiting: list[values.Impact] = []
        """Impacts to publish, primary ones first."""
        self.force, self.impact, self._wrench = (
            node.create_owned_publisher(message_type, f"{topic}{suffix}", qos)
            for message_type, topic, qos in (
                (ForceBlock, topics.FORCE, topics.FORCE_QOS),
                (Impact, topics.IMPACT, topics.STREAM_QOS),
                (WrenchStamped, topics.WRENCH, topics.STREAM_QOS),
            )
        )
        self.reset()

    def reset(self) -> None:
        """Restart the impact detection."""
        self.detector = Detector(self._settings.detection)
        self.impacts = self.rebounds = 0

    def publish(self, blocks: Sequence[values.ForceBlock]) -> None:
        """Publish the blocks and the wrenches of their samples."""
        wrenches = self._settings.wrench_rate and self._wrench.get_subscription_count()
        for block in blocks:
            self.force.publish(force_block_message(block))
            if wrenches:
                self._publish_wrenches(block)

    def publish_impacts(self, impacts: Sequence[values.Impact]) -> None:
        """Count detected impacts and publish the first one; the others wait for `publish_waiting`."""
        rebounds = sum(impact.rebound > 0 for impact in impacts)
        self.impacts, self.rebounds = self.impacts + len(impacts) - rebounds, self.rebounds + rebounds
        with self._lock:
            is_idle = not self.waiting
            self.waiting = sorted([*self.waiting, *impacts], key=lambda impact: impact.rebound > 0)
        if is_idle:
            self.publish_waiting()

    def publish_waiting(self, *, at_once: bool = False) -> None:
        """Publish the next of the waiting impacts, or all of them."""
        with self._lock:
            count = len(self.waiting) if at_once else 1 + len(self.waiting) // _IMPACTS_PER_INTERVAL
            due, self.waiting = self.waiting[:count], self.waiting[count:]
            for impact in due:
                self.impact.publish(impact_message(impact))

    def _publish_wrenches(self, block: values.ForceBlock) -> None:
        """Publish the largest sample of each interval, because an impact is shorter than an interval."""
        count = max(1, round(len(block.force) / block.sample_rate * self._settings.wrench_rate))
        for part in np.array_split(np.arange(len(block.force)), min(count, len(block.force))):
            index = int(part[np.abs(block.force[part]).argmax()])
            message = WrenchStamped()
            stamp_ns = block.stamp_ns + round(index / block.sample_rate * NS)
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, NS)
            message.header.frame_id = block.frame_id
            message.wrench.force.z = float(block.force[index])
            self._wrench.publish(message)


def impact_text(impact: values.Impact) -> str:
    """Return one line about an impact: peak, duration, impulse, and its flaws."""
    flags = {"clipped": impact.clipped, "incomplete": impact.incomplete}
    wrong = "".join(f", {name}" for name, is_set in flags.items() if is_set)
    size = f"{1e3 * impact.duration:.2f} ms, {impact.impulse:.3g} N s{wrong}"
    return f"{'simulated ' * impact.simulated}impact on {impact.frame_id}: peak {peak_text(impact)}, {size}"


def daq_statuses(
    acquisition: Acquisition, signal: SignalConditioner, detections: Iterable[tuple[Detector, int, int]]
) -> list[DiagnosticStatus]:
    """Return the statuses of the source and of each channel, whose `detections` are detector, impacts and rebounds."""
    statuses = [_source_status(acquisition, signal)]
    statuses += [_channel_status(channel, *item) for channel, item in zip(signal.channels, detections, strict=True)]
    for entry in statuses:
        entry.hardware_id = acquisition.source.description
    return statuses


def _source_status(acquisition: Acquisition, signal: SignalConditioner) -> DiagnosticStatus:
    source, statistics, jumps = acquisition.source, acquisition.statistics(), signal.clock.restarts
    lost = statistics.samples_lost + statistics.samples_dropped
    level = _LEVELS.get(statistics.state, DiagnosticStatus.ERROR)
    problem = ""
    if level == DiagnosticStatus.OK:
        problems = (
            statistics.reason,
            f"{lost} samples lost" if lost else "",
            f"{jumps} jumps of a clock, and of the stamps with it" if jumps else "",
        )
        problem = next(filter(None, problems), "")
    device_values = {
        "rate on the ROS clock [Hz]": f"{signal.clock.sample_rate:.9g}",
        "clock residual [ms]": f"{1e3 * signal.clock.residual:.3f}",
        "read latency p50 [ms]": f"{1e3 * statistics.latency_p50_s:.3f}",
        "read latency max [ms]": f"{1e3 * statistics.latency_max_s:.3f}",
    }
    if math.isnan(statistics.latency_p50_s):
        device_values = dict.fromkeys(device_values, "as recorded")
    values = {
        "source": source.description,
        "simulated": source.simulated,
        "state": statistics.state.value,
        "requested rate [Hz]": f"{source.requested_rate:.9g}",
        "rate of the device [Hz]": f"{source.sample_rate:.9g}",
        **device_values,
        "clock jumps": jumps,
        "delay of the device's filter [ms]": f"{1e3 * source.filter_delay:.3f}",
        "samples read": statistics.samples_read,
        "samples lost by the device": statistics.samples_lost,
        "samples dropped, not published in time": statistics.samples_dropped,
        "samples waiting": statistics.samples_waiting,
        "reconnects": statistics.reconnects,
    }
    message = statistics.reason or statistics.state.value
    return status("source", message, values, problem=problem, level=None if problem else level)


def _channel_status(channel: ForceChannel, detector: Detector, impacts: int, rebounds: int) -> DiagnosticStatus:
    problem, level = "", None
    if channel.fault:
        problem, level = channel.fault, DiagnosticStatus.ERROR
    elif channel.lost and not channel.samples:
        problem, level = f"no usable sample, {channel.lost} lost", DiagnosticStatus.ERROR
    elif channel.tare_problem:
        problem = channel.tare_problem
    elif channel.samples and not detector.settled:
        problem = "no steady baseline yet: impacts cannot be detected"
    elif detector.tensile_pulses:
        problem = f"{detector.tensile_pulses} tensile pulses: check sensor.invert"
    elif channel.saturated:
        problem = f"{channel.saturated} samples at the end of the measuring range, or of a sensor with a fault"
    elif channel.lost:
        problem = f"{channel.lost} samples lost"
    values = {
        "samples published": channel.samples,
        "samples lost": channel.lost,
        "samples saturated": channel.saturated,
        "delay of the low-pass [ms]": f"{1e3 * channel.lowpass_delay:.3f}",
        "tare [N]": f"{channel.tare:.4g}",
        "tare stamp [s]": f"{channel.tare_stamp_ns / 1e9:.6f}" if channel.tare_stamp_ns else "never",
        "sensor fault": channel.fault,
        "taring": channel.taring,
        "tare refused": channel.tare_problem,
        "baseline known": detector.settled,
        "impacts": impacts,
        "rebounds": rebounds,
        "drop-outs": detector.dropouts,
        "glitches": detector.glitches,
        "sustained contacts": detector.sustained_contacts,
        "tensile pulses": detector.tensile_pulses,
    }
    for item in detector.left_out:
        values[f"left out: {item.reason}"] = f"{item.occurrences}, {item.size_text}"
    message = f"{impact_count(impacts)}, rebounds: {rebounds}"
    return status(f"channel {channel.name}", message, values, problem=problem, level=level)


main = partial(run, "daq", DaqNode)

"""Diagnostic statuses of the force measurement."""

import math
from collections.abc import Collection, Iterable

from diagnostic_msgs.msg import DiagnosticStatus

from scara_effmass.daq.acquisition import Acquisition, AcquisitionState
from scara_effmass.daq.conditioning import ForceChannel, SignalConditioner
from scara_effmass.impacts.detector import Detector
from scara_effmass.nodes.diagnostics import status

_LEVELS = {
    AcquisitionState.RUNNING: DiagnosticStatus.OK,
    AcquisitionState.ENDED: DiagnosticStatus.OK,
    AcquisitionState.WAITING: DiagnosticStatus.ERROR,
    AcquisitionState.FAILED: DiagnosticStatus.ERROR,
}


def source_status(
    acquisition: Acquisition, signal: SignalConditioner, incompatible_qos: Collection[str]
) -> DiagnosticStatus:
    """Return the status of the source; `incompatible_qos` has one line per subscriber that cannot be connected."""
    source, statistics = acquisition.source, acquisition.statistics()
    unconnected = "; ".join(sorted(incompatible_qos))
    lost = statistics.samples_lost + statistics.samples_dropped
    level = _LEVELS.get(statistics.state, DiagnosticStatus.STALE)
    message = statistics.reason or statistics.state.value
    if level == DiagnosticStatus.OK:
        jumps = signal.clock.restarts
        warnings = (
            statistics.reason,
            f"{lost} samples lost" if lost else "",
            f"{jumps} jumps of a clock, and of the stamps with it" if jumps else "",
            unconnected,
        )
        if warning := next(filter(None, warnings), ""):
            level, message = DiagnosticStatus.WARN, warning
    is_recording = math.isnan(statistics.latency_p50_s)
    device_values = {
        "rate on the ROS clock [Hz]": f"{signal.clock.sample_rate:.9g}",
        "clock residual [ms]": f"{1e3 * signal.clock.residual:.3f}",
        "read latency p50 [ms]": f"{1e3 * statistics.latency_p50_s:.3f}",
        "read latency max [ms]": f"{1e3 * statistics.latency_max_s:.3f}",
    }
    return status(
        "source",
        level,
        message,
        {
            "source": source.description,
            "simulated": source.simulated,
            "state": statistics.state.value,
            "requested rate [Hz]": f"{source.requested_rate:.9g}",
            "rate of the device [Hz]": f"{source.sample_rate:.9g}",
            **{key: "as recorded" if is_recording else value for key, value in device_values.items()},
            "clock jumps": signal.clock.restarts,
            "delay of the device's filter [ms]": f"{1e3 * source.filter_delay:.3f}",
            "samples read": statistics.samples_read,
            "samples lost by the device": statistics.samples_lost,
            "samples dropped, not published in time": statistics.samples_dropped,
            "samples waiting": statistics.samples_waiting,
            "reconnects": statistics.reconnects,
            "incompatible QoS": unconnected,
        },
    )


def channel_status(channel: ForceChannel, detector: Detector, impacts: int) -> DiagnosticStatus:
    """Return the status of one channel, in which `impacts` were detected."""
    level, message = DiagnosticStatus.WARN, ""
    if channel.lost and not channel.samples:
        level, message = DiagnosticStatus.ERROR, f"no usable sample, {channel.lost} lost"
    elif channel.tare_problem:
        message = channel.tare_problem
    elif channel.samples and not detector.settled:
        message = "no steady baseline yet: impacts cannot be detected"
    elif detector.tensile_pulses:
        message = f"{detector.tensile_pulses} tensile pulses: check sensor.invert"
    elif channel.saturated:
        message = f"{channel.saturated} samples at the end of the measuring range"
    elif channel.lost:
        message = f"{channel.lost} samples lost"
    else:
        level, message = DiagnosticStatus.OK, f"{impacts} impacts"
    return status(
        f"channel {channel.name}",
        level,
        message,
        {
            "samples published": channel.samples,
            "samples lost": channel.lost,
            "samples saturated": channel.saturated,
            "delay of the low-pass [ms]": f"{1e3 * channel.lowpass_delay:.3f}",
            "tare [N]": f"{channel.tare:.4g}",
            "tare stamp [s]": f"{channel.tare_stamp_ns / 1e9:.6f}" if channel.tare_stamp_ns else "never",
            "taring": channel.taring,
            "tare refused": channel.tare_problem,
            "baseline known": detector.settled,
            "impacts": impacts,
            "drop-outs": detector.dropouts,
            "glitches": detector.glitches,
            "sustained contacts": detector.sustained_contacts,
            "tensile pulses": detector.tensile_pulses,
        },
    )


def daq_statuses(
    node_name: str,
    acquisition: Acquisition,
    signal: SignalConditioner,
    detections: Iterable[tuple[Detector, int]],
    incompatible_qos: Collection[str] = (),
) -> list[DiagnosticStatus]:
    """Return the statuses of the source and of each channel.

    `detections` are the detector and the number of impacts of each channel.
    """
    statuses = [source_status(acquisition, signal, incompatible_qos)]
    statuses += [channel_status(channel, *item) for channel, item in zip(signal.channels, detections, strict=True)]
    for item in statuses:
        item.name = f"{node_name}: {item.name}"
        item.hardware_id = acquisition.source.description
    return statuses

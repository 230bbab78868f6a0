# SPDX-License-Identifier: Apache-2.0
"""Diagnostic statuses of the force measurement."""

import math
from collections.abc import Iterable

from diagnostic_msgs.msg import DiagnosticStatus

from scara_effmass.daq.acquisition import Acquisition, AcquisitionState
from scara_effmass.daq.conditioning import ForceChannel, SignalConditioner
from scara_effmass.impacts.detector import Detector
from scara_effmass.impacts.load import force_text
from scara_effmass.nodes.diagnostics import status
from scara_effmass.values import Impact

_LEVELS = {
    AcquisitionState.RUNNING: DiagnosticStatus.OK,
    AcquisitionState.ENDED: DiagnosticStatus.OK,
    AcquisitionState.WAITING: DiagnosticStatus.ERROR,
    AcquisitionState.FAILED: DiagnosticStatus.ERROR,
}


def impact_text(impact: Impact) -> str:
    """Return one line about an impact: peak, duration, impulse, and its flaws."""
    flags = {"clipped": impact.clipped, "incomplete": impact.incomplete}
    wrong = "".join(f", {name}" for name, is_set in flags.items() if is_set)
    size = f"{1e3 * impact.duration:.2f} ms, {impact.impulse:.3g} N s{wrong}"
    return f"{'simulated ' * impact.simulated}impact on {impact.frame_id}: peak {force_text(impact)}, {size}"


def daq_statuses(
    acquisition: Acquisition, signal: SignalConditioner, detections: Iterable[tuple[Detector, int]]
) -> list[DiagnosticStatus]:
    """Return the statuses of the source and of each channel, whose `detections` are detector and number of impacts."""
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


def _channel_status(channel: ForceChannel, detector: Detector, impacts: int) -> DiagnosticStatus:
    problem, level = "", None
    if channel.lost and not channel.samples:
        problem, level = f"no usable sample, {channel.lost} lost", DiagnosticStatus.ERROR
    elif channel.tare_problem:
        problem = channel.tare_problem
    elif channel.samples and not detector.settled:
        problem = "no steady baseline yet: impacts cannot be detected"
    elif detector.tensile_pulses:
        problem = f"{detector.tensile_pulses} tensile pulses: check sensor.invert"
    elif channel.saturated:
        problem = f"{channel.saturated} samples at the end of the measuring range"
    elif channel.lost:
        problem = f"{channel.lost} samples lost"
    values = {
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
    }
    for item in detector.left_out:
        values[f"left out: {item.reason}"] = f"{item.occurrences}, up to {item.peak_force:.1f} N"
    return status(f"channel {channel.name}", f"{impacts} impacts", values, problem=problem, level=level)

"""What `/diagnostics` says of the force measurement: the acquisition, and each channel."""

from __future__ import annotations

from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticStatus

from scara_effmass.daq.acquisition import AcquisitionState
from scara_effmass.nodes.diagnostics import status

if TYPE_CHECKING:
    from collections.abc import Sequence

    from scara_effmass.daq.acquisition import Acquisition, AcquisitionStatistics
    from scara_effmass.daq.conditioning import ForceChannel, SignalConditioner
    from scara_effmass.impacts.detector import Detector

_LEVELS = {
    AcquisitionState.RUNNING: DiagnosticStatus.OK,
    AcquisitionState.ENDED: DiagnosticStatus.OK,
    AcquisitionState.WAITING: DiagnosticStatus.ERROR,
    AcquisitionState.FAILED: DiagnosticStatus.ERROR,
}


class DaqHealth:
    """Puts what the rooms below count into statuses, and remembers who could not be connected."""

    def __init__(self, node: str) -> None:
        """Report for the node of that name."""
        self._node = node
        self._unmatched: set[str] = set()

    def incompatible(self, line: str) -> None:
        """Note an endpoint that could not be connected for its QoS."""
        self._unmatched.add(line)

    def statuses(
        self, acquisition: Acquisition, signal: SignalConditioner, found: Sequence[tuple[Detector, int]]
    ) -> list[DiagnosticStatus]:
        """Return the statuses for one report; `found` is each channel's detector and its number of impacts."""
        source = acquisition.source
        statuses = [self._source(acquisition.statistics(), acquisition, signal)]
        statuses += [self._channel(channel, *each) for channel, each in zip(signal.channels, found, strict=True)]
        for each in statuses:
            each.hardware_id = source.description
        return statuses

    def _source(
        self, statistics: AcquisitionStatistics, acquisition: Acquisition, signal: SignalConditioner
    ) -> DiagnosticStatus:
        source = acquisition.source
        level = _LEVELS.get(statistics.state, DiagnosticStatus.STALE)
        lost = statistics.samples_lost + statistics.samples_dropped
        message = statistics.reason or statistics.state.value
        if level == DiagnosticStatus.OK and statistics.reason:
            level = DiagnosticStatus.WARN
        elif level == DiagnosticStatus.OK and lost:
            level, message = DiagnosticStatus.WARN, f"{lost} samples lost"
        elif level == DiagnosticStatus.OK and signal.clock.restarts:
            level, message = DiagnosticStatus.WARN, f"a clock has jumped {signal.clock.restarts} times: stamps with it"
        elif level == DiagnosticStatus.OK and self._unmatched:
            level, message = DiagnosticStatus.WARN, "; ".join(sorted(self._unmatched))
        live = statistics.latency_p50_s == statistics.latency_p50_s  # NaN of a recording, whose time is its own
        return status(
            f"{self._node}: source",
            level,
            message,
            {
                "source": source.description,
                "simulated": source.simulated,
                "state": statistics.state.value,
                "rate asked [Hz]": f"{source.requested_rate:.9g}",
                "rate of the device [Hz]": f"{source.sample_rate:.9g}",
                "rate on the ROS clock [Hz]": f"{signal.clock.sample_rate:.9g}" if live else "as recorded",
                "clock residual [ms]": f"{1e3 * signal.clock.residual:.3f}" if live else "as recorded",
                "clock fits begun anew": signal.clock.restarts,
                "delay of the device's filter [ms]": f"{1e3 * source.filter_delay:.3f}",
                "samples read": statistics.samples_read,
                "samples lost by the device": statistics.samples_lost,
                "samples dropped, not published in time": statistics.samples_dropped,
                "samples waiting": statistics.samples_waiting,
                "reconnects": statistics.reconnects,
                "read latency p50 [ms]": f"{1e3 * statistics.latency_p50_s:.3f}" if live else "as recorded",
                "read latency max [ms]": f"{1e3 * statistics.latency_max_s:.3f}" if live else "as recorded",
                "incompatible QoS": "; ".join(sorted(self._unmatched)),
            },
        )

    def _channel(self, channel: ForceChannel, detector: Detector, impacts: int) -> DiagnosticStatus:
        level, message = DiagnosticStatus.OK, f"{impacts} impacts"
        if channel.lost and not channel.samples:
            level, message = DiagnosticStatus.ERROR, f"none of {channel.lost} samples could be used"
        elif channel.tare_problem:
            level, message = DiagnosticStatus.WARN, channel.tare_problem
        elif channel.samples and not detector.settled:
            level, message = DiagnosticStatus.WARN, "no steady baseline yet: impacts are not found"
        elif detector.tensile_pulses:
            level, message = (
                DiagnosticStatus.WARN,
                f"{detector.tensile_pulses} tensile pulses: check sensor.invert",
            )
        elif channel.saturated:
            level, message = DiagnosticStatus.WARN, f"{channel.saturated} samples at the end of the measuring range"
        elif channel.lost:
            level, message = DiagnosticStatus.WARN, f"{channel.lost} samples lost"
        return status(
            f"{self._node}: channel {channel.name}",
            level,
            message,
            {
                "samples published": channel.samples,
                "samples lost": channel.lost,
                "samples saturated": channel.saturated,
                "delay of the low-pass [ms]": f"{1e3 * channel.lowpass_delay:.3f}",
                "tare [N]": f"{channel.tare:.4g}",
                "tare found at [s]": f"{channel.tare_stamp_ns / 1e9:.6f}" if channel.tare_stamp_ns else "never",
                "taring": channel.taring,
                "tare refused": channel.tare_problem,
                "baseline known": detector.settled,
                "impacts": impacts,
                "drop-outs": detector.dropouts,
                "glitches": detector.glitches,
                "pushes": detector.sustained_contacts,
                "pulls like impacts": detector.tensile_pulses,
            },
        )

# SPDX-License-Identifier: Apache-2.0
"""`validator_node`: compare measured impacts with predictions from the contact states at their onsets."""

import time
from collections import Counter
from collections.abc import Callable, Collection, Iterable
from collections.abc import Set as AbstractSet
from functools import partial
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from scara_effmass_msgs.msg import ContactStates, ForceBlock, Impact, ImpactValidation, RunInfo

from scara_effmass import values
from scara_effmass.cell.status import MAX_IMPACTS, left_out_entry
from scara_effmass.errors import DecodeError, SettingsError
from scara_effmass.impacts.agreement import RegionForce, comparison_text
from scara_effmass.impacts.criterion import impact_count
from scara_effmass.impacts.detector import Detector
from scara_effmass.impacts.impact_matcher import DUPLICATE, REBOUND
from scara_effmass.impacts.load import READS_LOW, LeftOuts
from scara_effmass.impacts.validator import Validator
from scara_effmass.nodes import parameters
from scara_effmass.nodes.diagnostics import Diagnostics, no_publisher, several_publishers, status
from scara_effmass.nodes.latched_input import LatchedInput
from scara_effmass.nodes.lifecycle import LifecycleBase, run
from scara_effmass.settings import DetectionSettings, MonitorSettings, ValidatorSettings, checked
from scara_effmass.settings.loading import fixed
from scara_effmass.values import Decision, ValidatedImpact, at_least, at_most
from scara_effmass.wire import topics
from scara_effmass.wire.contact_states import decode_contact_states
from scara_effmass.wire.force import decode_force_block, decode_impact
from scara_effmass.wire.impact_validation import impact_validation_message
from scara_effmass.wire.run_info import decode_run_info

_WAIT_PERIOD_S = 0.1
"""Time between two looks for impacts that have waited too long for contact states."""


class NodeSettings(parameters.NodeParameters, ValidatorSettings):
    """Settings of the validation and of the node."""

    find_impacts: bool = fixed(
        default=False,
        description="detect impacts in the topic force, for a sender that does not publish the topic impact",
    )
    report_folder: str = fixed(
        "", "parent folder of the reports of ~/write_report; empty: validation, in the working directory"
    )
    robot: str = fixed("", "robot file of the monitor, named in the report; empty: the shipped Omron i4-550L")
    detection: DetectionSettings = DetectionSettings()


class ValidatorNode(LifecycleBase[NodeSettings]):
    """Match `impact` (or impacts detected in `force`) with `contact_states`; publish `impact_validation`."""

    def __init__(self) -> None:
        """Declare the parameters. Raises SettingsError for an invalid one."""
        super().__init__("validator", NodeSettings)
        self._validator = Validator(self.settings)

    def configure(self) -> None:
        """Create the endpoints."""
        settings = self.settings
        self._undecodable: Counter[str] = Counter()
        self._last_error = ""
        self._contact_points: set[str] = set()
        self._validator = Validator(settings)
        self._detector = Detector(settings.detection)
        self._publisher = self.create_owned_publisher(ImpactValidation, topics.IMPACT_VALIDATION, topics.STREAM_QOS)
        self._log = Diagnostics(self, self._statuses).log
        inputs: list[tuple[type, str, Callable[[bytes], Any], Callable[[Any], None]]] = [
            (ContactStates, topics.CONTACT_STATES, decode_contact_states, self._on_decision),
            (ForceBlock, topics.FORCE, decode_force_block, self._on_force),
        ]
        if not settings.find_impacts:
            inputs.append((Impact, topics.IMPACT, decode_impact, self._on_impact))
        for kind, topic, decode, take in inputs:
            self.create_owned_subscription(
                kind, topic, partial(self._on_message, decode, take), topics.VALIDATOR_INPUT_QOS, raw=True
            )
        LatchedInput(self, RunInfo, topics.RUN_INFO, topics.INFO_QOS, self._on_run_info, self._forget_obstacle)
        self.create_steady_timer(_WAIT_PERIOD_S, self._pass_time)
        self.create_owned_trigger("~/reset", self._reset)
        self.create_owned_trigger("~/write_report", self._write_report)

    def _on_message(self, decode: Callable[[bytes], Any], take: Callable[[Any], None], data: bytes) -> None:
        """Take a decoded message, or count it by its type, with which the error begins."""
        if not self.active:
            return
        try:
            message = decode(data)
        except DecodeError as error:
            self._last_error = str(error)
            self._undecodable[self._last_error.partition(":")[0]] += 1
        else:
            take(message)

    def _on_decision(self, decision: Decision) -> None:
        if not decision.watchdog:
            self._contact_points.update(contact.contact_point for contact in decision.contacts)
        self._publish(self._validator.add_decision(decision, self.now_ns()))

    def _pass_time(self) -> None:
        if self.active:
            self._publish(self._validator.pass_time(self.now_ns()))

    def _on_impact(self, impact: values.Impact) -> None:
        self._publish(self._validator.add_impact(impact, self.now_ns()))

    def _on_force(self, block: values.ForceBlock) -> None:
        self._validator.add_force(block, self.now_ns())
        if self.settings.find_impacts:
            for impact in self._detector.feed(block):
                self._on_impact(impact)
        elif block.is_unknown:  # daq_node publishes no impact of it
            stop = block.first_sample + len(block.force)
            self._detector.left_out.add_unknown(block.stamp_ns, block.first_sample, stop)
        self._validator.leave_out(self._detector.left_out)

    def _on_run_info(self, data: bytes) -> None:
        try:
            late = self._validator.begin_run(decode_run_info(data), self.now_ns())
        except (DecodeError, SettingsError) as error:
            self._forget_obstacle(f"{topics.RUN_INFO}: {error}")
            return
        if late:
            late_text = f"arrived after {impact_count(late)} of its run, left out of the series"
            self.get_logger().error(f"{topics.RUN_INFO}: {late_text}")

    def _forget_obstacle(self, reason: str) -> None:
        """Let the obstacle mass be unknown for `reason`: predictions would use that of another run."""
        self.get_logger().error(f"{reason}; the obstacle mass is not known until the next RunInfo")
        self._validator.runs.forget_obstacle(self.now_ns())

    def _publish(self, impacts: Iterable[ValidatedImpact]) -> None:
        for impact in impacts:
            self._publisher.publish(impact_validation_message(impact))
            self._log.event(
                impact_text(impact), DiagnosticStatus.ERROR if impact.exceeds_limit else DiagnosticStatus.OK
            )

    def _statuses(self) -> list[DiagnosticStatus]:
        contact_points, self._contact_points = self._contact_points, set()
        force = (topics.FORCE, "ForceBlock") if self.settings.find_impacts else (topics.IMPACT, "Impact")
        inputs = ((topics.CONTACT_STATES, "ContactStates"), force)
        unheard = [
            several_publishers(self, topic) or no_publisher(self, topic, f"scara_effmass_msgs/msg/{kind}")
            for topic, kind in inputs
        ]
        unheard.append(several_publishers(self, topics.IMPACT_VALIDATION))  # another validator
        return [
            series_status(
                self._validator,
                self._undecodable,
                unheard="; ".join(filter(None, unheard)),
                example=self._last_error,
                contact_points=contact_points,
                robot=Path(self.settings.robot or "omron_i4_550l").stem,
            )
        ]

    def _reset(self) -> str:
        count = len(self._validator.result().impacts)
        self._validator.reset()
        self._detector.left_out = LeftOuts()
        self._undecodable.clear()
        return f"new series started; the previous one had {impact_count(count)}"

    def _write_report(self) -> str:
        """Write the report of the series; return the path of its page. Raises OutputError, RobotError."""
        from scara_effmass.analysis import validation_report  # noqa: PLC0415 - draws, only when it is asked for
        from scara_effmass.analysis.report import PAGE  # noqa: PLC0415
        from scara_effmass.analysis.validation import Validation, ValidationSettings  # noqa: PLC0415
        from scara_effmass.model.load import load_robot  # noqa: PLC0415

        settings = self.settings
        monitor = checked(MonitorSettings, {"robot": settings.robot}, "validator")
        stated = settings.model_dump(include=set(ValidatorSettings.model_fields))
        validator = checked(ValidatorSettings, stated, "validator")
        report_settings = ValidationSettings(monitor=monitor, validator=validator, detection=settings.detection)
        robot = load_robot(monitor.robot_path, monitor)
        validation = Validation(self._validator.result(), (), no_motion="the series was live")
        # Not the node's clock, which stands still after a replay, and is the same in the next one.
        folder = Path(settings.report_folder or "validation").resolve() / f"{time.time():.3f}"
        validation_report.write_report(validation, report_settings, robot, folder, overwrite=False)
        return str(folder / PAGE)

    def apply_settings(self, changed: AbstractSet[str]) -> None:
        """Use the parameters `changed`: the others must not override later run information."""
        names = {"obstacle_mass": "obstacle_mass", "configuration": "configuration", "plate_normal": "normal"}
        changes = {field: getattr(self.settings, field) for name, field in names.items() if name in changed}
        if changes:
            self._validator.runs.set(self.now_ns(), **changes)


def impact_text(impact: ValidatedImpact) -> str:
    """Return one line about an impact: measured and predicted peak, and the limit of the body region."""
    simulated = "simulated impact" if impact.simulated else "impact"
    force = (
        f"peak {impact.measured_force:.1f} N, predicted {impact.predicted_force:.1f} N ({impact.relative_error:+.1%})"
    )
    return f"{simulated}: {force}; {comparison_text(impact)}; {impact.series.count} in the series"


def _force_text(worst: RegionForce) -> str:
    return f"{at_least(worst.force, 1)} N of {at_most(worst.limit, 1)} N on {worst.region}"


def series_status(
    validator: Validator,
    undecodable: Counter[str],
    *,
    contact_points: Collection[str],
    robot: str,
    unheard: str = "",
    example: str = "",
) -> DiagnosticStatus:
    """Return the status of the series.

    Its message has every problem, the most serious one first. `contact_points` are those assessed since the last
    report, not by the watchdog. `undecodable` counts messages by type since the last reset, and `example` is the error
    of the last one. `unheard` says that an input has no publisher, or that a topic has several.
    """
    result = validator.result()
    selected, fit = next((model.overall, model.fit) for model in result.models if model.model == result.model)
    problems = []
    if result.held.exceedances:
        problems.append(f"held force above a limit: {_force_text(result.held.worst)}")
    if result.left_out.exceedances:
        problems.append(f"left out of the series and above a limit: {_force_text(result.left_out.worst)}")
    if result.unmeasured:
        problems.append(
            f"{result.unmeasured} contacts clipped, incomplete, stuck or without signal: their force is not known"
        )
    if result.ac_coupled:
        problems.append(READS_LOW)
    problems += [result.clock, result.force_sign, unheard]
    if unpaired := sum(result.unpaired.values()):
        problems.append(f"{impact_count(unpaired)} could not be paired: {', '.join(result.unpaired)}")
    if result.contact_point not in contact_points:
        others = ", ".join(sorted(contact_points))
        problems.append(
            f"no contact states of {result.contact_point}, only of {others}" if others else "no contact states"
        )
    if result.waiting:
        problems.append(f"waiting for contact states: {impact_count(result.waiting)}")
    if undecodable:
        problems.append(f"{undecodable.total()} undecodable messages, the last one: {example}")
    values: dict[str, object] = {
        "model": result.model,
        "contact point": result.contact_point,
        "obstacle mass [kg]": f"{validator.runs.latest.obstacle_mass:.6g}",
        "impacts seen": result.seen,
        "impacts in the series": len(result.impacts),
        "impacts waiting": result.waiting,
        "of these simulated": result.simulated,
        "accepted": result.accepted,
        "decidable": result.decidable,
        "reason": result.reason,
        "criterion hash": result.criterion_hash,
        "correlation": selected.correlation_reason or f"{selected.correlation:.5f}",
        "fitted stiffness [N/m]": f"{selected.fitted_stiffness:.6g}",
        "mass scale": f"{fit.mass_scale:.4g} ({fit.mass_scale_interval.low:.4g} to {fit.mass_scale_interval.high:.4g})",
        "gain of the force": f"{fit.gain:.4g} ({fit.gain_interval.low:.4g} to {fit.gain_interval.high:.4g})",
        "clock offset [s]": f"{result.clock_offset.offset:.4g}",
        "impacts above the limit": result.exceedances,
        "contacts of unknown force": result.unmeasured,
        "contacts that held": result.held.contacts,
        "contacts that held above the limit": result.held.exceedances,
        "bias [N]": f"{selected.bias:.4g}",
        "rmse [N]": f"{selected.rmse:.4g}",
        "non-conservative": selected.non_conservative,
        "clocks": result.clock,
        "sign of force": result.force_sign,
        "contact states too late": result.late_states,
        "undecodable messages": undecodable.total(),
    }
    groups = (("excluded", result.excluded), ("not paired", result.unpaired), ("undecodable", undecodable))
    for group, counts in groups:
        values |= {f"{group}: {name}": count for name, count in sorted(counts.items())}
    left_out = [impact for impact in result.refused if impact.reason not in {REBOUND, DUPLICATE}][-MAX_IMPACTS:]
    values |= {
        left_out_entry(impact.stamp_ns): ": ".join(filter(None, (impact.reason, impact.detail))) for impact in left_out
    }
    message = f"{impact_count(len(result.impacts))}, {result.verdict}"
    return status("series", message, values, problem="; ".join(filter(None, problems)), hardware_id=robot)


main = partial(run, "validator", ValidatorNode)

"""`validator_node`: compare measured impacts with predictions from the contact states at their onsets."""

from collections.abc import Callable, Iterable, Sequence
from collections.abc import Set as AbstractSet
from functools import partial
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticStatus
from pydantic import Field
from rclpy.event_handler import QoSMessageLostInfo
from scara_effmass_msgs.msg import ContactState, ForceBlock, Impact, ImpactValidation, RunInfo
from std_msgs.msg import String
from std_srvs.srv import Trigger

from scara_effmass import values
from scara_effmass.errors import DecodeError, EffmassError, SettingsError
from scara_effmass.impacts.detector import Detector
from scara_effmass.impacts.result import Result
from scara_effmass.impacts.validator import Validator
from scara_effmass.nodes import parameters
from scara_effmass.nodes.diagnostics import Diagnostics
from scara_effmass.nodes.lifecycle import LifecycleBase, run
from scara_effmass.nodes.qos import qos_profile
from scara_effmass.nodes.validator_health import ValidatorHealth
from scara_effmass.settings import READ_ONLY, DetectionSettings, ValidatorSettings, checked
from scara_effmass.values import ValidatedImpact
from scara_effmass.wire import topics
from scara_effmass.wire.contact_state import contact_from
from scara_effmass.wire.force import decode_force_block, decode_impact
from scara_effmass.wire.run_info import decode_run_info, run_info_from_json

WriteReport = Callable[[Result, "NodeSettings", Path], Path]

_NS = 1_000_000_000
_COMMON_FIELDS = (
    *("predicted_force", "measured_force", "relative_error", "effective_mass", "reduced_mass", "speed", "stiffness"),
    *("conservative", "count", "correlation", "fitted_stiffness", "bias", "rmse", "non_conservative", "accepted"),
    "reason",
)
"""Fields that `ImpactValidation` and `ValidatedImpact` share."""


class NodeSettings(ValidatorSettings):
    """Settings of the validation and of the node."""

    autostart: bool = Field(default=True, description="configure and activate at start", json_schema_extra=READ_ONLY)
    find_impacts: bool = Field(
        default=False,
        description="detect impacts in the topic force, for a sender that does not publish the topic impact",
        json_schema_extra=READ_ONLY,
    )
    report_folder: str = Field(
        "",
        description="parent folder of the reports of ~/write_report; empty: validation, in the working directory",
        json_schema_extra=READ_ONLY,
    )
    robot: str = Field(
        "",
        description="robot file of the monitor, named in the report; empty: the shipped Omron i4-550L",
        json_schema_extra=READ_ONLY,
    )
    detection: DetectionSettings = DetectionSettings()


class ValidatorNode(LifecycleBase):
    """Match `impact` (or impacts detected in `force`) with `contact_state`; publish `impact_validation`."""

    def __init__(self, write_report: WriteReport | None = None) -> None:
        """Declare the parameters; `write_report` writes the report. Raises SettingsError."""
        super().__init__("validator")
        settings = checked(NodeSettings, parameters.declare(self, NodeSettings), self.get_name())
        self.autostart = settings.autostart
        self._settings = settings
        self._write_report = write_report
        parameters.on_parameters_changed(self, lambda: self._settings, self._apply)
        self._validator: Validator | None = None

    def configure(self) -> None:
        """Create the endpoints."""
        settings = self._settings
        self._health = ValidatorHealth(self.get_name())
        self._validator = Validator(settings)
        self._detector = Detector(settings.detection)
        self._publisher = self.create_owned_publisher(
            ImpactValidation, topics.IMPACT_VALIDATION, topics.STREAM_QOS, self._health.incompatible
        )
        Diagnostics(self, self._statuses)
        self._subscribe(ContactState, topics.CONTACT_STATE, self._on_contact_state, raw=False)
        if not settings.find_impacts:
            self._subscribe(Impact, topics.IMPACT, self._on_impact, raw=True)
        self._subscribe(ForceBlock, topics.FORCE, self._on_force, raw=True)
        for kind, topic, callback in (
            (RunInfo, topics.RUN_INFO, self._on_run_info),
            (String, topics.RECORDING_INFO, self._on_recording_info),
        ):
            qos = qos_profile(topics.INFO_QOS)
            subscription = self.create_subscription(kind, topic, callback, qos, raw=kind is RunInfo)
            self.own(subscription, self.destroy_subscription)
        self.own(self.create_service(Trigger, "~/reset", self._on_reset), self.destroy_service)
        self.own(self.create_service(Trigger, "~/write_report", self._on_write_report), self.destroy_service)

    def _subscribe(self, message_type: type, topic: str, callback: Callable[..., None], *, raw: bool) -> None:
        qos, on_incompatible = topics.VALIDATOR_INPUT_QOS, self._health.incompatible
        on_lost = partial(self._on_lost, topic)
        self.create_owned_subscription(
            message_type, topic, callback, qos, on_incompatible, raw=raw, message_lost=on_lost
        )

    def _on_lost(self, topic: str, lost: QoSMessageLostInfo) -> None:
        self._health.lose(topic, lost.total_count)

    def _now_ns(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def _on_contact_state(self, message: ContactState) -> None:
        if self.active and self._validator is not None:
            self._publish(self._validator.add_state(contact_from(message), self._now_ns()))

    def _on_impact(self, data: bytes) -> None:
        if not self.active or self._validator is None:
            return
        try:
            self._publish(self._validator.add_impact(decode_impact(data), self._now_ns()))
        except DecodeError as error:
            self._health.undecodable(str(error))

    def _on_force(self, data: bytes) -> None:
        if not self.active or self._validator is None:
            return
        try:
            block = decode_force_block(data)
        except DecodeError as error:
            self._health.undecodable(str(error))
            return
        self._validator.add_force(block, self._now_ns())
        if self._settings.find_impacts:
            for impact in self._detector.feed(block):
                self._publish(self._validator.add_impact(impact, self._now_ns()))

    def _on_run_info(self, data: bytes) -> None:
        try:
            self._begin_run(decode_run_info(data))
        except DecodeError as error:
            self._refuse_run(error)

    def _on_recording_info(self, message: String) -> None:
        """Read run information in the JSON format of older recordings; ignore other text."""
        if info := run_info_from_json(message.data):
            self._begin_run(info)

    def _begin_run(self, info: values.RunInfo) -> None:
        if self._validator is None:
            return
        try:
            self._validator.set_run_info(info, self._now_ns())
        except SettingsError as error:
            self._refuse_run(error)

    def _refuse_run(self, error: EffmassError) -> None:
        """Set the obstacle mass to unknown, so that no prediction uses the mass of another run."""
        self.get_logger().error(f"{topics.RUN_INFO}: {error}; the obstacle mass is not known until the next RunInfo")
        if self._validator is not None:
            self._validator.forget_obstacle(self._now_ns())

    def _publish(self, impacts: Iterable[ValidatedImpact]) -> None:
        for impact in impacts:
            message = ImpactValidation(**{name: getattr(impact, name) for name in _COMMON_FIELDS})
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(impact.stamp_ns, _NS)
            message.header.frame_id = impact.frame_id
            self._publisher.publish(message)

    def _statuses(self) -> list[DiagnosticStatus]:
        validator = self._validator
        return self._health.statuses(validator.result(), validator.obstacle_mass) if validator is not None else []

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._validator is not None:
            count = len(self._validator.result().impacts)
            self._validator.reset()
            response.success = True
            response.message = f"new series started; the previous one had {count} impacts"
        return response

    def _on_write_report(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._validator is None or self._write_report is None:
            response.message = "the node is not configured, or runs without a report writer"
            return response
        folder = Path(self._settings.report_folder or "validation") / f"{self._now_ns() / _NS:.3f}"
        try:
            response.message = str(self._write_report(self._validator.result(), self._settings, folder))
            response.success = True
        except EffmassError as error:
            response.message = str(error)
        return response

    def _apply(self, settings: NodeSettings, names: AbstractSet[str]) -> None:
        self._settings = settings
        # Unchanged parameters must not override later run information.
        changes = {name: getattr(settings, name) for name in ("obstacle_mass", "configuration") if name in names}
        if changes and self._validator is not None:
            self._validator.set_run(self._now_ns(), **changes)


def main(args: Sequence[str] | None = None, write_report: WriteReport | None = None) -> int:
    """Run the node with the ROS arguments `args`; default: those of the process."""
    return run(partial(ValidatorNode, write_report), args)

# SPDX-License-Identifier: Apache-2.0
"""`visualization_node`: markers of the robot, its effective masses and verdicts, for RViz and Foxglove."""

import time
from collections import deque
from collections.abc import Iterator
from collections.abc import Set as AbstractSet
from contextlib import suppress
from functools import partial

from scara_effmass_msgs.msg import ContactStates, RunInfo
from sensor_msgs.msg import JointState
from visualization_msgs.msg import Marker, MarkerArray

from scara_effmass import values
from scara_effmass.cell.status import CellStatus
from scara_effmass.codes import Reason
from scara_effmass.errors import DecodeError
from scara_effmass.model.hulls import triangles
from scara_effmass.model.poses import pose_geometry
from scara_effmass.model.robot import Robot
from scara_effmass.nodes.lifecycle import run
from scara_effmass.nodes.markers import contact_markers, robot_markers, stamped
from scara_effmass.nodes.robot_input import RobotNode, RobotParameters
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import unknown_assessments, unknown_contact
from scara_effmass.safety.joint_state_adapter import JointStateAdapter
from scara_effmass.settings.loading import fixed, tunable
from scara_effmass.values import Decision, FloatArray, Vector3
from scara_effmass.wire import topics
from scara_effmass.wire.cdr import NS
from scara_effmass.wire.contact_states import decode_contact_states
from scara_effmass.wire.joint_state import JointStateDecoder
from scara_effmass.wire.run_info import decode_run_info

Received = deque[tuple[bytes, int]]
"""Serialized messages, each with the monotonic time of its arrival [ns]."""

_NO_ROBOT_FRAME = "base_link"
_LIFETIME_PERIODS = 5
_JOINT_STATES = 8
"""Joint states kept: the latest one may belong to another device."""
_CONTACT_STATES = 256


class NodeSettings(RobotParameters):
    """Settings of the node and of the monitor. Of the latter, only those of the robot and `timeout` have an effect."""

    rate: float = fixed(20.0, "number of marker arrays per second [Hz]", ge=0.5, le=100.0)
    ellipsoid_scale: float = tunable(
        0.05, "semi-axis of the mass ellipsoid at 1 kg; it grows with the root of the mass [m]", ge=0.0, le=1.0
    )
    arrow_scale: float = tunable(
        0.25, "length of the arrows of velocity and allowable speed at 1 m/s [m]", ge=0.0, le=10.0
    )


class VisualizationNode(RobotNode[NodeSettings]):
    """Subscribes to `joint_states` and `contact_states`, best effort; publishes `effective_mass_markers`."""

    def __init__(self) -> None:
        """Declare the parameters. Raises SettingsError for an invalid one."""
        super().__init__("visualization", NodeSettings)
        self._dynamics: RobotDynamics | None = None
        self._triangles: dict[str, FloatArray] = {}
        """Those of each hull, in the frame of its joint."""

    def configure(self) -> None:
        """Load the robot and create the endpoints. Raises EffmassError."""
        self._simulated = False
        self._joint_states: Received = deque(maxlen=_JOINT_STATES)
        self._contact_states: Received = deque(maxlen=_CONTACT_STATES)
        self._decoder = JointStateDecoder()
        self._status = CellStatus(time.monotonic_ns())
        self._shown: set[tuple[str, int]] = set()
        self.refuse_robot("")
        self._distrusted = ""
        self.await_robot()
        self._markers = self.create_owned_publisher(MarkerArray, topics.MARKERS, topics.Qos(10))
        best_effort = topics.STREAM_QOS._replace(reliable=False)  # the monitor waits for no acknowledgement
        for kind, topic, received in (
            (JointState, topics.JOINT_STATES, self._joint_states),
            (ContactStates, topics.CONTACT_STATES, self._contact_states),
        ):
            self.create_owned_subscription(kind, topic, partial(_keep, received), best_effort, raw=True)
        self.create_owned_subscription(RunInfo, topics.RUN_INFO, self._on_run_info, topics.INFO_QOS, raw=True)
        self.create_steady_timer(1.0 / self.settings.rate, self._publish)
        self.create_status_timer(self._log_status)

    def use_robot(self, robot: Robot) -> None:
        """Draw `robot`."""
        self._adapter = JointStateAdapter(robot.joint_names, self.settings)
        self._dynamics, self._triangles = RobotDynamics(robot), {}
        if robot.hulls:
            self._triangles = {name: triangles(vertices) for name, vertices in robot.hulls.items()}

    def refuse_robot(self, reason: str) -> None:
        """Draw no robot for `reason`."""
        self._dynamics, self._no_robot_reason = None, reason

    def distrust_robot(self, reason: str) -> None:
        """Draw no robot for `reason` while it is not empty."""
        self._distrusted = reason

    def check_settings(self, settings: NodeSettings) -> None:
        """Raise RobotError for an impossible load."""
        if self._dynamics is not None:
            self._dynamics.with_payload(settings)

    def apply_settings(self, changed: AbstractSet[str]) -> None:  # noqa: ARG002 - the load may be among them
        """Take the load of the settings."""
        if self._dynamics is not None:
            self._dynamics = self._dynamics.with_payload(self.settings)

    def _on_run_info(self, data: bytes) -> None:
        with suppress(DecodeError):  # the validator reports it
            self._simulated = decode_run_info(data).simulated

    def _publish(self) -> None:
        if not self.active:
            return
        markers = list(self._current())
        shown = {(marker.ns, marker.id) for marker in markers}
        gone = [Marker(ns=name, id=number, action=Marker.DELETE) for name, number in self._shown - shown]
        self._markers.publish(MarkerArray(markers=[*gone, *markers]))
        self._shown = shown

    def _log_status(self) -> None:
        viewers = self._markers.get_subscription_count()
        self.get_logger().info(f"{self._status.verdict.name}, markers: {len(self._shown)}, viewers: {viewers}")

    def _current(self) -> Iterator[Marker]:
        """Yield the markers of the latest states."""
        settings, dynamics = self.settings, self._dynamics
        stamp = partial(
            stamped,
            frame=dynamics.robot.base_frame if dynamics is not None else _NO_ROBOT_FRAME,
            lifetime_ns=round(_LIFETIME_PERIODS / settings.rate * NS),
        )
        decision = self._decision()
        contacts = list(decision.contacts)
        pose = self._distrusted or (self._pose() if dynamics is not None else self._no_robot_reason)
        places: dict[str, Vector3] = {}
        surfaces: dict[str, FloatArray] = {}
        if dynamics is None or isinstance(pose, str):
            contacts.append(unknown_contact("", str(pose)))
        else:
            geometry = pose_geometry(dynamics.robot, dynamics.lumped, pose.position)
            places = geometry.places(contacts)
            for name, pose_of_hull in geometry.hulls.items():
                surfaces[name] = self._triangles[name] @ pose_of_hull.rotation.T + pose_of_hull.translation
            for marker in robot_markers(geometry):
                yield stamp(marker, stamp_ns=pose.stamp_ns)
        scales = {"ellipsoid_scale": settings.ellipsoid_scale, "arrow_scale": settings.arrow_scale}
        normal, simulated = decision.contact_normal, self._simulated
        for marker in contact_markers(contacts, places, normal, surfaces, simulated=simulated, **scales):
            yield stamp(marker, stamp_ns=decision.stamp_ns)

    def _pose(self) -> values.JointState | str:
        """Return the latest joint state with the positions in the robot's order, or why there is none."""
        reason = "no joint state"
        oldest_ns = time.monotonic_ns() - self._status.timeout_ns
        for data, at_ns in reversed(self._joint_states):
            try:
                state = self._decoder.decode(data)
            except DecodeError as error:
                reason = str(error)
                continue
            q = self._adapter.positions(state) if at_ns >= oldest_ns else reason
            if not isinstance(q, str):
                return state._replace(position=q)
            reason = q
        return reason

    def _decision(self) -> Decision:
        """Return the latest decision, or UNKNOWN at its contact points without messages of the monitor."""
        status = self._status
        for data, at_ns in self._contact_states:
            with suppress(DecodeError):  # no news, as silence
                status.take_decision(decode_contact_states(data), at_ns)
        self._contact_states.clear()
        deadline_s = topics.verdict_qos(self.settings.timeout).deadline_s
        status.take_publisher(round(deadline_s * NS), exists=bool(self.count_publishers(topics.CONTACT_STATES)))
        status.update(time.monotonic_ns())
        decision = status.decision
        if decision is not None and (status.verdict, status.reason) == (decision.verdict, decision.reason):
            return decision
        names = tuple(contact.contact_point for contact in status.contacts) or ("",)
        return unknown_assessments(Reason.STATED, status.reason, points=names).decision(0)


def _keep(received: Received, data: bytes) -> None:
    received.append((data, time.monotonic_ns()))


main = partial(run, "visualization", VisualizationNode)

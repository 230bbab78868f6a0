# SPDX-License-Identifier: Apache-2.0
"""`visualization_node`: markers of a cell for RViz and Foxglove: links, lumped masses, contact points with verdicts.

Everything is drawn in the base frame, so a viewer needs neither a robot description nor transforms.
"""

import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from collections.abc import Set as AbstractSet
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, Quaternion, Vector3
from scara_effmass_msgs.msg import ContactStates, RunInfo
from sensor_msgs.msg import JointState
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from scara_effmass import values
from scara_effmass.cell.status import CellStatus
from scara_effmass.codes import Reason
from scara_effmass.errors import DecodeError
from scara_effmass.model.hulls import triangles
from scara_effmass.model.poses import PoseGeometry, mass_ellipsoid, pose_geometry, quaternion
from scara_effmass.model.robot import Robot
from scara_effmass.nodes.lifecycle import run
from scara_effmass.nodes.robot_input import RobotNode, RobotParameters
from scara_effmass.reference import RobotDynamics
from scara_effmass.reference.mobility import Mobility
from scara_effmass.safety import unknown_assessments, unknown_contact
from scara_effmass.safety.joint_state_adapter import JointStateAdapter
from scara_effmass.settings.loading import fixed, tunable
from scara_effmass.values import (
    NO_MOBILITY,
    VERDICT_COLORS,
    ZERO_VECTOR,
    ContactAssessment,
    Decision,
    FloatArray,
    Verdict,
    mobility_matrix,
)
from scara_effmass.wire import topics
from scara_effmass.wire.cdr import NS, sec_and_nanosec
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
LINK_COLOR = "#9AA5B1"
MASS_COLOR = "#56B4E9"
ALLOWABLE_COLOR = "#0072B2"
NORMAL_COLOR = "#CC79A7"
LINK_WIDTH_M = 0.02
MASS_DENSITY = 7850.0
"""Density [kg/m3] of the spheres of the lumped masses: that of steel."""
MAX_MASS = 10.0
"""Largest mass [kg] of an axis of the ellipsoid: where no joint moves the contact point, the mass is infinite."""
HULL_ALPHA = 0.35
NORMAL_LENGTH_M = 0.15
TEXT_HEIGHT_M = 0.04
TEXT_LIFT_M = 0.2


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
        self._dynamics = RobotDynamics(robot)
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
        places: dict[str, values.Vector3] = {}
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


def robot_markers(geometry: PoseGeometry) -> Iterator[Marker]:
    """Yield the links as lines, and the lumped masses as spheres of steel of that mass."""
    links = geometry.segments.reshape(-1, 3)
    yield _marker(Marker.LINE_LIST, "links", 0, LINK_COLOR, (LINK_WIDTH_M, 0.0, 0.0), points=links)
    for index, (mass, place) in enumerate(geometry.lumped_masses):
        diameter = (6.0 * max(mass, 0.0) / (np.pi * MASS_DENSITY)) ** (1.0 / 3.0)
        if diameter:
            yield _marker(Marker.SPHERE, "lumped_masses", index, MASS_COLOR, (diameter,) * 3, place)


def contact_markers(
    contacts: Iterable[ContactAssessment],
    places: Mapping[str, tuple[float, float, float]],
    contact_normal: str,
    surfaces: Mapping[str, FloatArray],
    *,
    ellipsoid_scale: float,
    arrow_scale: float,
    simulated: bool,
) -> Iterator[Marker]:
    """Yield what is known of each contact: verdict, hull, mass ellipsoid, velocity, allowable speed, worst normal.

    `contact_normal` is that of the decision. `places` are the positions [m] of the contact points; others only have
    a text above the base, and UNKNOWN only its text and hull. `surfaces` are the triangles (T, 3, 3) [m] of hulls. The
    ellipsoid has a semi-axis of `ellipsoid_scale` [m] at 1 kg, an arrow `arrow_scale` [m] at 1 m/s. Texts of contact
    points at the same place are stacked, so that none covers another.
    """
    drawn: list[FloatArray] = []
    for index, contact in enumerate(contacts):
        color = VERDICT_COLORS[contact.verdict]
        x, y, z = places.get(contact.contact_point, (0.0, 0.0, index * TEXT_LIFT_M))
        at = np.array([x, y, z])
        lift = TEXT_LIFT_M * (1 + sum(np.linalg.norm(at - other) < TEXT_HEIGHT_M for other in drawn))
        drawn.append(at)
        text = (x, y, z + (lift if z > -TEXT_LIFT_M else -lift))  # away from the base
        label = _label(contact, simulated=simulated)
        yield _marker(Marker.TEXT_VIEW_FACING, "verdict", index, color, (0.0, 0.0, TEXT_HEIGHT_M), text, text=label)
        if contact.contact_point in surfaces:
            corners = surfaces[contact.contact_point].reshape(-1, 3)
            yield _marker(Marker.TRIANGLE_LIST, "hulls", index, color, (1.0,) * 3, alpha=HULL_ALPHA, points=corners)
        is_finite = np.isfinite([*contact.direction, *contact.mobility]).all()
        if contact.verdict is Verdict.UNKNOWN or contact.contact_point not in places or not is_finite:
            continue
        direction, mobility = np.array(contact.direction), mobility_matrix(contact.mobility)
        if contact.mobility != NO_MOBILITY:
            masses, axes = mass_ellipsoid(mobility, MAX_MASS)
            sizes = 2.0 * ellipsoid_scale * np.sqrt(masses)
            ellipsoid = _marker(Marker.SPHERE, "mass_ellipsoid", index, color, sizes.tolist(), (x, y, z), alpha=0.4)
            ellipsoid.pose.orientation = Quaternion(**dict(zip("xyzw", quaternion(axes), strict=True)))
            yield ellipsoid
        if contact.direction == ZERO_VECTOR:
            continue
        velocity, allowable = (arrow_scale * v * direction for v in (contact.speed, contact.allowable_speed))
        yield _arrow("velocity", index, color, 0.012, at, velocity)
        if contact.allowable_speed > 0.0:
            yield _arrow("allowable_speed", index, ALLOWABLE_COLOR, 0.006, at, allowable)
        if contact_normal == "worst" and contact.mobility != NO_MOBILITY:
            alpha = 1.0 / contact.body_mass if contact.body_mass else 0.0
            normal = Mobility.of_matrix(mobility, direction, 3).worst_normal(alpha)
            yield _arrow("worst_normal", index, NORMAL_COLOR, 0.006, at, NORMAL_LENGTH_M * normal)


def stamped(marker: Marker, frame: str, stamp_ns: int, lifetime_ns: int) -> Marker:
    """Return `marker` in `frame`, with the stamp of its state; it vanishes after `lifetime_ns` without another one."""
    marker.header.frame_id = frame
    marker.header.stamp.sec, marker.header.stamp.nanosec = sec_and_nanosec(stamp_ns)
    marker.lifetime.sec, marker.lifetime.nanosec = divmod(lifetime_ns, NS)
    return marker


def _label(contact: ContactAssessment, *, simulated: bool) -> str:
    title = f"{contact.contact_point or 'robot'}: {contact.verdict.name}{' (simulated)' * simulated}"
    if contact.verdict is Verdict.UNKNOWN:
        return f"{title}\n{contact.reason}"
    numbers = f"{contact.speed_text}, {contact.effective_mass:.2f} kg ({contact.mass_model})"
    return f"{title}\n{numbers}\n{contact.reason}".strip()


def _arrow(namespace: str, index: int, color: str, width_m: float, at: FloatArray, vector: FloatArray) -> Marker:
    return _marker(Marker.ARROW, namespace, index, color, (width_m, 2.0 * width_m, 0.0), points=[at, at + vector])


def _marker(
    kind: int,
    namespace: str,
    index: int,
    color: str,
    scale: Iterable[float],
    at: tuple[float, float, float] = ZERO_VECTOR,
    *,
    alpha: float = 1.0,
    points: Iterable[FloatArray] = (),
    text: str = "",
) -> Marker:
    marker = Marker(type=kind, ns=namespace, id=index, text=text)
    marker.color = ColorRGBA(**_rgb(color), a=alpha)
    marker.scale = _xyz(Vector3, scale)
    marker.pose.position = _xyz(Point, at)
    marker.points = [_xyz(Point, point.tolist()) for point in points]
    return marker


def _xyz(kind: type, values: Iterable[float]) -> Any:  # noqa: ANN401 - geometry_msgs has no types
    return kind(**dict(zip("xyz", values, strict=True)))


def _rgb(color: str) -> dict[str, float]:
    return {name: int(color[at : at + 2], 16) / 255.0 for name, at in (("r", 1), ("g", 3), ("b", 5))}


main = partial(run, "visualization", VisualizationNode)

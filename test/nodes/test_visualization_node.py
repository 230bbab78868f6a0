# SPDX-License-Identifier: Apache-2.0
"""visualization_node over DDS: markers of the latest states, UNKNOWN without them."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from scara_effmass_msgs.msg import ContactStates, RunInfo
from std_msgs.msg import String
from visualization_msgs.msg import Marker, MarkerArray

from scara_effmass.model.load import load_robot
from scara_effmass.model.poses import pose_geometry
from scara_effmass.nodes.visualization_node import VisualizationNode
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Assessments, unknown_contact
from scara_effmass.share import share
from scara_effmass.values import RunInfo as RunInfoValue
from scara_effmass.values import Verdict
from scara_effmass.wire.contact_states import ContactStatesEncoder
from scara_effmass.wire.run_info import run_info_message
from test.decisions import assessments_of, decision_on
from test.nodes.conftest import DEEP_QOS, NodeHarness, Q, joint_state, stamp_ns

EXECUTABLE = str(Path(sys.executable).with_name("visualization_node"))
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
S = 1_000_000_000


def ok(stamp: int) -> Assessments:
    contact = unknown_contact("tool", "")._replace(
        verdict=Verdict.OK,
        direction=(0.0, 1.0, 0.0),
        speed=0.2,
        allowable_speed=0.5,
        effective_mass=1.0,
        mass_model="lumped",
        lumped_mobility=(1.0, 0.0, 0.0, 0.5, 0.0, 2.0),
    )
    return assessments_of(decision_on(contact, stamp_ns=stamp))


class Viewer:
    """A visualization node and what a viewer has received from it."""

    def __init__(self, harness: NodeHarness, *arguments: str) -> None:
        self.harness = harness
        self.arrays: list[MarkerArray] = []
        harness.start(*arguments, command=(EXECUTABLE,))
        harness.node.create_subscription(MarkerArray, "effective_mass_markers", self.arrays.append, DEEP_QOS)
        self.states = harness.node.create_publisher(ContactStates, "contact_states", DEEP_QOS)
        self.encoder = ContactStatesEncoder("base_link")

    def send(self) -> None:
        self.sent = joint_state()
        self.harness.send(self.sent)
        self.states.publish(self.encoder.encode(ok(stamp_ns(self.sent))))

    def until(
        self, done: Callable[[dict[str, Marker]], Any], repeat: Callable[[], object] | None = None
    ) -> dict[str, Marker]:
        """Return the markers of the first array from now on that is `done`, by name space and number."""
        self.arrays.clear()

        def first() -> dict[str, Marker] | None:
            for array in self.arrays:
                markers = {f"{marker.ns} {marker.id}": marker for marker in array.markers}
                if done(markers):
                    return markers
            return None

        markers: dict[str, Marker] = self.harness.spin_until(first, repeat=repeat)
        return markers


def test_markers_follow_the_states_and_become_unknown_without_them(new_harness: Callable[..., NodeHarness]) -> None:
    viewer = Viewer(new_harness(name="visualization"), "--ros-args", "-p", "timeout:=1.0", "-p", "rate:=50.0")
    markers = viewer.until(lambda shown: "velocity 0" in shown and "links 0" in shown, viewer.send)
    assert markers["verdict 0"].text.startswith("tool: OK\n")
    for marker in (marker for marker in markers.values() if marker.action == Marker.ADD):
        assert marker.header.frame_id == "base_link"
        assert 0 < stamp_ns(marker) <= stamp_ns(viewer.sent)
        assert (marker.lifetime.sec, marker.lifetime.nanosec) == (0, S // 10)
    dynamics = RobotDynamics(load_robot())
    geometry = pose_geometry(dynamics.robot, dynamics.lumped, np.array(Q))
    for index, (_, place) in enumerate(geometry.lumped_masses):
        at = markers[f"lumped_masses {index}"].pose.position
        assert (at.x, at.y, at.z) == pytest.approx(place)
    start = markers["velocity 0"].points[0]
    assert (start.x, start.y, start.z) == pytest.approx(geometry.contact_points["tool"])

    # The joint states end, then the monitor: nothing of the old pose stays.
    viewer.until(lambda shown: "links 0" in shown and shown["links 0"].action == Marker.DELETE)
    markers = viewer.until(lambda shown: "UNKNOWN" in shown["verdict 0"].text)
    assert markers.keys() == {"verdict 0", "verdict 1"}
    assert "the monitor is silent" in markers["verdict 0"].text or "no joint state" in markers["verdict 0"].text

    # They return.
    info = viewer.harness.node.create_publisher(RunInfo, "run_info", LATCHED)
    info.publish(run_info_message(RunInfoValue(simulated=True)))
    viewer.until(lambda shown: shown["verdict 0"].text.startswith("tool: OK (simulated)\n"), viewer.send)

    # A second monitor begins to count where the first one did not.
    second = viewer.harness.node.create_publisher(ContactStates, "contact_states", DEEP_QOS)

    second_encoder = ContactStatesEncoder("base_link")

    def send_both() -> None:
        viewer.send()
        second.publish(second_encoder.encode(ok(stamp_ns(viewer.sent))))

    viewer.until(lambda shown: "two monitors publish contact_states" in shown["verdict 0"].text, send_both)
    viewer.harness.node.destroy_publisher(second)
    viewer.harness.node.destroy_publisher(viewer.states)
    viewer.until(lambda shown: "no publisher" in shown["verdict 0"].text)


def test_robot_comes_from_its_description(new_harness: Callable[..., NodeHarness]) -> None:
    viewer = Viewer(new_harness(name="visualization"), "--ros-args", "-p", "await_robot_description:=true")
    viewer.until(lambda shown: any(m.text == "robot: UNKNOWN\nno robot_description yet" for m in shown.values()))
    descriptions = viewer.harness.node.create_publisher(String, "robot_description", LATCHED)
    descriptions.publish(String(data=share("config", "robots", "ur5_robot.urdf").read_text(encoding="utf-8")))
    joints = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
    names = [f"{joint}_joint" for joint in joints]

    def send() -> None:
        viewer.harness.send(joint_state(names=names, position=[0.1] * 6, velocity=[0.0] * 6))

    markers = viewer.until(lambda shown: "links 0" in shown, send)
    assert len(markers["links 0"].points) >= 12
    descriptions.publish(String(data="<robot/>"))
    viewer.until(lambda shown: shown.get("links 0", Marker()).action == Marker.DELETE, send)


def test_impossible_load_is_refused_and_a_possible_one_moves_the_masses(
    new_harness: Callable[..., NodeHarness],
) -> None:
    viewer = Viewer(new_harness(name="visualization"), "--ros-args", "-p", "rate:=50.0")
    before = viewer.until(lambda shown: "lumped_masses 4" in shown, viewer.send)["lumped_masses 4"].scale.x
    refusal = viewer.harness.set_parameters(payload_inertia=[0.1, 0.1, 0.1, 0.0, 0.0, 0.0])
    assert "must be 0 without payload_mass" in refusal
    assert viewer.harness.set_parameters(payload_mass=1.0) == ""
    viewer.until(
        lambda shown: "lumped_masses 4" in shown and shown["lumped_masses 4"].scale.x > 1.2 * before, viewer.send
    )


def test_unknown_parameter_is_refused(refusal_of: Callable[..., str]) -> None:
    assert refusal_of(VisualizationNode, "rate:=0.1").startswith("visualization: rate = 0.1: must be greater")

# SPDX-License-Identifier: Apache-2.0
"""Live payload: by topic from exactly one publisher, and by the parameter service at once."""

import time
from collections.abc import Callable

import numpy as np
from geometry_msgs.msg import Inertia, Vector3
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from scara_effmass_msgs.msg import ContactState, PayloadEstimate

from scara_effmass.codes import Reason
from scara_effmass.share import share
from scara_effmass.studies.load import Case, robot_of, simulated
from test.nodes.conftest import Answer, NodeHarness, joint_state

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def publisher_of(node: Node, mass: float) -> Publisher:
    """Return a latched publisher that has stated `mass`."""
    publisher = node.create_publisher(Inertia, "gripper/payload", LATCHED)
    publisher.publish(Inertia(m=mass, com=Vector3(z=0.1)))
    return publisher


def test_payload_comes_from_exactly_one_publisher(new_harness: Callable[..., NodeHarness]) -> None:
    harness = new_harness()
    first = publisher_of(harness.node, 2.0)  # before the monitor starts
    settings = ("-p", "release_time:=0.0", "-p", "timeout:=60.0")
    harness.start("--ros-args", *settings, "-r", "payload:=gripper/payload", "-p", "payload_topic:=payload")
    harness.subscribe()

    def until(condition: Callable[[Answer], bool]) -> Answer:
        harness.contact_states.clear()
        found: list[Answer] = []

        def matching() -> bool:
            found[:] = [contact for contact in harness.contact_states if condition(contact)]
            return bool(found)

        harness.spin_until(matching, repeat=lambda: harness.send(joint_state()))
        return found[0]

    def until_unknown(reason: str) -> None:
        contact = until(lambda contact: reason in contact.reason)
        assert (contact.verdict, contact.allowable_speed, contact.effective_mass) == (ContactState.UNKNOWN, 0.0, 0.0)

    heavy = until(lambda contact: contact.verdict == ContactState.OK)
    text = harness.diagnostic("model", "payload", lambda value: "topic" in value)
    assert text.endswith("| 0.25 kg (robot file) + 2 kg (topic payload)")
    first.publish(Inertia(m=4.0, com=Vector3(z=0.1)))
    heavier = until(lambda contact: contact.iso_mass > heavy.iso_mass + 1.9)
    assert heavier.full_mass > heavy.full_mass
    assert heavier.allowable_speed < heavy.allowable_speed
    first.publish(Inertia(m=-1.0))
    until_unknown("the payload is unknown: payload: payload_mass = -1.0: ")
    assert harness.diagnostic("model", "payload", lambda value: "-1.0" in value)
    first.publish(Inertia(m=2.0, com=Vector3(z=0.1)))
    until(lambda contact: contact.verdict == ContactState.OK)

    second = publisher_of(harness.node, 0.1)
    until_unknown("2 publishers of the payload on payload: must be one")
    harness.node.destroy_publisher(second)
    same = until(lambda contact: contact.verdict == ContactState.OK)
    assert (same.iso_mass, same.full_mass) == (heavy.iso_mass, heavy.full_mass)
    harness.node.destroy_publisher(first)
    until_unknown("no publishers of the payload on payload: must be one")
    harness.node.create_publisher(Inertia, "gripper/payload", 1)  # not latched
    until_unknown(
        "no publisher of the payload on payload fits: must be reliable and latched (durability transient_local)"
    )
    assert "a publisher of payload cannot be connected: its DURABILITY" in harness.diagnostic(
        "input", "incompatible QoS", bool
    )


def test_parameter_service_changes_the_whole_payload_at_once(harness: NodeHarness) -> None:
    def set_payload(mass: float, com: list[float], inertia: list[float]) -> str:
        values = {"payload_mass": mass, "payload_com": com, "payload_inertia": inertia}
        parameters = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        request = SetParametersAtomically.Request(parameters=parameters)
        result = harness.call_service(SetParametersAtomically, "set_parameters_atomically", request).result
        return "" if result.successful else str(result.reason)

    light = harness.response_to(joint_state())
    try:
        assert set_payload(2.5, [0.0, 0.0, 0.1], [0.1, 0.1, 0.1, 0.0, 0.0, 0.0]) == ""
        heavy = harness.response_to(joint_state())
        assert heavy.iso_mass > light.iso_mass + 2.4
        refusal = set_payload(0.1, [0.0, 0.0, 0.0], [0.1, 0.1, 0.5, 0.0, 0.0, 0.0])
        assert "violate the triangle inequality" in refusal
        unchanged = harness.response_to(joint_state())
        assert (unchanged.iso_mass, unchanged.full_mass) == (heavy.iso_mass, heavy.full_mass)
    finally:
        assert set_payload(0.0, [0.0, 0.0, 0.0], [0.0] * 6) == ""
    assert harness.response_to(joint_state()).full_mass == light.full_mass


def test_load_that_nobody_stated_shows_in_the_torques(new_harness: Callable[..., NodeHarness]) -> None:
    """Simulated joint states of a UR10 that carries 2 kg and states none."""
    case = Case("UR10", "ur10_robot.urdf", 2.0)
    robot = robot_of(case)
    states = simulated(robot, case, 2.0, 6.0, np.random.default_rng(1))
    path = str(share("config", "robots", "ur10_robot.urdf"))
    settings = ("-p", "timeout:=60.0", "-p", "release_time:=0.0", "-p", f"robot:={path}", "-p", "autostart:=true")
    harness = new_harness("--ros-args", *settings)
    harness.subscribe()
    estimates: list[PayloadEstimate] = []
    harness.node.create_subscription(PayloadEstimate, "payload_estimate", estimates.append, LATCHED)
    harness.spin_until(lambda: harness.node.count_subscribers("joint_states") == 1)
    start_ns = time.time_ns() - 7_000_000_000
    for stamp_ns, q, qd, effort in zip(*states, strict=True):
        message = joint_state(start_ns + int(stamp_ns - states.stamps[0]), robot.joint_names, q.tolist(), qd.tolist())
        message.effort = effort.tolist()
        harness.send(message)
    harness.spin_until(lambda: any(answer.reason_code == Reason.UNSTATED_LOAD for answer in harness.contact_states))
    answer = next(answer for answer in harness.contact_states if answer.reason_code == Reason.UNSTATED_LOAD)
    assert (answer.verdict, answer.allowable_speed) == (ContactState.UNKNOWN, 0.0)
    assert "not the stated 0.00 kg" in answer.reason
    harness.spin_until(lambda: 1.0 < estimates[-1].mass < 3.0)  # the first ones rest on few joint states
    last = estimates[-1]
    assert last.mass_lower < last.mass < last.mass_upper
    assert (last.stated_mass, last.is_observable) == (0.0, True)
    assert last.header.frame_id == "wrist_3_link"
    assert list(last.joint_names) == list(robot.joint_names)
    assert len(last.coulomb_friction) == len(last.viscous_friction) == len(last.effort_error) == 6
    assert harness.diagnostic("model", "load by the torques", lambda value: " kg (" in value)

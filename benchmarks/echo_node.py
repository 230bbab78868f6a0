# SPDX-License-Identifier: Apache-2.0
"""Bare node for comparison: the monitor's message types in and out, without any computation.

With the argument "verdict_qos" it offers what the monitor does: deadline, lease and lifespan, which cost Fast DDS
timers at each message.
"""

from __future__ import annotations

import sys

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.task import Future
from scara_effmass_msgs.msg import ContactState, ContactStates
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from scara_effmass.nodes.ros import qos_profile
from scara_effmass.settings import MonitorSettings
from scara_effmass.wire.topics import SCALAR_LIFESPAN_S, verdict_qos

IN = QoSProfile(reliability=ReliabilityPolicy.BEST_EFFORT, history=HistoryPolicy.KEEP_LAST, depth=200)
OUT = SCALARS = QoSProfile(reliability=ReliabilityPolicy.RELIABLE, history=HistoryPolicy.KEEP_LAST, depth=200)
if "verdict_qos" in sys.argv:
    qos = verdict_qos(MonitorSettings().timeout)
    OUT, SCALARS = qos_profile(qos), qos_profile(qos._replace(lifespan_s=SCALAR_LIFESPAN_S))


class EchoNode(Node):
    """Answer each joint state with constant ContactStates, restamped, and two constant numbers."""

    def __init__(self) -> None:
        super().__init__("echo")
        self._contact_states = self.create_publisher(ContactStates, "contact_states", OUT)
        self._allowable_speed = self.create_publisher(Float64, "allowable_speed", SCALARS)
        self._speed_scaling = self.create_publisher(Float64, "speed_scaling", SCALARS)
        contact = ContactState(contact_point="tool", body_region="lower_leg", criterion="force", verdict=1)
        self._message = ContactStates(contacts=[contact], verdict=1)
        self._message.header.frame_id = "base_link"
        self._number = Float64(data=1.0)
        self.create_subscription(JointState, "joint_states", self._on_joint_state, IN)

    def _on_joint_state(self, state: JointState) -> None:
        self._message.header.stamp = state.header.stamp
        self._contact_states.publish(self._message)
        self._allowable_speed.publish(self._number)
        self._speed_scaling.publish(self._number)


if __name__ == "__main__":
    rclpy.init()
    node = EchoNode()
    executor = EventsExecutor()
    executor.add_node(node)
    try:
        executor.spin_until_future_complete(Future(), timeout_sec=1e6)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()

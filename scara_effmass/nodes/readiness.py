# SPDX-License-Identifier: Apache-2.0
"""Readiness of the suite's nodes: every node reports it, and a replay waits for it before it sends anything.

DDS discovery takes from milliseconds to seconds and differs from pair to pair of nodes. A publisher therefore cannot
know which subscribers it has not discovered yet. Nodes that discovered each other before can: every report names the
nodes that its sender has discovered.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from rclpy.node import Node
from rclpy.topic_endpoint_info import TopicEndpointInfo
from scara_effmass_msgs.msg import NodeReadiness

from scara_effmass.nodes.ros import qos_profile
from scara_effmass.wire.cdr import NS
from scara_effmass.wire.topics import CLIENT_QOS, READINESS

PERIOD_S = 0.1


def node_names(endpoints: Iterable[TopicEndpointInfo]) -> set[str]:
    """Return the fully qualified names of the nodes that own `endpoints`."""
    return {f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}" for endpoint in endpoints}


def readiness_reporter(node: Node, is_active: Callable[[], bool]) -> Callable[[], None]:
    """Return a function that publishes the readiness of `node`; call it every PERIOD_S, in every lifecycle state."""
    publisher = node.create_publisher(NodeReadiness, READINESS, qos_profile(CLIENT_QOS))

    def publish() -> None:
        if publisher.get_subscription_count():
            report = NodeReadiness(
                node=node.get_fully_qualified_name(),
                active=is_active(),
                use_sim_time=bool(node.get_parameter("use_sim_time").value),
                peers=sorted(node_names(node.get_publishers_info_by_topic(READINESS))),
            )
            report.header.stamp = node.get_clock().now().to_msg()
            publisher.publish(report)

    return publish


class ReadinessReports:
    """Latest report of every node of the suite, as received by the node of a replay.

    Create it after all other endpoints of the replay: DDS announces endpoints in the order of their creation, so a
    report shows that its sender knows every subscription of the replay, and one that carries the time of the replay
    shows that its sender knows every publisher made before that of `/clock`.
    """

    def __init__(self, node: Node) -> None:
        """Subscribe with `node`."""
        self._node = node
        self._reports: dict[str, NodeReadiness] = {}
        node.create_subscription(NodeReadiness, READINESS, self._on_report, qos_profile(CLIENT_QOS))

    def unready(self, clock_ns: int, topics: Iterable[str]) -> dict[str, str]:
        """Return the nodes that a replay has to wait for, each with the reason.

        These are the nodes of the suite that run on `/clock`, where the replay has published `clock_ns`, or subscribe
        to one of `topics`. A node whose report is missing may be one of them.
        """
        discovered = node_names(self._node.get_publishers_info_by_topic(READINESS))
        reports = {name: report for name, report in self._reports.items() if name in discovered}
        known = discovered.union(*(report.peers for report in reports.values()))
        subscribed = set().union(*(node_names(self._node.get_subscriptions_info_by_topic(topic)) for topic in topics))
        consumers = {name for name, report in reports.items() if report.use_sim_time or name in subscribed}
        unready = dict.fromkeys(known - reports.keys(), "has sent no readiness report")
        for name in consumers:
            if reason := _reason(reports[name], clock_ns, consumers):
                unready[name] = reason
        return unready

    def _on_report(self, report: NodeReadiness) -> None:
        self._reports[report.node] = report


def _reason(report: NodeReadiness, clock_ns: int, consumers: set[str]) -> str:
    """Return why the sender of `report` is not ready, empty if it is."""
    if not report.active:
        return "is not active"
    if report.use_sim_time and report.header.stamp.sec * NS + report.header.stamp.nanosec != clock_ns:
        return "has not received the replay's /clock"
    missing = consumers.difference(report.peers)
    return f"has not discovered {', '.join(sorted(missing))}" if missing else ""

# SPDX-License-Identifier: Apache-2.0
"""Serve live topics to Foxglove over a WebSocket, by Foxglove's SDK, in place of foxglove_bridge."""

import socket
from collections.abc import Callable, Sequence
from typing import Any

import foxglove
from foxglove import Channel, Schema

from scara_effmass.bags.definitions import definition_of, known_types
from scara_effmass.errors import SettingsError
from scara_effmass.nodes import parameters
from scara_effmass.nodes.origin_guard import OriginGuard
from scara_effmass.nodes.record import TopicRecorder, resolve_topic
from scara_effmass.nodes.ros import ClientNode
from scara_effmass.settings.loading import FrozenSettings
from scara_effmass.wire.topics import FORCE_OUTPUTS, RECORDED

_SITES = ("foxglove.dev",)
"""Sites whose pages may read the topics: Foxglove in a browser."""
_PERIOD_S = 0.1
"""Period of topic discovery and of the check for a stop signal."""


class ChannelSink:
    """Offers every topic as a channel with its ROS 2 definition; messages pass unchanged."""

    def __init__(self) -> None:
        self._channels: list[Channel] = []

    def add_topic(self, name: str, message_type: str, *, offered_qos: str = "", types: Any = None) -> int:  # noqa: ANN401, ARG002
        """Offer a topic and return its index. Raises BagError for an unknown type."""
        definition, _ = definition_of(types or known_types(), message_type, name)
        schema = Schema(name=message_type, encoding="ros2msg", data=definition.encode())
        self._channels.append(Channel(name, schema=schema, message_encoding="cdr"))
        return len(self._channels) - 1

    def write(self, topic: int, log_time_ns: int, data: bytes) -> None:
        """Send a message to the clients that have subscribed."""
        self._channels[topic].log(data, log_time=log_time_ns)


def serve(
    topics: Sequence[str],
    host: str,
    port: int,
    ros_arguments: Sequence[str] = (),
    *,
    ready: Callable[[int], None] = lambda _: None,
    warn: Callable[[str], None] = lambda _: None,
) -> None:
    """Serve `topics` (none: those of the suite) until a signal ends it; call `ready` with the port.

    Pages of sites other than this machine's and Foxglove's are refused.

    Raises SettingsError for invalid arguments, and where the server cannot listen.
    """
    known_types()  # slow on the first call: before messages arrive
    with ClientNode("foxglove_server", arguments=ros_arguments) as client:
        node = client.node
        parameters.declare(node, FrozenSettings)  # only the parameters of every node
        names = [resolve_topic(node, topic) for topic in topics or RECORDED]
        parents = [] if topics else [resolve_topic(node, topic) for topic in FORCE_OUTPUTS]
        try:
            listener = socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET)
            # The SDK looks at no origin, so it is not what the browsers of this machine reach.
            server = foxglove.start_server(name="scara_effmass", host="127.0.0.1", port=0)
        except (RuntimeError, OSError) as error:
            raise SettingsError(f"foxglove: {host}:{port}: cannot listen: {error}") from None
        try:
            with OriginGuard(listener, server.port, _SITES):
                ready(listener.getsockname()[1])
                subscriptions = TopicRecorder(node, ChannelSink(), names, warn, parents)
                while not client.signals and client.context.ok():
                    subscriptions.discover()
                    client.spin_for(_PERIOD_S)
        finally:
            server.stop()

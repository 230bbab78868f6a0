# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass foxglove`: a WebSocket client of Foxglove's protocol reads the messages of live topics."""

import json
import socket
import struct
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import pytest
from scara_effmass_msgs.msg import ContactStates
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect

from scara_effmass.bags.definitions import definition_of, known_types
from scara_effmass.nodes import origin_guard
from scara_effmass.safety import unknown_contact
from scara_effmass.values import Verdict
from scara_effmass.wire.contact_states import ContactStatesEncoder, decode_contact_states
from test.decisions import assessments_of, decision_on
from test.nodes.conftest import DEEP_QOS, TIMEOUT_S, NodeHarness

COMMAND = (sys.executable, "-m", "scara_effmass", "foxglove")
MESSAGE_DATA = 1
TYPE = "scara_effmass_msgs/msg/ContactStates"
CONTACT = unknown_contact("tool", "close to the limit")._replace(
    verdict=Verdict.WARN, speed=0.4, allowable_speed=0.5, lumped_mass=1.0, full_mass=2.0
)
SENT = decision_on(CONTACT, stamp_ns=1_800_000_000_000_000_000)


def received(server: ClientConnection) -> Iterator[dict[str, Any]]:
    """Yield the JSON messages of the server."""
    while True:
        message = server.recv(timeout=TIMEOUT_S)
        if isinstance(message, str):
            yield json.loads(message)


def test_client_reads_a_contact_state_unchanged(new_harness: Callable[..., NodeHarness]) -> None:
    harness = new_harness()
    process = harness.start("--port", "0", command=COMMAND)
    assert process.stdout is not None
    address = process.stdout.readline().split()[2].rstrip(";")
    assert address.startswith("ws://127.0.0.1:")
    states = harness.node.create_publisher(ContactStates, "contact_states", DEEP_QOS)
    data = ContactStatesEncoder("base_link").encode(assessments_of(SENT))
    harness.spin_until(states.get_subscription_count)
    with connect(address, subprotocols=["foxglove.sdk.v1"], open_timeout=TIMEOUT_S) as server:  # type: ignore[list-item]
        messages = received(server)
        info = next(message for message in messages if message["op"] == "serverInfo")
        assert info["name"] == "scara_effmass"
        assert not {"clientPublish", "services", "parameters"} & set(info["capabilities"])  # clients only read
        offered = (c for m in messages if m["op"] == "advertise" for c in m["channels"])
        channel = next(c for c in offered if c["topic"] == "/contact_states")
        assert (channel["encoding"], channel["schemaName"], channel["schemaEncoding"]) == ("cdr", TYPE, "ros2msg")
        assert channel["schema"] == definition_of(known_types(), TYPE, "test")[0]
        server.send(json.dumps({"op": "subscribe", "subscriptions": [{"id": 7, "channelId": channel["id"]}]}))

        def frame() -> bytes | None:
            try:
                message = server.recv(timeout=0.01)
            except TimeoutError:
                return None
            return message if isinstance(message, bytes) else None

        binary = harness.spin_until(frame, repeat=lambda: states.publish(data))
    opcode, subscription, _ = struct.unpack_from("<BIQ", binary)
    assert (opcode, subscription) == (MESSAGE_DATA, 7)
    assert decode_contact_states(binary[13:]) == SENT._replace(sequence_number=1)


def test_port_in_use_is_one_line(new_harness: Callable[..., NodeHarness]) -> None:
    first, second = new_harness(), new_harness()
    process = first.start("--port", "0", command=COMMAND)
    assert process.stdout is not None
    port = process.stdout.readline().split()[2].rstrip(";").rpartition(":")[2]
    refused = second.start("--port", port, command=COMMAND)
    _, errors = refused.communicate(timeout=TIMEOUT_S)
    assert refused.returncode == 2
    assert f"foxglove: 127.0.0.1:{port}: cannot listen" in errors
    assert errors.count("\n") == 1


def test_pages_of_other_sites_are_refused_and_foxglove_is_not(new_harness: Callable[..., NodeHarness]) -> None:
    process = new_harness().start("--port", "0", command=COMMAND)
    assert process.stdout is not None
    address = process.stdout.readline().split()[2].rstrip(";")

    def greeting(*headers: tuple[str, str]) -> str:
        with connect(
            address,
            subprotocols=["foxglove.sdk.v1"],  # type: ignore[list-item]
            additional_headers=headers,
            open_timeout=TIMEOUT_S,
        ) as server:
            return str(next(received(server))["op"])

    for origin in ("https://app.foxglove.dev", "http://localhost:8080", "http://[::1]:8080", "file://", "app://x"):
        assert greeting(("Origin", origin)) == "serverInfo"
    assert greeting() == "serverInfo"
    refused = ("https://evil.example", "https://foxglove.dev.evil.example", "https://evilfoxglove.dev", "null")
    for status, origins in {403: refused, 400: ("http://[::1", "http://localhost:port")}.items():
        for origin in origins:
            with pytest.raises(InvalidStatus) as answer:
                greeting(("Origin", origin))
            assert answer.value.response.status_code == status
    with pytest.raises(InvalidStatus):
        greeting(("Origin", "http://localhost"), ("Origin", "https://evil.example"))


def test_connection_without_a_request_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(origin_guard, "HEAD_TIMEOUT_S", 0.2)
    monkeypatch.setattr(origin_guard, "MAX_CONNECTIONS", 3)
    with ExitStack() as stack:
        listener = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
        stack.enter_context(origin_guard.OriginGuard(listener, 1, ()))
        clients = [stack.enter_context(socket.create_connection(listener.getsockname())) for _ in range(10)]
        for client in clients:
            client.settimeout(TIMEOUT_S)
            assert client.recv(1) == b""

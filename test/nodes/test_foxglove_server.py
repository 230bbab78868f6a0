# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass foxglove`: a WebSocket client of Foxglove's protocol reads the messages of live topics."""

import json
import struct
import sys
from collections.abc import Callable, Iterator
from typing import Any

from scara_effmass_msgs.msg import ContactStates
from websockets.sync.client import ClientConnection, connect

from scara_effmass.bags.definitions import definition_of, known_types
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

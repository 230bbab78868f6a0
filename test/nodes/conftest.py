# SPDX-License-Identifier: Apache-2.0
"""Fixtures for tests of a node: a harness that runs it as a process and talks to it over ROS."""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager
from functools import partial
from pathlib import Path
from typing import Any, final

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.srv import SetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from scara_effmass_msgs.msg import ContactState, ContactStates
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from scara_effmass.errors import EffmassError
from scara_effmass.nodes.lifecycle import AnyNode
from test.forked import Forked

TIMEOUT_S = 120.0
"""Maximum wait [s] for any event; a test that waits longer fails."""
JOINTS = ("joint1", "joint2", "joint3", "joint4")
Q = (0.3, 1.2, 0.1, -0.4)
QD = (0.01, -0.01, 0.003, 0.01)
"""Slow enough that the positions may stand still: the input check cannot tell."""
DEEP_QOS = QoSProfile(depth=20_000)
MONITOR_NODE = Path(sys.executable).with_name("monitor_node")


def joint_state(
    stamp_ns: int | None = None,
    names: Sequence[str] = JOINTS,
    position: Sequence[float] = Q,
    velocity: Sequence[float] = QD,
) -> JointState:
    """Return a joint state, stamped now unless `stamp_ns` says otherwise."""
    message = JointState(name=list(names), position=list(position), velocity=list(velocity))
    seconds, message.header.stamp.nanosec = divmod(time.time_ns() if stamp_ns is None else stamp_ns, 1_000_000_000)
    message.header.stamp.sec = seconds
    return message


def stamp_ns(message: Any) -> int:  # noqa: ANN401 - any stamped message
    """Return the header stamp [ns]."""
    return int(message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec)


@contextmanager
def ros_node(name: str, namespace: str = "/", domain: int | None = None) -> Iterator[Node]:
    """Give a node in a ROS context of its own."""
    context = Context()
    rclpy.init(context=context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
    node = Node(name, context=context, namespace=namespace)
    try:
        yield node
    finally:
        node.destroy_node()
        context.try_shutdown()


def node_environment(domain: int, directory: Path) -> dict[str, str]:
    """Return the environment of a node."""
    own = {"ROS_DOMAIN_ID": str(domain), "ROS_LOG_DIR": str(directory)}
    return {**os.environ, **own}


class Answer:
    """One contact of a ContactStates message: its fields, and those of the message."""

    def __init__(self, message: ContactStates, index: int = 0) -> None:
        self.message, self.contact = message, message.contacts[index]

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401
        return getattr(self.contact if hasattr(self.contact, name) else self.message, name)


@final
class NodeHarness:
    """A node process in its own ROS domain, and a test node that talks to it."""

    def __init__(self, domain: int, directory: Path, name: str = "monitor", namespace: str = "") -> None:
        self.domain = domain
        self.directory = directory
        self.contact_states: list[Answer] = []
        """An answer for each message: its first contact."""
        self.scalars: dict[str, list[float]] = {"allowable_speed": [], "speed_scaling": []}
        self.diagnostics: list[DiagnosticArray] = []
        self.process: subprocess.Popen[str] | None = None
        self.process_may_end = False
        self._name = f"{namespace}/{name}"
        self._stack = ExitStack()
        self.node = self._stack.enter_context(ros_node("tester", namespace or "/", domain))
        self._executor = SingleThreadedExecutor(context=self.node.context)
        self._executor.add_node(self.node)
        self._input: Any = None

    def close(self) -> None:
        """Stop the process and destroy the test node."""
        try:
            if self.process is not None:
                self.process.terminate()
                self.process.communicate(timeout=TIMEOUT_S)
        finally:
            if self.process is not None:
                self.process.kill()
            self._executor.shutdown()
            self._stack.close()

    def start(self, *arguments: str, command: Sequence[str] = (str(MONITOR_NODE),)) -> subprocess.Popen[str]:
        """Start the node with `arguments`, its output piped."""
        environment = node_environment(self.domain, self.directory)
        self.process = Forked(
            [*command, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
        )
        return self.process

    def subscribe(self) -> None:
        """Subscribe to the topics of the monitor and to /diagnostics."""
        self.node.create_subscription(ContactStates, "contact_states", self.on_contact_states, DEEP_QOS)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self.diagnostics.append, DEEP_QOS)
        for topic, received in self.scalars.items():
            self.node.create_subscription(Float64, topic, partial(self._on_scalar, received), DEEP_QOS)

    def subscribe_until_ok(self) -> None:
        """Subscribe, wait for OK and discard what came before it."""
        self.subscribe()
        self.spin_until(
            lambda: self.contact_states and all(self.scalars.values()), repeat=lambda: self.send(joint_state())
        )
        self.synchronize()

    def on_contact_states(self, message: ContactStates) -> None:
        """Keep the answer."""
        self.contact_states.append(Answer(message))

    @staticmethod
    def _on_scalar(received: list[float], message: Float64) -> None:
        received.append(message.data)

    def spin_until(
        self, condition: Callable[[], Any], repeat: Callable[[], object] | None = None, timeout_s: float = TIMEOUT_S
    ) -> Any:  # noqa: ANN401
        """Spin until `condition` returns a true value and return it. Call `repeat` at once and then every 0.1 s."""
        start = now = next_repeat = time.monotonic()
        while not (result := condition()):
            assert now < start + timeout_s, f"condition not met within {timeout_s} s"
            if self.process is not None and not self.process_may_end and self.process.poll() is not None:
                raise AssertionError(f"the node process ended: {self.process.communicate()[1][-2000:]}")
            if repeat is not None and now >= next_repeat:
                repeat()
                next_repeat = now + 0.1
            self._executor.spin_once(timeout_sec=0.05)
            now = time.monotonic()
        return result

    def call_service(self, kind: Any, service: str, request: Any) -> Any:  # noqa: ANN401
        """Call the private service `~/service` of the node."""
        client = self.node.create_client(kind, f"{self._name}/{service}")
        self.spin_until(client.service_is_ready)
        futures = [client.call_async(request)]
        sent = time.monotonic()

        def answer() -> Any:  # noqa: ANN401
            # A node that has not yet discovered the client drops its answer; these two may be asked for twice.
            if kind in {SetParameters, GetState} and time.monotonic() > sent + 5.0 * len(futures):
                futures.append(client.call_async(request))
            return next((future for future in futures if future.done()), None)

        future = self.spin_until(answer)
        self.node.destroy_client(client)
        return future.result()

    def change_state(self, *transitions: int) -> bool:
        """Request lifecycle transitions up to the first refusal; return whether there was none."""
        requests = (ChangeState.Request(transition=Transition(id=transition)) for transition in transitions)
        return all(self.call_service(ChangeState, "change_state", request).success for request in requests)

    def set_parameters(self, **values: Any) -> str:  # noqa: ANN401
        """Set parameters one by one; return the reason of the first rejection, or an empty string."""
        parameters = [
            Parameter(name, Parameter.Type.STRING_ARRAY, value) if value == [] else Parameter(name, value=value)
            for name, value in values.items()
        ]
        request = SetParameters.Request(parameters=[parameter.to_parameter_msg() for parameter in parameters])
        results = self.call_service(SetParameters, "set_parameters", request).results
        return next((result.reason or "no reason" for result in results if not result.successful), "")

    def send(self, message: JointState | bytes) -> None:
        """Publish on joint_states."""
        if self._input is None:
            self._input = self.node.create_publisher(JointState, "joint_states", DEEP_QOS)
        self._input.publish(message)

    def stop_sending(self) -> None:
        """End the publisher of joint_states: another one would be a second one."""
        self.node.destroy_publisher(self._input)
        self._input = None

    def response_to(self, message: JointState | bytes) -> Answer:
        """Publish `message` and return the contact state that follows."""
        self._clear_when_complete()
        self.send(message)
        answers: list[Answer] = self.spin_until(
            lambda: self._complete() and [c for c in self.contact_states if not c.watchdog]
        )
        return answers[0]

    def watchdog_response(self) -> Answer:
        """Return the contact state that the watchdog publishes while no joint state is sent."""
        self._clear_when_complete()
        answers: list[Answer] = self.spin_until(
            lambda: self._complete() and [c for c in self.contact_states if c.watchdog]
        )
        return answers[-1]

    def send_until_ok(self) -> Answer:
        """Send joint states stamped now until the newest one gets OK; return that contact state."""
        sent: list[JointState] = []

        def send() -> None:
            sent.append(joint_state())
            self.send(sent[-1])

        def newest() -> Answer | None:
            """Return the OK for the newest joint state; all earlier ones are answered by then."""
            responses = (c for c in self.contact_states if sent and c.header.stamp == sent[-1].header.stamp)
            return next((c for c in responses if c.verdict == ContactState.OK), None)

        response: Answer = self.spin_until(newest, repeat=send)
        return response

    def synchronize(self) -> None:
        """Receive everything the node has published so far and discard it."""
        self.send_until_ok()
        self.send(joint_state(names=()))

        def all_refused() -> bool:
            """Return whether the latest message of each topic answers the invalid joint state that was sent last."""
            latest = [
                self.contact_states[-1].allowable_speed,
                *(value for v in self.scalars.values() for value in v[-1:]),
            ]
            return len(latest) == 1 + len(self.scalars) and not any(latest)

        self.spin_until(all_refused)
        self._clear()

    def discard_received(self) -> None:
        """Receive and discard the messages that have already arrived."""
        count = -1
        while count != (count := len(self.contact_states) + sum(map(len, self.scalars.values()))):
            for _ in range(20):
                self._executor.spin_once(timeout_sec=0.0)
        self._clear()

    def diagnostic(self, name: str, key: str, accept: Callable[[str], bool]) -> str:
        """Return "message | value" of the status `name` once `accept` holds for its value of `key`."""

        def matching() -> str | None:
            statuses = (s for array in self.diagnostics for s in array.status if s.name.endswith(name))
            pairs = ((status.message, pair) for status in statuses for pair in status.values)
            return next(
                (f"{text} | {pair.value}" for text, pair in pairs if pair.key == key and accept(pair.value)), None
            )

        self.diagnostics.clear()
        return str(self.spin_until(matching))

    def _complete(self) -> bool:
        """Whether both scalars have arrived for every decision."""
        return all(len(values) == len(self.contact_states) for values in self.scalars.values())

    def _clear_when_complete(self) -> None:
        self.spin_until(self._complete)
        self._clear()

    def _clear(self) -> None:
        self.contact_states.clear()
        for values in self.scalars.values():
            values.clear()


@pytest.fixture(scope="module")
def localhost_only() -> Iterator[None]:
    """Restrict ROS discovery to this machine."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        yield


@pytest.fixture(scope="module")
def shared_harness(
    localhost_only: None,  # noqa: ARG001
    reserve_domain: Callable[[], AbstractContextManager[int]],
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[NodeHarness]:
    """Run one monitor, without debounce and with a 60 s timeout, for tests that leave its state unchanged."""
    with reserve_domain() as domain, closing(NodeHarness(domain, tmp_path_factory.mktemp("shared"))) as harness:
        harness.start("--ros-args", "-p", "release_time:=0.0", "-p", "timeout:=60.0")
        harness.subscribe_until_ok()
        yield harness


@pytest.fixture
def harness(shared_harness: NodeHarness) -> NodeHarness:
    """Return the shared harness once its monitor answers OK."""
    shared_harness.send_until_ok()
    return shared_harness


@pytest.fixture
def default_context(own_domain: int) -> Iterator[None]:  # noqa: ARG001
    """Start ROS in this process, and end it however the test ends."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        yield
    finally:
        rclpy.try_shutdown()


@pytest.fixture
def refusal_of(
    own_domain: int,  # noqa: ARG001
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> Callable[[Callable[[], AnyNode], str], str]:
    """Return a function that brings a node up in this process with an invalid parameter and returns the error line."""

    def refusal(make: Callable[[], AnyNode], argument: str) -> str:
        monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path))
        rclpy.init(args=["--ros-args", "-p", argument], signal_handler_options=SignalHandlerOptions.NO)
        try:
            with pytest.raises(EffmassError) as refused:
                make().bring_up()
        finally:
            rclpy.try_shutdown()
        (line,) = str(refused.value).split("\n")
        return line

    return refusal


@pytest.fixture
def new_harness(
    localhost_only: None,  # noqa: ARG001
    reserve_domain: Callable[[], AbstractContextManager[int]],
    tmp_path: Path,
) -> Iterator[Callable[..., NodeHarness]]:
    """Return a function that makes a harness; with arguments it starts the node too."""
    with ExitStack() as stack:

        def make(*arguments: str, **options: Any) -> NodeHarness:  # noqa: ANN401
            harness = stack.enter_context(
                closing(NodeHarness(stack.enter_context(reserve_domain()), tmp_path, **options))
            )
            if arguments:
                harness.start(*arguments)
            return harness

        yield make

"""A cell for one monitor node: the node as a process of its own, and the test's end of every wire to it."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import SetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from scara_effmass_msgs.msg import ContactState
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from scara_effmass.errors import EffmassError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from contextlib import AbstractContextManager

    from scara_effmass.nodes.lifecycle import LifecycleBase

PATIENCE_S = 120.0
"""Longest wait for anything; whatever takes this long has failed."""
JOINTS = ("joint1", "joint2", "joint3", "joint4")
Q = (0.3, 1.2, 0.1, -0.4)
QD = (0.1, -0.2, 0.05, 0.3)
DEEP = QoSProfile(depth=20_000)
EXECUTABLE = Path(sys.executable).with_name("monitor_node")


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


@final
class Cell:
    """A domain of its own, a node process in it, and a test node that talks to that process."""

    def __init__(self, domain: int, directory: Path, name: str = "monitor", namespace: str = "") -> None:
        self.domain = domain
        self.directory = directory
        self.contacts: list[ContactState] = []
        self.numbers: dict[str, list[float]] = {"allowable_speed": [], "speed_scaling": []}
        self.reports: list[DiagnosticArray] = []
        self.process: subprocess.Popen[str] | None = None
        self.may_end = False
        self._name = f"{namespace}/{name}"
        self._context = Context()
        rclpy.init(context=self._context, domain_id=self.domain, signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node("tester", context=self._context, namespace=namespace or None)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._input: Any = None

    def close(self) -> None:
        """End the process and the test's node."""
        try:
            if self.process is not None:
                self.process.terminate()
                self.process.communicate(timeout=PATIENCE_S)
        finally:
            if self.process is not None:
                self.process.kill()
            self._executor.shutdown()
            self.node.destroy_node()
            self._context.try_shutdown()

    def start(self, *arguments: str, command: Sequence[str] = (str(EXECUTABLE),)) -> subprocess.Popen[str]:
        """Start the node with `arguments`; its output goes to a pipe."""
        environment = {**os.environ, "ROS_DOMAIN_ID": str(self.domain), "ROS_LOG_DIR": str(self.directory)}
        self.process = subprocess.Popen(
            [*command, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
        )
        return self.process

    def listen(self) -> None:
        """Subscribe to what the node publishes."""
        self.node.create_subscription(ContactState, "contact_state", self.contacts.append, DEEP)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self.reports.append, DEEP)
        for topic, heard in self.numbers.items():
            self.node.create_subscription(Float64, topic, partial(self._hear_number, heard), DEEP)

    @staticmethod
    def _hear_number(heard: list[float], message: Float64) -> None:
        heard.append(message.data)

    def until(
        self, condition: Callable[[], Any], again: Callable[[], object] | None = None, patience_s: float = PATIENCE_S
    ) -> Any:  # noqa: ANN401
        """Handle events until `condition` gives something true; return that. Do `again` now and ten times a second."""
        began = now = time.monotonic()
        due = began
        while not (result := condition()):
            assert now < began + patience_s, f"nothing came of it in {patience_s} s"
            if self.process is not None and not self.may_end and self.process.poll() is not None:
                raise AssertionError(f"the node has ended: {self.process.communicate()[1][-2000:]}")
            if again is not None and now >= due:
                again()
                due = now + 0.1
            self._executor.spin_once(timeout_sec=0.05)
            now = time.monotonic()
        return result

    def call(self, kind: Any, service: str, request: Any) -> Any:  # noqa: ANN401
        """Call one of the node's own services."""
        client = self.node.create_client(kind, f"{self._name}/{service}")
        self.until(client.service_is_ready)
        future = client.call_async(request)
        self.until(future.done)
        self.node.destroy_client(client)
        return future.result()

    def set(self, **values: Any) -> str:  # noqa: ANN401
        """Set parameters one by one; return the reason of the first refusal, empty when all were taken."""
        parameters = [
            Parameter(name, Parameter.Type.STRING_ARRAY, value)
            if isinstance(value, list)
            else Parameter(name, value=value)
            for name, value in values.items()
        ]
        request = SetParameters.Request(parameters=[parameter.to_parameter_msg() for parameter in parameters])
        results = self.call(SetParameters, "set_parameters", request).results
        return next((result.reason or "no reason" for result in results if not result.successful), "")

    def send(self, message: JointState | bytes) -> None:
        """Publish on joint_states."""
        if self._input is None:
            self._input = self.node.create_publisher(JointState, "joint_states", DEEP)
        self._input.publish(message)

    def exchange(self, message: JointState | bytes) -> ContactState:
        """Publish `message` and return the answer to it."""
        self._forget()
        self.send(message)
        return self.until(lambda: self._complete() and [c for c in self.contacts if not _silent(c)])[0]

    def silence(self) -> ContactState:
        """Return what is published when nothing is sent."""
        self._forget()
        return self.until(lambda: self._complete() and [c for c in self.contacts if _silent(c)])[-1]

    def good(self) -> ContactState:
        """Send good joint states, each stamped now, until one is found OK; return that answer."""
        sent: list[JointState] = []

        def send() -> None:
            sent.append(joint_state())
            self.send(sent[-1])

        def newest() -> ContactState | None:
            """Return the OK to the newest joint state: with it, all that were sent before are answered."""
            answers = (c for c in self.contacts if sent and c.header.stamp == sent[-1].header.stamp)
            return next((c for c in answers if c.verdict == ContactState.OK), None)

        answer: ContactState = self.until(newest, again=send)
        return answer

    def settle(self) -> None:
        """Count what comes from here on, of a node whose every wire is up and that is sent good joint states only."""
        self.good()
        self.send(joint_state(names=()))

        def refused() -> bool:
            """Return whether the last on each wire is zero, as nothing was before: with it, all that was has come."""
            return not any([self.contacts[-1].allowable_speed, *(heard[-1] for heard in self.numbers.values())])

        self.until(refused)
        self._clear()

    def drain(self) -> None:
        """Take what has come already, and forget it."""
        heard = -1
        while heard != (heard := len(self.contacts) + sum(map(len, self.numbers.values()))):
            for _ in range(20):
                self._executor.spin_once(timeout_sec=0.0)
        self._clear()

    def report(self, status: str, key: str, value: Callable[[str], bool]) -> str:
        """Return `key` of the diagnostics' `status` once `value` holds of it."""

        def found() -> str | None:
            for array in self.reports:
                for each in array.status:
                    for pair in each.values:
                        if each.name.endswith(status) and pair.key == key and value(pair.value):
                            return f"{each.message} | {pair.value}"
            return None

        self.reports.clear()
        return str(self.until(found))

    def _complete(self) -> bool:
        """Whether both numbers have come for every decision."""
        return all(len(heard) == len(self.contacts) for heard in self.numbers.values())

    def _forget(self) -> None:
        self.until(self._complete)
        self._clear()

    def _clear(self) -> None:
        self.contacts.clear()
        for heard in self.numbers.values():
            heard.clear()


def _silent(contact: ContactState) -> bool:
    return bool(contact.watchdog)


@pytest.fixture(scope="module")
def local() -> Iterator[None]:
    """Keep everything ROS on this machine."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        yield


@pytest.fixture(scope="module")
def shared(
    local: None,  # noqa: ARG001 - keeps it on this machine
    reserve_domain: Callable[[], AbstractContextManager[int]],
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[Cell]:
    """One node for all tests that leave it as they found it: nothing is held, and nothing is old before a minute."""
    with reserve_domain() as domain, closing(Cell(domain, tmp_path_factory.mktemp("shared"))) as cell:
        cell.start("--ros-args", "-p", "release_time:=0.0", "-p", "timeout:=60.0")
        cell.listen()
        cell.until(lambda: cell.contacts and all(cell.numbers.values()), again=lambda: cell.send(joint_state()))
        cell.settle()
        yield cell


@pytest.fixture
def cell(shared: Cell) -> Cell:
    """The shared node, found well."""
    shared.good()
    return shared


@pytest.fixture
def refusal_of(
    own_domain: int,  # noqa: ARG001 - where it is alone
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> Callable[[Callable[[], LifecycleBase], str], str]:
    """Bring a node up in this process with a parameter that it cannot use, and return its one line."""

    def refusal(make: Callable[[], LifecycleBase], argument: str) -> str:
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
def new_cell(
    local: None,  # noqa: ARG001 - keeps it on this machine
    reserve_domain: Callable[[], AbstractContextManager[int]],
    tmp_path: Path,
) -> Iterator[Callable[..., Cell]]:
    """Make cells for nodes that a test starts, and ends, its own way."""
    with ExitStack() as stack:

        def make(*arguments: str, **options: Any) -> Cell:  # noqa: ANN401
            cell = stack.enter_context(closing(Cell(stack.enter_context(reserve_domain()), tmp_path, **options)))
            if arguments:
                cell.start(*arguments)
            return cell

        yield make

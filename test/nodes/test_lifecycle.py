# SPDX-License-Identifier: Apache-2.0
"""Spinning of nodes, and their end while they start."""

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest
import rclpy
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.executors import ExternalShutdownException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from std_msgs.msg import String

from scara_effmass.nodes.lifecycle import LifecycleBase
from scara_effmass.nodes.parameters import NodeParameters
from scara_effmass.nodes.ros import spin_for
from test.nodes.conftest import ros_node


@pytest.mark.usefixtures("own_domain")
def test_spinning_ends_under_constant_load() -> None:
    calls = 0

    def again() -> None:
        nonlocal calls
        calls += 1
        executor.create_task(again)

    with ros_node("busy") as node:
        executor = EventsExecutor(context=node.context)
        executor.create_task(again)
        spin_for(executor, 0.05)
        assert calls > 0
        before = calls
        spin_for(executor, 600.0, lambda: calls >= before + 10)
        assert calls == before + 10
        executor.shutdown()


@pytest.mark.usefixtures("own_domain")
def test_spinning_goes_on_after_an_event_of_a_destroyed_subscription() -> None:
    calls: list[int] = []

    def destroy() -> None:
        node.create_publisher(String, "text", 1)
        while not subscription.get_publisher_count():
            time.sleep(0.01)
        node.destroy_subscription(subscription)  # its event waits for the executor, which is here
        executor.create_task(calls.append, 1)

    with ros_node("renewing") as node:
        subscription = node.create_subscription(
            String, "text", lambda _: None, 1, event_callbacks=SubscriptionEventCallbacks(matched=lambda _: None)
        )
        executor = EventsExecutor(context=node.context)
        executor.add_node(node)
        spin_for(executor, 0.1)  # the executor notices the subscription
        executor.create_task(destroy)
        spin_for(executor, 60.0, lambda: bool(calls))
        executor.shutdown()
    assert calls == [1]


@pytest.mark.usefixtures("default_context")
def test_timer_whose_context_ends_meanwhile_logs_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    node = LifecycleBase("ending", NodeParameters)
    publisher = node.create_publisher(String, "text", 1)
    ended: list[bool] = []

    def end_and_publish() -> None:
        """As a signal does, which has a thread of its own."""
        rclpy.try_shutdown()
        ended.append(True)
        publisher.publish(String())

    node.create_steady_timer(0.01, end_and_publish)
    executor = EventsExecutor()
    executor.add_node(node)
    with suppress(ExternalShutdownException):
        spin_for(executor, 60.0, lambda: bool(ended))
    executor.shutdown()
    node.destroy_node()
    assert ended
    assert "FATAL" not in capfd.readouterr().err


@pytest.mark.usefixtures("default_context")
def test_timer_that_the_executor_has_queued_does_not_call_after_clean_up() -> None:
    node, calls = LifecycleBase("cleaned", NodeParameters), list[str]()
    timer = node.create_steady_timer(60.0, lambda: calls.append("called"))
    queued = timer.callback
    queued()
    assert node.on_cleanup(LifecycleState("inactive", 2)) is TransitionCallbackReturn.SUCCESS
    queued()
    assert calls == ["called"]
    node.destroy_node()


@pytest.mark.live
@pytest.mark.parametrize("number", [1, 5])
def test_sigint_while_the_executor_takes_in_its_entities_ends_it_with_0(own_domain: int, number: int) -> None:
    script = f"""
import os, signal, threading
from rclpy.event_handler import EventHandler
from scara_effmass.nodes.validator_node import main

calls, add = [], EventHandler.add_to_wait_set

def interrupted_add(self, wait_set):
    calls.append(self)
    if len(calls) == {number}:
        os.kill(os.getpid(), signal.SIGINT)
        threading.Event().wait(0.1)  # time in which the thread for signals could shut the context down
    return add(self, wait_set)

EventHandler.add_to_wait_set = interrupted_add
raise SystemExit(main([]) or 3 * (len(calls) < {number}))
"""
    environment = {**os.environ, "ROS_DOMAIN_ID": str(own_domain)}
    ended = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=False)
    assert (ended.returncode, "Traceback" in ended.stderr) == (0, False), ended.stderr


@pytest.mark.live
@pytest.mark.parametrize("command", [("monitor_node",), ("scara-effmass", "monitor")])
@pytest.mark.parametrize("is_caught", [False, True])
def test_sigterm_while_a_node_starts_ends_it_with_0_or_143(
    command: tuple[str, ...], own_domain: int, tmp_path: Path, *, is_caught: bool
) -> None:
    """At once, and as soon as the process catches the signal: after its imports, before or while the node comes up."""
    environment = {**os.environ, "ROS_DOMAIN_ID": str(own_domain), "ROS_LOG_DIR": str(tmp_path)}
    words = [str(Path(sys.executable).with_name(command[0])), *command[1:]]
    with subprocess.Popen(words, env=environment, stderr=subprocess.PIPE, text=True) as process:
        status = Path("/proc", str(process.pid), "status")
        while is_caught:
            (caught,) = (line.split()[1] for line in status.read_text().splitlines() if line.startswith("SigCgt"))
            if int(caught, 16) >> (signal.SIGTERM - 1) & 1:
                break
        process.terminate()
        errors = process.communicate()[1]
    assert process.returncode in {0, 143, -signal.SIGTERM}  # a shell states the last one as 143, too
    assert "Traceback" not in errors
    assert "FATAL" not in errors


@pytest.mark.live
@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_signal_ends_a_node_that_loads_for_long(own_domain: int, number: signal.Signals, code: int) -> None:
    script = """
import time
from scara_effmass.nodes.validator_node import ValidatorNode, main

ValidatorNode.configure = lambda self: (print("loading", flush=True), time.sleep(600))
raise SystemExit(main([]))
"""
    environment = {**os.environ, "ROS_DOMAIN_ID": str(own_domain)}
    with subprocess.Popen([sys.executable, "-c", script], env=environment, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"loading\n"
        process.send_signal(number)
        assert process.wait(60.0) == code


@pytest.mark.live
@pytest.mark.parametrize("call", ["read", "close"])
def test_signal_ends_a_node_whose_driver_hangs(own_domain: int, call: str) -> None:
    script = f"""
import threading
from scara_effmass.daq.sim_source import SimSource
from scara_effmass.nodes import lifecycle
from scara_effmass.nodes.daq_node import main

lifecycle._END_S = 0.2
SimSource.{call} = lambda *_: threading.Event().wait(600)
lifecycle.LifecycleBase.bring_up = lambda self, up=lifecycle.LifecycleBase.bring_up: (up(self), print("up", flush=True))
raise SystemExit(main(["--ros-args", "-p", "source:=sim"]))
"""
    environment = {**os.environ, "ROS_DOMAIN_ID": str(own_domain)}
    with subprocess.Popen([sys.executable, "-c", script], env=environment, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"up\n"
        process.send_signal(signal.SIGTERM)
        assert process.wait(60.0) == 143


@pytest.mark.live
def test_node_refuses_with_status_2_although_its_streams_are_closed(own_domain: int) -> None:
    environment = {**os.environ, "ROS_DOMAIN_ID": str(own_domain)}
    command = f"exec {Path(sys.executable).with_name('daq_node')} --ros-args -p source:=nope <&- >&- 2>&-"
    assert subprocess.run(["sh", "-c", command], env=environment, check=False).returncode == 2

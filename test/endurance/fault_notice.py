# SPDX-License-Identifier: Apache-2.0
"""Measure the time from a fault of the monitor until a consumer stops.

    python test/endurance/fault_notice.py [-n RUNS]

For each fault a fresh `monitor_node` with default parameters gets 100 joint states a second, and
`examples/verdict_consumer.py` follows it in another process. The fault is the signal or the call that causes it.
"""

from __future__ import annotations

import argparse
import os
import signal
import statistics
import subprocess
import sys
import threading
import time
from pathlib import Path

import rclpy
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.node import Node
from sensor_msgs.msg import JointState

ROOT = Path(__file__).parents[2]
MONITOR = Path(sys.executable).with_name("monitor_node")
FAULTS = ("no input", "deactivate", "SIGTERM", "SIGKILL", "SIGSTOP")
PERIOD_S = 0.01
WAIT_S = 30.0
MIN_HOLD_S = 0.5


def main() -> None:
    """Print the median and the largest time of each fault [ms]."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("-n", "--runs", type=int, default=10, help="runs of each fault")
    runs = parser.parse_args().runs
    rclpy.init()
    node = rclpy.create_node("fault_notice")
    print("| fault | consumer stops because | median | worst |\n|---|---|---|---|")  # noqa: T201
    for fault in FAULTS:
        results = [measure(node, fault) for _ in range(runs)]
        times = [1e3 * seconds for seconds, _ in results]
        reasons = "; ".join(sorted({reason for _, reason in results}))
        print(f"| {fault} | {reasons} | {statistics.median(times):.0f} ms | {max(times):.0f} ms |", flush=True)  # noqa: T201
    node.destroy_node()
    rclpy.shutdown()


def measure(node: Node, fault: str) -> tuple[float, str]:
    """Return the time from `fault` to the consumer's STOP [s], and the reason without its numbers."""
    consumer = subprocess.Popen(
        [sys.executable, str(ROOT / "examples" / "verdict_consumer.py")], stdout=subprocess.PIPE, text=True
    )
    monitor = subprocess.Popen([str(MONITOR)], stderr=subprocess.DEVNULL)
    sending, ended = threading.Event(), threading.Event()
    sending.set()
    sender = threading.Thread(target=send, args=(node, sending, ended))
    sender.start()
    try:
        lines = iter(consumer.stdout or ())
        next(line for line in lines if "m/s" in line)
        time.sleep(MIN_HOLD_S)
        start = time.time()
        if fault == "no input":
            sending.clear()
        elif fault == "deactivate":
            client = node.create_client(ChangeState, "monitor/change_state")
            client.wait_for_service(WAIT_S)
            start = time.time()
            client.call_async(ChangeState.Request(transition=Transition(id=Transition.TRANSITION_DEACTIVATE)))
        else:
            os.kill(monitor.pid, getattr(signal, fault))
        stop = next(line for line in lines if "STOP" in line and float(line.split()[0]) >= start)
        stamp, _, reason = stop.strip().partition(" STOP: ")
        return float(stamp) - start, reason.partition(" for ")[0]
    finally:
        ended.set()
        sender.join()
        for process in (monitor, consumer):
            process.send_signal(signal.SIGCONT)
            process.terminate()  # a killed monitor's service would take the next run's call
            process.wait()


def send(node: Node, sending: threading.Event, ended: threading.Event) -> None:
    """Publish a robot at rest while `sending`, until `ended`."""
    publisher = node.create_publisher(JointState, "joint_states", 10)
    message = JointState(name=["joint1", "joint2", "joint3", "joint4"], position=[0.3, 1.2, 0.1, -0.4])
    message.velocity = [0.0] * 4
    while not ended.wait(PERIOD_S):
        if sending.is_set():
            message.header.stamp = node.get_clock().now().to_msg()
            publisher.publish(message)
    node.destroy_publisher(publisher)


if __name__ == "__main__":
    main()

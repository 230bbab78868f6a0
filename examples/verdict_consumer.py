# SPDX-License-Identifier: Apache-2.0
"""Stop whenever the last permissive verdict of the monitor no longer holds; docs/consuming.md explains each case.

    python examples/verdict_consumer.py [--timeout SECONDS] [--ros-args -p use_sim_time:=true]

Prints a line whenever the allowed speed changes. A robot controller would set its speed there.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress

import rclpy
from rclpy.duration import Duration
from rclpy.event_handler import QoSLivelinessChangedInfo, SubscriptionEventCallbacks
from rclpy.executors import ExternalShutdownException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.qos import LivelinessPolicy, QoSProfile
from rclpy.task import Future
from rclpy.time import Time
from rclpy.utilities import remove_ros_args
from scara_effmass_msgs.msg import ContactState, ContactStates


class VerdictConsumer(Node):
    """Follows `contact_states`; stops on UNKNOWN, VIOLATION, an old stamp, silence, a lost or a second monitor."""

    def __init__(
        self, timeout_s: float, on_change: Callable[[float, str], None], max_age_s: float | None = None
    ) -> None:
        """Call `on_change(speed, reason)` whenever the allowed speed [m/s] changes; at 0, `reason` says why.

        `timeout_s` is the parameter `timeout` of the monitor, `max_age_s` the largest age of a header stamp (default:
        `timeout_s`).
        """
        super().__init__("verdict_consumer")
        self._max_age = Duration(seconds=timeout_s if max_age_s is None else max_age_s)
        self._on_change = on_change
        self._monitors = self._number = 0
        self._alone_from = 0.0
        self._limit: tuple[float, str] | None = None
        # The monitor offers twice its timeout. A shorter request does not match, and then nothing arrives.
        self._deadline_s = 2.0 * timeout_s
        deadline = Duration(seconds=self._deadline_s)
        qos = QoSProfile(
            depth=10,
            deadline=deadline,
            liveliness=LivelinessPolicy.AUTOMATIC,
            liveliness_lease_duration=deadline,
        )
        events = SubscriptionEventCallbacks(
            deadline=lambda _: self._change(0.0, "deadline missed"), liveliness=self._on_liveliness
        )
        self.create_subscription(ContactStates, "contact_states", self._on_contact_states, qos, event_callbacks=events)
        # Neither event comes before the first match, so start stopped.
        self._change(0.0, "no contact states yet")

    def _on_contact_states(self, states: ContactStates) -> None:
        if self._monitors > 1 or states.sequence_number <= self._number:
            self._alone_from = time.monotonic() + self._deadline_s
        self._number = states.sequence_number
        age = self.get_clock().now() - Time.from_msg(states.header.stamp, clock_type=self.get_clock().clock_type)
        is_permissive = states.verdict in {ContactState.OK, ContactState.WARN} and states.allowable_speed > 0.0
        if time.monotonic() < self._alone_from:
            self._change(0.0, "a second monitor, or a new one")
        elif not is_permissive:
            self._change(0.0, states.reason or "no speed is allowed")
        elif abs(age.nanoseconds) > self._max_age.nanoseconds:  # a queue or a network delayed it, or the clocks differ
            self._change(0.0, f"the joint state is {age.nanoseconds / 1e9:.3f} s old")
        else:
            self._change(states.allowable_speed, "")

    def _on_liveliness(self, event: QoSLivelinessChangedInfo) -> None:
        self._monitors = event.alive_count
        if self._monitors != 1:
            self._change(0.0, "two monitors" if self._monitors else "liveliness lost")

    def _change(self, speed: float, reason: str) -> None:
        if self._limit is None or (speed, reason) != self._limit:
            self._limit = (speed, reason)
            self._on_change(speed, reason)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the changes until a signal comes."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--timeout", type=float, default=0.2, help="parameter `timeout` of the monitor [s]")
    arguments = sys.argv[1:] if arguments is None else arguments
    timeout_s = parser.parse_args(remove_ros_args([parser.prog, *arguments])[1:]).timeout

    def show(speed: float, reason: str) -> None:
        print(f"{time.time():.4f} {f'STOP: {reason}' if reason else f'{speed:.3f} m/s'}", flush=True)  # noqa: T201

    # A signal may come while the node starts, too.
    with ExitStack() as stack, suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.init(args=[*arguments])
        stack.callback(rclpy.try_shutdown)
        node = VerdictConsumer(timeout_s, show)
        stack.callback(node.destroy_node)
        executor = EventsExecutor()
        stack.callback(executor.shutdown)
        executor.add_node(node)
        executor.spin_until_future_complete(Future(), timeout_sec=1e9)


if __name__ == "__main__":
    sys.exit(main())

# SPDX-License-Identifier: Apache-2.0
"""Flow control at rate 0: the next joint state is sent when the monitor has answered the previous one.

The monitor's queue then never holds more than one joint state. Nothing is dropped, and the clock of the monitor equals
that of the recording, however slow the monitor is. Joint states of another device get no answer: after a few timeouts,
those with the same names are sent without waiting.
"""

from __future__ import annotations

import struct
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING

from rclpy.event_handler import QoSSubscriptionMatchedInfo, SubscriptionEventCallbacks
from rclpy.node import Node
from scara_effmass_msgs.msg import ContactStates

from scara_effmass.errors import DecodeError, EffmassError
from scara_effmass.nodes.qos import qos_profile
from scara_effmass.wire.contact_states import decode_contact_states
from scara_effmass.wire.joint_state import JointStateDecoder
from scara_effmass.wire.topics import CONTACT_STATES, STREAM_QOS

if TYPE_CHECKING:
    from scara_effmass.nodes.replay import ReplayReport

JointNames = tuple[str, ...]

MAX_UNANSWERED = 3
"""Unanswered joint states after which those with the same names are sent without waiting."""
MAX_UNANSWERED_IN_A_ROW = 10
"""Unanswered joint states in a row, of names that were answered before, after which the monitor counts as hung."""
UNKNOWN_NAMES_WAIT_NS = 10_000_000
"""Wait for each joint state without an expected answer while nothing has been answered, to avoid a flood."""
WAIT_SLICE_NS = 100_000_000
_STAMP = {0: struct.Struct(">iI"), 1: struct.Struct("<iI")}


def header_stamp_ns(data: bytes) -> int:
    """Return the stamp of a CDR message that begins with a std_msgs/Header, 0 if it is truncated."""
    try:
        sec, nanosec = _STAMP[data[1] & 1].unpack_from(data, 4)
    except (IndexError, struct.error):
        return 0
    return int(sec) * 1_000_000_000 + int(nanosec)


class Lockstep:
    """Counts in the report the `contact_states` messages that answer the joint states sent, matched by header stamp."""

    def __init__(self, node: Node, timeout_s: float, report: ReplayReport) -> None:
        """Subscribe to `contact_states`; `timeout_s` is the maximum wait for an expected answer [s]."""
        self.publishers = 0
        self._report = report
        self._timeout_ns = round(timeout_s * 1e9)
        self._decoder = JointStateDecoder()
        self._answered_names: set[JointNames] = set()
        self._unanswered_by_names: Counter[JointNames] = Counter()
        self._unanswered_in_a_row = 0
        self._awaited_stamp_ns: int | None = None
        self._is_answered = False
        self.topic = node.create_subscription(
            ContactStates,
            CONTACT_STATES,
            self._on_contact_states,
            qos_profile(STREAM_QOS),
            raw=True,
            event_callbacks=SubscriptionEventCallbacks(matched=self._on_matched),
        ).topic_name

    def expect(self, joint_state: bytes) -> JointNames:
        """Prepare for the answer to a joint state that is about to be sent; return its joint names."""
        self._is_answered = False
        try:
            state = self._decoder.decode(joint_state)
        except DecodeError:
            # The monitor answers it with UNKNOWN, whose stamp is not known here.
            self._awaited_stamp_ns = None
            return ()
        # A stamp before 1970 is answered as 0.
        self._awaited_stamp_ns = max(state.stamp_ns, 0)
        return state.names

    def wait(self, names: JointNames, spin_until: Callable[[int, Callable[[], bool]], None]) -> None:
        """Wait for the answer to the joint state just sent. Raises EffmassError if the monitor left or hangs."""
        expected = names in self._answered_names or self._unanswered_by_names[names] < MAX_UNANSWERED
        if not expected and self._answered_names:
            self._report.not_awaited += 1
            return
        timeout_ns = self._timeout_ns if expected else UNKNOWN_NAMES_WAIT_NS
        # In slices: if the whole machine stalls, only one slice passes.
        slice_ns = min(timeout_ns, WAIT_SLICE_NS)
        for _ in range(round(timeout_ns / slice_ns)):
            spin_until(time.monotonic_ns() + slice_ns, lambda: self._is_answered or not self.publishers)
        if self._is_answered:
            self._report.answered += 1
            self._answered_names.add(names)
            self._unanswered_in_a_row = 0
            return
        if not self.publishers:
            raise EffmassError(
                f"{self.topic}: its publisher left after {self._report.answered} answers; rate 0 needs it"
            )
        self._report.unanswered += 1
        self._unanswered_by_names[names] += 1
        self._unanswered_in_a_row += names in self._answered_names
        if self._unanswered_in_a_row >= MAX_UNANSWERED_IN_A_ROW:
            raise EffmassError(f"{self.topic}: {MAX_UNANSWERED_IN_A_ROW} joint states in a row without an answer")

    def _on_contact_states(self, data: bytes) -> None:
        if self._is_answered or self._awaited_stamp_ns not in (None, header_stamp_ns(data)):
            return
        # The watchdog's messages carry the clock, which shows the stamp of the first joint state before it is sent.
        with suppress(DecodeError):
            self._is_answered = not decode_contact_states(data).watchdog

    def _on_matched(self, info: QoSSubscriptionMatchedInfo) -> None:
        self.publishers = info.current_count

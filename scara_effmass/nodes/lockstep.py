"""Flow control of a replay without pace: the next joint state is sent when the monitor has answered the last one.

So the monitor's queue never holds more than one, nothing can be dropped, and its clock is exactly that of the
recording, however slow it is. A joint state that is none of its robot's gets no answer: that is waited for in vain
a few times, then no more for joint states with the same names.
"""

from __future__ import annotations

import time
from collections import Counter
from typing import TYPE_CHECKING

from rclpy.event_handler import SubscriptionEventCallbacks
from scara_effmass_msgs.msg import ContactState

from scara_effmass.errors import DecodeError, EffmassError
from scara_effmass.nodes.qos import qos_profile
from scara_effmass.nodes.replay_stamps import header_stamp_ns
from scara_effmass.wire.joint_state import JointStateDecoder
from scara_effmass.wire.topics import CONTACT_STATE, STREAM_QOS

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.event_handler import QoSSubscriptionMatchedInfo
    from rclpy.node import Node

Names = tuple[str, ...]

IN_VAIN = 3
"""After as many joint states without an answer, those with the same names are no longer expected to get one."""
GIVE_UP = 10
"""So many unanswered in a row, of names that were answered before, mean that the monitor is gone."""
SHORT_WAIT_NS = 10_000_000
"""While nothing has been answered at all, unexpected answers are still waited for this long, lest it be flooded."""
_SLICE_NS = 100_000_000


class Lockstep:
    """Counts the `contact_state`s that come back, by the stamp of the joint state they answer."""

    def __init__(self, node: Node, timeout_s: float) -> None:
        """Listen on `contact_state`; `timeout_s` is how long an expected answer may take."""
        self.answered = 0
        self.unanswered = 0
        self.not_awaited = 0
        self.publishers = 0
        self._timeout_ns = round(timeout_s * 1e9)
        self._decoder = JointStateDecoder()
        self._heard: set[Names] = set()
        self._misses: Counter[Names] = Counter()
        self._in_a_row = 0
        self._awaited_ns: int | None = None
        self._answer_is_here = False
        self.topic = node.create_subscription(
            ContactState,
            CONTACT_STATE,
            self._on_contact_state,
            qos_profile(STREAM_QOS),
            raw=True,
            event_callbacks=SubscriptionEventCallbacks(matched=self._on_matched),
        ).topic_name

    def expect(self, joint_state: bytes) -> Names:
        """Prepare for the answer to a joint state that is about to be sent; return its names."""
        self._answer_is_here = False
        try:
            state = self._decoder.decode(joint_state)
        except DecodeError:
            # Answered too, by an UNKNOWN, but there is no telling its stamp.
            self._awaited_ns = None
            return ()
        # A stamp before 1970 is answered as 0.
        self._awaited_ns = max(state.stamp_ns, 0)
        return state.names

    def wait(self, names: Names, spin_until: Callable[[int, Callable[[], bool]], None]) -> None:
        """Wait for the answer to the joint state just sent. Raises EffmassError when the monitor is gone."""
        expected = names in self._heard or self._misses[names] < IN_VAIN
        if not expected and self._heard:
            self.not_awaited += 1
            return
        patience_ns = self._timeout_ns if expected else SHORT_WAIT_NS
        # In slices: of a time in which the whole machine stood still, one counts.
        slice_ns = min(patience_ns, _SLICE_NS)
        for _ in range(round(patience_ns / slice_ns)):
            spin_until(time.monotonic_ns() + slice_ns, lambda: self._answer_is_here or not self.publishers)
        if self._answer_is_here:
            self.answered += 1
            self._heard.add(names)
            self._in_a_row = 0
            return
        if not self.publishers:
            raise EffmassError(f"{self.topic}: its publisher left after {self.answered} answers; rate 0 needs it")
        self.unanswered += 1
        self._misses[names] += 1
        self._in_a_row += names in self._heard
        if self._in_a_row >= GIVE_UP:
            raise EffmassError(f"{self.topic}: no answer to {GIVE_UP} joint states in a row; the monitor hangs")

    def _on_contact_state(self, data: bytes) -> None:
        if self._awaited_ns is None or header_stamp_ns(data) == self._awaited_ns:
            self._answer_is_here = True

    def _on_matched(self, info: QoSSubscriptionMatchedInfo) -> None:
        self.publishers = info.current_count

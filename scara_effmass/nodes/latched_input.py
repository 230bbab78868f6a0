# SPDX-License-Identifier: Apache-2.0
"""Latched input that a verdict rests on: it counts only while it has one publisher."""

from collections.abc import Callable
from typing import Any

from rclpy.event_handler import QoSSubscriptionMatchedInfo
from rclpy.qos import QoSCompatibility, qos_check_compatible

from scara_effmass.nodes.lifecycle import AnyNode
from scara_effmass.nodes.ros import with_info
from scara_effmass.wire.topics import Qos

_CHECK_S = 0.1


class LatchedInput:
    """Subscription that drops its messages from a second publisher on, even one that has gone again.

    When one publisher is left, a new subscription gets its latched message, which tells who is left.
    """

    def __init__(
        self,
        node: AnyNode,
        message_type: type,
        topic: str,
        qos: Qos,
        take: Callable[[Any], None],
        distrust: Callable[[str], None],
        *,
        name: str = "",
        lost: Callable[[str], None] = lambda _: None,
        raw: bool = True,
    ) -> None:
        """Pass trusted messages to `take`, and to `distrust` why earlier ones count no more.

        `name` stands for the topic in these reasons; `lost` gets why there is no publisher: the last one has gone, or
        none can be connected.
        """
        self._node, self._take, self._distrust, self._lost = node, take, distrust, lost
        self._message_type, self._topic, self._name, self._qos, self._raw = message_type, topic, name or topic, qos, raw
        self._publishers = 0
        """Number of publishers by which the input was distrusted, 0 while it is trusted."""
        self._absence = f"no publishers of {self._name}: must be one"
        self._is_used_up = False
        """Whether the present subscription has lost its last publisher: the next one counts as the first."""
        self._is_misfit = False
        """Whether there are publishers, none of which can be connected."""
        self._subscribe()
        node.create_steady_timer(_CHECK_S, self._renew)

    def _subscribe(self) -> None:
        self._publishers, self._is_used_up, self._number = 0, False, 0
        self._subscription = self._node.create_owned_subscription(
            self._message_type,
            self._topic,
            with_info(self._on_message),
            self._qos,
            raw=self._raw,
            matched=self._on_matched,
        )

    def _on_matched(self, info: QoSSubscriptionMatchedInfo) -> None:
        # While the executor was busy, another publisher may have come and gone.
        self._check(least=min(info.total_count, 2))
        if not info.current_count:
            self._is_used_up = True
            self._lost(self._absence)

    def _check(self, least: int = 1) -> int:
        """Distrust several publishers; return how many there are now.

        `least` is the number of publishers that this subscription has had, at least.
        """
        # The graph knows a publisher before its first message arrives.
        now = self._node.count_publishers(self._subscription.topic_name)
        count = max(now, least)
        if count > 1 and count > self._publishers:
            self._publishers = count
            self._distrust(f"{count} publishers of {self._name}: must be one")
        return now

    def _look_for_misfit(self) -> None:
        """State that no publisher can be connected, or that there is none any more."""
        own = self._subscription.qos_profile
        ends = self._node.get_publishers_info_by_topic(self._subscription.topic_name)
        # Not by identity: each result is a new object.
        is_misfit = bool(ends) and all(
            qos_check_compatible(end.qos_profile, own)[0] == QoSCompatibility.ERROR for end in ends
        )
        if is_misfit and not self._is_misfit:
            self._lost(f"no publisher of {self._name} fits: must be reliable and latched (durability transient_local)")
        elif self._is_misfit and not ends:
            self._lost(self._absence)
        self._is_misfit = is_misfit

    def _renew(self) -> None:
        self._look_for_misfit()
        if self._check() > 1 or not (self._publishers or self._is_used_up):
            return
        if self._publishers:
            self._distrust(f"no {self._topic} since it had several publishers")
        self._node.destroy_subscription(self._subscription)
        self._subscribe()

    def _on_message(self, message: Any, info: dict[str, Any]) -> None:  # noqa: ANN401 - as the message type
        # A message can come before the event of its publisher: that one's numbers begin at 1 again. Some middleware, as
        # Cyclone DDS, has none.
        before, self._number = self._number, info["publication_sequence_number"] or 0
        self._check(least=2 if 0 < self._number <= before else 1)
        if not self._publishers:
            self._take(message)

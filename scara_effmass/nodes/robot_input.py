# SPDX-License-Identifier: Apache-2.0
"""The robot of a node: from a file, or from the topic robot_description."""

from collections.abc import Callable
from dataclasses import replace
from hashlib import sha256

from rclpy.event_handler import QoSSubscriptionMatchedInfo
from rclpy.qos import DurabilityPolicy
from std_msgs.msg import String

from scara_effmass.errors import EffmassError, SettingsError
from scara_effmass.model.load import build_robot, load_robot
from scara_effmass.model.robot import Robot
from scara_effmass.model.urdf import parse_urdf
from scara_effmass.nodes.lifecycle import LifecycleBase
from scara_effmass.settings import MonitorSettings
from scara_effmass.wire import topics

NO_DESCRIPTION = "no robot_description yet"
_CHECK_S = 0.1
_DIGITS = 8
"""Digits of the hash that tells descriptions apart."""


def use_robot(
    node: LifecycleBase,
    settings: Callable[[], MonitorSettings],
    use: Callable[[Robot], None],
    refuse: Callable[[str], None],
    distrust: Callable[[str], None],
) -> None:
    """Call `use` with the robot of `settings`: now, or with `await_robot_description` at each other description.

    Each `refuse(reason)` leaves the node without a robot: no description yet, or one that cannot be used. After
    `distrust(reason)`, with two publishers, the robot counts for nothing until `distrust("")`. Raises EffmassError for
    a robot file that cannot be used.
    """
    if not settings().await_robot_description:
        use(load_robot(settings().robot_path, settings()))
        return
    if robot := settings().robot:
        raise SettingsError(f"{node.get_name()}: robot = {robot!r}: must be empty with await_robot_description")
    refuse(NO_DESCRIPTION)
    _DescriptionInput(node, settings, use, refuse, distrust)


class _DescriptionInput:
    """Takes the robot from the only publisher of robot_description.

    While there are several, none counts. When one is left, a new subscription gets its latched description, which tells
    who is left.
    """

    def __init__(
        self,
        node: LifecycleBase,
        settings: Callable[[], MonitorSettings],
        use: Callable[[Robot], None],
        refuse: Callable[[str], None],
        distrust: Callable[[str], None],
    ) -> None:
        self._node, self._settings, self._use, self._refuse, self._distrust = node, settings, use, refuse, distrust
        self._text = ""
        """Description of the robot in use, empty without one."""
        self._several = 0
        """Number of publishers, 0 if it is one."""
        self._subscribe()
        node.create_steady_timer(_CHECK_S, self._subscribe_again)

    def _subscribe(self) -> None:
        self._subscription = self._node.create_owned_subscription(
            String,
            topics.ROBOT_DESCRIPTION,
            self._on_description,
            topics.DESCRIPTION_QOS,
            matched=self._on_matched,
        )

    def _on_matched(self, _: QoSSubscriptionMatchedInfo) -> None:
        self._has_several()

    def _has_several(self) -> bool:
        """Return whether several publishers can reach this node, and distrust them."""
        # The graph knows a publisher before its first message arrives.
        publishers = self._node.get_publishers_info_by_topic(self._subscription.topic_name)
        count = sum(publisher.qos_profile.durability is not DurabilityPolicy.VOLATILE for publisher in publishers)
        if count > 1 and count != self._several:
            self._several = count
            reason = f"{count} publishers of {topics.ROBOT_DESCRIPTION}: must be one"
            self._node.get_logger().error(reason)
            self._distrust(reason)
        return count > 1

    def _subscribe_again(self) -> None:
        if not self._has_several() and self._several:
            self._several = 0
            self._distrust(f"no {topics.ROBOT_DESCRIPTION} since it had several publishers")
            self._node.destroy_subscription(self._subscription)
            self._subscribe()

    def _on_description(self, message: String) -> None:
        if self._has_several() or self._several:
            return
        text, name = message.data, topics.ROBOT_DESCRIPTION
        if text != self._text:
            self._text = ""
            try:
                stated = parse_urdf(text, name, self._settings())
                digest = sha256(text.encode(errors="surrogatepass")).hexdigest()[:_DIGITS]
                self._use(build_robot(replace(stated, origin=f"{name} {digest}"), self._settings()))
                self._text = text
            except EffmassError as error:
                self._refuse(str(error))
                self._node.get_logger().error(str(error))
        self._distrust("")


def label(robot: Robot) -> str:
    """Return name and origin of a robot, such as "panda (robot_description 1a2b3c4d)"."""
    return f"{robot.name} ({robot.origin})"

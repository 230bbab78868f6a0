# SPDX-License-Identifier: Apache-2.0
"""The robot of a node: from a file, or from the topic robot_description."""

from collections.abc import Callable

from std_msgs.msg import String

from scara_effmass.errors import EffmassError, SettingsError
from scara_effmass.model.load import build_robot, load_robot
from scara_effmass.model.robot import Robot
from scara_effmass.model.urdf import parse_urdf
from scara_effmass.nodes.lifecycle import LifecycleBase
from scara_effmass.settings import MonitorSettings
from scara_effmass.wire import topics

NO_DESCRIPTION = "no robot_description yet"


def use_robot(
    node: LifecycleBase,
    settings: Callable[[], MonitorSettings],
    use: Callable[[Robot], None],
    refuse: Callable[[str], None],
) -> None:
    """Call `use` with the robot of `settings`: now, or with `await_robot_description` at each description.

    Each `refuse(reason)` leaves the node without a robot: no description yet, or one that cannot be used. Raises
    EffmassError for a robot file that cannot be used.
    """
    if not settings().await_robot_description:
        use(load_robot(settings().robot_path, settings()))
        return
    if robot := settings().robot:
        raise SettingsError(f"{node.get_name()}: robot = {robot!r}: must be empty with await_robot_description")
    refuse(NO_DESCRIPTION)

    def on_description(message: String) -> None:
        try:
            use(build_robot(parse_urdf(message.data, "robot_description", settings()), settings()))
        except EffmassError as error:
            refuse(str(error))
            node.get_logger().error(str(error))

    node.create_owned_subscription(String, topics.ROBOT_DESCRIPTION, on_description, topics.DESCRIPTION_QOS)

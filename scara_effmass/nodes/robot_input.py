# SPDX-License-Identifier: Apache-2.0
"""The robot of a node: from a file, or from the topic robot_description."""

from dataclasses import replace
from hashlib import sha256
from typing import TypeVar

from std_msgs.msg import String

from scara_effmass.errors import EffmassError, SettingsError
from scara_effmass.model.load import build_robot, load_robot
from scara_effmass.model.robot import Robot
from scara_effmass.model.urdf import parse_urdf
from scara_effmass.nodes.latched_input import LatchedInput
from scara_effmass.nodes.lifecycle import LifecycleBase
from scara_effmass.nodes.parameters import NodeParameters
from scara_effmass.settings import MonitorSettings
from scara_effmass.wire import topics

NO_DESCRIPTION = "no robot_description yet"
_DIGITS = 8
"""Digits of the hash that tells descriptions apart."""


class RobotParameters(NodeParameters, MonitorSettings):
    """Parameters of a node with a robot."""


Parameters = TypeVar("Parameters", bound=RobotParameters)


class RobotNode(LifecycleBase[Parameters]):
    """Node with the robot of a file, or of the only publisher of robot_description."""

    def use_robot(self, robot: Robot) -> None:
        """Work with `robot`, the first or another one. Raises EffmassError if that is impossible."""
        raise NotImplementedError

    def refuse_robot(self, reason: str) -> None:
        """Work without a robot: there is no description yet, or one that cannot be used."""
        raise NotImplementedError

    def await_model(self) -> None:
        """Work with no robot from here on until `use_robot` or `refuse_robot`: another description has arrived."""

    def distrust_robot(self, reason: str) -> None:
        """Let the robot count for nothing for this `reason`, until it is empty."""
        raise NotImplementedError

    def await_robot(self) -> None:
        """Use the robot of a file now, or with `await_robot_description` the robot of each other description.

        Raises EffmassError for a robot file that cannot be used.
        """
        settings = self.settings
        if not settings.await_robot_description:
            self.use_robot(load_robot(settings.robot_path, settings))
            return
        if settings.robot:
            raise SettingsError(
                f"{self.get_name()}: robot = {settings.robot!r}: must be empty with await_robot_description"
            )
        self.refuse_robot(NO_DESCRIPTION)
        self._description: str | None = None
        """That of the robot in use, empty without one, None before the first."""
        LatchedInput(
            self,
            String,
            topics.ROBOT_DESCRIPTION,
            topics.DESCRIPTION_QOS,
            self._on_description,
            self._on_publishers,
            lost=self._on_absence,
            raw=False,
        )

    def _on_publishers(self, reason: str) -> None:
        self.get_logger().error(reason)
        self.distrust_robot(reason)

    def _on_absence(self, reason: str) -> None:
        """Say why there is no description yet: later on, it outlives its sender."""
        if self._description is None:
            self.refuse_robot(reason)

    def _on_description(self, message: String) -> None:
        text, name = message.data, topics.ROBOT_DESCRIPTION
        if text != self._description:
            self._description = ""
            self.await_model()
            try:
                stated = parse_urdf(text, name, self.settings)
                digest = sha256(text.encode(errors="surrogatepass")).hexdigest()[:_DIGITS]
                self.use_robot(build_robot(replace(stated, origin=f"{name} {digest}"), self.settings))
                self._description = text
            except EffmassError as error:
                self.refuse_robot(str(error))
                self.get_logger().error(str(error))
        self.distrust_robot("")


def label(robot: Robot) -> str:
    """Return name and origin of a robot, such as "panda (robot_description 1a2b3c4d)"."""
    return f"{robot.name} ({robot.origin})"

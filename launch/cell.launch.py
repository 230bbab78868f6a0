"""Starts the nodes of a cell: `ros2 launch scara_effmass cell.launch.py robot:=my_robot.urdf namespace:=cell`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

if TYPE_CHECKING:
    from launch import LaunchContext

ARGUMENTS = (
    DeclareLaunchArgument(
        "params_file",
        default_value="",
        description="YAML file with the parameters of the nodes, each below its name; empty: the defaults",
    ),
    DeclareLaunchArgument(
        "robot",
        default_value="",
        description="robot file, URDF or DH YAML; empty: the parameter of params_file, else the shipped Omron i4-550L",
    ),
    DeclareLaunchArgument(
        "source",
        default_value="none",
        choices=["none", "ni9230", "bag", "sim", "bench"],
        description="where force comes from; none: daq_node and validator_node are not started",
    ),
    DeclareLaunchArgument(
        "namespace",
        default_value="",
        description="namespace of the nodes and of their topics",
    ),
    DeclareLaunchArgument(
        "use_sim_time",
        default_value="false",
        choices=["true", "false"],
        description="take the time from /clock, as when a bag is replayed",
    ),
    DeclareLaunchArgument(
        "log_level",
        default_value="info",
        choices=["debug", "info", "warn", "error", "fatal"],
        description="least severity that the nodes log",
    ),
)


def nodes(context: LaunchContext) -> list[Node]:
    """Return the nodes, with those parameters alone that were asked for: an empty argument sets nothing."""
    given = {argument.name: LaunchConfiguration(argument.name).perform(context) for argument in ARGUMENTS}
    started = [_node("monitor_node", given, {"robot": given["robot"]} if given["robot"] else {})]
    if given["source"] != "none":
        started.append(_node("daq_node", given, {"source": given["source"]}))
        started.append(_node("validator_node", given, {}))
    return started


def _node(executable: str, given: dict[str, str], own: dict[str, str]) -> Node:
    parameters: list[str | dict[str, str] | dict[str, bool]] = [{"use_sim_time": given["use_sim_time"] == "true"}]
    if given["params_file"]:
        parameters.append(given["params_file"])
    return Node(
        package="scara_effmass",
        executable=executable,
        namespace=given["namespace"],
        parameters=[*parameters, own],
        arguments=["--ros-args", "--log-level", given["log_level"]],
        output="screen",
    )


def generate_launch_description() -> LaunchDescription:
    """Return the arguments and the nodes."""
    return LaunchDescription([*ARGUMENTS, OpaqueFunction(function=nodes)])

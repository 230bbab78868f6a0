"""Start the nodes of a cell: `ros2 launch scara_effmass cell.launch.py robot:=my_robot.urdf namespace:=cell`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

if TYPE_CHECKING:
    from launch import LaunchContext
    from launch.events.process import ProcessExited

ARGUMENTS = (
    DeclareLaunchArgument(
        "params_file",
        default_value="",
        description="YAML file with the parameters of the nodes, one section per node; empty: the defaults",
    ),
    DeclareLaunchArgument(
        "robot",
        default_value="",
        description="robot file, URDF or DH YAML; empty: the parameter of params_file, else the shipped Omron i4-550L",
    ),
    DeclareLaunchArgument(
        "source",
        default_value="none",
        choices=["none", "ni9230", "bag", "sim"],
        description="force source; none: daq_node and validator_node are not started",
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
        description="take the time from /clock, for a replayed bag",
    ),
    DeclareLaunchArgument(
        "log_level",
        default_value="info",
        choices=["debug", "info", "warn", "error", "fatal"],
        description="minimum severity that the nodes log",
    ),
)


def nodes(context: LaunchContext) -> list[Node]:
    """Return the nodes; an empty launch argument sets no parameter. Raises FileNotFoundError for a missing params_file.

    ROS would start the nodes without the file, and so the monitor with the shipped robot.
    """
    arguments = {argument.name: LaunchConfiguration(argument.name).perform(context) for argument in ARGUMENTS}
    params_file = arguments["params_file"]
    if params_file and not Path(params_file).is_file():
        raise FileNotFoundError(f"params_file = {params_file}: must be an existing file")
    actions = [_node("monitor_node", arguments, {"robot": arguments["robot"]} if arguments["robot"] else {})]
    if arguments["source"] != "none":
        actions.append(_node("daq_node", arguments, {"source": arguments["source"]}))
        actions.append(_node("validator_node", arguments, {}))
    return actions


def end_launch(event: ProcessExited, context: LaunchContext) -> None:
    """End the launch with status 1 when a node ends before it; only a recording that is over may end `daq_node`.

    An exception is the only way to a status other than 0.
    """
    is_finished = event.returncode == 0 and event.process_name.startswith("daq_node")
    if not context.is_shutdown and not is_finished:
        raise RuntimeError(f"{event.process_name} ended with status {event.returncode}")


def _node(executable: str, arguments: dict[str, str], node_parameters: dict[str, str]) -> Node:
    parameters: list[str | dict[str, str] | dict[str, bool]] = [{"use_sim_time": arguments["use_sim_time"] == "true"}]
    if arguments["params_file"]:
        parameters.append(arguments["params_file"])
    return Node(
        package="scara_effmass",
        executable=executable,
        namespace=arguments["namespace"],
        parameters=[*parameters, node_parameters],
        arguments=["--ros-args", "--log-level", arguments["log_level"]],
        output="screen",
        on_exit=end_launch,
    )


def generate_launch_description() -> LaunchDescription:
    """Return the arguments and the nodes."""
    return LaunchDescription([*ARGUMENTS, OpaqueFunction(function=nodes)])

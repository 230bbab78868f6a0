# SPDX-License-Identifier: Apache-2.0
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
        "robot_from_topic",
        default_value="false",
        choices=["true", "false"],
        description="take the robot from the topic robot_description of the namespace, in place of a file",
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
        default_value="",
        choices=["", "true", "false", "True", "False"],
        description="take the time from /clock; empty: as the including launch file says, true with replay",
    ),
    DeclareLaunchArgument(
        "log_level",
        default_value="info",
        choices=["debug", "info", "warn", "error", "fatal"],
        description="minimum severity that the nodes log",
    ),
    DeclareLaunchArgument(
        "record",
        default_value="",
        description="folder of a new bag that records the topics of the cell; empty: none",
    ),
    DeclareLaunchArgument(
        "replay",
        default_value="",
        description="bag to replay to the nodes with /clock, its topics in the namespace; empty: none",
    ),
    DeclareLaunchArgument(
        "visualization",
        default_value="false",
        choices=["true", "false"],
        description="publish markers for RViz and Foxglove",
    ),
    DeclareLaunchArgument(
        "speed_scaling",
        default_value="",
        description="topic of a trajectory controller's speed scaling factor, which speed_scaling_node then sends, as "
        "/arm_controller/speed_scaling_input; empty: it is not started",
    ),
    DeclareLaunchArgument(
        "dashboard",
        default_value="",
        description="TCP port of the operator's page on this machine (8321); empty: no page",
    ),
    DeclareLaunchArgument(
        "respawn",
        default_value="false",
        choices=["true", "false"],
        description="start a node again 1 s after it ends, for whatever reason; false: its end ends the launch",
    ),
)


def nodes(context: LaunchContext) -> list[Node]:
    """Return the nodes; an empty launch argument sets no parameter. Raises FileNotFoundError for a missing params_file.

    Without this check ROS would ignore a missing file and start the monitor with the shipped robot.
    """
    arguments = {argument.name: LaunchConfiguration(argument.name).perform(context) for argument in ARGUMENTS}
    params_file, robot = arguments["params_file"], arguments["robot"]
    if params_file and not Path(params_file).is_file():
        raise FileNotFoundError(f"params_file = {params_file}: must be an existing file")
    if robot and arguments["robot_from_topic"] == "true":
        raise ValueError(f"robot = {robot}: must be empty with robot_from_topic")
    if arguments["dashboard"] and arguments["robot_from_topic"] == "true":  # the page would show the shipped robot
        rule = "must be empty with robot_from_topic: start `scara-effmass dashboard --robot FILE` beside it"
        raise ValueError(f"dashboard = {arguments['dashboard']}: {rule}")
    if arguments["replay"] and not arguments["use_sim_time"]:
        arguments["use_sim_time"] = "true"
    file: dict[str, str | bool] = {"robot": robot} if robot else {}
    model = {**file, **({"await_robot_description": True} if arguments["robot_from_topic"] == "true" else {})}
    actions = [_node("monitor_node", arguments, model)]
    if arguments["source"] != "none":
        actions.append(_node("daq_node", arguments, {"source": arguments["source"]}))
        actions.append(_node("validator_node", arguments, file))
    if arguments["visualization"] == "true":
        actions.append(_node("visualization_node", arguments, model))
    if arguments["speed_scaling"]:
        actions.append(_node("speed_scaling_node", arguments, {}))
        actions.append(_node("speed_scaling_node", arguments, {"standby": True}, name="speed_scaling_standby"))
    return [*actions, *_commands(arguments)]


def _commands(arguments: dict[str, str]) -> list[Node]:
    """Return the dashboard, the recorder and the replay."""
    page = ["dashboard", "--port", arguments["dashboard"]]
    page += ["--params", arguments["params_file"]] if arguments["params_file"] else []
    page += ["--robot", arguments["robot"]] if arguments["robot"] else []
    commands = {
        "dashboard": page,
        "record": ["record", "-o", arguments["record"]],
        "replay": ["replay", arguments["replay"]],
    }
    return [_node("scara-effmass", arguments, {}, command) for name, command in commands.items() if arguments[name]]


def end_launch(event: ProcessExited, context: LaunchContext) -> None:
    """End the launch with status 1 when a process ends, except for a replay that ends with 0.

    Only an exception gives a launch a status other than 0.
    """
    is_finished = event.returncode == 0 and (event.process_name.startswith("daq_node") or "replay" in event.cmd)
    if not context.is_shutdown and not is_finished:
        raise RuntimeError(f"{event.process_name} ended with status {event.returncode}")


def _node(
    executable: str,
    arguments: dict[str, str],
    own: dict[str, str | bool],
    command: list[str] | None = None,
    name: str | None = None,
) -> Node:
    parameters: list[str | dict[str, str | bool]] = []
    if arguments["use_sim_time"]:  # else the parent's SetParameter("use_sim_time", ...) holds
        parameters.append({"use_sim_time": arguments["use_sim_time"].lower() == "true"})
    if arguments["params_file"] and command is None:
        parameters.append(arguments["params_file"])
    plays_once = executable == "daq_node" and arguments["source"] == "bag"
    respawn = arguments["respawn"] == "true" and command is None and not plays_once
    return Node(
        package="scara_effmass",
        executable=executable,
        name=name,
        namespace=arguments["namespace"],
        parameters=[*parameters, *([own] if own else [])],
        arguments=[*(command or []), "--ros-args", "--log-level", arguments["log_level"]],
        remappings=[("joint_trajectory_controller/speed_scaling_input", arguments["speed_scaling"])]
        if executable == "speed_scaling_node"
        else [],
        output="screen",
        respawn=respawn,
        respawn_delay=1.0,
        on_exit=None if respawn or (command and command[0] == "dashboard") else end_launch,
    )


def generate_launch_description() -> LaunchDescription:
    """Return the arguments and the nodes."""
    return LaunchDescription([*ARGUMENTS, OpaqueFunction(function=nodes)])

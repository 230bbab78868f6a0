# SPDX-License-Identifier: Apache-2.0
"""The launch file, against small fakes of the launch API, because `launch` has no wheel."""

import runpy
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from scara_effmass_msgs.msg import ContactState, ContactStates
from sensor_msgs.msg import JointState

from scara_effmass.bags.files import open_bag
from test.forked import Forked
from test.nodes.conftest import DEEP_QOS, JOINTS, QD, NodeHarness, Q, joint_state, node_environment

Cell = list[Forked]
ROOT = Path(__file__).parents[2]


class Fake:
    """Keeps its keyword arguments as attributes; `name` is the first positional one."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:  # noqa: ANN401
        self.name = args[0] if args else ""
        vars(self).update(kwargs)

    def perform(self, context: SimpleNamespace) -> str:
        return str(context.configurations[self.name])


@pytest.fixture
def launch_file(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Return the globals of the launch file."""
    names = {
        "launch": ["LaunchDescription"],
        "launch.actions": ["DeclareLaunchArgument", "OpaqueFunction"],
        "launch.substitutions": ["LaunchConfiguration"],
        "launch_ros": [],
        "launch_ros.actions": ["Node"],
    }
    for module_name, classes in names.items():
        module = ModuleType(module_name)
        vars(module).update(dict.fromkeys(classes, Fake))
        monkeypatch.setitem(sys.modules, module_name, module)
    return runpy.run_path(str(ROOT / "launch" / "cell.launch.py"))


def context(launch_file: dict[str, Any], **values: str) -> SimpleNamespace:
    defaults = {argument.name: argument.default_value for argument in launch_file["ARGUMENTS"]}
    return SimpleNamespace(configurations={**defaults, **values}, is_shutdown=False)


def test_missing_params_file_ends_the_launch(launch_file: dict[str, Any], tmp_path: Path) -> None:
    params = tmp_path / "cell.yaml"
    with pytest.raises(FileNotFoundError, match=f"params_file = {params}: must be an existing file"):
        launch_file["nodes"](context(launch_file, params_file=str(params)))
    params.write_text("", encoding="utf-8")
    (monitor,) = launch_file["nodes"](context(launch_file, params_file=str(params)))
    assert str(params) in monitor.parameters


@pytest.mark.parametrize(
    ("process", "status", "shutting_down", "fails"),
    [
        ("monitor_node-1", 2, False, True),
        ("monitor_node-1", 0, False, True),
        ("monitor_node-1", -9, True, False),
        ("daq_node-2", 2, False, True),
        ("daq_node-2", 0, False, False),
        ("validator_node-3", -9, False, True),
        ("scara-effmass-4 record", 0, False, True),
        ("scara-effmass-5 replay", 0, False, False),
        ("scara-effmass-5 replay", 2, False, True),
    ],
)
def test_node_that_ends_before_the_launch_ends_it_with_an_error(
    launch_file: dict[str, Any], process: str, status: int, *, shutting_down: bool, fails: bool
) -> None:
    cell = context(launch_file, source="sim")
    nodes = launch_file["nodes"](cell)
    assert len(nodes) == 3
    cell.is_shutdown = shutting_down
    event = SimpleNamespace(process_name=process, returncode=status, cmd=process.split())
    for node in nodes:
        if fails:
            with pytest.raises(RuntimeError, match=f"{process} ended with status {status}"):
                node.on_exit(event, cell)
        else:
            assert node.on_exit(event, cell) is None


def named(nodes: list[Any]) -> dict[str, Any]:
    """Return the nodes by executable, commands by their name."""
    return {node.arguments[0] if node.executable == "scara-effmass" else node.executable: node for node in nodes}


def stated(node: Any) -> dict[str, Any]:  # noqa: ANN401
    return {name: value for item in node.parameters if isinstance(item, dict) for name, value in item.items()}


def test_every_argument_has_a_description(launch_file: dict[str, Any]) -> None:
    assert all(argument.description for argument in launch_file["ARGUMENTS"])


def test_use_sim_time_is_set_only_on_request_and_by_a_replay(launch_file: dict[str, Any]) -> None:
    def sim_time(**values: str) -> list[object]:
        return [stated(node).get("use_sim_time") for node in launch_file["nodes"](context(launch_file, **values))]

    assert sim_time(source="sim") == [None, None, None]
    assert sim_time(use_sim_time="false") == [False]
    assert sim_time(use_sim_time="true", record="bag") == [True, True]
    assert sim_time(use_sim_time="True") == [True]  # as Python, and so an including launch file, writes it
    assert sim_time(use_sim_time="False") == [False]
    assert sim_time(replay="bag") == [True, True]
    assert sim_time(replay="bag", use_sim_time="false") == [False, False]


def test_robot_is_a_file_or_the_topic(launch_file: dict[str, Any]) -> None:
    cell = context(launch_file, robot="arm.urdf", source="sim", visualization="true", dashboard="8321")
    nodes = named(launch_file["nodes"](cell))
    own = {name: stated(node).get("robot") for name, node in nodes.items()}
    robots = dict.fromkeys(("monitor_node", "validator_node", "visualization_node"), "arm.urdf")
    assert own == {**robots, "daq_node": None, "dashboard": None}
    assert nodes["dashboard"].arguments[:5] == ["dashboard", "--port", "8321", "--robot", "arm.urdf"]
    nodes = named(launch_file["nodes"](context(launch_file, robot_from_topic="true", visualization="true")))
    assert [stated(node) for node in nodes.values()] == [{"await_robot_description": True}] * 2
    for name, value in (("robot", "arm.urdf"), ("dashboard", "8321")):
        with pytest.raises(ValueError, match=f"{name} = {value}: must be empty with robot_from_topic"):
            launch_file["nodes"](context(launch_file, robot_from_topic="true", **{name: value}))


def test_speed_scaling_is_sent_to_the_topic_of_the_controller(launch_file: dict[str, Any]) -> None:
    assert "speed_scaling_node" not in named(launch_file["nodes"](context(launch_file)))
    nodes = named(launch_file["nodes"](context(launch_file, speed_scaling="/arm/speed_scaling_input")))
    topic = "joint_trajectory_controller/speed_scaling_input"
    assert nodes["speed_scaling_node"].remappings == [(topic, "/arm/speed_scaling_input")]
    both = launch_file["nodes"](context(launch_file, speed_scaling="/arm/speed_scaling_input"))[1:]
    assert [stated(node).get("standby", False) for node in both] == [False, True]
    assert both[0].remappings == both[1].remappings
    assert nodes["monitor_node"].remappings == []


@pytest.mark.parametrize(("source", "again"), [("sim", True), ("bag", False)])
def test_nodes_respawn_but_nothing_is_played_twice(launch_file: dict[str, Any], source: str, *, again: bool) -> None:
    cell = context(launch_file, source=source, record="bag", replay="bag", respawn="true")
    nodes = named(launch_file["nodes"](cell))
    respawned = {name: node.respawn for name, node in nodes.items()}
    others = dict.fromkeys(("record", "replay"), False)
    assert respawned == {"monitor_node": True, "daq_node": again, "validator_node": True, **others}
    assert all(node.respawn != (node.on_exit is not None) for node in nodes.values())


def command_of(node: Any, folder: Path, number: int) -> list[str]:  # noqa: ANN401
    """Return the command line that launch_ros makes of `node`: parameters of a dict become a file for all nodes."""
    words = [str(Path(sys.prefix, "lib", node.package, node.executable)), *node.arguments]
    words += ["--ros-args", "-r", f"__ns:=/{node.namespace}"]
    words += ["-r", f"__node:={node.name}"] if node.name else []
    for index, item in enumerate(node.parameters):
        path = item
        if isinstance(item, dict):
            path = folder / f"launch_params_{number}_{index}.yaml"
            path.write_text(yaml.safe_dump({"/**": {"ros__parameters": item}}), encoding="utf-8")
        words += ["--params-file", str(path)]
    return words


@pytest.fixture
def start_cell(launch_file: dict[str, Any], own_domain: int, tmp_path: Path) -> Iterator[Callable[..., Cell]]:
    """Start the processes of a cell."""
    processes: Cell = []
    environment = node_environment(own_domain, tmp_path)

    def start(**arguments: str) -> Cell:
        own = []
        for node in launch_file["nodes"](context(launch_file, **arguments)):
            words = command_of(node, tmp_path, len(processes))
            own.append(Forked(words, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True))
            processes.append(own[-1])
        return own

    yield start
    for process in processes:
        process.kill()
        process.wait()


def test_two_cells_side_by_side_keep_to_their_namespaces(
    start_cell: Callable[..., Cell], own_domain: int, tmp_path: Path
) -> None:
    cells = {
        name: start_cell(namespace=name, source="sim", record=str(tmp_path / name), use_sim_time="false")
        for name in ("left", "right")
    }
    harness = NodeHarness(own_domain, tmp_path)
    received: dict[str, list[ContactStates]] = {name: [] for name in cells}
    senders = {}
    for name, states in received.items():
        harness.node.create_subscription(ContactStates, f"/{name}/contact_states", states.append, DEEP_QOS)
        senders[name] = harness.node.create_publisher(JointState, f"/{name}/joint_states", DEEP_QOS)

    arrays: list[DiagnosticArray] = []
    harness.node.create_subscription(DiagnosticArray, "/diagnostics", arrays.append, DEEP_QOS)

    def send() -> None:
        senders["left"].publish(joint_state())
        senders["right"].publish(joint_state(names=JOINTS[1:], position=Q[1:], velocity=QD[1:]))

    def answered() -> bool:
        reasons = {states.reason for states in received["right"]}
        return any(states.verdict == ContactState.OK for states in received["left"]) and any(
            reason.startswith("joint joint1 is missing") for reason in reasons
        )

    def recorded() -> bool:
        topics = ("contact_states", "force", "joint_states")
        return all(harness.node.count_subscribers(f"/{name}/{topic}") >= 2 for name in cells for topic in topics)

    harness.spin_until(lambda: recorded() and answered(), repeat=send)
    config = yaml.safe_load((ROOT / "config" / "diagnostic_aggregator.yaml").read_text(encoding="utf-8"))
    groups = [item for item in config["analyzers"]["ros__parameters"].values() if isinstance(item, dict)]
    assert not any("discard_stale" in group for group in groups)  # which shows a killed node as OK
    wanted = {f"/{name}{status}" for name in cells for group in groups for status in group.get("expected", ())}
    reporters = {f"/{name}/{node}" for name in cells for node in ("monitor", "daq", "validator")}

    def statuses() -> set[str]:
        return {status.name for array in arrays for status in array.status}

    harness.spin_until(lambda: wanted <= statuses() and reporters <= {name.split(":")[0] for name in statuses()})
    harness.spin_until(lambda: all(sender.get_subscription_count() >= 2 for sender in senders.values()))
    # The recorder takes what it receives some time after it has subscribed: send for some more diagnostics.
    known = len(arrays)
    harness.spin_until(lambda: len(arrays) > known + 12, repeat=send)
    for status in statuses():  # each belongs to one analyzer
        assert sum(any(part in status for part in group["contains"]) for group in groups) == 1, status
    harness.close()
    assert {states.verdict for states in received["right"]} == {ContactState.UNKNOWN}
    for name, cell in cells.items():
        for process in cell:
            process.terminate()
        assert [(process.communicate()[1][-300:], process.returncode)[1] for process in cell] == [0] * 4
        with open_bag(tmp_path / name) as bag:
            names = {topic.name for topic in bag.topics} - {"/diagnostics"}
        assert {f"/{name}/contact_states", f"/{name}/force", f"/{name}/joint_states"} <= names
        assert {topic.split("/")[1] for topic in names} == {name}

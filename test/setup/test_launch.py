"""The launch file, against small fakes of the launch API, because `launch` has no wheel."""

import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

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
    ],
)
def test_node_that_ends_before_the_launch_ends_it_with_an_error(
    launch_file: dict[str, Any], process: str, status: int, *, shutting_down: bool, fails: bool
) -> None:
    cell = context(launch_file, source="sim")
    nodes = launch_file["nodes"](cell)
    assert len(nodes) == 3
    cell.is_shutdown = shutting_down
    event = SimpleNamespace(process_name=process, returncode=status)
    for node in nodes:
        if fails:
            with pytest.raises(RuntimeError, match=f"{process} ended with status {status}"):
                node.on_exit(event, cell)
        else:
            assert node.on_exit(event, cell) is None

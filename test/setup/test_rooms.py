# SPDX-License-Identifier: Apache-2.0
"""Import rules: a room imports only from rooms below it, and each foreign library has its rooms."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[2] / "scara_effmass"

FLOORS = (
    {"codes", "errors", "extras", "input_files", "share", "streams", "url", "values", "settings"},
    {"iso15066"},
    {"model"},
    {"reference"},
    {"kernel"},
    {"identification"},
    {"safety", "impacts"},
    {"wire"},
    {"bags"},
    {"sim", "importers"},
    {"daq"},
    {"cell"},
    {"analysis"},
    {"nodes"},
    {"dashboard"},
    {"studies"},
    {"cli"},
    {"__init__", "__main__"},
)
"""The rooms from the bottom up. Rooms on one floor do not import each other, except on the bottom floor."""

PURE = {
    "values",
    "codes",
    "settings",
    "model",
    "reference",
    "iso15066",
    "kernel",
    "identification",
    "safety",
    "impacts",
}
PURE |= {"cell"}
IMPURE = {"rclpy", "logging", "threading", "time", "datetime", "asyncio"}
"""Libraries that pure rooms do not import: ROS, loggers, threads, clocks. Time is an argument."""

IMPORTERS = {
    "rclpy": {"nodes", "cli"},
    "dask": {"cli"},
    "distributed": {"cli"},
    "fsspec": {"url"},
    "pinocchio": {"identification", "model", "reference", "studies"},
    "mcap": {"bags"},
    "rosbags": {"bags"},
    "foxglove": {"nodes"},
    "nidaqmx": {"daq"},
    "lvm_read": {"importers"},
    "nptdms": {"importers"},
    "mujoco": {"sim"},
    "jinja2": {"analysis"},
    "nicegui": {"dashboard"},
    "matplotlib": {"analysis", "studies"},
    "numba": {"kernel"},
    "pyarrow": {"analysis", "bags", "studies"},
    "scipy": {
        "analysis",
        "cell",
        "daq",
        "identification",
        "impacts",
        "iso15066",
        "model",
        "reference",
        "sim",
        "studies",
    },
}
"""The rooms that may import a library."""
MESSAGE_IMPORTERS = {"nodes", "wire", "cli"}

FLOOR_OF = {room: floor for floor, rooms in enumerate(FLOORS) for room in rooms}
ROOMS = sorted(
    {path.relative_to(PACKAGE).parts[0].removesuffix(".py") for path in PACKAGE.rglob("*.py")} - {"__init__"}
)


def imports(source: str) -> set[str]:
    """Return the dotted names of all modules imported anywhere in `source`."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"line {node.lineno}: must be an absolute import"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def violation(room: str, name: str) -> str:
    """Return why `room` must not import `name`, empty if it may."""
    library, _, rest = name.partition(".")
    other = rest.partition(".")[0]
    if library == "scara_effmass" and other in FLOOR_OF and other != room:
        is_below = FLOOR_OF[other] < FLOOR_OF[room] or {room, other} <= FLOORS[0]
        return "" if is_below else f"{other} is not below {room}"
    importers = MESSAGE_IMPORTERS if library.endswith("_msgs") else IMPORTERS.get(library, {room})
    if room not in importers:
        return f"{library} must be imported by {', '.join(sorted(importers))} only"
    return f"{room} is pure, {library} is not" if room in PURE and library in IMPURE else ""


@pytest.mark.parametrize("room", ROOMS)
def test_room_imports_only_from_below_and_its_own_libraries(room: str) -> None:
    assert room in FLOOR_OF, f"add {room} to FLOORS and to docs/architecture.md"
    paths = [*(PACKAGE / room).rglob("*.py"), *PACKAGE.glob(f"{room}.py")]
    imported = [(path, name) for path in paths for name in imports(path.read_text(encoding="utf-8"))]
    assert not [f"{path.name}: {problem}" for path, name in imported if (problem := violation(room, name))]


@pytest.mark.parametrize(
    ("room", "source"),
    [
        ("model", "import scara_effmass.nodes"),
        ("safety", "from scara_effmass.impacts import segment"),
        ("errors", "from scara_effmass import model"),
        ("safety", "def f():\n    import rclpy.node"),
        ("safety", "from rclpy import logging"),
        ("safety", "import time"),
        ("nodes", "import matplotlib.pyplot as plt"),
        ("nodes", "import mcap"),
        ("analysis", "import pinocchio"),
        ("bags", "from sensor_msgs.msg import JointState"),
    ],
)
def test_misplaced_import_is_detected(room: str, source: str) -> None:
    assert any(violation(room, name) for name in imports(source))


def executed(node: ast.AST) -> Iterator[ast.AST]:
    """Yield `node` and all nodes in it, without what only a type checker reads."""
    if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
        for other in node.orelse:
            yield from executed(other)
        return
    yield node
    for child in ast.iter_child_nodes(node):
        yield from executed(child)


def imported_modules(name: str, source: str, modules: set[str]) -> set[str]:
    """Return the `modules` that `source` of the module `name` imports anywhere, by statement or "module:function"."""
    found: set[str] = set()
    for node in executed(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            members = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= (members & modules) or {str(node.module)}
        elif isinstance(node, ast.Constant) and str(node.value).startswith("scara_effmass."):
            found.add(str(node.value).partition(":")[0])
    return (found & modules) - {name}


def import_cycle(sources: dict[str, str]) -> list[str]:
    """Return modules that import each other in a circle, empty if there are none."""
    graph = {name: imported_modules(name, source, set(sources)) for name, source in sources.items()}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        cycle: list[str] = error.args[1]
        return cycle
    return []


def test_no_modules_import_each_other() -> None:
    sources: dict[str, str] = {}
    for path in PACKAGE.rglob("*.py"):
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        sources[".".join(parts).removesuffix(".__init__")] = path.read_text(encoding="utf-8")
    assert not import_cycle(sources)


@pytest.mark.parametrize(
    "deferred", ["from scara_effmass import a", "X = 'scara_effmass.a:f'", "def f(): import scara_effmass.a"]
)
def test_cycle_is_detected(deferred: str) -> None:
    assert import_cycle({"scara_effmass.a": "from scara_effmass.b import c", "scara_effmass.b": deferred})
    assert not import_cycle(
        {
            "scara_effmass.a": "import scara_effmass.b",
            "scara_effmass.b": "if TYPE_CHECKING:\n    from scara_effmass import a",
        }
    )


@pytest.mark.live
@pytest.mark.parametrize("module", ["nodes.monitor_node", "nodes.daq_node", "nodes.validator_node", "cli.nodes"])
def test_node_loads_no_simulator_no_study_and_only_with_bags_their_libraries(module: str) -> None:
    code = f"import sys, scara_effmass.{module}; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    bag_libraries = () if module == "nodes.daq_node" else ("mcap", "rosbags")
    assert not [name for name in loaded if name.startswith(("scara_effmass.sim", "scara_effmass.studies", "mujoco"))]
    assert not {*bag_libraries}.intersection(loaded)

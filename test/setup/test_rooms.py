"""Who may import whom: only downwards, and each foreign world through one room."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[2] / "scara_effmass"

FLOORS = (
    {"errors", "share", "values", "settings"},
    {"iso15066"},
    {"model"},
    {"safety", "impacts"},
    {"wire"},
    {"bags"},
    {"sim"},
    {"daq"},
    {"analysis"},
    {"nodes", "paper"},
    {"cli"},
    {"__main__"},
)
"""From the bottom up. Rooms on one floor do not know each other; the bottom floor is one room of single modules."""

PURE = {"values", "settings", "model", "iso15066", "safety", "impacts"}

ONLY = {
    "rclpy": {"nodes", "cli"},
    "pinocchio": {"model"},
    "mcap": {"bags"},
    "rosbags": {"bags"},
    "nidaqmx": {"daq"},
    "mujoco": {"sim"},
    "matplotlib": {"analysis", "paper"},
    "nptdms": {"daq"},
    "pyarrow": {"analysis", "bags"},
    "scipy": {"daq", "analysis", "impacts", "paper", "sim"},
}
"""Who alone may import a library; the `cli` only starts what knows rclpy, it does not talk to it."""

IMPURE = {"rclpy", "logging", "threading", "time", "datetime", "asyncio"}
"""What the pure rooms do without: ROS, loggers, threads and clocks. Time is an argument."""

FLOOR_OF = {room: floor for floor, rooms in enumerate(FLOORS) for room in rooms}

MODULES = sorted(path for path in PACKAGE.rglob("*.py") if path != PACKAGE / "__init__.py")


def room_of(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imports(source: str) -> set[str]:
    """Return the dotted names of all modules that `source` imports, wherever in it."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"line {node.lineno}: a relative import"
            assert node.module is not None
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def misplaced(room: str, names: set[str]) -> list[str]:
    """Return what is wrong with `room` importing `names`."""
    wrong = []
    for name in sorted(names):
        top, _, rest = name.partition(".")
        if top == "scara_effmass":
            other = rest.partition(".")[0]
            if other not in FLOOR_OF or other == room:
                continue
            below = FLOOR_OF[other] < FLOOR_OF[room]
            if not below and FLOOR_OF[room] > 0:
                wrong.append(f"{room} is not above {other}")
            elif not below and other not in FLOORS[0]:
                wrong.append(f"{room} is at the bottom, {other} is not")
        if room not in ONLY.get(top, {room}):
            wrong.append(f"{top} belongs to {' and '.join(sorted(ONLY[top]))}, not to {room}")
        if room in PURE and top in IMPURE:
            wrong.append(f"{room} is pure, {top} is not")
        if top.endswith("_msgs") and room not in {"nodes", "wire", "cli"}:
            wrong.append(f"{top} belongs to wire and nodes, not to {room}")
    return wrong


def test_there_are_modules_to_check() -> None:
    assert {room_of(path) for path in MODULES} >= {"model", "iso15066", "safety", "wire", "bags", "nodes", "cli"}


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_only_downwards_and_only_its_own_libraries(path: Path) -> None:
    room = room_of(path)
    assert room in FLOOR_OF, f"{room} has no floor: give it one here and in the design"
    assert not misplaced(room, imports(path.read_text(encoding="utf-8")))


@pytest.mark.parametrize(
    ("room", "source"),
    [
        ("model", "import scara_effmass.nodes"),
        ("iso15066", "from scara_effmass.model import robot"),
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
def test_a_misplaced_import_is_found(room: str, source: str) -> None:
    assert misplaced(room, imports(source))

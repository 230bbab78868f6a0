# SPDX-License-Identifier: Apache-2.0
"""The ROS manifests name exactly the packages that the code and the messages use."""

import ast
import re
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from scara_effmass.extras import EXTRAS

ROOT = Path(__file__).parents[2]
MESSAGES = sorted((ROOT / "msg_schemas/msg").glob("*.msg"))

ROSDEP_KEYS = {
    "argcomplete": "python3-argcomplete",
    "jinja2": "python3-jinja2",
    "matplotlib": "python3-matplotlib",
    "mujoco": "python3-mujoco-pip",
    "numpy": "python3-numpy",
    "pinocchio": "pinocchio",
    "rich": "python3-rich",
    "rosbags": "python3-rosbags-pip",
    "scipy": "python3-scipy",
    "yaml": "python3-yaml",
}
"""rosdep keys that resolve, on Jazzy, to a version that this code supports."""

PIP_ONLY = {
    "distributed": "dask",
    "foxglove": "foxglove-sdk",
    "fsspec": "s3fs",
    "lvm_read": "lvm-read",
    "lz4": "lz4",
    "mcap": "mcap",
    "nicegui": "nicegui",
    "nidaqmx": "nidaqmx",
    "nptdms": "nptdms",
    "numba": "numba",
    "pyarrow": "pyarrow",
    "pydantic": "pydantic",
    "zstandard": "zstandard",
}
"""Names on PyPI of libraries that rosdep has no key for, or one for too old a version; a comment in package.xml has
them.
"""

BROUGHT = {
    *("scara_effmass", "scara_effmass_msgs", "tomli", "typing_extensions"),
    *("annotated_types", "pydantic_core"),  # pydantic
    "markupsafe",  # jinja2
    "mpl_toolkits",  # matplotlib
    *("fastapi", "starlette", "uvicorn"),  # nicegui
}
"""Imported names that others bring, or that no installation of ROS needs."""


def dependencies(path: Path) -> set[str]:
    """Return all dependencies of a manifest."""
    root = ET.parse(path).getroot()
    return {str(element.text) for element in root if element.tag.endswith("depend")}


def imported_packages(folder: Path) -> set[str]:
    names: set[str] = set()
    for path in folder.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                names |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                names.add(node.module.partition(".")[0])
    return names


def is_ros(name: str) -> bool:
    return name.endswith(("_msgs", "_interfaces")) or name in {"rclpy", "std_srvs", "launch", "launch_ros"}


def test_manifest_names_exactly_the_imported_ros_packages() -> None:
    imported = imported_packages(ROOT / "scara_effmass") | imported_packages(ROOT / "launch")
    named = dependencies(ROOT / "package.xml")
    assert {name for name in imported if is_ros(name)} == {name for name in named if is_ros(name)}


def test_manifest_names_every_imported_library() -> None:
    imported = imported_packages(ROOT / "scara_effmass")
    named = dependencies(ROOT / "package.xml")
    keys = set(ROSDEP_KEYS.values())
    assert keys == {name for name in named if name.startswith("python3-") or name in keys} - {"python3-pytest"}
    manifest = (ROOT / "package.xml").read_text(encoding="utf-8")
    for library, name in PIP_ONLY.items():
        assert library in imported | {"numba"} | EXTRAS.keys()  # numba by import_module
        assert name in manifest
        assert not any(name in key for key in named), f"{name} must have no rosdep key on Jazzy"
    others = {name for name in imported if not is_ros(name)} - sys.stdlib_module_names
    assert others <= ROSDEP_KEYS.keys() | PIP_ONLY.keys() | BROUGHT


def test_message_manifest_names_the_packages_of_the_fields() -> None:
    text = "".join(path.read_text(encoding="utf-8") for path in MESSAGES)
    used = set(re.findall(r"^(\w+)/\w+ ", text, re.MULTILINE))
    named = dependencies(ROOT / "msg_schemas/package.xml")
    assert used == {name for name in named if name.endswith(("_msgs", "_interfaces"))}


@pytest.mark.parametrize("path", MESSAGES, ids=lambda path: path.stem)
def test_message_is_built(path: Path) -> None:
    assert f"msg/{path.name}\n" in (ROOT / "msg_schemas/CMakeLists.txt").read_text(encoding="utf-8")


def test_executables_are_installed_for_ros2_run() -> None:
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    executables = {"scara-effmass", *re.findall(r"^(\w+_node) = ", text, re.MULTILINE)}
    assert len(executables) > 1
    assert executables == {path.name for path in (ROOT / "scripts/executables").iterdir()}

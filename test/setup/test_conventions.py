# SPDX-License-Identifier: Apache-2.0
"""Rules of style that no linter checks."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = sorted((ROOT / "scara_effmass").rglob("*.py"))
TESTS = sorted(path for path in (ROOT / "test").rglob("*.py") if path != Path(__file__))


def lines_with(pattern: str, paths: list[Path]) -> list[str]:
    """Return `path:line` of every line that matches `pattern`."""
    return [
        f"{path.relative_to(ROOT)}:{number}"
        for path in paths
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1)
        if re.search(pattern, line)
    ]


@pytest.mark.parametrize(
    ("pattern", "paths"),
    [
        pytest.param(r"would be right", PACKAGE, id="errors say what a value must be"),
        pytest.param(r"/ \"shared\"|\.\./shared", TESTS, id="tests read only files of the tree"),
        pytest.param(r"from scara_effmass.* import .*\b_[a-z]", TESTS, id="tests import only public names"),
    ],
)
def test_pattern_is_absent(pattern: str, paths: list[Path]) -> None:
    assert lines_with(pattern, paths) == []


def test_only_root_an_installed_driver_and_a_missing_browser_skip_tests() -> None:
    allowed = r"os\.geteuid|find_library\(\"nidaqmx|CHROMIUM is None|not shutil\.which\(\"chromium\""
    assert lines_with(rf"pytest\.skip|importorskip|mark\.skip(?!if\(({allowed}))", TESTS) == []


def test_every_source_file_states_its_licence() -> None:
    folders = ("benchmarks", "cmake", "docs", "examples", "launch", "msg_schemas", "scara_effmass", "scripts", "test")
    files = [path for folder in folders for path in (ROOT / folder).rglob("*")]
    sources = [path for path in files if path.suffix in {".py", ".sh", ".cmake"} or path.name == "CMakeLists.txt"]
    sources += [ROOT / name for name in (".ci/run", "Makefile", "scripts/ros_executable", "setup.py")]
    headers = {path: path.read_text(encoding="utf-8").splitlines()[:2] for path in sources}
    assert [path for path in headers if "# SPDX-License-Identifier: Apache-2.0" not in headers[path]] == []


@pytest.mark.parametrize("path", sorted((ROOT / "scara_effmass/kernel").glob("*.py")), ids=lambda path: path.stem)
def test_functions_of_the_kernel_have_at_most_60_lines(path: Path) -> None:
    functions = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.FunctionDef)]
    lengths = {node.name: (node.end_lineno or 0) - node.lineno + 1 for node in functions}
    assert {name: length for name, length in lengths.items() if length > 60} == {}

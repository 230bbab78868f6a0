# SPDX-License-Identifier: Apache-2.0
"""Every reason that the code can give has a remedy, and the documentation lists them all."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.errors import DecodeError, EffmassError
from scara_effmass.model.urdf import parse_urdf
from scara_effmass.safety.remedies import REMEDIES, remedy
from scara_effmass.settings import MonitorSettings
from scara_effmass.wire.joint_state import JointStateDecoder

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "scara_effmass"
SAFETY = sorted((PACKAGE / "safety").glob("*.py"))
OTHERS = [
    PACKAGE / name
    for name in (
        "model/robot.py",
        "model/inertial_check.py",
        "nodes/monitor_node.py",
        "nodes/robot_input.py",
        "nodes/lifecycle.py",
    )
] + [PACKAGE / "analysis/time_series.py"]
"""Other modules in which a reason of the monitor begins."""
NAMES = re.compile(
    r"reason|masses|.*_reason|error|warning|_empty_velocity|_payload|NO_CLAMPING_FORCE|NO_JOINT_STATE|NO_DESCRIPTION"
)
"""Variables and attributes that hold reasons."""
CALLS = re.compile("reject|mark_stale|_?publish_last|_?unknown|unknown_decision")
"""Functions that take a reason."""
NO_REASONS = {"remedy", "_disagreement", "_choice", "suggested_map", "joint_map_hint", "core"}
"""Functions of `safety` whose text is not a reason, or only a part of one."""
PREFIXES = ("held after: ", "latched until reset: ")


def sentences(value: ast.AST | None) -> Iterator[str]:
    """Yield the texts in an expression, "…" in place of values."""
    if isinstance(value, ast.JoinedStr):
        parts = (part.value if isinstance(part, ast.Constant) else "…" for part in value.values)
        yield "".join(map(str, parts))
    elif isinstance(value, ast.Constant) and isinstance(value.value, str):
        yield value.value
    elif value is not None and not isinstance(value, (ast.Compare, ast.Subscript)):
        for child in ast.iter_child_nodes(value):
            yield from sentences(child)


def name_of(node: ast.AST) -> str:
    return getattr(node, "attr", None) or getattr(node, "id", None) or ""


def reasons(path: Path, *, returned: bool) -> Iterator[tuple[str, str]]:
    """Yield place and text of every reason in a module: assigned, passed on, and, if so asked, returned."""
    found: list[tuple[int, ast.AST | None]] = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef) and returned and node.name not in NO_REASONS:
            if node.returns is not None and re.search(r"\bstr\b", ast.unparse(node.returns)):
                found += [(item.lineno, item.value) for item in ast.walk(node) if isinstance(item, ast.Return)]
        elif isinstance(node, ast.Assign | ast.AugAssign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names = [name_of(item) for target in targets for item in ast.walk(target)]
            if any(NAMES.fullmatch(name) for name in names):
                found.append((node.lineno, node.value))
        elif isinstance(node, ast.Call) and CALLS.fullmatch(name_of(node.func)):
            found += [(node.lineno, argument) for argument in node.args]
    for line, value in found:
        for text in sentences(value):
            if len(re.findall(r"[a-z]{2,}", text)) > 1 and not text.startswith(PREFIXES):
                yield f"{path.name}:{line}", text


ALL_REASONS = sorted(
    {item for path in SAFETY for item in reasons(path, returned=True)}
    | {item for path in OTHERS for item in reasons(path, returned=False)}
)


@pytest.mark.parametrize(("place", "text"), ALL_REASONS)
def test_reason_has_a_remedy(place: str, text: str) -> None:
    assert remedy(text), place
    assert remedy(f"held after: {text}") == remedy(f"latched until reset: tool: {text}") == remedy(text)


def test_the_search_finds_reasons_of_every_module() -> None:
    modules = {place.partition(":")[0] for place, _ in ALL_REASONS}
    assert {"joint_state_validator.py", "monitor.py", *(path.name for path in OTHERS)} <= modules
    assert len(ALL_REASONS) > 40


@pytest.mark.parametrize("part", REMEDIES)
def test_every_remedy_belongs_to_a_reason(part: str) -> None:
    """A row without a reason, or behind a more general one, would never be read."""
    texts = [text for _, text in ALL_REASONS] + ["JointState: …", "robot_description: …", "other reasons"]
    first = {
        next((row for row in REMEDIES if re.search(re.escape(row).replace("…", ".*"), text)), "") for text in texts
    }
    assert part in first


@given(st.binary(max_size=40))
def test_undecodable_joint_state_has_a_remedy(data: bytes) -> None:
    with pytest.raises(DecodeError) as error:
        JointStateDecoder().decode(data)
    assert remedy(str(error.value))


def test_invalid_robot_description_has_a_remedy() -> None:
    with pytest.raises(EffmassError) as error:
        parse_urdf("<robot/>", "robot_description", MonitorSettings())
    assert remedy(str(error.value))


def test_text_without_a_reason_has_no_remedy() -> None:
    assert remedy("") == remedy("an unknown text") == ""


def test_documentation_lists_every_reason_and_remedy() -> None:
    _, _, table = (ROOT / "docs/verdict.md").read_text(encoding="utf-8").partition("| reason | remedy |\n")
    rows = re.findall(r"^\| (.+) \| (.+) \|$", table, re.MULTILINE)
    assert dict(rows) == REMEDIES

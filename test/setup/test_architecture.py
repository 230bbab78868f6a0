# SPDX-License-Identifier: Apache-2.0
"""Every name in docs/architecture.md exists."""

import re
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs/architecture.md").read_text(encoding="utf-8")
ROOMS = {path.stem for path in (ROOT / "scara_effmass").glob("[a-z]*") if path.is_dir() or path.suffix == ".py"}
NAMES = sorted(set(re.findall(rf"`((?:{'|'.join(sorted(ROOMS))})\.[\w.]+)`", TEXT)))


@pytest.mark.parametrize("name", NAMES)
def test_name_exists(name: str) -> None:
    parts = name.split(".")
    length = next(n for n in range(len(parts), 0, -1) if _is_module(parts[:n]))
    target = import_module(".".join(["scara_effmass", *parts[:length]]))
    for part in parts[length:]:
        target = getattr(target, part)


@pytest.mark.parametrize("room", sorted(ROOMS))
def test_room_is_in_the_picture(room: str) -> None:
    assert re.search(rf"[│ ,]{room}\b", TEXT)


def _is_module(parts: list[str]) -> bool:
    path = ROOT.joinpath("scara_effmass", *parts)
    return path.is_dir() or path.with_suffix(".py").is_file()

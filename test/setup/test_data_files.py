"""What a ROS workspace installs beside the code is all there is, each file where it is in the tree."""

from __future__ import annotations

from configparser import ConfigParser
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PREFIX = "share/scara_effmass/"


def installed() -> set[tuple[str, str]]:
    """Return the folder below the prefix and the path in the tree of every file that `setup.cfg` names."""
    config = ConfigParser(delimiters=("=",))
    config.optionxform = str  # type: ignore[assignment,method-assign]
    config.read(ROOT / "setup.cfg", encoding="utf-8")
    return {
        (folder.removeprefix(PREFIX), path.relative_to(ROOT).as_posix())
        for folder, patterns in config["options.data_files"].items()
        for pattern in patterns.split()
        for path in ROOT.glob(pattern)
        if folder.startswith(PREFIX)
    }


@pytest.mark.parametrize("folder", ["bags", "config", "launch"])
def test_every_file_is_installed_where_it_is_in_the_tree(folder: str) -> None:
    files = {path for path in (ROOT / folder).rglob("*") if path.is_file() and "__pycache__" not in path.parts}
    assert files
    in_tree = {(path.parent.relative_to(ROOT).as_posix(), path.relative_to(ROOT).as_posix()) for path in files}
    assert {each for each in installed() if each[1].startswith(f"{folder}/")} == in_tree

# SPDX-License-Identifier: Apache-2.0
"""A ROS workspace installs all shipped files, in the folders that they have in the tree."""

from configparser import ConfigParser
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PREFIX = "share/scara_effmass/"


def installed_files() -> set[tuple[str, str]]:
    """Return (folder below the prefix, path in the tree) of every file named in `setup.cfg`."""
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
def test_shipped_files_keep_their_folders(folder: str) -> None:
    files = {path for path in (ROOT / folder).rglob("*") if path.is_file() and "__pycache__" not in path.parts}
    assert files
    in_tree = {(path.parent.relative_to(ROOT).as_posix(), path.relative_to(ROOT).as_posix()) for path in files}
    assert {(target, path) for target, path in installed_files() if path.startswith(f"{folder}/")} == in_tree


def test_every_template_and_table_is_package_data() -> None:
    config = ConfigParser(delimiters=("=",))
    config.read(ROOT / "setup.cfg", encoding="utf-8")
    package = ROOT / "scara_effmass"
    patterns = config["options.package_data"]["scara_effmass"].split()
    files = {*package.rglob("*.html"), *package.rglob("*.yaml"), *package.rglob("*.msg")}
    assert len(files) > 3
    assert files <= {path for pattern in patterns for path in package.glob(pattern)}

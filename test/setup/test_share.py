# SPDX-License-Identifier: Apache-2.0
from pathlib import Path

import pytest

from scara_effmass.errors import EffmassError
from scara_effmass.share import share

MODULE = "scara_effmass/share.py"


def create(root: Path, *files: str) -> None:
    for file in files:
        path = root / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()


def test_shipped_robot_exists() -> None:
    assert share("config", "omron_i4_550l.yaml").is_file()


def test_checkout_uses_its_own_files(tmp_path: Path) -> None:
    create(tmp_path, MODULE, "package.xml", "config/robot.yaml")
    assert share("config", "robot.yaml", module=tmp_path / MODULE) == tmp_path / "config/robot.yaml"


@pytest.mark.parametrize("library", ["lib/python3.12/site-packages", "local/lib/python3.12/dist-packages", ""])
def test_installation_uses_its_prefix(tmp_path: Path, library: str) -> None:
    create(tmp_path, f"{library}/{MODULE}", "share/scara_effmass/package.xml", "share/scara_effmass/config/robot.yaml")
    path = share("config", "robot.yaml", module=tmp_path / library / MODULE)
    assert path == tmp_path / "share/scara_effmass/config/robot.yaml"


def test_missing_file_is_named() -> None:
    with pytest.raises(EffmassError, match=r"config/no_such_robot\.yaml: does not exist"):
        share("config", "no_such_robot.yaml")


def test_missing_share_folder_is_named(tmp_path: Path) -> None:
    create(tmp_path, MODULE)
    with pytest.raises(EffmassError, match="no share/scara_effmass"):
        share("config", module=tmp_path / MODULE)

# SPDX-License-Identifier: Apache-2.0
"""With --force a command replaces output of its own kind, and never its input."""

from pathlib import Path
from shutil import copy, copytree

import pytest

from scara_effmass.analysis.protocol import Protocol, protocol_yaml
from scara_effmass.share import share
from test.analysis.conftest import RAW, content
from test.cli.conftest import Refused


@pytest.fixture
def folder(tmp_path: Path, swing_bag: Path) -> Path:
    """Folder with a bag, one as a file, a link to it, a robot, a protocol with its raw data, and a table."""
    copytree(swing_bag, tmp_path / "bag")
    (tmp_path / "runs").mkdir()
    copy(next(swing_bag.glob("*.mcap")), tmp_path / "runs" / "run.mcap")
    (tmp_path / "link.mcap").symlink_to("runs/run.mcap")
    (tmp_path / "hard.mcap").hardlink_to(tmp_path / "runs" / "run.mcap")
    copy(share("config", "omron_i4_550l.yaml"), tmp_path / "arm.yaml")
    (tmp_path / "cell.yaml").write_text("monitor:\n  ros__parameters: {robot: arm.yaml}\n")
    (tmp_path / "raw.csv").write_bytes(RAW)
    (tmp_path / "notes.mcap").write_text("notes")
    (tmp_path / "hulls.svg").write_text("notes")
    (tmp_path / "protocol.yaml").write_text(protocol_yaml(Protocol.model_validate(content())), encoding="utf-8")
    return tmp_path


INPUTS = [
    "assess runs/run.mcap -o runs/run.mcap",
    "assess runs/run.mcap -o link.mcap",
    "assess hard.mcap -o ./runs/../runs/run.mcap",
    "assess runs -o runs/run.mcap",
    "import bag -o bag",
    "import bag/bag_0.mcap -o bag",
    "import raw.csv hard.mcap -o runs/run.mcap",
    "demo --bag out/recording --out out",
    "identify bag --robot arm.yaml -o .",
    "identify bag --params cell.yaml -o .",
    "init --robot arm.yaml -o arm.yaml",
    "coverage runs/run.mcap coverage.json -o .",
]


@pytest.mark.parametrize("command", INPUTS)
def test_an_input_is_not_replaced(refused: Refused, folder: Path, command: str) -> None:
    if "out/recording" in command:
        copytree(folder / "bag", folder / "out" / "recording")
    (folder / "coverage.json").write_text("{}")
    assert ": must not be the input " in refused(*command.split(), "--force")


KINDS = [
    "assess runs/run.mcap -o raw.csv",
    "assess runs/run.mcap -o notes.mcap",
    "protocol init -o raw.csv",
    "protocol init -o cell.yaml",
    "protocol fill protocol.yaml -o raw.csv",
    "init -o protocol.yaml",
    "import raw.csv -o notes.mcap",
    "doctor --hulls hulls.svg",
    "identify bag --robot arm.yaml -o other",
    "evidence -o other",
]


@pytest.mark.parametrize("command", KINDS)
def test_a_file_of_another_kind_is_not_replaced(refused: Refused, folder: Path, command: str) -> None:
    (folder / "other").mkdir()
    copy(folder / "arm.yaml", folder / "other")
    copy(folder / "raw.csv", folder / "other" / "impacts.csv")
    assert "is not replaced" in refused(*command.split(), "--force")


@pytest.mark.parametrize("command", ["impacts", "assess bag -o", "protocol init -o", "doctor --params"])
def test_an_empty_path_is_not_the_current_folder(refused: Refused, folder: Path, command: str) -> None:
    assert "must not be empty" in refused(*command.split(), "")
    assert folder.is_dir()

# SPDX-License-Identifier: Apache-2.0
"""`coverage`: recordings and earlier counts give figure and file; refusals are one line."""

import json
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from scara_effmass.bags.writer import BagWriter
from scara_effmass.share import share
from scara_effmass.values import JointState
from scara_effmass.wire.message_types import JOINT_STATE
from test.cli.conftest import JOINTS, START_NS, Cli, Refused


def test_counts_of_an_earlier_run_are_added(swing_bag: Path, cli: Cli, refused: Refused, tmp_path: Path) -> None:
    done = cli("coverage", swing_bag, "-o", tmp_path / "swing")
    assert (done.returncode, done.stderr) == (0, "")
    assert "direction tool" in done.stdout
    assert {path.name for path in (tmp_path / "swing").iterdir()} == {
        f"coverage.{end}" for end in ("json", "png", "svg")
    }
    assert imread(tmp_path / "swing" / "coverage.png").shape[1] > 1000
    assert (tmp_path / "swing" / "coverage.json").stat().st_size < 5000
    earlier = tmp_path / "swing" / "coverage.json"
    line = share("bags", "straight_300_200")
    both = json.loads(cli("coverage", line, earlier, "-o", tmp_path / "both", "--json").stdout)
    swing = json.loads(earlier.read_text(encoding="utf-8"))
    assert both["joint_states"] > swing["joint_states"] > 900
    for name, covered in swing["covered"].items():
        assert name == "fastest_bin_from_m_s" or 0.0 < covered <= both["covered"][name]
    assert "must not be counted twice" in refused("coverage", swing_bag, earlier, "-o", tmp_path / "again")
    assert "--force" in refused("coverage", swing_bag, "-o", tmp_path / "swing")


@pytest.mark.usefixtures("unrendered")
def test_names_of_the_joints_can_be_mapped(swing_bag: Path, cli: Cli, tmp_path: Path) -> None:
    robot = tmp_path / "other.yaml"
    text = share("config", "omron_i4_550l.yaml").read_text(encoding="utf-8")
    robot.write_text(text.replace("name: joint", "name: axis"), encoding="utf-8")
    words = ("coverage", swing_bag, "-o", tmp_path / "out", "--robot", robot, "--joint-map", "joint*=axis*", "--json")
    result = json.loads(cli(*words).stdout)
    assert result["joint_states"] > 900
    assert result["covered"]["position axis1"] > 0.0


def test_other_file_is_refused(refused: Refused, tmp_path: Path) -> None:
    for content in ("{}", "no JSON", "[1]"):
        (tmp_path / "other.json").write_text(content, encoding="utf-8")
        assert "must be a coverage.json" in refused("coverage", tmp_path / "other.json", "-o", tmp_path / "out")


@pytest.mark.usefixtures("unrendered")
def test_joint_states_that_are_not_valid_are_counted_with_their_reason(cli: Cli, tmp_path: Path) -> None:
    halves = [(JOINTS[:2], START_NS), (JOINTS[2:], START_NS + 1), (JOINTS, START_NS + 2)]
    with BagWriter(tmp_path / "a.mcap") as bag:
        states = (JointState(stamp, names, np.zeros(len(names)), np.zeros(len(names))) for names, stamp in halves)
        bag.write_joint_states("/joint_states", states)
    done = cli("coverage", tmp_path / "a.mcap", "-o", tmp_path / "out")
    lines = [line.split(maxsplit=2)[2] for line in done.stdout.splitlines() if line.startswith("not valid")]
    assert {"1: joint joint1 is missing", "1: joint joint3 is missing"} <= set(lines)


def test_losses_are_listed_also_without_a_valid_joint_state(cli: Cli, tmp_path: Path) -> None:
    with BagWriter(tmp_path / "a.mcap") as bag:
        bag.write("/joint_states", JOINT_STATE, START_NS, b"damaged")
    done = cli("coverage", tmp_path / "a.mcap", "-o", tmp_path / "out", "--json")
    assert (done.returncode, done.stderr) == (0, "")
    result = json.loads(done.stdout)
    assert result["joint_states"] == 0
    assert [loss.partition(": left out: ")[0] for loss in result["losses"]] == [f"{tmp_path / 'a.mcap'}: /joint_states"]

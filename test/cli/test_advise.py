# SPDX-License-Identifier: Apache-2.0
"""`advise`: factors, figure and a motion whose assessment has no VIOLATION."""

import json
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from scara_effmass.analysis.assessment import generated_description
from scara_effmass.bags.files import open_bag
from scara_effmass.share import share
from scara_effmass.sim.motion import sample_moves
from scara_effmass.sim.recordings import EPOCH_NS, JOINTS, write_recording
from scara_effmass.studies.shipped_bags import tour_moves
from scara_effmass.values import JointState, RunInfo, at_most
from test.cli.conftest import Cli, Refused


def write_tour(path: Path, velocity: float = 1.0) -> Path:
    """Write seven fast seconds of the tour, through a stretched pose, with the share `velocity` of its velocities."""
    q, qd = sample_moves(tour_moves(), 25)
    start = 390 + int(np.abs(qd[390:410]).max(axis=1).argmin())
    rows = [(q[start], 0.0 * q[start])] * 13 + list(zip(q[start:575], velocity * qd[start:575], strict=True))
    states = (JointState(EPOCH_NS + number * 40_000_000, JOINTS, *row) for number, row in enumerate(rows))
    write_recording(path, RunInfo(stamp_ns=EPOCH_NS, simulated=True, note="test"), states, (), overwrite=False)
    return path


def write_swing(path: Path, times: list[float]) -> Path:
    """Write a slow swing of joint 1 at the `times` [s]."""
    rows = [(np.array([0.1 * np.sin(t), 1.2, 0.1, 0.0]), np.array([0.1 * np.cos(t), 0.0, 0.0, 0.0])) for t in times]
    states = (JointState(EPOCH_NS + round(t * 1e9), JOINTS, *row) for t, row in zip(times, rows, strict=True))
    write_recording(path, RunInfo(stamp_ns=EPOCH_NS, simulated=True, note="test"), states, (), overwrite=False)
    return path


@pytest.fixture(scope="module")
def fast_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recording of the fast tour."""
    return write_tour(tmp_path_factory.mktemp("advise") / "fast.mcap")


@pytest.mark.parametrize(("verdict", "absent"), [("warn", ["VIOLATION"]), ("ok", ["VIOLATION", "WARN"])])
def test_assessing_the_advised_tour_finds_nothing_too_fast(
    cli: Cli, fast_bag: Path, tmp_path: Path, verdict: str, absent: list[str]
) -> None:
    done = cli("advise", fast_bag, "-o", tmp_path / "out", "--verdict", verdict, "--json")
    assert (done.returncode, done.stderr) == (0, "")
    advice = json.loads(done.stdout)
    table = (tmp_path / "out" / "segments.csv").read_text(encoding="utf-8").splitlines()
    assert len(table) == len(advice["segments"]) + 1
    assert imread(tmp_path / "out" / "advice.png").shape[1] > 1000
    cycle = advice["cycle_time"]
    assert cycle["recorded_s"] == pytest.approx(7.5, abs=0.3)
    assert cycle["advised_s"] == pytest.approx(sum(segment["advised_s"] for segment in advice["segments"]))
    advised = tmp_path / "out" / "advised.mcap"
    result = json.loads(cli("assess", advised, "-o", tmp_path / "advised.csv", "--json").stdout)
    assert not [name for name in absent if result["cycles_by_verdict"][name]]
    with open_bag(advised) as bag:
        assert generated_description(bag).startswith(f"generated: the motion of {fast_bag}")


@pytest.mark.usefixtures("unrendered")
def test_segment_without_a_speed_is_named_and_writes_no_motion(
    cli: Cli, refused: Refused, fast_bag: Path, tmp_path: Path
) -> None:
    done = cli("advise", fast_bag, "-o", tmp_path / "out", "--person-speed", "9", "--contact-point", "tool")
    assert (done.returncode, done.stderr) == (1, "")
    assert "no speed is allowed: " in done.stdout
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        *("segments.csv", "advice.json", "advice.png", "advice.svg")
    }
    assert "--force" in refused("advise", fast_bag, "-o", tmp_path / "out")


@pytest.mark.usefixtures("unrendered")
def test_motion_without_velocities_is_advised_by_its_positions(cli: Cli, tmp_path: Path) -> None:
    zeros = write_tour(tmp_path / "zeros.mcap", velocity=0.0)
    done = cli("advise", zeros, "-o", tmp_path / "out")
    assert (done.returncode, done.stderr) == (1, "")
    assert "--velocity from-positions takes those of the positions" in done.stdout
    done = cli("advise", zeros, "-o", tmp_path / "out", "--force", "--velocity", "from-positions")
    assert done.returncode == 0
    table = (tmp_path / "out" / "segments.csv").read_text(encoding="utf-8").splitlines()[1:]
    _, start, _, _, factor, decides = min((row.split(",", 5) for row in table), key=lambda row: float(row[4]))
    assert f"slowest         factor {at_most(float(factor), 3)} from {float(start):.3f} s: {decides}" in done.stdout
    advised = cli("assess", tmp_path / "out" / "advised.mcap", "-o", tmp_path / "advised.csv", "--json")
    assert not json.loads(advised.stdout)["cycles_by_verdict"]["VIOLATION"]


def test_settings_that_cannot_be_re_timed_are_refused(refused: Refused, fast_bag: Path, tmp_path: Path) -> None:
    assert "must be 0" in refused("advise", fast_bag, "-o", tmp_path / "out", "--velocity-window", "0.04")
    ur5 = share("config", "robots", "ur5_robot.urdf")
    ok = refused("advise", fast_bag, "-o", tmp_path / "out", "--verdict", "ok", "--robot", ur5)
    assert ok.startswith("--verdict = ok: must be warn while no verdict can be OK: payload not stated: ")
    assert "must be empty" in refused("advise", fast_bag, "-o", tmp_path / "out", "--payload-topic", "payload")
    assert "must be a whole number from 0" in refused("advise", fast_bag, "-o", tmp_path / "out", "--segments", "-1")
    many = refused("advise", fast_bag, "-o", tmp_path / "out", "--segments", "9223372036854775807")
    assert many == "--segments = 9223372036854775807: must be at most 188, the joint states"
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("unrendered")
def test_segment_without_a_joint_state_gets_no_factor(cli: Cli, tmp_path: Path) -> None:
    path = write_swing(tmp_path / "gaps.mcap", [0.02 * number for number in range(50) if number % 10 < 6])
    done = cli("advise", path, "-o", tmp_path / "out", "--segments", "20", "--json")
    assert done.returncode == 1
    segments = json.loads(done.stdout)["segments"]
    empty = [row for row in segments if row["decides"] == "holds no joint state: state fewer segments"]
    assert len(empty) == 4
    assert {row["factor"] for row in empty} == {None}

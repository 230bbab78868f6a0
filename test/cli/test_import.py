# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass import`: force of files in a new bag."""

import json
from pathlib import Path

import numpy as np
import pytest

from scara_effmass.bags.files import open_bag
from test.cli.conftest import Cli, Refused
from test.importers.conftest import force_of, imported


@pytest.fixture
def csv(tmp_path: Path) -> Path:
    """Return a CSV file with 3 s of force and one value that is no number."""
    path = tmp_path / "cell.csv"
    rows = [f"{n / 100:.2f},{'nan' if n == 150 else n}" for n in range(300)]
    path.write_text("\n".join(["t (s),f (N)", *rows]), encoding="utf-8")
    return path


def test_bag_holds_the_imported_blocks(csv: Path, tmp_path: Path, cli: Cli) -> None:
    other = csv.rename(tmp_path / "2 cells.csv")
    done = cli("import", other, other, "-o", tmp_path / "run", "--frame", "cell", "--invert")
    assert done.returncode == 0
    assert done.stdout.splitlines() == [
        "/force          2 cells.csv, f (N): 299 samples at 100 Hz, 1 lost, 0 saturated",
        "/force/file1    2 cells.csv, f (N): 299 samples at 100 Hz, 1 lost, 0 saturated",
        f"written         {tmp_path / 'run'}",
    ]
    expected = imported(other, **{"frame_id": "cell", "sensor.invert": True})
    with open_bag(tmp_path / "run") as bag:
        for topic in ("/force", "/force/file1"):
            blocks = list(bag.force_blocks(topic))
            assert force_of(blocks) == force_of(expected)
            for block, right in zip(blocks, expected, strict=True):
                assert np.array_equal(block.saturated_samples, right.saturated_samples)
                marks = right.saturated_samples
                assert block._replace(force=right.force, saturated_samples=marks) == right
        log_times_ns = [message.log_time_ns for message in bag.messages()]
        assert log_times_ns == sorted(log_times_ns)


def test_json_states_what_was_imported(csv: Path, tmp_path: Path, cli: Cli) -> None:
    result = json.loads(cli("import", csv, "-o", tmp_path / "run.mcap", "--range", "250", "--json").stdout)
    assert result["output"] == str(tmp_path / "run.mcap")
    (topic,) = result["topics"]
    assert topic["sample_rate_hz"] == pytest.approx(100.0)
    assert topic["last_stamp_s"] == pytest.approx(2.99)
    assert {key: topic[key] for key in ("samples", "lost_samples", "saturated_samples", "losses")} == {
        "samples": 299,
        "lost_samples": 1,
        "saturated_samples": 50,
        "losses": [],
    }


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--topic", "g"], "cell.csv: topic = g: must be one of t (s), f (N)"),
        (["--unit", "kN"], "cell.csv: f (N): unit = kN: must be empty, the file states N"),
        (["--unit", "oz"], "invalid choice: 'oz'"),
        (["--sensitivity", "0"], "options: sensor.sensitivity = 0.0: "),
        (["--axis", "w"], "invalid choice: 'w'"),
    ],
)
def test_input_error_is_one_line_and_leaves_nothing(
    csv: Path, tmp_path: Path, options: list[str], message: str, refused: Refused
) -> None:
    assert message in refused("import", csv, "-o", tmp_path / "run", *options)


def test_existing_output_is_replaced_only_with_force(csv: Path, tmp_path: Path, cli: Cli, refused: Refused) -> None:
    words = ("import", csv, "-o", tmp_path / "run")
    assert cli(*words).returncode == 0
    assert "exists" in refused(*words)
    assert cli(*words, "--force").returncode == 0


def test_joint_states_of_a_csv_file_are_assessed(tmp_path: Path, cli: Cli, refused: Refused) -> None:
    rows = [f"{i / 100},{10 + 20 * i / 100},68,20,0,20,0,1e-9,0" for i in range(200)]
    log, mapping, bag = tmp_path / "log.csv", tmp_path / "map.yaml", tmp_path / "run.mcap"
    log.write_text("\n".join(["t,q0,q1,q2,q3,v0,v1,v2,v3", *rows]), encoding="utf-8")
    units = ("deg", "deg", "mm", "deg")
    joints = [f"  joint{i + 1}: {{position: q{i}, velocity: v{i}, unit: {unit}}}" for i, unit in enumerate(units)]
    mapping.write_text("\n".join(["time: t", "joints:", *joints]), encoding="utf-8")
    words = ("import", log, "--joints", mapping, "-o", bag)
    assert cli(*words).stdout.splitlines() == [
        "/joint_states   log.csv: 200 joint states, 1.000 to 2.990 s, with velocities",
        "time            1.000 s later than in the file, which begins at 0 or before",
        f"written         {bag}",
    ]
    result = json.loads(cli("assess", bag, "-o", tmp_path / "a.csv", "--json").stdout)
    assert result["cycles_by_verdict"]["UNKNOWN"] < 40
    assert result["tightest"]["positions"]["joint2"] == pytest.approx(np.radians(68.0))
    assert json.loads(cli(*words, "--force", "--json").stdout)["joint_states"] == 200
    assert "exists" in refused(*words)
    assert "must belong to one file" in refused("import", log, log, *words[2:], "--force")
    for option, setting in (("--time-column", "time_column = q1"), ("--topic", "topic = q1")):
        assert f"--joints = {mapping}: {setting}: must not be stated" in refused(*words, option, "q1", "--force")

"""`demo`: all nodes live on the simulated cell, and the report of their impacts."""

import json
from pathlib import Path

import pytest

from test.cli.conftest import Cli


def test_every_live_impact_is_in_the_recording(cli_process: Cli, tmp_path: Path) -> None:
    done = cli_process("demo", "--duration", "6", "--out", tmp_path / "out", "--json")
    assert done.stderr == ""
    result = json.loads(done.stdout)
    # At least one impact in 6 s, more if the nodes end late; an accepted series needs three.
    assert 1 <= result["live"] == result["both"] <= result["offline"]
    assert result["accepted"] == (result["offline"] >= 3)
    assert done.returncode == (not result["accepted"])
    assert result["recording"]["lost"] == 0
    impact = result["impacts"][0]
    assert impact["simulated"] is True
    assert (impact["configuration"], impact["obstacle_mass"]) == ("300_200", 0.5)
    assert impact["speed"] == pytest.approx(0.25, abs=0.002)
    assert impact["measured_force"] == pytest.approx(202.6, rel=0.01)
    files = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"recording", "report.html", "report.json"} <= files

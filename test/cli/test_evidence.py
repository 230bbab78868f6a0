# SPDX-License-Identifier: Apache-2.0
"""`evidence`: a short run, an interrupted one, and refusals in one line."""

import json
import os
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import mujoco  # noqa: F401 - its first import starts a process, which a test that is not live must not do
import pytest

from test.cli.conftest import Cli

Start = Callable[..., subprocess.Popen[str]]


@pytest.mark.usefixtures("unrendered")
def test_short_run_and_its_continuation(cli: Cli, tmp_path: Path) -> None:
    folder = tmp_path / "new" / "evidence"
    result = cli("evidence", "-o", folder, "--impacts", "1", "--jobs", "1")
    assert (result.returncode, result.stderr) == (0, "")
    assert "1 random impacts of i4-550L (MuJoCo); nothing was measured" in result.stdout
    result = cli("evidence", "-o", folder, "--impacts", "2", "--jobs", "1", "--json")
    summary = json.loads(result.stdout)
    assert (summary["impacts"], summary["simulated"]) == (2, True)
    assert len((folder / "impacts.csv").read_text(encoding="utf-8").splitlines()) == 1 + 3 + 3
    other = cli("evidence", "-o", folder, "--impacts", "2", "--seed", "2")
    assert other.returncode == 2
    assert "must be of this seed and version" in other.stderr
    assert cli("evidence", "-o", folder, "--impacts", "1", "--seed", "2", "--force", "--json").returncode == 0


def test_report_of_another_command_is_not_replaced(cli: Cli, tmp_path: Path) -> None:
    (tmp_path / "report.html").write_text("another", encoding="utf-8")
    result = cli("evidence", "-o", tmp_path, "--impacts", "1")
    assert (result.returncode, result.stdout) == (2, "")
    assert "report.html: already exists; use --force to replace it" in result.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]


@pytest.mark.parametrize("name", ["impacts.csv", "report.html", "evidence.png"])
def test_what_is_no_file_is_never_removed(refused: Callable[..., str], tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / name)
    assert f"{name}: is a folder, a device or a pipe" in refused(
        "evidence", "-o", tmp_path, "--impacts", "1", "--force"
    )
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).is_fifo()


@pytest.mark.parametrize(("option", "value"), [("--impacts", "0"), ("--seed", "-1"), ("--jobs", "0.5")])
def test_invalid_number_is_refused(refused: Callable[..., str], option: str, value: str) -> None:
    assert f"{value}: must be a whole number from" in refused("evidence", "-o", "out", option, value)


def test_interrupted_run_ends_with_one_line_and_can_be_resumed(start: Start, cli: Cli, tmp_path: Path) -> None:
    table = tmp_path / "impacts.csv"
    process = start("evidence", "-o", tmp_path, "--impacts", "100000", "--jobs", "2")
    while not (table.exists() and "\n2," in table.read_text(encoding="utf-8")):  # the workers run
        assert process.poll() is None
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    output, errors = process.communicate(timeout=60)
    assert (process.returncode, output, errors) == (130, "", "interrupted\n")
    written = table.read_text(encoding="utf-8")
    count = int(written.splitlines()[-1].split(",")[0]) + 1
    result = cli("evidence", "-o", tmp_path, "--impacts", str(count), "--jobs", "1")
    assert (result.returncode, result.stderr) == (0, "")
    assert table.read_text(encoding="utf-8").startswith(written)
    assert (tmp_path / "report.html").exists()

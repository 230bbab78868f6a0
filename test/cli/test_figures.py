"""`figures`: all of the paper's figures and claims, in a folder that was free."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from matplotlib.image import imread

from scara_effmass.share import share

if TYPE_CHECKING:
    import subprocess
    from collections.abc import Callable
    from pathlib import Path

    Cli = Callable[..., subprocess.CompletedProcess[str]]

DRAWN = [f"figure_{number}" for number in (6, 7, 8, 9, 10, 11, 12, 14, 15, 17, 18, 19)]


def test_everything_is_written_and_said(cli: Cli, tmp_path: Path) -> None:
    folder = tmp_path / "new" / "figures"
    done = cli("figures", "-o", folder, "--json")
    assert (done.returncode, done.stderr) == (0, "")
    result = json.loads(done.stdout)
    assert result["output"] == str(folder)
    assert result["figures"] == DRAWN
    assert result["left_out"] == []
    outcomes = {claim["key"]: claim["outcome"] for claim in result["claims"]}
    forces = ("force_grows", "force_order", "force_proportional", "speed", "midpoint")
    assert {outcomes[key] for key in forces} == {"match"}
    assert outcomes["repetitions"] == "no match"  # the shipped campaign has one of each
    names = {f"{name}.{suffix}" for name in DRAWN for suffix in ("png", "svg")} | {"index.html", "claims.json"}
    assert {path.name for path in folder.iterdir()} == names
    for name in DRAWN:
        height, width, _ = imread(folder / f"{name}.png").shape
        assert width > 800
        assert height > 500
    assert json.loads((folder / "claims.json").read_text(encoding="utf-8"))["claims"] == result["claims"]

    refused = cli("figures", "-o", folder)
    assert refused.returncode == 2
    assert refused.stderr.count("\n") == 1
    assert "--force" in refused.stderr


def test_a_folder_without_impacts_is_refused(cli: Cli, tmp_path: Path) -> None:
    for campaign in (tmp_path / "nowhere", share("bags", "tour")):
        done = cli("figures", "-o", tmp_path / "out", "--campaign", campaign)
        assert done.returncode == 2
        assert done.stderr.count("\n") == 1
        assert str(campaign) in done.stderr
        assert not (tmp_path / "out").exists()


def test_a_file_in_the_way_is_refused(cli: Cli, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    done = cli("figures", "-o", tmp_path / "file")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "file" in done.stderr


def test_the_folder_must_be_named(cli_process: Cli) -> None:
    done = cli_process("figures")
    assert done.returncode == 2
    assert "-o" in done.stderr

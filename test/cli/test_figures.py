# SPDX-License-Identifier: Apache-2.0
"""`figures`: writes the paper's figures and claims, and refuses an existing output."""

import json
from pathlib import Path

from matplotlib.image import imread

from scara_effmass.share import share
from test.cli.conftest import Cli, Refused

FIGURES = [f"figure_{number}" for number in (6, 7, 8, 9, 10, 11, 12, 14, 15, 17, 18, 19)]


def test_all_figures_and_claims_are_written(cli: Cli, refused: Refused, tmp_path: Path) -> None:
    folder = tmp_path / "new" / "figures"
    run = cli("figures", "-o", folder, "--json")
    assert (run.returncode, run.stderr) == (0, "")
    result = json.loads(run.stdout)
    assert result["output"] == str(folder)
    assert result["figures"] == FIGURES
    outcomes = {claim["key"]: claim["outcome"] for claim in result["claims"]}
    forces = ("force_grows", "force_order", "force_proportional", "speed", "midpoint")
    assert {outcomes[key] for key in forces} == {"match"}
    assert outcomes["repetitions"] == "no match"  # one run per case in the shipped campaign
    names = {f"{name}.{suffix}" for name in FIGURES for suffix in ("png", "svg")} | {"index.html", "claims.json"}
    assert {path.name for path in folder.iterdir()} == names
    for name in FIGURES:
        height, width, _ = imread(folder / f"{name}.png").shape
        assert width > 800
        assert height > 500
    assert json.loads((folder / "claims.json").read_text(encoding="utf-8"))["claims"] == result["claims"]

    assert "--force" in refused("figures", "-o", folder)


def test_folder_without_impacts_is_refused(refused: Refused, tmp_path: Path) -> None:
    for campaign in (tmp_path / "nowhere", share("bags", "tour")):
        assert str(campaign) in refused("figures", "-o", tmp_path / "out", "--campaign", campaign)


def test_output_that_is_a_file_is_refused(refused: Refused, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    assert "file: is no folder; must be one, or a new path" in refused("figures", "-o", tmp_path / "file", "--force")


def test_campaign_belongs_to_the_paper_s_robot(refused: Refused, tmp_path: Path) -> None:
    words = (
        "figures",
        "-o",
        tmp_path / "out",
        "--robot",
        share("config", "robots", "panda.urdf"),
        "--campaign",
        tmp_path,
    )
    assert refused(*words) == f"--campaign = {tmp_path}: must belong to the paper's robot, so without --robot"
    params = ("--params", tmp_path / "cell.yaml")
    assert "must come with --robot" in refused("figures", "-o", tmp_path / "out", *params)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "index.html").touch()
    assert "--force" in refused(*words[:5])

# SPDX-License-Identifier: Apache-2.0
"""`campaign`: records runs, resumes after an interruption, refuses invalid options in one line."""

import json
import signal
import subprocess
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import mujoco  # noqa: F401 - its first import starts a process, which a test that is not live must not do
import pytest

from scara_effmass.bags.files import find_bags
from test.bags.messages import run_info_of
from test.cli.conftest import Cli

Start = Callable[..., subprocess.Popen[str]]

SMALL = ("--configuration", "300_0", "--mass", "0.5", "--repetitions", "2")


def test_existing_runs_are_kept_or_replaced_with_force(cli: Cli, tmp_path: Path) -> None:
    folder = tmp_path / "new" / "campaign"
    result = cli("campaign", "-o", folder, *SMALL)
    assert (result.returncode, result.stderr) == (0, "")
    assert "2 impacts in the simulated cell (MuJoCo); nothing was measured" in result.stdout
    assert "kept  " not in result.stdout
    assert [bag.name for bag in find_bags(folder)] == ["300_0_500g_1", "300_0_500g_2"]
    assert run_info_of(folder / "300_0_500g_1").simulated

    summary = json.loads(cli("campaign", "-o", folder, *SMALL, "--json").stdout)
    assert summary["simulated"] is True
    assert (summary["made"], summary["kept"]) == (0, 2)
    assert [run["obstacle_mass_kg"] for run in summary["runs"]] == [0.5, 0.5]
    assert "kept            2 existing recordings" in cli("campaign", "-o", folder, *SMALL).stdout

    refused = cli("campaign", "-o", folder, *SMALL, "--seed", "1")
    assert refused.returncode == 2
    assert refused.stderr.count("\n") == 1
    assert "not of this run" in refused.stderr
    replaced = json.loads(cli("campaign", "-o", folder, *SMALL, "--seed", "1", "--force", "--json").stdout)
    assert (replaced["made"], replaced["seed"]) == (2, 1)


def test_options_of_the_tip_are_applied(cli: Cli, tmp_path: Path) -> None:
    tip = ("--tip-stiffness", "5e5", "--damping", "20", "--friction", "0.2")
    single = (*SMALL[:-1], "1")
    summary = json.loads(cli("campaign", "-o", tmp_path / "soft", *single, *tip, "--json").stdout)
    assert (summary["stiffness"], summary["exponent"], summary["damping"], summary["friction"]) == (5e5, 1.0, 20.0, 0.2)
    info = run_info_of(tmp_path / "soft" / "300_0_500g_1")
    assert info.contact_stiffness == 5e5
    assert {"damping = 20.0", "friction = 0.2"} <= set(info.note.splitlines())
    result = cli("campaign", "-o", tmp_path / "hertz", *single, "--hertz")
    assert "Hertz contact 1.075e+08 N/m^1.5" in result.stdout
    info = run_info_of(tmp_path / "hertz" / "300_0_500g_1")
    assert info.contact_exponent == 1.5
    assert info.contact_stiffness == pytest.approx(3400.0 * 1000.0**1.5)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--configuration", "nowhere"), "300_-200"),
        (("--mass", "-1"), "must be a number from 0.001 to 1000"),
        (("--mass", "nan"), "--mass"),
        (("--mass", "heavy"), "--mass"),
        (("--mass", "0.001"), "stiffness"),
        (("--mass", "1", "--mass", "1.0001"), "gram"),
        (("--repetitions", "0"), "must be a whole number from 1"),
        (("--seed", "1.5"), "must be a whole number from 0"),
        (("--friction", "2"), "friction"),
        (("--tip-stiffness", "1e12"), "stiffness"),
        (("--damping", "inf"), "damping = inf"),
    ],
)
def test_invalid_options_are_refused_before_writing(
    refused: Callable[..., str], options: tuple[str, ...], message: str
) -> None:
    assert message in refused("campaign", "-o", "out", *options)


def test_folder_that_cannot_be_created_is_refused(cli: Cli, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    result = cli("campaign", "-o", tmp_path / "file", *SMALL)
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1


@pytest.mark.live
def test_interrupted_campaign_leaves_complete_bags_and_resumes(cli: Cli, tmp_path: Path, start: Start) -> None:
    folder = tmp_path / "out"
    process = start("campaign", "-o", folder, *SMALL[:-1], "50")
    while process.poll() is None and not (folder / "300_0_500g_2").exists():
        with suppress(subprocess.TimeoutExpired):
            process.wait(0.005)
    process.send_signal(signal.SIGINT)
    assert process.wait() == 130
    bags = sorted(folder.iterdir())
    assert 2 <= len(bags) < 50
    assert all(run_info_of(bag).simulated for bag in bags)
    result = cli("campaign", "-o", folder, *SMALL[:-1], str(len(bags)), "--json")
    assert json.loads(result.stdout)["kept"] == len(bags)

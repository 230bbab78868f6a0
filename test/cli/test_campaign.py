"""`campaign`: bags that say what they are, gone on with after an interruption; bad options in one line."""

from __future__ import annotations

import json
import signal
import subprocess
from contextlib import suppress
from typing import TYPE_CHECKING

import pytest

from scara_effmass.bags.files import find_bags, open_bag
from scara_effmass.bags.run_info import run_infos

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from scara_effmass.values import RunInfo

    Cli = Callable[..., subprocess.CompletedProcess[str]]
    Start = Callable[..., subprocess.Popen[str]]

SMALL = ("--configuration", "300_0", "--mass", "0.5", "--repetitions", "2")


def stated(path: Path) -> RunInfo:
    with open_bag(path) as bag:
        ((_, info),) = run_infos(bag)
    return info


def test_it_records_then_keeps_then_replaces(cli: Cli, tmp_path: Path) -> None:
    folder = tmp_path / "new" / "campaign"
    first = cli("campaign", "-o", folder, *SMALL)
    assert (first.returncode, first.stderr) == (0, "")
    assert "2 impacts in the simulated cell (MuJoCo); nothing was measured" in first.stdout
    assert "kept" not in first.stdout
    assert [bag.name for bag in find_bags(folder)] == ["300_0_500g_1", "300_0_500g_2"]
    assert stated(folder / "300_0_500g_1").simulated

    again = cli("campaign", "-o", folder, *SMALL, "--json")
    result = json.loads(again.stdout)
    assert result["simulated"] is True
    assert (result["made"], result["kept"]) == (0, 2)
    assert [run["obstacle_mass_kg"] for run in result["runs"]] == [0.5, 0.5]
    assert "kept            2 existing recordings" in cli("campaign", "-o", folder, *SMALL).stdout

    other = cli("campaign", "-o", folder, *SMALL, "--seed", "1")
    assert other.returncode == 2
    assert other.stderr.count("\n") == 1
    assert "not of this run" in other.stderr
    replaced = cli("campaign", "-o", folder, *SMALL, "--seed", "1", "--force", "--json")
    assert (json.loads(replaced.stdout)["made"], json.loads(replaced.stdout)["seed"]) == (2, 1)


def test_the_tip_is_as_asked_for(cli: Cli, tmp_path: Path) -> None:
    tip = ("--stiffness", "500", "--damping", "20", "--friction", "0.2")
    one = (*SMALL[:-1], "1")
    result = json.loads(cli("campaign", "-o", tmp_path / "soft", *one, *tip, "--json").stdout)
    assert (result["stiffness"], result["exponent"], result["damping"], result["friction"]) == (5e5, 1.0, 20.0, 0.2)
    info = stated(tmp_path / "soft" / "300_0_500g_1")
    assert info.contact_stiffness == 5e5
    assert {"damping = 20.0", "friction = 0.2"} <= set(info.note.splitlines())
    done = cli("campaign", "-o", tmp_path / "hertz", *one, "--hertz")
    assert "Hertz contact 3400 N/mm^1.5" in done.stdout
    info = stated(tmp_path / "hertz" / "300_0_500g_1")
    assert info.contact_exponent == 1.5
    assert info.contact_stiffness == pytest.approx(3400.0 * 1000.0**1.5)


@pytest.mark.parametrize(
    ("options", "named"),
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
        (("--stiffness", "1e9"), "stiffness"),
        (("--damping", "inf"), "damping = inf"),
    ],
)
def test_bad_options_are_refused_before_anything_is_written(
    cli: Cli, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: tuple[str, ...], named: str
) -> None:
    try:
        done = cli("campaign", "-o", tmp_path / "out", *options)
        code, errors = done.returncode, done.stderr
    except SystemExit as exit_:  # what the parser itself refuses
        code, errors = exit_.code if isinstance(exit_.code, int) else 0, capsys.readouterr().err
    assert code == 2
    assert errors.count("\n") == 1
    assert named in errors
    assert not (tmp_path / "out").exists()


def test_a_folder_that_cannot_be_made_is_an_error(cli: Cli, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    done = cli("campaign", "-o", tmp_path / "file", *SMALL)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1


def test_an_interruption_leaves_whole_bags_and_the_rest_is_made_later(cli: Cli, tmp_path: Path, start: Start) -> None:
    folder = tmp_path / "out"
    process = start("campaign", "-o", folder, *SMALL[:-1], "50")
    while process.poll() is None and not (folder / "300_0_500g_2").exists():
        with suppress(subprocess.TimeoutExpired):
            process.wait(0.005)
    process.send_signal(signal.SIGINT)
    assert process.wait() == 130
    bags = sorted(folder.iterdir())
    assert 2 <= len(bags) < 50
    assert all(stated(bag).simulated for bag in bags)
    done = cli("campaign", "-o", folder, *SMALL[:-1], str(len(bags)), "--json")
    assert json.loads(done.stdout)["kept"] == len(bags)

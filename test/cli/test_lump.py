# SPDX-License-Identifier: Apache-2.0
"""`lump`: table, comparison and picture of the lumped model; the comparison agrees with the closed forms."""

import json
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from scara_effmass.analysis.lumped_model import REGIONS, compare_models
from scara_effmass.analysis.robot_figures import draw_masses
from scara_effmass.cli import main
from scara_effmass.iso15066 import BODY_REGIONS
from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.settings import MonitorSettings
from scara_effmass.share import share
from test.cli.conftest import Cli, Refused

ROBOTS = Path(__file__).parents[1] / "robots"
PANDA, UR5 = (share("config", "robots", f"{name}.urdf") for name in ("panda", "ur5_robot"))


def test_shipped_robot_has_the_masses_of_the_paper(cli: Cli, tmp_path: Path) -> None:
    done = cli("lump", "-o", "out")
    assert done.returncode == 0
    assert "masses by axis, base to tip: 1.94, 2.38, 0.42, 0.375, 0.175 kg" in done.stdout
    assert "5 masses remain for 4 joints" in done.stdout
    result = json.loads((tmp_path / "out/lump.json").read_text(encoding="utf-8"))
    assert [round(link["kappa2"], 3) for link in result["links"]] == [0.292, 0.21, 1.0, 0.5]
    assert [entry["quantity"] for entry in result["lumped_over_full_minus_1"][:3]] == [
        "mass",
        *(f"reduced mass, {region}" for region in REGIONS),
    ]
    picture = imread(tmp_path / "out/lumped_masses.png")
    assert picture.std() > 0.01
    assert (tmp_path / "out/lumped_masses.svg").is_file()


def test_first_masses_move_with_a_sliding_first_joint(cli: Cli, tmp_path: Path) -> None:
    text = (ROBOTS / "scara_icube_tutorial.urdf").read_text(encoding="utf-8")
    assert "; the first does not move" in cli("lump", ROBOTS / "scara_icube_tutorial.urdf").stdout
    on_rail = tmp_path / "on_rail.urdf"
    on_rail.write_text(text.replace('type="revolute"', 'type="prismatic"', 1), encoding="utf-8")
    done = cli("lump", on_rail)
    assert "masses by axis" in done.stdout
    assert "does not move" not in done.stdout


def test_link_without_two_masses_is_named_and_answered(cli: Cli) -> None:
    done = cli("lump", PANDA)
    assert done.returncode == 1
    assert done.stdout.count("refused") == 3
    assert "no lumped model: link behind panda_joint1: its centre of mass lies 3.9 mm off the plane" in done.stdout
    done = cli("lump", PANDA, "--policy", "project_com", "--free-parameters", "fit_inertia", "--poses", "50", "--json")
    assert done.returncode == 0
    result = json.loads(done.stdout)
    assert result["lumping"] == {"policy": "project_com", "free_parameters": "fit_inertia"}
    answers = [link["answer"] for link in result["links"]]
    assert answers[0] == "its centre of mass moved by 3.9 mm"
    assert sum(result["masses_by_axis_kg"]) == pytest.approx(sum(link["mass"] for link in result["links"]))
    (mass, *_) = result["lumped_over_full_minus_1"]
    assert mass["p5"] < mass["p50"] < mass["p95"] < 0.0
    assert (mass["lighter"], abs(mass["worst"]) > abs(mass["p5"])) == (1.0, True)


def test_point_without_lumped_mass_and_robot_without_full_model_have_no_comparison(cli: Cli) -> None:
    assert "ee_link: at 100.0% of the poses no lumped mass" in cli("lump", UR5, "--poses", "20").stdout
    done = cli("lump", ROBOTS / "scara_icube_tutorial.urdf")
    assert done.returncode == 0
    assert "no comparison: there is no full model: every inertia tensor is the identity" in done.stdout
    done = cli("lump", ROBOTS / "tm5-700-nominal.urdf", "--policy", "mass_at_com")
    assert done.returncode == 1
    assert "every centre of mass lies at its link's origin" in done.stdout


def test_invalid_options_and_existing_output_are_refused(cli: Cli, refused: Refused, tmp_path: Path) -> None:
    assert cli("lump", "-o", tmp_path / "out", "--poses", "2").returncode == 0
    assert "already exists; use --force" in refused("lump", "-o", tmp_path / "out")
    assert cli("lump", PANDA, "-o", tmp_path / "out", "--force").returncode == 1
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["lump.json"]
    whole = refused("lump", "--poses", "1.5")
    assert "argument --poses: 1.5: must be a whole number from 1 to 10000000 (see --help)" in whole
    assert "argument --poses: 0: must be a whole number from 1" in refused("lump", "--poses", "0")


def test_comparison_is_that_of_the_masses() -> None:
    dynamics = RobotDynamics(load_robot(None, MonitorSettings(contact_points=("tool",))))
    comparisons, missing = compare_models(dynamics, 0.01, 400, 5)
    rng, model = np.random.default_rng(5), dynamics.robot.model
    poses = rng.uniform(
        np.maximum(model.lowerPositionLimit, -np.pi), np.minimum(model.upperPositionLimit, np.pi), (400, 4)
    )
    masses = []
    for q, n in zip(poses, rng.normal(size=(400, 3)), strict=True):
        qd = np.linalg.pinv(dynamics.at(q).contacts[0].jacobian) @ n
        (at,) = dynamics.at(q, qd).contacts
        masses.append((at.lumped, at.full))
    lumped, full = np.array(masses).T
    assert missing == [0.0]
    for comparison, region in zip(comparisons, ("", *REGIONS), strict=True):
        alpha = 1.0 / BODY_REGIONS[region].mass_kg if region else 0.0
        error = (1.0 / full + alpha) / (1.0 / lumped + alpha) - 1.0
        expected = *np.percentile(error, (5, 50, 95)), error[np.abs(error).argmax()], np.mean(error < 0.0)
        assert comparison[2:7] == pytest.approx(expected, rel=1e-6, abs=1e-9)
        assert comparison.too_light == np.mean(error < -0.01)
        assert f"median {abs(comparison.p50):.1%} heavier" in comparison.text


def test_picture_labels_every_mass() -> None:
    dynamics = RobotDynamics(load_robot())
    assert dynamics.lumped is not None
    (axes,) = draw_masses(dynamics.robot, dynamics.lumped).axes
    labels = " ".join(text.get_text() for text in axes.texts)
    assert all(f"m_l{number} = {mass.mass:.3g} kg" in labels for number, mass in enumerate(dynamics.lumped.masses, 1))
    assert axes.get_xlabel() == "x [m]"


@pytest.mark.parametrize(
    ("words", "level", "text"),
    [
        ((), "ok", "tool: median 1.9% heavier (P5 +0.1%, P95 +4.0%, worst +7.2%), more than the margin lighter in 0%"),
        (("--robot", str(UR5)), "note", "ee_link: no lumped mass at 100% of the poses"),
    ],
)
def test_doctor_compares_the_models(
    words: tuple[str, ...], level: str, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["doctor", "--json", *words]) == 0
    findings = json.loads(capsys.readouterr().out)["findings"]
    (finding,) = (finding for finding in findings if finding["subject"] == "lumped over full")
    assert finding["level"] == level
    assert finding["text"].startswith(text)

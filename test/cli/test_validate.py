# SPDX-License-Identifier: Apache-2.0
"""`validate`: a report, a summary, and an exit code that says whether the criterion is met."""

import json
import shutil
from pathlib import Path

import pytest

from scara_effmass.bags.files import open_bag
from scara_effmass.bags.writer import BagWriter
from scara_effmass.studies.campaign import Campaign, run_campaign
from test.cli.conftest import Cli, Refused

pytestmark = pytest.mark.usefixtures("unrendered")  # but for the test in a process of its own

FIGURES = ("force_over_root_mu", "force_over_obstacle_mass", "bland_altman", "exponent")
FILES = {"report.html", "report.json", *(f"{name}.{suffix}" for name in FIGURES for suffix in ("png", "svg"))}


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six recordings: three configurations with two masses each."""
    folder = tmp_path_factory.mktemp("campaign")
    assert len(list(run_campaign(folder, Campaign(obstacle_masses=(0.5, 7.35), repetitions=1)))) == 6
    return folder


def test_json_has_every_model_the_lumped_first(cli_process: Cli, campaign: Path, tmp_path: Path) -> None:
    done = cli_process("validate", campaign, "-o", "new/report", "--json")
    assert (done.returncode, done.stderr) == (0, "")  # and no progress bar in a pipe
    report = json.loads(done.stdout)
    assert {path.name for path in (tmp_path / "new" / "report").iterdir()} == FILES
    assert [model["model"] for model in report["models"]] == ["lumped", "full", "iso"]
    for model in report["models"]:
        assert model["count"] == 6
        for name in ("correlation", "fitted_stiffness", "exponent", "mass_scale", "gain", "bias", "rmse"):
            assert isinstance(model[name], float)
        assert isinstance(model["non_conservative"], int)
    assert [model["accepted"] for model in report["models"]] == [True, True, False]
    scales = report["mass_scale_by_motion"]
    for model in report["models"]:  # what impacts and motion say of the mass agrees
        scale = scales[model["model"]]
        low, high = scale["scale"] - scale["half"], scale["scale"] + scale["half"]
        if model["model"] != "iso":
            assert low < model["mass_scale"] < high
    assert scales["full"]["scale"] == pytest.approx(1.0, abs=0.05)
    assert scales["iso"]["scale"] < 0.8
    assert report["no_mass_scale_by_motion"] == ""
    assert report.pop("output") == "new/report"
    assert report == json.loads((tmp_path / "new" / "report" / "report.json").read_text(encoding="utf-8"))


def test_the_summary_is_short(cli: Cli, refused: Refused, campaign: Path) -> None:
    done = cli("validate", campaign, "-o", "report")
    assert (done.returncode, done.stderr) == (0, "")
    lines = done.stdout.splitlines()
    assert lines[0].split() == ["result", "accepted"]
    assert "0 of 6 impacts above the limit; largest " in lines[1]
    assert "converted from a measured peak of " in lines[1]
    assert "6 in the series, 6 of them simulated; " in lines[2]
    assert " rebounds of earlier impacts, which count with them" in lines[2]
    models = [subject for model in ("lumped", "full", "iso") for subject in (model, "mass", "mass")]
    subjects = [*models, "clocks", "comparison", "excluded", "robot", "written"]
    assert [line.split()[0] for line in lines[3:]] == subjects
    assert "would have found a mass error of " in lines[4]
    assert "--force" in refused("validate", campaign, "-o", "report")
    assert cli("validate", campaign, "-o", "report", "--force").returncode == 0


def test_a_failed_criterion_exits_with_1_and_a_report(cli: Cli, campaign: Path, tmp_path: Path) -> None:
    done = cli("validate", campaign, "-o", "report", "--model", "iso")
    assert (done.returncode, done.stderr) == (1, "")
    assert done.stdout.startswith("result          not accepted: correlation 0.")
    assert {path.name for path in (tmp_path / "report").iterdir()} == FILES


def test_no_impacts_gives_no_statistics(cli: Cli, campaign: Path, tmp_path: Path) -> None:
    done = cli("validate", campaign, "-o", "report", "--obstacle-mass", "0")
    assert done.returncode == 1
    assert done.stdout.startswith(
        "result          not decidable: no impacts, at least 6 are required; 6 left out: obstacle_mass is not given\n"
    )
    assert "lumped          no impact\n" in done.stdout
    page = (tmp_path / "report" / "report.html").read_text(encoding="utf-8")
    assert "+0.00" not in page


def test_obstacle_mass_and_stiffness_options_apply(cli: Cli, campaign: Path) -> None:
    done = cli("validate", campaign, "-o", "report", "--obstacle-mass", "2", "--stiffness-n-m", "1e6", "--json")
    report = json.loads(done.stdout)
    assert done.returncode == 1
    assert {impact["obstacle_mass"] for impact in report["impacts"]} == {2.0}
    assert {model["stiffness"] for model in report["models"]} == {1e6}


def test_a_force_above_the_limit_of_a_region_exits_with_1(cli: Cli, campaign: Path) -> None:
    """A device of 5 N/mm in place of the tip of 2000 N/mm: the same force means much more on a stiffer leg."""
    options = ("--region", "lower_leg", "--json", "--force")
    below = cli("validate", campaign, "-o", "report", *options)
    above = cli("validate", campaign, "-o", "report", *options, "--stiffness-n-m", "5e3")
    report = json.loads(below.stdout)
    assert (below.returncode, report["accepted"], report["exceedances"]) == (0, True, 0)
    assert above.returncode == 1
    report = json.loads(above.stdout)
    assert report["exceedances"] == sum(impact["region_force"] > 260.0 for impact in report["impacts"]) > 0
    assert {impact["body_region"] for impact in report["impacts"]} == {"lower_leg"}


def test_plate_normal_and_fixed_obstacle_apply(cli: Cli, campaign: Path, tmp_path: Path) -> None:
    (tmp_path / "cell.yaml").write_text("validator: {ros__parameters: {obstacle_mass: 3.0}}\n")
    words = ("--plate-normal", "0 0 1", "--fixed", "--params", "cell.yaml")
    done = cli("validate", campaign, "-o", "report", *words)
    settings = json.loads((tmp_path / "report" / "report.json").read_text())["settings"]["validator"]
    assert done.returncode == 1
    assert (settings["plate_normal"], settings["obstacle_fixed"]) == ("0 0 1", True)
    reason = "has no effect without an obstacle that can move (obstacle_fixed = false)"
    assert f"no effect       obstacle_mass = 3.0 {reason}\n" in done.stdout


def test_payload_rotors_and_points_reach_the_monitor_and_the_limits_the_validator(cli: Cli, campaign: Path) -> None:
    points = ("--contact-point", "flange=link4: 0 0 0")
    load = ("--payload", "2", "--payload-com", "0", "0", "0.1", "--payload-inertia", *("0.1",) * 3, *("0",) * 3)
    options = (*points, *load, "--armature", "joint2=0.1", "--contact-area-m2", "3e-4")
    done = cli("validate", campaign, "-o", "report", *options, "--json")
    report = json.loads(done.stdout)
    monitor, validator = report["settings"]["monitor"], report["settings"]["validator"]
    assert (monitor["payload_mass"], monitor["payload_com"]) == (2.0, [0.0, 0.0, 0.1])
    assert monitor["payload_inertia"] == [0.1, 0.1, 0.1, 0.0, 0.0, 0.0]
    assert monitor["armature"] == ["joint2=0.1"]
    assert {impact["contact_point"] for impact in report["impacts"]} == {"flange"}
    assert (monitor["contact_area_m2"], validator["contact_area_m2"]) == (1e-4, 3e-4)


def test_every_section_of_the_file_counts(cli: Cli, campaign: Path, tmp_path: Path) -> None:
    (tmp_path / "cell.yaml").write_text(
        "monitor: {ros__parameters: {timeout: 0.3}}\n"
        "validator: {ros__parameters: {criterion: {least_count: 7}}}\n"
        "/cell/daq: {ros__parameters: {source: sim, detection.threshold: 20.0}}\n"
    )
    done = cli("validate", campaign, "-o", "report", "--params", "cell.yaml", "--json")
    report = json.loads(done.stdout)
    assert done.returncode == 1
    assert report["reason"] == "6 impacts, at least 7 are required"
    assert report["settings"]["monitor"]["timeout"] == 0.3
    assert report["settings"]["detection"]["threshold"] == 20.0
    assert all(impact["peak_force"] >= 20.0 for impact in report["refused"])


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("camera: {ros__parameters: {}}\n", "holds camera"),
        ("validator: {ros__parameters: {stiffness_n_m: -1.0}}\n", "stiffness_n_m = -1.0"),
        ("daq: {ros__parameters: {detection: {threshold: 0}}}\n", "detection.threshold = 0"),
        ("[", "not YAML"),
    ],
)
def test_invalid_parameter_file_is_refused(
    refused: Refused, campaign: Path, tmp_path: Path, text: str, wrong: str
) -> None:
    (tmp_path / "bad.yaml").write_text(text)
    line = refused("validate", campaign, "-o", "report", "--params", "bad.yaml")
    assert line.startswith("bad.yaml: ")
    assert wrong in line


@pytest.mark.parametrize("missing", ["/joint_states", "/force"])
def test_bag_without_motion_or_force_is_named(refused: Refused, campaign: Path, tmp_path: Path, missing: str) -> None:
    half = tmp_path / "half"
    with open_bag(campaign / "300_200_500g_1") as bag, BagWriter(half) as writer:
        for message in bag.messages():
            if message.topic != missing:
                writer.write(*message)
    assert str(half) in refused("validate", campaign, half, "-o", "report")


@pytest.mark.parametrize("is_copied", [False, True])
def test_recording_may_be_given_only_once(refused: Refused, campaign: Path, tmp_path: Path, *, is_copied: bool) -> None:
    recording = campaign / "300_200_500g_1"
    again = tmp_path / "copy" if is_copied else campaign / ".." / campaign.name / "300_200_500g_1"
    if is_copied:
        shutil.copytree(recording, again)
    line = f"{again}: same content as {recording}: must be given only once"
    assert refused("validate", campaign, again, "-o", "report") == line


def test_force_files_are_as_many_as_recordings(refused: Refused, campaign: Path) -> None:
    line = refused("validate", campaign, "-o", "report", "--force-from", "cell.csv")
    assert line == "argument --force-from: 1 files: must be 6, as many as BAGs"
    assert "--force-offset: soon: must be a number" in refused("validate", "a", "-o", "b", "--force-offset", "soon")
    assert "1e300: must be a number from -2147483647" in refused("validate", "a", "-o", "b", "--force-offset", "1e300")


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        (("--force-offset", "1"), "--force-offset = 1.0: must come with --force-from"),
        (("--fixed", "--obstacle-mass", "3"), "argument --fixed: must not come with --obstacle-mass 3"),
    ],
)
def test_options_that_contradict_each_other_are_refused(
    refused: Refused, campaign: Path, options: tuple[str, ...], problem: str
) -> None:
    assert refused("validate", campaign, "-o", "report", *options) == problem


def test_force_beside_a_recording(cli: Cli, campaign: Path, tmp_path: Path) -> None:
    run = campaign / "300_200_500g_1"
    with open_bag(run) as bag, BagWriter(tmp_path / "force.mcap") as writer:
        for message in bag.messages(["/force"]):
            writer.write(*message)
    done = cli("validate", run, "--force-from", "force.mcap", "-o", "report")
    assert "force           force.mcap: its stamps " in done.stdout
    report = json.loads((tmp_path / "report" / "report.json").read_text(encoding="utf-8"))
    assert abs(report["recordings"][0]["force_offset"]) < 1e-3
    assert len(report["impacts"]) == 1
    path = tmp_path / "force.mcap"
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 95 // 100])
    done = cli("validate", run, "--force-from", path, "--force-offset", "0", "-o", "cut")
    assert f"not read        {path}: cut off" in done.stdout
    report = json.loads((tmp_path / "cut" / "report.json").read_text(encoding="utf-8"))
    assert "cut off" in report["recordings"][0]["losses"][0]


@pytest.mark.parametrize(("option", "value"), [("--obstacle-mass", "-1"), ("--stiffness-n-m", "nan")])
def test_invalid_option_is_refused(refused: Refused, campaign: Path, option: str, value: str) -> None:
    line = refused("validate", campaign, "-o", "report", f"{option}={value}")
    assert f"options: {option.strip('-').replace('-', '_')} = {float(value)}" in line


@pytest.mark.parametrize(
    ("option", "problem"),
    [
        ("--plate-normal=0 0 0", "options: plate_normal = '0 0 0': must be empty, or three numbers"),
        ("--region=face", "body_regions = 'face': the standard permits no contact"),
    ],
)
def test_invalid_normal_or_region_is_refused(
    refused: Refused, campaign: Path, tmp_path: Path, option: str, problem: str
) -> None:
    assert problem in refused("validate", campaign, "-o", "report", option)
    assert not (tmp_path / "report").exists()

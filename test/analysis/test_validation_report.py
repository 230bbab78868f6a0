# SPDX-License-Identifier: Apache-2.0
"""Validation report: complete, self-contained, reproducible, and valid with few or no impacts."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

import pytest
from matplotlib.image import imread

from scara_effmass.analysis.output import check_output_files
from scara_effmass.analysis.validation import Validation, ValidationSettings, validate
from scara_effmass.analysis.validation_report import FILES, record, summary_lines, write_report
from scara_effmass.errors import OutputError
from scara_effmass.impacts.agreement import RegionForce
from scara_effmass.impacts.impact_matcher import PRESS
from scara_effmass.impacts.validator import ComparedForces
from scara_effmass.reference import RobotDynamics
from scara_effmass.settings import ValidatorSettings
from scara_effmass.values import RefusedImpact
from test.analysis.conftest import Page


class Altered(Protocol):
    def __call__(self, path: Path, **changes: object) -> Path: ...


SETTINGS = ValidationSettings()


def written(
    validation: Validation, dynamics: RobotDynamics, folder: Path, settings: ValidationSettings = SETTINGS
) -> dict[str, bytes]:
    write_report(validation, settings, dynamics.robot, folder, overwrite=False)
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def texts_of(files: dict[str, bytes]) -> list[str]:
    return Page(files["report.html"].decode()).texts


@pytest.fixture(scope="session")
def files(
    validation: Validation, dynamics: RobotDynamics, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, bytes]:
    """Report of the campaign."""
    return written(validation, dynamics, tmp_path_factory.mktemp("report") / "new")


def numbers(value: Any) -> list[float]:  # noqa: ANN401 - whatever JSON holds
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list):
        return [number for each in value for number in numbers(each)]
    return [value] if isinstance(value, float) else []


def test_report_is_reproducible(
    files: dict[str, bytes], validation: Validation, dynamics: RobotDynamics, tmp_path: Path
) -> None:
    assert set(files) == set(FILES)
    assert files == written(validation, dynamics, tmp_path)
    for name in FILES:
        if name.endswith(".png"):
            height, width, _ = imread(tmp_path / name).shape
            assert width > 1000
            assert height > 500


def test_page_is_well_formed_and_self_contained(files: dict[str, bytes]) -> None:
    text = files["report.html"].decode()
    page = Page(text)
    assert page.open == []
    assert text.count("<svg ") == 6  # the force over time of each impact
    assert [address[:22] for address in page.addresses] == ["data:image/png;base64,"] * 4
    assert "url(" not in text
    assert "@import" not in text


def test_a_configuration_may_have_any_name_that_can_be_printed(
    campaign: list[Path], dynamics: RobotDynamics, altered: Altered, tmp_path: Path
) -> None:
    name = "<b> $x_{$ & _"
    named = validate([altered(campaign[0], info={"configuration": name})], dynamics, SETTINGS)
    assert name in texts_of(written(named, dynamics, tmp_path / "report"))


def test_page_states_result_limits_and_origin(
    files: dict[str, bytes], validation: Validation, dynamics: RobotDynamics
) -> None:
    texts = texts_of(files)
    assert "Accepted." in texts
    assert "lumped model, simulated impacts; nothing was measured on a robot." in texts
    whole = " ".join(texts)
    for statement in (
        "It is not a certified safety function",
        "F = v √(μ k) is valid for a free, linear, undamped contact.",
        f"(hash {validation.result.criterion_hash})",
        validation.result.comparison.text,
    ):
        assert statement in whole
    assert dynamics.robot.origin in texts
    assert "rebound of an earlier impact" in texts
    for recording in validation.recordings:
        assert texts.count(recording.path.name) == 3  # its force over time, its impact, and itself
    for model in validation.result.models:
        assert any(text.startswith(f"{model.overall.correlation:.5f} (") for text in texts)


def test_page_names_the_joints_without_rotor_inertia(files: dict[str, bytes]) -> None:
    assert "no rotor inertia for joint1, joint2, joint3, joint4" in files["report.html"].decode()


def test_json_report_is_complete_and_finite(
    files: dict[str, bytes], validation: Validation, dynamics: RobotDynamics
) -> None:
    report = json.loads(files["report.json"])
    assert report == record(validation, SETTINGS, dynamics.robot)
    assert all(map(math.isfinite, numbers(report)))
    assert next(iter(report)) == "models"
    lumped = report["models"][0]
    assert {"count", "correlation", "fitted_stiffness", "exponent", "bias", "rmse", "accepted"} <= lumped.keys()
    assert lumped["by_obstacle_mass"].keys() == {"0.5", "7.35"}
    assert [each["recording"] for each in report["impacts"]] == [r.path.name for r in validation.recordings]
    assert report["settings"]["validator"]["clock_tolerance"] == SETTINGS.validator.clock_tolerance
    assert set(report["excluded"]) == {"rebound of an earlier impact"}


def test_report_without_impacts(
    campaign: list[Path], dynamics: RobotDynamics, altered: Altered, tmp_path: Path
) -> None:
    quiet = altered(campaign[0], block=lambda block: block._replace(force=1e-3 * block.force))
    files = written(validate([quiet], dynamics, SETTINGS), dynamics, tmp_path / "report")
    assert set(files) == set(FILES)
    texts = texts_of(files)
    assert any(text.startswith("Not decidable: no impacts") for text in texts)
    assert "Every impact that was found is in the series." in texts
    assert json.loads(files["report.json"])["models"][0]["exponent"] is None
    assert b"no impact could be paired with the robot" in b"".join(
        line for line in files["bland_altman.svg"].splitlines() if line.strip().startswith(b"<!--")
    )


def test_regions_have_the_force_of_the_verdict(
    campaign: list[Path], dynamics: RobotDynamics, altered: Altered, tmp_path: Path
) -> None:
    """An obstacle on an oblique guide yields less along the normal of the plate."""
    oblique = altered(campaign[0], info={"guide_direction": (0.6, -0.8, 0.0), "plate_normal": (1.0, 0.0, 0.0)})
    validation = validate([oblique], dynamics, SETTINGS)
    (impact,) = validation.result.impacts
    assert impact.force_share == pytest.approx(0.6)
    texts = texts_of(written(validation, dynamics, tmp_path / "report"))
    row = texts.index(impact.body_region)
    assert texts[row + 3] == f"{impact.region_force:.1f}"


def test_a_report_of_one_impact(campaign: list[Path], dynamics: RobotDynamics, tmp_path: Path) -> None:
    settings = ValidationSettings(validator=ValidatorSettings(stiffness_n_m=2e6))
    files = written(validate(campaign[:1], dynamics, settings), dynamics, tmp_path / "report", settings)
    texts = texts_of(files)
    assert "undefined: fewer than two impacts" in texts
    assert "Not decidable: 1 impact, at least 6 are required." in texts
    assert "All models use the specified stiffness of 2000 N/mm." in texts
    assert json.loads(files["report.json"])["models"][0]["stiffness"] == 2e6


def test_page_of_a_live_series_names_its_problems(
    validation: Validation, dynamics: RobotDynamics, tmp_path: Path
) -> None:
    result = validation.result._replace(simulated=0, clock="clocks differ", force_sign="negative", late_states=3)
    live = validation._replace(result=result._replace(other_contact_points=("elbow",)), recordings=())
    texts = texts_of(written(live, dynamics, tmp_path / "report"))
    assert "The recordings do not state the calibration uncertainty of the force sensor." in texts
    expected = {"measured impacts", "clocks differ", "negative", "other contact points: elbow"}
    assert expected | {"3 arrived out of order and were dropped", "none: the series was live"} <= set(texts)


def test_nothing_is_overwritten_and_nothing_half_written(
    validation: Validation, dynamics: RobotDynamics, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "report"
    folder.mkdir()
    (folder / "exponent.svg").write_text("<svg>mine")
    refused = r"exponent\.svg: already exists; use --force to replace it"
    with pytest.raises(OutputError, match=refused):
        check_output_files(folder, FILES, overwrite=False)
    with pytest.raises(OutputError, match=refused):
        write_report(validation, SETTINGS, dynamics.robot, folder, overwrite=False)
    check_output_files(folder, FILES, overwrite=True)

    def fail(*_: object, **_options: object) -> str:
        raise OutputError("no room")

    monkeypatch.setattr("scara_effmass.analysis.validation_report.render", fail)
    with pytest.raises(OutputError, match="no room"):
        write_report(validation, SETTINGS, dynamics.robot, folder, overwrite=True)
    assert [path.name for path in folder.iterdir()] == ["exponent.svg"]
    assert (folder / "exponent.svg").read_text() == "<svg>mine"


def test_the_folder_must_not_be_a_file(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="file"):
        check_output_files(tmp_path / "file", FILES, overwrite=True)


def test_held_forces_are_larger_than_measured_with_ac_coupling(
    validation: Validation, dynamics: RobotDynamics, tmp_path: Path
) -> None:
    held = ComparedForces(1, 0, RegionForce("chest", 100.0, 140.0, ""))
    changed = validation._replace(result=validation.result._replace(held=held, ac_coupled=True))
    assert "held forces are larger than measured" in dict(summary_lines(changed))["coupling"]
    texts = texts_of(written(changed, dynamics, tmp_path / "report"))
    assert any("held forces are larger than measured" in text for text in texts)


def test_impacts_above_a_limit_only_by_what_stayed_are_told_from_those_above_it_by_their_peaks(
    validation: Validation, dynamics: RobotDynamics, tmp_path: Path
) -> None:
    first, *others = validation.result.impacts
    held = replace(first, exceeds_limit=True, held_force=150.0, held_limit=140.0, held_region="hand_fingers")
    result = validation.result._replace(impacts=(held, *others), exceedances=1)
    changed = validation._replace(result=result)
    statement = f"1 of {len(result.impacts)} impacts above the limit, 1 only by the force that stayed; largest "
    assert dict(summary_lines(changed))["limit"].startswith(statement)
    texts = texts_of(written(changed, dynamics, tmp_path / "report"))
    assert any("Impacts above a limit only by the force that stayed: 1." in text for text in texts)


@pytest.mark.parametrize("is_paired", [True, False])
def test_the_largest_force_may_be_one_left_out_that_is_below_its_limit(
    validation: Validation, dynamics: RobotDynamics, tmp_path: Path, *, is_paired: bool
) -> None:
    others = ComparedForces(1, 0, RegionForce("lower_leg", 259.0, 260.0, ""))
    changes: dict[str, Any] = {"left_out": others} | ({} if is_paired else {"impacts": ()})
    changed = Validation(validation.result._replace(**changes), validation.recordings if is_paired else ())
    origin = "left out of the series" if is_paired else "as measured, because no impact could be paired with the robot"
    assert f"largest 259 N of 260 N (lower_leg), {origin}" in dict(summary_lines(changed))["limit"]
    texts = texts_of(written(changed, dynamics, tmp_path / "report"))
    assert any("largest 259 N of 260 N" in text for text in texts)
    assert any("Forces are as measured" in text for text in texts) == (not is_paired)


def test_a_refused_contact_is_listed_with_its_load_and_what_stayed(validation: Validation) -> None:
    presses = [
        RefusedImpact(1, 60.0, excluded=True, reason=PRESS, detail="", held_force=90.0, load_force=20.0),
        RefusedImpact(2, 70.0, excluded=True, reason=PRESS, detail="", held_force=10.0, load_force=10.0),
    ]
    changed = validation._replace(result=validation.result._replace(refused=tuple(presses), excluded={PRESS: 2}))
    assert dict(summary_lines(changed))["excluded"] == f"2: {PRESS} (up to 90.0 N)"


@pytest.mark.parametrize(
    ("changes", "word", "statement"),
    [
        ({"unmeasured": 1}, "Force not known", "1 clipped, incomplete, stuck or without signal: force not known"),
        (
            {"left_out": ComparedForces(1, 1, RegionForce("lower_leg", 895.0, 260.0, "")), "exceedances": 1},
            "Force above a limit",
            "1 of 7 contacts above the limit; largest 895 N of 260 N (lower_leg), left out of the series",
        ),
    ],
)
def test_no_series_is_accepted_whose_other_contacts_are_above_a_limit_or_not_known(
    validation: Validation, dynamics: RobotDynamics, tmp_path: Path, changes: dict[str, Any], word: str, statement: str
) -> None:
    changed = validation._replace(result=validation.result._replace(**changes))
    assert (changed.result.accepted, changed.result.within_limits) == (True, False)
    assert statement in dict(summary_lines(changed))["limit"]
    texts = texts_of(written(changed, dynamics, tmp_path / "report"))
    assert word in texts
    assert "Accepted." not in texts

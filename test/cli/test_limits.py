# SPDX-License-Identifier: Apache-2.0
"""`limits`: the printed table and speeds are those of `iso15066`."""

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from scara_effmass.cli import main
from scara_effmass.iso15066 import (
    BODY_POINTS,
    BODY_REGIONS,
    CLAUSE_2025,
    EDITION,
    TABLE_HASH,
    limits_for,
    speed_limit_of_mass,
)
from scara_effmass.settings import ContactType, MonitorSettings
from test.cli.conftest import Cli, Refused


def result(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, Any]:
    assert main(["limits", "--json", *words]) == 0
    table: dict[str, Any] = json.loads(capsys.readouterr().out)
    return table


def test_json_contains_the_whole_table(capsys: pytest.CaptureFixture[str]) -> None:
    table = result(capsys)
    assert (table["edition"], table["hash"]) == (EDITION, TABLE_HASH)
    assert [point["clause"] for point in table["body_points"]] == [point.clause for point in BODY_POINTS]
    assert [region["name"] for region in table["body_regions"]] == list(BODY_REGIONS)
    for printed, point in zip(table["body_points"], BODY_POINTS, strict=True):
        assert printed["quasi_static_force_n"] == point.quasi_static_force_n
        assert printed["transient_pressure_n_cm2"] == point.transient_pressure_n_cm2
    assert table["allowable_speeds"] == []


@pytest.mark.parametrize("contact", ContactType)
def test_speeds_match_the_limits(contact: ContactType, capsys: pytest.CaptureFixture[str]) -> None:
    speeds = result(capsys, "--mass", "0.97", "--mass", "2.77", "--contact", contact.value)["allowable_speeds"]
    limits = limits_for(MonitorSettings(contact=contact))
    assert len(speeds) == 2 * len(limits)
    for row in speeds:
        (limit,) = (limit for limit in limits if limit.region == row["region"])
        found = speed_limit_of_mass([limit], row["effective_mass_kg"])
        assert row["allowable_speed_m_s"] == found.allowable_speed
        assert row["criterion"] == found.criterion
        assert row["clause"] == limit.clause


def test_hand_has_the_reference_speeds(capsys: pytest.CaptureFixture[str]) -> None:
    # ISO/TS 15066, by hand: 280 N / sqrt(mu * 75 N/mm), mu of 0.6 kg with 0.97 and 2.77 kg.
    speeds = result(capsys, "--mass", "0.97", "--mass", "2.77", "--region", "hand_fingers")["allowable_speeds"]
    assert [round(1e3 * row["allowable_speed_m_s"]) for row in speeds] == [1679, 1456]


def test_text_contains_every_row_the_units_and_the_lowest_speed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["limits", "--mass", "2.77"]) == 0
    text = capsys.readouterr().out
    for point in BODY_POINTS:
        assert f"{point.clause} " in text
        assert point.name in text
    assert "stiffness [N/mm]" in text
    assert "649 (lower_leg, force)" in text
    assert "relative speed at nominal values; a monitor allows less" in text
    assert CLAUSE_2025 in text
    assert TABLE_HASH in text
    assert "…" not in text


def test_max_force_parameter_overrides_the_standard(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "cell.yaml"
    file.write_text("/**:\n  ros__parameters:\n    max_force: 100.0\n", encoding="utf-8")
    words = ("--mass", "2.77", "--region", "hand_fingers")
    (standard,) = result(capsys, *words)["allowable_speeds"]
    (custom,) = result(capsys, *words, "--params", str(file))["allowable_speeds"]
    assert custom["allowable_speed_m_s"] == pytest.approx(standard["allowable_speed_m_s"] * 100.0 / 280.0)
    assert "own limit" in custom["clause"]


@pytest.mark.parametrize("contact", ContactType)
@pytest.mark.parametrize("region", ["skull_forehead", "face"])
def test_head_and_face_never_get_a_speed(
    region: str, contact: ContactType, cli: Cli, refused: Refused, swing_bag: Path, tmp_path: Path
) -> None:
    chosen = ("--region", region, "--contact", contact.value)
    for command in (("limits", "--mass", "2.77"), ("assess", str(swing_bag), "-o", str(tmp_path / "a.csv"))):
        assert f"body_regions = '{region}'" in refused(*command, *chosen)
        assert "no contact with head and face" in refused(*command, "--region", "chest", *chosen)
    rows = json.loads(cli("limits", "--json", "--mass", "2.77", "--contact", contact.value).stdout)["allowable_speeds"]
    assert region not in {row["region"] for row in rows}
    table = cli("limits", "--mass", "2.77", "--contact", contact.value).stdout
    assert region not in table[table.index("Allowable speed [mm/s]") :]
    out = tmp_path / "swing.csv"
    assert cli("assess", swing_bag, "-o", out, "--contact", contact.value).returncode == 0
    assert region not in out.read_text(encoding="utf-8")


@pytest.mark.usefixtures("own_domain")
@pytest.mark.parametrize("region", ["skull_forehead", "face"])
def test_monitor_refuses_head_and_face(region: str, refused: Refused) -> None:
    for contact in ContactType:
        words = ("-p", f"body_regions:=['{region}']", "-p", f"contact:={contact.value}")
        assert "no contact with head and face" in refused("monitor", "--ros-args", *words)


def test_tables_fit_into_80_columns_and_keep_their_words(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("TERM", "dumb")
    assert main(["limits", "--mass", "2.77", "--mass", "0.97"]) == 0
    tables, _, _ = capsys.readouterr().out.partition(f"{EDITION};")
    assert max(map(len, tables.splitlines())) <= 80
    words = set(tables.split())
    assert {word for point in BODY_POINTS for word in f"{point.name} {point.region}".split()} <= words

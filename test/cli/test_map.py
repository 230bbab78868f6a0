# SPDX-License-Identifier: Apache-2.0
"""`map`: figure, table and summary of a robot, and refusals in one line."""

import json
from pathlib import Path

import pytest
from matplotlib.image import imread
from pyarrow import csv, parquet

from scara_effmass import __version__
from scara_effmass.share import share
from test.cli.conftest import Cli, Refused

UR5 = share("config", "robots", "ur5_robot.urdf")


def test_map_of_a_plane_of_a_six_axis_arm(cli: Cli, refused: Refused, tmp_path: Path) -> None:
    out = tmp_path / "new" / "map"
    words = ("map", UR5, "-o", out, "--model", "full", "--plane", "z=0.3", "--direction", "0", "0", "-1")
    done = cli(*words, "--samples", "300", "--json")
    assert (done.returncode, done.stderr) == (0, "")
    result = json.loads(done.stdout)
    assert (result["configurations"], result["plane"]) == (300, "plane z = 0.3 m")
    assert result["mass_models"] == [["full: effective_mass_model full", 300]]
    assert result["direction"] == [0.0, 0.0, -1.0]
    assert result["deciding_contacts"] == {"ee_link": result["cells"]}
    assert "payload not stated: --payload 0 if there is none" in result["assumptions"]["assumed"]["payload"]
    framed = cli(*words, "--samples", "100", "--direction-frame", "ee_link", "--force", "--json")
    assert json.loads(framed.stdout)["frame"] == "ee_link"  # a link and a contact point
    assert "assumed         payload not stated: " in cli(*words, "--samples", "100", "--force").stdout
    done = cli(*words, "--samples", "300", "--force", "--json")
    assert {path.name for path in out.iterdir()} == {"map.png", "map.svg", "map.csv", "map.json"}
    assert imread(out / "map.png").shape[1] > 1000
    lines = (out / "map.csv").read_text(encoding="utf-8").splitlines()
    assert f"# scara_effmass_version: {__version__}" in lines
    options = csv.ReadOptions(skip_rows=sum(line.startswith("#") for line in lines))
    rows = csv.read_csv(out / "map.csv", read_options=options).to_pylist()
    assert len(rows) == result["cells"]
    assert sum(row["configurations"] for row in rows) == 300
    assert min(row["allowable_speed_m_s"] for row in rows) == result["slowest"]["allowable_speed_m_s"]
    written = json.loads((out / "map.json").read_text(encoding="utf-8"))
    assert written["provenance"]["robot"] == str(UR5)
    assert "--force" in refused(*words, "--samples", "300")


@pytest.mark.usefixtures("unrendered")
def test_parquet_carries_the_provenance_and_replaces_the_other_table(cli: Cli, tmp_path: Path) -> None:
    # A filter of the cell's velocities does not concern sampled ones.
    params = tmp_path / "cell.yaml"
    params.write_text("monitor: {ros__parameters: {velocity_source: from_positions, velocity_window: 0.05}}")
    words = ("map", "-o", tmp_path / "map", "--samples", "100", "--table", "parquet", "--params", params)
    done = cli(*words)
    assert "every z, seen along z" in done.stdout
    assert cli(*words[:-4], "--force").returncode == 0
    assert {path.name for path in (tmp_path / "map").glob("map.*")} == {"map.csv", "map.json", "map.png", "map.svg"}
    assert cli(*words, "--force").returncode == 0
    metadata = parquet.read_schema(tmp_path / "map" / "map.parquet").metadata
    assert metadata[b"scara_effmass_version"].decode() == __version__


@pytest.mark.usefixtures("unrendered")
def test_map_of_several_contacts_says_which_decides(cli: Cli, tmp_path: Path) -> None:
    words = ("map", "-o", tmp_path / "map", "--samples", "200", "--contact-point", "tool")
    assert "decided by" not in cli(*words).stdout
    done = cli(*words, "--contact-point", "whole_arm", "--force")
    assert (done.returncode, done.stderr) == (0, "")
    counts = json.loads((tmp_path / "map" / "map.json").read_text(encoding="utf-8"))["deciding_contacts"]
    shares = ", ".join(f"{name} {count / sum(counts.values()):.1%}" for name, count in counts.items() if count)
    assert f"decided by      {shares} of the cells" in done.stdout
    assert "of all contacts min" in done.stdout


def test_sample_whose_halves_share_no_cell_is_said_to_be_too_small(cli: Cli, tmp_path: Path) -> None:
    done = cli("map", UR5, "--contact-point", "upper_arm_link", "-o", tmp_path / "map", "--samples", "2000")
    assert (done.returncode, done.stderr) == (0, "")
    assert "completeness    its halves reached no cell in common: give more --samples" in done.stdout


@pytest.mark.usefixtures("unrendered")
def test_completeness_counts_only_cells_that_both_halves_reached(cli: Cli, tmp_path: Path) -> None:
    words = ("map", UR5, "-o", tmp_path / "map", "--samples", "100", "--table", "parquet")
    result = json.loads(cli(*words, "--json").stdout)
    counts = parquet.read_table(tmp_path / "map" / "map.parquet")["configurations"].to_numpy()
    assert sum(counts > 1) >= result["shared_cells"] > 0
    assert result["rise_by_second_half"]["p95"] > 0.0  # most cells hold one configuration: they show nothing


@pytest.mark.parametrize(
    ("words", "rule"),
    [
        (("--plane", "z=9"), "does not reach the plane z = 9 m"),
        (("--plane", "w=1"), "w=1: must be x=M, y=M or z=M"),
        (("--plane", "z=low"), "low: must be AXIS=M with a number M"),
        (("--direction", "0", "0", "0"), "--direction = 0 0 0: must not be 0"),
        (("--direction", "1", "0", "0", "--direction-frame", "hand"), "test_direction_frame = 'hand': must be one of"),
        (("--model", "lumped"), "no lumped mass"),
        (("--samples", "9"), "9: must be a whole number from 100"),
    ],
)
def test_refusals(refused: Refused, words: tuple[str, ...], rule: str) -> None:
    model = () if "--model" in words else ("--model", "full")
    samples = () if "--samples" in words else ("--samples", "100")
    assert rule in refused("map", UR5, "-o", "out", *model, *samples, *words)


@pytest.mark.usefixtures("unrendered")
def test_maps_of_several_robots_have_folders_and_a_robot_without_one_is_reported(
    cli: Cli, refused: Refused, tmp_path: Path
) -> None:
    (tmp_path / "bad.urdf").write_text("<robot/>")
    robots, options = (UR5, share("config", "omron_i4_550l.yaml")), ("--samples", "100", "--jobs", "1")
    done = cli("map", *robots, "bad.urdf", "-o", "maps", *options, "--model", "full", "--json")
    assert done.returncode == 1
    result = json.loads(done.stdout)
    assert [found["output"] for found in result["maps"]] == ["maps/ur5_robot", "maps/omron_i4_550l"]
    assert [line.split(":")[0] for line in result["not_mapped"]] == ["bad.urdf"]
    assert {path.name for path in (tmp_path / "maps").iterdir()} == {"ur5_robot", "omron_i4_550l"}
    for robot in robots:
        cli("map", robot, "-o", robot.stem, *options, "--model", "full")
        for path in (tmp_path / robot.stem).iterdir():
            assert path.read_bytes() == (tmp_path / "maps" / robot.stem / path.name).read_bytes()
    assert "must have a file name of its own" in refused("map", UR5, UR5, "-o", "twice")

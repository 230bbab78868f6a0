# SPDX-License-Identifier: Apache-2.0
"""Report of random impacts: shares, intervals and goals of a table whose numbers are known."""

import json
from collections.abc import Callable
from itertools import product
from pathlib import Path

import pytest

from scara_effmass.studies.evidence import PAGE, SUMMARY, TABLE, Evidence, draw_evidence, write_evidence

COLUMNS = (
    "index,robot,contact_point,region,plate,drives,bandwidth_hz,damping,draws,setting,allowable_speed_m_s,"
    "ratio,time_to_peak_s,turn_to_peak"
)


@pytest.fixture
def write_table(tmp_path: Path) -> Callable[[float], Path]:
    """Write 200 impacts, 50 for each kind of drives and plate, of `default` and `servo`; two of them above the limit.

    The median of the worst plates is the argument.
    """

    def write(median: float) -> Path:
        lines = [COLUMNS]
        for number, (drives, plate) in enumerate(product(("free", "computed_torque"), ("worst", "random"))):
            for i in range(50):
                index = 50 * number + i
                robot = "UR5" if i % 2 else "i4-550L"
                for setting in ("default", "servo"):
                    above = i < 2 and (setting, drives, plate) == ("default", "free", "worst")
                    ratio = 1.25 + 0.25 * i if above else median if plate == "worst" else 0.5
                    lines.append(
                        f"{index},{robot},tool,chest,{plate},{drives},5.0,0.7,2,{setting},0.5,{ratio},0.01,0.1"
                    )
        (tmp_path / TABLE).write_text("\n".join(lines) + "\n", encoding="utf-8")
        return tmp_path / TABLE

    return write


def test_shares_and_intervals(write_table: Callable[[float], Path]) -> None:
    evidence = Evidence(write_table(0.8))
    assert (evidence.impacts, evidence.robots, evidence.draws) == (200, ["i4-550L", "UR5"], 2.0)
    group = evidence.group("default", "free", "worst")
    assert group is not None
    assert (group.impacts, group.above, group.share, group.worst, group.median) == (50, 2, 0.04, 1.5, 0.8)
    assert group.interval == pytest.approx((0.00488, 0.13714), abs=1e-5)  # Clopper and Pearson, 2 of 50
    clean = evidence.group("servo", "computed_torque")
    assert clean is not None
    assert clean.interval == pytest.approx((0.0, 1.0 - 0.025 ** (1.0 / 100.0)))
    assert evidence.group("paper", "free") is None
    assert len(evidence.groups()) == 8
    assert len(evidence.groups(("",), ("UR5",))) == 4
    assert [row["ratio"] for row in evidence.largest()[:3]] == [1.5, 1.25, 0.8]


@pytest.mark.parametrize(("median", "met"), [(0.8, [False, True, True, True]), (0.7, [False, False, True, False])])
def test_goals(write_table: Callable[[float], Path], median: float, met: list[bool]) -> None:
    assert [goal[2] for goal in Evidence(write_table(median)).goals()] == met


def test_report_states_results_and_what_is_simulated(write_table: Callable[[float], Path]) -> None:
    folder = write_table(0.8).parent
    write_evidence(folder, 1, overwrite=False)
    page = (folder / PAGE).read_text(encoding="utf-8")
    assert "Everything on this page is simulated" in page
    assert "4.00% (0.49% to 13.71%)" in page
    summary = json.loads((folder / SUMMARY).read_text(encoding="utf-8"))
    assert (summary["simulated"], summary["impacts"], summary["seed"]) == (True, 200, 1)
    assert {path.suffix for path in folder.iterdir()} == {".csv", ".html", ".json", ".png", ".svg"}


def test_figure_has_a_panel_per_drives_and_plate(write_table: Callable[[float], Path]) -> None:
    figure = draw_evidence(Evidence(write_table(0.8)))
    assert [len(axes.get_lines()) for axes in figure.axes] == [4, 4, 4, 4, 2, 2]  # two settings, limit and median

# SPDX-License-Identifier: Apache-2.0
"""Random impacts: each begins at the allowed speed, whatever was simulated before, and their table can be resumed."""

from pathlib import Path

import numpy as np
import pytest

from scara_effmass.errors import OutputError
from scara_effmass.safety import Monitor
from scara_effmass.settings import MonitorSettings
from scara_effmass.sim.recordings import EPOCH_NS
from scara_effmass.studies.bounds import ROBOTS, arm_of
from scara_effmass.studies.evidence import COMPUTED_TORQUE, FREE, draw_impact, extend_table, settings_of, simulate
from scara_effmass.values import JointState

SEED = 3


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Five impacts without interruption."""
    path = tmp_path_factory.mktemp("table") / "impacts.csv"
    assert list(extend_table(path, SEED, 5)) == [1, 2, 3, 4, 5]
    return path.read_text(encoding="utf-8")


def test_every_setting_starts_at_exactly_the_allowed_speed() -> None:
    for index in range(4):
        impact = draw_impact(SEED, index)
        arm = arm_of(impact.robot)
        settings = settings_of(arm.dynamics, impact.limit.region, impact.servo)
        assert settings.keys() == impact.qd.keys()
        assert ("paper" in settings) == (impact.robot == "i4-550L")
        for name, qd in impact.qd.items():
            state = JointState(EPOCH_NS, arm.dynamics.robot.joint_names, impact.q, qd)
            decision = Monitor(arm.dynamics, settings[name]).assess(state, EPOCH_NS)
            assert decision is not None
            contact = decision.contacts[impact.point]
            assert 0.0 <= contact.margin < 1e-6 * contact.speed
            assert contact.body_region == impact.limit.region
            assert impact.normal @ contact.direction > 0.0
        uncertainty = MonitorSettings().mass_uncertainty
        assert np.all(np.abs(impact.mass_factors - 1.0) <= uncertainty)
        assert np.ptp(impact.mass_factors) > 0.1 * uncertainty


def test_robots_plates_and_drives_take_turns() -> None:
    impacts = [draw_impact(SEED, index) for index in (0, 1, 2, 3, 4, 8, 12)]
    assert [impact.robot for impact in impacts[:4]] == list(ROBOTS)
    cases = [("worst", True), ("random", True), ("worst", False), ("random", False)]
    assert [(impact.plate, impact.drives == FREE) for impact in (impacts[0], *impacts[4:])] == cases


def test_worst_normal_gives_a_larger_force_than_a_random_one() -> None:
    peaks: dict[str, list[float]] = {"worst": [], "random": []}
    for index in range(8):
        peaks["worst" if index < 4 else "random"] += [float(row["ratio"]) for row in simulate(SEED, index)]
    assert np.median(peaks["worst"]) > np.median(peaks["random"])


@pytest.mark.parametrize("index", [1643, 1657])
def test_arm_whose_joints_would_saturate_keeps_the_limit(index: int) -> None:
    """Where the arm hit again, up to 2.2 times too hard: its saturated joints had run away from their reference."""
    assert draw_impact(1, index).drives == COMPUTED_TORQUE
    (ratio,) = [row["ratio"] for row in simulate(1, index) if row["setting"] == "servo"]
    assert 0.0 < float(ratio) < 1.0


def test_rows_do_not_depend_on_what_was_simulated_before(table: str) -> None:
    rows = [line for line in table.splitlines() if line.startswith("0,")]
    simulate(SEED, 4)
    assert [",".join(map(str, row.values())) for row in simulate(SEED, 0)] == rows


@pytest.mark.parametrize("size", [0, 40, 0.3, 0.6, 0.999])
def test_resumed_table_is_that_of_one_run(table: str, tmp_path: Path, size: float) -> None:
    path = tmp_path / "impacts.csv"
    path.write_text(table[: size if isinstance(size, int) else int(size * len(table))], encoding="utf-8")
    assert list(extend_table(path, SEED, 5))[-1] == 5
    assert path.read_text(encoding="utf-8") == table


@pytest.mark.parametrize("change", ["seed", "header", "number", "line", "binary"])
def test_table_of_another_run_is_refused_and_kept(table: str, tmp_path: Path, change: str) -> None:
    path = tmp_path / "impacts.csv"
    number = f"{table[: table.rindex(' ')]} 1.5\n"
    text = {"seed": table, "header": f"x{table}", "number": number, "line": "other", "binary": "\xff"}[change]
    path.write_text(text, encoding="latin-1")
    with pytest.raises(OutputError, match=r"impacts.csv: must be of this seed and version"):
        list(extend_table(path, SEED + (change == "seed"), 6))
    assert path.read_text(encoding="latin-1") == text


def test_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.touch()
    with pytest.raises(OutputError, match=r"file/impacts.csv: cannot be written"):
        list(extend_table(file / "impacts.csv", SEED, 1))

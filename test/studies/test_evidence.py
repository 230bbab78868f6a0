# SPDX-License-Identifier: Apache-2.0
"""Random impacts begin at the allowed speed, whatever was simulated before; their table can be resumed and reported."""

import json
import math
from collections.abc import Callable, Sequence
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from scara_effmass.errors import OutputError
from scara_effmass.iso15066 import limits_for
from scara_effmass.safety import Monitor
from scara_effmass.settings import MonitorSettings, ServoSettings
from scara_effmass.sim.recordings import EPOCH_NS
from scara_effmass.studies import evidence
from scara_effmass.studies.bounds import CREEP_MPS, RANDOM_ARM, ROBOTS, TINY, arm_of
from scara_effmass.studies.evidence import (
    FREE,
    LOSSY,
    PAGE,
    RANDOM,
    SUMMARY,
    TABLE,
    WORST,
    Evidence,
    draw_evidence,
    draw_impact,
    extend_table,
    simulate,
    write_evidence,
)
from scara_effmass.values import FloatArray, JointState, Verdict

COLUMNS = (
    "index,robot,link,region,place,plate,drives,bandwidth_hz,damping,draws,setting,speed_m_s,"
    "ratio,time_to_peak_s,turn_to_peak,contact_damping,contact_friction"
)


NONE = "no impact at the worst normal"
ENOUGH = 1250
"""Impacts of each of eight kinds, with which a goal can be met."""


@pytest.fixture
def write_table(tmp_path: Path) -> Callable[..., Path]:
    """Write impacts of `free` and `default`, `count` for each kind of drives, place and plate.

    The first argument is the median of the worst places and plates, `above` are ratios of the first ones of `free`.
    """

    def write(median: float, count: int = 50, above: Sequence[float] = (1.25, 1.5)) -> Path:
        lines = [COLUMNS]
        cases = product(("free", "computed_torque"), (WORST, RANDOM), (WORST, RANDOM))
        for number, (drives, place, plate) in enumerate(cases):
            for i in range(count):
                index = count * number + i
                robot = "UR5" if i % 2 else "i4-550L"
                for setting in ("free", "default"):
                    ratio = median if place == plate == WORST else 0.5
                    if index < len(above) and setting == "free":
                        ratio = above[index]
                    lines.append(
                        f"{index},{robot},link2,chest,{place},{plate},{drives},5.0,0.7,2,{setting},0.5,{ratio},0.01,"
                        "0.1,0.0,0.0"
                    )
        (tmp_path / TABLE).write_text("\n".join(lines) + "\n", encoding="utf-8")
        return tmp_path / TABLE

    return write


def test_shares_and_intervals(write_table: Callable[..., Path]) -> None:
    evidence = Evidence(write_table(0.8))
    assert (evidence.impacts, evidence.robots, evidence.draws) == (400, ["i4-550L", "UR5"], 2.0)
    group = evidence.group("free", "free", place=WORST, plate=WORST)
    assert group is not None
    assert (group.impacts, group.above, group.share, group.worst, group.median) == (50, 2, 0.04, 1.5, 0.8)
    assert group.interval == pytest.approx((0.00488, 0.13714), abs=1e-5)  # Clopper and Pearson, 2 of 50
    clean = evidence.group("default", "computed_torque")
    assert clean is not None
    assert clean.interval == pytest.approx((0.0, 1.0 - 0.025 ** (1.0 / 200.0)))
    assert evidence.group("iso", "free") is None
    lengths = {name: len(groups) for name, groups in evidence.tables().items()}
    assert lengths == {"place": 16, "robot": 8, "surface": 4, "worst": 8}
    assert evidence.groups(robot=("UR5",)) == evidence.tables()["robot"][2:4] + evidence.tables()["robot"][6:]
    assert [row["ratio"] for row in evidence.largest()[:3]] == [1.5, 1.25, 0.8]


@pytest.mark.parametrize(
    ("old", "new"), [("0.8,0.01", "x,0.01"), ("0.8,0.01", "nan,0.01"), ("0.8,0.01", "0.8"), ("ratio", "r")]
)
def test_damaged_table_is_refused(write_table: Callable[[float], Path], old: str, new: str) -> None:
    table = write_table(0.8)
    table.write_text(table.read_text(encoding="utf-8").replace(old, new, 1), encoding="utf-8")
    with pytest.raises(OutputError, match="is damaged: must be a table of impacts"):
        Evidence(table)


@pytest.mark.parametrize(
    ("median", "met"),
    [(0.7, [False, True, True, True]), (0.69, [False, False, True, False])],
)
def test_goals(write_table: Callable[..., Path], median: float, met: list[bool]) -> None:
    assert [goal[2] for goal in Evidence(write_table(median, ENOUGH)).goals()] == met


@pytest.mark.parametrize(
    ("above", "met"), [([1.05] * 5, True), ([1.01] * 6, False), ([1.0] * 6, True), ([1.051], False)]
)
def test_goal_is_few_impacts_above_the_limit_and_none_far(
    write_table: Callable[..., Path], above: list[float], *, met: bool
) -> None:
    """Of 5000 with free joints."""
    _, _, first = Evidence(write_table(0.8, ENOUGH, above)).goals()[0]
    assert first == met


def test_damped_impacts_are_a_group_and_count_for_every_goal(write_table: Callable[..., Path]) -> None:
    table = write_table(0.8, ENOUGH)
    goals = Evidence(table).goals()
    table.write_text(table.read_text(encoding="utf-8").replace(",0.0,0.0\n", ",0.1,0.0\n"), encoding="utf-8")
    evidence = Evidence(table)
    assert evidence.goals() == goals
    assert {group.surface for group in evidence.tables()["surface"]} == {LOSSY}


def test_no_goal_is_met_by_too_few_impacts(write_table: Callable[..., Path]) -> None:
    goals = Evidence(write_table(0.8, ENOUGH - 1)).goals()
    assert [text.split(";")[0] for _, text, _ in goals] == ["too few impacts: 9992 of at least 10000"] * 4
    assert not any(met for _, _, met in goals)


def test_report_states_results_and_what_is_simulated(write_table: Callable[..., Path]) -> None:
    folder = write_table(0.8).parent
    write_evidence(folder, 1)
    page = (folder / PAGE).read_text(encoding="utf-8")
    assert "Everything on this page is simulated" in page
    assert "4.00% (0.49% to 13.71%)" in page
    assert "With the default the limit was kept in 400 of 400 simulated impacts (worst force 0.800 of it), with" in page
    summary = json.loads((folder / SUMMARY).read_text(encoding="utf-8"))
    assert (summary["simulated"], summary["impacts"], summary["seed"]) == (True, 400, 1)
    assert {path.suffix for path in folder.iterdir()} == {".csv", ".html", ".json", ".png", ".svg"}


def test_figure_has_a_panel_per_drives_and_place(write_table: Callable[..., Path]) -> None:
    figure = draw_evidence(Evidence(write_table(0.8)))
    assert [len(axes.get_lines()) for axes in figure.axes] == [4, 4, 4, 4, 2, 2]  # two settings, limit and median
    assert [[text.get_text() for text in axes.texts] for axes in figure.axes[3:5]] == [[], [NONE]]


SEED = 3


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Five impacts without interruption."""
    path = tmp_path_factory.mktemp("table") / "impacts.csv"
    extend_table(path, SEED, 5)
    text = path.read_text(encoding="utf-8")
    assert [*dict.fromkeys(line.split(",")[0] for line in text.splitlines())] == ["index", *"01234"]
    return text


def test_every_setting_starts_at_exactly_the_allowed_speed() -> None:
    for index in (0, 1, 2, 23):
        impact = draw_impact(SEED, index)
        arm = arm_of(impact.robot, is_whole=True)
        settings = impact.settings
        assert settings.keys() == impact.starts.keys()
        for name, (qd, position, person, normal) in impact.starts.items():
            monitor = Monitor(arm.dynamics, settings[name])
            contact = (
                monitor.assess_configurations(impact.q[None], qd[None], impact.qdd).decision(0).contacts[impact.link]
            )
            assert 0.0 <= contact.margin < 1e-6 * contact.speed or not qd.any()
            assert contact.body_region == impact.limit.region
            assert np.linalg.norm(person) == pytest.approx(impact.person_speed)
            arm.sim.move_contact(impact.link, position)
            velocity = arm.sim.kinematics(impact.q, impact.link)[0] @ qd
            assert normal @ (velocity - person) >= 0.0
            if impact.place == WORST and qd.any():
                assert velocity == pytest.approx(np.array(contact.direction) * contact.speed, abs=1e-6)
            assert np.all(np.abs(qd) <= arm.max_speed)
        uncertainty = MonitorSettings().mass_uncertainty
        assert np.all(np.abs(impact.mass_factors - 1.0) <= uncertainty)
        assert np.ptp(impact.mass_factors) > 0.1 * uncertainty


def test_no_verdict_is_ok_for_a_user_who_states_nothing() -> None:
    """So none of them can exceed the limit; the shipped SCARA's file states everything."""
    rng = np.random.default_rng(SEED)
    for name in (*list(ROBOTS)[1:], *(f"{RANDOM_ARM}{number}" for number in range(5))):
        arm = arm_of(name, is_whole=True)
        for _ in range(20):
            q, qd = arm.draw_motion(rng)
            state = JointState(EPOCH_NS, arm.dynamics.robot.joint_names, q, qd)
            decision = Monitor(arm.dynamics, MonitorSettings()).assess(state, EPOCH_NS)
            assert decision is not None
            assert all(contact.verdict is not Verdict.OK for contact in decision.contacts)


def test_robots_plates_drives_and_places_take_turns() -> None:
    impacts = [draw_impact(SEED, index) for index in (0, 1, 2, 3, 4, 5, 10, 15, 20)]
    assert [impact.robot for impact in impacts[:4]] == list(ROBOTS)
    assert impacts[4].robot.startswith(RANDOM_ARM)
    cases = [(WORST, True, WORST), (RANDOM, True, WORST), (WORST, False, WORST), (RANDOM, False, WORST)]
    found = [(impact.plate, impact.drives == FREE, impact.place) for impact in (impacts[0], *impacts[5:])]
    assert found == [*cases, (WORST, True, RANDOM)]


def test_worst_normal_and_place_give_a_larger_force_than_random_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same motions, at the same speed, with another plate or at another place of the link."""

    def forces(index: int) -> FloatArray:
        return np.array([row["peak_n"] for row in simulate(SEED, index)], dtype=float)

    rng = np.random.default_rng(SEED)
    others: tuple[list[float], list[float]] = [], []
    for index in range(5):
        impact = draw_impact(SEED, index)
        assert (impact.plate, impact.place) == (WORST, WORST)
        normals, places = {}, {}
        for name, start in impact.starts.items():
            normal = rng.normal(size=3)
            normal *= math.copysign(1.0, normal @ start.normal) / np.linalg.norm(normal)
            normals[name], places[name] = start._replace(normal=normal), start._replace(position=impact.position)
        worst = forces(index)
        for starts, ratios in zip((normals, places), others, strict=True):
            changed = impact._replace(starts=starts)
            monkeypatch.setattr(evidence, "draw_impact", lambda *_, changed=changed: changed)
            ratios.extend((forces(index) / worst).tolist())
            monkeypatch.undo()
    for ratios in others:
        assert np.median(ratios) < 1.0


SATURATED = {
    "Panda": (
        [-2.1027, 0.9054, -1.0129, -0.6703, 0.4280, 0.7046, 0.8103],
        [-0.03835, -0.04607, -0.03487, 0.06841, -0.00113, 0.10931, 0.0],
        [-0.4306, -0.1775, 0.8849],
        0.5,
    ),
    "UR5": (
        [-0.4047, -1.5286, -0.2984, -2.1228, 2.7075, -1.4143],
        [-0.21695, -0.0178, 0.33521, 0.53941, -0.27429, -0.29607],
        [0.6798, 0.2819, 0.6771],
        1.0,
    ),
}
"""Pose, motion, plate normal and damping ratio of a servo of 10 Hz, whose joints saturate."""


@pytest.mark.parametrize("robot", SATURATED)
def test_arm_whose_joints_would_saturate_keeps_the_limit(robot: str) -> None:
    """Where the arm hit again, up to 2.2 times too hard: its saturated joints had run away from their reference."""
    q, qd, normal, damping = SATURATED[robot]
    arm, servo = arm_of(robot), ServoSettings(bandwidth=10.0, damping=damping, computed_torque=True)
    arm.sim.scale_masses(np.ones(arm.sim.n))
    settings = MonitorSettings(servo=servo, body_regions=("thigh_knee",), effective_mass_model="full")
    (limit,) = limits_for(settings)
    motion = np.array(qd) + TINY
    speed = float(np.linalg.norm(arm.sim.kinematics(np.array(q))[0] @ motion))
    allowed = arm.allowed(np.array(q), motion * (CREEP_MPS / speed), settings)
    assert allowed is not None
    peak = arm.sim.touch(np.array(q), allowed, np.array(normal), limit, servo)
    assert 0.0 < peak.force < limit.permissible_force_n


def test_rows_do_not_depend_on_what_was_simulated_before(table: str) -> None:
    rows = [line for line in table.splitlines() if line.startswith("0,")]
    simulate(SEED, 4)
    assert [",".join(map(str, row.values())) for row in simulate(SEED, 0)] == rows


@pytest.mark.parametrize("size", [0, 40, 0.3, 0.6, 0.999])
def test_resumed_table_is_that_of_one_run(table: str, tmp_path: Path, size: float) -> None:
    path = tmp_path / "impacts.csv"
    path.write_text(table[: size if isinstance(size, int) else int(size * len(table))], encoding="utf-8")
    extend_table(path, SEED, 5)
    assert path.read_text(encoding="utf-8") == table


@pytest.mark.parametrize("change", ["seed", "header", "number", "line", "binary"])
def test_table_of_another_run_is_refused_and_kept(table: str, tmp_path: Path, change: str) -> None:
    path = tmp_path / "impacts.csv"
    number = f"{table[: table.rindex(' ')]} 1.5\n"
    text = {"seed": table, "header": f"x{table}", "number": number, "line": "other", "binary": "\xff"}[change]
    path.write_text(text, encoding="latin-1")
    with pytest.raises(OutputError, match=r"impacts.csv: must be of this seed and version"):
        extend_table(path, SEED + (change == "seed"), 6)
    assert path.read_text(encoding="latin-1") == text


def test_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.touch()
    with pytest.raises(OutputError, match=r"file/impacts.csv: cannot be written"):
        extend_table(file / "impacts.csv", SEED, 1)

# SPDX-License-Identifier: Apache-2.0
"""Maps of the workspace: every cell has the worst of the configurations in it, by the monitor and the closed forms."""

import math
from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.analysis.workspace_map import (
    Cells,
    Plane,
    WorkspaceSample,
    _motions,
    draw_map,
    map_table,
    sample_workspace,
    summarize,
)
from scara_effmass.errors import RobotError
from scara_effmass.kernel.records import CONTACT
from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor, unknown_contact
from scara_effmass.settings import MassModel, MonitorSettings
from scara_effmass.share import share
from scara_effmass.studies.scara import scara_lumped_mass
from scara_effmass.values import Vector3, Verdict
from test.decisions import assessments_of, decision_on

ALONG_X: Vector3 = (1.0, 0.0, 0.0)
SEEN_FROM_ABOVE = Plane()
MASSES = ("effective_mass", "reduced_mass", "worst_normal_reduced_mass")


def sample(
    settings: MonitorSettings,
    direction: Vector3 = ALONG_X,
    plane: Plane = SEEN_FROM_ABOVE,
    *,
    use_reference: bool = False,
    count: int = 300,
) -> WorkspaceSample:
    dynamics = RobotDynamics(load_robot(settings.robot_path, settings))
    return sample_workspace(
        Monitor(dynamics, settings, use_reference=use_reference), direction, "", plane, count, lambda _: None
    )


def test_masses_are_those_of_the_closed_form() -> None:
    drawn = sample(MonitorSettings(effective_mass_model=MassModel.LUMPED))
    expected = [min(float(scara_lumped_mass(q[0], q[1], 0.0, 2.38, 0.97)), 1000.0) for q in drawn.q]
    np.testing.assert_allclose(drawn.masses("effective_mass"), expected, rtol=1e-4)
    length = np.hypot(drawn.positions[:, 0], drawn.positions[:, 1])
    np.testing.assert_allclose(length, 0.55 * np.abs(np.cos(drawn.q[:, 1] / 2.0)), atol=1e-9)


@pytest.mark.parametrize("person_speed", [0.0, 0.05])
def test_result_does_not_depend_on_the_speed_of_the_motion(person_speed: float) -> None:
    settings = {"contact_points": ("whole_arm",), "contact_links": ("link4",)} if person_speed else {}
    slow, fast = (
        sample(MonitorSettings(**settings, person_speed=person_speed, speed_threshold=threshold))
        for threshold in (0.002, 0.02)
    )
    same = {tuple(q): row for row, q in enumerate(slow.q.tolist())}
    pairs = [(same[tuple(q)], row) for row, q in enumerate(fast.q.tolist()) if tuple(q) in same]
    assert len(pairs) > 280
    for first, second in pairs:
        for field in (*MASSES, "allowable_speed"):
            value = slow.contacts[field][first]
            assert fast.contacts[field][second] == pytest.approx(value, rel=1e-4, abs=1e-5), field


def test_plane_and_direction_of_a_six_axis_arm() -> None:
    robot = str(share("config", "robots", "ur5_robot.urdf"))
    direction = (0.0, 0.6, -0.8)
    drawn = sample(MonitorSettings(robot=robot, effective_mass_model=MassModel.FULL), direction, Plane(1, 0.25))
    np.testing.assert_allclose(drawn.positions[:, 1], 0.25, atol=1e-4)
    np.testing.assert_allclose(drawn.contacts["direction"], [direction] * 300, atol=1e-3)
    assert {contact.direction for contact in drawn.assessments()} == {*map(tuple, drawn.contacts["direction"].tolist())}
    cells = Cells(drawn)
    table = map_table(cells, ("a", "b", "c", "d", "e", "f"))
    assert table.column_names[:2] == ["x_m", "z_m"]
    for row in table.to_pylist():
        offsets = np.abs(drawn.positions[:, [0, 2]] - [row["x_m"], row["z_m"]])
        inside = np.all(offsets <= cells.size / 2.0 + 1e-9, axis=1)
        assert row["configurations"] == inside.sum()
        assert row["effective_mass_kg"] == drawn.masses("effective_mass")[inside].max()
        slowest = min(np.flatnonzero(inside), key=lambda index: drawn.contacts["allowable_speed"][index])
        assert row["allowable_speed_m_s"] == drawn.contacts["allowable_speed"][slowest]
        assert row["f_position"] == drawn.q[slowest, 5]


@pytest.mark.parametrize("robot", ["", "ur5_robot.urdf", "panda.urdf"])
def test_compiled_kernel_gives_the_numbers_of_the_reference(robot: str) -> None:
    settings = MonitorSettings(robot=str(share("config", "robots", robot)) if robot else "")
    fast = sample(settings, (0.6, 0.8, 0.0), count=100)
    slow = sample(settings, (0.6, 0.8, 0.0), count=100, use_reference=True)
    assert (fast.left_out, len(fast.q)) == (slow.left_out, 100)
    for name in set(CONTACT.names or ()) - {"reason"}:
        np.testing.assert_allclose(fast.contacts[name], slow.contacts[name], rtol=1e-10, atol=1e-10, err_msg=name)
    assert fast.assessed.labels == slow.assessed.labels
    assert [contact.reason for contact in fast.assessments()] == [contact.reason for contact in slow.assessments()]


def test_point_that_cannot_move_along_the_direction_is_refused() -> None:
    with pytest.raises(RobotError, match="contact point elbow cannot move along"):
        sample(MonitorSettings(contact_points=("elbow",)), (0.0, 0.0, 1.0))


def test_deciding_contact_is_the_one_that_reaches_its_limit_first() -> None:
    drawn = sample(MonitorSettings(contact_points=("tool", "whole_arm")))
    cells, names = Cells(drawn), drawn.assessed.points
    table = map_table(cells, ("a", "b", "c", "d"))
    worst = [max(decision.contacts, key=lambda contact: contact.limit_share) for decision in drawn.assessed.decisions()]
    speeds = [speed / contact.limit_share for speed, contact in zip(drawn.contacts["speed"], worst, strict=True)]
    for number, row in enumerate(table.to_pylist()):
        slowest = min(np.flatnonzero(cells.of == number), key=lambda index: speeds[index])
        assert row["allowable_speed_all_contacts_m_s"] == pytest.approx(speeds[slowest], rel=1e-12)
        assert row["allowable_speed_all_contacts_m_s"] <= row["allowable_speed_m_s"] * (1.0 + 1e-12)
        if speeds[slowest] > 0.0:
            assert row["deciding_contact"] == worst[slowest].contact_point
    counts = summarize(cells, table, 2.77)["deciding_contacts"]
    assert counts.keys() == {*names}
    assert sum(counts.values()) == table.num_rows
    assert len(+Counter(counts)) > 2


def test_scaled_motion_violates_the_limit_of_the_deciding_contact_alone() -> None:
    settings = MonitorSettings(contact_points=("tool", "whole_arm"))
    drawn = sample(settings)
    monitor = Monitor(RobotDynamics(load_robot(settings.robot_path, settings)), settings)
    q, _, qd, _ = _motions(monitor, drawn.q, ALONG_X, "", SEEN_FROM_ABOVE)
    above = monitor.assess_configurations(q, 1.001 * qd * (drawn.speed_of_all / drawn.contacts["speed"])[:, None])
    below = monitor.assess_configurations(q, 0.999 * qd * (drawn.speed_of_all / drawn.contacts["speed"])[:, None])
    is_above, rows = above.contacts["verdict"] == Verdict.VIOLATION, np.arange(len(q))
    clear = (drawn.speed_of_all > 0.05) & (np.sort(above.limit_shares, axis=1)[:, -2] < 0.98)
    assert clear.sum() > 100
    assert is_above[rows, drawn.assessed.deciding()][clear].all()
    assert (is_above[clear].sum(axis=1) == 1).all()
    assert not (below.contacts["verdict"] == Verdict.VIOLATION)[clear].any()


def test_map_of_one_contact_point_has_no_panel_of_contacts() -> None:
    panels = []
    for points in (("tool",), ("tool", "elbow")):
        cells = Cells(sample(MonitorSettings(contact_points=points)))
        axes = draw_map(cells, map_table(cells, ("a", "b", "c", "d")), "", 2.77).axes
        panels.append([ax.get_ylabel() for ax in axes if "[m]" not in ax.get_ylabel()])
    assert panels[1] == [*panels[0], "allowable speed along n, all contacts [m/s]", "deciding contact"]


@given(st.lists(st.tuples(st.integers(0, 3), st.none() | st.floats(0.1, 9.0)), min_size=2, max_size=30))
def test_unknown_configuration_allows_no_speed_and_has_no_mass(rows: list[tuple[int, float | None]]) -> None:
    blank = unknown_contact("tool", "no mass")
    contacts = [
        blank
        if mass is None
        else blank._replace(
            verdict=Verdict.OK,
            speed=0.01,
            allowable_speed=1.0 / mass,
            effective_mass=mass,
            reduced_mass=mass,
            worst_normal_reduced_mass=mass,
        )
        for _, mass in rows
    ]
    assessed = assessments_of(*map(decision_on, contacts))
    assert [decision.reason for decision in assessed.decisions()] == [contact.reason for contact in contacts]
    positions = np.array([[place, 0.0, 0.0] for place, _ in rows], float)
    cells = Cells(WorkspaceSample(SEEN_FROM_ABOVE, ALONG_X, np.zeros((len(rows), 1)), positions, assessed, 0))
    table = map_table(cells, ("joint1",))
    assert table.num_rows == len({place for place, _ in rows})
    for row in table.to_pylist():
        own = [mass for place, mass in rows if abs(place - row["x_m"]) <= cells.size]
        known = [mass for mass in own if mass is not None]
        assert row["unknown"] == own.count(None)
        assert row["allowable_speed_m_s"] == (0.0 if None in own else 1.0 / max(known))
        assert row["allowable_speed_all_contacts_m_s"] == pytest.approx(row["allowable_speed_m_s"], rel=1e-12)
        for name in MASSES:
            assert row[f"{name}_kg"] == max(known) if known else math.isnan(row[f"{name}_kg"])
    assert summarize(cells, table, 2.77)["unknown"] == [mass for _, mass in rows].count(None)

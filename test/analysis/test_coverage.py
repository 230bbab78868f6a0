# SPDX-License-Identifier: Apache-2.0
"""Coverage: every valid joint state is counted once, and merged files equal one run."""

import json
import math
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.analysis.coverage import AZIMUTHS, ELEVATIONS, POSITIONS, SPEEDS, Coverage
from scara_effmass.errors import SettingsError
from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import unknown_contact
from scara_effmass.values import ContactAssessment, JointState, Vector3, Verdict

KINOVA = Path(__file__).parents[1] / "robots" / "kinova.urdf"
JOINTS = ("joint1", "joint2", "joint3", "joint4")
POINTS = ("tool", "elbow")

rows = st.lists(
    st.tuples(
        st.tuples(*[st.floats(-2.3, 2.3)] * 2, st.floats(0.0, 0.45), st.floats(-6.2, 6.2)),
        st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda v: math.hypot(*v) > 1e-3),
        st.floats(0.0, 3.0),
    ),
    max_size=20,
)
Row = tuple[tuple[float, ...], Vector3, float]


def contacts(direction: Vector3 = (0.0, 0.0, 0.0), speed: float = 0.0, mass: float = 2.0) -> list[ContactAssessment]:
    length = math.hypot(*direction) or 1.0
    x, y, z = (component / length for component in direction)
    return [
        unknown_contact(point, "")._replace(verdict=Verdict.OK, effective_mass=mass, direction=(x, y, z), speed=speed)
        for point in POINTS
    ]


def counted(dynamics: RobotDynamics, rows: list[Row], *recordings: str) -> Coverage:
    coverage = Coverage.of_robot(dynamics.robot)
    for recording in recordings:
        coverage.begin(recording)
    for positions, direction, speed in rows:
        coverage.add(JointState(1, JOINTS, np.array(positions), np.zeros(4)), contacts(direction, speed))
    return coverage


def written(coverage: Coverage, folder: Path) -> Path:
    path = folder / "coverage.json"
    path.write_text(json.dumps({"coverage": coverage.model_dump(mode="json")}), encoding="utf-8")
    return path


@given(rows, rows)
def test_merged_files_equal_one_run(dynamics: RobotDynamics, first: list[Row], second: list[Row]) -> None:
    merged = counted(dynamics, second, "b")
    with TemporaryDirectory() as folder:
        merged.merge(written(counted(dynamics, first, "a"), Path(folder)))
    once = counted(dynamics, first + second, "b", "a")
    assert merged == once
    assert once.joint_states == len(first) + len(second)
    assert all(sum(bins) == once.joint_states for bins in once.counts.values())


def test_joint_states_that_are_left_out_are_counted_by_reason(dynamics: RobotDynamics, tmp_path: Path) -> None:
    coverage, merged = (Coverage.of_robot(dynamics.robot) for _ in "ab")
    for reason in ("joint2 at 2.1 rad is off", "joint2 at -2.25 rad is off", "joint joint2 is missing"):
        coverage.add(JointState(1, JOINTS, np.zeros(4), np.zeros(4)), [unknown_contact("tool", reason)])
    assert coverage.joint_states == 0
    for _ in range(2):
        merged.merge(written(coverage, tmp_path))
    assert merged.invalid == {"joint2 at … rad is off": 4, "joint joint2 is missing": 2}


def test_bins_hold_their_values(dynamics: RobotDynamics) -> None:
    coverage = counted(dynamics, [((-2.3736, 0.0, 0.45, 0.0), (1.0, 0.0, 1e-9), 0.05)])
    assert coverage.counts["position joint1"].index(1) == 0
    assert coverage.counts["position joint2"].index(1) == POSITIONS // 2
    assert coverage.counts["position joint3"].index(1) == POSITIONS - 1
    assert coverage.counts["speed tool"].index(1) == SPEEDS.index(0.05)
    assert coverage.counts["direction elbow"].index(1) == ELEVATIONS // 2 * AZIMUTHS + AZIMUTHS // 2
    assert len(coverage.poses) == 1
    shares = coverage.shares()
    assert shares["poses"] == 1 / 256
    assert shares["position joint1"] == 1 / POSITIONS
    assert shares["fastest_bin_from_m_s"] == {"speed tool": 0.05, "speed elbow": 0.05}


def test_continuous_joint_covers_a_turn_however_often_it_has_turned() -> None:
    dynamics = RobotDynamics(load_robot(KINOVA))
    names, coverage = dynamics.robot.joint_names, Coverage.of_robot(dynamics.robot)
    assert coverage.ranges[names[0]] == (-math.pi, math.pi)
    (point,) = dynamics.contact_points
    moving = [unknown_contact(point, "")._replace(verdict=Verdict.OK, effective_mass=2.0)]
    for angle in np.linspace(-400.0, -400.0 + math.pi, 200).tolist():
        coverage.add(JointState(1, names, np.array([angle, *[2.0] * 5]), np.zeros(6)), moving)
    assert coverage.shares()[f"position {names[0]}"] == pytest.approx(0.5, abs=1.1 / POSITIONS)
    assert len(coverage.poses) in (2, 3)


def test_directions_are_bins_of_equal_area(dynamics: RobotDynamics) -> None:
    vectors = np.random.default_rng(1).normal(size=(4000, 3))
    coverage = counted(dynamics, [((0.0,) * 4, (x, y, z), 1.0) for x, y, z in vectors.tolist()])
    mean = 4000 / (AZIMUTHS * ELEVATIONS)
    assert max(abs(count - mean) for count in coverage.counts["direction tool"]) < 5.0 * math.sqrt(mean)


def test_state_at_rest_has_no_direction_and_an_invalid_one_does_not_count(dynamics: RobotDynamics) -> None:
    coverage = counted(dynamics, [])
    state = JointState(1, JOINTS, np.zeros(4), np.zeros(4))
    coverage.add(state, contacts(mass=0.0))
    coverage.add(state, [*contacts()[:1], *contacts(mass=0.0)[1:]])
    assert coverage.joint_states == 0
    coverage.add(state, contacts())
    assert coverage.joint_states == coverage.counts["speed tool"][0] == 1
    assert not any(coverage.counts["direction tool"])


def test_recording_counts_once(dynamics: RobotDynamics, tmp_path: Path) -> None:
    path = written(counted(dynamics, [], "a"), tmp_path)
    with pytest.raises(SettingsError, match="a: must not be counted twice"):
        counted(dynamics, [], "a").merge(path)


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        ({"robot": "other"}, "robot, ranges and bins = "),
        ({"counts": {"position joint1": [1]}}, "robot, ranges and bins = "),
        ({"joint_states": -1}, "joint_states = -1"),
        ({"counts": 5}, "counts = 5"),
    ],
)
def test_file_that_does_not_fit_is_refused(
    dynamics: RobotDynamics, tmp_path: Path, change: dict[str, object], rule: str
) -> None:
    path = written(counted(dynamics, []), tmp_path)
    content = json.loads(path.read_text(encoding="utf-8"))
    path.write_text(json.dumps({"coverage": content["coverage"] | change}), encoding="utf-8")
    with pytest.raises(SettingsError, match=rule):
        counted(dynamics, []).merge(path)


def test_speeds_of_the_picture_can_be_read(dynamics: RobotDynamics) -> None:
    figure = counted(dynamics, [((0.0, 0.0, 0.1, 0.0), (1.0, 0.0, 0.0), 0.05)]).figure()
    figure.draw_without_rendering()
    (axes, *_) = (axes for axes in figure.axes if axes.get_xlabel().startswith("speed"))
    boxes = [label.get_window_extent() for label in axes.get_xticklabels()]
    assert all(following.x0 - box.x1 > 5.0 for box, following in pairwise(boxes))

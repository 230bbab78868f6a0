# SPDX-License-Identifier: Apache-2.0
"""Joint states assessed many at once get the verdicts, texts and numbers that a monitor gives them one by one."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyarrow import parquet
from scara_effmass.analysis.archive import many_at_once, slow_reason
from scara_effmass.analysis.assessed_states import AssessedStates, batch_size

from scara_effmass.analysis import assessed_states
from scara_effmass.analysis.assessment import ClockSkew, Time, assess_joint_states, joint_state_topic, one_by_one
from scara_effmass.analysis.cross_check import cross_checked, first_difference
from scara_effmass.analysis.tables import open_writer
from scara_effmass.bags.files import find_bags, open_bag
from scara_effmass.errors import BagError, CrossCheckError
from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import Verdict
from test.analysis.faulty_recordings import FAULTS, messages, write

ROOT = Path(__file__).parents[2]
BAGS = [path for folder in (ROOT / "bags", ROOT / "test" / "recordings") for path in find_bags(folder)]
ROBOTS = [*sorted(ROOT.glob("config/robots/*.urdf")), *sorted(ROOT.glob("test/robots/*.urdf"))]
SCARA = RobotDynamics(load_robot(settings=MonitorSettings()))


@pytest.fixture(autouse=True, scope="module")
def _small_batches() -> Iterator[None]:
    """Make the seams of batches frequent."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(assessed_states, "ROWS", 67 * len(SCARA.contact_points))
        yield


def compare(path: Path, dynamics: RobotDynamics, time: Time = Time.LIVE, **changes: Any) -> list[AssessedStates]:  # noqa: ANN401
    """Return the assessments of a recording once both ways agree on every joint state, and on all counts."""
    config = MonitorSettings(**changes)
    monitor, reference = Monitor(dynamics, config), Monitor(dynamics, config)
    skew, other_skew = ClockSkew(), ClockSkew()
    assert not slow_reason(monitor, None)
    with open_bag(path) as bag, open_bag(path) as again:
        topic = joint_state_topic(bag, None)
        decisions = assess_joint_states(again, topic, reference, time)
        both = (
            many_at_once(bag, topic, monitor, skew, time),
            one_by_one(decisions, other_skew, batch_size(len(dynamics.contact_points))),
        )
        states = list(cross_checked(path.name, *both))
        assert bag.losses == again.losses
    assert (monitor.ignored, monitor.rejected) == (reference.ignored, reference.rejected)
    assert (skew.min_s, skew.max_s) == (other_skew.min_s, other_skew.max_s)
    return states


@settings(max_examples=16)
@given(
    st.lists(st.tuples(st.sampled_from(FAULTS), st.integers(0, 400)), max_size=6),
    st.integers(0, 1000),
    st.sampled_from(Time),
    st.sampled_from(
        [
            {},
            {"release_time": 0.0},
            {"release_time": 0.02, "timeout": 0.05},
            {"joint_map": ("o_(.*)=\\1",)},
            {"velocity_source": "from_positions", "velocity_window": 0.02},
            {"velocity_window": 0.01},
        ]
    ),
)
def test_every_joint_state_is_assessed_as_by_a_monitor(
    faults: list[tuple[str, int]], seed: int, time: Time, changes: dict[str, Any]
) -> None:
    with TemporaryDirectory() as folder:
        path = write(Path(folder, "bag.mcap"), messages(SCARA, 400, seed, faults))
        compare(path, SCARA, time, **changes)


def test_verdicts_and_refusals_of_all_kinds_are_compared(tmp_path: Path) -> None:
    states = compare(write(tmp_path / "bag.mcap", messages(SCARA, 2000, 2, [("jump", 900), ("nan", 1500)])), SCARA)
    verdicts = np.concatenate([batch.contacts[0].verdict for batch in states])
    assert set(verdicts.tolist()) == {*Verdict}
    assert any(batch.refused.any() and not batch.refused.all() for batch in states)


@pytest.mark.parametrize("path", BAGS, ids=lambda path: path.name)
def test_recordings_are_assessed_as_by_a_monitor(path: Path) -> None:
    try:
        assert compare(path, SCARA)
    except BagError as error:
        assert "names a joint of the robot" in str(error)  # noqa: PT017 - of another robot, for both


@pytest.mark.parametrize("path", ROBOTS, ids=lambda path: path.stem)
def test_every_robot_is_assessed_as_by_a_monitor(path: Path, tmp_path: Path) -> None:
    dynamics = RobotDynamics(load_robot(path, MonitorSettings()))
    if path.stem == "kinova":  # masses on the axes of 1e-4 kg, of which Pinocchio's inverse is off by 1e-6
        assert "disagrees with Pinocchio in lumped_mass" in slow_reason(Monitor(dynamics, MonitorSettings()), None)
        return
    faults = [("drop", 50), ("order", 100), ("sign", 150)]
    states = compare(write(tmp_path / "bag.mcap", messages(dynamics, 300, 1, faults)), dynamics)
    assert sum(map(len, states)) > 150


def test_table_is_the_same_for_every_number_of_threads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, tables = write(tmp_path / "bag.mcap", messages(SCARA, 2000, 4, [("jump", 900)])), []
    for threads in (1, 5):
        monkeypatch.setattr(os, "sched_getaffinity", lambda _, threads=threads: range(threads))
        table = tmp_path / f"{threads}.parquet"
        with open_bag(path) as bag, open_writer(table, {}, "base", overwrite=False) as writer:
            for states in many_at_once(bag, "/joint_states", Monitor(SCARA, MonitorSettings()), ClockSkew()):
                writer.add("bag", states)
        tables.append(table.read_bytes())
    assert tables[0] == tables[1]
    assert parquet.ParquetFile(table).metadata.num_row_groups == 30


def test_a_difference_is_named_with_its_joint_state() -> None:
    with TemporaryDirectory() as folder, open_bag(write(Path(folder, "b.mcap"), messages(SCARA, 100, 3, []))) as bag:
        states = list(many_at_once(bag, "/joint_states", Monitor(SCARA, MonitorSettings()), ClockSkew()))
    contact = states[1].contacts[0]
    wrong = contact.speed.copy()
    wrong[5] += 1e-9
    other = replace(states[1], contacts=(contact._replace(speed=wrong), *states[1].contacts[1:]))
    assert first_difference(states[1], states[1]) is None
    difference = first_difference(states[1], other)
    assert difference is not None
    assert difference[0] == 5
    text = rf"bag: cross-check: joint state 73 at \d+ ns: tool: speed = {contact.speed[5]}, but .* by the monitor"
    with pytest.raises(CrossCheckError, match=text):
        list(cross_checked("bag", iter(states), iter([states[0], other])))
    with pytest.raises(CrossCheckError, match="the number of joint states differs"):
        list(cross_checked("bag", iter(states), iter(states[:1])))


@pytest.mark.parametrize(
    ("changes", "reason"),
    [({"latch": True}, "latch"), ({"payload_topic": "payload"}, "payload_topic"), ({}, "")],
)
def test_settings_that_need_one_by_one_are_named(changes: dict[str, Any], reason: str) -> None:
    assert reason in slow_reason(Monitor(SCARA, MonitorSettings(**changes)), None)

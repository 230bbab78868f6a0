# SPDX-License-Identifier: Apache-2.0
"""Joint states assessed in batches get verdicts, texts and numbers as by a monitor, one after the other."""

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

from scara_effmass.analysis import assessment
from scara_effmass.analysis.assessment import (
    AssessedStates,
    Time,
    assess_joint_states,
    assessed_rows,
    cross_checked,
    joint_state_topic,
    payload_topics,
)
from scara_effmass.analysis.tables import open_writer
from scara_effmass.bags.bag import Bag
from scara_effmass.bags.files import find_bags, open_bag
from scara_effmass.codes import Reason
from scara_effmass.errors import BagError, CrossCheckError
from scara_effmass.kernel.records import CONTACT
from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Assessments, Monitor
from scara_effmass.safety.assessments import joined
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import Verdict
from scara_effmass.wire.payload import decode_payload
from test.analysis.faulty_recordings import FAULTS, messages, write

ROOT = Path(__file__).parents[2]
BAGS = [path for folder in (ROOT / "bags", ROOT / "test" / "recordings") for path in find_bags(folder)]
ROBOTS = [*sorted(ROOT.glob("config/robots/*.urdf")), *sorted(ROOT.glob("test/robots/*.urdf"))]
SCARA = RobotDynamics(load_robot(settings=MonitorSettings(contact_points=("tool", "elbow"))))


@pytest.fixture(autouse=True, scope="module")
def _small_batches() -> Iterator[None]:
    """Make the seams of batches frequent."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(assessment, "ROWS", 67 * len(SCARA.contact_points))
        yield


def one_after_the_other(bag: Bag, topic: str, monitor: Monitor, time: Time) -> Assessments:
    """Return the assessments of a recording by `assess_one`, as the live node calls it."""
    rows, clock_ns = [], 0
    loads = payload_topics(bag, monitor.settings.payload_topic)
    payloads = [(message.log_time_ns, decode_payload(message.data)) for message in bag.messages(loads)] if loads else []
    for block in bag.joint_state_blocks(topic):
        for log_time_ns, reason in block.decode_failures:
            rows.append(monitor.settle(monitor.refuse(Reason.UNDECODABLE, reason, log_time_ns)))
        for log_time_ns, state in zip(block.log_time_ns.tolist(), block.states(), strict=True):
            while payloads and payloads[0][0] <= log_time_ns:
                monitor.take_payload(payloads.pop(0)[1])
            own = state._replace(stamp_ns=log_time_ns) if time is Time.LOG else state
            clock_ns = max(clock_ns, own.stamp_ns)
            now_ns = clock_ns if time is Time.HEADER else log_time_ns
            assessed = monitor.assess_one(own, now_ns)
            if assessed is not None:
                rows.append(assessed)
    if not rows:
        raise BagError("no joint state names a joint of the robot")
    return joined(rows)


def compare(path: Path, dynamics: RobotDynamics, time: Time = Time.LIVE, **changes: Any) -> list[AssessedStates]:  # noqa: ANN401
    """Return the assessments of a recording once both ways agree on every joint state, and on all counts."""
    config = MonitorSettings(**changes)
    monitor, other = Monitor(dynamics, config), Monitor(dynamics, config)
    with open_bag(path) as bag, open_bag(path) as again:
        topic = joint_state_topic(bag, None)
        states = list(assess_joint_states(bag, topic, monitor, time))
        expected = one_after_the_other(again, topic, other, time)
        assert bag.losses == again.losses
    assessed = joined([batch.assessments for batch in states])
    assert len(assessed) == len(expected)
    for name in assessed.states.dtype.names or ():
        if name not in {"sequence", "now_ns", "reason"}:
            np.testing.assert_array_equal(assessed.states[name], expected.states[name], err_msg=name)
    for name in set(CONTACT.names or ()) - {"reason"}:
        np.testing.assert_array_equal(assessed.contacts[name], expected.contacts[name], err_msg=name)
    for point in range(len(dynamics.contact_points)):
        own, texts = assessed.reasons(point)
        theirs, others = expected.reasons(point)
        np.testing.assert_array_equal(np.array(texts, object)[own], np.array(others, object)[theirs])
    assert (monitor.ignored, monitor.rejected, monitor.verdicts) == (other.ignored, other.rejected, other.verdicts)
    assert monitor.first_cause == other.first_cause
    return states


def test_a_former_recording_holds_the_same_assessments() -> None:
    """A topic `contact_state` of the definition before ContactStates: a message for each contact point."""
    former_names = {"body_mass": "obstacle_mass"}
    with open_bag(ROOT / "test" / "recordings" / "former_contact_state.mcap") as bag:
        former = map(bag.deserialize, bag.messages(["/contact_state"]))
        for row in assessed_rows(bag, "/joint_states", Monitor(SCARA, MonitorSettings(drives="free"))):
            for contact in row.decision.contacts:
                recorded = next(former)
                assert (recorded.contact_point, recorded.verdict) == (contact.contact_point, contact.verdict)
                assert recorded.reason == contact.reason
                for name, value in contact._asdict().items():
                    if isinstance(value, float):
                        own = getattr(recorded, former_names.get(name, name), None)
                        assert own is None or value == pytest.approx(own, rel=1e-9, abs=1e-9, nan_ok=True), name
        assert next(former, None) is None


CHANGES: list[dict[str, Any]] = [
    {},
    {"release_time": 0.0},
    {"release_time": 0.02, "timeout": 0.05},
    {"joint_map": ("o_(.*)=\\1",)},
    {"velocity_source": "from_positions", "velocity_window": 0.02},
    {"velocity_source": "from_positions", "velocity_window": 0.0},
    {"velocity_window": 0.01},
    {"latch": True},
    {"payload_topic": "payload"},
    {"drives": "servo"},
]


@settings(max_examples=16)
@given(
    st.lists(st.tuples(st.sampled_from(FAULTS), st.integers(0, 400)), max_size=6),
    st.integers(0, 1000),
    st.sampled_from(Time),
    st.sampled_from(CHANGES),
    st.integers(1, 200),
)
def test_every_joint_state_is_assessed_as_by_a_monitor(
    faults: list[tuple[str, int]], seed: int, time: Time, changes: dict[str, Any], rows: int
) -> None:
    with TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        patch.setattr(assessment, "ROWS", rows)
        path = write(Path(folder, "bag.mcap"), messages(SCARA, 400, seed, faults))
        compare(path, SCARA, time, **changes)


def test_verdicts_and_refusals_of_all_kinds_are_compared(tmp_path: Path) -> None:
    states = compare(write(tmp_path / "bag.mcap", messages(SCARA, 2000, 2, [("jump", 900), ("nan", 1500)])), SCARA)
    assert set(np.concatenate([batch.assessments.contacts["verdict"][:, 0] for batch in states]).tolist()) == {*Verdict}
    admitted = [batch.assessments.states["is_admitted"] for batch in states]
    assert any(rows.any() and not rows.all() for rows in admitted)


@pytest.mark.parametrize("path", BAGS, ids=lambda path: path.name)
def test_recordings_are_assessed_as_by_a_monitor(path: Path) -> None:
    try:
        assert compare(path, SCARA)
    except BagError as error:
        assert "names a joint of the robot" in str(error)  # noqa: PT017 - of another robot, for both


@pytest.mark.parametrize("path", ROBOTS, ids=lambda path: path.stem)
def test_every_robot_is_assessed_as_by_a_monitor(path: Path, tmp_path: Path) -> None:
    dynamics = RobotDynamics(load_robot(path, MonitorSettings()))
    faults = [("drop", 50), ("order", 100), ("sign", 150)]
    states = compare(write(tmp_path / "bag.mcap", messages(dynamics, 300, 1, faults)), dynamics)
    assert sum(map(len, states)) > 150


def test_table_is_the_same_for_every_number_of_threads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, tables = write(tmp_path / "bag.mcap", messages(SCARA, 2000, 4, [("jump", 900)])), []
    for threads in (1, 5):
        monkeypatch.setattr(os, "sched_getaffinity", lambda _, threads=threads: range(threads))
        table = tmp_path / f"{threads}.parquet"
        with open_bag(path) as bag, open_writer(table, {}, "base", overwrite=False) as writer:
            for states in assess_joint_states(bag, "/joint_states", Monitor(SCARA, MonitorSettings())):
                writer.add("bag", states)
        tables.append(table.read_bytes())
    assert tables[0] == tables[1]
    assert parquet.ParquetFile(table).metadata.num_row_groups == 30


def test_a_difference_is_named_with_its_joint_state() -> None:
    with TemporaryDirectory() as folder, open_bag(write(Path(folder, "b.mcap"), messages(SCARA, 100, 3, []))) as bag:
        states = list(assess_joint_states(bag, "/joint_states", Monitor(SCARA, MonitorSettings())))
    own = states[1].assessments
    other = replace(states[1], assessments=replace(own, numbers=own.numbers.copy()))
    other.assessments.contacts["speed"][5, 0] += 1e-9
    assert list(cross_checked("bag", iter(states), iter(states))) == states
    speed = own.contacts["speed"][5, 0]
    text = rf"bag: cross-check: joint state 73 at \d+ ns: tool: speed = {speed}, but .* by the monitor"
    with pytest.raises(CrossCheckError, match=text):
        list(cross_checked("bag", iter(states), iter([states[0], other])))
    with pytest.raises(CrossCheckError, match="the number of joint states differs"):
        list(cross_checked("bag", iter(states), iter(states[:1])))


@pytest.mark.parametrize(
    "changes", [*CHANGES, {"contact_normal": "velocity"}, {"effective_mass_model": "full"}], ids=str
)
def test_kernel_agrees_with_the_reference(changes: dict[str, Any], tmp_path: Path) -> None:
    config, faults = MonitorSettings(**changes), [("jump", 300), ("nan", 350), ("drop", 100), ("undecodable", 50)]
    path = write(tmp_path / "bag.mcap", messages(SCARA, 400, 2, faults))
    with open_bag(path) as bag, open_bag(path) as again:
        kernel, reference = Monitor(SCARA, config), Monitor(SCARA, config, use_reference=True)
        batches = (
            assess_joint_states(source, "/joint_states", own) for source, own in ((bag, kernel), (again, reference))
        )
        assert sum(map(len, cross_checked("bag", *batches))) > 200

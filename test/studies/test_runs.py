# SPDX-License-Identifier: Apache-2.0
"""Impacts and motions read from campaign recordings agree with the ground truth."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scara_effmass.bags.files import find_bags, open_bag
from scara_effmass.bags.writer import BagWriter
from scara_effmass.errors import BagError
from scara_effmass.reference import RobotDynamics
from scara_effmass.share import share
from scara_effmass.studies.runs import AFTER_ONSET_S, BEFORE_ONSET_S, FigureInputs, read_inputs
from scara_effmass.values import JointState
from scara_effmass.wire.message_types import RUN_INFO
from scara_effmass.wire.run_info import decode_run_info, run_info_message
from test.bags.messages import run_info_of

RUN = "300_0_500g_1"


def copy_run(
    path: Path,
    changes: dict[str, Any],
    blocks: int = 1000,
    joints: Callable[[JointState], JointState] = lambda state: state,
) -> Path:
    """Copy the shipped run to `path` with `changes` in its run information and its first `blocks` force blocks.

    `joints` changes the joint states.
    """
    source = share("bags", "campaign", RUN)
    with open_bag(source) as bag, BagWriter(path) as copy:
        states = [joints(state) for block in bag.joint_state_blocks() for state in block.states()]
        copy.write_joint_states("/joint_states", states)
        for message in bag.messages(["/run_info", "/force"]):
            data = message.data
            if message.type == RUN_INFO:
                data = run_info_message(decode_run_info(data)._replace(**changes))
            if message.topic == "/force":
                blocks -= 1
                if blocks < 0:
                    continue
            copy.write(message.topic, message.type, message.log_time_ns, data)
    return path


def test_runs_agree_with_the_ground_truth(shipped: FigureInputs) -> None:
    bags = find_bags(share("bags", "campaign"))
    assert len(shipped.runs) == len(bags) == 12
    for bag, run in zip(bags, shipped.runs, strict=True):
        info = run_info_of(bag)
        assert run.point == info.impact_position[:2]
        assert run.obstacle_mass == info.obstacle_mass
        assert run.source == f"simulated run {bag.name}"
        assert run.peak_force == pytest.approx(info.true_peak_force, rel=5e-3)
        assert run.speed == pytest.approx(info.true_speed, rel=2e-3)
        assert np.interp(run.onset, run.time, run.x) == pytest.approx(run.point[0], abs=1.2e-3)
        before = run.time < run.onset - 2e-3
        np.testing.assert_allclose(run.velocity[before], np.gradient(run.x, run.time)[before], atol=6e-3)


def test_force_starts_before_the_onset(shipped: FigureInputs) -> None:
    for run in shipped.runs:
        assert -BEFORE_ONSET_S <= run.force_time[0] < 0.0
        assert AFTER_ONSET_S - 1e-4 < run.force_time[-1] <= AFTER_ONSET_S
        assert np.abs(run.force[run.force_time < -1e-4]).max() < 1.5
        assert run.force.max() == pytest.approx(run.peak_force, rel=0.02)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"plate_normal": (0.0, 0.0, 0.0)}, "must state obstacle_mass"),
        ({"obstacle_mass": 0.0}, "obstacle_mass"),
        ({"plate_normal": (0.0, 1.0, 0.0), "guide_direction": (0.0, 0.0, 0.0)}, "plate_normal"),
        ({"plate_normal": (0.0, 1.0, 0.0)}, "guide_direction = .*: must not lie in the plate"),
        ({"impact_position": (math.nan, 0.0, 0.0)}, "impact_position"),
    ],
)
def test_recording_without_point_or_mass_raises(
    dynamics: RobotDynamics, tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
    path = copy_run(tmp_path / "run", changes)
    with pytest.raises(BagError, match=message) as raised:
        read_inputs(dynamics, tmp_path)
    assert str(path) in str(raised.value)


@pytest.mark.parametrize(("blocks", "message"), [(0, "ForceBlock"), (4, "0 impacts")])
def test_recording_without_an_impact_raises(dynamics: RobotDynamics, tmp_path: Path, blocks: int, message: str) -> None:
    copy_run(tmp_path / "run", {}, blocks)
    with pytest.raises(BagError, match=message):
        read_inputs(dynamics, tmp_path)


def test_joints_may_be_in_any_order(shipped: FigureInputs, tmp_path: Path) -> None:
    copy_run(
        tmp_path / RUN,
        {},
        joints=lambda s: s._replace(names=s.names[::-1], position=s.position[::-1], velocity=s.velocity[::-1]),
    )
    (run,) = read_inputs(shipped.dynamics, tmp_path).runs
    expected = next(run for run in shipped.runs if run.name == RUN)
    assert run.speed == expected.speed
    np.testing.assert_array_equal(run.x, expected.x)


@pytest.mark.parametrize(
    ("joints", "message"),
    [
        (lambda s: s._replace(names=("joint1", "gripper", "joint3", "joint4")), "joint2"),
        (lambda s: s._replace(velocity=np.empty(0)), "velocity"),
        (lambda s: s._replace(stamp_ns=s.stamp_ns + 10**9), "must be within the recording"),
    ],
)
def test_unusable_joint_states_raise_in_one_line(
    dynamics: RobotDynamics, tmp_path: Path, joints: Callable[[JointState], JointState], message: str
) -> None:
    copy_run(tmp_path / "run", {}, joints=joints)
    with pytest.raises(BagError, match=message) as raised:
        read_inputs(dynamics, tmp_path)
    assert "\n" not in str(raised.value)

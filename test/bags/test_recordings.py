"""Recordings of real robots, and what is known of them; skipped where they are not at hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from scara_effmass.bags.files import find_bags, open_bag

RECORDINGS = Path(__file__).resolve().parents[3] / "shared" / "recordings"
WX200 = RECORDINGS / "interbotix_wx200_waist_diagnostics.bag"
STILL = RECORDINGS / "zero_velocity_while_moving.bag"

pytestmark = pytest.mark.skipif(not RECORDINGS.is_dir(), reason="the recordings are not beside the checkout")


def test_a_real_arm_with_types_of_its_own() -> None:
    with open_bag(WX200) as bag:
        assert {topic.name: topic.count for topic in bag.topics}["/wx200/joint_states"] == 10598
        assert bag.joint_state_topics == ("/wx200/joint_states",)
        assert bag.duration_ns == pytest.approx(106e9, rel=0.001)
        blocks = list(bag.joint_state_blocks())
        assert sum(map(len, blocks)) == 10598
        (names,) = {block.names for block in blocks}
        assert names == (
            "waist", "shoulder", "elbow", "wrist_angle", "wrist_rotate", "gripper", "left_finger", "right_finger",
        )  # fmt: skip
        waist = np.concatenate([block.position for block in blocks])[:, 0]
        speed = np.concatenate([block.velocity for block in blocks])[:, 0]
        stamp_ns = np.concatenate([block.stamp_ns for block in blocks])
        assert np.abs(waist).max() == pytest.approx(3.13, abs=0.02)
        assert np.abs(speed).max() == pytest.approx(2.3, abs=0.1)
        assert np.diff(stamp_ns).max() == pytest.approx(64e6, rel=0.02)
        assert bag.losses == ()


def test_types_that_only_this_recording_defines_are_decoded() -> None:
    with open_bag(WX200) as bag:
        custom = [topic.name for topic in bag.topics if not topic.type.startswith("sensor_msgs")]
        assert len(custom) == 2
        for name in custom:
            messages = list(bag.messages([name]))
            assert {topic.name: topic.count for topic in bag.topics}[name] == len(messages)
            assert all(bag.deserialize(message) is not None for message in messages)
        assert bag.losses == ()


def test_velocities_of_zero_while_moving_stay_as_they_were_recorded() -> None:
    with open_bag(STILL) as bag:
        blocks = list(bag.joint_state_blocks())
        assert sum(map(len, blocks)) == 2725
        assert all(block.velocity.shape == block.position.shape == (len(block), 6) for block in blocks)
        assert not any(block.velocity.any() for block in blocks)
        assert np.ptp(np.concatenate([block.position for block in blocks]), axis=0).max() > 0


def test_the_folder_holds_two_recordings() -> None:
    assert find_bags(RECORDINGS) == [WX200, STILL]

# SPDX-License-Identifier: Apache-2.0
"""A recording of a real robot."""

from pathlib import Path

import numpy as np
import pytest

from scara_effmass.bags.files import open_bag

WX200 = Path(__file__).parents[1] / "recordings" / "interbotix_wx200_waist.bag"


def test_joint_states_of_a_real_robot() -> None:
    with open_bag(WX200) as bag:
        assert bag.joint_state_topics == ("/wx200/joint_states",)
        assert bag.duration_ns == pytest.approx(12e9, rel=0.001)
        blocks = list(bag.joint_state_blocks())
        assert sum(map(len, blocks)) == 1195
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


def test_types_that_only_the_recording_defines_are_decoded() -> None:
    with open_bag(WX200) as bag:
        counts = {topic.name: topic.count for topic in bag.topics if not topic.type.startswith("sensor_msgs")}
        assert len(counts) == 2
        for name, count in counts.items():
            messages = list(bag.messages([name]))
            assert len(messages) == count > 0
            assert all(bag.deserialize(message) is not None for message in messages)
        assert bag.losses == ()

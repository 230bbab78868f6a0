# SPDX-License-Identifier: Apache-2.0
"""Reading needs the memory of a few chunks, whatever the length of the bag."""

import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from scara_effmass.bags.files import open_bag
from scara_effmass.bags.writer import BagWriter
from scara_effmass.values import JointState
from scara_effmass.wire.joint_state import joint_state_message

COUNT = 60_000
JOINTS = 24
NAMES = tuple(f"joint{number}" for number in range(JOINTS))
CHUNK_BYTES = 1 << 20


@pytest.fixture(scope="module")
def long_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a bag of 60 000 equal messages, 45 MB uncompressed."""
    path = tmp_path_factory.mktemp("bags") / "long.mcap"
    data = joint_state_message(JointState(0, NAMES, np.zeros(JOINTS), np.ones(JOINTS)))
    with BagWriter(path) as writer:
        for number in range(COUNT):
            writer.write("/joint_states", "sensor_msgs/msg/JointState", number, data)
    return path


@pytest.mark.parametrize("interface", ["blocks", "messages"])
def test_memory_does_not_grow_with_the_bag(long_bag: Path, interface: str) -> None:
    with open_bag(long_bag) as bag:
        assert "sensor_msgs/msg/JointState" in bag.types.types  # loaded before the measurement
        tracemalloc.start()
        try:
            if interface == "blocks":
                count = sum(len(block) for block in bag.joint_state_blocks())
            else:
                count = sum(1 for _ in bag.messages())
            _, peak = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
    assert count == COUNT
    assert peak < 12 * CHUNK_BYTES

# SPDX-License-Identifier: Apache-2.0
"""Bags with ForceBlocks for the tests, and a clock."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from scara_effmass.bags.writer import BagWriter
from scara_effmass.values import ForceBlock
from scara_effmass.wire.force import force_block_message
from scara_effmass.wire.message_types import FORCE_BLOCK

MS = 10**6
RATE = 1000.0
START_NS = 1_700_000_000 * 10**9


class Clock:
    """Clock that the test sets."""

    def __init__(self, now_ns: int) -> None:
        self.now_ns = now_ns

    def __call__(self) -> int:
        return self.now_ns


def force_block(first: int, count: int = 100, **changes: Any) -> ForceBlock:  # noqa: ANN401 - of any field
    """Return a block at 1 kHz whose samples are their own numbers."""
    block = ForceBlock(
        stamp_ns=START_NS + first * MS,
        frame_id="cell",
        first_sample=first,
        sample_rate=RATE,
        force=np.arange(first, first + count, dtype=np.float64),
        clock_residual=1e-5,
        filter_delay=3e-3,
        source="test",
        relative_uncertainty=0.15,
    )
    return block._replace(**changes)


def block_messages(blocks: Iterable[ForceBlock], topic: str = "/force") -> list[tuple[str, str, int, bytes]]:
    return [
        (topic, FORCE_BLOCK, max(0, block.stamp_ns) + len(block.force) * MS, force_block_message(block))
        for block in blocks
    ]


def write_messages(path: Path, messages: Iterable[tuple[str, str, int, bytes]]) -> Path:
    with BagWriter(path) as bag:
        for message in messages:
            bag.write(*message)
    return path


def write_blocks(path: Path, blocks: Iterable[ForceBlock]) -> Path:
    return write_messages(path, block_messages(blocks))

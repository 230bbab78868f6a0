# SPDX-License-Identifier: Apache-2.0
"""JointState messages decoded in bulk: consecutive messages of equal layout become one array each."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from scara_effmass.bags.batches import IntArray, LossLog, MessageBatch
from scara_effmass.errors import DecodeError
from scara_effmass.values import FloatArray, JointState
from scara_effmass.wire.cdr import NS, STAMP_AT
from scara_effmass.wire.joint_state import JointStateLayout, joint_state_layout

MIN_WINDOW = 64
WINDOW_GROWTH = 4


class DecodeFailure(NamedTuple):
    """A message that is not a valid JointState, and the reason."""

    log_time_ns: int
    reason: str


@dataclass(frozen=True, slots=True)
class JointStateBlock:
    """Consecutive JointStates (m,) of one topic with the same names; arrays are read-only.

    `position` (m, n) is in [rad] or [m], `velocity` (m, k) per second, as received; n and k may be 0 and may differ
    from the number of names. `log_time_ns` (m,) is the receive time, `stamp_ns` (m,) the header stamp.
    `decode_failures` precede the first state; a block may consist of failures alone.
    """

    log_time_ns: IntArray
    stamp_ns: IntArray
    names: tuple[str, ...]
    position: FloatArray
    velocity: FloatArray
    decode_failures: tuple[DecodeFailure, ...] = ()

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def states(self) -> Iterator[JointState]:
        """Yield the states one by one, bit-identical to the output of `JointStateDecoder`."""
        names = self.names
        for stamp_ns, position, velocity in zip(self.stamp_ns.tolist(), self.position, self.velocity, strict=True):
            yield JointState(stamp_ns, names, position, velocity)


class BlockDecoder:
    """Decodes batches of JointState messages and lists the invalid ones in `losses`."""

    def __init__(self, origin: str, losses: LossLog) -> None:
        self._origin = origin
        self._losses = losses
        self._failure_counts: Counter[str] = Counter()
        self._names: tuple[str, ...] = ()
        self._window = MIN_WINDOW

    def blocks(self, batch: MessageBatch) -> Iterator[JointStateBlock]:
        """Yield the JointStates of `batch`, which must all be of one topic, in order."""
        size = batch.stop - batch.start
        buffer = np.frombuffer(batch.data, np.uint8)
        failures: list[DecodeFailure] = []
        first = 0
        while first < len(size):
            try:
                layout = joint_state_layout(batch.data[batch.start[first] : batch.stop[first]])
            except DecodeError as error:
                line = f"{self._origin}: left out: {error}"
                self._failure_counts[line] += 1
                self._losses.add(line, self._failure_counts[line])
                failures.append(DecodeFailure(int(batch.log_time_ns[first]), str(error)))
                first += 1
                continue
            # How many messages share the layout is unknown: the window grows as long as all messages in it match.
            window = slice(first, first + self._window)
            count = _leading(size[window] == layout.size)
            rows = sliding_window_view(buffer, layout.size)[batch.start[first : first + count]]
            fixed = np.concatenate([np.arange(*span) for span in layout.fixed])
            count = _leading((rows[:, fixed] == rows[0, fixed]).all(axis=1))
            self._window = self._window * WINDOW_GROWTH if count == len(size[window]) else max(count, 1)
            if layout.names != self._names:
                self._names = layout.names
            block = _block(rows[:count], batch.log_time_ns[first : first + count], layout, self._names)
            yield replace(block, decode_failures=tuple(failures))
            failures.clear()
            first += count
        if failures:
            empty = np.empty((0, 0))
            no_times = batch.log_time_ns[:0]
            yield JointStateBlock(no_times, no_times, (), empty, empty, tuple(failures))


def _leading(flags: NDArray[np.bool_]) -> int:
    """Return the number of true flags before the first false one."""
    return len(flags) if flags.all() else int(flags.argmin())


def _columns(rows: NDArray[np.uint8], start: int, size: int, dtype: str) -> NDArray[np.generic]:
    columns: NDArray[np.generic] = rows[:, start : start + size].copy().view(dtype)
    return columns


def _block(
    rows: NDArray[np.uint8], log_time_ns: IntArray, layout: JointStateLayout, names: tuple[str, ...]
) -> JointStateBlock:
    order = layout.byte_order
    sec = _columns(rows, STAMP_AT, 4, f"{order}i4")[:, 0].astype(np.int64)
    nanosec = _columns(rows, STAMP_AT + 4, 4, f"{order}u4")[:, 0].astype(np.int64)
    position = _columns(rows, layout.position_at, 8 * layout.position_count, f"{order}f8").astype(np.float64)
    velocity = _columns(rows, layout.velocity_at, 8 * layout.velocity_count, f"{order}f8").astype(np.float64)
    block = JointStateBlock(log_time_ns.copy(), sec * NS + nanosec, names, position, velocity)
    for array in (block.log_time_ns, block.stamp_ns, position, velocity):
        array.flags.writeable = False
    return block

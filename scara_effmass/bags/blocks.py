"""JointStates decoded many at a time: equal layouts in a row become one array each, without a loop over messages."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from scara_effmass.errors import DecodeError
from scara_effmass.values import JointState
from scara_effmass.wire.cdr import NS, STAMP_AT
from scara_effmass.wire.joint_state import joint_state_layout

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from scara_effmass.bags.batches import IntArray, Losses, MessageBatch
    from scara_effmass.values import FloatArray
    from scara_effmass.wire.joint_state import JointStateLayout

FIRST_WINDOW = 64
WINDOW_GROWTH = 4


class Unreadable(NamedTuple):
    """A message on a topic of joint states that is none, and why."""

    log_time_ns: int
    reason: str


@dataclass(frozen=True, slots=True)
class JointStateBlock:
    """Consecutive JointStates (m,) of one topic that carry the same names; arrays are read-only.

    `position` (m, n) and `velocity` (m, k) are in [rad] or [m] and per second, as received; n and k may be 0, and
    differ from the number of names. `log_time_ns` (m,) is when the recorder got them, `stamp_ns` (m,) what they say.
    `unreadable` came between the block before and this one, which is empty where nothing readable followed.
    """

    log_time_ns: IntArray
    stamp_ns: IntArray
    names: tuple[str, ...]
    position: FloatArray
    velocity: FloatArray
    unreadable: tuple[Unreadable, ...] = ()

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def states(self) -> Iterator[JointState]:
        """Yield them one by one, equal to the last bit to what `JointStateDecoder` makes of the same bytes."""
        names = self.names
        for stamp_ns, position, velocity in zip(self.stamp_ns.tolist(), self.position, self.velocity, strict=True):
            yield JointState(stamp_ns, names, position, velocity)


class BlockDecoder:
    """Decodes batches of JointState messages; what is no JointState also goes into `losses`."""

    def __init__(self, origin: str, losses: Losses) -> None:
        self._origin = origin
        self._losses = losses
        self._left_out: Counter[str] = Counter()
        self._names: tuple[str, ...] = ()
        self._window = FIRST_WINDOW

    def blocks(self, batch: MessageBatch) -> Iterator[JointStateBlock]:
        """Yield the JointStates of `batch`, which must be of one topic, in order."""
        size = batch.stop - batch.start
        buffer = np.frombuffer(batch.data, np.uint8)
        unreadable: list[Unreadable] = []
        first = 0
        while first < len(size):
            try:
                layout = joint_state_layout(batch.data[batch.start[first] : batch.stop[first]])
            except DecodeError as error:
                line = f"{self._origin}: left out: {error}"
                self._left_out[line] += 1
                self._losses.add(line, self._left_out[line])
                unreadable.append(Unreadable(int(batch.log_time_ns[first]), str(error)))
                first += 1
                continue
            # as many as are alike cannot be known beforehand: try more as long as it goes well
            window = slice(first, first + self._window)
            alike = _leading(size[window] == layout.size)
            rows = sliding_window_view(buffer, layout.size)[batch.start[first : first + alike]]
            decisive = np.concatenate([np.arange(*span) for span in layout.fixed])
            alike = _leading((rows[:, decisive] == rows[0, decisive]).all(axis=1))
            self._window = self._window * WINDOW_GROWTH if alike == len(size[window]) else max(alike, 1)
            if layout.names != self._names:
                self._names = layout.names
            block = _block(rows[:alike], batch.log_time_ns[first : first + alike], layout, self._names)
            yield replace(block, unreadable=tuple(unreadable))
            unreadable.clear()
            first += alike
        if unreadable:
            nothing = np.empty((0, 0))
            yield JointStateBlock(batch.log_time_ns[:0], batch.log_time_ns[:0], (), nothing, nothing, tuple(unreadable))


def _leading(flags: NDArray[np.bool_]) -> int:
    """Return how many flags are true before the first false one."""
    return len(flags) if flags.all() else int(flags.argmin())


def _columns(rows: NDArray[np.uint8], first: int, size: int, number: str) -> NDArray[np.generic]:
    columns: NDArray[np.generic] = rows[:, first : first + size].copy().view(number)
    return columns


def _block(
    rows: NDArray[np.uint8],
    log_time_ns: IntArray,
    layout: JointStateLayout,
    names: tuple[str, ...],
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

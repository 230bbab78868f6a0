# SPDX-License-Identifier: Apache-2.0
"""Assess recordings with the numbers of many joint states at once.

What depends on earlier joint states stays in order: admission, as `Monitor.admit` does it, and debouncing.
"""

from __future__ import annotations

import os
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from scara_effmass.analysis.assessed_states import AssessedStates, batch_size
from scara_effmass.analysis.assessment import (
    ClockSkew,
    RecordedVelocities,
    Time,
    require_own_joints,
)
from scara_effmass.bags.bag import Bag
from scara_effmass.bags.batches import IntArray
from scara_effmass.bags.joint_state_blocks import JointStateBlock
from scara_effmass.kernel.contact_columns import LABELS, NUMBERS, ContactColumns
from scara_effmass.safety import Admitted, Monitor, sequence
from scara_effmass.safety.debounce import HELD
from scara_effmass.safety.joint_state_validator import NANOSECONDS
from scara_effmass.values import NAN, BoolArray, FloatArray, JointState, Verdict

MIN_MANY, MAX_SINGLES = 16, 64
"""Smallest block that is admitted as a whole; most joint states that are admitted singly before the next attempt."""
MAX_THREADS = 4
"""Threads that compute: one reads, and one writes, as fast as four of them."""
Compute = Callable[[FloatArray, FloatArray, FloatArray], tuple[ContactColumns, ...]]


def slow_reason(monitor: Monitor, velocities: RecordedVelocities | None) -> str:
    """Return why the joint states are assessed one by one; empty if many at once. The kernel serves both."""
    kernel, settings = monitor.assessor.load_kernel(), monitor.settings
    slow = {
        "latch": settings.latch,
        "--velocity-bag": velocities is not None,
        "payload_topic": bool(settings.payload_topic),
    }
    return next((name for name, is_used in slow.items() if is_used), kernel)


class _Source(NamedTuple):
    """Where rows of a batch come from: those from number `first` on are those of `block` from `block_row` on."""

    first: int
    block: JointStateBlock | None
    block_row: int


class _Batch:
    """Joint states on their way through the steps: `count` of the `size` rows of each array are filled.

    `stale` holds codes of `texts`: why a state is refused, or which gap is before it.
    """

    def __init__(self, joints: int, size: int) -> None:
        self.count, self.size = 0, size
        self.texts: list[str] = []
        self._sources: list[_Source] = []
        self.log_time_ns, self.stamp_ns, self.stale = (np.full(size, sequence.NO_REASON) for _ in range(3))
        self.age, self.delay = np.zeros(size), np.zeros(size)
        self.valid, self.cleared = np.ones(size, np.bool_), np.zeros(size, np.bool_)
        self.q, self.qd, self.tolerance = (np.zeros((size, joints)) for _ in range(3))

    def add(self, block: JointStateBlock | None, block_row: int, count: int = 1) -> slice:
        """Add `count` rows that begin at `block_row` of `block`, and return them."""
        first = self.count
        last = self._sources[-1] if self._sources else None
        if last is None or last.block is not block or first - last.first != block_row - last.block_row:
            self._sources.append(_Source(first, block, block_row))
        self.count += count
        return slice(first, self.count)

    def add_motions(
        self,
        block: JointStateBlock,
        block_row: int,
        tolerance: FloatArray,
        stamps: IntArray,
        clocks: IntArray,
        q: FloatArray,
        qd: FloatArray,
    ) -> None:
        """Add as many valid joint states as `tolerance` has rows."""
        count = len(tolerance)
        if count:
            rows = self.add(block, block_row, count)
            self.log_time_ns[rows] = block.log_time_ns[block_row : block_row + count]
            self.stamp_ns[rows], self.q[rows], self.qd[rows] = stamps[:count], q[:count], qd[:count]
            self.age[rows] = (clocks[:count] - stamps[:count]) / 1e9
            self.tolerance[rows] = tolerance

    def add_admitted(self, block: JointStateBlock | None, block_row: int, log_time_ns: int, admitted: Admitted) -> None:
        """Add one joint state, None in `block` for a message that cannot be decoded."""
        (motion, reason, stamp_ns, age, delay), row = admitted, self.add(block, block_row).start
        self.log_time_ns[row], self.stamp_ns[row], self.age[row], self.valid[row] = log_time_ns, stamp_ns, age, False
        if motion is not None:
            self.valid[row], self.delay[row] = True, delay
            self.q[row], self.qd[row], self.tolerance[row] = motion
        if reason:
            self.stale[row] = text_code(len(self.texts))
            self.texts.append(reason)

    def positions(self, monitor: Monitor, row: int) -> dict[str, float]:
        """Return the joint positions of `row` by the robot's names."""
        source = self._sources[bisect_right(self._sources, row, key=lambda source: source.first) - 1]
        if source.block is None:
            return {}
        values = source.block.position[source.block_row + row - source.first]
        return dict(zip(monitor.names_of(source.block.names), values.tolist(), strict=False))

    def compute(self, compute: Compute) -> tuple[ContactColumns, ...]:
        """Return the columns of the valid joint states."""
        valid = self.valid[: self.count]
        rows = slice(None) if valid.all() else valid
        return compute(*(column[: self.count][rows] for column in (self.q, self.qd, self.tolerance)))


def text_code(index: int) -> int:
    """Return the code of text number `index`, below NO_REASON; the codes of rows are their numbers."""
    return sequence.NO_REASON - 1 - index


def many_at_once(
    bag: Bag, topic: str, monitor: Monitor, skew: ClockSkew, time: Time = Time.LIVE
) -> Iterator[AssessedStates]:
    """Yield the assessments of the joint states on `topic` in batches: those of `assess_joint_states`, as columns.

    Counts the clocks in `skew`. Only without a `slow_reason`. Raises BagError as `assess_joint_states`.
    """
    monitor.assessor.load_kernel()  # before there are threads
    debouncers = [_Debouncer(monitor) for _ in monitor.dynamics.contact_points]
    waiting: deque[tuple[_Batch, Future[tuple[ContactColumns, ...]]]] = deque()
    threads = min(len(os.sched_getaffinity(0)), MAX_THREADS)
    with ThreadPoolExecutor(threads) as pool:
        for batch in _admitted(bag, topic, monitor, skew, time):
            waiting.append((batch, pool.submit(batch.compute, monitor.assessor.compute)))
            if len(waiting) > threads:
                yield _finished(monitor, debouncers, *waiting.popleft())
        while waiting:
            yield _finished(monitor, debouncers, *waiting.popleft())


def _admitted(bag: Bag, topic: str, monitor: Monitor, skew: ClockSkew, time: Time) -> Iterator[_Batch]:
    """Yield the joint states of the robot in batches, those that the validator refuses included."""
    admission, total, clock_ns = _Admission(monitor), 0, 0
    for block in bag.joint_state_blocks(topic):
        total += len(block) + len(block.decode_failures)
        for failure in block.decode_failures:
            yield from admission.refuse(*failure)
        if not len(block):
            continue
        skew.add(block.stamp_ns, block.log_time_ns)
        stamps = block.log_time_ns if time is Time.LOG else block.stamp_ns
        clocks = block.log_time_ns
        if time is Time.HEADER:
            clocks = np.maximum.accumulate(np.maximum(stamps, clock_ns))
            clock_ns = int(clocks[-1])
        yield from admission.admit(block, stamps, clocks)
    if admission.batch.count:
        yield admission.batch
    require_own_joints(bag, topic, monitor, total)


class _Admission:
    """Fills batches with joint states; `Monitor.admit` judges, one by one, those that may be doubtful.

    It does so with all of them if their velocities are filtered or computed from positions.
    """

    def __init__(self, monitor: Monitor) -> None:
        self._monitor = monitor
        joints, points = monitor.dynamics.robot.joint_names, monitor.dynamics.contact_points
        self._new_batch = partial(_Batch, len(joints), batch_size(len(points)))
        self.batch = self._new_batch()
        self._singles = self._next_singles = 1
        self._filters = monitor.settings.filters_velocity

    def refuse(self, log_time_ns: int, reason: str) -> Iterator[_Batch]:
        """Add a message that cannot be decoded; yield a full batch."""
        yield from self._full()
        self._monitor.rejected += 1
        self.batch.add_admitted(None, 0, log_time_ns, Admitted(None, reason, 0, 0.0))

    def admit(self, block: JointStateBlock, stamps: IntArray, clocks: IntArray) -> Iterator[_Batch]:
        """Add the joint states of `block` with these stamps and receive times; yield full batches."""
        names, order, row = self._monitor.names_of(block.names), None, 0
        is_whole = block.position.shape[1] == block.velocity.shape[1] == len(names)
        if is_whole and len(block) >= MIN_MANY and not self._filters:
            order = self._monitor.validator.joint_order(names)
        q, qd = (values[:, () if order is None else order] for values in (block.position, block.velocity))
        while row < len(block):
            yield from self._full()
            if order is None or self._singles:
                self._admit_one(block, row, int(stamps[row]), int(clocks[row]))
                self._singles = max(self._singles - 1, 0)
                row += 1
                continue
            rows = slice(row, row + self.batch.size - self.batch.count)
            columns = stamps[rows], clocks[rows], q[rows], qd[rows]
            tolerance = sequence.agreeing_states(self._monitor.validator, *columns)
            self.batch.add_motions(block, row, tolerance, *columns)
            # Where one refusal follows another, the attempts cost more than they save.
            self._next_singles = 1 if len(tolerance) else min(2 * self._next_singles, MAX_SINGLES)
            self._singles = self._next_singles
            row += len(tolerance)

    def _admit_one(self, block: JointStateBlock, row: int, stamp_ns: int, now_ns: int) -> None:
        self.batch.cleared[self.batch.count] |= self._monitor.went_back(now_ns)
        state = JointState(stamp_ns, block.names, block.position[row], block.velocity[row])
        admitted = self._monitor.admit(state, now_ns)
        if admitted is not None:
            self.batch.add_admitted(block, row, int(block.log_time_ns[row]), admitted)

    def _full(self) -> Iterator[_Batch]:
        if self.batch.count == self.batch.size:
            yield self.batch
            self.batch = self._new_batch()


class _Debouncer:
    """Debounces the verdicts of one contact point, batch by batch."""

    def __init__(self, monitor: Monitor) -> None:
        self._release_ns = round(monitor.settings.release_time * NANOSECONDS)
        self._seen_ns = np.zeros(5, np.int64)
        self._seen_texts = [""] * 5

    def take(
        self, batch: _Batch, columns: ContactColumns, iso_mass: float
    ) -> tuple[ContactColumns, IntArray, list[str]]:
        """Return the columns of all rows of `batch` with debounced verdicts, indices of the reasons, and their texts.

        `columns` are those of the valid rows.
        """
        valid = batch.valid[: batch.count]
        numbers = np.cumsum(valid) - 1
        whole = columns if len(columns.verdict) == batch.count else _with_refused(columns, valid, iso_mass)
        texts = batch.texts + self._seen_texts
        own = len(batch.texts)
        seen = np.array([text_code(own + i) if self._seen_texts[i] else sequence.NO_REASON for i in range(5)])
        rows = slice(batch.count)
        flags, times = (batch.valid[rows], batch.cleared[rows], batch.stale[rows]), batch.stamp_ns[rows]
        shown, codes, held = np.empty_like(whole.verdict), np.empty_like(times), np.zeros_like(valid)
        sequence.debounce(whole.verdict, *flags, times, self._release_ns, self._seen_ns, seen, shown, codes, held)
        is_stricter = (shown == Verdict.UNKNOWN) & (whole.verdict != Verdict.UNKNOWN)
        if is_stricter.any():
            whole = whole._replace(
                allowable_speed=np.where(is_stricter, 0.0, whole.allowable_speed),
                margin=np.where(is_stricter, -whole.speed, whole.margin),
            )
        keys = pa.array(2 * codes + held).dictionary_encode()  # in the order of their first rows
        used = keys.dictionary.to_numpy(zero_copy_only=False)
        wanted = np.concatenate((used >> 1, seen))
        own_texts = iter(columns.reasons(numbers[wanted[wanted >= 0]].tolist()))
        reasons = [
            next(own_texts) if code >= 0 else "" if code == sequence.NO_REASON else texts[text_code(code)]
            for code in wanted.tolist()
        ]
        self._seen_texts = reasons[len(used) :]
        shown_texts = [f"{HELD}{text}" if key % 2 else text for key, text in zip(used.tolist(), reasons, strict=False)]
        return whole._replace(verdict=shown), keys.indices.to_numpy(zero_copy_only=False), shown_texts


def _with_refused(columns: ContactColumns, valid: BoolArray, iso_mass: float) -> ContactColumns:
    """Return `columns`, those of the `valid` rows, with rows as those of `unknown_contact` between them."""
    changes: dict[str, Any] = {}
    for name in NUMBERS:
        values = getattr(columns, name)
        fill = {"lumped_mass": NAN, "full_mass": NAN, "iso_mass": iso_mass}.get(name, 0)
        changes[name] = np.full((len(valid), *values.shape[1:]), fill, values.dtype)
        changes[name][valid] = values
    for name, texts in LABELS.items():
        changes[texts] = (*getattr(columns, texts), "")
        changes[name] = np.full(len(valid), len(getattr(columns, texts)), np.int16)
        changes[name][valid] = getattr(columns, name)
    return columns._replace(**changes)


def _finished(
    monitor: Monitor, debouncers: list[_Debouncer], batch: _Batch, computed: Future[tuple[ContactColumns, ...]]
) -> AssessedStates:
    iso_mass = monitor.assessor.iso_mass
    pairs = zip(debouncers, computed.result(), strict=True)
    contacts, reasons, texts = zip(*(debouncer.take(batch, own, iso_mass) for debouncer, own in pairs), strict=True)
    rows = slice(batch.count)
    return AssessedStates(
        log_time_ns=batch.log_time_ns[rows],
        stamp_ns=batch.stamp_ns[rows],
        input_age=batch.age[rows],
        velocity_delay=batch.delay[rows],
        refused=~batch.valid[rows],
        contacts=contacts,
        reasons=reasons,
        reason_texts=texts,
        positions=partial(batch.positions, monitor),
    )

# SPDX-License-Identifier: Apache-2.0
"""The debounced verdict is the worst verdict within the release time; a plain implementation agrees with the kernel."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import accumulate
from typing import NamedTuple

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from scara_effmass.codes import Reason
from scara_effmass.kernel.records import CONTACT
from scara_effmass.kernel.settle import settle
from scara_effmass.kernel.state import CODE, DEBOUNCE, HELD, MEMORY, RULES, STATE, VALUES
from scara_effmass.values import Verdict, limit_share, severity

RELEASE_NS = 100
NO_REASON = -1


class Step(NamedTuple):
    """One joint state: its verdict, or None if it is refused; `stale`: it is refused for a reason, or follows a gap."""

    stamp_ns: int
    verdict: Verdict | None
    stale: bool = False
    clears: bool = False


class Shown(NamedTuple):
    """Published verdict; `reason` is the stamp of the joint state that gave it, NO_REASON for none."""

    verdict: Verdict
    reason: int
    is_held: bool = False


@dataclass
class Settler:
    """Settles the verdicts of one contact by the kernel."""

    release_ns: int = RELEASE_NS

    def __post_init__(self) -> None:
        """Remember nothing."""
        rules = np.zeros(1, RULES)
        rules["release_ns"] = self.release_ns
        self._memory = tuple(array.view(np.uint8) for array in (rules, np.zeros(1, MEMORY), np.zeros(1, DEBOUNCE)))

    def settle(self, *steps: Step) -> list[Shown]:
        """Return what shows after each step. The reason of a step holds its stamp."""
        states, contacts = np.zeros(len(steps), STATE), np.zeros((len(steps), 1, 1), CONTACT)
        for state, contact, step in zip(states, contacts[:, 0, 0], steps, strict=True):
            state["stamp_ns"], state["is_cleared"] = step.stamp_ns, step.clears
            state["is_admitted"], state["is_watchdog"] = (
                step.verdict is not None,
                step.verdict is None and not step.stale,
            )
            if step.verdict is None or step.stale:
                state["reason"][[CODE, VALUES]] = Reason.GAP, step.stamp_ns
            if step.verdict is not None:
                allowable = 0.0 if step.verdict is Verdict.UNKNOWN else 1.0
                contact["verdict"], contact["speed"], contact["allowable_speed"] = step.verdict, 0.5, allowable
                contact["margin"] = allowable - 0.5
                if step.verdict is not Verdict.OK:
                    contact["reason"][[CODE, VALUES]] = Reason.TOO_FAST, step.stamp_ns
        unknown = np.zeros(1, CONTACT).view(np.float64)
        numbers = contacts.view(np.float64).reshape(len(steps), 1, -1)
        settle(states.view(np.uint8), numbers, unknown, *self._memory)
        for contact in contacts[:, 0, 0]:
            if contact["verdict"] == Verdict.UNKNOWN:
                assert contact["allowable_speed"] == 0.0
                assert contact["margin"] == -contact["speed"]
        return [
            Shown(
                Verdict(int(contact["verdict"])),
                int(contact["reason"][VALUES]) if contact["reason"][CODE] else NO_REASON,
                bool(contact["reason"][HELD]),
            )
            for contact in contacts[:, 0, 0]
        ]

    def update(self, verdict: Verdict, stamp_ns: int, *, stale: bool = False, clears: bool = False) -> Shown:
        (shown,) = self.settle(Step(stamp_ns, verdict, stale, clears))
        return shown


@dataclass
class Plain:
    """The same in plain Python: last stamp and reason of each verdict that is not OK."""

    release_ns: int
    seen: dict[Verdict, tuple[int, int]] = field(default_factory=dict)
    stale_reason: int = NO_REASON

    def step(self, step: Step) -> Shown:
        if step.clears:
            self.seen, self.stale_reason = {}, NO_REASON
        if step.stale:
            self.stale_reason = step.stamp_ns
        if step.verdict is None:
            return Shown(Verdict.UNKNOWN, step.stamp_ns)
        if self.stale_reason != NO_REASON:
            self.seen[Verdict.UNKNOWN], self.stale_reason = (step.stamp_ns, self.stale_reason), NO_REASON
        if step.verdict is not Verdict.OK:
            self.seen[step.verdict] = step.stamp_ns, step.stamp_ns
        for worse in sorted(Verdict, key=severity, reverse=True):
            if severity(worse) > severity(step.verdict) and worse in self.seen:
                seen_ns, reason = self.seen[worse]
                if step.stamp_ns - seen_ns < self.release_ns:
                    return Shown(worse, reason, is_held=True)
        return Shown(step.verdict, NO_REASON if step.verdict is Verdict.OK else step.stamp_ns)


verdicts = st.sampled_from(Verdict)
sequences = st.lists(st.tuples(st.integers(1, 60), verdicts), min_size=1, max_size=40).map(
    lambda steps: list(zip(accumulate(gap for gap, _ in steps), (verdict for _, verdict in steps), strict=True))
)


@given(sequences, st.sampled_from([0, 1, RELEASE_NS, 10_000]))
def test_worst_verdict_within_the_release_time_shows(sequence: list[tuple[int, Verdict]], release_ns: int) -> None:
    settler = Settler(release_ns)
    for row, (stamp_ns, verdict) in enumerate(sequence):
        held = [past for at, past in sequence[: row + 1] if stamp_ns - at < release_ns]
        shown = settler.update(verdict, stamp_ns)
        assert shown.verdict is max([verdict, *held], key=severity)
        assert (shown.reason == NO_REASON) == (shown.verdict is Verdict.OK)


@given(sequences)
def test_worse_verdict_shows_at_once_with_its_reason(sequence: list[tuple[int, Verdict]]) -> None:
    settler = Settler()
    before = Verdict.OK
    for stamp_ns, verdict in sequence:
        shown = settler.update(verdict, stamp_ns)
        if severity(verdict) >= severity(before):
            assert shown == (verdict, NO_REASON if verdict is Verdict.OK else stamp_ns, False)
        before = shown.verdict


@given(
    st.lists(
        st.tuples(st.integers(0, 60), st.none() | verdicts, st.integers(0, 9), st.integers(0, 9)),
        min_size=1,
        max_size=60,
    ),
    st.sampled_from([0, 1, 100, 10_000]),
    st.integers(1, 60),
)
@example([(0, Verdict.VIOLATION, 1, 1), (99, Verdict.OK, 1, 1)], 100, 60)
def test_blocks_of_any_size_are_settled_as_the_plain_implementation_does(
    steps: list[tuple[int, Verdict | None, int, int]], release_ns: int, size: int
) -> None:
    stamps = accumulate(1 + gap for gap, *_ in steps)
    rows = [
        Step(stamp_ns, verdict, stale == 0, clears == 0)
        for stamp_ns, (_, verdict, clears, stale) in zip(stamps, steps, strict=True)
    ]
    settler, plain = Settler(release_ns), Plain(release_ns)
    shown = [shown for first in range(0, len(rows), size) for shown in settler.settle(*rows[first : first + size])]
    assert shown == [plain.step(row) for row in rows]


def test_verdict_improves_exactly_after_the_release_time() -> None:
    settler = Settler()
    assert settler.update(Verdict.VIOLATION, 1000) == (Verdict.VIOLATION, 1000, False)
    assert settler.update(Verdict.OK, 1000 + RELEASE_NS - 1) == (Verdict.VIOLATION, 1000, True)
    assert settler.update(Verdict.OK, 1000 + RELEASE_NS) == (Verdict.OK, NO_REASON, False)


def test_verdict_improves_step_by_step() -> None:
    settler = Settler()
    settler.update(Verdict.VIOLATION, 1000)
    assert settler.update(Verdict.WARN, 1090).verdict is Verdict.VIOLATION
    assert settler.update(Verdict.OK, 1110) == (Verdict.WARN, 1090, True)
    assert settler.update(Verdict.OK, 1190).verdict is Verdict.OK


def test_refused_joint_state_holds_unknown_from_the_next_one() -> None:
    settler = Settler()
    settler.update(Verdict.OK, 1000)
    assert settler.settle(Step(1001, None, stale=True)) == [(Verdict.UNKNOWN, 1001, False)]
    assert settler.update(Verdict.OK, 5000) == (Verdict.UNKNOWN, 1001, True)
    assert settler.update(Verdict.VIOLATION, 5050) == (Verdict.UNKNOWN, 1001, True)
    assert settler.update(Verdict.OK, 5100) == (Verdict.VIOLATION, 5050, True)


def test_zero_release_time_holds_nothing() -> None:
    settler = Settler(0)
    assert settler.update(Verdict.OK, 5000, stale=True) == (Verdict.OK, NO_REASON, False)
    settler.update(Verdict.VIOLATION, 5001)
    assert settler.update(Verdict.OK, 5002) == (Verdict.OK, NO_REASON, False)


contacts_of_a_state = st.lists(
    st.tuples(verdicts, st.floats(0.0, 2.0), st.just(0.0) | st.floats(0.01, 2.0)), min_size=1, max_size=4
)


@given(contacts_of_a_state)
@example([(Verdict.OK, 0.9, 1.0), (Verdict.OK, 0.01, 0.02)])
@example([(Verdict.VIOLATION, 0.25, 0.045), (Verdict.VIOLATION, 1.5, 1.0)])
def test_the_contact_that_decides_has_the_largest_share_of_its_limit(rows: list[tuple[Verdict, float, float]]) -> None:
    states, contacts = np.zeros(1, STATE), np.zeros((1, len(rows), 1), CONTACT)
    states["stamp_ns"], states["is_admitted"] = 1000, 1
    for contact, row in zip(contacts[0, :, 0], rows, strict=True):
        contact["verdict"], contact["speed"], contact["allowable_speed"] = row
        contact["margin"] = row[2] - row[1]
    memory = np.zeros(1, RULES), np.zeros(1, MEMORY), np.zeros(len(rows), DEBOUNCE)
    numbers = contacts.view(np.float64).reshape(1, len(rows), -1)
    unknown = np.zeros(1, CONTACT).view(np.float64)
    settle(states.view(np.uint8), numbers, unknown, *(array.view(np.uint8) for array in memory))
    worst = max(rows, key=lambda row: (severity(row[0]), limit_share(row[1], row[2]), row[1] - row[2]))
    assert rows[int(states["contact"][0])] == worst


def test_clock_that_jumps_back_discards_held_verdicts() -> None:
    settler = Settler()
    settler.update(Verdict.VIOLATION, 1000)
    settler.settle(Step(1000, None, stale=True))
    assert settler.update(Verdict.OK, 1001, clears=True) == (Verdict.OK, NO_REASON, False)

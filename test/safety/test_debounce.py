# SPDX-License-Identifier: Apache-2.0
"""The debounced verdict is the worst verdict within the release time."""

from itertools import accumulate

from hypothesis import given
from hypothesis import strategies as st
from scara_effmass.safety.debounce import VerdictDebouncer, severity

from scara_effmass.values import Verdict

RELEASE_NS = 100

verdicts = st.sampled_from(Verdict)
steps = st.lists(st.tuples(st.integers(1, 60), verdicts), min_size=1, max_size=40)


def make_debouncer(release_ns: int = RELEASE_NS) -> VerdictDebouncer:
    debouncer = VerdictDebouncer()
    debouncer.release_ns = release_ns
    return debouncer


def reason(verdict: Verdict, stamp_ns: int) -> str:
    return "" if verdict is Verdict.OK else f"{verdict.name} at {stamp_ns}"


@given(steps, st.sampled_from([0, 1, RELEASE_NS, 10_000]))
def test_worst_verdict_within_the_release_time_shows(sequence: list[tuple[int, Verdict]], release_ns: int) -> None:
    debouncer = make_debouncer(release_ns)
    history: list[tuple[int, Verdict]] = []
    for stamp_ns, verdict in zip(accumulate(gap for gap, _ in sequence), (v for _, v in sequence), strict=True):
        history.append((stamp_ns, verdict))
        held = [past for at, past in history if stamp_ns - at < release_ns]
        debounced, debounced_reason = debouncer.update(verdict, reason(verdict, stamp_ns), stamp_ns)
        assert debounced is max([verdict, *held], key=severity)
        assert bool(debounced_reason) == (debounced is not Verdict.OK)


@given(steps)
def test_worse_verdict_shows_at_once_with_its_reason(sequence: list[tuple[int, Verdict]]) -> None:
    debouncer = make_debouncer()
    debounced, stamp_ns = Verdict.OK, 0
    for gap, verdict in sequence:
        stamp_ns += gap
        before, (debounced, debounced_reason) = (
            debounced,
            debouncer.update(verdict, reason(verdict, stamp_ns), stamp_ns),
        )
        if severity(verdict) >= severity(before):
            assert (debounced, debounced_reason) == (verdict, reason(verdict, stamp_ns))


def test_verdict_improves_exactly_after_the_release_time() -> None:
    debouncer = make_debouncer()
    assert debouncer.update(Verdict.VIOLATION, "too fast", 1000) == (Verdict.VIOLATION, "too fast")
    assert debouncer.update(Verdict.OK, "", 1000 + RELEASE_NS - 1) == (Verdict.VIOLATION, "held after: too fast")
    assert debouncer.update(Verdict.OK, "", 1000 + RELEASE_NS) == (Verdict.OK, "")


def test_verdict_improves_step_by_step() -> None:
    debouncer = make_debouncer()
    debouncer.update(Verdict.VIOLATION, "too fast", 1000)
    assert debouncer.update(Verdict.WARN, "near", 1090)[0] is Verdict.VIOLATION
    assert debouncer.update(Verdict.OK, "", 1110) == (Verdict.WARN, "held after: near")
    assert debouncer.update(Verdict.OK, "", 1190)[0] is Verdict.OK


def test_stale_input_holds_unknown_from_the_next_joint_state() -> None:
    debouncer = make_debouncer()
    debouncer.update(Verdict.OK, "", 1000)
    debouncer.mark_stale("no names")
    assert debouncer.update(Verdict.OK, "", 5000) == (Verdict.UNKNOWN, "held after: no names")
    assert debouncer.update(Verdict.VIOLATION, "too fast", 5050) == (Verdict.UNKNOWN, "held after: no names")
    assert debouncer.update(Verdict.OK, "", 5100) == (Verdict.VIOLATION, "held after: too fast")


def test_zero_release_time_holds_nothing() -> None:
    debouncer = make_debouncer(0)
    debouncer.mark_stale("no names")
    assert debouncer.update(Verdict.OK, "", 5000) == (Verdict.OK, "")
    debouncer.update(Verdict.VIOLATION, "too fast", 5001)
    assert debouncer.update(Verdict.OK, "", 5002) == (Verdict.OK, "")


def test_clear_discards_held_verdicts() -> None:
    debouncer = make_debouncer()
    debouncer.update(Verdict.VIOLATION, "too fast", 1000)
    debouncer.mark_stale("no names")
    debouncer.clear()
    assert debouncer.update(Verdict.OK, "", 1001) == (Verdict.OK, "")

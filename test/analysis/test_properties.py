# SPDX-License-Identifier: Apache-2.0
"""Temporal properties: they hold for the verdicts of the core, and each violated one is found."""

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scara_effmass.analysis.properties import PROPERTIES, check_assessment, check_recording
from scara_effmass.analysis.tables import open_writer
from scara_effmass.bags.writer import BagWriter
from scara_effmass.safety import unknown_contact
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import NAN, ContactAssessment, Decision, Verdict, severity
from scara_effmass.wire.contact_states import ContactStatesEncoder
from scara_effmass.wire.message_types import CONTACT_STATES
from test.decisions import assessments_of, decision_on, states_of

MS = 1_000_000
START_NS = 1_767_225_600_000_000_000
SETTINGS = MonitorSettings()
OK, WARN, VIOLATION, UNKNOWN = Verdict.OK, Verdict.WARN, Verdict.VIOLATION, Verdict.UNKNOWN
Trace = list[tuple[int, Decision]]
"""Log times and decisions."""


def decision(verdict: Verdict, reason: str, stamp_ns: int) -> Decision:
    """Return a decision on one contact, with the speed that fits its verdict."""
    speed = 2.0 if verdict is VIOLATION else 0.5
    allowable = 0.0 if verdict is UNKNOWN else 1.0
    empty = unknown_contact("tool", reason)
    contact = empty._replace(verdict=verdict, speed=speed, allowable_speed=allowable, margin=allowable - speed)
    return decision_on(contact, stamp_ns=stamp_ns, input_age=0.001)


def debounced(spans: list[tuple[Verdict, int]], period_ns: int = MS, release_s: float = 0.2) -> Trace:
    """Return what a monitor publishes for verdicts that last the given numbers of periods."""
    trace: Trace = []
    seen_ns: dict[Verdict, int] = {}
    for verdict in (verdict for verdict, count in spans for _ in range(count)):
        stamp_ns = START_NS + len(trace) * period_ns
        seen_ns[verdict] = stamp_ns
        recent = (other for other, at_ns in seen_ns.items() if stamp_ns - at_ns < round(release_s * 1e9))
        shown = max(recent, key=severity, default=verdict)
        reason = "" if shown is OK else "cause" if shown is verdict else "held after: cause"
        trace.append((stamp_ns + MS, decision(shown, reason, stamp_ns)))
    return trace


def violated(trace: Trace, path: Path, duration_ns: int = 0) -> set[str]:
    """Return the violated properties of a recording of `trace`."""
    with BagWriter(path / "bag") as bag:
        encoder = ContactStatesEncoder("base_link")
        for log_time_ns, state in trace:
            bag.write("/contact_states", CONTACT_STATES, log_time_ns, encoder.encode(assessments_of(state)))
        if duration_ns:
            bag.write("/other", "std_msgs/msg/Empty", trace[0][0] + duration_ns, b"\0\1\0\0\0")
    return {result.text for result in check_recording(path / "bag", SETTINGS) if result.violations}


TRACE = debounced(
    [(OK, 100), (WARN, 50), (OK, 300), (VIOLATION, 40), (OK, 900), (UNKNOWN, 5), (OK, 300), (VIOLATION, 1), (OK, 300)]
)
INDEX = {verdict: next(i for i, (_, state) in enumerate(TRACE) if state.verdict is verdict) for verdict in Verdict}
"""Index of the first state with each verdict."""


def changed(verdict: Verdict, **fields: Any) -> Callable[[Trace], Trace]:  # noqa: ANN401
    """Return a mutation of the fourth state with `verdict`."""
    at = INDEX[verdict] + 3
    of_contact = {name: value for name, value in fields.items() if name in ContactAssessment._fields}
    of_state = {name: value for name, value in fields.items() if name not in of_contact}

    def replaced(state: Decision) -> Decision:
        return state._replace(contacts=(state.contacts[0]._replace(**of_contact),), **of_state)

    return lambda trace: [(t, replaced(state) if i == at else state) for i, (t, state) in enumerate(trace)]


def released(verdict: Verdict) -> Callable[[Trace], Trace]:
    """Return a mutation that shows OK 30 ms before the release time of `verdict` has passed."""

    def mutate(trace: Trace) -> Trace:
        end = next(i for i in range(INDEX[verdict], len(trace)) if trace[i][1].verdict is not verdict)
        return [(t, decision(OK, "", c.stamp_ns) if end - 30 <= i < end else c) for i, (t, c) in enumerate(trace)]

    return mutate


MUTATIONS: dict[str, Callable[[Trace], Trace]] = {
    "UNKNOWN implies speed 0": changed(UNKNOWN, allowable_speed=0.2),
    "a permissive verdict is not below the speed": changed(WARN, margin=-0.01),
    "a permissive verdict is not older than the timeout": changed(OK, input_age=0.25),
    "a watchdog's verdict is UNKNOWN": changed(OK, watchdog=True),
    "WARN is held for the release time": released(WARN),
    "a VIOLATION is not followed by OK or WARN within the release time": released(VIOLATION),
    "UNKNOWN is held for the release time": released(UNKNOWN),
    "a verdict comes at least every deadline while active": lambda trace: [
        (t, c) for t, c in trace if not 0 < t - trace[300][0] < 410 * MS
    ],
}


def test_verdicts_of_a_former_recording_are_checked() -> None:
    path = Path(__file__).parents[1] / "recordings" / "former_contact_state.mcap"
    results = check_recording(path, SETTINGS)
    assert {result.verdicts for result in results} == {str(path)}
    assert [result.violations for result in results] == [0] * len(PROPERTIES)
    assert all(result.evaluated == 800 for result in results)


def test_every_property_has_a_mutation() -> None:
    assert list(MUTATIONS) == list(PROPERTIES)


@pytest.mark.parametrize("text", MUTATIONS)
def test_mutated_recording_violates_the_property(text: str, tmp_path: Path) -> None:
    assert violated(TRACE, tmp_path) == set()
    mutated = violated(MUTATIONS[text](TRACE), tmp_path / "mutated")
    assert text in mutated
    assert all("release time" in text and "release time" in other for other in mutated - {text})


@pytest.mark.parametrize(
    ("text", "fields"),
    [
        ("UNKNOWN implies speed 0", {"verdict": UNKNOWN, "allowable_speed": NAN}),
        ("a permissive verdict is not below the speed", {"verdict": WARN, "margin": NAN}),
        ("a permissive verdict is not older than the timeout", {"verdict": OK, "input_age": NAN}),
    ],
)
def test_a_number_that_is_nan_violates_the_property(text: str, fields: dict[str, Any], tmp_path: Path) -> None:
    """From a table: a message with such a number counts as UNKNOWN when it is read."""
    log_times_ns, decisions = zip(*changed(**fields)(TRACE), strict=True)
    with open_writer(tmp_path / "verdicts.parquet", {}, "base", overwrite=False) as writer:
        writer.add("bag", states_of(*decisions, log_time_ns=np.array(log_times_ns)))
    results = check_assessment(tmp_path / "verdicts.parquet", [], SETTINGS)
    assert {result.text for result in results if result.violations} == {text}


def test_a_monitor_that_is_silent_to_the_end_of_the_recording_is_found_unless_it_was_ended(tmp_path: Path) -> None:
    silent = "a verdict comes at least every deadline while active"
    duration_ns = TRACE[-1][0] - TRACE[0][0] + 500 * MS
    assert violated(TRACE, tmp_path, duration_ns) == {silent}
    last_ns, last = TRACE[-1]
    ended = decision_on(
        unknown_contact("tool", "the node shuts down"), stamp_ns=last.stamp_ns, contact_normal="", watchdog=True
    )
    assert violated([*TRACE, (last_ns + MS, ended)], tmp_path / "ended", duration_ns) == set()


SPANS = st.lists(st.tuples(st.sampled_from(Verdict), st.integers(1, 40)), min_size=1, max_size=15)


@given(spans=SPANS, period_ms=st.sampled_from([1, 8, 100]), cut=st.integers(1, 20))
@settings(max_examples=20)
def test_debounced_verdicts_have_all_properties_and_those_held_too_shortly_do_not(
    spans: list[tuple[Verdict, int]], period_ms: int, cut: int
) -> None:
    with TemporaryDirectory() as folder:
        trace = debounced(spans, period_ms * MS)
        assert violated(trace, Path(folder)) == set()
        shorter = debounced(spans, period_ms * MS, 0.2 - 0.005 * cut)
        shown = [state.verdict for _, state in trace]
        if shown != [state.verdict for _, state in shorter]:
            assert violated(shorter, Path(folder) / "shorter")


def test_more_verdicts_than_a_chunk_are_evaluated_without_gaps(tmp_path: Path) -> None:
    """360 runs of equal verdicts: each VIOLATION is held, but for one."""
    trace = debounced([(OK, 1), (VIOLATION, 1), (OK, 3)] * 120, 100 * MS)
    assert violated(trace, tmp_path) == set()
    for index in (412, 417, 422):
        assert trace[index][1].reason.startswith("held after")
        mutated = [(t, decision(OK, "", c.stamp_ns) if i == index else c) for i, (t, c) in enumerate(trace)]
        assert violated(mutated, tmp_path / f"{index}") == {
            "a VIOLATION is not followed by OK or WARN within the release time",
            "WARN is held for the release time",
        }

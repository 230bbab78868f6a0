# SPDX-License-Identifier: Apache-2.0
"""The speed scaling factor: bounds, fall, rise, and convergence of the closed loop without oscillation."""

import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scara_effmass.cell.speed_scaling import SpeedScaler
from scara_effmass.safety import unknown_contact
from scara_effmass.values import ContactAssessment, Decision, Verdict
from test.decisions import decision_on

TIMEOUT_NS = 200_000_000
START_NS = 10**15
PERIOD_NS = 4_000_000


def contact(
    speed: float, allowable_speed: float, name: str = "tool", verdict: Verdict = Verdict.OK, *, at_rest: bool = False
) -> ContactAssessment:
    known = unknown_contact(name, "")._replace(verdict=verdict, worst_direction_used=at_rest)
    return known._replace(speed=speed, allowable_speed=allowable_speed)


def state(speed: float, allowable_speed: float, *, at_rest: bool = False) -> Decision:
    return decision_on(contact(speed, allowable_speed, at_rest=at_rest))


def released(rise_rate: float = 1.0, latency_ns: int = 0) -> tuple[SpeedScaler, int]:
    """Return a scaler whose factor has risen to 1, and the time."""
    scaler = SpeedScaler(TIMEOUT_NS, START_NS)
    scaler.rise_rate, scaler.latency_ns = 100.0, latency_ns
    now_ns = START_NS
    for _ in range(100):
        now_ns += PERIOD_NS
        scaler.factor(now_ns)
        scaler.take(state(0.0, 1.0, at_rest=True), now_ns)
    scaler.rise_rate = rise_rate
    return scaler, now_ns


def test_factor_is_0_before_the_first_state() -> None:
    scaler = SpeedScaler(TIMEOUT_NS, START_NS)
    assert [scaler.factor(START_NS + step * TIMEOUT_NS) for step in range(5)] == [0.0] * 5
    assert scaler.reason == "no contact states yet"


any_number = st.floats() | st.sampled_from([0.0, -0.0, 5e-324, 1e-3, 0.5, 1.0, 1e308])
contacts = st.builds(
    contact, any_number, any_number, st.sampled_from(["tool", "elbow"]), st.sampled_from(Verdict), at_rest=st.booleans()
)
decisions = st.lists(contacts, min_size=1, max_size=3).map(lambda contacts: decision_on(*contacts))
steps = st.lists(
    st.tuples(st.integers(0, 3 * TIMEOUT_NS), st.none() | decisions, st.integers(-TIMEOUT_NS, 2 * TIMEOUT_NS)),
    max_size=40,
)


@given(steps, st.floats(1e-3, 100.0), st.integers(0, TIMEOUT_NS), st.floats(0.01, 1.0))
def test_factor_is_a_number_from_0_to_1_that_rises_slowly(
    steps: list[tuple[int, Decision | None, int]], rise_rate: float, latency_ns: int, speed_ratio: float
) -> None:
    scaler, now_ns, last, last_ns = SpeedScaler(TIMEOUT_NS, START_NS), START_NS, 0.0, START_NS
    scaler.rise_rate, scaler.latency_ns, scaler.speed_ratio = rise_rate, latency_ns, speed_ratio
    for wait_ns, decision, age_ns in steps:
        now_ns += wait_ns
        falls = decision is not None and scaler.take(decision, now_ns, age_ns)
        factor = scaler.factor(now_ns)
        assert 0.0 <= factor <= 1.0
        assert factor <= last + rise_rate * (now_ns - last_ns) / 1e9 + 1e-12
        assert not falls or factor < last
        if decision is not None and (
            age_ns > TIMEOUT_NS
            or any(
                one.verdict is Verdict.UNKNOWN
                or not (math.isfinite(one.speed) and 0.0 < one.allowable_speed < math.inf)
                for one in decision.contacts
            )
        ):
            assert factor == 0.0
            assert scaler.reason
        last, last_ns = factor, now_ns


@given(st.floats(0.01, 5.0), st.floats(0.01, 5.0), st.floats(0.1, 1.0))
def test_factor_falls_at_once_to_what_is_allowed(speed: float, allowable_speed: float, speed_ratio: float) -> None:
    scaler, now_ns = released()
    scaler.speed_ratio = speed_ratio
    falls = scaler.take(state(speed, allowable_speed), now_ns)
    expected = min(1.0, speed_ratio * allowable_speed / speed)
    assert math.isclose(scaler.factor(now_ns), expected, rel_tol=1e-12)
    assert falls == (expected < 1.0)


def test_tightest_contact_point_decides() -> None:
    scaler, now_ns = released(rise_rate=100.0)
    for _ in range(200):
        now_ns += PERIOD_NS
        speed = scaler.factor(now_ns)
        scaler.take(decision_on(contact(speed, 0.3, "elbow"), contact(speed, 0.6)), now_ns + 1)
    assert math.isclose(scaler.factor(now_ns + 2), 0.3, rel_tol=1e-9)


def test_silence_stops_until_the_next_decision() -> None:
    scaler, now_ns = released(rise_rate=100.0)
    assert scaler.factor(now_ns + 2 * TIMEOUT_NS) == 1.0
    now_ns += 2 * TIMEOUT_NS + 1_000_000
    for wait_ns in (0, TIMEOUT_NS):
        assert scaler.factor(now_ns + wait_ns) == 0.0
        assert scaler.reason == "no contact states for 0.401 s"
    now_ns += 2 * TIMEOUT_NS
    scaler.take(state(0.0, 0.3), now_ns)
    assert scaler.factor(now_ns + PERIOD_NS) > 0.0
    assert scaler.reason == ""


def test_after_a_stop_the_next_decision_releases_the_factor() -> None:
    scaler, now_ns = released(rise_rate=100.0)
    scaler.stop("deadline of contact_states missed")
    assert scaler.factor(now_ns + PERIOD_NS) == 0.0
    assert scaler.reason == "deadline of contact_states missed"
    scaler.take(state(0.0, 0.3), now_ns + 2 * PERIOD_NS)
    assert scaler.factor(now_ns + 3 * PERIOD_NS) > 0.0


@given(
    st.permutations(
        [
            contact(0.0, 0.0, "tool", Verdict.UNKNOWN),
            contact(0.0, 1.0, "elbow", at_rest=True),
            contact(0.3, 1.0, "rim"),
        ]
    )
)
def test_one_contact_point_that_allows_nothing_stops_until_it_allows_something(
    contacts: list[ContactAssessment],
) -> None:
    scaler, now_ns = SpeedScaler(TIMEOUT_NS, START_NS), START_NS
    scaler.rise_rate = 100.0
    for _ in range(100):
        now_ns += PERIOD_NS
        scaler.take(decision_on(*contacts), now_ns)
        assert scaler.factor(now_ns + 1) == 0.0
        assert scaler.reason == "tool: no speed is allowed"
    rest = [contact(0.0, 1.0, one.contact_point, at_rest=True) for one in contacts]
    scaler.take(decision_on(*rest), now_ns)
    assert scaler.factor(now_ns + PERIOD_NS) > 0.0
    assert scaler.reason == ""


@pytest.mark.parametrize(
    ("age_ns", "reason"),
    [
        (TIMEOUT_NS + 1_000_000, "0.201 s old"),
        (-TIMEOUT_NS - 1_000_000, "stamped 0.201 s after the time of this node's clock"),
    ],
)
def test_state_of_another_time_stops(age_ns: int, reason: str) -> None:
    scaler, now_ns = released()
    scaler.take(state(0.1, 1.0), now_ns, age_ns)
    assert scaler.factor(now_ns) == 0.0
    assert scaler.reason == f"the joint state is {reason}"


@pytest.mark.parametrize("fields", [{"allowable_speed": 0.0}, {"speed_scaling": 0.0}, {"watchdog": True}])
def test_message_that_allows_nothing_stops(fields: dict[str, Any]) -> None:
    scaler, now_ns = released()
    scaler.take(state(0.1, 1.0)._replace(**fields), now_ns)
    assert scaler.factor(now_ns) == 0.0
    assert scaler.reason == "no speed is allowed"


def test_state_counts_with_the_factor_in_force_when_it_was_measured() -> None:
    scaler, now_ns = released(rise_rate=1000.0)
    scaler.take(state(1.0, 0.5), now_ns)
    assert scaler.factor(now_ns) == 0.5
    now_ns += PERIOD_NS
    scaler.take(state(0.5, 0.4), now_ns, PERIOD_NS + 1)  # before the factor fell
    assert math.isclose(scaler.factor(now_ns), 0.8, rel_tol=1e-12)
    now_ns += PERIOD_NS
    scaler.take(state(0.5, 0.3), now_ns, PERIOD_NS)  # from when on the factor of 0.8 was in force
    assert math.isclose(scaler.factor(now_ns), 0.48, rel_tol=1e-12)


def test_state_without_age_counts_with_the_factor_sent_at_that_time() -> None:
    scaler, now_ns = released(rise_rate=1e-9)
    scaler.take(state(1.0, 0.5), now_ns)
    now_ns += PERIOD_NS
    assert scaler.factor(now_ns) == 0.5
    scaler.take(state(0.5, 0.4), now_ns, 0)
    assert math.isclose(scaler.factor(now_ns), 0.4, rel_tol=1e-12)


@pytest.mark.parametrize("age_ns", [0, -15 * PERIOD_NS])
def test_state_whose_stamp_leads_the_clock_counts_as_measured_now(age_ns: int) -> None:
    """Not later, when the present factor alone will be in force: it would rise above what is allowed."""
    latency_ns = 10 * PERIOD_NS
    scaler, now_ns = released(rise_rate=1e6, latency_ns=latency_ns)
    scaler.take(state(1.0, 0.2), now_ns)
    assert math.isclose(scaler.factor(now_ns), 0.2)
    now_ns += 2 * latency_ns
    scaler.take(state(0.2, 0.4), now_ns)
    assert math.isclose(scaler.factor(now_ns), 0.4)
    now_ns += PERIOD_NS
    scaler.take(state(0.2, 0.3), now_ns, age_ns)  # at 0.2 or at 0.4
    assert math.isclose(scaler.factor(now_ns), 0.4)


def test_noise_of_a_robot_at_rest_does_not_keep_the_factor_at_0() -> None:
    scaler, now_ns = released()
    scaler.stop("deadline of contact_states missed")
    scaler.factor(now_ns)
    scaler.take(state(1e-4, 0.3, at_rest=True), now_ns + PERIOD_NS)
    assert scaler.factor(now_ns + 2 * PERIOD_NS) > 0.0


def test_factors_are_kept_for_the_oldest_state_that_counts() -> None:
    """It was measured a timeout ago, with the factor of a latency before that."""
    latency_ns = 10 * PERIOD_NS
    scaler, start_ns = released(rise_rate=1e-9, latency_ns=latency_ns)
    now_ns = start_ns + latency_ns
    scaler.factor(now_ns)
    scaler.take(state(1.0, 0.5), now_ns)
    while now_ns < start_ns + latency_ns + TIMEOUT_NS:
        assert math.isclose(scaler.factor(now_ns), 0.5)
        now_ns += PERIOD_NS
    scaler.take(state(1.0, 0.4), now_ns, TIMEOUT_NS)
    assert math.isclose(scaler.factor(now_ns), 0.4, rel_tol=1e-12)


@settings(max_examples=20)
@given(st.floats(0.02, 1.0), st.floats(0.1, 1.0), st.integers(0, 5), st.integers(0, 5), st.floats(10.0, 100.0))
def test_closed_loop_reaches_a_constant_limit_monotonically(
    limit: float, programmed_speed: float, delay: int, slack: int, rise_rate: float
) -> None:
    """Whatever the true delay of the loop, up to the stated latency: no overshoot, no undershoot, no limit cycle."""
    latency_ns = (delay + slack + 1) * PERIOD_NS
    scaler, now_ns = released(rise_rate, latency_ns)
    sent = [1.0] * (delay + 1)
    settled_after = 3 * (delay + slack + 2) + math.ceil(1e9 / PERIOD_NS / rise_rate) + 1
    for _ in range(settled_after):
        now_ns += PERIOD_NS
        speed = sent[-1 - delay] * programmed_speed
        scaler.take(state(speed, limit * programmed_speed, at_rest=speed < 1e-3), now_ns)
        sent.append(scaler.factor(now_ns))
        assert sent[-1] >= limit * (1.0 - 1e-9)
        assert sent[-1] <= sent[-2] or sent[-1] <= limit * (1.0 + 1e-9)
    assert math.isclose(sent[-1], limit, rel_tol=1e-9)
    # From below: released again after a stop, it rises to the limit; from rest, blindly during the latency.
    scaler.stop("test")
    sent.append(scaler.factor(now_ns))
    for _ in range(3 * settled_after):
        now_ns += PERIOD_NS
        speed = sent[-1 - delay] * programmed_speed
        scaler.take(state(speed, limit * programmed_speed, at_rest=speed < 1e-3), now_ns)
        sent.append(scaler.factor(now_ns))
        assert sent[-1] <= max(limit, rise_rate * latency_ns / 1e9) * (1.0 + 1e-9)
        assert sent[-2] * (1.0 - 1e-9) <= sent[-1] or sent[-1] >= limit * (1.0 - 1e-9)
    assert math.isclose(sent[-1], limit, rel_tol=1e-3)


def test_controller_that_does_not_obey_is_named_after_a_second_and_while_it_moves() -> None:
    scaler, now_ns = released()
    for speed, seconds, expected in ((0.3, 0.9, ""), (0.3, 1.0, "the robot moves at 0.30 m/s at a factor of 0")):
        for _ in range(round(seconds * 1e9 / PERIOD_NS)):
            now_ns += PERIOD_NS
            scaler.take(state(speed, 0.0), now_ns)  # a VIOLATION that latches: the factor is 0
            assert scaler.factor(now_ns) == 0.0
        assert scaler.disobedience.startswith(expected)
        assert bool(scaler.disobedience) == bool(expected)
    # Allowed again, but it has never stopped: the factor cannot rise, as the programmed speed is not known.
    scaler.take(state(0.3, 1.0), now_ns + PERIOD_NS)
    assert scaler.factor(now_ns + PERIOD_NS) == 0.0
    assert scaler.reason == ""
    assert scaler.disobedience
    scaler.take(state(0.0, 1.0, at_rest=True), now_ns + 2 * PERIOD_NS)
    assert scaler.disobedience == ""


def test_controller_that_obeys_is_not_doubted_at_a_small_factor() -> None:
    scaler, now_ns = released()
    factor = 1.0
    for _ in range(1000):
        now_ns += PERIOD_NS
        scaler.take(state(2.0 * factor, 0.01), now_ns)
        factor = scaler.factor(now_ns)
        assert scaler.disobedience == ""
    assert 0.0 < factor < 0.01

# SPDX-License-Identifier: Apache-2.0
"""State of a monitor: debounce, latch, first cause, watchdog, jumps of the clock."""

import math
from dataclasses import replace

import numpy as np
import pytest

from scara_effmass.codes import Reason
from scara_effmass.errors import RobotError
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor, unknown_assessments, unknown_contact
from scara_effmass.settings import MonitorSettings, VelocitySource
from scara_effmass.values import Decision, JointState, Verdict

JOINTS = ("joint1", "joint2", "joint3", "joint4")
NOW = 1_700_000_000_000_000_000
MS = 1_000_000
SLOW, FAST = 0.05, 5.0
"""Speeds of joint 1 [rad/s] that are OK and a VIOLATION here."""


def make_monitor(dynamics: RobotDynamics, **settings: object) -> Monitor:
    return Monitor(dynamics, MonitorSettings.model_validate({"release_time": 0.0, **settings}))


def send(
    monitor: Monitor, at_ms: float, speed: float = SLOW, names: tuple[str, ...] = JOINTS, q1: float = 0.3
) -> Decision:
    now = NOW + round(at_ms * MS)
    decision = monitor.assess(
        JointState(now, names, np.array([q1, 1.2, 0.1, 0.0]), np.array([speed, 0.01, 0.001, 0.01])), now
    )
    assert decision is not None
    return decision


def verdict(decision: Decision) -> Verdict:
    return decision.contacts[0].verdict


def reason(decision: Decision) -> str:
    return decision.contacts[0].reason


def test_release_time_counts_on_header_stamps(scara: RobotDynamics) -> None:
    monitor = make_monitor(scara, release_time=0.1)
    assert verdict(send(monitor, 0)) is Verdict.OK
    assert verdict(send(monitor, 10, FAST, q1=0.325)) is Verdict.VIOLATION
    held = send(monitor, 109, q1=0.575)
    assert verdict(held) is Verdict.VIOLATION
    assert reason(held).startswith("held after: ")
    assert held.contacts[0].margin > 0.0
    released = send(monitor, 110, q1=0.575)
    assert (verdict(released), released.contacts[0].reason_code) == (Verdict.WARN, Reason.TURNS)  # it brakes
    assert verdict(send(monitor, 210, q1=0.575)) is Verdict.OK


def test_held_unknown_allows_nothing(scara: RobotDynamics) -> None:
    monitor = make_monitor(scara, release_time=0.1)
    send(monitor, 0)
    send(monitor, 10, names=("joint1",) * 4)
    for at in (20, 60, 119):
        held = send(monitor, at)
        assert verdict(held) is Verdict.UNKNOWN
        assert reason(held) == "held after: joint joint1 is named twice"
        assert (held.allowable_speed, held.speed_scaling) == (0.0, 0.0)
        assert held.contacts[0].allowable_speed == 0.0
        assert held.contacts[0].margin == -held.contacts[0].speed
    assert verdict(send(monitor, 120)) is Verdict.OK


def test_gap_between_stamps_gives_held_unknown(scara: RobotDynamics) -> None:
    monitor = make_monitor(scara, release_time=0.1)
    send(monitor, 0)
    after = send(monitor, 201)
    assert (verdict(after), reason(after)) == (Verdict.UNKNOWN, "held after: no valid joint state for 0.201 s")
    assert verdict(send(monitor, 301)) is Verdict.OK


def test_gap_of_exactly_the_timeout_holds_nothing(scara: RobotDynamics) -> None:
    monitor = make_monitor(scara, release_time=0.1)
    send(monitor, 0)
    assert verdict(send(monitor, 200)) is Verdict.OK


@pytest.mark.parametrize("stamp_ns", [0, -5])
def test_unusable_stamp_gives_the_time_of_the_clock_and_no_age(scara: RobotDynamics, stamp_ns: int) -> None:
    state = JointState(stamp_ns, JOINTS, np.zeros(4), np.full(4, 0.01))
    decision = make_monitor(scara).assess(state, NOW)
    assert decision is not None
    assert (decision.stamp_ns, decision.input_age) == (NOW, 0.0)


def test_unknown_contact_states_no_number() -> None:
    contact = unknown_contact("tool", "no data", Reason.NO_ROBOT)
    assert (contact.contact_point, contact.reason, contact.reason_code) == ("tool", "no data", Reason.NO_ROBOT)
    assert contact.position == contact.position_in_link == contact.direction == (0.0, 0.0, 0.0)
    assert math.isnan(contact.lumped_mass)
    assert math.isnan(contact.full_mass)
    assert contact.lumped_mobility == contact.full_mobility == (0.0,) * 6
    assert contact.test_direction == (0.0, 0.0, 0.0)
    names = set(contact._fields) - {
        *("contact_point", "reason", "reason_code", "direction", "lumped_mass", "full_mass"),
        *("lumped_mobility", "full_mobility", "test_direction", "position", "position_in_link"),
    }
    assert {name for name in names if getattr(contact, name)} == set()


def test_remembered_reasons_keep_their_words_under_other_settings(scara: RobotDynamics) -> None:
    """A code means another body region there, and a kept one must not name it."""
    monitor = make_monitor(scara, latch=True, release_time=1.0, body_regions=["chest"])
    assert "limit of chest" in reason(send(monitor, 0, FAST))
    monitor.apply(MonitorSettings(latch=True, release_time=1.0, body_regions=("neck",)))
    assert monitor.first_cause is not None
    assert "limit of chest" in monitor.first_cause.reason
    assert reason(send(monitor, 2)).startswith("latched until reset: tool: ")
    assert "limit of chest" in reason(send(monitor, 4))
    monitor.apply(MonitorSettings(release_time=1.0, body_regions=("neck",)))
    held = send(monitor, 6)
    assert held.contacts[0].reason_code is Reason.TOO_FAST
    assert reason(held).startswith("held after: ")
    assert "limit of chest" in reason(held)
    assert "limit of neck" in reason(send(monitor, 8, FAST))


def test_command_number_that_does_not_increase_gives_unknown_for_the_timeout(scara: RobotDynamics) -> None:
    monitor = make_monitor(scara)
    verdicts = []
    for at_ms, number in ((0, 7), (1, 9), (2, 9), (3, 10), (50, 8), (51, 9), (250, 10), (251, 11)):
        command = JointState(NOW + at_ms * MS, JOINTS, np.zeros(4), np.empty(0))
        monitor.take_command(command, command.stamp_ns, number)
        decision = send(monitor, at_ms)
        verdicts.append(verdict(decision))
        if at_ms == 50:
            assert reason(decision).endswith("or a restarted one: command number 8 follows number 10")
    assert verdicts == [Verdict.OK] * 2 + [Verdict.UNKNOWN] * 5 + [Verdict.OK]


def test_clock_that_goes_back_does_not_end_the_doubt_of_the_commands(scara: RobotDynamics) -> None:
    monitor = make_monitor(scara)
    reasons = []
    for at_ms, number in ((5000, 9), (5001, 8), (0, 9), (202, 10)):
        if at_ms == 0:
            monitor.clear_history()
        command = JointState(NOW + at_ms * MS, JOINTS, np.zeros(4), np.empty(0))
        monitor.take_command(command, command.stamp_ns, number)
        reasons.append("restarted" in reason(send(monitor, at_ms)))
    assert reasons == [False, True, True, False]


class TestFirstCause:
    def test_first_cause_stays_until_reset(self, scara: RobotDynamics) -> None:
        monitor = make_monitor(scara)
        causes = []
        for at, speed, names in ((0, SLOW, JOINTS), (1, FAST, JOINTS), (2, SLOW, ("joint1",) * 4)):
            send(monitor, at, speed, names)
            causes.append(monitor.first_cause)
        before, cause, later = causes
        assert before is None
        assert cause is not None
        assert (cause.stamp_ns, cause.contact_point, cause.verdict) == (NOW + MS, "tool", Verdict.VIOLATION)
        assert "is above the" in cause.reason
        assert later == cause
        monitor.reset()
        assert monitor.first_cause is None

    def test_first_joint_state_can_be_the_first_cause(self, scara: RobotDynamics) -> None:
        monitor = make_monitor(scara)
        send(monitor, 0, FAST)
        assert monitor.first_cause is not None
        assert monitor.first_cause.stamp_ns == NOW

    def test_unknown_before_the_first_valid_input_is_no_cause(self, scara: RobotDynamics) -> None:
        monitor = make_monitor(scara, latch=True)
        monitor.watchdog_decision(10**9)
        send(monitor, 0, names=("joint1",) * 4)
        assert monitor.first_cause is None
        assert verdict(send(monitor, 1)) is Verdict.OK

    def test_monitor_of_a_changed_robot_takes_over_the_first_cause(self, scara: RobotDynamics) -> None:
        before, after = make_monitor(scara), make_monitor(scara, latch=True)
        send(before, 0, FAST)
        cause = after.first_cause = before.first_cause
        assert cause is not None
        assert after.first_cause == cause
        latched = send(after, 1)
        assert (verdict(latched), reason(latched)) == (Verdict.VIOLATION, f"latched until reset: tool: {cause.reason}")


class TestLatch:
    def test_holds_a_violation_until_reset(self, scara: RobotDynamics) -> None:
        monitor = make_monitor(scara, latch=True)
        assert verdict(send(monitor, 0)) is Verdict.OK
        send(monitor, 1, FAST)
        for at in (2, 1000, 100_000):
            latched = send(monitor, at)
            assert verdict(latched) is Verdict.VIOLATION
            assert reason(latched).startswith("latched until reset: tool: 2.")
            assert (latched.allowable_speed, latched.speed_scaling) == (0.0, 0.0)
        again = send(monitor, 100_000.5, FAST).contacts[0]
        assert again.reason.startswith("latched until reset: ")
        assert again.allowable_speed == 0.0
        monitor.reset()
        assert verdict(send(monitor, 100_001)) is Verdict.OK

    def test_holds_an_unknown_and_allows_nothing(self, scara: RobotDynamics) -> None:
        monitor = make_monitor(scara, latch=True)
        send(monitor, 0)
        monitor.watchdog_decision(10**9)
        latched = send(monitor, 1)
        assert verdict(latched) is Verdict.UNKNOWN
        assert reason(latched) == "latched until reset: tool: no valid joint state for 1.00 s"
        assert latched.contacts[0].allowable_speed == 0.0
        assert latched.contacts[0].margin == -latched.contacts[0].speed

    def test_worse_verdict_than_the_latched_one_shows(self, scara: RobotDynamics) -> None:
        monitor = make_monitor(scara, latch=True)
        send(monitor, 0, FAST)
        worse = send(monitor, 1, names=("joint1",) * 4)
        assert (verdict(worse), reason(worse)) == (Verdict.UNKNOWN, "joint joint1 is named twice")

    def test_latch_switched_on_later_holds_the_first_cause(self, scara: RobotDynamics) -> None:
        monitor = make_monitor(scara)
        send(monitor, 0)
        send(monitor, 1, FAST)
        assert verdict(send(monitor, 2)) is Verdict.OK
        monitor.apply(MonitorSettings(release_time=0.0, latch=True))
        assert verdict(send(monitor, 3)) is Verdict.VIOLATION

    def test_reset_clears_held_verdicts(self, scara: RobotDynamics) -> None:
        monitor = make_monitor(scara, latch=True, release_time=10.0)
        send(monitor, 0)
        send(monitor, 1, FAST)
        monitor.reset()
        assert verdict(send(monitor, 2)) is Verdict.OK


class TestWatchdogDecision:
    def test_watchdog_decision_is_unknown_and_allows_nothing(self, scara: RobotDynamics) -> None:
        monitor = make_monitor(scara)
        for expected in ("no joint state yet", "no valid joint state for 0.25 s"):
            silent = monitor.watchdog_decision(250 * MS).decision(0)
            assert (verdict(silent), reason(silent), silent.input_age) == (Verdict.UNKNOWN, expected, 0.25)
            assert (silent.allowable_speed, silent.speed_scaling) == (0.0, 0.0)
            send(monitor, 0)
        assert silent.stamp_ns == NOW

    def test_watchdog_decision_changes_no_later_verdict(self, scara: RobotDynamics) -> None:
        undisturbed, monitor = (make_monitor(scara, release_time=0.1) for _ in range(2))
        for at in range(0, 2000, 150):
            monitor.watchdog_decision(10**9)
            assert repr(send(monitor, at)) == repr(send(undisturbed, at))


def test_earlier_stamps_are_valid_after_the_clock_jumps_back(scara: RobotDynamics) -> None:
    monitor = make_monitor(scara, release_time=0.1)
    send(monitor, 5000, FAST)
    assert reason(send(monitor, 4990)).startswith("the header stamp goes back")
    monitor.clear_history()
    assert verdict(send(monitor, 0)) is Verdict.OK


def test_monitor_recovers_from_system_time_set_back(scara: RobotDynamics) -> None:
    """System time has no jump callback: what was the future then must not block the stamps of now for ever."""
    monitor = make_monitor(scara)
    send(monitor, 3_600_000)
    verdicts = [verdict(send(monitor, at)) for at in range(10)]
    assert verdicts[-1] is Verdict.OK


@pytest.mark.parametrize(("beyond_ns", "expected"), [(0, Verdict.UNKNOWN), (1, Verdict.OK)])
def test_clock_counts_as_set_back_beyond_the_future_tolerance(
    scara: RobotDynamics, beyond_ns: int, expected: Verdict
) -> None:
    """Within it the stamps must still increase."""
    monitor = make_monitor(scara)
    send(monitor, 0)
    back_ns = round(monitor.settings.future_tolerance * 1e9) + beyond_ns
    assert verdict(send(monitor, -back_ns / MS)) is expected


def test_robot_that_is_not_in_si_units_has_no_monitor(scara: RobotDynamics) -> None:
    robot = replace(scara.robot, units_reason="the links must be in metres, not in millimetres")
    with pytest.raises(RobotError, match=r"omron_i4_550l.yaml: the links must be in metres, not in millimetres"):
        Monitor(RobotDynamics(robot), MonitorSettings())


def test_payload_that_cannot_be_is_refused_before_anything_changes(scara: RobotDynamics) -> None:
    monitor = make_monitor(scara)
    changed = monitor.settings.model_copy(
        update={"payload_mass": 1.0, "payload_inertia": (1.0, 1.0, 5.0, 0.0, 0.0, 0.0)}
    )
    for take in (monitor.check, monitor.apply):
        with pytest.raises(RobotError, match="payload_inertia"):
            take(changed)
    assert monitor.settings.payload_mass == 0.0
    assert verdict(send(monitor, 0)) is Verdict.OK


def test_changed_velocity_source_applies(scara: RobotDynamics) -> None:
    monitor = make_monitor(scara)
    monitor.apply(monitor.settings.model_copy(update={"velocity_source": VelocitySource.FROM_POSITIONS}))
    verdicts = [verdict(send(monitor, at, 50.0, q1=0.3 + 5e-5 * at)) for at in range(0, 200, 10)]
    assert verdicts[-5:] == [Verdict.OK] * 5


def test_verdicts_are_counted(scara: RobotDynamics) -> None:
    monitor = make_monitor(scara)
    for at, speed in enumerate((SLOW, FAST, SLOW, FAST, FAST)):
        send(monitor, at, speed)
    send(monitor, 9, names=("joint1",) * 4)
    monitor.watchdog_decision(10**9)
    counted = {verdict.name: count for verdict, count in monitor.verdicts.items()}
    assert counted == {"UNKNOWN": 2, "OK": 2, "WARN": 0, "VIOLATION": 3}
    assert monitor.rejected == 1


def test_undecodable_joint_state_has_no_stamp_and_no_age(scara: RobotDynamics) -> None:
    monitor = make_monitor(scara)
    decision = monitor.settle(monitor.refuse(Reason.UNDECODABLE, "not CDR", 0)).decision(0)
    assert (verdict(decision), reason(decision), monitor.rejected) == (Verdict.UNKNOWN, "not CDR", 1)
    assert (decision.stamp_ns, decision.input_age) == (0, 0.0)


@pytest.mark.parametrize("text", ["no robot_description yet", "robot_description: not XML"])
def test_no_robot_allows_nothing(text: str) -> None:
    decision = unknown_assessments(Reason.NO_ROBOT, text).decision(0)
    assert (verdict(decision), reason(decision), decision.contacts[0].contact_point) == (Verdict.UNKNOWN, text, "")
    assert decision.reason_code is Reason.NO_ROBOT
    assert (decision.allowable_speed, decision.speed_scaling) == (0.0, 0.0)
    assert (decision.watchdog, decision.input_age) == (False, 0.0)
    assert unknown_assessments(Reason.NO_ROBOT, text, watchdog=True).decision(0).watchdog


def test_only_decisions_of_the_watchdog_are_marked(scara: RobotDynamics) -> None:
    monitor = make_monitor(scara)
    assert not send(monitor, 0).watchdog
    assert monitor.watchdog_decision(10**9).decision(0).watchdog

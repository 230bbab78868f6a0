# SPDX-License-Identifier: Apache-2.0
"""Admission: each kind of invalid joint state gives UNKNOWN with its reason."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from scara_effmass.kernel.admission import WINDOW_S
from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import FloatArray, JointState, Verdict

if TYPE_CHECKING:
    from collections.abc import Sequence

    from scara_effmass.values import Decision

JOINTS = ("joint1", "joint2", "joint3", "joint4")
OTHERS = ("gripper", "rail", "wheel")
REPOSITORY = Path(__file__).resolve().parents[2]
Q = (0.3, 1.2, 0.1, -0.4)
QD = (0.1, -0.2, 0.05, 0.3)
NOW = 1_700_000_000_000_000_000
MS = 1_000_000
NAN, INF = math.nan, math.inf


def state(
    stamp_ns: int = NOW,
    names: Sequence[str] = JOINTS,
    position: Sequence[float] | FloatArray = Q,
    velocity: Sequence[float] | FloatArray = QD,
) -> JointState:
    return JointState(stamp_ns, tuple(names), np.array(position, float), np.array(velocity, float))


def make_monitor(dynamics: RobotDynamics, **settings: object) -> Monitor:
    return Monitor(dynamics, MonitorSettings.model_validate({"release_time": 0.0, **settings}))


class Motion(NamedTuple):
    """Position and velocity of the joints."""

    q: FloatArray
    qd: FloatArray


def admitted(monitor: Monitor, joint_state: JointState, now_ns: int) -> FloatArray | str:
    """Return the tolerances of the velocities (n,) of an admitted joint state, or why it is refused."""
    stamps, clocks = np.array([joint_state.stamp_ns]), np.array([now_ns])
    pending = monitor.admit(joint_state.names, stamps, clocks, joint_state.position[None], joint_state.velocity[None])
    assert pending is not None
    monitor.compute(pending)
    assessments = monitor.settle(pending)
    return pending.motions[0, 2] if assessments.states["is_admitted"][0] else assessments.reason(0, 0)


@dataclass
class Feed:
    """A sender of joint states, one millisecond apart, to one monitor."""

    monitor: Monitor
    now_ns: int = NOW
    decision: Decision | None = field(default=None, init=False)

    def __call__(self, joint_state: JointState | None = None, step_ns: int = MS) -> tuple[Verdict, str]:
        """Send `joint_state`, or a good one, stamped now; return verdict and reason."""
        self.now_ns += step_ns
        self.decision = self.monitor.assess((joint_state or state())._replace(stamp_ns=self.now_ns), self.now_ns)
        assert self.decision is not None
        (contact,) = self.decision.contacts
        return contact.verdict, contact.reason


@pytest.mark.parametrize(
    ("steps_ms", "lead_ms", "reason"),
    [
        ((), 20, ""),
        ((), 21, "the header stamp is 0.021 s in the future"),
        ((25,), 21, "the header stamp is 0.021 s in the future"),  # one step alone may be a jump
        ((10**9, 25, 25), 45, ""),
        ((10**9, 25, 25), 46, "the header stamp is 0.046 s in the future"),
        ((100, 100), 120, ""),
        ((100, 100, *[1] * 8), 120, ""),
        ((100, 100, *[1] * 9), 22, "the header stamp is 0.022 s in the future"),  # steps of the past
        (
            (150, 150),
            121,
            "the header stamp is 0.121 s in the future: /clock moves in steps of 0.150 s, above half of timeout",
        ),
    ],
)
def test_stamp_may_lead_a_simulated_clock_by_its_step_up_to_half_the_timeout(
    scara: RobotDynamics, steps_ms: tuple[int, ...], lead_ms: int, reason: str
) -> None:
    monitor = make_monitor(scara)
    for step_ms in steps_ms:
        monitor.take_clock_step(step_ms * MS)
    monitor.apply(monitor.settings)  # forgets no step
    decision = monitor.assess(state(NOW + lead_ms * MS), NOW)
    assert decision is not None
    assert {contact.reason for contact in decision.contacts} == {reason}


BAD = {
    "no names": (state(names=(), position=(), velocity=()), "the joint state has no names"),
    "no names, but numbers": (state(names=()), "the joint state has no names"),
    "an empty name": (state(names=("joint1", "", "joint3", "joint4")), "name 1 of the joint state is empty"),
    "only empty names": (state(names=("", "", "", "")), "name 0 of the joint state is empty"),
    "a name twice": (state(names=("joint1", "joint2", "joint2", "joint4")), "joint joint2 is named twice"),
    "a foreign name twice": (
        state(names=(*JOINTS, "x", "x"), position=(*Q, 0.0, 0.0), velocity=(*QD, 0.0, 0.0)),
        "joint x is named twice",
    ),
    "a missing joint": (state(names=JOINTS[:3], position=Q[:3], velocity=QD[:3]), "joint joint4 is missing"),
    "too few positions": (state(position=Q[:3]), "3 positions for 4 names"),
    "too many positions": (state(position=(*Q, 0.0)), "5 positions for 4 names"),
    "no position": (state(position=()), "0 positions for 4 names"),
    "too few velocities": (state(velocity=QD[:1]), "1 velocities for 4 names"),
    "too many velocities": (state(velocity=(*QD, 0.0)), "5 velocities for 4 names"),
    "no velocity": (state(velocity=()), "the velocity is empty"),
    "NaN velocity": (state(velocity=(0.1, NAN, 0.0, 0.0)), "the velocity of joint2 is nan"),
    "infinite velocity": (state(velocity=(0.1, 0.1, -INF, 0.1)), "the velocity of joint3 is -inf"),
    "NaN position": (state(position=(NAN, 0.0, 0.1, 0.0)), "the position of joint1 is nan"),
    "infinite position": (state(position=(0.0, 0.0, 0.1, INF)), "the position of joint4 is inf"),
    "beyond a limit": (state(position=(0.0, 2.7, 0.1, 0.0)), "joint2 at 2.7000 rad lies outside its limits"),
    "below a limit": (state(position=(0.0, 0.0, -0.1, 0.0)), "joint3 at -0.1000 m lies outside its limits"),
    "too fast for a joint": (
        state(velocity=(0.1, 0.1, -4.0, 0.1)),
        "joint3 at -4.0000 m/s exceeds its maximum speed",
    ),
}


@pytest.mark.parametrize(("bad", "reason"), BAD.values(), ids=BAD.keys())
def test_invalid_joint_state_gives_unknown_and_the_next_valid_one_does_not(
    scara: RobotDynamics, bad: JointState, reason: str
) -> None:
    feed = Feed(make_monitor(scara))
    assert feed() == (Verdict.OK, "")
    verdict, why = feed(bad)
    assert verdict is Verdict.UNKNOWN
    assert why.startswith(reason)
    assert feed.decision is not None
    assert (feed.decision.allowable_speed, feed.decision.speed_scaling) == (0.0, 0.0)
    assert feed() == (Verdict.OK, "")
    assert feed.monitor.rejected == 1


def test_old_joint_state_gives_unknown_even_if_it_is_newer_than_the_last(scara: RobotDynamics) -> None:
    monitor = make_monitor(scara)
    for stamp_ns, now_ns, expected in (
        (NOW, NOW, (Verdict.OK, "")),
        (NOW + MS, NOW + 201 * MS, (Verdict.OK, "")),
        (NOW + 2 * MS, NOW + 202 * MS + 1, (Verdict.UNKNOWN, "the joint state is 0.200 s old")),
    ):
        decision = monitor.assess(state(stamp_ns), now_ns)
        assert decision is not None
        assert {(contact.verdict, contact.reason) for contact in decision.contacts} == {expected}


@pytest.mark.parametrize(
    ("stamp_ns", "reason"),
    [
        (0, "the header stamp is zero or negative"),
        (-5, "the header stamp is zero or negative"),
        (NOW, "the header stamp is repeated"),
        (NOW - 50 * MS, "the header stamp goes back by 0.050000 s"),
        (NOW + 32 * MS, "the header stamp is 0.031 s in the future"),
        (NOW + 10**15, "the header stamp is 999999.999 s in the future"),
        (NOW - 200 * MS, "the joint state is 0.201 s old"),
        (1, "the joint state is 1700000000.001 s old"),
    ],
)
def test_invalid_stamp_gives_unknown_and_the_next_valid_one_does_not(
    scara: RobotDynamics, stamp_ns: int, reason: str
) -> None:
    monitor = make_monitor(scara)
    for stamp, now, expected in (
        (NOW, NOW, (Verdict.OK, "")),
        (stamp_ns, NOW + MS, (Verdict.UNKNOWN, reason)),
        (NOW + 2 * MS, NOW + 2 * MS, (Verdict.OK, "")),
    ):
        decision = monitor.assess(state(stamp), now)
        assert decision is not None
        assert [(c.verdict, c.reason) for c in decision.contacts] == [expected]


def test_simulated_time_may_begin_at_zero(scara: RobotDynamics) -> None:
    feed = Feed(make_monitor(scara), now_ns=0)
    assert [feed(state(velocity=(1e-9,) * 4))[0] for _ in range(3)] == [Verdict.OK] * 3


def test_age_exactly_at_the_limit_is_valid(scara: RobotDynamics) -> None:
    for age_ns in (-20 * MS, 0, 200 * MS):
        decision = make_monitor(scara).assess(state(NOW - age_ns), NOW)
        assert decision is not None
        assert decision.contacts[0].verdict is Verdict.OK
        assert decision.input_age == age_ns / 1e9


def test_joint_states_of_other_devices_are_ignored_and_counted(scara: RobotDynamics) -> None:
    monitor = make_monitor(scara)
    gripper = state(names=("left_finger", "right_finger"), position=(0.0, 0.0), velocity=())
    for _ in range(3):
        assert monitor.assess(gripper, NOW) is None
    assert (monitor.ignored, monitor.rejected, monitor.first_cause) == (3, 0, None)
    assert "(3 named none of the robot's joints)" in monitor.watchdog_decision(10**9).reason(0, 0)


def test_forty_thousand_names_are_compared_once_each(scara: RobotDynamics) -> None:
    """A quadratic search would compare 800 million pairs."""
    comparisons = 0

    class Name(str):
        __slots__ = ()
        __hash__ = str.__hash__

        def __eq__(self, other: object) -> bool:
            nonlocal comparisons
            comparisons += 1
            return str.__eq__(self, other)

    names = [Name(f"n{i}") for i in range(40_000)]
    for bad, reason in ((["x", "x"], "joint x is named twice"), (JOINTS[:3], "joint joint4 is missing")):
        flood = [*names, *map(Name, bad)]
        verdict, why = Feed(make_monitor(scara))(state(names=flood, position=(), velocity=()))
        assert (verdict, why) == (Verdict.UNKNOWN, reason)
    assert comparisons < 5 * len(names)


def test_number_that_does_not_increase_gives_unknown(scara: RobotDynamics) -> None:
    """Of a second publisher, or once of a restarted one; other devices on the topic do not count."""
    monitor = make_monitor(scara)
    gripper = state(names=("finger",), position=(0.0,), velocity=())
    results = []
    for i, (joint_state, number) in enumerate(
        (
            (state(), 8),
            (state(), 9),
            (gripper, 3),
            (state(), 12),
            (state(), 12),
            (state(), 1),
            (state(), 2),
            (state(), None),
        )
    ):
        now = NOW + i * MS
        decision = monitor.assess(joint_state._replace(stamp_ns=now), now, number)
        results.append(decision and decision.contacts[0].reason)
    prefix = "a second publisher, or a restarted one: joint state number"
    assert results == ["", "", None, "", f"{prefix} 12 follows number 12", f"{prefix} 1 follows number 12", "", ""]
    monitor.clear_history()
    decision = monitor.assess(state(NOW + 9 * MS), NOW + 9 * MS, 1)
    assert decision is not None
    assert decision.contacts[0].verdict is Verdict.OK


@given(
    order=st.permutations(range(7)),
    position=st.tuples(*[st.floats(-1.0, 1.0)] * 2, st.floats(0.0, 0.4), st.floats(-3.0, 3.0)),
    velocity=st.tuples(*[st.floats(0.01, 1.0)] * 4),
    others=st.tuples(*[st.floats()] * 3),
)
def test_joint_order_and_extra_joints_change_no_bit(
    scara: RobotDynamics,
    order: list[int],
    position: tuple[float, ...],
    velocity: tuple[float, ...],
    others: tuple[float, ...],
) -> None:
    names = (*JOINTS, *OTHERS)
    mixed = state(
        NOW,
        [names[i] for i in order],
        [(*position, *others)[i] for i in order],
        [(*velocity, *others)[i] for i in order],
    )
    plain = state(NOW, JOINTS, position, velocity)
    settings = {"ignored_joints": OTHERS}
    assert repr(make_monitor(scara, **settings).assess(mixed, NOW)) == repr(
        make_monitor(scara, **settings).assess(plain, NOW)
    )


@pytest.mark.parametrize("step_ms", [1, 8])
def test_acceleration_is_that_of_the_velocities(scara: RobotDynamics, step_ms: int) -> None:
    """Within 20 ms of a start it is covered by estimate and error; after 0.2 s it is exact; braking has no error."""
    monitor = make_monitor(scara)
    steps, qdd = 400 // step_ms, 4.0
    seconds = np.arange(1, steps + 1)[:, None] * step_ms * 1e-3
    stamps = NOW + np.arange(1, steps + 1) * step_ms * MS

    def motions(sign: float) -> FloatArray:
        velocity = 2.0 + sign * qdd * np.maximum(0.0, seconds - 0.1) * np.array([1.0, 0.0, 0.0, 0.0])
        velocity[:, 1:] = 0.01
        position = np.array(Q) + np.cumsum(velocity, axis=0) * step_ms * 1e-3 - velocity * step_ms * 5e-4
        position[:, 0] -= 1.0
        monitor.clear_history()
        pending = monitor.admit(tuple(scara.robot.joint_names), stamps, stamps, position, velocity)
        assert pending is not None
        assert pending.records["is_admitted"].all()
        return pending.motions

    faster, braking = motions(1.0), motions(-1.0)
    start = int(np.searchsorted(seconds[:, 0], 0.1 + 0.02))
    assert faster[start:, 3:5, 0].sum(axis=1).min() > 0.9 * qdd
    assert faster[-1, 3:5, 0] == pytest.approx([qdd, 0.0], abs=0.05)
    assert braking[-1, 3, 0] == pytest.approx(-qdd, abs=0.05)
    assert not braking[:, 4, 0].any()
    assert np.abs(faster[:, 3:, 1:]).max() < 1e-9


@pytest.mark.parametrize("source", ["reported", "from_positions"])
@pytest.mark.parametrize("speed", [0.5, -0.5, 0.0])
def test_position_of_a_continuous_joint_wraps(source: str, speed: float) -> None:
    """The driver reports angles within +-pi; at rest at pi, they jump between both."""
    robot = str(REPOSITORY / "test" / "robots" / "kinova.urdf")
    settings = MonitorSettings.model_validate({"robot": robot, "velocity_source": source, "release_time": 0.0})
    model = load_robot(settings=settings)
    assert model.periods[0] == 2.0 * math.pi
    monitor, names = Monitor(RobotDynamics(model), settings), model.joint_names
    q, qd = np.mean([model.model.lowerPositionLimit, model.model.upperPositionLimit], axis=0), np.full(len(names), 1e-9)
    admitted = []
    for i in range(400):
        q[0] = math.remainder(3.0 + 0.01 * speed * i if speed else math.pi + 1e-4 * (-1) ** i, 2.0 * math.pi)
        qd[0] = speed or 1e-9
        stamp = NOW + 10 * MS * i
        assessments = monitor.assess_one(JointState(stamp, names, q.copy(), qd), stamp)
        assert assessments is not None
        admitted.append(bool(assessments.states["is_admitted"][0]))
    assert all(admitted[20:])  # until then, zeros are not confirmed


class TestZeroVelocity:
    """A velocity of exactly zero is valid only for a joint whose position does not change."""

    def test_zero_velocity_while_moving_gives_unknown(self, scara: RobotDynamics) -> None:
        feed = Feed(make_monitor(scara))
        results = [feed(state(position=(0.3 + 0.002 * i, *Q[1:]), velocity=(0.0,) * 4), 4 * MS) for i in range(300)]
        assert {verdict for verdict, _ in results} == {Verdict.UNKNOWN}
        assert any(reason.startswith("the position of joint1 is +") for _, reason in results)

    def test_motion_after_rest_at_zero_velocity_gives_unknown(self, scara: RobotDynamics) -> None:
        feed = Feed(make_monitor(scara))
        for _ in range(200):
            verdict, _ = feed(state(velocity=(0.0,) * 4))
        assert verdict is Verdict.OK
        results = [feed(state(position=(0.3 + 0.001 * i, *Q[1:]), velocity=(0.0,) * 4)) for i in range(1, 60)]
        first_unknown = next(i for i, (verdict, _) in enumerate(results) if verdict is Verdict.UNKNOWN)
        assert first_unknown <= 12  # milliseconds at 1 rad/s: position_tolerance
        assert results[first_unknown][1] == "the position of joint1 is +0.0109 rad off the integral of its velocity"
        assert {verdict for verdict, _ in results[first_unknown:]} == {Verdict.UNKNOWN}

    def test_rest_is_confirmed_within_a_tenth_of_a_second(self, scara: RobotDynamics) -> None:
        feed = Feed(make_monitor(scara))
        verdicts = [feed(state(velocity=(0.0,) * 4))[0] for _ in range(110)]
        assert set(verdicts[:100]) == {Verdict.UNKNOWN}
        assert set(verdicts[100:]) == {Verdict.OK}

    def test_rest_is_confirmed_per_joint(self, scara: RobotDynamics) -> None:
        feed = Feed(make_monitor(scara))
        verdict, reason = feed(state(velocity=(0.1, 0.0, 0.1, 0.1)))
        assert (verdict, reason) == (
            Verdict.UNKNOWN,
            "the velocity of joint2 reads zero, not yet confirmed by its position",
        )

    def test_joint_that_moved_may_stop(self, scara: RobotDynamics) -> None:
        feed = Feed(make_monitor(scara))
        feed()
        feed()
        assert feed(state(velocity=(0.0,) * 4)) == (Verdict.OK, "")

    @pytest.mark.parametrize("speed", [0.06, 0.3, 2.0])
    def test_slow_motion_at_zero_velocity_gives_unknown(self, scara: RobotDynamics, speed: float) -> None:
        feed = Feed(make_monitor(scara))
        feed()
        results = set()
        for i in range(1, 600):
            q = (0.3 + speed * i * 1e-3, 1.2, 0.1, -0.4)
            results.add(feed(state(position=q, velocity=(0.0,) * 4))[1][:28])
        assert "the position of joint1 is +0" in results

    def test_encoder_drift_is_tolerated(self, scara: RobotDynamics) -> None:
        feed = Feed(make_monitor(scara))
        feed()
        for i in range(3000):
            q = (0.3 + 1e-5 * i + 0.0005 * (-1) ** i, 1.2, 0.1, -0.4)
            assert feed(state(position=q, velocity=(0.0,) * 4))[0] is Verdict.OK

    def test_zeros_are_confirmed_by_another_joint_that_moves(self, scara: RobotDynamics) -> None:
        feed = Feed(make_monitor(scara))
        speed = 1.0
        verdicts = [
            feed(state(position=(0.3 + speed * i * 1e-3, *Q[1:]), velocity=(speed, 0.0, 0.0, 0.0)))[0]
            for i in range(100)
        ]
        first_ok = verdicts.index(Verdict.OK)
        assert 10 < first_ok < 30  # milliseconds: joint 1 moved farther than the tolerances explain
        assert set(verdicts[first_ok:]) == {Verdict.OK}

    def test_velocity_of_one_sample_confirms_no_zeros(self, scara: RobotDynamics) -> None:
        """Joint 1 reports a velocity, but its position does not change: a contradiction confirms nothing."""
        feed = Feed(make_monitor(scara))
        verdicts = [feed(state(velocity=(0.5, 0.0, 0.0, 0.0)))[0] for _ in range(300)]
        assert set(verdicts) == {Verdict.UNKNOWN}

    def test_slow_start_and_reversal_of_one_joint_leave_no_doubt_about_its_zeros(self, scara: RobotDynamics) -> None:
        """Joint 4 reports zero below 0.05 rad/s, which is off its position at times; joint 1 moves all the time."""
        feed = Feed(make_monitor(scara))
        reasons = []
        for i in range(20_000):
            t = i / 500.0
            q = np.array([0.9 * np.sin(0.8 * t), 1.2, 0.1, np.sin(0.25 * t) ** 3])
            qd = np.array([0.72 * np.cos(0.8 * t), 0.0, 0.0, 0.75 * np.sin(0.25 * t) ** 2 * np.cos(0.25 * t)])
            reasons.append(feed(state(position=q, velocity=np.where(np.abs(qd) < 0.05, 0.0, qd)), 2 * MS)[1])
        assert any(reason.startswith("the position of joint4") for reason in reasons)
        assert not any("reads zero" in reason for reason in reasons[100:])


Lie = Callable[[Motion], tuple[FloatArray, FloatArray]]
LIES: dict[str, Lie] = {
    "sign": lambda motion: (motion.q, motion.qd * [1.0, -1.0, 1.0, 1.0]),
    "a third too slow": lambda motion: (motion.q, motion.qd * 0.67),
    "half too fast": lambda motion: (motion.q, motion.qd * 1.5),
    "frozen position": lambda motion: (np.array(Q), motion.qd),
    "frozen velocity": lambda motion: (motion.q, np.array(QD)),
    "zero velocity": lambda motion: (motion.q, np.zeros(4)),
    "swapped velocities": lambda motion: (motion.q, motion.qd[[1, 0, 2, 3]]),
    "swapped positions": lambda motion: (motion.q[[1, 0, 2, 3]], motion.qd),
}


def sweep(t: float, lag: float = 0.0) -> Motion:
    """Return position and velocity of a robot that sweeps joints 1 and 2, its velocities late by `lag` [s]."""
    amplitude, rate = np.array([0.8, 0.5, 0.0, 0.4]), np.array([2.0, 3.0, 1.0, 2.5])
    q = np.array(Q) - [0.0, 0.0, 0.0, 0.4] + amplitude * np.sin(rate * t)
    return Motion(q, amplitude * rate * np.cos(rate * (t - lag)) + 1e-9)


class TestVelocityAgainstPosition:
    """The displacement of each joint must equal the integral of its signed velocity."""

    @pytest.mark.parametrize("lie", LIES.values(), ids=LIES.keys())
    def test_contradiction_gives_unknown_and_agreement_ends_it(self, scara: RobotDynamics, lie: Lie) -> None:
        feed = Feed(make_monitor(scara, release_time=0.2))
        for i in range(3000):
            position, velocity = lie(sweep(i / 1e3))
            verdict, _ = feed(state(position=position, velocity=velocity))
            assert verdict is Verdict.UNKNOWN or i < 250
        for i in range(3000, 5000):
            motion = sweep(i / 1e3)
            verdict, _ = feed(state(position=motion.q, velocity=motion.qd))
        assert verdict is not Verdict.UNKNOWN

    def test_positions_that_jump_give_unknown(self, scara: RobotDynamics) -> None:
        """Two publishers at different poses on one topic, or an encoder that leaps."""
        feed = Feed(make_monitor(scara))
        feed()
        for i in range(1, 100):
            verdict, reason = feed(state(position=(0.3 + 0.03 * (i % 2), *Q[1:])))
            assert verdict is Verdict.UNKNOWN or not i % 2
            assert reason.startswith("the position of joint1 is +0.0") or not i % 2
        assert feed.monitor.rejected >= 50

    def test_one_leap_is_forgotten_within_the_window(self, scara: RobotDynamics) -> None:
        feed = Feed(make_monitor(scara))
        for _ in range(110):
            feed(state(velocity=(0.0,) * 4))
        leapt = state(position=(1.5, *Q[1:]), velocity=(0.0,) * 4)
        verdicts = [feed(leapt)[0] for _ in range(500)]
        assert set(verdicts[:250]) == {Verdict.UNKNOWN}
        assert set(verdicts[400:]) == {Verdict.OK}

    @pytest.mark.parametrize("step_ms", [1, 10, 40])
    @pytest.mark.parametrize("lag", [-0.005, 0.0, 0.02, 0.05])
    def test_velocities_may_lag_behind_the_positions(self, scara: RobotDynamics, lag: float, step_ms: int) -> None:
        feed = Feed(make_monitor(scara))
        for i in range(8000 // step_ms):
            motion = sweep(i * step_ms / 1e3, lag)
            _, reason = feed(state(position=motion.q, velocity=motion.qd), step_ms * MS)
            assert "off the integral" not in reason

    def test_larger_lag_than_the_maximum_gives_unknown(self, scara: RobotDynamics) -> None:
        feed = Feed(make_monitor(scara, max_velocity_lag=0.01))
        reasons = []
        for i in range(4000):
            motion = sweep(i / 1e3, 0.06)
            reasons.append(feed(state(position=motion.q, velocity=motion.qd))[1])
        assert any("off the integral" in reason for reason in reasons)

    @given(
        amplitude=st.floats(0.0, 1.0),
        rate=st.floats(0.1, 5.0),
        step_ms=st.integers(1, 50),
        noise=st.floats(0.0, 0.002),
    )
    def test_consistent_motion_is_valid(
        self, scara: RobotDynamics, amplitude: float, rate: float, step_ms: int, noise: float
    ) -> None:
        """Sampled a little late, and with the steps of a coarse encoder."""
        feed = Feed(make_monitor(scara))
        for i in range(100):
            t = i * step_ms / 1e3
            q = amplitude * math.sin(rate * t) + noise * (-1) ** i
            qd = amplitude * rate * math.cos(rate * (t - 0.005)) + 1e-6
            verdict, reason = feed(state(position=(q, *Q[1:]), velocity=(qd, *[1e-6] * 3)), step_ms * MS)
            assert "off the integral" not in reason
            assert verdict is not Verdict.UNKNOWN

    @pytest.mark.parametrize(("factor", "passes"), [(0.98, True), (1.05, False)])
    def test_velocity_error_up_to_the_stated_tolerance_passes(
        self, scara: RobotDynamics, factor: float, *, passes: bool
    ) -> None:
        """A constant drift of joint1 at a velocity that reads zero."""
        monitor, tolerance, results = make_monitor(scara), 0.01 / WINDOW_S, []
        for i in range(5000):
            now = NOW + i * MS
            motion = state(now, position=(Q[0] + factor * tolerance * i / 1e3, *Q[1:]), velocity=(0.0,) * 4)
            results.append(admitted(monitor, motion, now))
        last = results[-1]
        assert isinstance(last, str) != passes
        if not isinstance(last, str):
            recent = factor * 0.01 / 0.1
            expected = [recent, tolerance, 0.25 * tolerance, tolerance]
            assert last.tolist() == pytest.approx(expected, rel=1e-3)

    @staticmethod
    def tolerances(scara: RobotDynamics, motion_at: Callable[[int], Motion], milliseconds: int) -> FloatArray:
        """Return the velocity tolerance (m,) of joint1 at each millisecond, NaN where the joint state is refused."""
        monitor, results = make_monitor(scara), []
        for i in range(milliseconds):
            now = NOW + i * MS
            result = admitted(monitor, state(now, position=motion_at(i).q, velocity=motion_at(i).qd), now)
            results.append(NAN if isinstance(result, str) else result[0])
        return np.array(results)

    def test_error_at_the_start_of_a_motion_is_added_before_it_is_found(self, scara: RobotDynamics) -> None:
        """Until the lag is known, a velocity that is too small looks like one that lags."""
        speed, reported = 0.8, 0.5

        def motion_at(i: int) -> Motion:
            t = max(i / 1e3 - 0.2, 0.0)
            return Motion(np.array((Q[0] + speed * t, *Q[1:])), np.array((reported * (t > 0.0), 0.0, 0.0, 0.0)))

        tolerances = self.tolerances(scara, motion_at, 700)
        assert tolerances[150] < 0.02
        found = 320 + int(np.flatnonzero(np.isnan(tolerances[320:]))[0])
        assert found > 340
        assert min(tolerances[320:found]) > speed - reported

    def test_lag_is_added_until_it_is_known(self, scara: RobotDynamics) -> None:
        tolerances = self.tolerances(scara, lambda i: sweep(i / 1e3, 0.05), 10_000)
        assert np.nanmax(tolerances[:500]) > 0.2
        assert np.nanmax(tolerances[8000:]) < 0.15

    def test_lag_is_forgotten_over_ten_seconds(self, scara: RobotDynamics) -> None:
        monitor, evidence = make_monitor(scara), {}
        for i in range(2300):
            q, qd = sweep(min(i, 300) / 100, 0.02)
            now = NOW + 10 * i * MS
            admitted(monitor, state(now, position=q, velocity=qd if i < 300 else 0.0 * qd), now)
            if i in {1299, 2299}:  # at rest, 10 s apart
                memory = monitor._memory[0]  # noqa: SLF001 - the estimate of the lag is not public
                evidence[i] = np.array([memory["lag_correlation"], memory["lag_excitation"]])
        assert min(evidence[1299]) > 0.0
        np.testing.assert_allclose(evidence[2299] / evidence[1299], math.exp(-1.0), rtol=1e-3)

    def test_lag_evidence_of_before_counts(self, scara: RobotDynamics) -> None:
        """Velocities that are late by what was estimated agree better than without the estimate."""
        tolerances = []
        for excitation in (0.0, 50.0):
            monitor = make_monitor(scara)
            for i in range(21):
                now, motion = NOW + 8 * i * MS, sweep(8e-3 * i, 0.05)
                if i == 20:
                    monitor._memory["lag_correlation"] = 0.05 * excitation  # noqa: SLF001
                    monitor._memory["lag_excitation"] = excitation  # noqa: SLF001
                result = admitted(monitor, state(now, position=motion.q, velocity=motion.qd), now)
            assert not isinstance(result, str)
            tolerances.append(result[[0, 1, 3]])
        assert (tolerances[1] < tolerances[0]).all()


class TestCommands:
    """The controller's commands reveal lies in which positions and velocities agree."""

    @pytest.mark.parametrize("expected", [True, False])
    @pytest.mark.parametrize("lie", ["frozen", "exchanged", ""])
    def test_lie_without_contradiction_is_found_with_commands(
        self, scara: RobotDynamics, lie: str, *, expected: bool
    ) -> None:
        feed = Feed(make_monitor(scara, release_time=0.2))
        if expected:
            feed.monitor.expect_commands(0.1)
        verdicts = []
        for i in range(1200, 1600):
            command = sweep((i + 20) / 1e3).q
            feed.monitor.take_command(state(names=(*JOINTS, "x"), position=(*command, 0.0), velocity=()), feed.now_ns)
            q, qd = sweep(1.2 if lie == "frozen" else i / 1e3)
            qd *= lie != "frozen"
            order = [1, 0, 2, 3] if lie == "exchanged" else [0, 1, 2, 3]
            verdicts.append(feed(state(position=q[order], velocity=qd[order]))[0])
        assert (verdicts[-1] is Verdict.UNKNOWN) == (expected and lie != "")

    @pytest.mark.parametrize("joint", range(4))
    def test_position_at_the_tolerance_of_the_command_is_valid(self, scara: RobotDynamics, joint: int) -> None:
        for offset, valid in ((0.125, True), (0.126, False), (-0.125, True), (-0.126, False), (NAN, False)):
            feed = Feed(make_monitor(scara))
            feed.monitor.expect_commands(0.125)
            command = list(Q)
            command[joint] += offset * (0.25 if joint == 2 else 1.0) * (1.0 - 1e-9)
            feed.monitor.take_command(state(position=command), feed.now_ns)
            verdict, reason = feed()
            assert (verdict is Verdict.OK) == valid
            assert reason == "" or "off its command" in reason

    def test_missing_commands_give_unknown(self, scara: RobotDynamics) -> None:
        feed = Feed(make_monitor(scara))
        feed.monitor.expect_commands(0.1)
        assert feed() == (Verdict.UNKNOWN, "no joint command yet")
        for refused in (
            state(names=JOINTS[:3], position=Q[:3]),
            state(position=Q[:3]),
            state(names=("x",), position=(0.0,)),
        ):
            feed.monitor.take_command(refused, feed.now_ns)
            assert feed() == (Verdict.UNKNOWN, "no joint command yet")
        feed.monitor.take_command(state(), feed.now_ns)
        slow = state(velocity=(1e-6,) * 4)
        assert feed(slow, 200 * MS) == (Verdict.OK, "")
        assert feed(slow) == (Verdict.UNKNOWN, "no joint command for 0.201 s")

    def test_command_from_before_a_jump_of_the_clock_does_not_count(self, scara: RobotDynamics) -> None:
        feed = Feed(make_monitor(scara))
        feed.monitor.expect_commands(0.1)
        feed.monitor.take_command(state(), feed.now_ns)
        assert feed()[0] is Verdict.OK
        feed.monitor.clear_history()
        assert feed() == (Verdict.UNKNOWN, "no joint command yet")


class TestDifferentiation:
    """A velocity differentiated from positions uses header time."""

    def test_differentiated_velocity_equals_the_stated_one(self, scara: RobotDynamics) -> None:
        """Powers of two throughout, so that the difference quotient is exact."""
        step_ns = 15_625_000
        start = NOW - NOW % step_ns
        with_velocity = make_monitor(scara, velocity_tolerance=0.0)
        differentiated = make_monitor(scara, velocity_tolerance=0.0, velocity_source="from_positions")
        qd = (0.5, -0.25, 0.125, 1.0)
        for i in range(4):
            q = tuple(x + v * i / 64.0 for x, v in zip((0.25, 1.25, 0.125, -0.5), qd, strict=True))
            now = start + i * step_ns
            expected = with_velocity.assess(state(now, position=q, velocity=qd), now)
            decision = differentiated.assess(state(now, position=q, velocity=()), now)
            assert decision is not None
            assert expected is not None
            if i:
                assert (decision.velocity_delay, expected.velocity_delay) == (0.5 * step_ns / 1e9, 0.0)
                assert repr(decision._replace(velocity_delay=0.0)) == repr(expected)
            else:
                assert decision.contacts[0].reason.startswith("the velocity is empty, and one joint state alone")

    def test_gap_cannot_be_differentiated(self, scara: RobotDynamics) -> None:
        feed = Feed(make_monitor(scara, velocity_source="from_positions"))
        feed(state(velocity=()))
        verdict, reason = feed(state(velocity=()), 201 * MS)
        assert verdict is Verdict.UNKNOWN
        assert "cannot be differentiated" in reason

    def test_nan_position_gives_no_velocity(self, scara: RobotDynamics) -> None:
        feed = Feed(make_monitor(scara, velocity_source="from_positions"))
        feed(state(velocity=()))
        assert feed(state(position=(NAN, *Q[1:]), velocity=())) == (
            Verdict.UNKNOWN,
            "the position of joint1 is nan",
        )
        assert feed(state(velocity=()))[0] is Verdict.UNKNOWN
        assert feed(state(velocity=()))[1].startswith("the velocity of joint1 reads zero")

    def test_wrong_velocity_length_is_invalid_with_differentiation(self, scara: RobotDynamics) -> None:
        feed = Feed(make_monitor(scara, velocity_source="from_positions"))
        assert feed(state(velocity=QD[:2])) == (Verdict.UNKNOWN, "2 velocities for 4 names")


def is_valid(joint_state: JointState, now_ns: int, last_ns: int) -> bool:
    """Return whether a joint state may lead to a verdict: an independent, plain implementation."""
    names = list(joint_state.names)
    if "" in names or len(set(names)) < len(names) or not set(JOINTS) <= set(names):
        return False
    if not len(names) == len(joint_state.position) == len(joint_state.velocity):
        return False
    if not max(last_ns + 1, 1, now_ns - 200 * MS) <= joint_state.stamp_ns <= now_ns + 20 * MS:
        return False
    pairs = dict(zip(names, zip(joint_state.position, joint_state.velocity, strict=True), strict=True))
    ranges = ((-2.3736, 2.3736, 12.6), (-2.5831, 2.5831, 12.6), (0.0, 0.45, 3.0), (-6.2832, 6.2832, 50.0))
    return all(
        lower - 0.020001 <= pairs[joint][0] <= upper + 0.020001 and abs(pairs[joint][1]) <= 1.100001 * fastest
        for joint, (lower, upper, fastest) in zip(JOINTS, ranges, strict=True)
    )


numbers = st.one_of(st.floats(), st.floats(-3.0, 3.0), st.sampled_from([0.0, NAN, INF, -INF, 1e308, -1e308, 5e-324]))
wild_names = st.lists(st.sampled_from([*JOINTS, "gripper", "", "joint1 ", "\N{GREEK SMALL LETTER MU}"]), max_size=7)
stamps = st.one_of(
    st.integers(-(2**63), 2**63 - 1), st.integers(NOW - 300 * MS, NOW + 50 * MS), st.sampled_from([0, NOW])
)
random_states = st.builds(state, stamps, wild_names, st.lists(numbers, max_size=7), st.lists(numbers, max_size=7))
nearly_valid_states = st.builds(
    state,
    st.integers(NOW - 250 * MS, NOW + 30 * MS),
    st.one_of(st.just(JOINTS), st.permutations(JOINTS)),
    st.lists(st.one_of(st.floats(-0.1, 0.5), numbers), min_size=4, max_size=4),
    st.lists(st.one_of(st.floats(-3.0, 3.0), numbers), min_size=4, max_size=4),
)


@given(st.lists(st.one_of(random_states, nearly_valid_states, st.just(state())), min_size=1, max_size=6), st.booleans())
@example([state(velocity=(1e-300,) * 4)], False)  # noqa: FBT003 - positional for hypothesis
def test_no_input_raises_or_gives_nan_or_a_wrong_verdict(
    scara: RobotDynamics,
    states: list[JointState],
    differentiate: bool,  # noqa: FBT001
) -> None:
    monitor = make_monitor(scara, velocity_source="from_positions" if differentiate else "reported")
    last_ns = 0
    for joint_state in states:
        # From positions, a reported velocity is not used, whatever it is, if there is one for each name.
        is_unused = differentiate and len(joint_state.velocity) in {0, len(joint_state.names)}
        used = joint_state._replace(velocity=np.zeros(len(joint_state.names))) if is_unused else joint_state
        valid = is_valid(used, NOW, last_ns)
        decision = monitor.assess(joint_state, NOW)
        if decision is None:
            assert not set(joint_state.names) & set(JOINTS)
            continue
        (contact,) = decision.contacts
        for name, value in contact._asdict().items():
            if isinstance(value, float) and name not in {"lumped_mass", "full_mass"}:
                assert math.isfinite(value), name
        assert math.isfinite(math.hypot(*contact.direction))
        assert 0.0 <= decision.speed_scaling <= 1.0
        assert 0.0 <= decision.allowable_speed < INF
        assert decision.stamp_ns >= 0
        if contact.verdict is Verdict.UNKNOWN:
            assert contact.reason
            assert (contact.allowable_speed, decision.allowable_speed, decision.speed_scaling) == (0.0, 0.0, 0.0)
        else:
            assert valid
        if valid:
            last_ns = joint_state.stamp_ns


class TestBoundaries:
    """Values exactly at a limit are valid; the next float beyond it is not."""

    def refusal(self, scara: RobotDynamics, joint_state: JointState) -> str:
        """Return why a first joint state is refused, empty if it is not."""
        result = admitted(make_monitor(scara), joint_state, NOW)
        return result if isinstance(result, str) else ""

    @pytest.mark.parametrize("joint", range(4))
    @pytest.mark.parametrize("side", ["lowerPositionLimit", "upperPositionLimit"])
    def test_position_exactly_at_a_joint_limit_is_valid(self, scara: RobotDynamics, joint: int, side: str) -> None:
        sign = 1.0 if side.startswith("upper") else -1.0
        limit = float(getattr(scara.robot.model, side)[joint]) + sign * 0.02
        positions = list(Q)
        positions[joint] = limit
        assert self.refusal(scara, state(position=positions)) == ""
        positions[joint] = math.nextafter(limit, sign * INF)
        assert "lies outside its limits" in self.refusal(scara, state(position=positions))

    @pytest.mark.parametrize("joint", range(4))
    @pytest.mark.parametrize("sign", [1.0, -1.0])
    def test_velocity_exactly_at_the_maximum_speed_is_valid(
        self, scara: RobotDynamics, joint: int, sign: float
    ) -> None:
        max_speed = float(scara.robot.model.velocityLimit[joint]) * 1.1
        velocities = list(QD)
        velocities[joint] = sign * max_speed
        assert self.refusal(scara, state(velocity=velocities)) == ""
        velocities[joint] = sign * math.nextafter(max_speed, INF)
        assert "exceeds its maximum speed" in self.refusal(scara, state(velocity=velocities))

    @pytest.mark.parametrize("stated", [0.0, INF])
    def test_joint_without_stated_maximum_speed_has_the_default_one(self, scara: RobotDynamics, stated: float) -> None:
        model = scara.robot.model.copy()
        model.velocityLimit = np.full(4, stated)
        unlimited = RobotDynamics(replace(scara.robot, model=model))
        assert self.refusal(unlimited, state(velocity=(66.0, 0.1, 11.0, 0.1))) == ""
        for joint, name in ((0, "joint1"), (2, "joint3")):
            velocities = [66.0, 0.1, 11.0, 0.1]
            velocities[joint] += 0.001
            assert f"{name} at" in self.refusal(unlimited, state(velocity=velocities))

    @pytest.mark.parametrize(("duration_ms", "expected"), [(99, Verdict.UNKNOWN), (100, Verdict.OK)])
    def test_zero_velocity_is_confirmed_after_a_tenth_of_a_second(
        self, scara: RobotDynamics, duration_ms: int, expected: Verdict
    ) -> None:
        feed = Feed(make_monitor(scara))
        feed(state(velocity=(0.0,) * 4))
        assert feed(state(velocity=(0.0,) * 4), duration_ms * MS)[0] is expected

    @pytest.mark.parametrize("joint", range(4))
    def test_displacement_is_bounded_by_the_position_tolerance(self, scara: RobotDynamics, joint: int) -> None:
        """0.01 rad, for a prismatic joint 2.5 mm."""
        tolerance = (0.01, 0.01, 0.0025, 0.01)[joint]
        for factor, expected in (
            (0.99, Verdict.OK),
            (1.02, Verdict.UNKNOWN),
            (-0.99, Verdict.OK),
            (-1.02, Verdict.UNKNOWN),
        ):
            feed = Feed(make_monitor(scara))
            for _ in range(110):
                feed(state(velocity=(0.0,) * 4))
            position = list(Q)
            position[joint] += factor * tolerance
            assert feed(state(position=position, velocity=(0.0,) * 4))[0] is expected

    def test_gap_restarts_the_comparison(self, scara: RobotDynamics) -> None:
        feed = Feed(make_monitor(scara))
        feed()
        assert feed(state(position=(1.5, *Q[1:])), 201 * MS)[0] is Verdict.OK

    @pytest.mark.parametrize(("gap_ms", "expected"), [(200, Verdict.OK), (201, Verdict.UNKNOWN)])
    def test_gap_up_to_the_timeout_can_be_differentiated(
        self, scara: RobotDynamics, gap_ms: int, expected: Verdict
    ) -> None:
        feed = Feed(make_monitor(scara, velocity_source="from_positions"))
        feed(state(velocity=()))
        assert feed(state(position=[q + 0.01 for q in Q], velocity=()), gap_ms * MS)[0] is expected

# SPDX-License-Identifier: Apache-2.0
"""Joint states with joints that the model does not have: a rail, a second arm, wheels, another arm altogether."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest

from scara_effmass.errors import SettingsError
from scara_effmass.kernel.other_joints import MAX_NAMES, TOO_MANY, OtherJoints
from scara_effmass.model.description import HeldJoint
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.settings import MonitorSettings, checked
from scara_effmass.values import FloatArray, JointState, Verdict

JOINTS = ("joint1", "joint2", "joint3", "joint4")
NOW, MS = 1_700_000_000_000_000_000, 1_000_000
STEP_MS = 10
RAIL = "joint rail moves, but is not in the model"


class Other(NamedTuple):
    """Names, positions and velocities beside those of the robot, at a time [s]; NaN where there is none."""

    names: tuple[str, ...]
    position: tuple[float, ...]
    velocity: tuple[float, ...]


def monitor_of(scara: RobotDynamics, **settings: object) -> Monitor:
    accepted = ("payload", "rotor_inertia", "contact_area", "person_speed", "contact_points", "acceleration", "masses")
    values: dict[str, Any] = {"release_time": 0.0, "accept_assumptions": accepted, **settings}
    return Monitor(scara, checked(MonitorSettings, values, "test"))


def arm(seconds: float) -> tuple[FloatArray, FloatArray]:
    """Return a slow motion of the robot."""
    rate = np.array([0.5, 0.4, 0.01, 0.3])
    return np.array([0.3, 1.2, 0.1, -0.4]) + rate * np.sin(seconds), rate * np.cos(seconds)


def run(monitor: Monitor, others: list[Other], names: tuple[str, ...] = JOINTS) -> list[str]:
    """Return the reason of each joint state of the robot that also holds `others`, 10 ms apart."""
    reasons = []
    for i, other in enumerate(others):
        q, qd = arm(i * STEP_MS / 1e3)
        stamp = NOW + i * STEP_MS * MS
        state = JointState(stamp, (*names, *other.names), np.append(q, other.position), np.append(qd, other.velocity))
        decision = monitor.assess(state, stamp)
        assert decision is not None
        contact = decision.contacts[0]
        assert (contact.verdict is Verdict.UNKNOWN) == bool(contact.reason) == (decision.allowable_speed == 0.0)
        reasons.append(contact.reason)
    return reasons


def rail(speed: float, count: int = 30, *, velocity: float | None = None, start: float = 0.0) -> list[Other]:
    """Return a rail that moves at `speed` [m/s] and reports `velocity`."""
    reported = speed if velocity is None else velocity
    return [Other(("rail",), (start + speed * i * STEP_MS / 1e3,), (reported,)) for i in range(count)]


class TestInTheSameJointState:
    @pytest.mark.parametrize(
        ("speed", "velocity", "unseen"),
        [(2.0, None, 0), (0.3, 0.0, 1), (0.3, math.nan, 1), (0.0, 0.3, 0), (-0.05, None, 0), (0.02, math.nan, 13)],
        ids=["rail", "velocity reads 0", "no velocity", "position is frozen", "slow", "very slow"],
    )
    def test_joint_that_moves_gives_unknown_that_names_it(
        self, scara: RobotDynamics, speed: float, velocity: float | None, unseen: int
    ) -> None:
        monitor = monitor_of(scara)
        reasons = run(monitor, rail(speed, 20, velocity=velocity))
        assert set(reasons[unseen:]) == {RAIL}
        assert set(reasons[:unseen]) <= {""}
        assert monitor.unmodelled_joints == ("rail",)

    def test_joint_at_rest_changes_nothing_and_rest_is_seen_after_a_tenth_of_a_second(
        self, scara: RobotDynamics
    ) -> None:
        noise = [Other(("rail",), (0.5 + 0.001 * (-1) ** i,), (0.002 * (-1) ** i,)) for i in range(20)]
        monitor = monitor_of(scara)
        assert set(run(monitor, noise)) == {""}
        assert monitor.unmodelled_joints == ()
        stops = [*rail(1.0, 10), *rail(0.0, 20, start=0.09)]
        assert run(monitor_of(scara), stops) == [RAIL] * 19 + [""] * 11

    @pytest.mark.parametrize("ignored", ["rail", "ra*"])
    def test_joint_that_is_stated_as_harmless_is_not_watched_and_an_ok_says_so(
        self, scara: RobotDynamics, ignored: str
    ) -> None:
        monitor = monitor_of(scara, ignored_joints=(ignored,))
        assert set(run(monitor, rail(2.0))) == {""}
        stamp = NOW + 10**9
        decision = monitor.assess(JointState(stamp, JOINTS, *arm(1.0)), stamp)
        assert decision is not None
        assert decision.scope.endswith(f"; motion does not count of {ignored}")

    def test_joint_of_the_model_cannot_be_ignored(self, scara: RobotDynamics) -> None:
        with pytest.raises(SettingsError, match="ignored_joints = 'joint2': must not be a joint that the model moves"):
            monitor_of(scara, ignored_joints=("joint2",))

    def test_joint_is_ignored_by_the_reported_name_or_that_of_joint_map(self, scara: RobotDynamics) -> None:
        for name in ("track", "rack"):
            monitor = monitor_of(scara, ignored_joints=(name,), joint_map=("tra*=ra*",))
            others = [other._replace(names=("track",)) for other in rail(2.0)]
            assert set(run(monitor, others)) == {""}

    def test_pattern_for_a_finger_fits_a_joint(self, scara: RobotDynamics) -> None:
        robot = RobotDynamics(replace(scara.robot, held=(HeldJoint("rail", is_harmless=True),)))
        for ignored, unmatched in (("rail", ()), ("ra*", ()), ("door", ("door",))):
            monitor = monitor_of(robot, ignored_joints=(ignored,))
            assert set(run(monitor, rail(2.0))) == {""}
            assert monitor.unmatched == unmatched

    def test_each_joint_that_moves_is_listed(self, scara: RobotDynamics) -> None:
        monitor = monitor_of(scara)
        both = [Other(("left", "right", "still"), (0.0, 0.01 * i, 1.0), (0.0, 1.0, 0.0)) for i in range(5)]
        assert set(run(monitor, both)) == {"joint right moves, but is not in the model"}
        both = [Other(("left", "right", "still"), (0.01 * i, 0.05, 1.0), (1.0, 0.0, 0.0)) for i in range(5)]
        q, qd = arm(0.05)
        for i, other in enumerate(both):
            stamp = NOW + (60 + i) * MS
            position, velocity = np.append(q, other.position), np.append(qd, other.velocity)
            monitor.assess(JointState(stamp, (*JOINTS, *other.names), position, velocity), stamp)
        assert monitor.unmodelled_joints == ("left", "right")

    @pytest.mark.parametrize("velocity", [math.nan, 0.0])
    def test_joint_without_position_may_move(self, scara: RobotDynamics, velocity: float) -> None:
        blind = [Other(("rail",), (math.nan,), (velocity,))] * 5
        text = "joint rail may move (it shows no position), but is not in the model"
        assert set(run(monitor_of(scara), blind)) == {text}

    def test_wheel_at_rest_at_pi_does_not_move(self, scara: RobotDynamics) -> None:
        wheel = [Other(("wheel",), (math.pi * (-1) ** i,), (0.0,)) for i in range(20)]
        assert set(run(monitor_of(scara), wheel)) == {""}

    def test_other_faults_keep_their_reason(self, scara: RobotDynamics) -> None:
        monitor = monitor_of(scara)
        q, qd = arm(0.0)
        state = JointState(NOW, (*JOINTS, "rail"), np.append(q, 0.0), np.append(qd, 1.0))
        for changed, reason in (
            (state._replace(stamp_ns=0), "the header stamp is zero or negative"),
            (state._replace(position=state.position[:4]), "4 positions for 5 names"),
            (state._replace(position=np.append(9.0, state.position[1:])), "joint1 at 9.0000 rad lies outside"),
        ):
            decision = monitor.assess(changed, NOW)
            assert decision is not None
            assert decision.contacts[0].reason.startswith(reason)


class TestInJointStatesOfTheirOwn:
    """Another device, such as a second arm, publishes on the same topic."""

    def feed(self, monitor: Monitor, i: int, position: float, velocity: float) -> None:
        stamp = NOW + i * MS
        device = JointState(stamp, ("swing",), np.array([position]), np.array([velocity]))
        assert monitor.assess(device, stamp) is None

    def reason(self, monitor: Monitor, i: int) -> str:
        stamp = NOW + i * MS
        decision = monitor.assess(JointState(stamp, JOINTS, *arm(i / 1e3)), stamp)
        assert decision is not None
        return decision.contacts[0].reason

    def test_device_that_moves_gives_unknown_until_it_is_seen_at_rest(self, scara: RobotDynamics) -> None:
        monitor, moves = monitor_of(scara), "joint swing moves, but is not in the model"
        assert self.reason(monitor, 0) == ""
        self.feed(monitor, 5, 0.0, 0.0)
        assert self.reason(monitor, 10) == ""
        self.feed(monitor, 15, 0.05, 0.5)
        assert self.reason(monitor, 20) == moves
        for i in range(30, 400, 10):  # silent since
            assert self.reason(monitor, i) == moves
        self.feed(monitor, 405, 0.05, 0.0)
        assert self.reason(monitor, 410) == ""
        self.feed(monitor, 415, 0.05, 0.5)
        assert self.reason(monitor, 420) == moves
        monitor.reset()  # the device was taken away
        assert self.reason(monitor, 430) == ""

    def test_device_at_rest_that_is_reported_no_more_may_move(self, scara: RobotDynamics) -> None:
        """One that reports at 1 Hz stays usable."""
        monitor, silent = monitor_of(scara), "joint swing may move (it is silent), but is not in the model"
        reasons = []
        for i in range(0, 3600, 10):
            if i in {0, 1000, 2000, 3590}:
                self.feed(monitor, i, 0.5, 0.0)
            reasons.append(self.reason(monitor, i))
        assert reasons == [""] * 351 + [silent] * 8 + [""]
        for i in range(3600, 5100, 10):
            self.reason(monitor, i)
        assert self.reason(monitor, 5100) == silent
        monitor.reset()  # the device was taken away
        assert self.reason(monitor, 5110) == ""

    def test_device_that_was_seen_before_the_clock_went_back_is_silent(self, scara: RobotDynamics) -> None:
        monitor = monitor_of(scara)
        self.feed(monitor, 3000, 0.5, 0.0)
        assert "it is silent" in self.reason(monitor, 1499)
        assert self.reason(monitor, 1500) == ""

    def test_timeout_above_that_time_counts_for_other_devices_too(self, scara: RobotDynamics) -> None:
        monitor = monitor_of(scara, timeout=2.0)
        self.feed(monitor, 0, 0.5, 0.0)
        assert [self.reason(monitor, i) for i in (0, 1000, 2000)] == [""] * 3
        assert "may move" in self.reason(monitor, 2010)

    def test_clock_that_goes_back_ends_no_motion_and_holds_none(self, scara: RobotDynamics) -> None:
        monitor = monitor_of(scara)
        self.feed(monitor, 1000, 0.0, 0.5)
        self.feed(monitor, 0, 0.0, 0.5)
        assert "swing moves" in self.reason(monitor, 10)
        self.feed(monitor, 101, 0.0, 0.0)
        assert self.reason(monitor, 110) == ""


class TestHeldByTheModel:
    @pytest.mark.parametrize(("position", "shown"), [(0.5, ""), (0.509, ""), (0.511, "0.511"), (-1.0, "-1")])
    def test_joint_at_another_position_than_in_the_model_gives_unknown(
        self, scara: RobotDynamics, position: float, shown: str
    ) -> None:
        robot = replace(scara.robot, held=(HeldJoint("rail", is_harmless=False, position=0.5),))
        at_rest = [Other(("rail",), (position,), (0.0,))] * 5
        reason = f"joint rail is at {shown}, but the model holds it at 0.5"
        assert set(run(monitor_of(RobotDynamics(robot)), at_rest)) == {reason if shown else ""}
        assert set(run(monitor_of(RobotDynamics(robot), ignored_joints=("rail",)), at_rest)) == {""}

    @pytest.mark.parametrize(
        ("reported", "ignored", "is_known"),
        [
            ((), (), False),
            (("rail",), (), False),
            (("rail", "swing"), (), True),
            (("rail",), ("sw*",), True),
            ((), ("rail", "swing"), True),
        ],
    )
    def test_joint_that_no_joint_state_has_gives_unknown(
        self,
        scara: RobotDynamics,
        reported: tuple[str, ...],
        ignored: tuple[str, ...],
        is_known: bool,  # noqa: FBT001 - a parameter
    ) -> None:
        """Unless it is stated as locked, or hardly shapes the arm."""
        held = [HeldJoint(name, is_harmless=False, position=0.0) for name in ("rail", "swing")]
        held += [
            HeldJoint("locked", is_harmless=False, position=0.0, is_stated=True),
            HeldJoint("jaw", is_harmless=False),
        ]
        monitor = monitor_of(RobotDynamics(replace(scara.robot, held=tuple(held))), ignored_joints=ignored)
        at_rest = [Other(reported, (0.0,) * len(reported), (0.0,) * len(reported))] * 5
        text = "not every joint that the model holds fixed is reported: rail, swing"
        assert set(run(monitor, at_rest)) == {"" if is_known else text}
        assert monitor.unmatched == ()
        assert monitor.unmodelled_joints == ()

    def test_held_joint_may_be_reported_by_itself_and_may_go_at_a_reset(self, scara: RobotDynamics) -> None:
        robot = replace(scara.robot, held=(HeldJoint("swing", is_harmless=False, position=0.0),))
        monitor, alone = monitor_of(RobotDynamics(robot)), [Other((), (), ())]
        unreported = ["not every joint that the model holds fixed is reported: swing"]
        assert run(monitor, alone) == unreported
        monitor.reset()
        assert run(monitor, alone) == unreported
        monitor.assess(JointState(NOW, ("swing",), np.zeros(1), np.zeros(1)), NOW)
        assert run(monitor, alone) == [""]
        monitor.reset()
        monitor.clear_history()
        assert run(monitor, alone) == [""]


class TestAnotherArm:
    @pytest.mark.parametrize(
        ("more", "named"),
        [(("joint5", "joint6"), "joint5, joint6"), (("joint0",), "joint0"), (("joint05",), "joint05")],
    )
    def test_more_joints_of_the_same_names_are_another_arm(
        self, scara: RobotDynamics, more: tuple[str, ...], named: str
    ) -> None:
        at_rest = [Other(more, (0.0,) * len(more), (0.0,) * len(more))] * 3
        text = f"joint states of another arm than {scara.robot.name}, which has no {named}"
        assert set(run(monitor_of(scara), at_rest)) == {text}
        assert set(run(monitor_of(scara, ignored_joints=more), at_rest)) == {""}

    def test_other_names_with_numbers_are_not(self, scara: RobotDynamics) -> None:
        at_rest = [Other(("gripper1", "my_joint5"), (0.0, 0.0), (0.0, 0.0))] * 3
        assert set(run(monitor_of(scara), at_rest)) == {""}


def test_joints_beyond_the_memory_count_as_moving() -> None:
    others, clocks = OtherJoints({}), np.array([NOW])
    others.tolerance, others.max_speed = 0.0025, 0.0036
    zeros = np.zeros((1, 1))
    for i in range(MAX_NAMES - 1):
        last = others.numbers([f"joint_{i}"])
    assert others.watch(last, clocks, zeros, zeros) is None
    beyond = others.watch(others.numbers(["one more"]), clocks, zeros, zeros)
    assert beyond is not None
    assert others.text(int(beyond.numbers[0]), int(beyond.states[0])) == f"{TOO_MANY} moves"

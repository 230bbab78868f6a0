# SPDX-License-Identifier: Apache-2.0
"""Joint states with other names, without names, and with filtered velocities or velocities from positions."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.codes import Reason
from scara_effmass.errors import SettingsError
from scara_effmass.kernel.state import STATE
from scara_effmass.model.description import HeldJoint
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.safety.joint_state_adapter import JointStateAdapter, suggested_map
from scara_effmass.settings import MonitorSettings, checked
from scara_effmass.values import ContactAssessment, Decision, FloatArray, JointState, Verdict

JOINTS = ("joint1", "joint2", "joint3", "joint4")
NOW = 1_700_000_000_000_000_000
MS = 1_000_000


def settings_of(**settings: object) -> MonitorSettings:
    return checked(MonitorSettings, {"release_time": 0.0, **settings}, "test")


def adapter_of(**settings: object) -> JointStateAdapter:
    return JointStateAdapter(JOINTS, settings_of(**settings))


def motion(t: float) -> tuple[FloatArray, FloatArray]:
    """Return position and velocity of a robot that moves all joints."""
    amplitude, rate = np.array([0.8, 0.5, 0.02, 0.4]), np.array([2.0, 3.0, 1.5, 2.5])
    return np.array([0.0, 1.2, 0.2, 0.0]) + amplitude * np.sin(rate * t), amplitude * rate * np.cos(rate * t)


def run_decisions(
    monitor: Monitor,
    names: tuple[str, ...] = JOINTS,
    velocity: Callable[[FloatArray], FloatArray] = lambda qd: qd,
    seconds: float = 1.0,
) -> list[Decision]:
    """Return the decisions over a motion at 500 Hz."""
    decisions = []
    for i in range(round(500 * seconds)):
        q, qd = motion(i / 500)
        decision = monitor.assess(JointState(NOW + 2 * MS * i, names, q, velocity(qd)), NOW + 2 * MS * i)
        assert decision is not None
        decisions.append(decision)
    return decisions


def run(
    monitor: Monitor, names: tuple[str, ...] = JOINTS, velocity: Callable[[FloatArray], FloatArray] = lambda qd: qd
) -> list[ContactAssessment]:
    """Return the assessments of the tool over that motion."""
    return [decision.contacts[0] for decision in run_decisions(monitor, names, velocity)]


def velocities(
    adapter: JointStateAdapter,
    stamp_ns: int,
    position: FloatArray,
    velocity: FloatArray,
    names: tuple[str, ...] = JOINTS,
) -> tuple[FloatArray, FloatArray, float, bool]:
    """Return the filtered velocity of a joint state, its change within the delay, the delay, and if there is one."""
    layout, motions = adapter.layout(names), np.zeros((1, 6, len(JOINTS)))
    records = np.zeros(1, STATE)
    records["stamp_ns"] = stamp_ns
    assert adapter.read(layout, position, velocity, motions[:, 0], motions[:, 1]) == (Reason.NONE, (0.0, 0.0))
    filtered = adapter.filter(layout, records, motions)
    delays, known = (np.zeros(1), np.ones(1, bool)) if filtered is None else filtered
    return motions[0, 1], motions[0, 3], float(delays[0]), bool(known[0])


MAPS = [
    (("lwr_0=joint1", "lwr_1=joint2", "lwr_2=joint3", "lwr_3=joint4"), ("lwr_0", "lwr_1", "lwr_2", "lwr_3")),
    (("left/*=*",), ("left/joint1", "left/joint2", "left/joint3", "left/joint4")),
    (("axis_*_of_left=joint*",), ("axis_1_of_left", "axis_2_of_left", "axis_3_of_left", "axis_4_of_left")),
    ((r"re:[lr]_(\d)_j{1,2}=joint\1",), ("l_1_j", "r_2_jj", "l_3_j", "r_4_j")),
    (("elbow=joint2",), ("joint1", "elbow", "joint3", "joint4")),
]


@pytest.mark.parametrize(("joint_map", "names"), MAPS)
def test_mapped_names_change_no_bit(scara: RobotDynamics, joint_map: tuple[str, ...], names: tuple[str, ...]) -> None:
    mapped = run(Monitor(scara, settings_of(joint_map=joint_map)), names)
    assert repr(mapped) == repr(run(Monitor(scara, settings_of())))


def test_joint_states_without_names_have_those_of_the_settings(scara: RobotDynamics) -> None:
    named = run(Monitor(scara, settings_of(joint_names=JOINTS)), ())
    assert repr(named) == repr(run(Monitor(scara, settings_of())))
    assert {contact.reason for contact in run(Monitor(scara, settings_of()), ())} == {"the joint state has no names"}
    too_many = run(Monitor(scara, settings_of(joint_names=(*JOINTS, "gripper"))), ())
    assert {contact.reason for contact in too_many} == {"4 positions for 5 names"}


def test_map_that_gives_a_joint_several_names_gives_unknown(scara: RobotDynamics) -> None:
    monitor = Monitor(scara, settings_of(joint_map=("a*=joint*", "*=j*")))
    names = ("a1", "a2", "a3", "a4")
    assert {contact.reason for contact in run(monitor, names)} == {
        "joint_map gives joint a1 several names: ja1, joint1"
    }
    monitor = Monitor(scara, settings_of(joint_map=("a1=joint1",)))
    decision = monitor.assess(JointState(NOW, ("a1", *JOINTS), np.zeros(5), np.ones(5)), NOW)
    assert decision is not None
    assert decision.contacts[0].reason == "joint_map gives joint a1, joint1 the same name: joint1"


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"joint_map": ("a=jiont1",)}, "joint_map = 'a=jiont1': jiont1: must be joint1"),
        ({"joint_map": ("joint1",)}, "'joint1': must be \"reported=robot\""),
        ({"joint_map": ("=joint1",)}, "'=joint1': must be \"reported=robot\""),
        ({"joint_map": ("a**=b",)}, "must be"),
        ({"joint_map": ("re:(a=joint1",)}, "must be a regular expression and a name"),
        ({"joint_map": (r"re:a=joint\1",)}, "invalid group reference"),
        ({"joint_map": ("a=joint*",)}, "invalid group reference"),
        ({"joint_names": ("joint1", "joint2", "joint4")}, "joint_names = joint1, joint2, joint4: must hold joint3"),
        ({"velocity_window": 0.1}, "velocity_window = 0.1: must be at most max_velocity_lag = 0.06 s"),
        ({"joint_limits": ("joint1=1 -1",)}, 'must be "joint=lower upper" with lower < upper'),
        ({"joint_limits": ("joint1=nan 1",)}, 'must be "joint=lower upper" with lower < upper'),
    ],
)
def test_unclear_settings_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(SettingsError) as error:
        adapter_of(**settings)
    assert message in str(error.value)


def test_similar_names_are_suggested_only_one_to_one() -> None:
    lwr, arm = [f"lwr_{i}_joint" for i in range(7)], [f"lwr_arm_{i}_joint" for i in range(7)]
    pairs = ",".join(f"{a}={b}" for a, b in zip(lwr, arm, strict=True))
    assert suggested_map(lwr, arm) == f"; try joint_map {pairs}"
    assert suggested_map(lwr[:6], arm) == ""
    assert suggested_map(["wheel_left", "wheel_right"], ["joint1", "joint2"]) == ""
    assert suggested_map(["arm_joint", "arm_joint_"], ["arm-joint"]) == "; try joint_map arm_joint=arm-joint"
    assert suggested_map(["ab", "ba"], ["ac"]) == ""
    assert suggested_map([f"joint{i}" for i in range(65)], ["joint1"]) == ""


def test_no_map_is_suggested_for_an_arm_with_more_joints() -> None:
    gen3, scara = [f"gen3_joint_{i}" for i in range(1, 8)], [f"joint{i}" for i in range(1, 5)]
    assert suggested_map(gen3, scara) == ""
    assert suggested_map([*gen3[:4], "gripper"], scara).startswith("; try joint_map gen3_joint_1=joint1,")


def test_missing_joint_and_silence_suggest_a_map(scara: RobotDynamics) -> None:
    monitor = Monitor(scara, settings_of())
    decision = monitor.assess(JointState(NOW, ("joint1", "joint2", "joint3", "joint_4"), np.zeros(4), np.ones(4)), NOW)
    assert decision is not None
    assert decision.contacts[0].reason == "joint joint4 is missing; try joint_map joint_4=joint4"
    other = ("a_joint1", "a_joint2", "a_joint3", "a_joint4")
    assert monitor.assess(JointState(NOW, other, np.zeros(4), np.ones(4)), NOW) is None
    silent = monitor.watchdog_decision(10**9)
    assert silent.reason(0, 0).endswith(
        "they name a_joint1, a_joint2, a_joint3, a_joint4; try joint_map "
        "a_joint1=joint1,a_joint2=joint2,a_joint3=joint3,a_joint4=joint4"
    )


def test_commands_are_named_like_joint_states(scara: RobotDynamics) -> None:
    q, qd = motion(0.0)
    names, others = (tuple(f"{side}/{name}" for name in JOINTS) for side in ("left", "right"))
    for commanded in (names, others):
        monitor = Monitor(scara, settings_of(joint_map=("left/*=*",)))
        monitor.expect_commands(0.1)
        monitor.take_command(JointState(NOW, commanded, q, np.empty(0)), NOW)
        decision = monitor.assess(JointState(NOW, names, q, qd), NOW)
        assert decision is not None
        assert (decision.contacts[0].verdict is Verdict.UNKNOWN) == (commanded is others)
    assert Monitor(scara, settings_of()).assess(JointState(NOW, names, q, qd), NOW) is None


@given(
    coefficients=st.lists(st.tuples(*[st.floats(-2.0, 2.0)] * 3), min_size=4, max_size=4),
    steps_ms=st.lists(st.integers(1, 20), min_size=5, max_size=30),
    window_ms=st.integers(0, 120),
)
def test_slope_and_mean_are_those_of_the_window_and_late_by_the_stated_delay(
    coefficients: list[tuple[float, float, float]], steps_ms: list[int], window_ms: int
) -> None:
    """Compared with numpy's fit; at constant acceleration and rate the slope is the velocity before the delay."""
    c0, c1, c2 = np.array(coefficients).T
    times = np.cumsum([0, *steps_ms]) / 1e3
    settings = {"velocity_window": window_ms / 1e3, "max_velocity_lag": 0.12}
    fitted = adapter_of(velocity_source="from_positions", **settings)
    mean = adapter_of(**settings)
    for number, t in enumerate(times):
        stamp_ns = NOW + round(t * 1e9)
        q, qd = c0 + c1 * t + c2 * t * t, c1 + 2.0 * c2 * t
        slope, slope_change, slope_delay, has_slope = velocities(fitted, stamp_ns, q, np.full(4, np.nan))
        average, average_change, average_delay, _ = velocities(mean, stamp_ns, q, qd)
        inside = times[: number + 1][t - times[: number + 1] <= window_ms / 1e3 + 1e-9]
        if window_ms:
            expected = np.mean([c1 + 2.0 * c2 * t_i for t_i in inside], axis=0)
            np.testing.assert_allclose(average, expected, atol=1e-9)
            assert average_delay == pytest.approx(t - inside.mean(), abs=1e-9)
            np.testing.assert_allclose(average_change, abs(qd - expected), atol=1e-9)
        if number == 0:
            assert not has_slope
            continue
        inside = inside if len(inside) > 1 else times[number - 1 : number + 1]
        fit = np.polynomial.polynomial.polyfit(inside - t, np.array([c0 + c1 * x + c2 * x * x for x in inside]), 1)
        np.testing.assert_allclose(slope, fit[1], atol=1e-6)
        assert slope_delay == pytest.approx(t - inside.mean(), abs=1e-9)
        if len(set(steps_ms)) == 1:
            np.testing.assert_allclose(slope, c1 + 2.0 * c2 * (t - slope_delay), atol=1e-6)
            if len(inside) > 2:
                newer = inside[len(inside) // 2 if len(inside) > 3 else 1 :]
                change = 2.0 * abs(2.0 * c2) * (newer.mean() - inside.mean())
                np.testing.assert_allclose(slope_change, change, atol=1e-6)


@pytest.mark.parametrize("source", ["reported", "from_positions"])
def test_delay_is_published_and_the_speed_is_right(scara: RobotDynamics, source: str) -> None:
    settings = settings_of(velocity_source=source, velocity_window=0.05)
    plain, filtered = (run_decisions(Monitor(scara, values)) for values in (settings_of(), settings))
    assert {decision.velocity_delay for decision in plain} == {0.0}
    for number in range(100, 500):
        assert filtered[number].velocity_delay == pytest.approx(0.025, abs=1e-9)
        # 0.025 s earlier is between two joint states.
        speeds = [plain[number - back].contacts[0].speed for back in (13, 12)]
        assert filtered[number].contacts[0].speed == pytest.approx(np.mean(speeds), abs=0.02)
        assert filtered[number].contacts[0].verdict is not Verdict.UNKNOWN


def test_velocity_from_positions_needs_no_reported_one(scara: RobotDynamics) -> None:
    settings = settings_of(velocity_source="from_positions")
    expected = run(Monitor(scara, settings))
    for reported in (lambda _: np.empty(0), lambda qd: 0.0 * qd, lambda qd: np.full(4, np.nan) + qd):
        assert repr(run(Monitor(scara, settings), velocity=reported)) == repr(expected)
    assert expected[0].verdict is Verdict.UNKNOWN
    assert {contact.verdict for contact in expected[60:]} <= {Verdict.OK, Verdict.WARN, Verdict.VIOLATION}


def test_too_few_positions_have_no_slope(scara: RobotDynamics) -> None:
    monitor = Monitor(scara, settings_of(velocity_source="from_positions"))
    for i in range(3):
        stamp_ns = NOW + 2 * MS * i
        decision = monitor.assess(JointState(stamp_ns, JOINTS, np.zeros(3), np.empty(0)), stamp_ns)
        assert decision is not None
        assert decision.contacts[0].reason == "3 positions for 4 names"


def test_filter_reduces_the_scatter_of_the_mass(scara: RobotDynamics) -> None:
    """Slow motion with noise and resolution of the velocities; the share of states more than 10 % off the true mass."""
    rng = np.random.default_rng(1)
    reported = rng.normal(0.0, 0.03, (1000, 4))

    def masses(noise: FloatArray, **settings: object) -> FloatArray:
        monitor = Monitor(scara, settings_of(**settings))
        contacts = []
        for i in range(1000):
            q, qd = motion(i / 1500)
            velocity = np.round((qd / 3.0 + noise[i]) / 0.024) * 0.024 if noise.any() else qd / 3.0
            decision = monitor.assess(JointState(NOW + 2 * MS * i, JOINTS, q, velocity), NOW + 2 * MS * i)
            assert decision is not None
            contacts.append(decision.contacts[0].effective_mass)
        return np.array(contacts[100:])

    true = masses(np.zeros((1000, 4)))
    off = [np.mean(np.abs(masses(reported, velocity_window=w) / true - 1.0) > 0.1) for w in (0.0, 0.02, 0.05)]
    assert off[0] > 0.1
    assert off[2] < 0.3 * off[0]


def test_filter_hides_no_frozen_velocity(scara: RobotDynamics) -> None:
    frozen = run(Monitor(scara, settings_of(velocity_window=0.05)), velocity=lambda _: motion(0.0)[1])
    assert {contact.verdict for contact in frozen[150:]} == {Verdict.UNKNOWN}


def test_gap_or_other_joints_restart_the_filter() -> None:
    adapter = adapter_of(velocity_window=0.1, max_velocity_lag=0.1)
    states = [
        (0, JOINTS, 1.0, 1.0),
        (10, JOINTS, 2.0, 1.5),
        (15, ("finger",), 9.0, 9.0),
        (20, JOINTS, 3.0, 2.0),
        (221, JOINTS, 5.0, 5.0),
        (225, JOINTS[::-1], 7.0, 7.0),
        (220, JOINTS[::-1], 8.0, 8.0),
    ]
    for stamp_ms, names, velocity, expected in states:
        if adapter.layout(names).is_foreign:
            continue
        qd, *_ = velocities(adapter, NOW + stamp_ms * MS, np.zeros(4), np.full(4, velocity), names)
        assert set(qd) == {expected}


@pytest.mark.parametrize(
    ("names", "position", "expected"),
    [
        (("wheel", "arm_4", "arm_3", "arm_2", "arm_1"), (9.0, 4.0, 3.0, 2.0, 1.0), [1.0, 2.0, 3.0, 4.0]),
        (("arm_1", "arm_2", "arm_3"), (1.0, 2.0, 3.0), "joint joint4 is missing"),
        (("arm_1", "arm_2", "arm_3", "arm_4"), (1.0, 2.0), "2 positions for 4 names"),
        (("arm_1", "arm_2", "arm_3", "arm_4"), (1.0, 2.0, np.nan, 4.0), "a position is not finite"),
    ],
)
def test_positions_for_a_drawing_are_those_of_the_robot_or_the_reason_why_not(
    names: tuple[str, ...], position: tuple[float, ...], expected: list[float] | str
) -> None:
    state = JointState(NOW, names, np.array(position), np.empty(0))
    q = adapter_of(joint_map=("arm_*=joint*",)).positions(state)
    assert (q if isinstance(q, str) else q.tolist()) == expected


def test_fixed_joint_that_continues_the_numbers_is_none_of_another_arm() -> None:
    adapter = JointStateAdapter(JOINTS, settings_of(), held=[HeldJoint("joint5", is_harmless=False)])
    reasons = [adapter.layout((*JOINTS, name)).reason for name in ("joint5", "joint6")]
    assert reasons == [Reason.NONE, Reason.OTHER_ARM]

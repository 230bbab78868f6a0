# SPDX-License-Identifier: Apache-2.0
"""Advised factors: no state too fast, no slower than needed, accelerations kept, UNKNOWN never advised."""

from collections.abc import Callable, Iterable, Sequence
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from scara_effmass.analysis.advice import Advice, Motion, advise, draw_advice
from scara_effmass.codes import Reason
from scara_effmass.errors import BagError
from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.settings import ContactType, MonitorSettings, VelocitySource
from scara_effmass.share import share
from scara_effmass.sim.motion import sample_moves
from scara_effmass.studies.shipped_bags import tour_moves
from scara_effmass.values import Decision, FloatArray, JointState, Verdict

KINOVA = Path(__file__).parents[1] / "robots" / "kinova.urdf"
JOINTS = ("joint1", "joint2", "joint3", "joint4")
SETTINGS = MonitorSettings(contact_points=("tool",), release_time=0.0)
RATE_HZ = 50


def joint_states(q: FloatArray, qd: FloatArray, rate_hz: int = RATE_HZ) -> list[JointState]:
    return [
        JointState(10**18 + number * 10**9 // rate_hz, JOINTS, *row)
        for number, row in enumerate(zip(q, qd, strict=True))
    ]


@pytest.fixture(scope="module")
def dynamics() -> RobotDynamics:
    return RobotDynamics(load_robot(share("config", "omron_i4_550l.yaml"), SETTINGS))


@pytest.fixture(scope="module")
def motion() -> Motion:
    """12 s of the tour from one rest to another, with six moves that are too fast."""
    q, qd = sample_moves(tour_moves(), RATE_HZ)
    rest, moves = [245] * 25, range(245, 871)
    return Motion(joint_states(q[[*rest, *moves]], np.concatenate((0.0 * qd[rest], qd[moves]))), "tour", {})


class Judge:
    """Decide as a fresh monitor does."""

    def __init__(self, dynamics: RobotDynamics, settings: MonitorSettings = SETTINGS) -> None:
        self.dynamics, self.settings = dynamics, settings

    def __call__(self, states: Sequence[JointState]) -> list[Decision]:
        monitor = Monitor(self.dynamics, self.settings)
        return [decision for state in states if (decision := monitor.assess(state, state.stamp_ns))]

    def advise(self, motion: Motion, count: int | None = None, worst: Verdict = Verdict.WARN) -> Advice:
        return advise(motion, self(motion.states), self, count, self.settings, worst)


def verdicts(decisions: Iterable[Decision]) -> set[Verdict]:
    return {contact.verdict for decision in decisions for contact in decision.contacts}


@pytest.fixture(scope="module")
def advised(dynamics: RobotDynamics, motion: Motion) -> Callable[[int | None], Advice]:
    """Return a function that advises the motion in a number of segments, once for each number."""
    return cache(partial(Judge(dynamics).advise, motion))


@pytest.mark.parametrize("count", [None, 7, 0])
def test_advised_motion_has_no_violation(
    dynamics: RobotDynamics, motion: Motion, advised: Callable[[int | None], Advice], count: int | None
) -> None:
    judge = Judge(dynamics)
    assert Verdict.VIOLATION in verdicts(judge(motion.states))
    advice = advised(count)
    assert Verdict.VIOLATION not in verdicts(judge(advice.states))
    assert np.all((advice.factors > 0.0) & (advice.factors <= 1.0))
    before, after = advice.times(motion)
    assert np.all(after >= before * (1.0 - 1e-9))
    assert after.sum() == pytest.approx((advice.states[-1].stamp_ns - advice.states[0].stamp_ns) / 1e9)
    assert np.allclose(advice.states[-1].position, motion.q[-1])
    assert advice.states[0].stamp_ns == motion.states[0].stamp_ns


def test_ok_motion_has_no_warn(dynamics: RobotDynamics, motion: Motion) -> None:
    judge = Judge(dynamics)
    assert verdicts(judge(judge.advise(motion, worst=Verdict.OK).states)) <= {Verdict.OK, Verdict.UNKNOWN}


def test_ok_motion_has_no_warn_for_another_reason_than_its_speed(dynamics: RobotDynamics) -> None:
    """Joint 4 turns on the spot, and by its acceleration too far until the peak of a contact with the abdomen."""
    rest, time = np.zeros((RATE_HZ // 2, 4)), np.arange(2 * RATE_HZ)[:, np.newaxis] / RATE_HZ
    q, qd = np.zeros((len(time), 4)), np.zeros((len(time), 4))
    q[:, 3:], qd[:, 3:] = 0.2 * (1.0 - np.cos(10.0 * time)), 2.0 * np.sin(10.0 * time)
    motion = Motion(joint_states(np.concatenate((rest, q)), np.concatenate((rest, qd))), "turn", {})
    judge = Judge(dynamics, SETTINGS.model_copy(update={"body_regions": ("abdomen",)}))
    reasons = {contact.reason_code for decision in judge(motion.states) for contact in decision.contacts}
    assert {Reason.TURNS} == reasons - {Reason.NONE, Reason.UNCONFIRMED_ZERO}
    advice = judge.advise(motion, count=1, worst=Verdict.OK)
    assert 0.5 < advice.factors[0] < 1.0
    assert verdicts(judge(advice.states)) <= {Verdict.OK, Verdict.UNKNOWN}


def test_no_segment_is_slower_than_needed(
    dynamics: RobotDynamics, motion: Motion, advised: Callable[[int | None], Advice]
) -> None:
    """Brute force: every segment below 1 violates at each factor that is 2 % or more above the advised one."""
    judge = Judge(dynamics)
    advice = advised(None)
    limited = np.flatnonzero(advice.factors < 1.0)
    assert len(limited) >= 3
    for excess in (1.02, 1.05, 1.1, 1.25):
        faster = np.minimum(advice.factors * excess, 1.0)
        states, path_time = motion.at_factors(faster[advice.segment])
        segment = advice.segment[np.clip(np.searchsorted(motion.time, path_time, "right") - 1, 0, None)]
        bad = np.array([decision.contacts[0].verdict is Verdict.VIOLATION for decision in judge(states)])
        assert all(bad[segment == k].any() for k in limited if advice.factors[k] * 1.02 < 1.0)


def test_finer_segments_are_faster_and_each_state_by_itself_is_fastest(
    motion: Motion, advised: Callable[[int | None], Advice]
) -> None:
    durations = [advised(count).times(motion)[1].sum() for count in (1, 7, 0)]
    assert durations[0] > durations[1] > durations[2] > 1.0


@settings(max_examples=15, phases=[Phase.generate])
@given(st.lists(st.floats(0.05, 1.0), min_size=2, max_size=12), st.integers(0, 2**32 - 1))
def test_accelerations_stay_within_the_recorded_ones(levels: list[float], seed: int) -> None:
    t = np.linspace(0.0, 4.0, 401)
    phases = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, 4)
    q, qd = np.sin(t[:, None] + phases), np.cos(t[:, None] + phases)
    motion = Motion(joint_states(q, qd, 100), "sines", {})
    factors = np.repeat(levels, -(-401 // len(levels)))[:401]
    states, path_time = motion.at_factors(factors)
    stamps = np.array([state.stamp_ns for state in states]) / 1e9
    velocity = np.array([state.velocity for state in states])
    acceleration = np.diff(velocity, axis=0) / np.diff(stamps)[:, None]
    largest = np.abs(np.diff(qd, axis=0) * 100).max(axis=0)
    assert np.all(np.abs(acceleration).max(axis=0) <= largest * 1.05)
    on_recorded = np.isclose(path_time[:, None], t, rtol=0.0, atol=1e-9).argmax(axis=0)
    s = np.linalg.norm(velocity[on_recorded], axis=1) / np.linalg.norm(qd, axis=1)
    assert np.all(s <= factors * (1.0 + 1e-6))
    assert np.diff(stamps).max() <= 0.02 + 1e-6


def test_unknown_motion_and_forbidden_speed_get_no_factor(dynamics: RobotDynamics, motion: Motion) -> None:
    states = [*motion.states]
    middle = int(np.abs(motion.qd).max(axis=1).argmax())
    states[middle] = states[middle]._replace(velocity=states[middle].velocity * 5.0)
    advice = Judge(dynamics).advise(Motion(states, "lie", {}))
    (missing,) = np.flatnonzero(np.isnan(advice.factors))
    assert advice.segment[middle] == missing
    assert advice.reasons[missing].startswith("UNKNOWN: tool: ")
    assert not advice.states
    walking = Judge(dynamics, SETTINGS.model_copy(update={"person_speed": 9.0}))
    forbidden = walking.advise(motion)
    assert np.isnan(forbidden.factors).all()
    assert all(reason.startswith(("no speed is allowed: tool: ", "UNKNOWN")) for reason in forbidden.reasons)


@pytest.mark.parametrize("pause_h", [0, 300])
def test_gap_longer_than_the_timeout_gets_no_factor_and_the_others_keep_theirs(
    dynamics: RobotDynamics, motion: Motion, advised: Callable[[int | None], Advice], pause_h: int
) -> None:
    """A long one takes no longer to advise; the robot goes slower through it, which changes those beside it."""
    fastest = int(np.abs(motion.qd).max(axis=1).argmax())
    pause_ns = pause_h * 3600 * 10**9
    later = (state._replace(stamp_ns=state.stamp_ns + pause_ns) for state in motion.states[fastest + 11 :])
    gap = Motion([*motion.states[: fastest + 1], *later], "gap", {})
    advice = Judge(dynamics).advise(gap)
    (missing,) = np.flatnonzero(np.isnan(advice.factors))
    start_s = gap.time[fastest]
    assert advice.segment[fastest] == missing
    assert (
        advice.reasons[missing] == f"UNKNOWN: no joint state for {0.22 + pause_ns / 1e9:.3f} s from {start_s:.3f} s on"
    )
    assert not advice.states
    others = np.arange(len(advice.factors)) != missing
    assert np.all(advice.factors[others] > 0.0)
    assert pause_h or np.all(advice.factors[others] <= advised(None).factors[others] * 1.02)


def test_zeros_need_no_confirmation_only_while_the_positions_stand_still(dynamics: RobotDynamics) -> None:
    crawl = np.linspace(0.0, 0.02, 20)[:, None] * [1.0, 1.0, 0.1, 1.0] + [0.0, 1.2, 0.1, 0.0]
    rest, moving = (Motion(joint_states(q, 0.0 * q, 200), "zeros", {}) for q in (0.0 * crawl + crawl[0], crawl))
    assert np.all(Judge(dynamics).advise(rest).factors == 1.0)
    advice = Judge(dynamics).advise(moving)
    assert np.isnan(advice.factors).all()
    assert all("--velocity from-positions" in reason for reason in advice.reasons)
    true = Motion(moving.states, "zeros", {}, from_positions=True)
    np.testing.assert_allclose(true.qd[:, 0], 0.02 / 19 * 200)
    assert np.all(Judge(dynamics).advise(true).factors == 1.0)


def test_joint_at_rest_in_a_motion_that_is_recorded_from_its_middle_has_a_remedy_that_is_not_in_use(
    dynamics: RobotDynamics,
) -> None:
    crawl = np.linspace(0.0, 0.2, 40)[:, None] * [1.0, 0.0, 0.0, 0.0] + [0.0, 1.2, 0.1, 0.0]
    motion = Motion(joint_states(crawl, 0.0 * crawl), "middle", {}, from_positions=True)
    settings = SETTINGS.model_copy(update={"velocity_source": VelocitySource.FROM_POSITIONS})
    (reason,) = advise(motion, Judge(dynamics)(motion.states), Judge(dynamics), 1, settings).reasons
    assert reason.endswith(
        "joint2 reads zero, not yet confirmed by its position; begin the recording while all joints rest"
    )


@pytest.mark.parametrize("from_positions", [False, True])
def test_turning_joint_that_its_driver_wraps_is_advised_as_one_that_it_does_not(*, from_positions: bool) -> None:
    settings = MonitorSettings(release_time=0.0, contact=ContactType.QUASI_STATIC)
    robot = load_robot(KINOVA, settings)
    names, turns = robot.joint_names, dict(zip(robot.joint_names, robot.periods.tolist(), strict=True))
    judge, time = Judge(RobotDynamics(robot), settings), np.arange(26) / RATE_HZ
    q, qd = [0.0, 2.5, 2.0, 0.5, 1.0, 0.5] + 0.3 * time[:, None], np.full((26, 6), 0.3)
    angle, qd[:, 0] = 3.0 + 0.6 * time, 0.6
    advices = []
    for q[:, 0] in (angle, (angle + np.pi) % (2.0 * np.pi) - np.pi):
        states = [state._replace(names=names) for state in joint_states(q.copy(), qd)]
        advices.append(judge.advise(Motion(states, "turn", turns, from_positions=from_positions), 1))
    smooth, wrapped = advices
    assert 0.0 < smooth.factors[0] < 0.5  # states are added between the recorded ones
    np.testing.assert_allclose(wrapped.factors, smooth.factors)
    assert wrapped.reasons == smooth.reasons


def test_factors_that_were_found_stay_where_others_take_too_many_steps(
    dynamics: RobotDynamics,
    motion: Motion,
    advised: Callable[[int | None], Advice],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("scara_effmass.analysis.advice.ITERATIONS", 3)
    advice = Judge(dynamics).advise(motion)
    is_open = np.isnan(advice.factors)
    assert 0 < is_open.sum() < len(is_open)
    np.testing.assert_allclose(advice.factors[~is_open], advised(None).factors[~is_open], rtol=0.02)
    assert all(("not found within 3 steps" in why) == bad for why, bad in zip(advice.reasons, is_open, strict=True))
    assert not advice.states


def test_states_that_cannot_be_re_timed_are_refused(motion: Motion) -> None:
    first, second = motion.states[:2]
    both = f"{', '.join(JOINTS)} and {', '.join(JOINTS[::-1])}"
    for bad, rule, hint in (
        (second._replace(velocity=np.zeros(0)), "positions and velocities", "; --velocity from-positions takes those"),
        (second._replace(names=JOINTS[::-1]), "the same joints in the same order", f", not {both}$"),
        (second._replace(position=np.full(4, np.nan)), "finite values", "$"),
        (second._replace(stamp_ns=first.stamp_ns), "increasing header stamps", ": 1 of 2 are not later than the one"),
    ):
        with pytest.raises(BagError, match=rf"^run: must have {rule} in all joint states{hint}"):
            Motion([first, bad], "run", {})


def test_labels_of_the_picture_are_in_it(motion: Motion, advised: Callable[[int | None], Advice]) -> None:
    figure = draw_advice(motion, advised(None), "tour")
    figure.draw_without_rendering()
    for axes in figure.axes:
        assert axes.yaxis.label.get_window_extent().height <= axes.get_window_extent().height

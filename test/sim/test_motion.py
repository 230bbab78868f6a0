# SPDX-License-Identifier: Apache-2.0
import math
import random
from itertools import pairwise
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scara_effmass.errors import RobotError
from scara_effmass.model.load import load_robot
from scara_effmass.settings import MonitorSettings
from scara_effmass.sim.measurement import quantize
from scara_effmass.sim.motion import (
    L1,
    L2,
    ElbowConfig,
    JointMove,
    LinearMove,
    Move,
    QuinticScaling,
    TimeScaling,
    TrapezoidalScaling,
    inverse_kinematics,
    joint_positions_at,
    joint_rates,
    sample_moves,
)
from scara_effmass.studies.shipped_bags import RECORDINGS, ReferenceRecording, straight, tour_moves
from scara_effmass.values import FloatArray

ROBOT = load_robot(Path(__file__).parents[2] / "config" / "omron_i4_550l.yaml", MonitorSettings())

elbow_configs = st.sampled_from(list(ElbowConfig))
radii = st.floats(0.02, 0.5499)
angles = st.floats(-math.pi, math.pi)
durations = st.floats(0.1, 5.0)
trapezoids = st.builds(TrapezoidalScaling, st.floats(0.1, 0.5), st.floats(0.05, 0.5), st.floats(3.0, 20.0))
time_scalings = st.one_of(st.builds(QuinticScaling, durations), trapezoids)


def tool_position(q: FloatArray) -> FloatArray:
    """Return x, y [m] of the contact point by Pinocchio, independent of `sim`."""
    data = ROBOT.model.createData()
    frame = ROBOT.contact_frames["tool"]
    pin.framesForwardKinematics(ROBOT.model, data, q)
    return np.asarray(data.oMf[frame].translation[:2])


@given(radii, angles, elbow_configs)
def test_inverse_kinematics_inverts_forward_kinematics(radius: float, angle: float, elbow_config: ElbowConfig) -> None:
    xy = radius * np.array([math.cos(angle), math.sin(angle)])
    q = inverse_kinematics(xy, elbow_config)
    assert tool_position(np.array([*q, 0.1, 0.2])) == pytest.approx(xy, abs=1e-9)
    assert np.sign(q[1]) == elbow_config.value
    assert -math.pi < q[0] <= math.pi


def test_inverse_kinematics_gives_the_papers_pose() -> None:
    assert np.degrees(inverse_kinematics(np.array([0.3, 0.2]), ElbowConfig.RIGHT)) == pytest.approx(
        [-15.35, 98.08], abs=0.005
    )


@given(st.floats(-2.0, 2.0), st.floats(0.05, 2.5), elbow_configs, st.floats(-1, 1), st.floats(-1, 1))
def test_joint_rates_give_the_requested_tool_velocity(
    q1: float, bend: float, elbow_config: ElbowConfig, vx: float, vy: float
) -> None:
    q = np.array([q1, elbow_config.value * bend])
    qd = joint_rates(q, np.array([vx, vy]))
    data = ROBOT.model.createData()
    jacobian = pin.computeFrameJacobian(
        ROBOT.model, data, np.array([*q, 0.0, 0.0]), ROBOT.contact_frames["tool"], pin.LOCAL_WORLD_ALIGNED
    )
    assert jacobian[:2, :2] @ qd == pytest.approx([vx, vy], abs=1e-9)


@pytest.mark.parametrize("xy", [(0.551, 0.0), (0.4, 0.4)])
def test_position_out_of_reach_raises(xy: tuple[float, float]) -> None:
    with pytest.raises(RobotError, match=r"must be in reach, 0\.0000 to 0\.5500 m"):
        inverse_kinematics(np.array(xy), ElbowConfig.RIGHT)


def test_link_lengths_are_those_of_the_shipped_robot() -> None:
    assert tool_position(np.zeros(4)) == pytest.approx([L1 + L2, 0.0])
    assert tool_position(np.array([0.0, math.pi / 2, 0.0, 0.0])) == pytest.approx([L1, L2])


@settings(deadline=None)
@given(time_scalings)
def test_time_scaling_goes_from_0_to_1_and_from_rest_to_rest(time_scaling: TimeScaling) -> None:
    t = np.linspace(0.0, time_scaling.duration, 2001)
    s, rate = time_scaling.at(t)
    assert s[[0, -1]] == pytest.approx([0.0, 1.0], abs=1e-12)
    assert rate[[0, -1]] == pytest.approx([0.0, 0.0], abs=1e-9)
    assert np.all(np.diff(s) >= -1e-12)
    # The mean rate between two samples lies between their rates.
    half, mean = np.abs(np.diff(rate)) / 2.0, (rate[1:] + rate[:-1]) / 2.0
    assert np.all(np.abs(np.diff(s) / t[1] - mean) <= half + 1e-5 / time_scaling.duration)


@given(trapezoids)
def test_trapezoid_stays_within_its_speed_and_acceleration(time_scaling: TrapezoidalScaling) -> None:
    t = np.linspace(0.0, time_scaling.duration, 1001)
    _, rate = time_scaling.at(t)
    speed = rate * time_scaling.length
    assert speed.max() <= time_scaling.speed * (1.0 + 1e-12)
    assert np.abs(np.diff(speed)).max() <= time_scaling.acceleration * t[1] * (1.0 + 1e-6)
    assert speed[500] == pytest.approx(time_scaling.speed)


MOVES: tuple[Move, ...] = (
    JointMove((0.0, 1.0, 0.1, 0.0), (1.0, -1.0, 0.2, 2.0), QuinticScaling(1.0)),
    LinearMove((0.2, 0.3), (0.4, -0.1), ElbowConfig.LEFT, 0.1, QuinticScaling(1.0)),
    LinearMove((0.2, 0.3), (0.4, -0.1), ElbowConfig.RIGHT, 0.1, TrapezoidalScaling(0.447, 0.6, 4.0)),
)


@pytest.mark.parametrize("move", MOVES)
def test_velocities_are_the_derivatives_of_positions(move: Move) -> None:
    step = 1e-6
    t = np.linspace(0.01, move.time_scaling.duration - 0.01, 57)
    _, qd = move.at(t)
    assert (move.at(t + step)[0] - move.at(t - step)[0]) / (2.0 * step) == pytest.approx(qd, abs=1e-6)


def test_linear_move_is_straight_with_constant_orientation() -> None:
    q, _ = MOVES[1].at(np.linspace(0.0, 1.0, 21))
    for row in q:
        x, y = tool_position(row)
        assert (x - 0.2) * -0.4 - (y - 0.3) * 0.2 == pytest.approx(0.0, abs=1e-12)
    assert q[:, 0] + q[:, 1] - q[:, 3] == pytest.approx(np.zeros(21), abs=1e-12)


def test_samples_cover_consecutive_moves() -> None:
    start, end = (
        joint_positions_at((0.3, 0.2), ElbowConfig.RIGHT, 0.1),
        joint_positions_at((0.2, 0.3), ElbowConfig.RIGHT, 0.1),
    )
    q, qd = sample_moves(
        (JointMove(start, end, QuinticScaling(0.5)), JointMove(end, start, QuinticScaling(0.25))), frequency=100.0
    )
    assert q.shape == qd.shape == (75, 4)
    assert q[0] == pytest.approx(start)
    assert q[50] == pytest.approx(end)
    assert qd[[0, 50]] == pytest.approx(np.zeros((2, 4)))


def test_moves_of_the_tour_are_continuous() -> None:
    for before, after in pairwise(tour_moves()):
        end, _ = before.at(np.array([before.time_scaling.duration]))
        start, _ = after.at(np.array([0.0]))
        assert end == pytest.approx(start, abs=1e-9)


def test_straight_recording_is_the_papers_path() -> None:
    q, qd = straight()
    middle = len(q) // 2
    assert tool_position(q[middle]) == pytest.approx([0.3, 0.2], abs=1e-4)
    assert q[:, 1].min() > 0.0
    assert set(q[:, 2].tolist()) == {0.236}
    path = np.array([tool_position(row) for row in q])
    assert path[:, 1] == pytest.approx(np.full(len(q), 0.2), abs=1e-12)
    speed = np.diff(path[:, 0]) * 1000.0
    assert speed[middle - 300 : middle + 300] == pytest.approx(np.full(600, 0.25), abs=1e-9)
    assert np.all(qd[[0, -1]] == 0.0)


@pytest.mark.parametrize("recording", RECORDINGS, ids=lambda recording: recording.name)
def test_recording_is_continuous_within_the_joint_limits(recording: ReferenceRecording) -> None:
    q, qd = recording.motion()
    assert np.all(q >= ROBOT.model.lowerPositionLimit)
    assert np.all(q <= ROBOT.model.upperPositionLimit)
    assert np.all(np.abs(qd) <= ROBOT.model.velocityLimit)
    step = 1.0 / recording.frequency
    assert np.abs(np.diff(q, axis=0) - (qd[1:] + qd[:-1]) / 2.0 * step).max() < 5e-5
    assert np.abs(np.diff(qd, axis=0)).max() / step < 80.0


def test_quantization_error_is_at_most_one_and_a_half_counts() -> None:
    q, qd = np.full((1000, 4), 0.5), np.zeros((1000, 4))
    quantized_q, quantized_qd = quantize(q, qd, random.Random(1))  # noqa: S311
    assert np.abs(quantized_q - q).max() <= 1.5 * 2.0 * math.pi / 2**20
    assert np.abs(quantized_qd - qd).max() <= 1.5e-4
    assert len(np.unique(quantized_q[:, 0])) > 1

# SPDX-License-Identifier: Apache-2.0
import time

import numpy as np
import pytest

from scara_effmass.sim import experiment
from scara_effmass.sim.experiment import CONFIGURATIONS, LiveOutput, LiveSim
from scara_effmass.sim.measurement import ForceSensor
from scara_effmass.sim.motion import ElbowConfig, inverse_kinematics
from scara_effmass.values import FloatArray

START_NS = 1_800_000_000_123_456_789
SECOND = 1_000_000_000
SENSOR = ForceSensor(seed=4)
SECONDS = 8


def make_sim() -> LiveSim:
    return LiveSim(START_NS, sensor=SENSOR, impacts=((CONFIGURATIONS[0], 0.5), (CONFIGURATIONS[1], 7.35)))


@pytest.fixture(scope="module")
def whole() -> LiveOutput:
    return make_sim().advance_to(START_NS + SECONDS * SECOND)


@pytest.mark.parametrize("step_ns", [1_000_000, 7_300_000, 100_000_000])
def test_output_does_not_depend_on_the_time_steps(whole: LiveOutput, step_ns: int) -> None:
    sim = make_sim()
    parts = [sim.advance_to(START_NS + t) for t in range(step_ns, 1_200_000_001, step_ns)]
    force = np.concatenate([part.force for part in parts])
    assert np.array_equal(force, whole.force[: len(force)])
    assert len(force) > 1.15 * 12_800
    firsts = [part.first_sample for part in parts]
    assert firsts == np.cumsum([0, *(len(part.force) for part in parts[:-1])]).tolist()
    states = [state for part in parts for state in part.joint_states]
    assert len(states) == 1.2e9 // step_ns * step_ns // 1_000_000
    for state, expected in zip(states, whole.joint_states, strict=False):
        assert state.stamp_ns == expected.stamp_ns
        assert np.array_equal(state.position, expected.position)
        assert np.array_equal(state.velocity, expected.velocity)


def test_states_are_at_1_khz_without_duplicates(whole: LiveOutput) -> None:
    stamps = [state.stamp_ns - START_NS for state in whole.joint_states]
    assert stamps == [i * 1_000_000 for i in range(SECONDS * 1000)]
    sim = make_sim()
    assert len(sim.advance_to(START_NS + SECOND).joint_states) == 1000
    for now_ns in (START_NS + SECOND, START_NS, START_NS + SECOND + 999_999):
        repeated = sim.advance_to(now_ns)
        assert (repeated.joint_states, repeated.force.size, repeated.carts) == ((), 0, ())


def test_each_impact_uses_its_cart(whole: LiveOutput) -> None:
    first, second = whole.carts[:2]
    assert (first.configuration.name, first.obstacle_mass) == ("300_200", 0.5)
    assert (second.configuration.name, second.obstacle_mass) == ("300_0", 7.35)
    peaks = []
    for cart in whole.carts[:2]:
        sample = round((cart.start_ns - START_NS) / 1e9 * 12_800)
        peaks.append(float(whole.force[sample : sample + 12_800].max()))
    assert peaks == pytest.approx([202.4, 360.4], rel=0.01)


def test_force_does_not_depend_on_the_portion_length(monkeypatch: pytest.MonkeyPatch) -> None:
    forces = []
    for periods in (1, 10):
        monkeypatch.setattr(experiment, "FORCE_PERIODS", periods)
        forces.append(make_sim().advance_to(START_NS + 2_900_000_000).force)
    assert forces[0].max() > 200.0
    assert np.abs(forces[0] - forces[1]).max() < 2 * SENSOR.step


def positions(output: LiveOutput) -> FloatArray:
    return np.array([state.position for state in output.joint_states])


def test_motion_is_continuous_and_within_the_speed_limit(whole: LiveOutput) -> None:
    q = positions(whole)
    assert np.abs(np.diff(q, axis=0)).max() < 2.5e-3
    q1, q12 = q[:, 0], q[:, 0] + q[:, 1]
    tool = 0.275 * np.stack((np.cos(q1) + np.cos(q12), np.sin(q1) + np.sin(q12)), axis=1)
    steps = np.linalg.norm(tool[20:] - tool[:-20], axis=1) / 0.02
    # The cart pushes the robot back; while it catches up, it is faster than its path.
    assert steps.max() < 0.25 * 1.6
    for cart, configuration in zip(whole.carts, CONFIGURATIONS[:2], strict=False):
        row = (cart.start_ns - START_NS) // 1_000_000
        start = inverse_kinematics(np.array(configuration.path_point(-0.1)), ElbowConfig.RIGHT)
        assert q[row, :2] == pytest.approx(start, abs=2e-4)


def test_simulation_is_faster_than_real_time() -> None:
    sim = LiveSim(START_NS)
    sim.advance_to(START_NS)
    started = time.process_time()
    sim.advance_to(START_NS + 6 * SECOND)
    assert time.process_time() - started < 6

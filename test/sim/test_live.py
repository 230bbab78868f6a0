from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from scara_effmass.errors import SettingsError
from scara_effmass.sim import live
from scara_effmass.sim.adc import ForceSensor
from scara_effmass.sim.impact_setup import CONFIGURATIONS
from scara_effmass.sim.live import LiveSettings, LiveSim
from scara_effmass.sim.scara_kinematics import ElbowConfig, inverse_kinematics

if TYPE_CHECKING:
    from scara_effmass.sim.live import LiveOutput
    from scara_effmass.values import FloatArray

START_NS = 1_800_000_000_123_456_789
SECOND = 1_000_000_000
FAST = LiveSettings(impacts=((CONFIGURATIONS[0], 0.5), (CONFIGURATIONS[1], 7.35)), sensor=ForceSensor(seed=4))
SECONDS = 8


def portions(step_ns: int, seconds: float = SECONDS) -> list[LiveOutput]:
    bench = LiveSim(FAST, START_NS)
    times = range(step_ns, round(seconds * SECOND) + 1, step_ns)
    return [bench.advance_to(START_NS + t) for t in times]


@pytest.fixture(scope="module")
def whole() -> LiveOutput:
    return LiveSim(FAST, START_NS).advance_to(START_NS + SECONDS * SECOND)


@pytest.mark.parametrize("step_ns", [1_000_000, 7_300_000, 100_000_000])
def test_it_does_not_depend_on_how_time_is_portioned(whole: LiveOutput, step_ns: int) -> None:
    parts = portions(step_ns, 1.2)
    force = np.concatenate([part.force for part in parts])
    assert np.array_equal(force, whole.force[: len(force)])
    assert len(force) > 1.15 * 12_800
    firsts = [part.first_sample for part in parts]
    assert firsts == np.cumsum([0, *(len(part.force) for part in parts[:-1])]).tolist()
    states = [state for part in parts for state in part.joint_states]
    assert len(states) == 1.2e9 // step_ns * step_ns // 1_000_000
    for one, other in zip(states, whole.joint_states, strict=False):
        assert one.stamp_ns == other.stamp_ns
        assert np.array_equal(one.position, other.position)
        assert np.array_equal(one.velocity, other.velocity)


def test_states_come_each_millisecond_and_nothing_comes_twice(whole: LiveOutput) -> None:
    stamps = [state.stamp_ns - START_NS for state in whole.joint_states]
    assert stamps == [i * 1_000_000 for i in range(SECONDS * 1000)]
    bench = LiveSim(FAST, START_NS)
    assert len(bench.advance_to(START_NS + SECOND).joint_states) == 1000
    for now_ns in (START_NS + SECOND, START_NS, START_NS + SECOND + 999_999):
        again = bench.advance_to(now_ns)
        assert (again.joint_states, again.force.size, again.carts) == ((), 0, ())


def test_each_impact_happens_with_its_cart(whole: LiveOutput) -> None:
    first, second = whole.carts[:2]
    assert (first.setup.configuration.name, first.setup.obstacle_mass) == ("300_200", 0.5)
    assert (second.setup.configuration.name, second.setup.obstacle_mass) == ("300_0", 7.35)
    peaks = []
    for cart in whole.carts[:2]:
        sample = round((cart.stamp_ns - START_NS) / 1e9 * 12_800)
        peaks.append(float(whole.force[sample : sample + 12_800].max()))
    assert peaks == pytest.approx([202.4, 360.4], rel=0.01)


def test_a_contact_does_not_notice_where_a_portion_of_force_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    forces = []
    for frame in (1, 10):
        monkeypatch.setattr(live, "FORCE_PERIODS", frame)
        forces.append(LiveSim(FAST, START_NS).advance_to(START_NS + 2_900_000_000).force)
    assert forces[0].max() > 200.0
    assert np.abs(forces[0] - forces[1]).max() < 2 * FAST.sensor.step


def positions(output: LiveOutput) -> FloatArray:
    return np.array([state.position for state in output.joint_states])


def test_the_robot_goes_on_without_jumps_and_no_faster_than_it_may(whole: LiveOutput) -> None:
    q = positions(whole)
    assert np.abs(np.diff(q, axis=0)).max() < 2.5e-3
    q1, q12 = q[:, 0], q[:, 0] + q[:, 1]
    tool = 0.275 * np.stack((np.cos(q1) + np.cos(q12), np.sin(q1) + np.sin(q12)), axis=1)
    steps = np.linalg.norm(tool[20:] - tool[:-20], axis=1) / 0.02
    # The robot is pushed back by the cart and catches up, so it is for a moment faster than its path.
    assert steps.max() < 0.25 * 1.6
    for cart, configuration in zip(whole.carts, CONFIGURATIONS[:2], strict=False):
        at = (cart.stamp_ns - START_NS) // 1_000_000
        start = inverse_kinematics(np.array(configuration.path_point(-0.1)), ElbowConfig.RIGHT)
        assert q[at, :2] == pytest.approx(start, abs=2e-4)


def test_configurations_of_two_arms_are_refused() -> None:
    left = replace(CONFIGURATIONS[0], elbow_config=ElbowConfig.LEFT)
    for impacts in (((left, 1.0), (CONFIGURATIONS[0], 1.0)), ()):
        with pytest.raises(SettingsError, match="one elbow configuration"):
            LiveSim(replace(FAST, impacts=impacts), START_NS)


def test_it_keeps_ahead_of_real_time() -> None:
    bench = LiveSim(LiveSettings(), START_NS)
    bench.advance_to(START_NS)
    started = time.process_time()
    bench.advance_to(START_NS + 6 * SECOND)
    assert time.process_time() - started < 6

# SPDX-License-Identifier: Apache-2.0
import time
from dataclasses import replace

import numpy as np
import pytest

from scara_effmass.errors import SettingsError
from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.settings import MonitorSettings
from scara_effmass.share import share
from scara_effmass.sim import experiment
from scara_effmass.sim.collision_sim import SpringContact
from scara_effmass.sim.experiment import (
    CONFIGURATIONS,
    Configuration,
    ImpactRun,
    ImpactSetup,
    LiveOutput,
    LiveSim,
    build_sim,
    run_impact,
)
from scara_effmass.sim.measurement import POSITION_STEP, VELOCITY_STEP, ForceSensor
from scara_effmass.sim.motion import ElbowConfig, inverse_kinematics, joint_rates
from scara_effmass.sim.recordings import EPOCH_NS
from scara_effmass.values import FloatArray

SETUP = ImpactSetup(CONFIGURATIONS[0], 2.39)


@pytest.fixture(scope="module")
def run() -> ImpactRun:
    return run_impact(SETUP)


def recorded_force(run: ImpactRun) -> tuple[FloatArray, FloatArray]:
    """Return the times since the start [s] and the samples [N] of a run."""
    times = [
        (block.stamp_ns - run.setup.start_ns) / 1e9 + np.arange(len(block.force)) / block.sample_rate
        for block in run.force_blocks
    ]
    return np.concatenate(times), np.concatenate([block.force for block in run.force_blocks])


def test_impact_is_at_mid_path_at_the_papers_speed(run: ImpactRun) -> None:
    impact = run.impact
    # rest, half of 0.2 m / 0.25 m/s + 0.1 s of ramp
    assert (impact.onset_ns - EPOCH_NS) / 1e9 == pytest.approx(0.3 + 0.45, abs=1e-4)
    assert impact.speed == pytest.approx(0.25, rel=1e-3)


def test_masses_agree_with_the_model(run: ImpactRun) -> None:
    settings = MonitorSettings(contact_points=("tool",))
    index, rest_ns = divmod(run.impact.onset_ns - EPOCH_NS, 1_000_000)
    before = run.joint_states[index]
    at_onset = before.position + before.velocity * rest_ns / 1e9
    rates = joint_rates(at_onset[:2], np.array([0.25, 0.0]))
    along_x = np.array([*rates, 0.0, rates.sum()])
    (masses,) = (
        RobotDynamics(load_robot(share("config", "omron_i4_550l.yaml"), settings)).at(at_onset, along_x).contacts
    )
    assert run.effective_mass == pytest.approx(masses.full, rel=2e-5)
    assert run.reduced_mass == pytest.approx(1.0 / (1.0 / masses.full + 1.0 / 2.39), rel=2e-5)


def free_peak(run: ImpactRun) -> float:
    return SpringContact().free_impact(run.impact.speed, run.reduced_mass)[0]


@pytest.mark.parametrize("configuration", CONFIGURATIONS, ids=lambda c: c.name)
@pytest.mark.parametrize("mass", [0.5, 7.35])
def test_controller_changes_the_peak_force_by_less_than_half_a_percent(
    configuration: Configuration, mass: float
) -> None:
    run = run_impact(replace(SETUP, configuration=configuration, obstacle_mass=mass))
    peak = run.impact.peak_force
    assert peak == pytest.approx(free_peak(run), rel=5e-3)
    assert 160.0 < peak < 860.0
    assert 1e-3 < run.impact.duration < 4e-3
    # Later contacts are weaker: the first one has the peak force.
    assert all(contact.peak_force < 0.9 * peak for contact in run.contacts[1:])


def test_recorded_force_agrees_with_the_true_force(run: ImpactRun) -> None:
    times, force = recorded_force(run)
    impact = run.impact
    assert force.max() == pytest.approx(impact.peak_force, rel=6e-3)
    onset = (impact.onset_ns - EPOCH_NS) / 1e9
    middle = onset + impact.duration / 2.0
    assert times[force.argmax()] == pytest.approx(middle, abs=run.force_blocks[0].clock_residual + 1.0 / 12_800.0)
    inside = (times > onset - 1e-3) & (times < onset + impact.duration + 1.5e-3)
    assert force[inside].sum() / 12_800.0 == pytest.approx(impact.impulse, rel=5e-3)
    assert np.abs(force[times < onset - 5e-3]).max() < 6 * SETUP.sensor.noise


def test_force_blocks_are_consecutive_and_cover_the_run(run: ImpactRun) -> None:
    blocks = run.force_blocks
    assert {len(block.force) for block in blocks} == {1280}
    assert np.all(np.diff([block.first_sample for block in blocks]) == 1280)
    assert blocks[0].stamp_ns - EPOCH_NS < 0.1e9
    assert EPOCH_NS + len(run.joint_states) * 1_000_000 - blocks[-1].stamp_ns < 0.2e9
    gaps = np.diff([block.stamp_ns for block in blocks]) - 0.1e9
    assert np.abs(gaps).max() < 2 * 20e3
    for block in blocks:
        assert block.simulated
        assert "simulated" in block.source
        assert not block.force.flags.writeable
        assert block.tare != 0.0
        assert abs(block.tare) < 0.01
        counts = (block.force + block.tare) / SETUP.sensor.step
        assert np.abs(counts - np.rint(counts)).max() < 1e-6
        assert block.tare_stamp_ns < EPOCH_NS + 0.1e9
        assert block.filter_delay == pytest.approx(38 / 12_800.0, rel=1e-4)


def test_stamp_errors_stay_within_the_clock_residual() -> None:
    for seed in range(5):
        sensor = ForceSensor(clock_error=50e-6, noise=0.0, seed=seed)
        run = run_impact(replace(SETUP, sensor=sensor, seed=seed))
        times, force = recorded_force(run)
        index = int(force.argmax())
        before, top, after = force[index - 1 : index + 2]
        peak_time = times[index] + (after - before) / 2.0 / (2.0 * top - before - after) / 12_800
        middle = (run.impact.onset_ns - EPOCH_NS) / 1e9 + run.impact.duration / 2.0
        assert -20e-6 < peak_time - middle < run.force_blocks[0].clock_residual + 20e-6


def test_force_beyond_the_range_is_marked_saturated() -> None:
    run = run_impact(replace(SETUP, configuration=CONFIGURATIONS[2], obstacle_mass=7.35, contact=SpringContact(6e7)))
    clipped = [block for block in run.force_blocks if block.saturated_samples.size]
    assert len(clipped) == 1
    (block,) = clipped
    assert np.all(block.force[block.saturated_samples] > 2200.0)


def test_joint_states_are_whole_counts_at_1_khz(run: ImpactRun) -> None:
    stamps = [state.stamp_ns for state in run.joint_states]
    assert stamps == [EPOCH_NS + i * 1_000_000 for i in range(len(stamps))]
    q = np.array([state.position for state in run.joint_states])
    qd = np.array([state.velocity for state in run.joint_states])
    for values, step in ((q, POSITION_STEP), (qd, VELOCITY_STEP)):
        assert np.abs(values / step - np.rint(values / step)).max() < 1e-6
    # Velocities are the derivatives of the positions, except for filter and counts.
    assert np.abs(np.diff(q, axis=0) * 1000.0 - qd[1:])[:700, :2].max() < 0.03
    assert run.joint_states[0].names == ("joint1", "joint2", "joint3", "joint4")


def test_seed_determines_the_noise_only(run: ImpactRun) -> None:
    repeated, other = run_impact(SETUP), run_impact(replace(SETUP, seed=1, sensor=ForceSensor(seed=1)))
    assert repeated[3:] == other[3:] == run[3:]
    assert np.array_equal(recorded_force(repeated)[1], recorded_force(run)[1])
    assert not np.array_equal(recorded_force(other)[1][:1000], recorded_force(run)[1][:1000])


def test_cart_out_of_the_path_raises() -> None:
    with pytest.raises(SettingsError, match="not hit"):
        run_impact(replace(SETUP, offset=0.2))


def test_contact_too_short_or_too_damped_raises() -> None:
    with pytest.raises(SettingsError, match=r"the contact lasts 0\.18 ms"):
        build_sim(replace(SETUP, contact=SpringContact(2e8)))
    with pytest.raises(SettingsError, match=r"damping = 1e\+06: must be <= 6803"):
        build_sim(replace(SETUP, contact=SpringContact(damping=1e6)))


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

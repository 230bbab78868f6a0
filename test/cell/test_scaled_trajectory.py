# SPDX-License-Identifier: Apache-2.0
"""A simulated controller that obeys keeps the allowable speed, but for one cycle after a change."""

from typing import NamedTuple

import numpy as np
import pytest

from scara_effmass.cell.scaled_trajectory import ScaledTrajectory
from scara_effmass.cell.speed_scaling import SpeedScaler
from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.settings import Drives, MonitorSettings
from scara_effmass.share import share
from scara_effmass.sim.motion import sample_moves
from scara_effmass.studies.shipped_bags import tour_moves
from scara_effmass.values import FloatArray, Verdict

RATE_HZ = 250
PERIOD_S = 1.0 / RATE_HZ
PERIOD_NS = 1_000_000_000 // RATE_HZ
JOINTS = ("joint1", "joint2", "joint3", "joint4")
SETTINGS = MonitorSettings(contact_points=("tool",), drives=Drives.FREE)


class Run(NamedTuple):
    """One value for each cycle: factor in force, measured and allowable speed [m/s]; UNKNOWN ones are left out."""

    factor: FloatArray
    speed: FloatArray
    allowable_speed: FloatArray
    duration: float
    end: FloatArray

    @property
    def excess(self) -> FloatArray:
        return np.maximum(self.speed - self.allowable_speed, 0.0)


def tour_run(speed_ratio: float | None) -> Run:
    """Follow the tour; without `speed_ratio` at the programmed speed, else controlled."""
    dynamics = RobotDynamics(load_robot(share("config", "omron_i4_550l.yaml"), SETTINGS))
    q, qd = sample_moves(tour_moves(), RATE_HZ)
    trajectory = ScaledTrajectory(JOINTS, np.arange(len(q)) / RATE_HZ, q, qd)
    now_ns, factor, rows = 10**12, 1.0, []
    monitor, scaler = Monitor(dynamics, SETTINGS), SpeedScaler(200_000_000, now_ns)
    scaler.speed_ratio = speed_ratio or 1.0
    while not trajectory.ended:
        now_ns += PERIOD_NS
        decision = monitor.assess(trajectory.advance(factor, PERIOD_S, now_ns), now_ns)
        assert decision is not None
        (contact,) = decision.contacts
        scaler.take(decision, now_ns)
        rows.append((factor, contact.speed, contact.allowable_speed, contact.verdict is not Verdict.UNKNOWN))
        factor = 1.0 if speed_ratio is None else scaler.factor(now_ns)
    columns = np.array(rows)
    factors, speeds, allowable_speeds = columns[columns[:, 3] > 0.0, :3].T
    return Run(factors, speeds, allowable_speeds, len(rows) * PERIOD_S, trajectory.advance(0.0, 0.0, 0).position)


@pytest.fixture(scope="module")
def uncontrolled() -> Run:
    return tour_run(None)


def test_trajectory_at_factor_1_is_the_programmed_one(uncontrolled: Run) -> None:
    q, _ = sample_moves(tour_moves(), RATE_HZ)
    assert uncontrolled.duration == pytest.approx(len(q) * PERIOD_S, abs=2 * PERIOD_S)
    assert np.allclose(uncontrolled.end, q[-1])


def test_tour_violates_without_control(uncontrolled: Run) -> None:
    assert uncontrolled.excess.max() > 0.3
    assert np.count_nonzero(uncontrolled.excess) > 800


@pytest.mark.parametrize(("speed_ratio", "max_excess"), [(1.0, 0.02), (0.95, 0.01)])
def test_controlled_tour_exceeds_by_at_most_one_cycle_of_lag(
    uncontrolled: Run, speed_ratio: float, max_excess: float
) -> None:
    """The factor of a cycle that exceeds was allowed in the cycle before: s_k <= s*_(k-1)."""
    run = tour_run(speed_ratio)
    late = np.flatnonzero(run.excess > 1e-9)
    moving = run.speed > SETTINGS.speed_threshold
    allowed = np.full(len(run.factor), np.inf)
    allowed[moving] = run.factor[moving] * run.allowable_speed[moving] / run.speed[moving]
    assert np.all(run.factor[late] <= allowed[late - 1] * (1.0 + 1e-9))
    assert run.excess.max() < max_excess < 0.06 * uncontrolled.excess.max()
    assert np.allclose(run.end, uncontrolled.end)
    assert run.duration < 1.15 * uncontrolled.duration

# SPDX-License-Identifier: Apache-2.0
"""Contact while the drives push on: a case between free joints and an immovable robot.

Along a contact normal the robot is a mass m_n on a servo spring w_s^2 m_n with the damping ratio zeta, whose reference
moves on at constant velocity. It hits the body part, a mass m_H behind the contact spring k. The peak force is
proportional to the speed, F = v sqrt(mu k), with a reduced mass mu between that of free joints and m_H.
"""

import math
from functools import lru_cache

import numpy as np

from scara_effmass.iso15066.contact import TRANSIENT_S
from scara_effmass.settings import Drives, ServoSettings
from scara_effmass.values import FloatArray

MAX_MOBILITY = 20.0
"""Mobility 1/m_n [1/kg] up to which servo contacts are simulated; above it that of an immovable robot bounds them."""
_MOBILITIES = np.geomspace(1e-4, MAX_MOBILITY, 78)
_TOUCHING = (1e-3, 0.1, 0.5, 2.0, 8.0)
"""Mobilities [1/kg] between the simulated ones, at which a line of a hull is kept; each line is a bound by itself."""
_STEP = 0.1
"""Time step of the simulation, times the larger of the angular frequencies of contact and servo."""
_TERMS = 24
"""Number of terms of the matrix exponential; the last one is below 1e-16."""
_MARGIN = 1.005
"""Factor on the simulated reduced masses, which covers the mobilities between the simulated ones: 0.1 % at most."""

Line = tuple[float, float]
"""alpha [1/kg] and beta of the bound 1/mu(n) >= alpha + beta / m_n."""


@lru_cache(maxsize=1024)  # a study needs one for each servo and body region
def contact_lines(
    drives: Drives, servo: ServoSettings, stiffness: tuple[float, ...], body_mass: tuple[float, ...]
) -> list[tuple[Line, ...]]:
    """Return lower bounds of 1/mu for each contact stiffness k [N/m] and mass m_H [kg]; the largest one applies.

    Free joints have alpha = 1/m_H and beta = 1 (ISO/TS 15066), an immovable robot beta = 0. The lines of a servo lie on
    the lower convex hull of 1/mu over 1/m_n, which `servo_reduced_masses` simulates.
    """
    alphas = [1.0 / mass for mass in body_mass]
    if drives is not Drives.SERVO:
        beta = 1.0 if drives is Drives.FREE else 0.0
        return [((alpha, beta),) for alpha in alphas]
    masses = servo_reduced_masses(np.append(0.0, _MOBILITIES), np.array(stiffness), np.array(body_mass), servo)
    # A lighter robot must not count as hitting harder.
    inverses = 1.0 / np.maximum.accumulate(masses[:, ::-1] * _MARGIN, axis=1)[:, ::-1]
    # An immovable robot carries a free body part along; a clamped one it compresses as far as its reference moves on.
    least = [alpha or float(inverse[0]) for alpha, inverse in zip(alphas, inverses, strict=True)]
    return [_lower_hull(np.maximum(inverse[1:], alpha), alpha) for inverse, alpha in zip(inverses, least, strict=True)]


def _lower_hull(inverse: FloatArray, alpha: float) -> tuple[Line, ...]:
    """Return the lines at `_TOUCHING` of the lower convex hull of 1/mu at `_MOBILITIES`, and of alpha at 1/m_n = 0.

    At a mobility it is the lowest of all chords of a point on the left and one on the right. Lines that are negative at
    1/m_n = 0 bound nothing where the mobility is small. The tangent through the origin replaces them.
    """
    x, y = np.append(0.0, _MOBILITIES), np.append(alpha, inverse)
    lines = [(0.0, float(np.min(inverse / _MOBILITIES)))]
    for touching in _TOUCHING:
        left, right = x <= touching, x > touching
        slopes = (y[right] - y[left, None]) / (x[right] - x[left, None])
        heights = y[left, None] + slopes * (touching - x[left, None])
        i, j = np.unravel_index(np.argmin(heights), heights.shape)
        lines.append((float(y[left][i] - slopes[i, j] * x[left][i]), float(slopes[i, j])))
    lines = [line for line in lines if line[0] >= 0.0]
    return tuple({max(lines, key=lambda line: line[0] + line[1] * a) for a in _TOUCHING})


def servo_reduced_masses(
    mobility: FloatArray, stiffness: FloatArray, body_mass: FloatArray, settings: ServoSettings
) -> FloatArray:
    """Return mu (m, n) [kg] of m contacts (`stiffness` [N/m], `body_mass` [kg]) at n mobilities 1/m_n [1/kg].

    Simulates `TRANSIENT_S` in exact steps (matrix exponential); the contact may open and close. On a clamped body part
    (infinite m_H) the reference moves on for the stopping time and then stands still, which is simulated for a period
    of the servo. The state is the compression, its rate, the servo error and its rate, at unit speed; rates are per
    time step.
    """
    shape = (len(stiffness), len(mobility))
    k, alpha = (np.repeat(values, shape[1]) for values in (stiffness, 1.0 / body_mass))
    a, servo, clamped = np.tile(mobility, shape[0]), 2.0 * math.pi * settings.bandwidth, alpha == 0.0
    stop = np.where(clamped, settings.stopping_time, TRANSIENT_S)
    end = np.where(clamped, settings.stopping_time + 1.0 / settings.bandwidth, TRANSIENT_S)
    dt = _STEP / np.maximum(np.sqrt(k * (a + alpha)), servo)
    contact, free = (
        _exponential(_dynamics(stiffness * dt**2, a, alpha, servo * dt, settings.damping))
        for stiffness in (k, np.zeros_like(k))
    )
    state = np.tile([0.0, 1.0, 0.0, 0.0], (len(k), 1)) * dt[:, None]
    compression = np.zeros(len(k))
    order = np.argsort(-end / dt)  # the contacts with the fewest steps end first
    state, contact, free, unit_speed = state[order], contact[order], free[order], dt[order]
    stops, steps = (np.ceil((times / dt)[order]).astype(int) for times in (stop, end))
    running = len(k)
    for step in range(steps[0]):
        while steps[running - 1] <= step:
            running -= 1
        now = state[:running]
        now[:, 3] += unit_speed[:running] * (stops[:running] == step)  # the reference stops
        touching = (now[:, 0] > 0.0) | ((now[:, 0] == 0.0) & (now[:, 1] > 0.0))
        matrices = np.where(touching[:, None, None], contact[:running], free[:running])
        now[:] = np.einsum("nij,nj->ni", matrices, now)
        np.maximum(compression[:running], now[:, 0], out=compression[:running])
    peak = np.empty(len(k))
    peak[order] = compression / math.cos(_STEP / 2.0)  # the true peak is at most half a step from a sample
    return np.asarray((k * peak**2).reshape(shape))


def _dynamics(k: FloatArray, a: FloatArray, alpha: FloatArray, servo: FloatArray, damping: float) -> FloatArray:
    """Return the system matrices (m, 4, 4) of `servo_reduced_masses`, with the time step as the unit of time."""
    matrices = np.zeros((len(k), 4, 4))
    matrices[:, 0, 1] = matrices[:, 2, 3] = 1.0
    matrices[:, 1, 0], matrices[:, 3, 0] = -k * (a + alpha), -k * a
    matrices[:, 1::2, 2], matrices[:, 1::2, 3] = -(servo[:, None] ** 2), -2.0 * damping * servo[:, None]
    return matrices


def _exponential(matrices: FloatArray) -> FloatArray:
    """Return exp of `matrices` (m, 4, 4) of `_dynamics`, whose rows sum to at most 1 + 2 `_STEP` zeta, by its series.

    scipy.linalg.expm solves each matrix by LAPACK with threads, which takes seconds where the cores are busy.
    """
    term = np.broadcast_to(np.eye(4), matrices.shape)
    result = term.copy()
    for i in range(1, _TERMS + 1):
        term = term @ matrices / i
        result += term
    return result

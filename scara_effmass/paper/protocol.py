"""Conditions of the paper's comparison and experiment. Masses [kg], positions [m], speeds [m/s]."""

import math

OBSTACLES_KG = (0.50, 2.39, 3.72, 7.35)
SHOWN_OBSTACLE_KG = 2.39
"""Obstacle mass of Figs. 12, 14, 15 and 18; the text states it for 12 and 18 only."""
ALONG_X, ALONG_Y = 0.0, math.pi / 2.0
OBLIQUE = math.atan2(0.8, 0.6)
"""phi of the normal (0.6, 0.8, 0) of Fig. 12 (b)."""
POINT_OF_FIG_17 = (0.300, 0.200)
POINTS = (POINT_OF_FIG_17, (0.300, 0.0), (0.300, -0.200))
"""The three impact points. Only the first one is in the paper's text; the other two are chosen here."""
SPEED = 0.250
REPETITIONS = 3
SAMPLE_RATE, SAMPLES = 12_800.0, 10_000


def point_name(point: tuple[float, float]) -> str:
    """Return the point as the paper writes it, in [mm]."""
    x, y = (round(1e3 * coordinate) for coordinate in point)
    return f"({x}, {y})".replace("-", "\N{MINUS SIGN}")

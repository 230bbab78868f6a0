# SPDX-License-Identifier: Apache-2.0
"""Simulate impacts on plates that are turned and tilted against the path.

Effective mass and impact speed are those along the normal n of the plate. The force cell measures the component of the
force along its axis d, the path. Prints the simulated peak force for each plate beside v_n sqrt(mu k) (n . d).
"""

from __future__ import annotations

import math
from itertools import product

from scara_effmass.sim.experiment import CONFIGURATIONS, ImpactSetup, run_impact

OBSTACLE_KG = 2.39
PLATES = {
    "square to the path": (0.0, 0.0),
    "turned by 15 deg": (15.0, 0.0),
    "turned by 30 deg": (30.0, 0.0),
    "tilted up by 30 deg": (0.0, 30.0),
    "turned and tilted by 20 deg": (20.0, 20.0),
}
"""Rotation about the vertical, and tilt out of the horizontal [deg]."""


def main() -> None:
    """Print the table."""
    print(f"{'plate':<28}{'point':<10}{'v_n':>7}{'m_n':>7}{'mu':>7}{'peak':>8}{'expected':>10}{'error':>8}")  # noqa: T201
    for (name, (turned, tilted)), configuration in product(PLATES.items(), CONFIGURATIONS):
        a, b = math.radians(turned), math.radians(tilted)
        surface = (math.cos(b) * math.cos(a), math.cos(b) * math.sin(a), math.sin(b))
        setup = ImpactSetup(configuration, OBSTACLE_KG, surface=surface)
        run = run_impact(setup)
        impact = run.impact
        cell_share = math.cos(a) * math.cos(b)
        expected = impact.speed * math.sqrt(run.reduced_mass * setup.contact.stiffness) * cell_share
        numbers = f"{impact.speed:7.4f}{run.effective_mass:7.3f}{run.reduced_mass:7.3f}{impact.peak_force:8.1f}"
        print(f"{name:<28}{configuration.name:<10}{numbers}{expected:10.1f}{impact.peak_force / expected - 1:+8.2%}")  # noqa: T201


if __name__ == "__main__":
    main()

"""Simulated impacts on plates that are not square to the path, one of them tilted out of the plane.

The plate's normal n decides: the robot presents its mass along n, and the speed that counts is that along n. The force
cell sees the part of the force along its own axis d, the path. Prints, for each plate, the peak that the test bench
gives beside v_n sqrt(mu k) (n . d). All of it is simulated.
"""

from __future__ import annotations

import math
from itertools import product

from scara_effmass.sim.experiment import run_impact
from scara_effmass.sim.impact_setup import CONFIGURATIONS, ImpactSetup

OBSTACLE_KG = 2.39
PLATES = {
    "square to the path": (0.0, 0.0),
    "turned by 15 deg": (15.0, 0.0),
    "turned by 30 deg": (30.0, 0.0),
    "tilted up by 30 deg": (0.0, 30.0),
    "turned and tilted by 20 deg": (20.0, 20.0),
}
"""Turned about the vertical, tilted out of the horizontal [deg]."""


def main() -> None:
    """Print the table."""
    print(f"{'plate':<28}{'point':<10}{'v_n':>7}{'m_n':>7}{'mu':>7}{'peak':>8}{'expected':>10}{'off':>8}")  # noqa: T201
    for (name, (turned, tilted)), configuration in product(PLATES.items(), CONFIGURATIONS):
        a, b = math.radians(turned), math.radians(tilted)
        surface = (math.cos(b) * math.cos(a), math.cos(b) * math.sin(a), math.sin(b))
        setup = ImpactSetup(configuration, OBSTACLE_KG, surface=surface)
        truth = run_impact(setup).truth
        hit = truth.impact
        along_cell = math.cos(a) * math.cos(b)
        expected = hit.speed * math.sqrt(truth.reduced_mass * setup.contact.stiffness) * along_cell
        numbers = f"{hit.speed:7.4f}{truth.effective_mass:7.3f}{truth.reduced_mass:7.3f}{hit.peak_force:8.1f}"
        print(f"{name:<28}{configuration.name:<10}{numbers}{expected:10.1f}{hit.peak_force / expected - 1:+8.2%}")  # noqa: T201


if __name__ == "__main__":
    main()

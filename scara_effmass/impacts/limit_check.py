# SPDX-License-Identifier: Apache-2.0
"""Convert measured peak forces to body regions and compare them with the limits."""

import math
from collections.abc import Iterable
from typing import NamedTuple

from scara_effmass.iso15066 import Limit, reduced_mass


class RegionForce(NamedTuple):
    """Force [N] that an impact would exert on a body `region`, and the `limit` [N] of that region by `criterion`."""

    region: str
    force: float
    limit: float
    criterion: str

    @property
    def exceeds(self) -> bool:
        """Whether the force exceeds the limit."""
        return self.force > self.limit


NO_REGION = RegionForce("", 0.0, 0.0, "")


def region_force(
    limits: Iterable[Limit], peak: float, robot_mass: float, device_mass: float, stiffness: float
) -> RegionForce:
    """Return the region whose force is closest to its limit or exceeds it most.

    The measuring device, of `device_mass` [kg] (infinite: fixed) and `stiffness` [N/m], measured the `peak` [N]. The
    energy mu v^2 / 2 = F^2 / (2 k) of ISO/TS 15066, Annex A, at the same speed v gives the force on a region,
    F_region = F sqrt(mu_region k_region / (mu_device k_device)), where mu = 1 / (1/`robot_mass` + 1/m).
    """
    device = reduced_mass(robot_mass, device_mass) * stiffness
    if not 0.0 < device < math.inf:
        return NO_REGION
    forces = []
    for limit in limits:
        force = peak * math.sqrt(reduced_mass(robot_mass, limit.body_mass_kg) * limit.stiffness_n_m / device)
        forces.append(RegionForce(limit.region, force, limit.permissible_force_n, limit.criterion))
    return max(forces, key=lambda region: region.force / region.limit, default=NO_REGION)


def worst_force(
    limits: Iterable[Limit], peak: float, robot_masses: Iterable[float], device_mass: float, stiffness: float
) -> RegionForce:
    """Return the `region_force` that is largest relative to its limit, for any of `robot_masses` [kg]; 0: unknown."""
    limits = list(limits)
    forces = [region_force(limits, peak, mass, device_mass, stiffness) for mass in robot_masses if mass]
    return max(forces, key=lambda region: region.force / (region.limit or math.inf), default=NO_REGION)

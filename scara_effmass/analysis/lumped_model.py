# SPDX-License-Identifier: Apache-2.0
"""The lumped model: how its effective masses compare with those of the full model."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from scara_effmass.codes import ModelCode
from scara_effmass.iso15066 import BODY_REGIONS
from scara_effmass.reference import RobotDynamics

REGIONS = ("hand_fingers", "chest")
"""Body regions of the reduced masses: a light and a heavy one."""


class ModelComparison(NamedTuple):
    """Lumped over full mass minus 1, over random poses and directions: percentiles, and the value farthest from 0.

    `lighter` is the share of poses in which the lumped mass is lighter, `too_light` that in which it is lighter by more
    than the margin.
    """

    contact_point: str
    quantity: str
    p5: float
    p50: float
    p95: float
    worst: float
    lighter: float
    too_light: float

    @property
    def text(self) -> str:
        """The comparison in one line."""
        sign = "lighter" if self.p50 < 0.0 else "heavier"
        spread = f"P5 {self.p5:+.1%}, P95 {self.p95:+.1%}, worst {self.worst:+.1%}"
        return f"median {abs(self.p50):.1%} {sign} ({spread}), more than the margin lighter in {self.too_light:.0%}"


def compare_models(
    dynamics: RobotDynamics, margin: float, poses: int, seed: int
) -> tuple[list[ModelComparison], list[float]]:
    """Return the comparisons of each contact point, and the share of poses in which it has no lumped mass.

    The random `poses` are uniform over the joint ranges, at most half a turn from zero, their directions over the
    sphere. Without one of the models there are no comparisons.
    """
    rng, model = np.random.default_rng(seed), dynamics.robot.model
    # Mobilities (inverse masses) of both models along the direction, by contact point.
    along: list[list[tuple[float, float]]] = [[] for _ in dynamics.contact_points]
    if dynamics.lumped is None or dynamics.full_reason:
        return [], [1.0 for _ in along]
    models = (ModelCode.LUMPED, ModelCode.FULL)
    lower, upper = np.maximum(model.lowerPositionLimit, -np.pi), np.minimum(model.upperPositionLimit, np.pi)
    configurations, normals = rng.uniform(lower, upper, (poses, model.nv)), rng.normal(size=(poses, 3))
    for q, n in zip(configurations, normals, strict=True):
        for values, contact in zip(along, dynamics.at(q).contacts, strict=True):
            if contact.no_lumped_mass(None) is None:
                lumped, full = (n @ np.array([contact.mobilities[m] for m in models]) @ n / (n @ n)).tolist()
                if min(lumped, full) > 0.0:
                    values.append((lumped, full))
    inverse_body_masses = {"mass": 0.0}
    inverse_body_masses |= {f"reduced mass, {region}": 1.0 / BODY_REGIONS[region].mass_kg for region in REGIONS}
    comparisons = []
    for point, values in zip(dynamics.contact_points, along, strict=True):
        if not values:
            continue
        for quantity, inverse_body_mass in inverse_body_masses.items():
            lumped, full = np.array(values).T + inverse_body_mass
            error = full / lumped - 1.0
            p5, p50, p95 = np.percentile(error, (5.0, 50.0, 95.0)).tolist()
            worst = float(error[np.argmax(np.abs(error))])
            shares = float(np.mean(error < 0.0)), float(np.mean(error < -margin))
            comparisons.append(ModelComparison(point, quantity, p5, p50, p95, worst, *shares))
    return comparisons, [1.0 - len(values) / poses for values in along]

# SPDX-License-Identifier: Apache-2.0
"""The lumped model: how its effective masses compare with those of the full model, and a picture of its masses."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from scara_effmass.codes import ModelCode
from scara_effmass.iso15066 import BODY_REGIONS
from scara_effmass.model.lumping import LumpedModel
from scara_effmass.model.robot import Robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.values import FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

REGIONS = ("hand_fingers", "chest")
"""Body regions of the reduced masses: a light and a heavy one."""
BALL_PT = 9.0
"""Diameter of the ball of a mass of 1 kg in the picture; its volume is in proportion to the mass."""


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


def draw_masses(robot: Robot, lumped: LumpedModel) -> Figure:
    """Return the picture of the masses on the robot at its zero pose, as in Figs. 1 and 3 of the paper."""
    import matplotlib as mpl  # noqa: PLC0415 - an extra, which the comparison does not need

    from scara_effmass.analysis.report import CYCLE, INK, STYLE, new_figure  # noqa: PLC0415

    model = robot.model
    poses = robot.joint_poses(np.clip(np.zeros(model.nv), model.lowerPositionLimit, model.upperPositionLimit))

    def place(joint: int, point: FloatArray) -> FloatArray:
        return np.asarray(poses[joint - 1, :3, 3] + poses[joint - 1, :3, :3] @ point)

    masses = [(mass.mass, place(mass.joint, np.array(mass.point))) for mass in lumped.masses]
    origins = np.vstack([np.zeros(3), poses[:, :3, 3], place(len(poses), robot.tip.translation)])
    everything = np.vstack([origins, *(at for _, at in masses)])
    size = float(np.ptp(everything, axis=0).max()) / 2.0
    with mpl.rc_context(STYLE):
        figure = new_figure(8.0, 7.5, f"Lumped masses of {robot.name}")
        axes = figure.add_subplot(projection="3d")
        axes.plot(*origins.T, color=CYCLE[0], linewidth=4.0, alpha=0.5, label="joint origins, base to tip")
        for joint in range(1, model.njoints):
            reach = 0.25 * size * robot.axis_in_joint_frame(joint)
            ends = np.array([place(joint, -reach), place(joint, reach)])
            axes.plot(*ends.T, color=CYCLE[1], linestyle="--", linewidth=1.2, label="" if joint > 1 else "joint axes")
        labels: dict[tuple[float, ...], str] = {}  # by place: masses on the quill of a SCARA coincide
        for number, (mass, at) in enumerate(masses, start=1):
            key = tuple(np.round(at, 3).tolist())
            labels[key] = f"{labels.get(key, '')}   m_l{number} = {mass:.3g} kg"
            color = INK if mass > 0.0 else CYCLE[3]
            axes.plot(*at[:, None], "o", color=color, markersize=BALL_PT * abs(mass) ** (1.0 / 3.0), alpha=0.8)
        for key, label in labels.items():
            axes.text(*key, label.replace("kg   ", "kg\n   "), fontsize=8.5, va="center")
        centre = (everything.max(axis=0) + everything.min(axis=0)) / 2.0
        axes.set(**{f"{axis}lim": (c - size, c + size) for axis, c in zip("xyz", centre, strict=True)})
        axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]", box_aspect=(1.0, 1.0, 1.0))
        axes.legend(loc="upper right")
    return figure

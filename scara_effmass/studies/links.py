# SPDX-License-Identifier: Apache-2.0
"""Contact anywhere on the arm: what a watched tip misses, and how tight the bound over a link is.

    python -m scara_effmass.studies.links ROBOT [ROBOT ...] --package-dir FOLDER

ROBOT is a URDF with meshes, or a DH file with boxes. Configurations and joint velocities are random, with a seed.
`scara-effmass evidence` simulates impacts on links.
"""

import argparse
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from scara_effmass.errors import RobotError
from scara_effmass.input_files import read_yaml
from scara_effmass.model.dh import DhFile
from scara_effmass.model.hulls import package_folders, shape_points
from scara_effmass.model.load import load_robot
from scara_effmass.model.robot import Robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.reference.hull import point_maps
from scara_effmass.safety import Monitor
from scara_effmass.settings import WHOLE_ARM, MonitorSettings
from scara_effmass.values import FloatArray

POINTS = 2000
"""Random points on each mesh or box of a link, besides its vertices."""
REGIONS = ("hand_fingers", "upper_arm_elbow", "chest")
"""Body regions with a light, a middle and a heavy body part."""


class Missed(NamedTuple):
    """Share of the states in which another link exceeds its limit while the tip is at its own, and by how much.

    `median` and `worst` are ratios of speed and allowable speed, `governing` the share of the states by link.
    """

    share: float
    median: float
    worst: float
    governing: dict[str, float]


def random_motions(robot: Robot, count: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """Return `count` random q and qd (count, n); qd has a normal distribution."""
    rng, model = np.random.default_rng(seed), robot.model
    lower, upper = np.maximum(model.lowerPositionLimit, -np.pi), np.minimum(model.upperPositionLimit, np.pi)
    return rng.uniform(lower, upper, (count, model.nv)), rng.normal(size=(count, model.nv))


def missed(path: Path, settings: MonitorSettings, count: int, seed: int) -> Missed:
    """Return what the first contact point of a robot misses with random motions at the speed that it is allowed."""
    whole = settings.model_copy(update={"contact_points": (WHOLE_ARM,)})
    settings = settings.model_copy(update={"contact_links": ()})
    tip, arm = (Monitor(RobotDynamics(load_robot(path, s)), s) for s in (settings, whole))
    q, qd = random_motions(load_robot(path, settings), count, seed)
    for _ in range(8):  # the allowable speed depends a little on the speed
        contact = tip.assess_configurations(q, qd).contacts[:, 0]
        qd = qd * (contact["allowable_speed"] / contact["speed"])[:, None]
    contacts = arm.assess_configurations(q, qd).contacts
    names = arm.dynamics.contact_points[1:]  # the first is the tip, or its link
    shares = (contacts["speed"] / np.maximum(contacts["allowable_speed"], 1e-9))[:, 1:]
    worst = shares.max(axis=1)
    is_over = worst > 1.0
    governing = {name: float(np.mean(shares.argmax(axis=1)[is_over] == i)) for i, name in enumerate(names)}
    return Missed(float(np.mean(is_over)), float(np.median(worst[is_over])), float(worst.max()), governing)


def surfaces(path: Path, settings: MonitorSettings, seed: int) -> dict[str, tuple[str, FloatArray]]:
    """Return the joint and points (N, 3) [m] on meshes or boxes of each link that moves, in the frame of the joint."""
    rng = np.random.default_rng(seed)
    return _box_surfaces(path, rng) if path.suffix == ".yaml" else _mesh_surfaces(path, settings, rng)


def _box_surfaces(path: Path, rng: np.random.Generator) -> dict[str, tuple[str, FloatArray]]:
    """Return `surfaces` of the boxes in a DH file."""
    file, found = DhFile.model_validate(read_yaml(path, RobotError)), {}
    for row, link in zip(file.joints, file.links, strict=True):
        pose, points = row.link_in_joint(), []
        for box in link.boxes:
            corners = shape_points("box", box.size) + box.center
            points.append(_points_on(corners, ConvexHull(corners).simplices, rng) @ pose.rotation.T + pose.translation)
        if points:
            found[link.name] = row.name, np.vstack(points)
    return found


def _points_on(vertices: FloatArray, triangles: NDArray[np.int64], rng: np.random.Generator) -> FloatArray:
    """Return the vertices (V, 3) of `triangles` (T, 3), and POINTS random points on these."""
    corners = vertices[triangles]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    weights = rng.dirichlet(np.ones(3), POINTS)
    chosen = corners[rng.choice(len(areas), POINTS, p=areas / areas.sum())]
    return np.vstack([vertices, np.einsum("nk,nkd->nd", weights, chosen)])


def _mesh_surfaces(
    path: Path, settings: MonitorSettings, rng: np.random.Generator
) -> dict[str, tuple[str, FloatArray]]:
    """Return `surfaces` of the meshes of a URDF."""
    model, found = pin.buildModelFromUrdf(str(path)), {}
    folders = [str(folder) for folder in package_folders(path, [Path(folder) for folder in settings.package_dirs])]
    shapes = pin.buildGeomFromUrdf(model, str(path), pin.GeometryType.COLLISION, folders).geometryObjects
    for shape in (s for s in shapes if s.parentJoint > 0 and hasattr(s.geometry, "tri_indices")):
        mesh = shape.geometry
        triangles = np.array([[mesh.tri_indices(i)[k] for k in range(3)] for i in range(mesh.num_tris)])
        points = _points_on(np.array(mesh.vertices()), triangles, rng)
        name = model.frames[shape.parentFrame].name
        placed = points @ shape.placement.rotation.T + shape.placement.translation
        found[name] = model.names[shape.parentJoint], placed
    return found


def tightness(path: Path, settings: MonitorSettings, count: int, seed: int) -> dict[str, FloatArray]:
    """Return, per link, the bound of the force over the largest one of the points on it (count,), 1 or more.

    The full mass decides, at the first touch, with a body region by turns.
    """
    ratios: dict[str, list[float]] = {}
    links = surfaces(path, settings, seed)
    for number, region in enumerate(REGIONS):
        update = {"contact_points": (WHOLE_ARM,), "body_regions": (region,), "effective_mass_model": "full"}
        chosen = MonitorSettings.model_validate({**settings.model_dump(), **update, "drives": "free"})
        robot = load_robot(path, chosen)
        dynamics = RobotDynamics(robot)
        q, qd = random_motions(robot, count // len(REGIONS), seed + number)
        contacts = Monitor(dynamics, chosen).assess_configurations(q, qd).contacts
        data = robot.model.createData()
        for row in range(len(q)):
            inverse = np.linalg.inv(robot.mass_matrix(robot.model, data, q[row]))
            pin.computeJointJacobians(robot.model, data, q[row])
            for column, name in enumerate(dynamics.contact_points):
                contact = contacts[row, column]
                if name in links and not contact["worst_direction_used"]:  # one at rest has no direction
                    joint, points = links[name]
                    index = robot.model.getJointId(joint)
                    jacobian = pin.getJointJacobian(robot.model, data, index, pin.ReferenceFrame.LOCAL)
                    mobility = jacobian @ inverse @ jacobian.T
                    most = largest_energy(points, jacobian @ qd[row], mobility, 1.0 / contact["body_mass"])
                    bound = contact["worst_normal_reduced_mass"] * contact["speed"] ** 2
                    ratios.setdefault(name, []).append(float(np.sqrt(bound / most)))
    return {name: np.array(values) for name, values in ratios.items()}


def largest_energy(points: FloatArray, twist: FloatArray, mobility: FloatArray, s: float) -> float:
    """Return the largest v^T (s 1 + A)^-1 v of the points (N, 3) of a link, by the adjugate."""
    maps = point_maps(points)
    v = maps @ twist
    a, b, c = np.moveaxis(maps @ mobility @ maps.transpose(0, 2, 1) + s * np.eye(3), 1, 0)
    adjugate = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=2)
    determinants = np.einsum("ni,ni->n", a, np.cross(b, c))
    return float((np.einsum("ni,nij,nj->n", v, adjugate, v) / determinants).max())


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robot", nargs="+", type=Path)
    parser.add_argument("--package-dir", action="append", default=[])
    parser.add_argument("--states", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    settings = MonitorSettings(package_dirs=tuple(args.package_dir))
    for path in args.robot:
        miss = missed(path, settings, args.states, args.seed)
        links = ", ".join(f"{name} {share:.0%}" for name, share in miss.governing.items() if share >= 0.01)
        print(  # noqa: T201
            f"{path.stem}: tip at its limit, a link above its own in {miss.share:.1%} of {args.states} states, "
            f"{miss.median:.2f} times (worst {miss.worst:.2f}); {links}"
        )
        ratios = tightness(path, settings, args.states, args.seed)
        for name, values in [*ratios.items(), ("all links", np.concatenate([*ratios.values()]))]:
            p50, p95, most = np.percentile(values, [50, 95, 100])
            below = int(np.sum(values < 1.0 - 1e-9))
            print(f"  {name}: median {p50:.3f}, P95 {p95:.3f}, largest {most:.3f}, {below} below 1")  # noqa: T201


if __name__ == "__main__":
    main()

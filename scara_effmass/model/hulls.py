# SPDX-License-Identifier: Apache-2.0
"""Enclose the geometry of each moving link of a URDF in a convex polytope of few vertices.

The polytope contains the geometry: a quantity that is convex over the link, such as the speed of its points, is largest
at a vertex, and no point of the link exceeds it. scipy takes long to import: few points, such as boxes, do without.
"""

from __future__ import annotations

import math
import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple
from urllib.parse import unquote

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from scara_effmass.errors import RobotError
from scara_effmass.model.description import angles_of, numbers_of
from scara_effmass.values import MAX_VERTICES, BoolArray, FloatArray

if TYPE_CHECKING:
    from scipy.spatial import ConvexHull

MIN_THICKNESS_M = 1e-4
"""Extent [m] below which points are flat; each is then replaced by a cube with twice this edge."""
_CORNERS = np.array([(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
_CORNER_PLANES = np.array([sum(1 << axis + 3 * (x > 0.0) for axis, x in enumerate(corner)) for corner in _CORNERS])
"""Planes through each corner of a cube: bits 0 to 2 are the negative sides, bits 3 to 5 the positive ones."""
_MAX_PLANES = 50
"""Largest number of supporting planes, one bit of an integer each."""
_MIN_DIRECTIONS = 2
"""Number of axes along which geometry must extend: a plate does along two."""
_FACETS, _SPREAD = 50, 100
"""Numbers of candidate normals: the largest facets of the convex hull, and directions spread over the sphere."""
_GAP = 1e-7
"""Distance of planes from the points, as a share of their size; it differs so that no four planes meet at a point."""
_GOLDEN = (1.0 + math.sqrt(5.0)) / 2.0
_MIN_GAIN = 5e-3
"""Share by which a change must reduce the sum of squared distances."""
_SIDES, _ARCS = 32, 15
"""Sides of the polygon around a circle, and of that around half a circle, odd."""
_PACKAGE_LEVELS = 4
"""Number of levels of stated folders with packages: those of a repository in a workspace's `src` lie on the third."""
_ROUND = {"radius": 1, "length": 1}
_ATTRIBUTES = {"box": {"size": 3}, "cylinder": _ROUND, "sphere": {"radius": 1}, "capsule": _ROUND}
"""Attributes of the shapes of a URDF, each with its count of numbers, in the order of `settings.Shape.sizes`."""


class LinkHull(NamedTuple):
    """Convex polytope that contains the geometry of one link.

    `joint` is Pinocchio's index of the joint that carries the URDF link `link` in the reduced model, and `vertices`
    (V, 3) [m], at most MAX_VERTICES, are in the frame of that joint. `looseness` is the volume over that of the convex
    hull of the geometry, 1 or more. `source` is "collision" or "visual", by the elements of the URDF, or "stated".
    """

    link: str
    joint: int
    vertices: FloatArray
    looseness: float
    source: str


def urdf_hulls(
    links: Mapping[str, ET.Element],
    origin: str,
    frames: Mapping[str, pin.Frame],
    package_dirs: Sequence[Path],
    sweep: Sequence[Mapping[str, pin.Frame]] = (),
) -> list[LinkHull]:
    """Return the polytope around the geometry of each of the `links` of a URDF that a joint moves.

    `origin` names the URDF in errors, `frames` are the frames of the links in the reduced model, by name, and `sweep`
    those while a gripper closes: the polytope of a finger contains its geometry at all of them. The geometry
    is that of all <collision> elements, or of all <visual> ones for a link without collision; a link without either has
    no polytope. Meshes are searched in `package_dirs`, see `package_folders`. Raises RobotError for a size that is no
    number and for a mesh that cannot be read.
    """
    hulls = []
    for name, link in links.items():
        frame = frames[name]
        source = "visual" if link.find("collision") is None else "collision"
        elements = link.findall(source)
        if frame.parentJoint > 0 and elements:
            where = f"{origin}: link {name}: {source}"
            points = np.concatenate([_points(element, where, package_dirs) for element in elements])
            places = [frame.placement, *(at[name].placement for at in sweep if at[name].placement != frame.placement)]
            placed = np.concatenate([points @ place.rotation.T + place.translation for place in places])
            hulls.append(stated_hull(name, frame.parentJoint, placed)._replace(source=source))
    return hulls


def stated_hull(link: str, joint: int, points: FloatArray) -> LinkHull:
    """Return the polytope around stated `points` (N, 3) [m] of `link`, in the frame of the joint of index `joint`."""
    if len(points) <= MAX_VERTICES and not _are_flat(points):
        return LinkHull(link, joint, points, 1.0, "stated")
    hull = _convex_hull(points)
    vertices = _outer_vertices(hull)
    return LinkHull(link, joint, vertices, max(1.0, _hull_of(vertices).volume / hull.volume), "stated")


def shape_points(kind: str, sizes: Sequence[float]) -> FloatArray:
    """Return points (N, 3) [m] whose convex hull contains a shape about the origin, see `settings.SHAPE_SIZES`."""
    if kind == "box":
        corners: FloatArray = 0.5 * np.array(sizes) * _CORNERS
        return corners
    radius, length = sizes[0], 0.0 if kind == "sphere" else sizes[1]
    return _round_points(radius, 0.5 * length, is_flat=kind == "cylinder")


def package_folders(path: Path | None, stated: Sequence[Path]) -> list[Path]:
    """Return the folders in which to search for the packages and relative file names of the URDF at `path`.

    They are the `stated` ones, the packages in them, then `share` of each prefix in AMENT_PREFIX_PATH, then those above
    the URDF, its own first. A URDF that is no file has none of the last.
    """
    levels = ["*/" * level + "package.xml" for level in range(_PACKAGE_LEVELS)]
    packages = [file.parent for folder in stated for level in levels for file in sorted(folder.glob(level))]
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    above = [] if path is None else [*path.absolute().parents, *path.resolve().parents]
    return list(dict.fromkeys([*stated, *packages, *(Path(prefix, "share") for prefix in prefixes if prefix), *above]))


def outer_vertices(points: FloatArray) -> FloatArray:
    """Return the vertices (V, 3) of a tight convex polytope that contains `points` (N, 3) [m], at most MAX_VERTICES.

    Its planes almost touch the points. They are chosen to minimise the sum over the vertices of the squared distance
    from the convex hull of the points, because a bound over the vertices exceeds that over the points by what they
    stick out. The search starts from the box along the principal axes and adds planes; then it removes each plane in
    turn and adds others, as long as the sum decreases. Points that are flat are thickened first, see MIN_THICKNESS_M.
    """
    return _outer_vertices(_convex_hull(points))


def margin(points: FloatArray, vertices: FloatArray) -> float:
    """Return the distance [m] of the farthest of `points` (N, 3) from a plane around the polytope of `vertices`."""
    planes = _hull_of(vertices).equations
    return float((points @ planes[:, :3].T + planes[:, 3]).max())


def triangles(vertices: FloatArray) -> FloatArray:
    """Return the surface of the polytope around `vertices` (V, 3) as triangles (T, 3, 3), counterclockwise."""
    hull = _hull_of(vertices)
    corners: FloatArray = vertices[hull.simplices]
    a, b, c = np.moveaxis(corners, 1, 0)
    is_inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    corners[is_inward] = corners[is_inward, ::-1]
    return corners


def _points(element: ET.Element, where: str, package_dirs: Sequence[Path]) -> FloatArray:
    """Return points (N, 3) [m] in the frame of the link; the geometry of `element` is inside of their convex hull."""
    shape, origin = element.find("geometry/*"), element.find("origin")
    if shape is None or shape.tag not in {*_ATTRIBUTES, "mesh"}:
        raise RobotError(f"{where}: <geometry>: must be one of {', '.join(_ATTRIBUTES)}, mesh")
    sizes: tuple[float, ...] = ()
    if shape.tag == "mesh":
        points = _mesh_points(shape, where, package_dirs)
    else:
        sizes = tuple(chain(*(numbers_of(shape, name, where, n) for name, n in _ATTRIBUTES[shape.tag].items())))
        points = shape_points(shape.tag, sizes)
    if min(sizes, default=0.0) < 0.0 or np.count_nonzero(np.ptp(points, axis=0)) < _MIN_DIRECTIONS:
        text = " ".join(f"{key}={value!r}" for key, value in shape.attrib.items())
        raise RobotError(f"{where}: <{shape.tag} {text}>: must have sizes > 0 m, but for one thickness")
    if origin is None:
        return points
    rotation = pin.rpy.rpyToMatrix(np.array(angles_of(origin, where)))
    placed: FloatArray = points @ rotation.T + numbers_of(origin, "xyz", where, 3, "0 0 0")
    return placed


def _round_points(radius: float, half: float, *, is_flat: bool) -> FloatArray:
    """Return points (N, 3) around a cylinder of length 2 `half` about z, or around a capsule if it is not `is_flat`.

    They are corners of polygons around the circles, which lie outside of the shape.
    """
    ends = np.array([-1.0, 1.0])
    radii, heights = radius * np.abs(ends), half * ends
    if not is_flat:
        angles = np.linspace(-0.5 * math.pi, 0.5 * math.pi, _ARCS + 1)
        outer = radius / math.cos(0.5 * math.pi / _ARCS)
        radii, heights = outer * np.cos(angles), outer * np.sin(angles) + half * np.sign(angles)
    turns = 2.0 * math.pi * (np.arange(_SIDES) + 0.5) / _SIDES
    circle = np.column_stack([np.cos(turns), np.sin(turns)]) / math.cos(math.pi / _SIDES)
    return np.concatenate(
        [np.column_stack([r * circle, np.full(_SIDES, z)]) for r, z in zip(radii, heights, strict=True)]
    )


def _mesh_points(shape: ET.Element, where: str, package_dirs: Sequence[Path]) -> FloatArray:
    """Return the vertices (N, 3) [m] of a mesh. Raises RobotError."""
    name = shape.get("filename", "")
    scale = np.array(numbers_of(shape, "scale", where, 3, "1 1 1"))
    try:
        file = unquote(name.partition("://")[2]) or name
        package, _, rest = file.partition("/")
        places = chain(
            (folder / file for folder in (*package_dirs, Path("/"))),
            (folder / rest for folder in package_dirs if _is_package(folder, package)),
        )
        path = next(path for path in places if path.is_file())
        if path.suffix.lower() == ".dae":  # Pinocchio's loader ignores the unit, RViz does not
            unit = ET.parse(path).find("{*}asset/{*}unit")  # noqa: S314  a mesh is as trusted as its URDF
            meter = 1.0 if unit is None else float(unit.get("meter", "1"))
            scale *= meter if meter > 0.0 else math.nan
        points = np.array(pin.MeshLoader().load(str(path), scale).vertices(), dtype=float)
    except (StopIteration, OSError):
        remedy = "name the folder of its package, or one above, by package_dirs (--package-dir)"
        raise RobotError(f"{where}: mesh = {name!r}: must be a file that can be read: {remedy}") from None
    except (ValueError, RuntimeError, ET.ParseError):
        points = np.empty((0, 3))
    if not len(points) or not np.isfinite(points).all():
        raise RobotError(f"{where}: mesh = {name!r}: must be a mesh in STL, OBJ, COLLADA or the like")
    return points


def _is_package(folder: Path, name: str) -> bool:
    """Return whether `folder` is the ROS package `name` by its package.xml, or by its own name without one."""
    try:
        found = re.search(r"<name>\s*(.*?)\s*</name>", (folder / "package.xml").read_text("utf-8", errors="replace"))
    except OSError:
        return folder.resolve().name == name
    return found is not None and found[1] == name


def _hull_of(points: FloatArray) -> ConvexHull:
    from scipy.spatial import ConvexHull  # noqa: PLC0415 - takes long

    return ConvexHull(points)


def _are_flat(points: FloatArray) -> bool:
    return bool(np.ptp(points @ _principal_axes(points), axis=0).min() < MIN_THICKNESS_M)


def _convex_hull(points: FloatArray) -> ConvexHull:
    """Return the convex hull of `points` (N, 3), thickened where they are flat."""
    if _are_flat(points):
        points = (points[:, None] + MIN_THICKNESS_M * _CORNERS).reshape(-1, 3)
    return _hull_of(points)


def _principal_axes(points: FloatArray) -> FloatArray:
    """Return the principal axes of `points` (N, 3) as columns (3, 3)."""
    centred = points - points.mean(axis=0)
    axes: FloatArray = np.linalg.eigh(centred.T @ centred)[1]
    return axes


def _outer_vertices(hull: ConvexHull) -> FloatArray:
    corners = hull.points[hull.vertices]
    centre, size = corners.mean(axis=0), np.ptp(corners, axis=0).max()
    vertices = centre + size * _PlaneSearch((corners - centre) / size, _normals(hull)).vertices()
    # No point must be outside, whatever the rounding.
    planes = _hull_of(vertices).equations
    ratios = (corners - centre) @ planes[:, :3].T / -(planes[:, :3] @ centre + planes[:, 3])
    enlarged: FloatArray = centre + max(1.0, ratios.max()) * (vertices - centre)
    return enlarged


def _normals(hull: ConvexHull) -> FloatArray:
    """Return candidate normals (K, 3): first both directions of the principal axes."""
    axes = _principal_axes(hull.points[hull.vertices]).T
    a, b, c = np.moveaxis(hull.points[hull.simplices], 1, 0)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    normals = hull.equations[:, :3]
    _, first, group = np.unique(normals.round(2), axis=0, return_index=True, return_inverse=True)
    largest = np.argsort(-np.bincount(group.ravel(), areas), kind="stable")[:_FACETS]
    # A spiral of golden angles spreads the others evenly.
    z = 1.0 - (2.0 * np.arange(_SPREAD) + 1.0) / _SPREAD
    angle, radius = 2.0 * math.pi * _GOLDEN * np.arange(_SPREAD), np.sqrt(1.0 - z * z)
    spread = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), z])
    return np.concatenate([-axes, axes, normals[first[largest]], spread])


class _PlaneSearch:
    """Choice of supporting planes of `points` (N, 3), of size 1 about the origin, by their `normals` (K, 3)."""

    def __init__(self, points: FloatArray, normals: FloatArray) -> None:
        self._normals = normals
        self._offsets = (points @ normals.T).max(axis=0) + _GAP * (1.0 + _GOLDEN * np.arange(len(normals)) % 1.0)

    def vertices(self) -> FloatArray:
        """Return the vertices (V, 3) of the best polytope."""
        best, planes, vertices = self._completed(list(range(6)))
        failures = 0
        while failures < len(planes):
            total, others, trial = self._completed(planes[1:])
            is_less = len(trial) < len(vertices) or (total == 0.0 and len(others) < len(planes))
            if total < (1.0 - _MIN_GAIN) * best or (total <= best and is_less):
                best, planes, vertices, failures = total, others, trial, 0
            else:
                planes, failures = [*planes[1:], planes[0]], failures + 1
        return vertices

    def _completed(self, planes: list[int]) -> tuple[float, list[int], FloatArray]:
        """Add planes to `planes` while that helps; return the sum of squared distances, all planes and the vertices.

        The sum is infinite if there are too many vertices.
        """
        vertices, masks = 10.0 * _CORNERS, _CORNER_PLANES
        for bit, plane in enumerate(planes):
            vertices, masks = _cut(vertices, masks, self._beyond(vertices, plane), bit + 6)
        while True:
            beyond = self._beyond(vertices)
            squares = _squared_distances(beyond)
            total = float(squares.sum()) if len(vertices) <= MAX_VERTICES else math.inf
            sums = self._sums_after_cut(vertices, masks, beyond, squares)
            plane = int(sums.argmin())
            if not sums[plane] < (1.0 - _MIN_GAIN) * total or len(planes) == _MAX_PLANES:
                return total, planes, vertices
            vertices, masks = _cut(vertices, masks, beyond[:, plane], len(planes) + 6)
            planes = [*planes, plane]

    def _beyond(self, vertices: FloatArray, plane: int | slice = slice(None)) -> FloatArray:
        """Return how far `vertices` (V, 3) are beyond each plane (V, K), or beyond one `plane` (V,)."""
        beyond: FloatArray = vertices @ self._normals[plane].T - self._offsets[plane]
        return beyond

    def _sums_after_cut(
        self, vertices: FloatArray, masks: NDArray[np.int64], beyond: FloatArray, squares: FloatArray
    ) -> FloatArray:
        """Return the sum of squared distances after a cut by each plane (K,), infinite for too many vertices."""
        a, b = np.nonzero(np.triu(_edges(masks)))
        is_out = beyond > 0.0
        is_cut = is_out[a] != is_out[b]
        counts = (~is_out).sum(axis=0) + is_cut.sum(axis=0)
        is_allowed = (counts <= MAX_VERTICES) & is_out.any(axis=0)
        edge, plane = np.nonzero(is_cut & is_allowed)
        a, b = a[edge], b[edge]
        share = beyond[a, plane] / (beyond[a, plane] - beyond[b, plane])
        cuts = vertices[a] + share[:, None] * (vertices[b] - vertices[a])
        added = np.bincount(plane, _squared_distances(self._beyond(cuts)), minlength=len(is_allowed))
        return np.where(is_allowed, squares @ ~is_out + added, math.inf)


def _squared_distances(beyond: FloatArray) -> FloatArray:
    """Return the squared distance (V,) of each vertex from the points, by the plane that it is farthest beyond."""
    distances: FloatArray = np.maximum(beyond.max(axis=1) - 10.0 * _GAP, 0.0)  # the corners of a box need no cut
    return distances * distances


def _edges(masks: NDArray[np.int64]) -> BoolArray:
    """Return which vertices (V, V) are joined by an edge: those on two or more common planes."""
    common = masks[:, None] & masks & ~np.diag(masks)
    is_edge: BoolArray = common & (common - 1) != 0
    return is_edge


def _cut(
    vertices: FloatArray, masks: NDArray[np.int64], beyond: FloatArray, bit: int
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Return the vertices and their planes after a cut by the plane of index `bit`, which they are `beyond` (V,)."""
    is_out = beyond > 0.0
    a, b = np.nonzero(_edges(masks) & ~is_out[:, None] & is_out)
    share = beyond[a] / (beyond[a] - beyond[b])
    cuts = vertices[a] + share[:, None] * (vertices[b] - vertices[a])
    return np.concatenate([vertices[~is_out], cuts]), np.concatenate([masks[~is_out], masks[a] & masks[b] | 1 << bit])

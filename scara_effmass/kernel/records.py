# SPDX-License-Identifier: Apache-2.0
"""Records of the arrays that the compiled functions read and write; their fields are those of numpy's records."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from itertools import accumulate
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from scara_effmass.reference.hull import STEPS
from scara_effmass.values import MAX_VERTICES, ContactAssessment, FloatArray, Mobility6, Vector3

Vector = Annotated[FloatArray, (3,)]
ByteArray = NDArray[np.uint8]
IntArray = NDArray[np.int64]
REASON_SIZE = 12
"""Numbers of a reason, see `state`."""
MIN_NORMAL_COMPONENT = 0.1
"""Smallest share of the speed that counts along a fixed normal: its direction is known to about 6 degrees."""
MAX_JOINTS = 16
"""Largest number of joints; fixed, so that the functions are compiled once for all robots."""
MAX_SUPPORTS = STEPS + 1
MAX_CERTIFICATES = 2 * STEPS + 1
HULL_NONE, HULL_MASS, HULL_KNOWN = 0, 1, 2
"""What a mobility has of a hull: nothing, a mass that is the same everywhere, or the mobility of the link."""
MAX_MOBILITIES = 5
"""Largest number of mobilities: lumped, full, ISO, and the first two with joints that are held."""
PerJoint = Annotated[FloatArray, (MAX_JOINTS,)]
PerJointInt = Annotated[IntArray, (MAX_JOINTS,)]
Columns3 = Annotated[FloatArray, (MAX_JOINTS, 3)]
Square = Annotated[FloatArray, (MAX_JOINTS, MAX_JOINTS)]
_TYPES: dict[object, Any] = {float: "f8", int: "i8", bool: "?", FloatArray: "f8", IntArray: "i8"}


@dataclass
class Point:
    """Contact point at `place` [m] in the frame of `joint`, which can move in `rank` dimensions, or a whole link.

    That is the convex hull of `vertices`, in the same frame. `rotation` is that of the frame that names it. Of its
    cases, `weakest` (an index) permits the smallest force. The mobility [1/kg] of the body part for which the place of
    the contact on a link is chosen is `hull_mobility`.
    """

    joint: int
    rank: int
    place: Vector
    rotation: Annotated[FloatArray, (3, 3)]
    weakest: int
    hull_mobility: float
    vertex_count: int
    vertices: Annotated[FloatArray, (MAX_VERTICES, 3)]


@dataclass
class Case:
    """One limit, as `iso15066.ContactCase` has it, with the `region` (an index) and its nominal values."""

    region: int
    is_pressure: bool
    force: float
    stiffness: float
    rate: float
    obstacle_mobility: float
    drive_time: float
    nominal_stiffness: float
    body_mass: float
    line_count: int
    lines: Annotated[FloatArray, (8, 2)]


@dataclass
class Setup:
    """Robot and settings, one record of them.

    Per joint: index of its `parent` (-1 the base), its pose there, its `axis` in its own frame, its effort limit. Per
    model, lumped and full, and joint: inertia of its link about `lever`, in its frame; the rotors are in `armature` and
    `coupling`. Fixed contact normal and test direction are in the frame of a joint. `model` is a
    `kernel.codes.Model`, `normal` a `kernel.codes.Normal`.
    """

    joints: int
    parent: PerJointInt
    is_revolute: PerJointInt
    is_massless: PerJointInt
    effort: PerJoint
    rotation: Annotated[FloatArray, (MAX_JOINTS, 3, 3)]
    place: Annotated[FloatArray, (MAX_JOINTS, 3)]
    axis: Annotated[FloatArray, (MAX_JOINTS, 3)]
    mass: Annotated[FloatArray, (2, MAX_JOINTS)]
    armature: Annotated[FloatArray, (2, MAX_JOINTS)]
    lever: Annotated[FloatArray, (2, MAX_JOINTS, 3)]
    inertia: Annotated[FloatArray, (2, MAX_JOINTS, 3, 3)]
    coupling: Square
    normal_joint: int
    normal_vector: Vector
    has_test: bool
    test_joint: int
    test_vector: Vector
    has_lumped: bool
    has_full: bool
    is_lumped_regular: bool
    has_masses: bool
    is_scara: bool
    lumped_suffices: bool
    is_free: bool
    is_servo: bool
    joints_are_coupled: bool
    joints_are_held: bool
    clamps: bool
    needs_gravity: bool
    counts_person: bool
    has_person_direction: bool
    person_joint: int
    person_vector: Vector
    model: int
    normal: int
    iso_mass: float
    mass_cap: float
    mass_factor: float
    model_margin: float
    speed_threshold: float
    max_acceleration: float
    reaction_time: float
    amplification: float
    person_speed: float
    speed_uncertainty: float
    warn_ratio: float
    external_force: float
    min_alpha: float
    gravity: Vector


@dataclass
class Mobility:
    """Mobility of one mass model for the contact normals of the settings, and how it changes with the pose.

    `along` to `rank` are scalars of A: along the velocity, that of its adjugate, and its invariants. The
    others are its `PoseChange` in `change_rank` dimensions, 0 without one: direction and speed of the contact point, A,
    the `powers` K M^-1 J^T, and the accelerations with `free` and with `held` joint velocities; `either_way`: their
    opposites, too. `shown`, `opposed` (`held`), `error` and `error_root` are its `Acceleration`, and `heaviest` the
    largest effective mass; if it `is_scalar`, `speed_rate` counts in place of the vectors.

    `hull` to `own_roots` (scratch from `support` on) are of the hull of a link: the steps begin at `vertex`, and the
    `square` of the speed of the contact is that of the fastest one over `speed_ratio`.
    """

    along: float
    adjugate: float
    matrix_trace: float
    minors: float
    determinant: float
    rank: int
    change_rank: int
    direction: Vector
    speed: float
    matrix: Annotated[FloatArray, (6,)]
    powers: Annotated[FloatArray, (3, 3)]
    free: Vector
    held: Vector
    either_way: bool
    shown: Vector
    opposed: Vector
    error: float
    error_root: float
    heaviest: float
    is_scalar: bool
    speed_rate: float
    hull: int
    vertex_count: int
    vertex: int
    square: float
    speed_ratio: float
    energy_of_arm: float
    twist: Annotated[FloatArray, (1, 6)]
    twist_mobility: Annotated[FloatArray, (6, 6)]
    vertices: Annotated[FloatArray, (MAX_VERTICES, 3)]
    support: Annotated[IntArray, (MAX_SUPPORTS,)]
    weights: Annotated[FloatArray, (MAX_SUPPORTS,)]
    starts: Annotated[FloatArray, (MAX_SUPPORTS,)]
    blocks: Annotated[FloatArray, (MAX_SUPPORTS, MAX_SUPPORTS, 3, 3)]
    system: Annotated[FloatArray, (MAX_SUPPORTS, MAX_SUPPORTS, 3, 3)]
    pivots: Annotated[FloatArray, (MAX_SUPPORTS, 6)]
    forces: Annotated[FloatArray, (MAX_SUPPORTS, 3)]
    rows: Annotated[FloatArray, (6, 9)]
    met_roots: Annotated[FloatArray, (MAX_VERTICES,)]
    certificates: int
    of_arm: Annotated[FloatArray, (MAX_CERTIFICATES,)]
    fastest: Annotated[FloatArray, (MAX_CERTIFICATES,)]
    own_roots: Annotated[FloatArray, (MAX_CERTIFICATES, MAX_VERTICES)]


@dataclass
class Principal:
    """Mobility along its eigenvectors (the rows of `axes`), for the velocity of a person.

    `values` are the eigenvalues, the smallest first; the point does not move along the first `unreached` axes. There,
    too: velocity of the contact point (`direction`, `speed`), direction to the person (`towards`), and, if the pose
    `changes`, accelerations and `lessening` = -dA/dt. The smallest eigenvalue counts as at least `floor`. `speed_rate`,
    `across` and the errors are its `Acceleration`: along n, across it, and those of the mobility, at least
    `least_mobility`. `matrix` is scratch.
    """

    values: Vector
    axes: Annotated[FloatArray, (3, 3)]
    matrix: Annotated[FloatArray, (3, 3)]
    unreached: int
    changes: bool
    floor: float
    speed: float
    direction: Vector
    towards: Vector
    free: Vector
    held: Vector
    lessening: Annotated[FloatArray, (3, 3)]
    speed_rate: float
    across: Vector
    error: float
    error_root: float
    least_mobility: float


@dataclass
class Work:
    """Intermediate results of one joint state, of both models where the first dimension is 2.

    `jacobian`, its rate, and what M makes of it have one row per joint, up to that of the contact point. `twists`,
    `twist_mobility`, `energies` (both models, free and held), the `fastest_square` of the speeds of its vertices and
    its `worst_vertex` are of the link that is assessed as a whole.
    """

    qd: PerJoint
    errors: PerJoint
    rotations: Annotated[FloatArray, (MAX_JOINTS, 3, 3)]
    places: Annotated[FloatArray, (MAX_JOINTS, 3)]
    axes: Annotated[FloatArray, (MAX_JOINTS, 6)]
    axis_rates: Annotated[FloatArray, (MAX_JOINTS, 6)]
    velocities: Annotated[FloatArray, (MAX_JOINTS, 6)]
    inertias: Annotated[FloatArray, (2, MAX_JOINTS, 10)]
    composites: Annotated[FloatArray, (2, MAX_JOINTS, 10)]
    momenta: Annotated[FloatArray, (2, MAX_JOINTS, 6)]
    flows: Annotated[FloatArray, (MAX_JOINTS, 12)]
    diagonals: Annotated[FloatArray, (2, MAX_JOINTS)]
    factors: Annotated[FloatArray, (2, MAX_JOINTS, MAX_JOINTS)]
    has_coriolis: Annotated[IntArray, (2,)]
    coriolis: Annotated[FloatArray, (2, MAX_JOINTS, MAX_JOINTS)]
    bias: Annotated[FloatArray, (2, MAX_JOINTS)]
    gravity: PerJoint
    jacobian: Columns3
    jacobian_rate: Columns3
    uncoupled: Annotated[FloatArray, (2, MAX_JOINTS, 3)]
    twists: Annotated[FloatArray, (MAX_JOINTS, 6)]
    twist_mobility: Annotated[FloatArray, (4, 6, 6)]
    energies: Annotated[FloatArray, (4,)]
    vertices: Annotated[FloatArray, (MAX_VERTICES, 3)]
    fastest_square: float
    worst_vertex: int
    responses: Columns3
    masses: Vector
    worst: Vector
    any_normal: Annotated[Any, (3,), Mobility]
    mobilities: Annotated[Any, (MAX_MOBILITIES,), Mobility]
    principals: Annotated[Any, (MAX_MOBILITIES,), Principal]
    least_mobilities: Annotated[FloatArray, (MAX_MOBILITIES,)]
    growths: Annotated[FloatArray, (MAX_MOBILITIES,)]
    accelerations: Annotated[FloatArray, (MAX_MOBILITIES,)]


@cache
def dtype_of(record: type) -> np.dtype[np.void]:
    """Return numpy's type of a record class above; its fields are attributes in plain Python, too."""
    fields = []
    for name, hint in get_type_hints(record, include_extras=True).items():
        kind, shape, *records = get_args(hint) if get_origin(hint) is Annotated else (hint, ())
        kind = records[0] if records else kind
        fields.append((name, _TYPES.get(kind) or dtype_of(kind), shape))
    return np.dtype((np.record, fields))


CASE, POINT, SETUP, WORK = dtype_of(Case), dtype_of(Point), dtype_of(Setup), dtype_of(Work)
Contact = Any
"""A record of CONTACT; numpy has no type for its fields."""
_SHAPES: dict[object, tuple[int, ...]] = {Vector3: (3,), Mobility6: (6,)}
_NOT_NUMBERS = {"contact_point", "reason_code"}
"""Fields that are the column of an array, or part of the reason."""
FIELDS = {
    name: (REASON_SIZE,) if name == "reason" else _SHAPES.get(kind, ())
    for name, kind in get_type_hints(ContactAssessment).items()
    if name not in _NOT_NUMBERS
}
"""Shape of each field of a contact, all float64, in order: texts are codes of `scara_effmass.codes`, `reason` is as in
`state`."""
_SIZES = [math.prod(shape) for shape in FIELDS.values()]
PLACES = dict(zip(FIELDS, accumulate(_SIZES, initial=0), strict=False))
"""Place of each field in the numbers of a contact."""
CONTACT = np.dtype((np.record, [(name, "f8", shape) for name, shape in FIELDS.items()]))
"""numpy's type of a `ContactAssessment`."""

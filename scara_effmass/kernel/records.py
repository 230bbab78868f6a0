# SPDX-License-Identifier: Apache-2.0
"""Records of the arrays that the compiled functions read and write; their fields are those of numpy's records."""

from __future__ import annotations

from dataclasses import dataclass
from struct import Struct
from typing import Annotated, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from scara_effmass.settings import MassModel
from scara_effmass.values import FloatArray

Vector = Annotated[FloatArray, (3,)]
ByteArray = NDArray[np.uint8]
IntArray = NDArray[np.int64]
MIN_NORMAL_COMPONENT = 0.1
"""Smallest share of the speed that counts along a fixed normal: its direction is known to about 6 degrees."""
LUMPED, FULL, ISO, LARGEST, AUTO = range(5)
HELD = 2
"""Index in `Work.responses` of those with joints that are held, of either model."""
MODELS = tuple(MassModel)
"""Settings in the order of `Setup.model`; the first three are models, too."""
WORST, VELOCITY, FIXED = range(3)
NORMALS = ("worst", "velocity")
"""Settings in the order of `Setup.normal`."""
WHY_SETTING, WHY_HEAVY, WHY_LIGHTER, WHY_LARGEST, WHY_FULL = range(1, 6)
"""Why a model decides. From WHY_FULL on: no lumped mass for a reason below; as many further on: nor a full mass."""
NOT_THERE, NOT_DEFINITE, MASSLESS, MASSLESS_JOINT = range(4)
"""Why there is no lumped mass; from MASSLESS_JOINT on the joint that moves the contact point, but no lumped mass."""
NO_MASSES, NO_FULL, NO_FORCE, TOO_LIGHT, NO_WORST, NO_LUMPED = 1, 2, 3, 4, 7, 10
"""Why the verdict is UNKNOWN; TOO_LIGHT and NO_WORST plus the model, NO_LUMPED plus the reason above."""
OK, WARN, VIOLATION = 1.0, 2.0, 3.0
FAST, CLOSE, LIGHT, CLAMPED = 1, 2, 4, 8
"""Values of `Row.remark`."""
MAX_JOINTS = 16
"""Largest number of joints; fixed, so that the functions are compiled once for all robots."""
WIDTH = 32
"""Numbers of a mobility, see `functions`."""
MAX_MOBILITIES = 5
"""Largest number of mobilities: lumped, full, ISO, and the first two with joints that are held."""
PerJoint = Annotated[FloatArray, (MAX_JOINTS,)]
PerJointInt = Annotated[IntArray, (MAX_JOINTS,)]
Rows3 = Annotated[FloatArray, (3, MAX_JOINTS)]
Square = Annotated[FloatArray, (MAX_JOINTS, MAX_JOINTS)]
_TYPES: dict[object, str] = {float: "f8", int: "i8", bool: "?", FloatArray: "f8", IntArray: "i8"}


@dataclass
class Point:
    """Contact point at `place` [m] in the frame of `joint`, which can move in `rank` dimensions."""

    joint: int
    rank: int
    place: Vector


@dataclass
class Case:
    """One limit, as `iso15066.speed_limit.Case` has it, with the `region` (an index) and its nominal values."""

    region: int
    is_pressure: bool
    force: float
    stiffness: float
    rate: float
    obstacle_mobility: float
    max_mu: float
    drive_time: float
    nominal_stiffness: float
    obstacle_mass: float
    line_count: int
    lines: Annotated[FloatArray, (8, 2)]


@dataclass
class Setup:
    """Robot and settings, one record of them.

    Per joint: index of its `parent` (-1 the base), its pose there, its `axis` in its own frame, its effort limit. Per
    model, lumped and full, and joint: inertia of its link about `lever`, in its frame; the rotors are in `armature` and
    `coupling`. Fixed contact normal and test direction are in the frame of a joint. `model` is an index of MODELS,
    `normal` of NORMALS, or FIXED.
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
    model: int
    normal: int
    iso_mass: float
    mass_cap: float
    mass_factor: float
    model_margin: float
    speed_threshold: float
    person_speed: float
    closing_speed: float
    warn_ratio: float
    external_force: float
    weakest_force: float
    min_alpha: float
    min_stiffness: float
    max_drive_time: float
    gravity: Vector


@dataclass
class Row:
    """Assessment of one contact point at one joint state: numbers of `ContactAssessment`, in one type.

    Indices of the texts in `safety.reasons`: `body_region`, `criterion`, `mass_model`, `mass_model_reason` and `error`.
    `remark` is 1 too fast, 2 close to the limit, plus 4 for a model that is too light; 8 clamped with too much force.
    """

    direction: Vector
    speed: float
    effective_mass: float
    lumped_mass: float
    full_mass: float
    iso_mass: float
    worst_direction_mass: float
    body_mass: float
    reduced_mass: float
    stiffness: float
    predicted_force: float
    allowable_speed: float
    margin: float
    smallest_singular_value: float
    worst_normal_reduced_mass: float
    force_bound: float
    clamping_force: float
    lumped_mobility: Annotated[FloatArray, (6,)]
    full_mobility: Annotated[FloatArray, (6,)]
    test_direction: Vector
    test_effective_mass: float
    worst_direction_used: float
    mass_capped: float
    verdict: float
    body_region: float
    criterion: float
    mass_model: float
    mass_model_reason: float
    error: float
    remark: float


@dataclass
class Work:
    """Intermediate results of one joint state, of both models where the first dimension is 2."""

    qd: PerJoint
    rotations: Annotated[FloatArray, (MAX_JOINTS, 3, 3)]
    places: Annotated[FloatArray, (MAX_JOINTS, 3)]
    motions: Annotated[FloatArray, (MAX_JOINTS, 18)]
    inertias: Annotated[FloatArray, (2, MAX_JOINTS, 10)]
    composites: Annotated[FloatArray, (2, MAX_JOINTS, 22)]
    momenta: Annotated[FloatArray, (2, MAX_JOINTS, 6)]
    diagonals: Annotated[FloatArray, (2, MAX_JOINTS)]
    factors: Annotated[FloatArray, (2, MAX_JOINTS, MAX_JOINTS)]
    coriolis: Annotated[FloatArray, (2, MAX_JOINTS, MAX_JOINTS)]
    has_coriolis: Annotated[IntArray, (2,)]
    gravity: PerJoint
    jacobian: Rows3
    jacobian_rate: Rows3
    rate: Rows3
    responses: Annotated[FloatArray, (3, 3, MAX_JOINTS)]
    masses: Vector
    worst: Vector
    any_normal: Annotated[FloatArray, (3, WIDTH)]
    mobilities: Annotated[FloatArray, (MAX_MOBILITIES, WIDTH)]
    max_masses: Annotated[FloatArray, (MAX_MOBILITIES,)]
    growths: Annotated[FloatArray, (MAX_MOBILITIES,)]


def dtype_of(record: type) -> np.dtype[np.void]:
    """Return numpy's type of a record class above."""
    fields = []
    for name, hint in get_type_hints(record, include_extras=True).items():
        kind, shape = get_args(hint) if get_origin(hint) is Annotated else (hint, ())
        fields.append((name, _TYPES[kind], shape))
    return np.dtype(fields)


ROW = dtype_of(Row)
"""numpy's type of `Row`, all of float64."""
ROW_LAYOUT, CODE_LAYOUT = Struct("35d72s"), Struct("9d")
"""Layout of a row: its numbers in order up to `test_effective_mass`, and the bytes of the codes from then on."""
OFFSETS = {name: field[1] // 8 for name, field in (ROW.fields or {}).items()}
"""Place of each field in a row."""

# SPDX-License-Identifier: Apache-2.0
"""Load a robot from Denavit-Hartenberg rows in YAML, such as `config/omron_i4_550l.yaml`."""

from __future__ import annotations

import math
import reprlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pinocchio as pin
from pydantic import AfterValidator, Field, Strict, ValidationError, field_validator, model_validator
from pydantic_core import PydanticCustomError

from scara_effmass.codes import Assumption
from scara_effmass.errors import RobotError
from scara_effmass.input_files import read_yaml
from scara_effmass.model.description import (
    MAX_ANGLE_RAD,
    PARALLEL,
    RobotDescription,
    StatedLink,
    contact_point,
    inertia_tensor,
    principal_moments,
    rotor_inertia,
    watched_links,
)
from scara_effmass.model.hulls import shape_points, stated_hull
from scara_effmass.settings import WHOLE_ARM, MonitorSettings
from scara_effmass.settings.loading import FrozenSettings, broken_rule, nearest
from scara_effmass.values import FloatArray


def _bounded(value: float) -> float:
    if abs(value) > 1e6:
        raise ValueError("must be at most 1e6 in magnitude")
    return value


Number = Annotated[float, Strict(), AfterValidator(_bounded)]
"""A finite number; a magnitude above a million [SI] is a typing error and would overflow later."""
Point = tuple[Number, Number, Number]
Extent = Annotated[Number, Field(gt=0.0)]
Inertia = Number | tuple[Number, Number, Number, Number, Number, Number]


class _Strict(FrozenSettings):
    @model_validator(mode="before")
    @classmethod
    def _check_keys(cls, rows: object) -> object:
        for key in rows if isinstance(rows, dict) else ():
            if key not in cls.model_fields:
                comma = ": a number must have a decimal point, as 5.1" * isinstance(key, (int, float))
                rule = comma or nearest(str(key), cls.model_fields)
                raise PydanticCustomError("key", "{text}", {"text": f"{key}: unknown: {rule.lstrip(': ')}"})
        return rows


class DhJoint(_Strict):
    """One standard DH row, Rz(theta) Tz(d) Tx(a) Rx(alpha), with position and speed limits [rad or m, per second]."""

    name: str = Field(min_length=1)
    type: Literal["revolute", "prismatic"]
    a: Number
    alpha: Number
    d: Number = 0.0
    theta: Number = 0.0
    lower: Number
    upper: Number
    max_speed: Number = Field(gt=0.0)
    max_effort: Number = Field(0.0, ge=0.0)
    """Effort limit [N m, N]; 0: unknown."""
    torque_constant: Number = Field(1.0, gt=0.0)
    """Torque [N m, N] per unit of effort in the joint states, as of a motor current; 1: the effort is the torque."""
    armature: Number | None = Field(None, ge=0.0)

    @model_validator(mode="after")
    def _ordered(self) -> DhJoint:
        for key in ("alpha", "theta"):
            if abs(angle := getattr(self, key)) > MAX_ANGLE_RAD:
                raise ValueError(
                    f"{key} = {angle:g}: must be in radians: {angle:g} degrees are {math.radians(angle):.9g}"
                )
        if self.lower >= self.upper:
            raise ValueError(f"lower = {self.lower}: must be < upper = {self.upper}")
        return self

    def link_in_joint(self) -> pin.SE3:
        """Return the pose of the link frame (on the axis, x along the common normal) in the moving joint frame."""
        c, s = math.cos(self.theta), math.sin(self.theta)
        rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return pin.SE3(rotation, np.array([0.0, 0.0, self.d]))

    def next_in_joint(self) -> pin.SE3:
        """Return the pose of the DH frame, in which the next joint moves, in the moving joint frame."""
        c, s = math.cos(self.alpha), math.sin(self.alpha)
        rotation = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
        return self.link_in_joint() * pin.SE3(rotation, np.array([self.a, 0.0, 0.0]))


class DhBox(_Strict):
    """Box of `size` along the axes of the link frame [m]."""

    center: Point
    size: tuple[Extent, Extent, Extent]


class DhLink(_Strict):
    """Mass [kg], centre of mass [m] and, where known, inertia about it [kg m2], in the link frame.

    `boxes` contain the link; without any, `whole_arm` does not watch it.
    """

    name: str = Field(min_length=1)
    mass: Number = Field(ge=0.0)
    com: Point
    inertia: Inertia | None = None
    boxes: tuple[DhBox, ...] = ()

    @field_validator("inertia")
    @classmethod
    def _has_no_negative_moment(cls, inertia: Inertia | None) -> Inertia | None:
        principal_moments(_tensor(inertia))
        return inertia

    @property
    def body(self) -> pin.Inertia:
        """Pinocchio's inertia of the link, in the link frame."""
        return pin.Inertia(self.mass, np.array(self.com), _tensor(self.inertia))


class DhPayload(DhLink):
    """End-effector and workpiece, in the last DH frame."""

    name: str = "payload"
    com: Point = (0.0, 0.0, 0.0)


class DhContactPoint(_Strict):
    """Point `at` [m] in the frame of `link` (name, or number from 1), as its com. A list is in the last DH frame."""

    link: str | Annotated[int, Strict()] = ""
    at: Point

    @model_validator(mode="before")
    @classmethod
    def _from_list(cls, value: object) -> object:
        return {"at": value} if isinstance(value, (list, tuple)) else value


class DhFile(_Strict):
    """Content of a DH file."""

    robot: str = Field(min_length=1)
    base_frame: str = Field(min_length=1)
    joints: tuple[DhJoint, ...] = Field(min_length=1)
    links: tuple[DhLink, ...] = Field(min_length=1)
    rotor_inertia: tuple[tuple[Number, ...], ...] | None = None
    payload: DhPayload = DhPayload(mass=0.0)
    contact_points: dict[str, DhContactPoint] = Field(min_length=1)
    defaults_hold: tuple[str, ...] = ()
    """Names of the assumptions that hold for this robot as the defaults of the parameters have them."""

    @property
    def has_boxes(self) -> bool:
        """Whether a link or the payload has boxes."""
        return any(link.boxes for link in (*self.links, self.payload))

    @field_validator("defaults_hold")
    @classmethod
    def _names_assumptions(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        known = [assumption.name.lower() for assumption in Assumption]
        for name in names:
            if name not in known:
                raise ValueError(f"{name!r}: {nearest(name, known)}")
        return names

    @model_validator(mode="after")
    def _consistent(self) -> DhFile:
        names = [joint.name for joint in self.joints]
        if len(set(names)) != len(names):
            raise ValueError(f"joint names {names}: must differ")
        if len(self.links) != len(self.joints):
            raise ValueError(f"{len(self.links)} links for {len(self.joints)} joints: must be one link per joint")
        for name, point in self.contact_points.items():
            self.link_number(point.link, f"contact_points.{name}")
        if self.rotor_inertia is not None:
            if any(joint.armature is not None for joint in self.joints):
                raise ValueError("rotor_inertia: must be absent where a joint states its armature")
            rows = self.rotor_inertia
            if {len(rows), *map(len, rows)} != {len(names)} or rows != tuple(zip(*rows, strict=True)):
                raise ValueError(f"rotor_inertia: must be a symmetric {len(names)} x {len(names)} matrix")
        if any(abs(math.sin(joint.alpha)) > PARALLEL for joint in self.joints):
            for name, inertia in (
                *((link.name, link.inertia) for link in self.links),
                ("payload", self.payload.inertia),
            ):
                if isinstance(inertia, float) and inertia > 0.0:
                    raise ValueError(
                        f"inertia of {name} = {inertia}: must be six numbers, because the axes are not parallel"
                    )
        return self

    def link_number(self, link: str | int, key: str) -> int:
        """Return the number of `link`, 0 for an empty name. Raises ValueError that names `key` for any other."""
        names = [link.name for link in self.links]
        if link == "":
            return 0
        numbers = [number for number, name in enumerate(names, start=1) if link in {number, name}]
        if len(numbers) == 1:
            return numbers[0]
        rule = f"1 to {len(names)}, or one of {', '.join(names)}"
        if numbers:
            rule = "a number, because several links have this name"
        raise ValueError(f"{key}: link = {link!r}: must be {rule}")


def load_dh(path: Path, settings: MonitorSettings) -> RobotDescription:
    """Return what the DH file at `path` states, with the contact points of `settings` (default: all of the file).

    Raises RobotError for a file that cannot be used, and for settings that the file must state itself.
    """
    locked = settings.locked_joints
    if locked:
        raise RobotError(f"locked_joints = {locked!r}: must be unset for a DH file: set it in {path}")
    rows = read_yaml(path, RobotError)
    if isinstance(rows, dict) and any(isinstance(node, dict) and "ros__parameters" in node for node in rows.values()):
        raise RobotError(
            f"{path}: holds parameters of {', '.join(map(str, rows))}: must be a robot; use --params for it"
        )
    try:
        _set_limits(rows, settings.position_limits)
        file = DhFile.model_validate(rows)
    except ValidationError as error:
        # A list, where a number may stand as well, first fails because it is no number.
        first = min(error.errors(), key=lambda item: item["type"] == "float_type" and isinstance(item["input"], list))
        raise RobotError(f"{path}: {_place(first['loc'], rows)}{broken_rule(first)}") from None
    return _described(file, str(path), settings)


def _set_limits(content: Any, limits: Mapping[str, tuple[float, float]]) -> None:  # noqa: ANN401 - unchecked YAML
    """Replace lower and upper of the joints that `limits` name."""
    joints = content.get("joints") if isinstance(content, dict) else ()
    for row in joints if isinstance(joints, list) else ():
        if isinstance(row, dict) and str(row.get("name")) in limits:
            row["lower"], row["upper"] = limits[str(row["name"])]


def _place(keys: Sequence[int | str], rows: Any) -> str:  # noqa: ANN401 - what the file holds
    """Return the place of an error, counted from 1 and with the name: "links 2 (forearm): mass"."""
    place = ""
    for key in keys:
        if isinstance(rows, dict):
            place += f"{': ' if place.endswith(')') else '.' if place else ''}{key}"
            rows = rows.get(key)
        elif isinstance(rows, list) and isinstance(key, int):
            rows = rows[key] if key < len(rows) else None
            name = reprlib.repr(rows.get("name", "")).strip("'") if isinstance(rows, dict) else ""
            place += f" {key + 1}{f' ({name})' if name else ''}"
    return place or "file"


def _described(file: DhFile, origin: str, settings: MonitorSettings) -> RobotDescription:
    model = pin.Model()
    model.name = file.robot
    parent = 0
    placement = pin.SE3.Identity()
    for row, link in zip(file.joints, file.links, strict=True):
        joint = pin.JointModelRZ() if row.type == "revolute" else pin.JointModelPZ()
        limits = (np.array([value]) for value in (row.max_effort, row.max_speed, row.lower, row.upper))
        parent = model.addJoint(parent, joint, placement, row.name, *limits)
        model.appendBodyToJoint(parent, link.body, row.link_in_joint())
        placement = row.next_in_joint()
    model.appendBodyToJoint(parent, file.payload.body, placement)
    stated = np.diag([math.nan if row.armature is None else row.armature for row in file.joints])
    if file.rotor_inertia is not None:
        stated = np.array(file.rotor_inertia)
    joints = [row.name for row in file.joints]
    points = []
    for name, number, at in _contact_points(file, origin, settings.contact_points):
        pose = file.joints[number - 1].link_in_joint() if number else placement
        points.append((name, number or parent, pose * pin.SE3(np.eye(3), np.array(at))))
    hulls: dict[str, FloatArray] = {}
    notes: list[str] = []
    by_default = not settings.contact_points and settings.contact_normal == "worst" and file.has_boxes
    if by_default or WHOLE_ARM in settings.contact_points:
        hulls, watched, notes = _hulls(file, origin, settings, [name for name, *_ in points])
        points += watched
    return RobotDescription(
        origin=origin,
        base_frame=file.base_frame,
        model=model,
        links=[StatedLink(link.name, link.mass, np.array(link.com), _tensor(link.inertia)) for link in file.links],
        rotors=rotor_inertia(joints, stated, "the DH file", settings.armature, origin),
        payload_mass=file.payload.mass,
        contact_points=points,
        tip=placement,
        notes=notes,
        stated=frozenset(_stated(file)),
        hulls=hulls,
        torque_constants=np.array([row.torque_constant for row in file.joints]),
    )


def _hulls(
    file: DhFile, origin: str, settings: MonitorSettings, taken: Collection[str]
) -> tuple[dict[str, FloatArray], list[tuple[str, int, pin.SE3]], list[str]]:
    """Return the hulls of the links that `whole_arm` watches, these as contact points, and notes. Raises RobotError."""
    hulls, points = dict[str, FloatArray](), list[tuple[str, int, pin.SE3]]()
    if not file.has_boxes:
        raise RobotError(f"{origin}: contact_points = {WHOLE_ARM!r}: no link has boxes: state them, or name points")
    bodies = [
        (link, joint, row.link_in_joint())
        for joint, (row, link) in enumerate(zip(file.joints, file.links, strict=True), 1)
    ]
    bodies += [(file.payload, len(file.joints), file.joints[-1].next_in_joint())]
    shaped = [link.name for link, *_ in bodies if link.boxes]
    watched, notes = watched_links(shaped, settings.contact_links, origin)
    for link, joint, pose in (body for body in bodies if body[0].boxes and body[0].name in watched):
        if link.name in taken:
            raise RobotError(f"{origin}: contact_points.{link.name}: must have another name than the link")
        corners = np.concatenate([shape_points("box", box.size) + box.center for box in link.boxes])
        hulls[link.name] = stated_hull(link.name, joint, corners @ pose.rotation.T + pose.translation).vertices
        points.append((link.name, joint, pose))
    return hulls, points, notes


def _stated(file: DhFile) -> Iterator[Assumption]:
    """Yield the assumptions that `file` states."""
    yield Assumption.CONTACT_POINTS
    if "payload" in file.model_fields_set:
        yield Assumption.PAYLOAD
    for name in file.defaults_hold:
        yield Assumption[name.upper()]


def _contact_points(file: DhFile, origin: str, entries: Sequence[str]) -> Iterator[tuple[str, int, Point]]:
    """Yield name, number of the link (0: the last DH frame) and position of each contact point."""
    if {*entries} <= {WHOLE_ARM}:
        for name, point in file.contact_points.items():
            yield name, file.link_number(point.link, name), point.at
    for entry in dict.fromkeys(entry for entry in entries if entry != WHOLE_ARM):
        name, link, at = contact_point(entry)
        if link:
            try:
                yield name, file.link_number(link, f"contact_points = {entry!r}"), at
            except ValueError as error:
                raise RobotError(f"{origin}: {error}") from None
        elif name in file.contact_points:
            stated = file.contact_points[name]
            yield name, file.link_number(stated.link, entry), stated.at
        else:
            names = ", ".join(file.contact_points)
            raise RobotError(f"{origin}: contact_points = {entry!r}: must be one of {names}, or NAME=LINK: X Y Z")


def _tensor(inertia: Inertia | None) -> FloatArray:
    if inertia is None:
        return np.zeros((3, 3))
    if isinstance(inertia, float):
        # A planar robot states I_zz alone; equal halves for I_xx and I_yy satisfy the triangle inequality.
        return np.diag([inertia / 2.0, inertia / 2.0, inertia])
    return inertia_tensor(inertia)

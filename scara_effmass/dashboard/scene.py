# SPDX-License-Identifier: Apache-2.0
"""The robot in 3-D: links, hulls in the colours of their verdicts, velocity, worst normal and mass ellipsoid."""

import numpy as np
from nicegui import ui
from nicegui.elements.scene.scene_object3d import Object3D

from scara_effmass.cell.status import CellStatus
from scara_effmass.model.hulls import triangles
from scara_effmass.model.poses import mass_ellipsoid, pose_geometry, rotation_to
from scara_effmass.model.robot import Robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.reference.mobility import Mobility
from scara_effmass.safety.joint_state_adapter import JointStateAdapter
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import (
    NO_MOBILITY,
    VERDICT_COLORS,
    ZERO_VECTOR,
    ContactAssessment,
    FloatArray,
    Verdict,
    mobility_matrix,
)

LINK_COLOR, JOINT_COLOR, ELLIPSOID_COLOR = "#8a96a3", "#4a5561", "#3a86c8"
VELOCITY_COLOR, NORMAL_COLOR = "#17202a", "#b0006d"
MAX_MASS = 20.0
"""Largest mass that the ellipsoid shows [kg]: in a direction that no joint moves, the mass is infinite."""
HULL_OPACITY = 0.4
STL = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
"""Triangle of a binary STL file."""
_DOWN = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Turns y, the axis of a cylinder in three.js, to z."""


def stl_of(robot: Robot) -> list[bytes]:
    """Return each hull of a link in the frame of its joint, as STL, in the order of the contacts."""
    files = []
    for name in (name for name in robot.contact_frames if name in robot.hulls):
        corners = triangles(robot.hulls[name])
        facets = np.zeros(len(corners), STL)
        facets["corners"] = corners
        files.append(bytes(80) + np.uint32(len(facets)).tobytes() + facets.tobytes())
    return files


class RobotScene:
    """Scene of one robot; sizes follow its reach."""

    def __init__(self, dynamics: RobotDynamics, settings: MonitorSettings) -> None:
        self._dynamics = dynamics
        self._adapter = JointStateAdapter(dynamics.robot.joint_names, settings)
        self._size = size = max(dynamics.robot.reach, 0.1)
        self._pool: dict[str, list[Object3D]] = {}
        self._used: dict[str, int] = {}
        self._hulls: list[Object3D] = []
        label = 'role=img aria-label="robot in 3-D with velocity, worst normal and mass ellipsoid"'
        camera = ui.scene.perspective_camera(fov=40)
        self._scene = ui.scene(
            grid=(max(round(4 * size), 1), 20), camera=camera, background_color="#f1f3f5", fps=10
        ).props(label)
        self._scene.move_camera(1.4 * size, -1.3 * size, 1.3 * size, 0.3 * size, 0.0, 0.0, duration=0)
        with self._scene as scene:  # the base
            scene.cylinder(0.1 * size, 0.1 * size, 0.02 * size).rotate_R(_DOWN.tolist()).material(JOINT_COLOR)
            for number in range(len(dynamics.robot.hulls)):
                self._hulls.append(scene.stl(f"/hulls/{number}.stl").visible(value=False))
        self.note = ""

    def update(self, status: CellStatus, now_ns: int) -> None:
        """Draw the latest pose; `note` states why there is none, or what else there is to say."""
        self._used = {}
        state = status.joint_state
        q = "no joint state yet" if state is None else self._adapter.positions(state)
        age_ns = now_ns - status.joint_state_at_ns
        if isinstance(q, str):
            self.note = q
        else:
            self.note = f"as of {age_ns / 1e9:.0f} s ago: no joint state since" if age_ns > 1_000_000_000 else ""
            self._draw(status, q, is_current=age_ns <= 1_000_000_000)
        for hull in self._hulls:
            hull.visible(value=not isinstance(q, str))
        for kind, objects in self._pool.items():
            for unused in objects[self._used.get(kind, 0) :]:
                unused.visible(value=False)

    def _draw(self, status: CellStatus, q: FloatArray, *, is_current: bool) -> None:
        geometry = pose_geometry(self._dynamics.robot, self._dynamics.lumped, q)
        is_current = is_current and status.verdict is not Verdict.UNKNOWN
        contacts = {contact.contact_point: contact for contact in status.contacts}
        thin = 0.02 * self._size
        for start, end in geometry.segments:
            self._line("link", start, end, thin, LINK_COLOR)
            for point in (start, end):
                self._object("joint", JOINT_COLOR).move(*point.tolist()).scale(1.3 * thin)
        for hull, (name, pose) in zip(self._hulls, geometry.hulls.items(), strict=True):
            verdict = contacts[name].verdict if is_current and name in contacts else Verdict.UNKNOWN
            hull.move(*pose.translation.tolist()).rotate_R(pose.rotation.tolist())
            hull.material(VERDICT_COLORS[verdict], HULL_OPACITY)
        for name, at in geometry.places(status.contacts).items():
            contact = contacts.get(name)
            if contact is None:
                self.note = f"the monitor has no contact point {name}: give the dashboard its robot and parameters"
            self._object("contact", VELOCITY_COLOR).move(*at).scale(1.6 * thin)
            if is_current and contact is not None and contact.verdict is not Verdict.UNKNOWN:
                self._draw_motion(contact, np.array(at))

    def _draw_motion(self, contact: ContactAssessment, at: FloatArray) -> None:
        """Draw velocity, mass ellipsoid and worst normal of a contact."""
        if not np.isfinite((*contact.direction, *contact.mobility)).all():
            return
        direction = np.array(contact.direction)
        if contact.direction != ZERO_VECTOR:
            self._arrow("velocity", at, at + contact.speed * self._size * direction, VELOCITY_COLOR)
        if contact.mobility == NO_MOBILITY:
            return
        mobility = mobility_matrix(contact.mobility)
        masses, axes = mass_ellipsoid(mobility, MAX_MASS)
        ellipsoid = self._object("ellipsoid", ELLIPSOID_COLOR, 0.3).move(*at.tolist()).rotate_R(axes.tolist())
        ellipsoid.scale(*(0.06 * self._size * np.sqrt(masses)).tolist())
        if contact.direction != ZERO_VECTOR:
            alpha = 1.0 / contact.body_mass if contact.body_mass else 0.0
            normal = Mobility.of_matrix(mobility, direction, 3).worst_normal(alpha)
            self._arrow("normal", at, at + 0.25 * self._size * normal, NORMAL_COLOR)

    def _arrow(self, kind: str, start: FloatArray, end: FloatArray, color: str) -> None:
        """Draw a line whose end is a cone."""
        thin = 0.01 * self._size
        self._line(kind, start, end, thin, color)
        along = end - start
        length = float(np.linalg.norm(along))
        if length > thin:
            self._line(f"{kind} tip", end, end + along / length * 6.0 * thin, 2.5 * thin, color)

    def _line(self, kind: str, start: FloatArray, end: FloatArray, radius: float, color: str) -> None:
        length = float(np.linalg.norm(end - start))
        if length > 1e-6:
            x, y, z = ((end - start) / length).tolist()
            rotation = rotation_to((x, y, z)) @ _DOWN
            shape = self._object(kind, color).move(*(0.5 * (start + end)).tolist())
            shape.rotate_R(rotation.tolist()).scale(radius, length, radius)

    def _object(self, kind: str, color: str, opacity: float = 1.0) -> Object3D:
        """Return the next object of a kind, visible, and made if there are too few."""
        objects, index = self._pool.setdefault(kind, []), self._used.get(kind, 0)
        self._used[kind] = index + 1
        if index == len(objects):
            with self._scene as scene:
                if kind in {"joint", "contact", "ellipsoid"}:
                    made: Object3D = scene.sphere(1.0)
                else:
                    made = scene.cylinder(0.0 if kind.endswith("tip") else 1.0, 1.0, 1.0, 16)
            objects.append(made.material(color, opacity))
        return objects[index].visible()

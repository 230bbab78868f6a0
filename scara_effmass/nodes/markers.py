# SPDX-License-Identifier: Apache-2.0
"""Markers of a cell for RViz and Foxglove: links, lumped masses, and each contact point with its verdict.

Everything is drawn in the base frame, so a viewer needs neither a robot description nor transforms.
"""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, Quaternion, Vector3
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker

from scara_effmass.model.poses import PoseGeometry, mass_ellipsoid, quaternion
from scara_effmass.reference.mobility import Mobility
from scara_effmass.values import (
    NO_MOBILITY,
    VERDICT_COLORS,
    ZERO_VECTOR,
    ContactAssessment,
    FloatArray,
    Verdict,
    mobility_matrix,
)
from scara_effmass.wire.cdr import NS, sec_and_nanosec

LINK_COLOR = "#9AA5B1"
MASS_COLOR = "#56B4E9"
ALLOWABLE_COLOR = "#0072B2"
NORMAL_COLOR = "#CC79A7"
LINK_WIDTH_M = 0.02
MASS_DENSITY = 7850.0
"""Density [kg/m3] of the spheres of the lumped masses: that of steel."""
MAX_MASS = 10.0
"""Largest mass [kg] of an axis of the ellipsoid: where no joint moves the contact point, the mass is infinite."""
HULL_ALPHA = 0.35
NORMAL_LENGTH_M = 0.15
TEXT_HEIGHT_M = 0.04
TEXT_LIFT_M = 0.2


def robot_markers(geometry: PoseGeometry) -> Iterator[Marker]:
    """Yield the links as lines, and the lumped masses as spheres of steel of that mass."""
    links = geometry.segments.reshape(-1, 3)
    yield _marker(Marker.LINE_LIST, "links", 0, LINK_COLOR, (LINK_WIDTH_M, 0.0, 0.0), points=links)
    for index, (mass, place) in enumerate(geometry.lumped_masses):
        diameter = (6.0 * max(mass, 0.0) / (np.pi * MASS_DENSITY)) ** (1.0 / 3.0)
        if diameter:
            yield _marker(Marker.SPHERE, "lumped_masses", index, MASS_COLOR, (diameter,) * 3, place)


def contact_markers(
    contacts: Iterable[ContactAssessment],
    places: Mapping[str, tuple[float, float, float]],
    contact_normal: str,
    surfaces: Mapping[str, FloatArray],
    *,
    ellipsoid_scale: float,
    arrow_scale: float,
    simulated: bool,
) -> Iterator[Marker]:
    """Yield what is known of each contact: verdict, hull, mass ellipsoid, velocity, allowable speed, worst normal.

    `contact_normal` is that of the decision. `places` are the positions [m] of the contact points; others only have
    a text above the base, and UNKNOWN only its text and hull. `surfaces` are the triangles (T, 3, 3) [m] of hulls. The
    ellipsoid has a semi-axis of `ellipsoid_scale` [m] at 1 kg, an arrow `arrow_scale` [m] at 1 m/s. Texts of contact
    points at the same place are stacked, so that none covers another.
    """
    drawn: list[FloatArray] = []
    for index, contact in enumerate(contacts):
        color = VERDICT_COLORS[contact.verdict]
        x, y, z = places.get(contact.contact_point, (0.0, 0.0, index * TEXT_LIFT_M))
        at = np.array([x, y, z])
        lift = TEXT_LIFT_M * (1 + sum(np.linalg.norm(at - other) < TEXT_HEIGHT_M for other in drawn))
        drawn.append(at)
        text = (x, y, z + (lift if z > -TEXT_LIFT_M else -lift))  # away from the base
        label = _label(contact, simulated=simulated)
        yield _marker(Marker.TEXT_VIEW_FACING, "verdict", index, color, (0.0, 0.0, TEXT_HEIGHT_M), text, text=label)
        if contact.contact_point in surfaces:
            corners = surfaces[contact.contact_point].reshape(-1, 3)
            yield _marker(Marker.TRIANGLE_LIST, "hulls", index, color, (1.0,) * 3, alpha=HULL_ALPHA, points=corners)
        is_finite = np.isfinite([*contact.direction, *contact.mobility]).all()
        if contact.verdict is Verdict.UNKNOWN or contact.contact_point not in places or not is_finite:
            continue
        direction, mobility = np.array(contact.direction), mobility_matrix(contact.mobility)
        if contact.mobility != NO_MOBILITY:
            masses, axes = mass_ellipsoid(mobility, MAX_MASS)
            sizes = 2.0 * ellipsoid_scale * np.sqrt(masses)
            ellipsoid = _marker(Marker.SPHERE, "mass_ellipsoid", index, color, sizes.tolist(), (x, y, z), alpha=0.4)
            ellipsoid.pose.orientation = Quaternion(**dict(zip("xyzw", quaternion(axes), strict=True)))
            yield ellipsoid
        if contact.direction == ZERO_VECTOR:
            continue
        velocity, allowable = (arrow_scale * v * direction for v in (contact.speed, contact.allowable_speed))
        yield _arrow("velocity", index, color, 0.012, at, velocity)
        if contact.allowable_speed > 0.0:
            yield _arrow("allowable_speed", index, ALLOWABLE_COLOR, 0.006, at, allowable)
        if contact_normal == "worst" and contact.mobility != NO_MOBILITY:
            alpha = 1.0 / contact.body_mass if contact.body_mass else 0.0
            normal = Mobility.of_matrix(mobility, direction, 3).worst_normal(alpha)
            yield _arrow("worst_normal", index, NORMAL_COLOR, 0.006, at, NORMAL_LENGTH_M * normal)


def stamped(marker: Marker, frame: str, stamp_ns: int, lifetime_ns: int) -> Marker:
    """Return `marker` in `frame`, with the stamp of its state; it vanishes after `lifetime_ns` without another one."""
    marker.header.frame_id = frame
    marker.header.stamp.sec, marker.header.stamp.nanosec = sec_and_nanosec(stamp_ns)
    marker.lifetime.sec, marker.lifetime.nanosec = divmod(lifetime_ns, NS)
    return marker


def _label(contact: ContactAssessment, *, simulated: bool) -> str:
    title = f"{contact.contact_point or 'robot'}: {contact.verdict.name}{' (simulated)' * simulated}"
    if contact.verdict is Verdict.UNKNOWN:
        return f"{title}\n{contact.reason}"
    numbers = f"{contact.speed_text}, {contact.effective_mass:.2f} kg ({contact.mass_model})"
    return f"{title}\n{numbers}\n{contact.reason}".strip()


def _arrow(namespace: str, index: int, color: str, width_m: float, at: FloatArray, vector: FloatArray) -> Marker:
    return _marker(Marker.ARROW, namespace, index, color, (width_m, 2.0 * width_m, 0.0), points=[at, at + vector])


def _marker(
    kind: int,
    namespace: str,
    index: int,
    color: str,
    scale: Iterable[float],
    at: tuple[float, float, float] = ZERO_VECTOR,
    *,
    alpha: float = 1.0,
    points: Iterable[FloatArray] = (),
    text: str = "",
) -> Marker:
    marker = Marker(type=kind, ns=namespace, id=index, text=text)
    marker.color = ColorRGBA(**_rgb(color), a=alpha)
    marker.scale = _xyz(Vector3, scale)
    marker.pose.position = _xyz(Point, at)
    marker.points = [_xyz(Point, point.tolist()) for point in points]
    return marker


def _xyz(kind: type, values: Iterable[float]) -> Any:  # noqa: ANN401 - geometry_msgs has no types
    return kind(**dict(zip("xyz", values, strict=True)))


def _rgb(color: str) -> dict[str, float]:
    return {name: int(color[at : at + 2], 16) / 255.0 for name, at in (("r", 1), ("g", 3), ("b", 5))}

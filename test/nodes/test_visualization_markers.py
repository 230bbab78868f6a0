# SPDX-License-Identifier: Apache-2.0
"""Markers show what they stand for: masses by volume, mobilities by ellipsoids, verdicts by word and colour."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from visualization_msgs.msg import Marker

from scara_effmass.model.hulls import triangles
from scara_effmass.model.load import load_robot
from scara_effmass.model.poses import pose_geometry
from scara_effmass.nodes.visualization_node import contact_markers, robot_markers
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor, unknown_contact
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import VERDICT_COLORS, ContactAssessment, JointState, Vector3, Verdict, mobility_matrix

DYNAMICS = RobotDynamics(load_robot(settings=MonitorSettings(contact_points=("tool",))))
WHOLE = RobotDynamics(load_robot(settings=MonitorSettings(contact_points=("whole_arm",))))
Q = np.array([0.3, 1.2, 0.1, -0.4])
PLACE: Vector3 = (0.1, -0.2, 0.3)
STEEL = 7850.0
SCALES = {"ellipsoid_scale": 0.05, "arrow_scale": 0.25}
ANGLE = st.floats(-2.3, 2.3)


def assessed(q: np.ndarray = Q, qd: tuple[float, ...] = (0.5, 0.3, 0.01, 0.2), **settings: Any) -> ContactAssessment:  # noqa: ANN401
    """Return what the monitor says of the tool."""
    monitor = Monitor(DYNAMICS, MonitorSettings.model_validate(settings))
    state = JointState(1_000_000_000, DYNAMICS.robot.joint_names, q, np.array(qd))
    return monitor.assess(state, state.stamp_ns).contacts[0]  # type: ignore[union-attr]


def drawn(contact: ContactAssessment, contact_normal: str = "worst", *, simulated: bool = False) -> dict[str, Marker]:
    places = {contact.contact_point: PLACE}
    return {
        marker.ns: marker
        for marker in contact_markers([contact], places, contact_normal, {}, simulated=simulated, **SCALES)
    }


def vector(marker: Marker) -> np.ndarray:
    start, end = ([point.x, point.y, point.z] for point in marker.points)
    assert start == pytest.approx(PLACE)
    return np.subtract(end, start)


def rotation(marker: Marker) -> np.ndarray:
    """Return the rotation matrix of the pose, by the formula of unit quaternions."""
    o = marker.pose.orientation
    v, w = np.array([o.x, o.y, o.z]), o.w
    cross = np.array([[0.0, -o.z, o.y], [o.z, 0.0, -o.x], [-o.y, o.x, 0.0]])
    return np.asarray((w * w - v @ v) * np.eye(3) + 2.0 * np.outer(v, v) + 2.0 * w * cross)


def test_spheres_have_the_volume_of_their_mass_in_steel_and_the_places_of_the_forward_kinematics() -> None:
    geometry = pose_geometry(DYNAMICS.robot, DYNAMICS.lumped, Q)
    links, *spheres = robot_markers(geometry)
    volumes = [math.pi / 6.0 * sphere.scale.x**3 for sphere in spheres]
    assert [STEEL * volume for volume in volumes] == pytest.approx([mass for mass, _ in geometry.lumped_masses])
    elbow = (0.275 * math.cos(0.3), 0.275 * math.sin(0.3))
    at = spheres[1].pose.position
    assert (at.x, at.y) == pytest.approx(elbow)
    assert (links.type, len(links.points)) == (Marker.LINE_LIST, 2 * len(geometry.segments))


def test_each_link_has_its_hull_in_the_colour_of_its_verdict() -> None:
    geometry = pose_geometry(WHOLE.robot, WHOLE.lumped, Q)
    contacts = [assessed()._replace(contact_point=name) for name in WHOLE.contact_points]
    surfaces = {
        name: triangles(WHOLE.robot.hulls[name]) @ pose.rotation.T + pose.translation
        for name, pose in geometry.hulls.items()
    }
    markers = contact_markers(contacts, geometry.contact_points, "worst", surfaces, simulated=False, **SCALES)
    hulls = [marker for marker in markers if marker.ns == "hulls"]
    assert [WHOLE.contact_points[marker.id] for marker in hulls] == ["link1", "link2", "link3", "link4"]
    for marker, volume in zip(
        hulls, (0.425 * 0.15 * 0.12, 0.425 * 0.15 * 0.2, 0.04 * 0.04 * 0.5, 0.06**3), strict=True
    ):
        corners = np.array([(point.x, point.y, point.z) for point in marker.points]).reshape(-1, 3, 3)
        # Divergence theorem: positive, because every triangle is counterclockwise from outside.
        assert np.linalg.det(corners).sum() / 6.0 == pytest.approx(volume, rel=1e-2)
        assert marker.type == Marker.TRIANGLE_LIST
        color = VERDICT_COLORS[contacts[0].verdict]
        assert marker.color.r == pytest.approx(int(color[1:3], 16) / 255.0)
    link2 = np.array([(point.x, point.y, point.z) for point in hulls[1].points])
    along = np.array([math.cos(Q[0] + Q[1]), math.sin(Q[0] + Q[1])])
    elbow = 0.275 * np.array([math.cos(Q[0]), math.sin(Q[0])])
    assert (link2[:, :2] - elbow) @ along == pytest.approx(
        np.where((link2[:, :2] - elbow) @ along > 0, 0.35, -0.075), abs=1e-3
    )


@given(q1=ANGLE, q2=st.floats(0.2, 2.3), v1=st.floats(0.1, 1.0), v2=st.floats(0.1, 1.0))
def test_axes_of_the_ellipsoid_are_eigenvectors_of_the_mobility(q1: float, q2: float, v1: float, v2: float) -> None:
    contact = assessed(np.array([q1, q2, 0.1, 0.0]), (v1, v2, 0.01, 0.01))
    marker = drawn(contact)["mass_ellipsoid"]
    mobility = mobility_matrix(contact.lumped_mobility)
    sizes = np.array([marker.scale.x, marker.scale.y, marker.scale.z])
    masses = (sizes / (2.0 * SCALES["ellipsoid_scale"])) ** 2
    for mass, axis in zip(masses, rotation(marker).T, strict=True):
        if mass < 9.99:  # else limited
            assert mobility @ axis == pytest.approx(axis / mass, abs=1e-6)
    if masses.max() < 9.99:
        along = rotation(marker).T @ np.array(contact.direction)
        assert 1.0 / np.sum(along**2 / masses) == pytest.approx(contact.effective_mass, rel=1e-6)


def test_mass_of_the_standard_is_a_sphere() -> None:
    contact = assessed(effective_mass_model="iso")
    scale = drawn(contact)["mass_ellipsoid"].scale
    assert [scale.x, scale.y, scale.z] == pytest.approx([0.1 * math.sqrt(contact.iso_mass)] * 3)


def test_arrows_have_the_length_of_the_speeds_and_the_directions_of_the_state() -> None:
    contact = assessed()
    markers = drawn(contact)
    assert vector(markers["velocity"]) == pytest.approx(0.25 * contact.speed * np.array(contact.direction))
    assert vector(markers["allowable_speed"]) == pytest.approx(
        0.25 * contact.allowable_speed * np.array(contact.direction)
    )
    normal = vector(markers["worst_normal"]) / np.linalg.norm(vector(markers["worst_normal"]))
    inverse_masses = mobility_matrix(contact.lumped_mobility) + np.eye(3) / contact.body_mass
    worst = np.linalg.solve(inverse_masses, contact.direction)
    assert normal == pytest.approx(worst / np.linalg.norm(worst))
    reduced = np.dot(normal, contact.direction) ** 2 / (normal @ inverse_masses @ normal)
    assert reduced == pytest.approx(contact.worst_normal_reduced_mass, rel=1e-3)


@pytest.mark.parametrize("normal", ["velocity", "0 0 1"])
def test_worst_normal_is_drawn_only_where_the_verdict_assumes_it(normal: str) -> None:
    assert "worst_normal" not in drawn(assessed(contact_normal=normal), normal)


def test_contact_point_at_rest_has_no_arrows() -> None:
    contact = assessed()._replace(direction=(0.0, 0.0, 0.0), speed=0.0)
    assert drawn(contact).keys() == {"verdict", "mass_ellipsoid"}


@pytest.mark.parametrize("verdict", Verdict)
def test_verdict_is_a_word_and_a_colour_of_its_own(verdict: Verdict) -> None:
    contact = assessed()._replace(verdict=verdict, reason="why")
    markers = drawn(contact, simulated=True)
    text = markers["verdict"].text
    assert text.startswith(f"tool: {verdict.name} (simulated)\n")
    assert text.endswith("\nwhy")
    color = markers["verdict"].color
    hexadecimal = "#" + "".join(f"{round(255 * part):02X}" for part in (color.r, color.g, color.b))
    assert [name for name, its in VERDICT_COLORS.items() if its == hexadecimal] == [verdict]
    assert color.a == 1.0
    if verdict is Verdict.UNKNOWN:
        assert set(markers) == {"verdict"}
        assert "m/s" not in text
        assert color.r == color.g == color.b  # grey
    else:
        assert markers["mass_ellipsoid"].color.g == markers["velocity"].color.g == color.g
        assert contact.speed_text in text


def test_contact_point_without_a_place_has_its_word_above_the_base() -> None:
    contacts = [assessed(), unknown_contact("", "why")]
    markers = list(contact_markers(contacts, {}, "worst", {}, simulated=False, **SCALES))
    assert [marker.ns for marker in markers] == ["verdict", "verdict"]
    assert markers[0].pose.position.z < markers[1].pose.position.z
    assert markers[1].text == "robot: UNKNOWN\nwhy"


@pytest.mark.parametrize("z", [0.3, -0.3])
def test_words_of_contact_points_at_one_place_do_not_cover_each_other(z: float) -> None:
    """The OK of the flange would hide the VIOLATION of the tool."""
    names = ("elbow", "tool", "flange", "rim")
    places = dict.fromkeys(names, (0.4, 0.0, z)) | {"elbow": (0.2, 0.0, z)}
    contacts = [assessed()._replace(contact_point=name) for name in names]
    markers = contact_markers(contacts, places, "worst", {}, simulated=False, **SCALES)
    at = {marker.text.partition(":")[0]: marker.pose.position.z for marker in markers if marker.ns == "verdict"}
    away = math.copysign(0.2, z)
    assert [at[name] - z for name in names] == pytest.approx([away, away, 2.0 * away, 3.0 * away])


def test_numbers_that_are_not_finite_leave_only_the_word() -> None:
    contact = assessed()
    for broken in ({"lumped_mobility": (math.nan,) * 6}, {"direction": (math.inf, 0.0, 0.0)}):
        assert drawn(contact._replace(**broken)).keys() == {"verdict"}
    assert "mass_ellipsoid" not in drawn(contact._replace(mass_model="iso", iso_mass=0.0))

# SPDX-License-Identifier: Apache-2.0
"""The picture of the hulls: closed polytopes in their place on the robot."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]
from scipy.spatial import ConvexHull

from scara_effmass.analysis.hull_figure import draw_hulls, faces
from scara_effmass.model.hulls import outer_vertices
from scara_effmass.model.load import load_robot
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import FloatArray


def area(face: FloatArray) -> float:
    """Return the area of a plane polygon (K, 3), less where its corners are out of order."""
    arms = face - face[0]
    return float(np.linalg.norm(np.cross(arms[1:-1], arms[2:]).sum(axis=0))) / 2.0


def test_box_has_six_faces_of_four_corners() -> None:
    x, y, z = 0.1, 0.2, 0.4
    corners = np.array([(i * x, j * y, k * z) for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    found = [*faces(corners)]
    assert [len(face) for face in found] == [4] * 6
    assert sorted(map(area, found)) == pytest.approx(sorted(2 * [x * y, y * z, x * z]))


@given(st.integers(0, 1000))
def test_faces_have_the_area_of_the_hull(seed: int) -> None:
    vertices = outer_vertices(np.random.default_rng(seed).normal(size=(40, 3)) * [0.05, 0.1, 0.3])
    assert sum(map(area, faces(vertices))) == pytest.approx(ConvexHull(vertices).area, rel=1e-5)


def test_hulls_are_where_the_links_are() -> None:
    settings = MonitorSettings(contact_points=("tool", "whole_arm"))
    robot = load_robot(settings.robot_path, settings)
    (axes,) = draw_hulls(robot).axes
    drawn = [item for item in axes.collections if isinstance(item, Poly3DCollection)]
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, pin.neutral(robot.model))
    assert len(drawn) == len(robot.hulls) == 4
    for collection, (name, vertices) in zip(drawn, robot.hulls.items(), strict=True):
        pose = data.oMi[robot.model.frames[robot.contact_frames[name]].parentJoint]
        expected = np.array([pose.act(vertex) for vertex in vertices])
        corners = np.unique(np.concatenate(collection._faces).round(9), axis=0)  # noqa: SLF001 - no public way
        np.testing.assert_allclose(corners, np.unique(expected.round(9), axis=0), atol=1e-8)
    legend = axes.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["joints", "tool", *robot.hulls]
    tool = data.oMf[robot.contact_frames["tool"]].translation
    places = [np.ravel(line.get_data_3d()) for line in axes.lines[1:]]  # type: ignore[attr-defined]
    np.testing.assert_allclose(places, [tool], atol=1e-12)

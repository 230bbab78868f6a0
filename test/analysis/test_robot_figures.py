# SPDX-License-Identifier: Apache-2.0
"""Pictures of a robot: polytopes in their place on it, and labels that can be read."""

import numpy as np
import pinocchio as pin
from mpl_toolkits.mplot3d import Axes3D  # type: ignore[import-untyped]
from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]

from scara_effmass.analysis.robot_figures import draw_hulls, draw_masses
from scara_effmass.model.load import load_robot
from scara_effmass.model.lumping import lump
from scara_effmass.settings import MonitorSettings


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


def test_legend_of_the_masses_covers_no_label() -> None:
    robot = load_robot()
    figure = draw_masses(robot, lump(robot))
    figure.draw_without_rendering()
    (axes,) = figure.axes
    legend = axes.get_legend()
    assert legend is not None
    assert isinstance(axes, Axes3D)
    labels = (axis.label for axis in (axes.xaxis, axes.yaxis, axes.zaxis))
    assert not any(label.get_window_extent().overlaps(legend.get_window_extent()) for label in (*labels, *axes.texts))

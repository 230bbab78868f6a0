# SPDX-License-Identifier: Apache-2.0
"""Draw the effective_mass_markers of a recording at one time.

    python examples/draw_markers.py BAG SECONDS IMAGE

SECONDS count from the first markers in BAG.
"""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from mcap.reader import make_reader
from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]
from rclpy.serialization import deserialize_message
from visualization_msgs.msg import Marker, MarkerArray


def arrays(bag: Path) -> Iterator[tuple[float, Any]]:
    """Yield the marker arrays of a rosbag2 folder with their log times [s], counted from the first."""
    for path in sorted(bag.glob("*.mcap")):
        with path.open("rb") as file:
            messages = make_reader(file).iter_messages(topics=["/effective_mass_markers"])
            start_ns = 0
            for _, _, message in messages:
                start_ns = start_ns or message.log_time
                yield (message.log_time - start_ns) / 1e9, deserialize_message(message.data, MarkerArray)


def rotation(q: Any) -> Any:  # noqa: ANN401 - geometry_msgs and numpy
    """Return the rotation matrix (3, 3) of a unit quaternion."""
    cross = np.array([[0.0, -q.z, q.y], [q.z, 0.0, -q.x], [-q.y, q.x, 0.0]])
    return np.eye(3) + 2.0 * q.w * cross + 2.0 * cross @ cross


def draw(axes: Any, marker: Any) -> None:  # noqa: ANN401 - matplotlib's 3-D axes, and a marker
    """Draw one marker."""
    color = (marker.color.r, marker.color.g, marker.color.b)
    at = np.array([marker.pose.position.x, marker.pose.position.y, marker.pose.position.z])
    points = np.array([[point.x, point.y, point.z] for point in marker.points])
    if marker.type == Marker.SPHERE:
        u, v = np.mgrid[0 : 2 * np.pi : 25j, 0 : np.pi : 13j]
        unit = np.array([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)]).reshape(3, -1)
        sizes = np.diag([marker.scale.x, marker.scale.y, marker.scale.z]) / 2.0
        surface = (rotation(marker.pose.orientation) @ sizes @ unit).reshape(3, *u.shape) + at[:, None, None]
        axes.plot_surface(*surface, color=color, alpha=0.8 * marker.color.a, linewidth=0)
    elif marker.type == Marker.LINE_LIST:
        for start, end in points.reshape(-1, 2, 3):
            axes.plot(*np.array([start, end]).T, color=color, linewidth=8, solid_capstyle="round")
    elif marker.type == Marker.TRIANGLE_LIST:
        axes.add_collection3d(Poly3DCollection(points.reshape(-1, 3, 3) + at, facecolors=color, alpha=marker.color.a))
    elif marker.type == Marker.ARROW:
        axes.quiver(*points[0], *(points[1] - points[0]), color=color, linewidth=250 * marker.scale.x, zorder=10)
    elif marker.type == Marker.TEXT_VIEW_FACING:
        axes.text(*at, marker.text, color=color, ha="center", va="bottom", fontsize=11, zorder=20)


def main(bag: str, seconds: str, image: str) -> None:
    """Draw the marker array nearest to `seconds` and write it to the file `image`."""
    _, nearest = min(arrays(Path(bag)), key=lambda item: abs(item[0] - float(seconds)))
    figure = Figure(figsize=(9.0, 5.2), facecolor="#303030")
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0), projection="3d", facecolor="#303030", computed_zorder=False)
    for marker in nearest.markers:
        if marker.action == Marker.ADD:
            draw(axes, marker)
    axes.set_axis_off()
    axes.set(xlim=(-0.1, 0.6), ylim=(-0.35, 0.35), zlim=(-0.45, 0.25))
    axes.view_init(elev=28.0, azim=-62.0)
    axes.set_box_aspect((1.0, 1.0, 1.0), zoom=1.6)
    figure.text(0.02, 0.03, "drawn by matplotlib from the markers, not a screenshot of RViz", color="#CCCCCC")
    figure.savefig(image, dpi=100)


if __name__ == "__main__":
    main(*sys.argv[1:])

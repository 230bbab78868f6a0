"""Contour maps of one quantity over the workspace or over q1 and q2, with the standard's value in red."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import Stroke, withStroke

from scara_effmass.analysis.plot_style import ISO_RED
from scara_effmass.paper.scara import Scara
from scara_effmass.paper.workspace import JointAngles
from scara_effmass.values import FloatArray

TICKS_M = np.arange(-0.5, 0.51, 0.25)


@dataclass(frozen=True, slots=True)
class ColorScale:
    """Contour levels [units of `label`]; `extend` tells at which ends values may lie beyond them."""

    label: str
    levels: FloatArray
    ticks: FloatArray
    extend: Literal["neither", "max", "both"] = "neither"

    @property
    def norm(self) -> Normalize:
        """One colour between two levels."""
        return BoundaryNorm(self.levels.tolist(), 256, extend=self.extend)

    def clip(self, values: FloatArray) -> FloatArray:
        """Return `values` with a finite maximum: contours cannot be drawn next to infinity."""
        if self.extend == "neither":
            return values
        below, top = self.levels[-2:]
        return np.asarray(np.minimum(values, top + 4.0 * (top - below)))

    def add_bar(self, figure: Figure, axes: Sequence[Axes], **options: object) -> None:
        """Draw the colour bar of `axes`."""
        mappable = mpl.cm.ScalarMappable(self.norm, mpl.rcParams["image.cmap"])
        bar = figure.colorbar(mappable, ax=list(axes), ticks=self.ticks, label=self.label, **options)  # type: ignore[arg-type]
        bar.ax.minorticks_off()


def draw_map(axes: Axes, x: FloatArray, y: FloatArray, values: FloatArray, scale: ColorScale) -> None:
    """Fill `axes` with the colours of `values` at (x, y), all (n, m)."""
    contours = axes.contourf(x, y, scale.clip(values), levels=scale.levels, norm=scale.norm, extend=scale.extend)
    contours.set_edgecolor("face")  # no gaps between the bands


def draw_iso(axes: Axes, x: FloatArray, y: FloatArray, values: FloatArray, scale: ColorScale, iso: float) -> None:
    """Draw the contour of `iso` in red."""
    lines = axes.contour(x, y, scale.clip(values), levels=[iso], colors=ISO_RED, linewidths=2.0)
    lines.set_path_effects([withStroke(linewidth=3.6, foreground="white")])


def iso_handle(label: str) -> Line2D:
    """Return the red line for a legend."""
    return Line2D([], [], color=ISO_RED, linewidth=2.0, label=label, path_effects=[Stroke()])


def label_workspace(axes: Axes) -> None:
    """Set labels and limits of a map over the tool position."""
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", xticks=TICKS_M, yticks=TICKS_M)
    axes.set(xlim=(-0.6, 0.6), ylim=(-0.6, 0.6))


def label_angles(axes: Axes, scara: Scara, poses: JointAngles) -> None:
    """Set labels and limits of a map over q1 and q2."""
    q2 = np.degrees(poses.q2)
    q1_max = float(np.degrees(scara.q1_max))
    axes.set(xlabel="$q_1$ [deg]", ylabel="$q_2$ [deg]", xlim=(-q1_max, q1_max), ylim=(q2.min(), q2.max()))
    axes.set(xticks=np.arange(-120.0, 121.0, 60.0))
    axes.set(yticks=[tick for tick in np.arange(-120.0, 121.0, 30.0) if q2.min() <= tick <= q2.max()])

"""Markers of impacts in validation figures: colour by obstacle mass, marker by configuration."""

from __future__ import annotations

from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.lines import Line2D

if TYPE_CHECKING:
    from collections.abc import Iterable

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from scara_effmass.values import ValidatedImpact

MARKERS = "os^Dv<>pX*"
"""Markers of the configurations; they repeat if there are more."""
DARK, LIGHT = 0.0, 0.88
"""Range of the colour map with enough contrast to white."""
GREY = "#777777"


class Marks:
    """Marker style of each impact of a series.

    `configurations` are in the order of their mean effective mass, `obstacle_masses` [kg] ascending.
    """

    def __init__(self, impacts: Iterable[ValidatedImpact]) -> None:
        masses: dict[str, list[float]] = {}
        obstacle_masses = set()
        for impact in impacts:
            masses.setdefault(impact.configuration, []).append(impact.effective_mass)
            obstacle_masses.add(impact.obstacle_mass)
        self.configurations = sorted(masses, key=lambda name: (float(np.mean(masses[name])), name))
        self.obstacle_masses = sorted(obstacle_masses)

    def marker(self, configuration: str) -> str:
        """Return the marker of a configuration."""
        return MARKERS[self.configurations.index(configuration) % len(MARKERS)]

    def scatter(self, axes: Axes, impacts: Iterable[ValidatedImpact], points: Iterable[tuple[float, float]]) -> None:
        """Draw one point for each impact."""
        for impact, (x, y) in zip(impacts, points, strict=True):
            axes.plot(
                x,
                y,
                linestyle="none",
                marker=self.marker(impact.configuration),
                color=color(self.obstacle_masses.index(impact.obstacle_mass), len(self.obstacle_masses)),
                markersize=6.0,
                alpha=0.85,
                zorder=2,
            )
        axes.grid(alpha=0.3)

    def legend(self, figure: Figure, *lines: Line2D) -> None:
        """Draw the legend of the markers and `lines` beside the axes."""
        count = len(self.obstacle_masses)
        handles = [*lines, Line2D([], [], color="none", label="$m_H$ [kg]")]
        handles += [
            Line2D([], [], linestyle="none", marker="o", color=color(number, count), label=f"{mass:g}")
            for number, mass in enumerate(self.obstacle_masses)
        ]
        handles.append(Line2D([], [], color="none", label="configuration"))
        handles += [
            Line2D([], [], linestyle="none", marker=self.marker(name), color=GREY, label=configuration_label(name))
            for name in self.configurations
        ]
        figure.legend(handles=handles, loc="outside right upper")


def color(number: int, count: int) -> tuple[float, float, float, float]:
    """Return colour `number` of `count`."""
    return mpl.colormaps["plasma"](DARK + (LIGHT - DARK) * number / max(count - 1, 1))


def configuration_label(configuration: str) -> str:
    """Return the label of a configuration, with `$` escaped for matplotlib."""
    return configuration.replace("$", r"\$") or "not named"

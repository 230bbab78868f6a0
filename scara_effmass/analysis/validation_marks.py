"""How impacts are marked in the figures of a validation: colour by mass of the obstacle, marker by configuration."""

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
"""One for each configuration, and again from the first one on."""
DARK, LIGHT = 0.0, 0.88
"""Ends of the colour map that are told from each other, and from the paper."""
GREY = "#777777"


class Marks:
    """The marks of a series of impacts.

    `configurations` begin with the one in which the robot's mass is smallest, `obstacle_masses` [kg] with the least.
    """

    def __init__(self, impacts: Iterable[ValidatedImpact]) -> None:
        masses: dict[str, list[float]] = {}
        found = set()
        for impact in impacts:
            masses.setdefault(impact.configuration, []).append(impact.effective_mass)
            found.add(impact.obstacle_mass)
        self.configurations = sorted(masses, key=lambda name: (float(np.mean(masses[name])), name))
        self.obstacle_masses = sorted(found)

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
        """Say outside the panels what marks and `lines` mean."""
        count = len(self.obstacle_masses)
        handles = [*lines, Line2D([], [], color="none", label="$m_H$ [kg]")]
        handles += [
            Line2D([], [], linestyle="none", marker="o", color=color(number, count), label=f"{mass:g}")
            for number, mass in enumerate(self.obstacle_masses)
        ]
        handles.append(Line2D([], [], color="none", label="configuration"))
        handles += [
            Line2D([], [], linestyle="none", marker=self.marker(name), color=GREY, label=shown(name))
            for name in self.configurations
        ]
        figure.legend(handles=handles, loc="outside right upper")


def color(number: int, count: int) -> tuple[float, float, float, float]:
    """Return the colour of the `number`-th of `count`."""
    return mpl.colormaps["plasma"](DARK + (LIGHT - DARK) * number / max(count - 1, 1))


def shown(configuration: str) -> str:
    """Return what a configuration is called in a figure, where dollars would begin a formula."""
    return configuration.replace("$", r"\$") or "not named"

"""Fig. 8: how often which effective mass occurs over the workspace."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from scara_effmass.analysis.plot_style import CYCLE, INK, ISO_RED, new_figure
from scara_effmass.paper.workspace import spread_positions

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from scara_effmass.paper.scara import Scara
    from scara_effmass.values import FloatArray

FINE = 1500
"""Cells of each angle over the whole workspace: shares and median are then good to 1e-3, the mean to 1e-3 kg."""
BIN_KG, FINE_BIN_KG, PEAK_BIN_KG = 0.2, 0.05, 0.1
SHOWN_KG = 8.0


class Distribution(NamedTuple):
    """Effective masses (n,) [kg] over the workspace, and the share of its area (n,) that each stands for."""

    mass: FloatArray
    share: FloatArray

    @property
    def mean(self) -> float:
        """Of all positions [kg]."""
        return float(self.mass @ self.share)

    @property
    def median(self) -> float:
        """Of all positions [kg]."""
        order = np.argsort(self.mass)
        return float(self.mass[order][np.searchsorted(np.cumsum(self.share[order]), 0.5)])

    def below(self, mass: float) -> float:
        """Return the share of the positions with less than `mass` [kg]."""
        return float(self.share[self.mass < mass].sum())

    def density(self, edges: FloatArray) -> FloatArray:
        """Return the probability density [1/kg] between `edges` [kg], evenly spaced."""
        shares, _ = np.histogram(self.mass, edges, weights=self.share)
        return np.asarray(shares / (edges[1] - edges[0]))


def at_positions(scara: Scara, phi: float = 0.0) -> Distribution:
    """Return the masses of the simplified model, right arm, at 2500 positions spread evenly over the workspace."""
    mass = scara.lumped(*spread_positions(scara), phi)
    return Distribution(mass, np.full(mass.size, 1.0 / mass.size))


def over_workspace(scara: Scara, phi: float = 0.0) -> Distribution:
    """Return them for the whole workspace: by quadrature over the angles, which is densest at the stretched arm."""
    middles = (np.arange(FINE) + 0.5) / FINE
    q1, q2 = np.meshgrid(scara.q1_max * (2.0 * middles - 1.0), scara.q2_max * middles, indexing="ij")
    area = np.sin(q2).ravel()  # dA = l1 l2 |sin q2| dq1 dq2
    return Distribution(scara.lumped(q1, q2, phi).ravel(), area / area.sum())


def peaks(spread: Distribution) -> FloatArray:
    """Return the masses [kg], to half of `PEAK_BIN_KG`, at which the density has its local maxima."""
    # The first maximum is the lightest mass: put it into a bin, not on an edge.
    edges = np.arange(spread.mass.min() - 0.7 * PEAK_BIN_KG, SHOWN_KG, PEAK_BIN_KG)
    rises = np.diff(np.concatenate(([0.0], spread.density(edges), [0.0])))
    return np.asarray((edges[:-1] + edges[1:])[(rises[:-1] > 0.0) & (rises[1:] < 0.0)] / 2.0)


def figure_8(scara: Scara) -> Figure:
    """Probability density of the effective mass of the simplified model, along x."""
    few, whole = at_positions(scara), over_workspace(scara)
    figure = new_figure(8.5, 5.0, "Fig. 8  Probability density of the effective mass, simplified model, n = [1 0 0]")
    axes = figure.subplots()
    edges = np.arange(scara.m3, SHOWN_KG, BIN_KG)
    label = f"{few.mass.size} positions"
    axes.stairs(few.density(edges), edges, fill=True, color="#B7C4D3", edgecolor="white", label=label)
    edges = np.arange(scara.m3, SHOWN_KG, FINE_BIN_KG)
    axes.stairs(whole.density(edges), edges, color=INK, linewidth=1.0, label="whole workspace")
    for value, name, color, style in (
        (few.median, "median", CYCLE[0], "--"),
        (few.mean, "mean", CYCLE[2], "-."),
        (scara.iso_mass, "ISO standard, $m_R$", ISO_RED, "-"),
    ):
        axes.axvline(value, color=color, linestyle=style, linewidth=2.0, label=f"{name} = {value:.2f} kg")
    beyond = f"{1.0 - few.below(SHOWN_KG):.1%} lie above {SHOWN_KG:g} kg"
    axes.text(0.99, 0.03, beyond, transform=axes.transAxes, ha="right", fontsize=9.0)
    axes.set(xlabel="effective mass $m_{x,s}$ [kg]", ylabel="probability density [1/kg]", xlim=(0.5, SHOWN_KG))
    axes.set_title(f"right arm; {few.below(scara.iso_mass):.1%} of the positions lie below $m_R$")
    axes.legend()
    return figure

# SPDX-License-Identifier: Apache-2.0
"""Fig. 8: distribution of the effective mass over the workspace."""

from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from scara_effmass.analysis.plot_style import CYCLE, INK, ISO_RED, new_figure
from scara_effmass.paper.runs import FigureInputs
from scara_effmass.paper.scara import Scara, equal_area_poses
from scara_effmass.values import FloatArray

FINE_GRID = 1500
"""Values of each angle for the whole workspace; shares and median are accurate to 1e-3, the mean to 1e-3 kg."""
BIN_KG, FINE_BIN_KG, PEAK_BIN_KG = 0.2, 0.05, 0.1
MAX_SHOWN_KG = 8.0


class MassDistribution(NamedTuple):
    """Effective masses (n,) [kg], and the share of the workspace area (n,) with each of them."""

    mass: FloatArray
    share: FloatArray

    @property
    def mean(self) -> float:
        """Mean over the area [kg]."""
        return float(self.mass @ self.share)

    @property
    def median(self) -> float:
        """Median over the area [kg]."""
        order = np.argsort(self.mass)
        return float(self.mass[order][np.searchsorted(np.cumsum(self.share[order]), 0.5)])

    def below(self, mass: float) -> float:
        """Return the share with less than `mass` [kg]."""
        return float(self.share[self.mass < mass].sum())

    def density(self, edges: FloatArray) -> FloatArray:
        """Return the probability density [1/kg] between evenly spaced `edges` [kg]."""
        shares, _ = np.histogram(self.mass, edges, weights=self.share)
        return np.asarray(shares / (edges[1] - edges[0]))


def sampled_distribution(scara: Scara) -> MassDistribution:
    """Return the masses of the simplified model along x, right arm, at 2500 positions of equal area."""
    mass = scara.lumped(*equal_area_poses(scara))
    return MassDistribution(mass, np.full(mass.size, 1.0 / mass.size))


def workspace_distribution(scara: Scara, phi: float = 0.0) -> MassDistribution:
    """Return the masses of the simplified model over the whole workspace, by quadrature over the angles."""
    centres = (np.arange(FINE_GRID) + 0.5) / FINE_GRID
    q1, q2 = np.meshgrid(scara.q1_max * (2.0 * centres - 1.0), scara.q2_max * centres, indexing="ij")
    area = np.sin(q2).ravel()  # dA = l1 l2 |sin q2| dq1 dq2
    return MassDistribution(scara.lumped(q1, q2, phi).ravel(), area / area.sum())


def density_peaks(distribution: MassDistribution) -> FloatArray:
    """Return the masses [kg] at the local maxima of the density, to half of `PEAK_BIN_KG`."""
    # The first maximum is the lightest mass: the edges keep it inside a bin.
    edges = np.arange(distribution.mass.min() - 0.7 * PEAK_BIN_KG, MAX_SHOWN_KG, PEAK_BIN_KG)
    rises = np.diff(np.concatenate(([0.0], distribution.density(edges), [0.0])))
    return np.asarray((edges[:-1] + edges[1:])[(rises[:-1] > 0.0) & (rises[1:] < 0.0)] / 2.0)


def figure_8(inputs: FigureInputs) -> Figure:
    """Draw the probability density of the effective mass of the simplified model, along x."""
    scara = inputs.scara
    sampled, whole = sampled_distribution(scara), workspace_distribution(scara)
    figure = new_figure(8.5, 5.0, "Fig. 8  Probability density of the effective mass, simplified model, n = [1 0 0]")
    axes = figure.subplots()
    edges = np.arange(scara.m3, MAX_SHOWN_KG, BIN_KG)
    label = f"{sampled.mass.size} positions"
    axes.stairs(sampled.density(edges), edges, fill=True, color="#B7C4D3", edgecolor="white", label=label)
    edges = np.arange(scara.m3, MAX_SHOWN_KG, FINE_BIN_KG)
    axes.stairs(whole.density(edges), edges, color=INK, linewidth=1.0, label="whole workspace")
    for value, name, color, style in (
        (sampled.median, "median", CYCLE[0], "--"),
        (sampled.mean, "mean", CYCLE[2], "-."),
        (scara.iso_mass, "ISO standard, $m_R$", ISO_RED, "-"),
    ):
        axes.axvline(value, color=color, linestyle=style, linewidth=2.0, label=f"{name} = {value:.2f} kg")
    beyond = f"{1.0 - sampled.below(MAX_SHOWN_KG):.1%} lie above {MAX_SHOWN_KG:g} kg"
    axes.text(0.99, 0.03, beyond, transform=axes.transAxes, ha="right", fontsize=9.0)
    axes.set(xlabel="effective mass $m_{x,s}$ [kg]", ylabel="probability density [1/kg]", xlim=(0.5, MAX_SHOWN_KG))
    axes.set_title(f"right arm; {sampled.below(scara.iso_mass):.1%} of the positions lie below $m_R$")
    axes.legend()
    return figure

# SPDX-License-Identifier: Apache-2.0
"""The paper's maps and distribution of masses for any other robot, from sampled configurations."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from scara_effmass.analysis.output import check_output_files
from scara_effmass.analysis.report import (
    CYCLE,
    ISO_RED,
    figure_files,
    figure_text,
    new_figure,
    render,
    report_figure,
    styled,
    write_report_files,
)
from scara_effmass.analysis.tables import provenance
from scara_effmass.analysis.workspace_map import Cells, Plane, sample_workspace
from scara_effmass.errors import RobotError
from scara_effmass.iso15066 import reduced_mass
from scara_effmass.safety import Monitor
from scara_effmass.studies.figures import PAGE
from scara_effmass.studies.scara import OBSTACLES_KG, SHOWN_OBSTACLE_KG, MassDistribution, relative_error
from scara_effmass.values import FloatArray, Vector3

SUMMARY = "figures.json"
NUMBERS = (6, 8, 9, 10, 11, 12, 15)
"""Numbers of the figures in the paper."""
SAMPLES = 20_000
BINS, MAX_SHOWN_PERCENTILE = 60, 95.0
ALONG_X, ALONG_Y, OBLIQUE = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.6, 0.8, 0.0)
NAMES = {"lumped": "simplified model", "full": "full model"}
LEFT_OUT = {
    "Fig. 7": "its poses follow from the closed forms of the paper's SCARA",
    "Fig. 14": "right and left arm are those of a SCARA; each cell counts every configuration",
    "Figs. 17 to 19": "they show the experiment with the paper's robot",
    "claims": "they are those about the paper's robot",
}
"""Parts of the paper that do not apply to another robot, and the reasons."""


class RobotMasses:
    """Masses of a robot in sampled configurations, by the simplified and the full model, as far as it has them."""

    def __init__(
        self, monitor: Monitor, advance: Callable[[int], object] = lambda _: None, samples: int = SAMPLES
    ) -> None:
        """Sample `samples` configurations. Raises RobotError if no model gives a mass along a direction."""
        self.robot = monitor.dynamics.robot
        self.sample = sample_workspace(monitor, ALONG_X, "", Plane(), samples, advance)
        self._cells = Cells(self.sample)
        masses = {model: self._along(ALONG_X, model) for model in NAMES}
        self.masses = {model: mass for model, mass in masses.items() if np.isfinite(mass).any()}
        if not self.masses:
            raise RobotError(f"{self.robot.origin}: no mass along a direction: {monitor.dynamics.full_reason}")
        self.model = next(iter(self.masses))

    def _along(self, n: Vector3, model: str) -> FloatArray:
        """Return the mass of `model` along `n` (m,) [kg]; NaN without it."""
        x, y, z = n
        rows = self.sample.contacts[f"{model}_mobility"]
        mobility = rows @ [x * x, 2.0 * x * y, 2.0 * x * z, y * y, 2.0 * y * z, z * z]
        with np.errstate(divide="ignore"):
            masses = np.where(mobility > 0.0, 1.0 / mobility, np.inf)
        return np.where(rows[:, 0] + rows[:, 3] + rows[:, 5] > 0.0, masses, np.nan)

    def figures(self) -> Iterator[tuple[int, Figure]]:
        """Yield number and figure, in order."""
        mass, model, m_h = self.masses[self.model], NAMES[self.model], SHOWN_OBSTACLE_KG
        obstacles = {f"$m_H$ = {obstacle:g} kg": obstacle for obstacle in OBSTACLES_KG}
        along_x, against_full = "n = [1 0 0]", "of the simplified against the full model"
        panels = {f"effective mass [kg], {NAMES[name]}": values for name, values in self.masses.items()}
        yield 6, self._maps(f"Fig. 6  Largest effective mass, {along_x}", panels, self.robot.iso_mass)
        yield 8, self._density()
        has_both = len(self.masses) > 1
        full = self.masses.get("full", mass)
        if has_both:
            panels = {"error [%]": relative_error(full, mass)}
            yield 9, self._maps(f"Fig. 9  Largest error {against_full}, {along_x}", panels)
        panels = {f"µ [kg], {label}": reduced_mass(mass, obstacle) for label, obstacle in obstacles.items()}
        yield 10, self._maps(f"Fig. 10  Largest reduced mass, {model}, {along_x}", panels)
        if has_both:
            panels = {
                f"error [%], {label}": relative_error(reduced_mass(full, obstacle), reduced_mass(mass, obstacle))
                for label, obstacle in obstacles.items()
            }
            yield 11, self._maps(f"Fig. 11  Largest error in reduced mass {against_full}, {along_x}", panels)
        panels = {f"µ [kg], n = {list(n)}": reduced_mass(self._along(n, self.model), m_h) for n in (ALONG_Y, OBLIQUE)}
        yield 12, self._maps(f"Fig. 12  Largest reduced mass, {model}, $m_H$ = {m_h:g} kg", panels)
        title = f"Fig. 15  Smallest reduced mass, {model}, $m_H$ = {m_h:g} kg, {along_x}"
        yield 15, self._maps(title, {"µ [kg]": reduced_mass(mass, m_h)}, sign=-1.0)

    def _maps(
        self, title: str, panels: dict[str, FloatArray], iso_mass: float | None = None, sign: float = 1.0
    ) -> Figure:
        """Return maps of the largest (`sign` -1: smallest) of the values (m,) in each cell, by label."""
        largest = {label: sign * self._cells.largest(sign * values) for label, values in panels.items()}
        return self._cells.draw(f"{title}\n{figure_text(self.robot.name)}, seen from above", largest, iso_mass)

    @styled
    def _density(self) -> Figure:
        """Return the probability density of the masses along x over the area of the workspace."""
        share = 1.0 / np.bincount(self._cells.of)[self._cells.of]
        finite = np.concatenate([mass[np.isfinite(mass)] for mass in self.masses.values()])
        edges = np.linspace(0.0, float(np.percentile(finite, MAX_SHOWN_PERCENTILE)), BINS + 1)
        figure = new_figure(8.5, 5.0, f"Fig. 8  Probability density, n = [1 0 0]\n{figure_text(self.robot.name)}")
        axes = figure.subplots()
        for color, (model, mass) in zip(CYCLE, self.masses.items(), strict=False):
            known = np.isfinite(mass)
            density = MassDistribution(mass[known], share[known] / share[known].sum()).density(edges)
            axes.stairs(density, edges, color=color, linewidth=1.8, label=NAMES[model])
        iso_mass = self.robot.iso_mass
        axes.axvline(iso_mass, color=ISO_RED, linewidth=2.0, label=f"ISO, M/2 + m_L = {iso_mass:.2f} kg")
        axes.set(xlabel="effective mass along x [kg]", ylabel="probability density [1/kg]")
        axes.legend()
        return figure


def make_figures(
    monitor: Monitor, folder: Path, *, overwrite: bool, advance: Callable[[int], object], samples: int = SAMPLES
) -> dict[str, Any]:
    """Write the figures of the robot of `monitor`, a page and a summary into `folder`; return the summary.

    Raises RobotError as `RobotMasses` does, and OutputError if a file exists.
    """
    names = [f"figure_{number}" for number in NUMBERS]
    check_output_files(folder, [PAGE, SUMMARY, *figure_files(names)], overwrite=overwrite)
    masses = RobotMasses(monitor, advance, samples)
    caption = "Each cell shows one of the sampled configurations in it; in Fig. 8 each cell counts the same."
    figures = [report_figure(f"figure_{n}", f"Fig. {n}", caption, figure) for n, figure in masses.figures()]
    left_out = dict(LEFT_OUT)
    if len(figures) < len(NUMBERS):
        missing = monitor.dynamics.full_reason if masses.model == "lumped" else monitor.dynamics.lumped_reason
        reason = missing or "a joint moves the contact point, but no lumped mass"
        left_out["Figs. 9 and 11"] = f"the {NAMES[masses.model]} is the only one: {reason}"
    summary = {
        "robot": masses.robot.origin,
        "model": masses.model,
        "figures": [figure.name for figure in figures],
        "left_out": left_out,
        "provenance": provenance(monitor.settings, masses.robot.origin, []),
    }
    page = render("robot.html", robot=masses.robot, figures=figures, left_out=left_out)
    write_report_files(folder, {PAGE: page, SUMMARY: summary}, figures, overwrite=overwrite)
    return summary

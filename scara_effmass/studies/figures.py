# SPDX-License-Identifier: Apache-2.0
"""Figures of the paper: poses, maps and distribution of masses and of the simplified model's error, impact tests.

`make_figure_set` writes all of them with a page and the claims, or nothing.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import Stroke, withStroke

from scara_effmass import __version__
from scara_effmass.analysis.output import check_output_files
from scara_effmass.analysis.report import (
    CYCLE,
    INK,
    ISO_RED,
    MARKERS,
    figure_files,
    new_figure,
    render,
    report_figure,
    styled,
    write_report_files,
)
from scara_effmass.input_files import read_table
from scara_effmass.iso15066 import reduced_mass
from scara_effmass.sim.motion import ElbowConfig
from scara_effmass.studies.claims import Claim, Outcome, all_claims
from scara_effmass.studies.runs import (
    FigureInputs,
    Point,
    mass_at,
    mean_peaks,
    origin,
    points_by_mass,
    root_reduced_mass,
)
from scara_effmass.studies.scara import (
    ALONG_X,
    ALONG_Y,
    MAX_SHOWN_KG,
    OBLIQUE,
    OBSTACLES_KG,
    SHOWN_OBSTACLE_KG,
    JointAngles,
    ModelAgreement,
    Scara,
    compare_models,
    equal_area_poses,
    joint_grid,
    polar_grid,
    relative_error,
    sampled_distribution,
    scara_max_lumped_mass,
    workspace_distribution,
)
from scara_effmass.values import FloatArray

PAGE, CLAIMS = "index.html", "claims.json"
LIGHT_Q1, HEAVY_Q1 = math.radians(25.0), math.radians(-50.0)
"""Angles of the two poses in Fig. 7, chosen here: the text of the paper does not give them."""
CIRCLES, RAYS = 200, 721
"""Grid of Fig. 15, fine enough for the edge where the reach of one arm ends."""
BIN_KG, FINE_BIN_KG = 0.2, 0.05
"""Bins of Fig. 8."""


@dataclass(frozen=True, slots=True)
class ColorScale:
    """Contour levels in the unit of `label`; values may lie beyond the ends that `extend` names.

    `iso_symbol` is the symbol of the standard's value, which is drawn as a red contour.
    """

    label: str
    levels: FloatArray
    ticks: FloatArray
    extend: Literal["neither", "max", "both"] = "neither"
    iso_symbol: str = ""

    @property
    def norm(self) -> BoundaryNorm:
        """One colour between two levels."""
        return BoundaryNorm(self.levels.tolist(), 256, extend=self.extend)

    def clip(self, values: FloatArray) -> FloatArray:
        """Return `values` with a finite maximum: contours cannot be drawn next to infinity."""
        below, top = self.levels[-2:]
        return np.asarray(np.minimum(values, top + 4.0 * (top - below)))

    def draw(
        self, axes: Axes, x: FloatArray, y: FloatArray, values: FloatArray, iso: float | None, level: int | None = None
    ) -> None:
        """Draw the colours of `values` at (x, y), all (n, m), and the contour of `iso`; on 3D axes at the `level`."""
        values = self.clip(values)
        below: dict[str, Any] = {}
        above: dict[str, Any] = {}
        if level is not None:
            below = {"zdir": "z", "offset": level, "zorder": 3 * level}
            above = {"zdir": "z", "offset": level, "zorder": 3 * level + 1}
        bands = axes.contourf(x, y, values, levels=self.levels, norm=self.norm, extend=self.extend, **below)
        if level is None:
            bands.set_edgecolor("face")  # no gaps between the bands
        if iso is not None:
            width, halo = (2.0, 3.6) if level is None else (1.8, 3.0)
            lines = axes.contour(x, y, values, levels=[iso], colors=ISO_RED, linewidths=width, **above)
            lines.set_path_effects([withStroke(linewidth=halo, foreground="white")])

    def add_bar(self, figure: Figure, panels: Sequence[Axes], iso: Sequence[float], **options: float) -> None:
        """Draw the colour bar of `panels`, and a legend of the red contours `iso`, one for each slice."""
        mappable = mpl.cm.ScalarMappable(self.norm, mpl.rcParams["image.cmap"])
        bar = figure.colorbar(mappable, ax=list(panels), ticks=self.ticks, label=self.label, **options)  # type: ignore[arg-type]
        bar.ax.minorticks_off()
        if iso:
            values = ", ".join(f"{value:.2f}" for value in iso)
            label = f"{self.iso_symbol} = {values} kg (ISO standard){', from the bottom up' * (len(iso) > 1)}"
            line = Line2D([], [], color=ISO_RED, linewidth=2.0, label=label, path_effects=[Stroke()])
            figure.legend(handles=[line], loc="outside lower left")


EFFECTIVE = ColorScale(
    "effective mass $m_{x,s}$ [kg]", np.arange(0.75, 6.01, 0.25), np.arange(1.0, 6.1, 1.0), "max", "$m_R$"
)
EFFECTIVE_ERROR = ColorScale(
    r"relative error $|m_{n,f} - m_{n,s}|\,/\,m_{n,f}$ [%]",
    np.arange(2.0, 10.1, 0.5),
    np.arange(2.0, 10.1, 1.0),
    "both",
)
MU_LABEL, MU_ISO = r"reduced mass $\mu_{n,s}$ [kg]", r"$\mu_{\mathrm{ISO}}$"
REDUCED = ColorScale(MU_LABEL, np.arange(0.6, 2.41, 0.1), np.arange(0.6, 2.41, 0.2), "neither", MU_ISO)
REDUCED_SLICES = ColorScale(MU_LABEL, np.arange(0.3, 4.01, 0.1), np.arange(0.5, 4.01, 0.5), "max", MU_ISO)
REDUCED_ERROR = ColorScale(
    r"relative error $|\mu_{n,f} - \mu_{n,s}|\,/\,\mu_{n,f}$ [%]",
    np.arange(0.0, 5.01, 0.25),
    np.arange(0.0, 5.01),
    "max",
)


def figure_6(inputs: FigureInputs) -> Figure:
    """Draw the effective mass of the simplified model, along x."""
    scara, poses = inputs.scara, joint_grid(inputs.scara)
    title = "Fig. 6  Effective mass, simplified model, right arm, n = [1 0 0]"
    return _draw_both_spaces(scara, poses, scara.lumped(*poses), EFFECTIVE, title, scara.iso_mass)


def figure_7(inputs: FigureInputs) -> Figure:
    """Draw a pose of smallest and one of largest effective mass, along x, seen from above."""
    scara = inputs.scara
    figure = new_figure(10.0, 5.0, "Fig. 7  Poses of smallest and of largest effective mass, n = [1 0 0]")
    light, heavy = figure.subplots(1, 2)
    q2 = -LIGHT_Q1 + math.pi / 2.0
    _draw_arm(light, scara, LIGHT_Q1, q2)
    light.set_title(
        "(a) second link across n:  $q_2 = -q_1 + \\phi + \\pi/2$\n"
        f"$m_{{x,s}} = M_3$ = {scara.lumped(LIGHT_Q1, q2):.2f} kg"
    )
    q2 = -HEAVY_Q1
    _draw_arm(heavy, scara, HEAVY_Q1, q2)
    heavy.set_title(
        "(b) second link along n:  $q_2 = -q_1 + \\phi$\n"
        f"$m_{{x,s}} = M_3 + M_2 / \\sin^2 q_2$ = {scara_max_lumped_mass(q2, scara.m2, scara.m3):.2f} kg"
    )
    return figure


def _draw_arm(axes: Axes, scara: Scara, q1: float, q2: float) -> None:
    elbow = scara.inertia.l1 * np.array([math.cos(q1), math.sin(q1)])
    tool = np.array(scara.tool(np.float64(q1), np.float64(q2)))  # type: ignore[arg-type]
    axes.plot([0.0, elbow[0], tool[0]], [0.0, elbow[1], tool[1]], color="#9AA5B1", linewidth=9.0, zorder=1)
    axes.plot(*elbow, "o", color=CYCLE[0], markeredgecolor="white", markersize=14.0 * math.sqrt(scara.m2), zorder=2)
    axes.plot(*tool, "o", color=CYCLE[1], markeredgecolor="white", markersize=14.0 * math.sqrt(scara.m3), zorder=2)
    axes.plot(0.0, 0.0, "o", color="white", markeredgecolor=INK, markersize=11.0, zorder=2)
    axes.text(elbow[0] + 0.03, elbow[1] - 0.04, f"$M_2$ = {scara.m2:.2f} kg", va="center")
    axes.text(tool[0] - 0.025, tool[1] + 0.045, f"$M_3$ = {scara.m3:.2f} kg", va="center", ha="right")
    arrow = {"arrowstyle": "-|>", "color": ISO_RED, "linewidth": 2.0, "shrinkA": 7.0}
    axes.annotate("", (tool[0] + 0.12, tool[1]), (tool[0], tool[1]), arrowprops=arrow)
    axes.text(tool[0] + 0.125, tool[1], "n", color=ISO_RED, fontweight="bold", va="center")
    axes.text(-0.02, 0.035, "joint 1", ha="center")
    angles = f"$q_1$ = {math.degrees(q1):.0f}°,  $q_2$ = {math.degrees(q2):.0f}°"
    axes.text(0.97, 0.04, angles.replace("-", "\N{MINUS SIGN}"), transform=axes.transAxes, ha="right")
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", xlim=(-0.1, 0.65), ylim=(-0.36, 0.46))


def figure_9(inputs: FigureInputs) -> Figure:
    """Draw the relative error of the simplified model in effective mass, along x."""
    scara, poses = inputs.scara, joint_grid(inputs.scara)
    error = relative_error(scara.full(*poses), scara.lumped(*poses))
    title = "Fig. 9  Error in effective mass, simplified against full model, right arm, n = [1 0 0]"
    return _draw_both_spaces(scara, poses, error, EFFECTIVE_ERROR, title)


def figure_10(inputs: FigureInputs) -> Figure:
    """Draw the reduced mass of the simplified model for four obstacle masses, along x."""
    scara = inputs.scara
    lumped = scara.lumped(*joint_grid(scara))
    slices = [reduced_mass(lumped, obstacle) for obstacle in OBSTACLES_KG]
    iso = [reduced_mass(scara.iso_mass, obstacle) for obstacle in OBSTACLES_KG]
    title = "Fig. 10  Reduced mass, simplified model, right arm, n = [1 0 0]"
    return _draw_slices(scara, slices, REDUCED_SLICES, title, iso)


def figure_11(inputs: FigureInputs) -> Figure:
    """Draw the relative error in reduced mass for four obstacle masses, along x."""
    scara, poses = inputs.scara, joint_grid(inputs.scara)
    lumped, full = scara.lumped(*poses), scara.full(*poses)
    slices = [relative_error(reduced_mass(full, m_h), reduced_mass(lumped, m_h)) for m_h in OBSTACLES_KG]
    title = "Fig. 11  Error in reduced mass, simplified against full model, right arm, n = [1 0 0]"
    return _draw_slices(scara, slices, REDUCED_ERROR, title)


def figure_12(inputs: FigureInputs) -> Figure:
    """Draw the reduced mass along y, and along (0.6, 0.8, 0)."""
    scara, poses = inputs.scara, joint_grid(inputs.scara)
    title = f"Fig. 12  Reduced mass, simplified model, right arm, $m_H$ = {SHOWN_OBSTACLE_KG:g} kg"
    figure = new_figure(11.0, 5.4, title)
    panels = figure.subplots(1, 2)
    iso = reduced_mass(scara.iso_mass, SHOWN_OBSTACLE_KG)
    for axes, phi, name in zip(panels, (ALONG_Y, OBLIQUE), ("(a) n = [0 1 0]", "(b) n = [0.6 0.8 0]"), strict=True):
        mu = reduced_mass(scara.lumped(*poses, phi), SHOWN_OBSTACLE_KG)
        _draw_workspace(axes, scara.tool(*poses), mu, REDUCED, name, iso, phi)
    REDUCED.add_bar(figure, panels, [iso])
    return figure


def figure_14(inputs: FigureInputs) -> Figure:
    """Draw the reduced mass of the left arm, along x."""
    scara, poses = inputs.scara, joint_grid(inputs.scara, ElbowConfig.LEFT)
    mu, iso = reduced_mass(scara.lumped(*poses), SHOWN_OBSTACLE_KG), reduced_mass(scara.iso_mass, SHOWN_OBSTACLE_KG)
    title = f"Fig. 14  Reduced mass, simplified model, left arm, n = [1 0 0], $m_H$ = {SHOWN_OBSTACLE_KG:g} kg"
    return _draw_both_spaces(scara, poses, mu, REDUCED, title, iso)


def figure_15(inputs: FigureInputs) -> Figure:
    """Draw the smaller reduced mass of both arms along x, or that of the only arm that reaches a position."""
    scara, grid = inputs.scara, polar_grid(inputs.scara, CIRCLES, RAYS)
    smaller = np.fmin(scara.lumped(*grid.right), scara.lumped(*grid.left))
    mu, iso = reduced_mass(smaller, SHOWN_OBSTACLE_KG), reduced_mass(scara.iso_mass, SHOWN_OBSTACLE_KG)
    figure = new_figure(7.4, 6.2, f"Fig. 15  Smaller reduced mass of both arms, $m_H$ = {SHOWN_OBSTACLE_KG:g} kg")
    axes = figure.subplots()
    _draw_workspace(axes, (grid.x, grid.y), mu, REDUCED, "simplified model, n = [1 0 0]", iso)
    REDUCED.add_bar(figure, [axes], [iso])
    return figure


def _draw_both_spaces(
    scara: Scara, poses: JointAngles, values: FloatArray, scale: ColorScale, title: str, iso: float | None = None
) -> Figure:
    figure = new_figure(11.5, 5.2, title)
    workspace, angles = figure.subplots(1, 2, width_ratios=(1.0, 1.05))
    _draw_workspace(workspace, scara.tool(*poses), values, scale, "(a) Cartesian space", iso)
    q1, q2 = np.degrees(poses)
    scale.draw(angles, q1, q2, values, iso)
    angles.set(xlabel="$q_1$ [deg]", ylabel="$q_2$ [deg]", xlim=(q1.min(), q1.max()), ylim=(q2.min(), q2.max()))
    angles.set(xticks=np.arange(-120.0, 121.0, 60.0))
    angles.set(yticks=[tick for tick in np.arange(-120.0, 121.0, 30.0) if q2.min() <= tick <= q2.max()])
    angles.set_title("(b) joint space")
    scale.add_bar(figure, [workspace, angles], [] if iso is None else [iso])
    return figure


def _draw_workspace(
    axes: Axes,
    xy: tuple[FloatArray, FloatArray],
    values: FloatArray,
    scale: ColorScale,
    title: str,
    iso: float | None,
    phi: float = ALONG_X,
) -> None:
    """Draw the map, and the normal as an arrow from joint 1, where the workspace has a hole."""
    scale.draw(axes, *xy, values, iso)
    ticks = np.arange(-0.5, 0.51, 0.25)
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", xticks=ticks, yticks=ticks)
    axes.set(xlim=(-0.6, 0.6), ylim=(-0.6, 0.6), title=title)
    axes.plot(0.0, 0.0, "o", color="black", markersize=4.0)
    tip = (0.11 * np.cos(phi), 0.11 * np.sin(phi))
    axes.annotate("", tip, (0.0, 0.0), arrowprops={"arrowstyle": "-|>", "color": "black", "linewidth": 1.4})
    axes.text(-0.03 * np.cos(phi), -0.03 * np.sin(phi), "n", ha="center", va="center", fontweight="bold")


def _draw_slices(
    scara: Scara, slices: Sequence[FloatArray], scale: ColorScale, title: str, iso: Sequence[float] = ()
) -> Figure:
    """Draw one slice per obstacle mass over the tool position and over q1 and q2."""
    poses = joint_grid(scara)
    figure = new_figure(12.5, 7.2, title)
    x, y = scara.tool(*poses)
    q1, q2 = np.degrees(poses)
    workspace, angles = (figure.add_subplot(1, 2, column, projection="3d", computed_zorder=False) for column in (1, 2))
    for axes, across, up in ((workspace, x, y), (angles, q1, q2)):
        for level, values in enumerate(slices):
            scale.draw(axes, across, up, values, iso[level] if iso else None, level)
        # Evenly spaced: in proportion to the masses, the two slices in the middle would hide each other.
        axes.set(zlim=(0.0, len(OBSTACLES_KG) - 1.0), zticks=range(len(OBSTACLES_KG)))
        axes.set_zticklabels([f"{obstacle:.2f}" for obstacle in OBSTACLES_KG])
        axes.set_zlabel("obstacle mass $m_H$ [kg]", labelpad=8.0)
        axes.view_init(elev=23.0, azim=-60.0)
        axes.set_box_aspect((1.0, 1.0, 1.5))
    ticks = (-0.4, 0.0, 0.4)
    workspace.set(xlabel="x [m]", ylabel="y [m]", xlim=(-0.6, 0.6), ylim=(-0.6, 0.6), xticks=ticks, yticks=ticks)
    workspace.set_title("(a) Cartesian space")
    angles.set(xlabel="$q_1$ [deg]", ylabel="$q_2$ [deg]", xlim=(q1.min(), q1.max()), ylim=(q2.min(), q2.max()))
    angles.set(xticks=(-120.0, -60.0, 0.0, 60.0), yticks=(0.0, 60.0, 120.0))
    angles.set_title("(b) joint space")
    scale.add_bar(figure, [workspace, angles], iso, shrink=0.7, pad=0.06)
    return figure


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


def figure_17(inputs: FigureInputs) -> Figure:
    """Draw position and velocity of the tool along x, and the instant of impact."""
    run = inputs.shown_run
    figure = new_figure(10.5, 4.2, f"Fig. 17  Tool along x, {run.source}")
    position, velocity = figure.subplots(1, 2)
    for axes, values, name, label in (
        (position, run.x, "(a) position", "x [mm]"),
        (velocity, run.velocity, "(b) velocity", "velocity along x [mm/s]"),
    ):
        axes.plot(run.time, 1e3 * values, color=CYCLE[0], linewidth=1.6)
        axes.axvline(run.onset, color=ISO_RED, linestyle="--", zorder=1.5, label="instant of impact")
        axes.set(xlabel="time [s]", ylabel=label, title=name, xlim=(0.0, run.time[-1]))
        axes.grid(alpha=0.3)
    figure.legend(*position.get_legend_handles_labels(), loc="outside lower left")
    return figure


def figure_18(inputs: FigureInputs) -> Figure:
    """Draw force over time for each configuration with one obstacle mass, one line per repetition."""
    scara = inputs.scara
    shown_mass = min((run.obstacle_mass for run in inputs.runs), key=lambda mass: abs(mass - SHOWN_OBSTACLE_KG))
    runs = [run for run in inputs.runs if run.obstacle_mass == shown_mass]
    figure = new_figure(8.5, 4.8, f"Fig. 18  Impact force, {origin(runs)}, $m_H$ = {shown_mass:g} kg")
    axes = figure.subplots()
    for point, color in zip(points_by_mass(scara, runs), CYCLE, strict=False):
        label = f"{_point_name(point)} mm, $m_{{n,s}}$ = {mass_at(scara, point):.2f} kg"
        for run in (run for run in runs if run.point == point):
            axes.plot(1e3 * run.force_time, run.force, color=color, linewidth=1.2, label=label)
            label = ""
    axes.set(xlabel="time since the onset [ms]", ylabel="force [N]")
    axes.grid(alpha=0.3)
    axes.legend(title="tool at the impact")
    return figure


def figure_19(inputs: FigureInputs) -> Figure:
    """Draw mean peak forces and sqrt(mu) of the simplified model by configuration."""
    scara, peaks = inputs.scara, mean_peaks(inputs.runs)
    points = points_by_mass(scara, inputs.runs)
    figure = new_figure(10.5, 4.8, "Fig. 19  Peak force and $\\sqrt{\\mu}$")
    forces, roots = figure.subplots(1, 2)
    _draw_curves(forces, scara, points, lambda point, mass: peaks.get((point, mass)))
    forces.set(ylabel="mean peak force [N]", title=f"(a) {origin(inputs.runs)}")
    _draw_curves(roots, scara, points, lambda point, mass: root_reduced_mass(scara, point, mass))
    roots.set(ylabel="$\\sqrt{\\mu}$ [$\\sqrt{\\mathrm{kg}}$]", title="(b) simplified model")
    roots.legend(title="$m_H$ [kg]", loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def _draw_curves(
    axes: Axes,
    scara: Scara,
    points: Sequence[Point],
    quantity: Callable[[Point, float], float | None],
) -> None:
    """Draw `quantity`(point, mass) over the configurations, one curve per obstacle mass; None is not drawn."""
    for mass, color, marker in reversed(list(zip(OBSTACLES_KG, CYCLE, MARKERS, strict=True))):
        values = [(i, value) for i, point in enumerate(points) if (value := quantity(point, mass)) is not None]
        if values:
            axes.plot(*zip(*values, strict=True), marker=marker, color=color, linewidth=1.8, label=f"{mass:.2f}")
    names = [f"{_point_name(point)} mm\n{mass_at(scara, point):.2f} kg" for point in points]
    axes.set_xticks(range(len(points)), names)
    axes.set(xlabel="tool at the impact, its effective mass $m_{n,s}$", xlim=(-0.3, len(points) - 0.7))
    axes.set_ylim(bottom=0.0)
    axes.grid(alpha=0.3)


def _point_name(point: Point) -> str:
    """Return the point as the paper writes it, in [mm]."""
    x, y = (round(1e3 * coordinate) for coordinate in point)
    return f"({x}, {y})".replace("-", "\N{MINUS SIGN}")


DrawFigure = Callable[[FigureInputs], Figure]
FIGURES: dict[DrawFigure, str] = {
    globals()[name]: caption for name, caption in read_table(__file__, "captions.yaml").items()
}
"""Captions by the functions that draw the figures; the files have the names of the functions."""
STEPS = len(FIGURES) + 1
"""Number of calls of `advance` in `make_figure_set`."""


@dataclass(frozen=True, slots=True)
class FigureSet:
    """Names of the figures, the claims, and the agreement of the two models."""

    figures: tuple[str, ...]
    claims: tuple[Claim, ...]
    agreement: ModelAgreement

    @property
    def counts(self) -> dict[str, int]:
        """Number of claims by outcome."""
        return {outcome.value: sum(claim.outcome is outcome for claim in self.claims) for outcome in Outcome}

    def as_dict(self) -> dict[str, Any]:
        """Return the content of `claims.json`."""
        return {
            "scara_effmass": __version__,
            "figures": list(self.figures),
            "counts": self.counts,
            "closed_form_check": self.agreement._asdict(),
            "claims": list(map(asdict, self.claims)),
        }


@styled
def make_figure_set(
    inputs: FigureInputs,
    folder: Path,
    *,
    overwrite: bool,
    advance: Callable[[], object],
    captions: dict[DrawFigure, str] = FIGURES,
) -> FigureSet:
    """Write figures (PNG and SVG), `index.html` and `claims.json` into `folder`; call `advance` after each step.

    Raises OutputError, before anything is drawn, where a file exists.
    """
    names = tuple(draw.__name__ for draw in captions)
    check_output_files(folder, [PAGE, CLAIMS, *figure_files(names)], overwrite=overwrite)
    figures = []
    for name, (draw, caption) in zip(names, captions.items(), strict=True):
        figures.append(report_figure(name, name.replace("figure_", "Fig. "), caption, draw(inputs)))
        advance()
    # Not on the joint grid: with a stretched arm the tool cannot move along n.
    agreement = compare_models(inputs.dynamics, inputs.scara, *equal_area_poses(inputs.scara))
    claims = tuple(all_claims(inputs))
    figure_set = FigureSet(names, claims, agreement)
    advance()
    page = render("paper.html", figures=figures, figure_set=figure_set)
    write_report_files(folder, {PAGE: page, CLAIMS: figure_set.as_dict()}, figures, overwrite=overwrite)
    return figure_set

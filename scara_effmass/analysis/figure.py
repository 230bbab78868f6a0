"""The picture of a run: speed under its limit, the verdict, and the effective masses, over time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from scara_effmass.analysis.time_series import decimate, verdict_spans
from scara_effmass.values import Verdict

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes

    from scara_effmass.analysis.forces import RecordedForce
    from scara_effmass.analysis.time_series import TimeSeries
    from scara_effmass.values import FloatArray

COLUMNS = 1500
"""Pixels across the data, about; finer than that nothing can be seen."""
SUBTITLE_IN = 0.44
"""How far below the upper edge it stands [inch]: in the second line of the title, which is empty."""
FORMATS = (".png", ".svg")
DPI = 140
LARGEST_LINEAR_RATIO = 12.0
"""Masses further apart than this are drawn on a logarithmic axis."""

_LOOKS: dict[Verdict, dict[str, Any]] = {
    # Okabe and Ito's palette, which the usual kinds of colour blindness can tell apart.
    Verdict.OK: {"facecolor": "#009E73", "linewidth": 0.0},
    Verdict.WARN: {"facecolor": "#F0E442", "linewidth": 0.0},
    Verdict.VIOLATION: {"facecolor": "#D55E00", "linewidth": 0.0},
    Verdict.UNKNOWN: {"facecolor": "#DDDDDD", "hatch": "////", "edgecolor": "#777777", "linewidth": 0.0},
}
_ORDER = (Verdict.OK, Verdict.WARN, Verdict.VIOLATION, Verdict.UNKNOWN)
_STYLE: dict[Any, Any] = {
    "font.size": 10.0,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "hatch.linewidth": 0.6,
    "svg.hashsalt": "scara_effmass",
}


def draw_run(
    series: TimeSeries,
    *,
    title: str,
    subtitle: str,
    mass_model: str,
    timeout: float,
    forces: RecordedForce | None = None,
) -> Figure:
    """Return the figure of one contact point's series; the verdict used the mass of `mass_model`.

    `timeout` [s] is the silence after which nothing is known; `forces` are drawn below, where there are any.
    """
    with mpl.rc_context(_STYLE):
        heights = (0.25, 2.2, 1.6, 1.3) if forces else (0.25, 2.2, 1.6)
        figure = Figure(figsize=(13.0, 1.9 * sum(heights)), layout="constrained")
        FigureCanvasAgg(figure)
        rows = figure.subplots(len(heights), 1, sharex=True, height_ratios=heights)
        band, speeds, masses = rows[:3]
        series = series.with_gaps(timeout)
        _draw_verdicts(band, series, timeout)
        _draw_speeds(speeds, series)
        _draw_masses(masses, series, mass_model)
        if forces:
            _draw_forces(rows[-1], forces, series.start_ns)
        rows[-1].set_xlabel("time since the first joint state [s]")
        masses.set_xlim(0.0, max(float(series.time[-1]), 1e-3))
        for axes in (speeds, masses):
            for start, stop, verdict in verdict_spans(series, timeout):
                if verdict is Verdict.UNKNOWN:
                    axes.axvspan(
                        start, stop, facecolor="none", edgecolor="#BBBBBB", hatch="////", linewidth=0.0, zorder=0
                    )
        figure.suptitle(f"{title}\n", fontsize=13.0, fontweight="bold", x=0.01, ha="left")
        below_title = 1.0 - SUBTITLE_IN / figure.get_figheight()
        figure.text(0.01, below_title, subtitle, fontsize=9.5, color="#444444", va="center")
        figure.align_ylabels()
    return figure


def write(figure: Figure, png: Path, svg: Path) -> None:
    """Write `figure` in both formats, alike every time, under the style it was drawn in.

    It is laid out once and drawn once for each; `savefig` would draw it twice for each.
    """
    figure.set_dpi(DPI)
    FigureCanvasAgg(figure).print_png(png)  # type: ignore[no-untyped-call]
    figure.set_layout_engine("none")
    FigureCanvasSVG(figure).print_svg(svg, metadata={"Date": None})  # type: ignore[no-untyped-call]


def _draw_verdicts(axes: Axes, series: TimeSeries, timeout: float) -> None:
    spans = verdict_spans(series, timeout)
    shortest = float(series.time[-1]) / COLUMNS
    for verdict in _ORDER:
        # A verdict of a single cycle is thinner than a pixel and would not be seen.
        bars = [(start, max(stop - start, shortest)) for start, stop, each in spans if each is verdict]
        look = _LOOKS[verdict]
        axes.broken_barh(bars, (0.0, 1.0), **look)
    axes.set_ylim(0.0, 1.0)
    axes.set_yticks([])
    axes.grid(visible=False)
    axes.set_ylabel("verdict", rotation=0, ha="right", va="center")
    seen = [verdict for verdict in _ORDER if any(each is verdict for _, _, each in spans)]
    patches = [Patch(label=verdict.name, **_LOOKS[verdict]) for verdict in seen]
    axes.legend(handles=patches, loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False, ncols=2)


def _draw_speeds(axes: Axes, series: TimeSeries) -> None:
    _line(axes, series, series.allowable_speed, color="#0072B2", linewidth=1.6, label="allowable speed")
    _line(axes, series, series.speed, color="#000000", linewidth=1.2, label="speed")
    above = np.where(series.speed > series.allowable_speed, series.speed, np.nan)
    if np.isfinite(above).any():
        _line(axes, series, above, color="#D55E00", linewidth=2.4, label="speed above the allowable")
    axes.set_ylabel("speed of the contact point [m/s]")
    axes.set_ylim(bottom=0.0)
    _legend(axes)


def _draw_masses(axes: Axes, series: TimeSeries, mass_model: str) -> None:
    for model, values, label, color, style in (
        ("lumped", series.lumped_mass, "lumped model", "#0072B2", ":"),
        ("full", series.full_mass, "full model", "#000000", "--"),
        ("iso", series.iso_mass, "ISO, M/2 + m_L", "#CC79A7", "-."),
    ):
        if np.isfinite(values).any():
            decides = model == mass_model
            _line(
                axes,
                series,
                values,
                color=color,
                linestyle="-" if decides else style,
                linewidth=2.2 if decides else 1.3,
                label=f"{label} (decides)" if decides else label,
            )
    if mass_model == "largest":
        _line(
            axes,
            series,
            series.effective_mass,
            color="#E69F00",
            linewidth=4.0,
            alpha=0.5,
            label="larger of both (decides)",
        )
    drawn = np.concatenate([line.get_ydata() for line in axes.get_lines()] or [np.empty(0)])
    drawn = drawn[np.isfinite(drawn)]
    if len(drawn) and drawn.max() > LARGEST_LINEAR_RATIO * drawn.min():
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter("{x:g}")
    else:
        axes.set_ylim(bottom=0.0)
    axes.set_ylabel("effective mass [kg]")
    _legend(axes)


def _draw_forces(axes: Axes, forces: RecordedForce, start_ns: int) -> None:
    time = (forces.stamp_ns - start_ns) / 1e9
    what = "simulated force" if forces.simulated else "measured force"
    axes.plot(*decimate(time, forces.force, COLUMNS), color="#000000", linewidth=1.0, label=what)
    for sound, marker, label in ((True, "v", "impact"), (False, "x", "impact, clipped or incomplete")):
        found = [impact for impact in forces.impacts if sound is not (impact.clipped or impact.incomplete)]
        if found:
            onsets = [(impact.stamp_ns - start_ns) / 1e9 for impact in found]
            peaks = [impact.peak_force for impact in found]
            axes.plot(onsets, peaks, linestyle="none", marker=marker, color="#D55E00", label=label)
    axes.set_ylabel("force [N]")
    _legend(axes)


def _line(axes: Axes, series: TimeSeries, values: FloatArray, **style: object) -> None:
    axes.plot(*decimate(series.time, values, COLUMNS), **style)  # type: ignore[arg-type]


def _legend(axes: Axes) -> None:
    if axes.get_lines():
        axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False)

# SPDX-License-Identifier: Apache-2.0
"""The report of a run, live or offline: a figure and the episodes of each contact point, a page, and a summary.

A figure shows verdict, speed and its limit, effective masses, and force over time.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from scara_effmass.analysis.forces import RecordedForce, ShownTrace, recorded_traces
from scara_effmass.analysis.output import check_output_files
from scara_effmass.analysis.report import (
    ENGLISH_PAGE,
    PAGE,
    STYLE,
    PageOptions,
    ReportFigure,
    figure_files,
    figure_text,
    file_hashes,
    new_figure,
    render,
    report_figure,
    setting_rows,
    write_report_files,
)
from scara_effmass.analysis.summary import WORST_FIRST, worst
from scara_effmass.analysis.time_series import Episode, TimeSeries, decimate, intervals
from scara_effmass.iso15066 import Limit, limits_for
from scara_effmass.safety.remedies import remedy
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import VERDICT_COLORS, FloatArray, Verdict

SUMMARY = "summary.json"
CAPTION = (
    "Verdict; speed of the contact point and its allowable speed; effective masses. "
    "Hatched: UNKNOWN, or no joint state."
)
MAX_ROWS = 100
"""Most episodes in a table of the page; the summary lists all."""
COLUMNS = 1500
"""Approximate width of the data [pixel]; lines are decimated to it."""
MAX_LINEAR_RATIO = 12.0
"""Maximum ratio of the masses on a linear axis; beyond it the axis is logarithmic."""

_VERDICT_STYLES: dict[Verdict, dict[str, Any]] = {
    verdict: {"facecolor": color, "linewidth": 0.0} for verdict, color in VERDICT_COLORS.items()
}
_VERDICT_STYLES[Verdict.UNKNOWN] |= {"hatch": "////", "edgecolor": "#777777"}
_STYLE = STYLE | {"axes.grid": True, "grid.alpha": 0.3, "hatch.linewidth": 0.6}


class RunReport:
    """Collects the figures and episodes of a run; `write` writes all files or none."""

    def __init__(
        self,
        folder: Path,
        figures: int,
        settings: MonitorSettings,
        options: PageOptions = ENGLISH_PAGE,
        *,
        overwrite: bool,
    ) -> None:
        """Prepare for up to `figures` figures; `settings` are those of the monitor.

        Raises OutputError where a file exists.
        """
        self._folder, self._settings, self._overwrite = folder, settings, overwrite
        self._options = options
        names = [f"run_{number}" if number > 1 else "run" for number in range(1, figures + 1)]
        check_output_files(folder, [PAGE, SUMMARY, *options.files(), *figure_files(names)], overwrite=overwrite)
        self._names = iter(names)
        self._sections: list[tuple[ReportFigure, int, list[Episode], int]] = []
        self._traces: dict[str, list[ShownTrace]] = {}
        self._period = [2**63, 0]
        self._is_simulated = False
        self._contacts: set[str] = set()
        self._episodes: list[dict[str, Any]] = []

    def add(
        self, series: TimeSeries, contact_point: str, run: str, *, generated: bool, forces: RecordedForce | None
    ) -> None:
        """Draw `contact_point` in the run `run`, with the forces of that run."""
        if not len(series.time):
            return
        self._contacts.add(contact_point)
        settings, model = self._settings, self._settings.effective_mass_model.value
        motion = "generated motion, no real robot" if generated else "recorded motion, modelled masses"
        models = [
            f"{key} ({count / series.mass_models.total():.0%})" for key, count in series.mass_models.most_common()
        ]
        drawing = draw_run(
            series,
            title=f"{run}, {model} mass",
            subtitle=f"{motion} · contact point: {contact_point} · below {settings.speed_threshold:g} m/s: worst "
            "direction · allowable speed includes the uncertainty margins"
            f"\nmass: {'; '.join(models) or 'none'}",
            mass_model=model,
            timeout=settings.timeout,
            forces=forces,
        )
        name, head = next(self._names), f"{run} · contact point: {contact_point}"
        figure = report_figure(name, head, CAPTION, drawing, self._options.language)
        episodes = [item for item in intervals(series, settings.timeout) if item.verdict is not Verdict.OK]
        by_severity = sorted(episodes, key=lambda item: (WORST_FIRST.index(item.verdict), item.start - item.stop))
        serious = by_severity[:MAX_ROWS]
        shown_episodes = sorted(serious, key=lambda item: item.start)
        self._sections.append((figure, series.start_ns, shown_episodes, len(episodes) - len(serious)))
        end_ns = series.start_ns + round(float(series.time[-1]) * 1e9)
        self._period = [min(self._period[0], series.start_ns), max(self._period[1], end_ns)]
        self._is_simulated |= generated or bool(forces and forces.simulated)
        if forces and run not in self._traces:
            self._traces[run] = recorded_traces(forces, run)
        self._episodes += [
            {
                "run": run,
                "contact_point": contact_point,
                "verdict": episode.verdict.name,
                "stamp_ns": series.start_ns + round(episode.start * 1e9),
                "start_s": episode.start,
                "duration_s": episode.stop - episode.start,
                "min_margin_m_s": None if math.isnan(episode.min_margin) else episode.min_margin,
                "body_region": episode.body_region,
                "positions": dict(episode.positions),
                "reason": episode.reason,
                "remedy": remedy(episode.reason_code),
            }
            for episode in episodes
        ]

    def write(
        self, title: str, lines: Iterable[tuple[str, str]], result: Mapping[str, Any], paths: Iterable[Path] = ()
    ) -> dict[str, Any]:
        """Write all files; return the summary, which is `result` with figures and episodes. Raises OutputError.

        The page states the hashes of `paths` and of the robot file.
        """
        figures = [section[0] for section in self._sections]
        names = [str(self._folder / name) for name in figure_files(figure.name for figure in figures)]
        summary = {**result, "episodes": self._episodes, "figures": names}
        settings, seconds = self._settings, result["seconds_by_verdict"]
        total_s = sum(seconds.values()) or 1.0
        shares = [(name, seconds[name] / total_s) for name, count in result["cycles_by_verdict"].items() if count][::-1]
        page = render(
            "run.html",
            self._options.language,
            title=title,
            remedy=remedy,
            lines=list(lines),
            sections=self._sections,
            summary=summary,
            shares=shares,
            verdict=worst(Verdict[name] for name, _ in shares).name,
            running=title,
            simulated=self._is_simulated,
            period=self._period if self._sections else None,
            regions=list(self._regions()),
            traces=list(chain(*self._traces.values())),
            margins=list(setting_rows("monitor", settings, ("uncertainty", "margin", "drives", "person_speed"))),
            files=file_hashes([*paths, settings.robot_path]),
            setting_rows=list(setting_rows("monitor", settings, changed_only=True)),
        )
        texts: dict[str, str | dict[str, Any]] = {PAGE: page, SUMMARY: summary}
        write_report_files(self._folder, texts, figures, self._options, overwrite=self._overwrite)
        return summary

    def _regions(self) -> Iterator[tuple[Limit, int, float | None, str]]:
        """Yield the limit of each region with the number of its episodes, their smallest margin [m/s], worst verdict.

        It is that of the contact with the smallest area.
        """
        for limits in zip(*(limits_for(self._settings, name) for name in self._contacts or ("",)), strict=True):
            limit = min(limits, key=lambda limit: limit.permissible_force_n)
            episodes = [item for item in self._episodes if item["body_region"] == limit.region]
            margins = [item["min_margin_m_s"] for item in episodes if item["min_margin_m_s"] is not None]
            verdict = worst(Verdict[item["verdict"]] for item in episodes).name if episodes else ""
            yield limit, len(episodes), min(margins, default=None), verdict


@mpl.rc_context(_STYLE)
def draw_run(
    series: TimeSeries,
    *,
    title: str,
    subtitle: str,
    mass_model: str,
    timeout: float,
    forces: RecordedForce | None = None,
) -> Figure:
    """Return the figure of one contact point; `mass_model` names the mass model that decides the verdict.

    A gap longer than `timeout` [s] without joint states is UNKNOWN. `forces` get a panel of their own.
    """
    heights = (0.25, 2.2, 1.6, 1.3) if forces else (0.25, 2.2, 1.6)
    figure = new_figure(13.0, 1.9 * sum(heights), figure_text(title))
    rows = figure.subplots(len(heights), 1, sharex=True, height_ratios=heights)
    band, speeds, masses = rows[:3]
    series = series.with_gaps(timeout)
    episodes = list(intervals(series, timeout))
    _draw_verdicts(band, episodes, min_width=float(series.time[-1]) / COLUMNS)
    _draw_speeds(speeds, series)
    _draw_masses(masses, series, mass_model)
    if forces:
        _draw_forces(rows[-1], forces, series.start_ns)
    rows[-1].set_xlabel("time since the first joint state [s]")
    masses.set_xlim(0.0, max(float(series.time[-1]), 1e-3))
    unknown = [(item.start, item.stop - item.start) for item in episodes if item.verdict is Verdict.UNKNOWN]
    style = {"facecolor": "none", "edgecolor": "#BBBBBB", "hatch": "////", "linewidth": 0.0}
    for axes in (speeds, masses):
        axes.broken_barh(unknown, (0.0, 1.0), transform=axes.get_xaxis_transform(), zorder=0, **style)
    band.set_title(subtitle, fontsize=9.5, color="#444444")
    figure.align_ylabels()
    return figure


def _draw_verdicts(axes: Axes, episodes: Sequence[Episode], min_width: float) -> None:
    """Draw the band of verdicts; `min_width` [s] keeps the verdict of a single cycle visible."""
    patches = []
    for verdict, style in _VERDICT_STYLES.items():
        bars = [
            (episode.start, max(episode.stop - episode.start, min_width))
            for episode in episodes
            if episode.verdict is verdict
        ]
        axes.broken_barh(bars, (0.0, 1.0), **style)
        if bars:
            patches.append(Patch(label=verdict.name, **style))
    axes.set_ylim(0.0, 1.0)
    axes.set_yticks([])
    axes.grid(visible=False)
    axes.set_ylabel("verdict", rotation=0, ha="right", va="center")
    axes.legend(handles=patches, loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False, ncols=2)


def _draw_speeds(axes: Axes, series: TimeSeries) -> None:
    speed, allowable = series.rows["speed"], series.rows["allowable_speed"]
    _line(axes, series, allowable, color="#0072B2", linewidth=1.6, label="allowable speed")
    _line(axes, series, speed, color="#000000", linewidth=1.2, label="speed")
    above = np.where(speed > allowable, speed, np.nan)
    _line(axes, series, above, color="#D55E00", linewidth=2.4, label="speed above the allowable")
    axes.set_ylabel("speed of the contact point [m/s]")
    axes.set_ylim(bottom=0.0)
    _legend(axes)


def _draw_masses(axes: Axes, series: TimeSeries, mass_model: str) -> None:
    for model, label, color, style in (
        ("lumped", "lumped model", "#0072B2", ":"),
        ("full", "full model", "#000000", "--"),
        ("iso", "ISO, M/2 + m_L", "#CC79A7", "-."),
    ):
        drawn = {"linestyle": style, "linewidth": 1.3, "label": label}
        if model == mass_model:
            drawn = {"linestyle": "-", "linewidth": 2.2, "label": f"{label} (decides)"}
        _line(axes, series, series.rows[f"{model}_mass"], color=color, **drawn)
    if mass_model in {"largest", "auto"}:
        label, mass = f"{mass_model} (decides)", series.rows["effective_mass"]
        _line(axes, series, mass, color="#E69F00", linewidth=4.0, alpha=0.5, label=label)
    masses = np.concatenate([line.get_ydata() for line in axes.get_lines()] or [np.empty(0)])
    masses = masses[np.isfinite(masses)]
    if len(masses) and masses.max() > MAX_LINEAR_RATIO * masses.min():
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter("{x:g}")
    else:
        axes.set_ylim(bottom=0.0)
    axes.set_ylabel("effective mass [kg]")
    _legend(axes)


def _draw_forces(axes: Axes, forces: RecordedForce, start_ns: int) -> None:
    time = (forces.stamp_ns - start_ns) / 1e9
    label = "simulated force" if forces.simulated else "measured force"
    axes.plot(*decimate(time, forces.force, COLUMNS), color="#000000", linewidth=1.0, label=label)
    for usable, marker, label in ((True, "v", "impact"), (False, "x", "impact, clipped or incomplete")):
        impacts = [impact for impact in forces.impacts if usable is not (impact.clipped or impact.incomplete)]
        if impacts:
            onsets = [(impact.stamp_ns - start_ns) / 1e9 for impact in impacts]
            peaks = [impact.peak_force + impact.load_force for impact in impacts]
            axes.plot(onsets, peaks, linestyle="none", marker=marker, color="#D55E00", label=label)
    axes.set_ylabel("force [N]")
    _legend(axes)


def _line(axes: Axes, series: TimeSeries, values: FloatArray, **style: object) -> None:
    """Draw values (m,) unless none of them is known."""
    if np.isfinite(values).any():
        axes.plot(*decimate(series.time, values, COLUMNS), **style)  # type: ignore[arg-type]


def _legend(axes: Axes) -> None:
    if axes.get_lines():
        axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False)

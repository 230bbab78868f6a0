"""The report of a run, live or offline: a figure and the episodes of each contact point, a page, and a summary."""

import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from textwrap import shorten
from typing import Any

from scara_effmass.analysis.figure import draw_run
from scara_effmass.analysis.output import check_output_files
from scara_effmass.analysis.recorded_run import RecordedForce
from scara_effmass.analysis.report import ReportFigure, figure_files, render, report_figure, write_report_files
from scara_effmass.analysis.time_series import Episode, TimeSeries, intervals
from scara_effmass.safety.remedies import remedy
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import Verdict

PAGE, SUMMARY = "report.html", "summary.json"
CAPTION = (
    "Verdict; speed of the contact point and its allowable speed; effective masses. "
    "Hatched: UNKNOWN, or no joint state."
)
MAX_MODELS_LENGTH = 180
"""Length of the line with the mass models that decided, and why."""
MAX_ROWS = 100
"""Most episodes in a table of the page; the summary lists all."""
_SEVERITY = (Verdict.VIOLATION, Verdict.UNKNOWN, Verdict.WARN)


class RunReport:
    """Collects the figures and episodes of a run; `write` writes all files or none."""

    def __init__(self, folder: Path, figures: int, settings: MonitorSettings, *, overwrite: bool) -> None:
        """Prepare for up to `figures` figures; `settings` are those of the monitor.

        Raises OutputError where a file exists.
        """
        self._folder, self._settings, self._overwrite = folder, settings, overwrite
        names = [f"run_{number}" if number > 1 else "run" for number in range(1, figures + 1)]
        check_output_files(folder, [PAGE, SUMMARY, *figure_files(names)], overwrite=overwrite)
        self._names = iter(names)
        self._sections: list[tuple[ReportFigure, list[Episode], int]] = []
        self._episodes: list[dict[str, Any]] = []

    def add(
        self, series: TimeSeries, contact_point: str, run: str, *, generated: bool, forces: RecordedForce | None
    ) -> None:
        """Draw `contact_point` in the run named `run`, with the forces of that run."""
        if not len(series.time):
            return
        settings, model = self._settings, self._settings.effective_mass_model.value
        motion = "generated motion, no real robot" if generated else "recorded motion, modelled masses"
        models = [
            f"{key} ({count / series.mass_models.total():.0%})" for key, count in series.mass_models.most_common()
        ]
        drawing = draw_run(
            series,
            title=f"{run}, {model} mass",
            subtitle=f"{motion} · contact point {contact_point} · below {settings.speed_threshold:g} m/s: worst "
            "direction · allowable speed includes the uncertainty margins"
            f"\n{shorten('mass: ' + '; '.join(models), MAX_MODELS_LENGTH)}",
            mass_model=model,
            timeout=settings.timeout,
            forces=forces,
        )
        figure = report_figure(next(self._names), f"{run}, contact point {contact_point}.", CAPTION, drawing)
        episodes = [item for item in intervals(series, settings.timeout) if item.verdict is not Verdict.OK]
        serious = sorted(episodes, key=lambda item: (_SEVERITY.index(item.verdict), item.start - item.stop))[:MAX_ROWS]
        self._sections.append((figure, sorted(serious, key=lambda item: item.start), len(episodes) - len(serious)))
        self._episodes += [
            {
                "run": run,
                "contact_point": contact_point,
                "verdict": episode.verdict.name,
                "stamp_ns": series.start_ns + round(episode.start * 1e9),
                "start_s": episode.start,
                "duration_s": episode.stop - episode.start,
                "min_margin_m_s": None if math.isnan(episode.min_margin) else episode.min_margin,
                "positions": dict(episode.positions),
                "body_region": episode.body_region,
                "reason": episode.reason,
                "remedy": remedy(episode.reason),
            }
            for episode in episodes
        ]

    def write(self, title: str, lines: Iterable[tuple[str, str]], result: Mapping[str, Any]) -> dict[str, Any]:
        """Write all files; return the summary, which is `result` with figures and episodes. Raises OutputError."""
        figures = [figure for figure, _, _ in self._sections]
        paths = [str(self._folder / name) for name in figure_files(figure.name for figure in figures)]
        summary = {**result, "episodes": self._episodes, "figures": paths}
        texts = {
            PAGE: render("run.html", title=title, remedy=remedy, lines=list(lines), sections=self._sections),
            SUMMARY: f"{json.dumps(summary, indent=2, allow_nan=False)}\n",
        }
        write_report_files(self._folder, texts, figures, overwrite=self._overwrite)
        return summary

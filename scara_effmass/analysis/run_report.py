# SPDX-License-Identifier: Apache-2.0
"""The report of a run, live or offline: a figure and the episodes of each contact point, a page, and a summary."""

import math
from collections.abc import Iterable, Iterator, Mapping
from itertools import chain
from pathlib import Path
from textwrap import shorten
from typing import Any

from scara_effmass.analysis.figure import draw_run
from scara_effmass.analysis.force_traces import ShownTrace, recorded_traces
from scara_effmass.analysis.output import check_output_files
from scara_effmass.analysis.pages import PageOptions, file_hashes, render, setting_rows
from scara_effmass.analysis.recorded_run import RecordedForce
from scara_effmass.analysis.report import ReportFigure, figure_files, report_figure, write_report_files
from scara_effmass.analysis.summary import WORST_FIRST, worst
from scara_effmass.analysis.time_series import Episode, TimeSeries, intervals
from scara_effmass.iso15066 import Limit, limits_for
from scara_effmass.safety.remedies import remedy
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import Verdict

PAGE, SUMMARY = "report.html", "summary.json"
ENGLISH_PAGE = PageOptions()
CAPTION = (
    "Verdict; speed of the contact point and its allowable speed; effective masses. "
    "Hatched: UNKNOWN, or no joint state."
)
MAX_MODELS_LENGTH = 180
"""Length of the line with the mass models that decided, and why."""
MAX_ROWS = 100
"""Most episodes in a table of the page; the summary lists all."""


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
        self._episodes: list[dict[str, Any]] = []

    def add(
        self, series: TimeSeries, contact_point: str, run: str, *, generated: bool, forces: RecordedForce | None
    ) -> None:
        """Draw `contact_point` in the run `run`, with the forces of that run."""
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
            subtitle=f"{motion} · contact point: {contact_point} · below {settings.speed_threshold:g} m/s: worst "
            "direction · allowable speed includes the uncertainty margins"
            f"\n{shorten('mass: ' + '; '.join(models), MAX_MODELS_LENGTH)}",
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
                "positions": dict(episode.positions),
                "body_region": episode.body_region,
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
        pdf_of = PAGE if self._options.pdf else None
        write_report_files(
            self._folder, {PAGE: page, SUMMARY: summary}, figures, overwrite=self._overwrite, pdf_of=pdf_of
        )
        return summary

    def _regions(self) -> Iterator[tuple[Limit, int, float | None, str]]:
        """Yield each limit with the number of episodes that it governs, their smallest margin [m/s], worst verdict."""
        for limit in limits_for(self._settings):
            episodes = [item for item in self._episodes if item["body_region"] == limit.region]
            margins = [item["min_margin_m_s"] for item in episodes if item["min_margin_m_s"] is not None]
            verdict = worst(Verdict[item["verdict"]] for item in episodes).name if episodes else ""
            yield limit, len(episodes), min(margins, default=None), verdict

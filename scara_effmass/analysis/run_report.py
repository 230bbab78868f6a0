"""The report of a run, live or offline: a figure and the episodes of each contact point, a page, and a summary."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from scara_effmass.analysis.figure import FORMATS, draw_run, write
from scara_effmass.analysis.forces import RecordedForce
from scara_effmass.analysis.output import atomic_file, check_output_path
from scara_effmass.analysis.report import EmbeddedFigure, render
from scara_effmass.analysis.time_series import Episode, TimeSeries, episodes
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import Verdict

PAGE, SUMMARY = "report.html", "summary.json"
CAPTION = (
    "Verdict; speed of the contact point and its allowable speed; effective masses. "
    "Hatched: UNKNOWN, or no joint state."
)
MAX_ROWS = 100
"""Most episodes in a table of the page; the summary lists all."""
_SEVERITY = (Verdict.VIOLATION, Verdict.UNKNOWN, Verdict.WARN)


@contextmanager
def run_report(folder: Path, figures: int, settings: MonitorSettings, *, overwrite: bool) -> Iterator[RunReport]:
    """Give a report of up to `figures` figures for `folder`; all its files appear when the `with` ends, or none.

    `settings` are those of the monitor. Raises OutputError where a file exists or cannot be written.
    """
    names = [f"run_{number}" if number > 1 else "run" for number in range(1, figures + 1)]
    for file in (PAGE, SUMMARY, *(f"{name}{suffix}" for name in names for suffix in FORMATS)):
        check_output_path(folder / file, overwrite=overwrite)
    with ExitStack() as stack:

        def create(file: str) -> Path:
            return stack.enter_context(atomic_file(folder / file, overwrite=overwrite))

        yield RunReport(folder, names, settings, create)


class RunReport:
    """A report in progress; see `run_report`."""

    def __init__(
        self, folder: Path, names: list[str], settings: MonitorSettings, create: Callable[[str], Path]
    ) -> None:
        """Write the figures `names`, the page and the summary to the paths that `create` returns for them."""
        self._folder = folder
        self._names = iter(names)
        self._settings = settings
        self._create = create
        self._sections: list[tuple[EmbeddedFigure, list[Episode], int]] = []
        self._episodes: list[dict[str, Any]] = []
        self._figures: list[str] = []

    def add(
        self, series: TimeSeries, contact_point: str, run: str, *, generated: bool, forces: RecordedForce | None
    ) -> None:
        """Draw `contact_point` in the run named `run`, with the forces of that run."""
        if not len(series.time):
            return
        settings, name = self._settings, next(self._names)
        motion = "generated motion, no real robot" if generated else "recorded motion, modelled masses"
        drawing = draw_run(
            series,
            title=f"{run}, {settings.effective_mass_model.value} mass",
            subtitle=f"{motion} · contact point {contact_point} · below {settings.speed_threshold:g} m/s: worst "
            "direction · allowable speed includes the uncertainty margins",
            mass_model=settings.effective_mass_model.value,
            timeout=settings.timeout,
            forces=forces,
        )
        paths = [self._create(f"{name}{suffix}") for suffix in FORMATS]
        write(drawing, *paths)
        self._figures += [str(self._folder / f"{name}{suffix}") for suffix in FORMATS]
        embedded = EmbeddedFigure(name, f"{run}, contact point {contact_point}.", CAPTION, paths[0].read_bytes())
        intervals = episodes(series, settings.timeout)
        serious = sorted(intervals, key=lambda item: (_SEVERITY.index(item.verdict), item.start - item.stop))[:MAX_ROWS]
        self._sections.append((embedded, sorted(serious), len(intervals) - len(serious)))
        self._episodes += [
            {
                "run": run,
                "contact_point": contact_point,
                "verdict": episode.verdict.name,
                "start_s": episode.start,
                "duration_s": episode.stop - episode.start,
                "min_margin_m_s": None if math.isnan(episode.min_margin) else episode.min_margin,
                "reason": episode.reason,
            }
            for episode in intervals
        ]

    def finish(self, title: str, lines: Iterable[tuple[str, str]], result: Mapping[str, Any]) -> dict[str, Any]:
        """Write page and summary; return the summary, which is `result` with figures and episodes."""
        page = render("run.html", title=title, lines=list(lines), sections=self._sections)
        self._create(PAGE).write_text(page, encoding="utf-8")
        summary = {**result, "episodes": self._episodes, "figures": self._figures}
        text = json.dumps(summary, indent=2, allow_nan=False)
        self._create(SUMMARY).write_text(f"{text}\n", encoding="utf-8")
        return summary

"""The report of a run, live or offline: a figure and the episodes per contact point, numbers, and a page."""

from __future__ import annotations

import json
import math
from contextlib import ExitStack, contextmanager
from html import escape
from typing import TYPE_CHECKING, Any

from scara_effmass.analysis.figure import FORMATS, draw_run, write
from scara_effmass.analysis.output import atomic_file, check_output_path
from scara_effmass.analysis.page import Picture, document, figure, table
from scara_effmass.analysis.time_series import episodes
from scara_effmass.values import Verdict

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from pathlib import Path

    from scara_effmass.analysis.forces import RecordedForce
    from scara_effmass.analysis.time_series import Episode, TimeSeries
    from scara_effmass.settings import MonitorSettings

PAGE, SUMMARY = "report.html", "summary.json"
NOTICE = (
    "Advisory software, not a certified safety function. Masses and allowable speeds come from the robot's model and "
    "ISO/TS 15066; allowable speeds include the uncertainty margins. Treat UNKNOWN as unsafe."
)
MAX_TABLE_ROWS = 100
"""Episodes in a table of the page; the summary lists all of them."""


@contextmanager
def run_report(folder: Path, figures: int, settings: MonitorSettings, *, overwrite: bool) -> Iterator[RunReport]:
    """Give a report of up to `figures` figures, to be written into `folder`: all files appear at the end, or none.

    `settings` are those of the monitor. Raises OutputError where a file exists or cannot be written.
    """
    names = [f"run_{number}" if number > 1 else "run" for number in range(1, figures + 1)]
    for file in (PAGE, SUMMARY, *(f"{name}{suffix}" for name in names for suffix in FORMATS)):
        check_output_path(folder / file, overwrite=overwrite)
    with ExitStack() as stack:
        yield RunReport(folder, names, settings, stack, overwrite=overwrite)


class RunReport:
    """A report that is being made; see `run_report`."""

    def __init__(
        self, folder: Path, names: list[str], settings: MonitorSettings, stack: ExitStack, *, overwrite: bool
    ) -> None:
        """Write the figures `names` and the rest into `folder` when `stack` closes."""
        self._folder = folder
        self._names = iter(names)
        self._settings = settings
        self._stack = stack
        self._overwrite = overwrite
        self._sections: list[str] = []
        self._episodes: list[dict[str, Any]] = []
        self._figures: list[str] = []

    def add(
        self, series: TimeSeries, contact_point: str, run: str, *, generated: bool, forces: RecordedForce | None = None
    ) -> None:
        """Draw `contact_point` in the run named `run`, with the forces of that run."""
        settings = self._settings
        if not len(series.time):
            return
        name = next(self._names)
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
        picture = Picture(name, f"{run}: {contact_point}.", CAPTION, paths[0].read_bytes())
        found = episodes(series, settings.timeout)
        self._sections.append(figure(picture) + _episode_table(found))
        self._episodes += [_record(episode, run, contact_point) for episode in found]

    def finish(self, title: str, lines: Iterable[tuple[str, str]], result: Mapping[str, Any]) -> dict[str, Any]:
        """Write page and summary; return `result` with figures and episodes, as the summary holds it."""
        body = "\n".join((f"<p>{escape(NOTICE)}</p>", table(("", "result"), list(lines)), *self._sections))
        self._create(PAGE).write_text(document(title, body), encoding="utf-8")
        summary = {**result, "episodes": self._episodes, "figures": self._figures}
        text = json.dumps(summary, indent=2, allow_nan=False)
        self._create(SUMMARY).write_text(f"{text}\n", encoding="utf-8")
        return summary

    def _create(self, file: str) -> Path:
        return self._stack.enter_context(atomic_file(self._folder / file, overwrite=self._overwrite))


CAPTION = (
    "Verdict, speed of the contact point below its allowable speed, effective masses. "
    "Hatched: no verdict (UNKNOWN) or no joint state."
)


def _episode_table(found: list[Episode]) -> str:
    """Return the episodes as HTML, VIOLATION first, then the longest."""
    order = (Verdict.VIOLATION, Verdict.UNKNOWN, Verdict.WARN)
    first = sorted(found, key=lambda episode: (order.index(episode.verdict), episode.start - episode.stop))
    rows = [
        (
            episode.verdict.name,
            f"{episode.start:.3f}",
            f"{episode.stop - episode.start:.3f}",
            "" if math.isnan(episode.min_margin) else f"{episode.min_margin:+.3f}",
            episode.reason,
        )
        for episode in sorted(first[:MAX_TABLE_ROWS])
    ]
    more = f"; {len(found) - len(rows)} shorter ones are in {SUMMARY}" if len(found) > len(rows) else ""
    heads = ("verdict", "start [s]", "duration [s]", "smallest margin [m/s]", "reason at its start")
    return f"<h2>{len(found)} episodes without verdict OK{more}</h2>" + table(heads, rows)


def _record(episode: Episode, run: str, contact_point: str) -> dict[str, Any]:
    return {
        "run": run,
        "contact_point": contact_point,
        "verdict": episode.verdict.name,
        "start_s": episode.start,
        "duration_s": episode.stop - episode.start,
        "min_margin_m_s": None if math.isnan(episode.min_margin) else episode.min_margin,
        "reason": episode.reason,
    }

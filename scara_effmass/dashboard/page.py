# SPDX-License-Identifier: Apache-2.0
"""The page of a cell: verdict, robot, speeds, masses, impacts, validation, diagnostics and episodes."""

import csv
import io
import math
import re
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime, timezone
from html import escape
from itertools import islice
from pathlib import Path
from typing import Any

from nicegui import ui

from scara_effmass.cell.status import HISTORY_NS, CellStatus, ImpactRecord
from scara_effmass.dashboard.scene import RobotScene
from scara_effmass.impacts.agreement import comparison_text
from scara_effmass.impacts.criterion import impact_count
from scara_effmass.impacts.load import peak_text
from scara_effmass.nodes.cell_client import CellClient
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety.remedies import remedy
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import ContactAssessment, Verdict, at_least, at_most, speed_texts

ADVISORY = "Advisory software, not a certified safety function."
FAST_S, SLOW_S = 0.2, 1.0
_SHAPES = {
    Verdict.OK: '<circle cx="50" cy="50" r="42"/><path d="M29 52l15 15 28-32"/>',
    Verdict.WARN: '<path d="M50 10L94 88H6z"/><path d="M50 38v24M50 74v2"/>',
    Verdict.VIOLATION: '<path d="M32 6h36l26 26v36L68 94H32L6 68V32z"/><path d="M33 33l34 34M67 33L33 67"/>',
    Verdict.UNKNOWN: '<path d="M50 4l46 46-46 46L4 50z"/><path d="M38 40c0-18 25-17 25-1 0 11-13 11-13 22M50 73v2"/>',
}
_LEVELS = ("OK", "WARN", "ERROR", "STALE")
_BEFORE_UNIT = re.compile(r"(?<=\d) (?=(?:N|kg|m/s|s)\b)")
_DIAGNOSTICS_AGE_NS = 5_000_000_000
_SPEED_COLOR, _LIMIT_COLOR, _GRID = "#17202a", "#c2410c", {"left": 50, "right": 16, "top": 52, "bottom": 42}


class Page:
    """One browser's view of the cell."""

    def __init__(self, client: CellClient, dynamics: RobotDynamics, settings: MonitorSettings) -> None:
        self._client = client
        self._beats = 0
        folder = Path(__file__).parent
        ui.add_css(folder / "page.css")
        ui.add_head_html(f"<script>{(folder / 'page.js').read_text(encoding='utf-8')}</script>")
        with ui.element("header").classes("top"):
            _html(f"<h1>Cell {escape(client.node.get_namespace())} · {escape(dynamics.robot.name)}</h1>")
            self._simulated = ui.label().classes("simulated").props("role=note")
            ui.element("span").classes("spring")
            ui.label(ADVISORY)
            self._time = ui.label().classes("time").props("role=timer")  # dates a print or a photo of the page
        with ui.element("div").classes("page"):
            self._make_verdict()
            with _card("Robot", "wide"):
                self._scene = RobotScene(dynamics, settings)
                _html(
                    "Links: in the colour of their verdict. At the worst place of each: velocity (black), worst normal "
                    "(magenta), root of the effective mass (ellipsoid).",
                    "note",
                )
                self._scene_note = ui.label().classes("note")
            with _card("Speed and allowable speed, last 60 s", "wide"):
                lines = [
                    _line("allowable", _LIMIT_COLOR, type="dashed", step="end"),
                    _line("speed", _SPEED_COLOR, areaStyle={"opacity": 0.08}),
                ]
                self._speeds = _chart("speed and allowable speed", "s before now", "m/s", lines, -60)
            with _card("Contact points", "whole"):
                self._contacts = _html("", "scroll numbers")
            with _card("Last impacts", "wide"):
                lines = [
                    _line("force", _SPEED_COLOR),
                    _line("predicted peak", _LIMIT_COLOR, type="dashed"),
                    _line("impact before", "#9aa5b1"),
                ]
                self._force = _chart("force of the last impact", "ms after the onset", "N", lines)
                self._impacts = _html("", "scroll")
            with _card("Predicted and measured peak force", "wide"):
                points = [
                    _points("predicted too low", "#a61b1b", 11, "triangle"),
                    _points("on the safe side", "#0b6b4b", 9),
                    _line("equal", "#9aa5b1"),
                ]
                self._scatter = _chart("predicted and measured peak forces", "predicted [N]", "measured [N]", points)
                self._series = ui.label().classes("note")
            with _card("Load by the torques, last 60 s", "wide"):
                lines = [
                    _line("load", _SPEED_COLOR),
                    _line("interval of 95 %", "#9aa5b1"),
                    _line("interval of 95 %", "#9aa5b1"),
                    _line("stated", _LIMIT_COLOR, type="dashed"),
                ]
                self._loads = _chart("load by the torques of the joints", "s before now", "kg", lines, -60)
                self._load = ui.label().classes("note")
            with _card("Episodes", "wide log"):
                self._episodes = _html("", "scroll")
                _html('<a href="/episodes.csv" download>Download all episodes (CSV)</a>')
            with _card("Diagnostics", "whole log"):
                self._diagnostics = _html("", "scroll")
        self._beat = ui.label().props("id=beat aria-hidden=true")
        ui.timer(FAST_S, self._refresh)
        ui.timer(SLOW_S, self._refresh_slowly)

    def _make_verdict(self) -> None:
        with ui.element("section").classes("verdict live") as self._panel:
            self._panel.props('aria-label="Verdict"')
            self._icon = _html("")
            with ui.element("div"):
                self._word = ui.label().classes("word").props("role=status aria-live=assertive")
                self._reason = ui.label().classes("reason")
                self._remedy = ui.label().classes("remedy")
                self._assumed = ui.label().classes("remedy")
            self._now = _html("", "now")
        # page.js shows this while the server is silent.
        with ui.element("section").classes("verdict gone UNKNOWN").props('aria-label="Verdict without connection"'):
            _html(_icon(Verdict.UNKNOWN))
            with ui.element("div"):
                ui.label("UNKNOWN").classes("word").props("role=status")
                ui.label("This page has no connection to the dashboard server.").classes("reason")

    def _refresh(self) -> None:
        """Show verdict, speeds and pose."""
        now_ns = time.monotonic_ns()
        status = self._client.poll()  # else a delay of this page would count as silence of the monitor
        verdict = status.verdict
        if self._word.text != verdict.name:
            self._panel.classes(remove=" ".join(Verdict.__members__), add=verdict.name)
            self._icon.content = _icon(verdict)
            self._word.text = verdict.name
        is_ok = verdict is Verdict.OK
        reason = status.scope if is_ok else f"{status.contact_point}: {status.reason}".strip(": ")
        self._reason.text = reason[:1].upper() + reason[1:]
        self._assumed.text = f"Assumed: {status.assumed}." if status.assumed else ""
        advice = remedy(status.reason_code)
        self._remedy.text = f"Remedy: {advice}.".replace("`", "") if advice else ""
        self._now.content = _speed_html(status)
        self._contacts.content = _table(*contact_rows(status))
        self._simulated.text = f"SIMULATED {' AND '.join(status.simulated).upper()}" if status.simulated else ""
        self._scene.update(status, now_ns)
        self._scene_note.text = self._scene.note
        self._time.text = f"{datetime.now().astimezone():%Y-%m-%d %H:%M:%S}"
        self._beats += 1
        self._beat.text = str(self._beats)

    def _refresh_slowly(self) -> None:
        """Show charts and tables."""
        now_ns, status = time.monotonic_ns(), self._client.status
        _show(self._speeds, *speed_lines(status, now_ns))
        records = list(status.impacts)
        traces: list[list[list[float]]] = [[], [], []]
        for record, index in zip(reversed(records), (0, 2), strict=False):
            pairs = zip(record.time_s.tolist(), record.force.tolist(), strict=True)
            traces[index] = [[round(1e3 * t, 2), round(f, 1)] for t, f in pairs]
        if records and records[-1].validation and traces[0]:
            predicted = round(records[-1].validation.predicted_force, 1)
            traces[1] = [[traces[0][0][0], predicted], [traces[0][-1][0], predicted]]
        _show(self._force, *traces)
        self._force.set_visibility(bool(traces[0]))
        rows = [
            [self._clock(record.at_ns) + " (simulated)" * record.impact.simulated, *impact_texts(record)]
            for record in islice(reversed(records), 4)
        ]
        self._impacts.content = _table(
            ["impact", "peak", "predicted", "error", "on the body region"], rows, status.no_impact_reason
        )
        low, safe = (
            [[v.predicted_force, v.measured_force] for v in status.validations if v.conservative is c]
            for c in (False, True)
        )
        end = max((force for point in low + safe for force in point), default=0.0)
        _show(self._scatter, low, safe, [[0.0, 0.0], [end, end]] if end else [])
        self._scatter.set_visibility(bool(status.validations))
        self._series.text = _series_text(status)
        _show(self._loads, *load_lines(status, now_ns))
        self._loads.set_visibility(any(sample.is_observable for sample in status.loads))
        self._load.text = status.load_text(now_ns)
        self._diagnostics.content = _table(
            ["node", "status", "message"],
            list(diagnostic_rows(status, now_ns)),
            "no diagnostics are received: no node of this cell publishes them",
        )
        episodes = [
            [
                self._clock(episode.start_ns) + " (simulated)" * bool(episode.simulated),
                episode.verdict.name,
                f"{((episode.end_ns or now_ns) - episode.start_ns) / 1e9:.1f} s"
                + ", lasting" * (episode.end_ns is None),
                f"{episode.contact_point}: {episode.cause}".strip(": "),
            ]
            for episode in islice(reversed(status.episodes), 6)
        ]
        self._episodes.content = _table(
            ["start", "verdict", "duration", "cause"], episodes, "none: the verdict has been OK"
        )

    def _clock(self, at_ns: int) -> str:
        return datetime.fromtimestamp(self._client.wall_ns(at_ns) / 1e9).astimezone().strftime("%H:%M:%S")


def csv_of(client: CellClient) -> str:
    """Return the episodes of a cell as CSV, times in UTC; an episode that lasts has no end."""
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(["verdict", "start", "end", "duration_s", "contact_point", "cause", "simulated"])
    for episode in client.status.episodes:
        start, end = (
            ""
            if at_ns is None
            else datetime.fromtimestamp(client.wall_ns(at_ns) / 1e9, timezone.utc).isoformat(timespec="milliseconds")
            for at_ns in (episode.start_ns, episode.end_ns)
        )
        duration = "" if episode.end_ns is None else f"{(episode.end_ns - episode.start_ns) / 1e9:.3f}"
        # A leading apostrophe keeps a spreadsheet from evaluating the text of a message.
        point, cause = (
            f"'{text}" if text.startswith(("=", "+", "-", "@")) else text
            for text in (episode.contact_point, episode.cause)
        )
        writer.writerow([episode.verdict.name, start, end, duration, point, cause, " and ".join(episode.simulated)])
    return text.getvalue()


def _speed_html(status: CellStatus) -> str:
    """Return speed and allowable speed of the contact point that decides, and the speed scaling, as HTML."""
    if status.verdict is Verdict.UNKNOWN or status.decision is None:
        return "<b>0 m/s</b><br>allowed while the verdict is UNKNOWN"
    contact = status.decision.worst
    share = min(contact.speed / contact.allowable_speed, 1.0) if contact.allowable_speed > 0.0 else 1.0
    speed, allowed = speed_texts(contact.speed, contact.allowable_speed)
    return (
        f"<b>{speed}</b> of <b>{allowed} m/s</b> allowed"
        f'<div class="bar" aria-hidden="true"><i style="width:{share:.0%}"></i></div>'
        f"{escape(contact.contact_point)} · {escape(contact.body_region.replace('_', ' '))} · "
        f"speed scaling {at_most(status.speed_scaling, 2)}"
    )


def speed_lines(status: CellStatus, now_ns: int) -> tuple[list[list[float | None]], list[list[float | None]]]:
    """Return allowable speeds and speeds over the last minute; a gap in time is a gap in the line.

    Under UNKNOWN no speed is allowed, and the speed is a gap: it is not known.
    """
    lines: tuple[list[list[float | None]], list[list[float | None]]] = ([], [])
    last_ns = 0
    for sample in status.speeds:
        is_known = sample.verdict is not Verdict.UNKNOWN
        allowable, speed = float(at_most(sample.allowable_speed, 3)), float(at_least(sample.speed, 3))
        for line, value in zip(lines, (allowable, speed if is_known else None), strict=True):
            if line and sample.at_ns - last_ns > status.timeout_ns:
                line.append([round((last_ns - now_ns) / 1e9, 2), None])
            line.append([round((sample.at_ns - now_ns) / 1e9, 2), value])
        last_ns = sample.at_ns
    return lines


def load_lines(status: CellStatus, now_ns: int) -> list[list[list[float | None]]]:
    """Return the load by the torques, both ends of its interval, and the stated load over the last minute.

    Where it is not observable there is a gap.
    """
    samples = [sample for sample in status.loads if now_ns - sample.at_ns <= HISTORY_NS]
    return [
        [
            [round((sample.at_ns - now_ns) / 1e9, 2), round(getattr(sample, name), 3) if sample.is_observable else None]
            for sample in samples
        ]
        for name in ("mass", "mass_lower", "mass_upper", "stated_mass")
    ]


def contact_rows(status: CellStatus) -> tuple[list[str], list[list[str]], str]:
    """Return a table with a row for each contact."""

    def mass(value: float) -> str:
        return "none" if math.isnan(value) else f"{value:.2f} kg"

    columns: dict[str, Callable[[ContactAssessment], str]] = {
        "along the velocity": lambda contact: contact.contact_point,
        "verdict": lambda contact: contact.verdict.name,
        "speed": lambda contact: f"{speed_texts(contact.speed, contact.allowable_speed)[0]} m/s",
        "allowable speed": lambda contact: f"{speed_texts(contact.speed, contact.allowable_speed)[1]} m/s",
        "effective mass, lumped": lambda contact: mass(contact.lumped_mass),
        "effective mass, full": lambda contact: mass(contact.full_mass),
        "effective mass, ISO": lambda contact: mass(contact.iso_mass),
        "deciding mass": lambda contact: (
            f"{contact.mass_model}, {'at least ' * contact.mass_capped}{mass(contact.effective_mass)}"
        ),
        "upper bound of force": lambda contact: f"{at_least(contact.force_bound, 0)} N",
        "limit": lambda contact: f"{contact.body_region.replace('_', ' ')}, {contact.criterion}",
    }
    contacts = status.contacts if status.verdict is not Verdict.UNKNOWN else ()
    rows = [[text(contact) for text in columns.values()] for contact in contacts]
    return [*columns], rows, "no numbers while the verdict is UNKNOWN"


def impact_texts(record: ImpactRecord) -> list[str]:
    """Return peak, predicted force or why there is none, its error, and the forces on the body with their limits."""
    peak, impact = peak_text(record.impact), record.validation
    if impact is None:
        return [peak, f"none: {record.left_out}" if record.left_out else "none yet", "", ""]
    return [peak, f"{impact.predicted_force:.1f} N", f"{impact.relative_error:+.1%}", comparison_text(impact)]


def _series_text(status: CellStatus) -> str:
    if not status.validations:
        return status.no_validation_reason
    last = status.validations[-1].series
    outcome = "accepted" if last.accepted else "not accepted" if last.decidable else "not decidable"
    text = f"{impact_count(last.count)}, correlation {last.correlation:.3f}: {outcome}"
    return f"{text}: {last.reason}" if last.reason else text


def diagnostic_rows(status: CellStatus, now_ns: int) -> Iterator[list[str]]:
    """Yield node and name, level, and message of each diagnostic status."""
    for entry in sorted(status.diagnostics.values(), key=lambda entry: entry.name):
        node, _, name = entry.name.partition(": ")
        is_stale = now_ns - entry.at_ns > _DIAGNOSTICS_AGE_NS
        message = f"silent for {(now_ns - entry.at_ns) / 1e9:.0f} s" if is_stale else entry.message
        yield [f"{node.rpartition('/')[2]} {name}", "STALE" if is_stale else _LEVELS[min(entry.level, 3)], message]


def _icon(verdict: Verdict) -> str:
    style = 'fill="none" stroke="currentColor" stroke-width="8" stroke-linecap="round" stroke-linejoin="round"'
    return f'<svg viewBox="0 0 100 100" aria-hidden="true" {style}>{_SHAPES[verdict]}</svg>'


def _table(headings: Sequence[str], rows: Sequence[Sequence[str]], empty: str = "") -> str:
    """Return an HTML table; the first column of a row is its heading."""
    if not rows:
        return f'<p class="note">{escape(empty)}</p>'
    head = "".join(f'<th scope="col">{escape(heading)}</th>' for heading in headings)
    body = "".join(
        f'<tr><th scope="row">{escape(row[0])}</th>{"".join(f"<td>{escape(cell)}</td>" for cell in row[1:])}</tr>'
        for row in rows
    )
    return f"<table><thead><tr>{head}</tr></thead><tbody>{_BEFORE_UNIT.sub('&nbsp;', body)}</tbody></table>"


def _html(content: str, classes: str = "") -> ui.html:
    """Return an element with `content`, whose texts of messages are escaped."""
    return ui.html(content, sanitize=False).classes(classes)


@contextmanager
def _card(title: str, classes: str = "") -> Iterator[None]:
    with ui.element("section").classes(f"card {classes}").props(f'aria-label="{title}"'):
        _html(f"<h2>{escape(title)}</h2>")
        yield


def _line(name: str, color: str, type: str = "solid", **options: Any) -> dict[str, Any]:  # noqa: A002, ANN401 - of ECharts
    style = {"color": color, "width": 2, "type": type}
    return {"name": name, "type": "line", "color": color, "lineStyle": style, "showSymbol": False, **options}


def _points(name: str, color: str, size: int, symbol: str = "circle") -> dict[str, Any]:
    return {"name": name, "type": "scatter", "symbol": symbol, "symbolSize": size, "color": color}


def _chart(label: str, x_name: str, y_name: str, series: list[dict[str, Any]], x_min: int | None = None) -> ui.echart:
    """Return a chart; with `x_min` it ends at x = 0, now."""
    x_max = None if x_min is None else 0
    axis = {"nameLocation": "middle", "nameTextStyle": {"color": _SPEED_COLOR}, "axisLabel": {"color": _SPEED_COLOR}}
    options = {
        "animation": False,
        "grid": _GRID,
        "legend": {"top": 0, "left": 0},
        "xAxis": {"type": "value", "name": x_name, "nameGap": 24, "min": x_min, "max": x_max, "scale": True, **axis},
        "yAxis": {"type": "value", "name": y_name, "nameGap": 36, "min": 0, **axis},
        "series": [{"data": [], **line} for line in series],
    }
    return ui.echart(options, renderer="svg").props(f'role=img aria-label="{label}"')


def _show(chart: ui.echart, *data: object) -> None:
    for series, values in zip(chart.options["series"], data, strict=True):
        series["data"] = values

# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass watch`, `dashboard` and `foxglove`: show a live cell in a terminal, on a web page, or in Foxglove."""

from __future__ import annotations

import argparse
import os
import secrets
import socket
import sys
import threading
import time
import webbrowser
from functools import partial
from typing import TYPE_CHECKING

from rich.align import Align
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from scara_effmass.cli.console import VERDICT_STYLES, live_file, print_lines, printer
from scara_effmass.cli.options import load_dynamics, monitor_settings
from scara_effmass.errors import SettingsError
from scara_effmass.impacts.agreement import comparison_text
from scara_effmass.impacts.load import peak_text
from scara_effmass.safety.remedies import remedy
from scara_effmass.values import Verdict, at_least, at_most, severity, speed_texts

if TYPE_CHECKING:
    from collections.abc import Callable

    from scara_effmass.cell.status import CellStatus, ImpactRecord

_NICENESS = 10
"""The nodes on this machine have priority over the dashboard."""
PERIOD_S = 0.1
MIN_ROWS = 10
"""Rows of a terminal for the large letters."""
_WHOLE_KG = 100.0
"""From this mass on [kg], whole ones are shown."""
_CHARACTERS = "OKWARNVILTU0123456789.-"
_FONT = (
    ".##. #..# #...# .##. ###. #..# #...# # #.. ### #..# ### .#. ### ### #.# ### ### ### ### ### . ...",
    "#..# #.#. #...# #..# #..# ##.# #...# # #.. .#. #..# #.# ##. ..# ..# #.# #.. #.. ..# #.# #.# . ...",
    "#..# ##.. #.#.# #### ###. #.## #...# # #.. .#. #..# #.# .#. ### ### ### ### ### ..# ### ### . ###",
    "#..# #.#. #.#.# #..# #.#. #..# .#.#. # #.. .#. #..# #.# .#. #.. ..# ..# ..# #.# ..# #.# ..# . ...",
    ".##. #..# .#.#. #..# #..# #..# ..#.. # ### .#. .##. ### ### ### ### ..# ### ### ..# ### ### # ...",
)
"""Five rows of pixels of `_CHARACTERS`."""


def has_display() -> bool:
    """Return whether a browser can open a window here."""
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def run_dashboard(args: argparse.Namespace) -> int:
    """Serve the page until a signal ends it; return 0. Raises EffmassError."""
    from scara_effmass.dashboard.server import bound_socket, is_local, serve  # noqa: PLC0415 - an extra
    from scara_effmass.nodes.cell_client import CellClient  # noqa: PLC0415 - rclpy

    settings = monitor_settings(args)
    dynamics = load_dynamics(settings)
    token = args.token or ("" if is_local(args.host) else secrets.token_urlsafe(16))
    listener = bound_socket(args.host, args.port)
    is_any = args.host in {"0.0.0.0", "::"}  # noqa: S104 - only compared
    host = socket.gethostname() if is_any else f"[{args.host}]" if ":" in args.host else args.host
    address = f"http://{host}:{listener.getsockname()[1]}/{f'?token={token}' if token else ''}"

    def on_start() -> None:
        print_lines([("dashboard", address)])
        if args.open and has_display():
            threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()  # some browsers block

    os.nice(_NICENESS)
    with listener, CellClient("dashboard", args.ros_arguments) as client:
        serve(client, dynamics, settings, listener, token, on_start)
    return 0


def run_foxglove(args: argparse.Namespace) -> int:
    """Serve live topics until a signal ends it."""
    from scara_effmass.nodes.foxglove_server import serve  # noqa: PLC0415 - rclpy, and an optional library

    show = partial(printer(live=True).print, soft_wrap=True)
    serve(
        args.topics,
        args.host,
        args.port,
        args.ros_arguments,
        ready=lambda port: show(f"serving on ws://{args.host}:{port}; Ctrl-C ends it"),
        warn=show,
    )
    return 0


def run_watch(args: argparse.Namespace) -> int:
    """Show the cell until a signal ends it. Raises SettingsError without a terminal, or for invalid ROS arguments."""
    console = Console(file=live_file(sys.stdout), highlight=False, markup=False)
    problem = "" if sys.stdout.isatty() else "stdout must be a terminal"
    if not problem and console.is_dumb_terminal:
        problem = f"TERM = {os.environ.get('TERM')}: must move the cursor"
    if problem:
        raise SettingsError(f"watch: {problem}; the log of the monitor has each change of its verdict")
    from scara_effmass.nodes.cell_client import CellClient  # noqa: PLC0415 - rclpy

    with CellClient("watch", args.ros_arguments) as client:
        name, block = client.node.get_namespace(), "#" if console.options.ascii_only else "█"
        with Live(console=console, screen=True, auto_refresh=False) as live:
            while not client.signals:
                status = client.poll()
                size = console.width, console.height
                live.update(screen(status, time.monotonic_ns(), name, *size, block), refresh=True)
                time.sleep(PERIOD_S)
    return 0


def screen(status: CellStatus, now_ns: int, name: str, width: int, height: int, block: str = "█") -> RenderableType:
    """Return the screen of `status` for a terminal of `width` columns and `height` rows.

    Its large letters consist of `block`; where they do not fit, the verdict comes first.
    """
    verdict, style = status.verdict, VERDICT_STYLES[status.verdict]
    is_unknown = verdict is Verdict.UNKNOWN
    rows = max((height - 10) // 2, 5) if height >= MIN_ROWS else 0
    seconds = (now_ns - status.verdict_since_ns) / 1e9
    point = f" at {status.contact_point}" * bool(status.contact_point and verdict is not Verdict.OK)
    simulated = f"SIMULATED: {', '.join(status.simulated)}" * bool(status.simulated)
    # The clock shows whether the display still updates.
    header = Table.grid(expand=True)
    header.add_column(justify="left")
    header.add_column(justify="center")
    header.add_column(justify="right")
    header.add_row(Text(f"scara-effmass watch {name}"), Text(simulated, "bold reverse"), time.strftime("%H:%M:%S"))
    fill = "? " * (width // 2) if is_unknown else ""
    word = Text(f"{verdict.name}{point} for {seconds:.0f} s", justify="center")
    hatching = Text(fill, no_wrap=True)
    banner = Group(hatching, Align.center(Text(_big(verdict.name, width, rows, block))), word, hatching)
    parts: list[RenderableType] = [header, Padding(banner, 0, style=style)]
    if not rows:
        parts = [Padding(word, 0, style=style), header]
    worst = status.decision.worst if status.decision is not None else None
    figures = Table.grid(expand=True)
    for _ in range(2):
        figures.add_column(justify="center", ratio=1)
    pair = (
        ("-.---", "-.---")
        if is_unknown or worst is None
        else (_figure(worst.speed, at_least), _figure(worst.allowable_speed, at_most))
    )
    figures.add_row(Text("speed [m/s]"), Text("allowable speed [m/s]"), style="bold")
    figures.add_row(*(Align.center(Text(_big(text, width // 2, rows, block))) for text in pair))
    parts.append(figures)
    if status.reason:
        parts.append(Text(status.reason, style="bold"))
    if verdict is Verdict.OK:
        parts.append(Text(status.scope))
    if status.assumed:
        parts.append(Text(f"assumed: {status.assumed}"))
    if is_unknown:
        parts.append(Text(f"remedy: {remedy(status.reason_code)}"))
    past = next((episode for episode in reversed(status.episodes) if episode.end_ns is not None), None)
    if past is not None and past.end_ns is not None:
        ago_s = (now_ns - past.end_ns) / 1e9
        lasted_s = (past.end_ns - past.start_ns) / 1e9
        cause = f"{past.contact_point}: {past.cause}".removeprefix(": ")
        parts.append(Text(f"before: {past.verdict.name} until {ago_s:.0f} s ago, for {lasted_s:.2f} s: {cause}"))
    if status.unknown_force:
        parts.append(Text(status.unknown_force, style="bold"))
    if status.impacts:
        parts.append(Text(_impact_text(status.impacts[-1], now_ns)))
    used = len(Console(width=width).render_lines(Group(*parts)))
    parts.append(_points(status, max(height - used - 1, 1)))
    return Group(*parts)


def _impact_text(record: ImpactRecord, now_ns: int) -> str:
    """Return peak, age and prediction of an impact, or why it has none."""
    validation = record.validation
    text = f"last impact: peak {peak_text(record.impact)}, {(now_ns - record.at_ns) / 1e9:.0f} s ago"
    if validation is not None:
        return f"{text}, predicted {validation.predicted_force:.1f} N; {comparison_text(validation)}"
    return f"{text}, not predicted: {record.left_out}" if record.left_out else text


def _points(status: CellStatus, rows: int) -> Table:
    """Return a row for each contact point, the worst first; without numbers where the whole cell is UNKNOWN.

    Of more than `rows`, the last one says how many have none.
    """
    table = Table(box=None, pad_edge=False)
    for heading in ("contact point", "verdict", "m/s", "of m/s", "kg", "body region"):
        table.add_column(heading, justify="right" if "m/s" in heading or heading == "kg" else "left", no_wrap=True)
    contacts = sorted(status.contacts, key=lambda contact: (-severity(contact.verdict), -contact.limit_share))
    shown = contacts if len(contacts) <= rows else contacts[: rows - 1]
    for contact in shown:
        verdict = contact.verdict if status.verdict is not Verdict.UNKNOWN else Verdict.UNKNOWN
        mass = contact.effective_mass
        mass_text = f"{'>=' * contact.mass_capped}{mass:{'.0f' if mass >= _WHOLE_KG else '.3g'}}"
        numbers = (*speed_texts(contact.speed, contact.allowable_speed), mass_text)
        if verdict is Verdict.UNKNOWN:
            numbers = ("-", "-", "-")
        table.add_row(
            Text(contact.contact_point), Text(verdict.name, VERDICT_STYLES[verdict]), *numbers, contact.body_region
        )
    if rest := len(contacts) - len(shown):
        table.add_row(f"and {rest} more")
    return table


def _figure(speed: float, rounded: Callable[[float, int], str]) -> str:
    """Return a speed [m/s] in five characters."""
    return next((text for digits in (3, 2, 1) if len(text := rounded(speed, digits)) <= 5), rounded(speed, 0))


def _big(text: str, width: int, height: int, block: str) -> str:
    """Return `text` in letters of `block`, as large as fits into `width` columns and `height` rows.

    Where not even the smallest ones fit, it is returned as it is.
    """
    glyphs = [[row.split()[_CHARACTERS.index(character)] for row in _FONT] for character in text]
    columns = sum(len(glyph[0]) for glyph in glyphs) + len(glyphs) - 1
    if not (scale := min(width // columns, 2 * (height // 5))):
        return text
    lines = (".".join(glyph[row] for glyph in glyphs) for row in range(5))
    blocks = ("".join((" " if pixel == "." else block) * scale for pixel in line) for line in lines)
    return "\n".join("\n".join([line] * ((scale + 1) // 2)) for line in blocks)

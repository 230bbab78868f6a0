# SPDX-License-Identifier: Apache-2.0
"""Print results and the status of a live run: lines of subject and text, tables, JSON, and progress."""

from __future__ import annotations

import io
import json
import os
import select
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from functools import partial
from itertools import chain
from textwrap import wrap
from typing import Any, TextIO

from rich.box import SIMPLE_HEAD
from rich.console import Console, Group
from rich.live import Live
from rich.progress import Progress, ProgressColumn
from rich.table import Table
from rich.text import Text

from scara_effmass.values import ContactAssessment, Decision, Verdict, at_most

PIPE_WIDTH = 160
"""Width of the output without a terminal [columns]."""
PIPE_PERIOD_S, TERMINAL_PERIOD_S = 2.0, 0.125
"""Period of the status of a live run."""
PATIENCE_S = 0.2
"""Time for which live output waits for a terminal."""
WIDE = 100
"""Columns from which a table has room for sentences."""
_MAX_WORD = 20
LEVEL_STYLES = {"ok": "green", "note": "yellow", "wrong": "bold white on red"}
VERDICT_STYLES = {
    Verdict.OK: "bold black on green",
    Verdict.WARN: "bold black on yellow",
    Verdict.VIOLATION: "bold white on red",
    Verdict.UNKNOWN: "bold white on magenta",
}


def printer(*, live: bool = False) -> Console:
    """Return the console for results, on stdout; `live`: for those of a command that still runs."""
    width = None if sys.stdout.isatty() else PIPE_WIDTH
    file = live_file(sys.stdout) if live else sys.stdout
    return Console(file=file, highlight=False, markup=False, soft_wrap=True, width=width)


class _Terminal(io.RawIOBase):
    """Terminal that loses output in place of waiting longer than PATIENCE_S for it."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def writable(self) -> bool:
        return True

    def isatty(self) -> bool:
        return True

    def fileno(self) -> int:
        return self._descriptor

    def write(self, data: Any) -> int:  # noqa: ANN401 - any buffer
        rest, end_s = memoryview(data), time.monotonic() + PATIENCE_S
        while rest and (left_s := end_s - time.monotonic()) > 0.0:
            if select.select([], [self._descriptor], [], left_s)[1]:
                with suppress(BlockingIOError):
                    rest = rest[os.write(self._descriptor, rest) :]
        return len(data)

    def close(self) -> None:
        if not self.closed:
            os.close(self._descriptor)
        super().close()


def live_file(stream: TextIO) -> TextIO:
    """Return `stream`, or for a terminal one that loses output in place of holding up a live command.

    After Ctrl-S or on a lost connection a terminal stands still; a write that waits for it also keeps signals away.
    """
    if not stream.isatty():
        return stream
    try:  # opened again, because the mode of the stream is also that of the shell
        descriptor = os.open(os.ttyname(stream.fileno()), os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY)
    except OSError:  # it is another user's, as after su
        return stream
    return io.TextIOWrapper(
        io.BufferedWriter(_Terminal(descriptor)), stream.encoding, stream.errors, write_through=True
    )


def print_lines(lines: Iterable[tuple[str, object]]) -> None:
    """Print each subject and its text in two columns."""
    console = printer()
    for subject, text in lines:
        console.print(f"{subject:<15} {text}")


def print_json(result: object) -> None:
    """Print `result` as JSON, paths as text. Raises ValueError for NaN and infinity, which JSON does not have."""
    text = json.dumps(result, allow_nan=False, default=str)
    try:
        json.dumps(result, ensure_ascii=False, default=str).encode(sys.stdout.encoding or "utf-8")
        ensure_ascii = False
    except UnicodeEncodeError:  # JSON has its own escapes
        ensure_ascii = True
    printer().print_json(text, ensure_ascii=ensure_ascii)


def print_result(result: object, lines: Iterable[tuple[str, object]], *, as_json: bool) -> None:
    """Print `result` as JSON, or else `lines` of subject and text."""
    if as_json:
        print_json(result)
    else:
        print_lines(lines)


def print_table(title: str, headings: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Print a table; numbers are aligned right, a missing number reads "none", and levels have their colour.

    Words of up to 20 characters, as UR names its joints, are kept whole.
    """

    def text_of(value: object) -> str:
        return "none" if value is None else f"{value:.4g}" if isinstance(value, int | float) else str(value)

    table = Table(box=SIMPLE_HEAD, title=title or None, title_justify="left", collapse_padding=True)
    rows = list(rows)
    for heading, column in zip(headings, zip(*rows, strict=True), strict=True):
        is_numeric = all(value is None or isinstance(value, int | float) for value in column)
        longest = max(len(word) for text in (heading, *map(text_of, column)) for word in (text.split() or [""]))
        table.add_column(
            heading, justify="right" if is_numeric else "left", overflow="fold", min_width=min(longest, _MAX_WORD)
        )
    for row in rows:
        table.add_row(*(Text(cell, LEVEL_STYLES.get(cell, "")) for cell in map(text_of, row)))
    printer().print(table)


def print_findings(rows: Sequence[tuple[str, str, str]]) -> None:
    """Print rows of level, subject and text: as a table, or below 100 columns as paragraphs, which keep words whole."""
    console = printer()
    if console.width >= WIDE:
        print_table("", ("level", "subject", "result"), rows)
        return
    indent = 2 + max(len(level) for level, *_ in rows)
    for level, subject, text in rows:
        lines = wrap(f"{subject}: {text}", console.width - indent, break_long_words=False, break_on_hyphens=False)
        console.print(Text(f"{level:<{indent}}", LEVEL_STYLES.get(level, "")) + Text(lines[0]))
        for line in lines[1:]:
            console.print(f"{'':{indent}}{line}")


def progress_bar(*columns: ProgressColumn) -> Progress:
    """Return a progress bar on stderr, to be used in a `with`; it is invisible unless stderr is a terminal."""
    return Progress(
        *columns, console=Console(file=live_file(sys.stderr)), disable=not sys.stderr.isatty(), transient=True
    )


@contextmanager
def shown_progress(name: str, total: float = 1.0) -> Iterator[partial[None]]:
    """Give a function that advances a progress bar called `name`, by 1 or by its argument, of `total`."""
    with progress_bar() as progress:
        yield partial(progress.advance, progress.add_task(name, total=total))


ShowStatus = Callable[[Decision, float], None]


@contextmanager
def live_status(console: Console, *, visible: bool) -> Iterator[ShowStatus]:
    """Give a function that shows a decision and the time of the run [s].

    A terminal gets updating lines, a pipe a line every 2 s; an invisible status prints nothing.
    """
    live = Live(console=console, auto_refresh=False, transient=True) if visible and console.is_terminal else None
    last_update_s = 0.0

    def show(decision: Decision, time_s: float) -> None:
        nonlocal last_update_s
        now_s = time.monotonic()
        if not visible or now_s - last_update_s < (TERMINAL_PERIOD_S if live else PIPE_PERIOD_S):
            return
        last_update_s = now_s
        contacts = decision.contacts
        lines = [_status_line(contact, time_s, decision.speed_scaling) for contact in contacts]
        if live is None:
            console.print(*lines, sep="\n")
        else:
            reasons = [Text(f"  {contact.reason}", no_wrap=True, overflow="ellipsis") for contact in contacts]
            live.update(Group(*chain.from_iterable(zip(lines, reasons, strict=True))), refresh=True)

    with live or nullcontext():
        yield show


def _status_line(contact: ContactAssessment, time_s: float, speed_scaling: float) -> Text:
    text = Text(f"{time_s:6.1f} s  {contact.contact_point}: ", no_wrap=True)
    is_unknown = contact.verdict is Verdict.UNKNOWN
    numbers = f"-.--- of 0.000 m/s, {'-':>6}" if is_unknown else f"{contact.speed_text}, {contact.effective_mass:6.3g}"
    text.append(f"{numbers} kg  ")
    text.append(f"{contact.verdict.name:<9}", VERDICT_STYLES[contact.verdict])
    return text.append(f"  scaling {at_most(speed_scaling, 2)}")

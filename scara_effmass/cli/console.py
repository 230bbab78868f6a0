"""How every command prints: lines of subject and text, JSON, and progress."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import Progress

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rich.progress import ProgressColumn

PIPE_WIDTH = 160
"""Columns where no terminal sets them: wide enough for every table."""


def printer() -> Console:
    """Return the console for results, on stdout."""
    return Console(highlight=False, markup=False, soft_wrap=True, width=None if sys.stdout.isatty() else PIPE_WIDTH)


def print_lines(lines: Iterable[tuple[str, object]]) -> None:
    """Print each subject and its text in two columns."""
    console = printer()
    for subject, text in lines:
        console.print(f"{subject:<16}{text}")


def print_json(result: object) -> None:
    """Print `result` as JSON, paths as text. Raises ValueError for NaN and infinity, which JSON does not have."""
    printer().print_json(json.dumps(result, allow_nan=False, default=str))


def progress_bar(*columns: ProgressColumn) -> Progress:
    """Return a progress bar on stderr, to be used in a `with`; it is invisible unless stderr is a terminal."""
    return Progress(*columns, console=Console(stderr=True), disable=not sys.stderr.isatty(), transient=True)

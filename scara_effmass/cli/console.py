"""Print the results of commands: lines of subject and text, tables, JSON, and progress."""

import json
import sys
from collections.abc import Iterable, Sequence

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import Progress, ProgressColumn
from rich.table import Table

PIPE_WIDTH = 160
"""Width of the output without a terminal [columns]."""


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


def print_table(title: str, headings: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Print a table; numbers are aligned right and a missing number reads "none"."""
    table = Table(box=SIMPLE_HEAD, title=title or None, title_justify="left")
    cells = [[_cell(value) for value in row] for row in rows]
    numeric = [all(right for _, right in column) for column in zip(*cells, strict=True)]
    for heading, right in zip(headings, numeric, strict=True):
        table.add_column(heading, justify="right" if right else "left", overflow="fold")
    for row in cells:
        table.add_row(*(text for text, _ in row))
    printer().print(table)


def _cell(value: object) -> tuple[str, bool]:
    """Return the text of a cell and whether it is a number."""
    if value is None or isinstance(value, int | float):
        return "none" if value is None else f"{value:.4g}", True
    return str(value), False

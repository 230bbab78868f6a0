# SPDX-License-Identifier: Apache-2.0
"""The table of random impacts: a CSV file that grows with each impact, so that an interrupted run can be resumed."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path

from scara_effmass.errors import OutputError
from scara_effmass.sim.random_impacts import Row, simulate

Simulate = Callable[[int], list[Row]]


def extend_table(
    path: Path,
    seed: int,
    impacts: int,
    run: Callable[[Simulate, Sequence[int]], Iterable[list[Row]]] = map,
) -> Iterator[int]:
    """Append random impacts of the series `seed` to the CSV file `path` until it has `impacts`; yield their number.

    The last impact of an existing table is simulated again and must give the same rows, so that the result is that of a
    run without interruption. `run` simulates impacts by their numbers and yields their rows in that order. Raises
    OutputError if the table has another seed or version, or cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a+", encoding="utf-8", errors="replace", newline="\n") as file:
            file.seek(0)
            text = file.read()
            lines = [line for line in text.splitlines(keepends=True) if line.endswith("\n")]
            number = lines[-1].partition(",")[0] if lines else ""
            last = int(number) if number.isdecimal() else 0
            kept = [line for line in lines if not line.startswith(f"{last},")]
            rows = simulate(seed, last)
            header, again = ",".join(rows[0]) + "\n", _lines(rows)
            is_same = lines[:1] == [header] and again.startswith("".join(lines[len(kept) :]))
            if not (is_same or header.startswith(text)):
                raise OutputError(f"{path}: must be of this seed and version; choose another folder, or use --force")
            file.truncate(sum(map(len, kept)))
            file.write(again if kept else header + again)
            file.flush()
            yield last + 1
            for index, rows in enumerate(run(partial(simulate, seed), range(last + 1, impacts)), start=last + 1):
                file.write(_lines(rows))
                file.flush()
                yield index + 1
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from None


def _lines(rows: Iterable[Row]) -> str:
    return "".join(",".join(map(str, row.values())) + "\n" for row in rows)

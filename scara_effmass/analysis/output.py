"""Files that appear under their name only when they are complete, and replace nothing unasked."""

from __future__ import annotations

import os
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from scara_effmass.errors import OutputError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


def check_output_path(path: Path, *, overwrite: bool) -> None:
    """Raise OutputError when `path` may not be written: it exists and is not to be replaced, or is a folder."""
    if path.is_dir():
        raise OutputError(f"{path}: is a folder; the name of a file would be right")
    if path.exists() and not overwrite:
        raise OutputError(f"{path}: exists already; --force replaces it")


@contextmanager
def atomic_file(path: Path, *, overwrite: bool) -> Iterator[Path]:
    """Give a path to write to in a `with`; what is there at its end is renamed to `path`, or removed after an error.

    Folders above are made. Raises OutputError.
    """
    check_output_path(path, overwrite=overwrite)
    unfinished = path.with_name(f".{path.stem}-{os.getpid()}{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        unfinished.touch()
        yield unfinished
        check_output_path(path, overwrite=overwrite)
        unfinished.replace(path)
    except OutputError:
        raise
    except OSError as error:
        raise _refused(path, error) from None
    finally:
        with suppress(OSError):
            unfinished.unlink()


def _refused(path: Path, error: OSError) -> OutputError:
    return OutputError(f"{path}: cannot be written: {error.strerror or error}")

"""Output files that appear only when complete and never replace a file without permission."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from scara_effmass.errors import OutputError


def check_output_path(path: Path, *, overwrite: bool) -> None:
    """Raise OutputError if `path` is a folder, or exists and must not be replaced."""
    if path.is_dir():
        raise OutputError(f"{path}: is a folder; must be a file")
    if path.exists() and not overwrite:
        raise OutputError(f"{path}: already exists; use --force to replace it")


@contextmanager
def atomic_file(path: Path, *, overwrite: bool) -> Iterator[Path]:
    """Give a temporary path to write to in a `with`; it becomes `path` at the end, or is removed after an error.

    Missing parent folders are created. Raises OutputError.
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
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from None
    finally:
        with suppress(OSError):
            unfinished.unlink()

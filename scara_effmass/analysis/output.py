# SPDX-License-Identifier: Apache-2.0
"""Output files that appear only when complete and never replace a file without permission; results as JSON types."""

import math
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import fields, is_dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from scara_effmass.errors import OutputError, writing
from scara_effmass.input_files import check_not_input
from scara_effmass.url import Url

MARKS = {".pdf": b"%PDF", ".png": b"\x89PNG", ".svg": b"<svg"}
"""What a file of this suffix holds near its beginning."""
HEAD_BYTES = 65536


def check_output_path(path: Path, *, overwrite: bool, mark: bytes = b"") -> None:
    """Raise OutputError if `path` is a folder, a device or a pipe, or exists and must not be replaced.

    An input of the command is never replaced, nor a file with content but without `mark` (default: by suffix) near its
    beginning, which is of another kind.
    """
    if path.exists() and not path.is_file():
        raise OutputError(f"{path}: is a folder, a device or a pipe; must be a file")
    if path.exists() and not overwrite:
        raise OutputError(f"{path}: already exists; use --force to replace it")
    if path.exists():
        check_not_input(path, OutputError)
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
        if head and (mark or MARKS.get(path.suffix, b"")) not in head:
            raise OutputError(f"{path}: is not a file of this kind and is not replaced")


def check_output_files(folder: Path, names: Iterable[str], *, overwrite: bool) -> None:
    """Raise OutputError if `folder` is a file, or one of the files `names` in it must not be replaced."""
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"{folder}: is no folder; must be one, or a new path")
    for name in names:
        check_output_path(folder / name, overwrite=overwrite)


@contextmanager
def atomic_file(path: Path, *, overwrite: bool, mark: bytes = b"") -> Iterator[Path]:
    """Yield a temporary path to write to, which becomes `path` at the end, or is removed after an error.

    Missing parent folders are created. An existing file must have `mark`. Raises OutputError.
    """
    check_output_path(path, overwrite=overwrite, mark=mark)
    if isinstance(path, Url):
        with TemporaryDirectory() as folder:
            unfinished = Path(folder) / path.name
            unfinished.touch()
            yield unfinished
            with writing(path):
                path.upload(unfinished)
        return
    unfinished = path.with_name(f".{path.stem}-{os.getpid()}{path.suffix}")
    is_new = not path.parent.exists()
    try:
        with writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            unfinished.touch()
            yield unfinished
            check_output_path(path, overwrite=overwrite, mark=mark)
            unfinished.replace(path)
    finally:
        with suppress(OSError):
            unfinished.unlink(missing_ok=True)
            if is_new:
                path.parent.rmdir()  # unless it holds the file


def json_types(value: Any, without: str = "") -> Any:  # noqa: ANN401 - any part of a result
    """Return `value` as JSON types; named tuples and dataclasses become objects, without the field `without`.

    Numbers that are not finite become null.
    """
    if is_dataclass(value):
        value = {field.name: getattr(value, field.name) for field in fields(value)}
    elif hasattr(value, "_asdict"):
        value = value._asdict()
    elif isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, dict):
        named = ((f"{key:g}" if isinstance(key, float) else str(key), item) for key, item in value.items())
        return {key: json_types(item) for key, item in named if key != without}
    if isinstance(value, tuple | list):
        return [json_types(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, bool | int | str) else str(value)

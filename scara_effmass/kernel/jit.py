# SPDX-License-Identifier: Apache-2.0
"""numba compiles the functions of this room; with NUMBA_DISABLE_JIT=1 they stay plain Python, which takes far longer.

What numba compiled is kept in a folder of its own, named by a hash of all sources of the kernel: numba looks only at
the file of the function that is called, but the functions that it calls are compiled into it.
"""

import hashlib
import os
import platform
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

Function = TypeVar("Function", bound=Callable[..., Any])
WHY_NOT = ""
"""Why numba cannot compile, empty if it can."""
numba: Any = None
if os.environ.get("NUMBA_DISABLE_JIT", "0") == "0":
    try:
        numba = import_module("numba")
    except Exception as error:  # noqa: BLE001 - a damaged installation may raise anything
        WHY_NOT = f"numba cannot be imported: {error}"
# IEEE arithmetic, because fast-math breaks checks of NaN. No function makes an array, so none has to count references.
OPTIONS = {"nogil": True, "error_model": "numpy", "_nrt": False}


def _source_hash() -> str:
    package = Path(__file__).parents[1]
    # Constants of these rooms are compiled in.
    rooms = ("kernel", "iso15066", "reference")
    sources = [*(path for room in rooms for path in sorted((package / room).glob("*.py")))]
    sources += [package / "codes.py", package / "values.py"]
    content = [source.read_bytes() for source in sources]
    versions = f"{platform.python_version()} {np.__version__} {getattr(numba, '__version__', '')}".encode()
    return hashlib.sha256(b"\0".join([*content, versions])).hexdigest()[:16]


def cache_folder() -> Path | None:
    """Return the folder of what was compiled from these sources; None if no folder can be written.

    It lies in NUMBA_CACHE_DIR, else in the user's cache folder, else beside the sources.
    """
    stated = os.environ.get("NUMBA_CACHE_DIR")
    user = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"), "scara_effmass")  # noqa: PTH111 - no home is no error
    for base in [Path(stated)] if stated else [user, Path(__file__).parent / "__pycache__"]:
        folder = base / f"kernel-{_source_hash()}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            return folder
    return None


CACHE = cache_folder() if numba else None


def compiled(function: Function) -> Function:
    """Return `function` compiled at its first call, or loaded from the cache."""
    if numba is None:
        return function
    if CACHE is None:
        wrapped: Function = numba.njit(**OPTIONS)(function)
        return wrapped
    before, numba.config.CACHE_DIR = numba.config.CACHE_DIR, str(CACHE)
    try:
        cached: Function = numba.njit(cache=True, **OPTIONS)(function)
    finally:
        numba.config.CACHE_DIR = before
    _save_if_possible(cached)
    return cached


def _save_if_possible(function: Any) -> None:  # noqa: ANN401 - a dispatcher of numba
    """Let a full disk cost the time to compile again, and not the call that compiled."""
    save = function._cache.save_overload  # noqa: SLF001 - numba has no other handle

    def save_overload(*arguments: object) -> None:
        with suppress(OSError):
            save(*arguments)

    function._cache.save_overload = save_overload  # noqa: SLF001


def inlined(function: Function) -> Function:
    """Return `function` compiled into the functions that call it."""
    if numba is None:
        return function
    wrapped: Function = numba.njit(no_cpython_wrapper=True, no_cfunc_wrapper=True, **OPTIONS)(function)
    return wrapped

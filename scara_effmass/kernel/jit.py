# SPDX-License-Identifier: Apache-2.0
"""numba compiles the functions of this room; with NUMBA_DISABLE_JIT=1 they stay plain Python, which takes far longer.

What numba compiled is kept in a folder of its own, named by a hash of all sources of the kernel: numba looks only at
path and time of the file of the function that is called, but the functions that it calls are compiled into it.
"""

import hashlib
import os
import platform
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar, cast

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
# IEEE arithmetic, because fast-math breaks checks of NaN; only a product that is added need not be rounded before. No
# function makes an array, so none has to count references.
OPTIONS = {"nogil": True, "error_model": "numpy", "_nrt": False, "fastmath": {"contract"}}


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
    wrapped: Any = numba.njit(**OPTIONS)(function)
    if CACHE is not None:
        wrapped._cache = _kernel_cache(function, CACHE)  # noqa: SLF001 - numba has no other handle
    return cast(Function, wrapped)


def _kernel_cache(function: Function, folder: Path) -> Any:  # noqa: ANN401 - a cache of numba, which has no types
    """Return a cache in `folder` that all installations of these sources share, and that need not save."""
    caching = import_module("numba.core.caching")

    class Locator(caching._CacheLocator):  # type: ignore[misc,name-defined]  # noqa: SLF001
        def get_cache_path(self) -> str:
            return str(folder)

        def get_source_stamp(self) -> str:
            return folder.name

        def get_disambiguator(self) -> str:
            return str(function.__code__.co_firstlineno)

        @classmethod
        def from_function(cls, *_: object) -> Any:  # noqa: ANN401
            return cls()

    class Contents(caching.CompileResultCacheImpl):  # type: ignore[misc,name-defined]
        _locator_classes = (Locator,)

    class Cache(caching.FunctionCache):  # type: ignore[misc,name-defined]
        _impl_class = Contents

        def load_overload(self, signature: object, context: object) -> Any:  # noqa: ANN401
            # numba's own prepares to compile first: 50 MB and 0.3 s that nothing compiled needs.
            with self._guard_against_spurious_io_errors():
                return self._load_overload(signature, context)

        def save_overload(self, *arguments: object) -> None:
            with suppress(OSError):  # a full disk costs the time to compile again, and not the call that compiled
                super().save_overload(*arguments)

    return Cache(function)


def inlined(function: Function) -> Function:
    """Return `function` compiled into the functions that call it."""
    if numba is None:
        return function
    wrapped: Function = numba.njit(no_cpython_wrapper=True, no_cfunc_wrapper=True, **OPTIONS)(function)
    return wrapped

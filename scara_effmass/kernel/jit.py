# SPDX-License-Identifier: Apache-2.0
"""numba; where it is missing or switched off, the functions stay plain Python."""

import os
from collections.abc import Callable
from importlib import import_module
from typing import Any, TypeVar

Function = TypeVar("Function", bound=Callable[..., Any])
WHY_NOT = ""
"""Why the functions are not compiled, empty if they are."""
numba: Any = None
try:
    if os.environ.get("NUMBA_DISABLE_JIT", "0") == "0":  # else its import would take a second for nothing
        numba = import_module("numba")
    if numba is None or numba.config.DISABLE_JIT:
        WHY_NOT = "NUMBA_DISABLE_JIT is set"
except ImportError:
    WHY_NOT = "numba is not installed: pip install 'numba>=0.61'"


def compiled(function: Function) -> Function:
    """Return `function` compiled at its first call, with the arithmetic of IEEE: fast-math breaks checks of NaN.

    It must not make arrays, only write into its arguments: then numba need not count references, which costs time.
    """
    global WHY_NOT  # noqa: PLW0603 - known only when numba looks for its cache
    if numba is None:
        return function
    options = {"nogil": True, "error_model": "numpy", "_nrt": False}
    try:
        wrapped: Function = numba.njit(cache=True, **options)(function)
    except RuntimeError:
        WHY_NOT = "numba cannot write its cache: set NUMBA_CACHE_DIR to a folder that this user may write"
        return function
    return wrapped

# SPDX-License-Identifier: Apache-2.0
"""numba."""

import os
from collections.abc import Callable
from importlib import import_module
from typing import Any, TypeVar

Function = TypeVar("Function", bound=Callable[..., Any])
WHY_NOT = ""
numba: Any = None
try:
    if os.environ.get("NUMBA_DISABLE_JIT", "0") == "0":  # else its import would take a second for nothing
        numba = import_module("numba")
    if numba is None or numba.config.DISABLE_JIT:
        WHY_NOT = "NUMBA_DISABLE_JIT is set"
except ImportError:
    WHY_NOT = "numba is not installed: pip install scara_effmass[fast]"
OPTIONS = {"nogil": True, "error_model": "numpy", "_nrt": False}


def compiled(function: Function) -> Function:
    if numba is None:
        return function
    return numba.njit(cache=True, **OPTIONS)(function)


def inlined(function: Function) -> Function:
    if numba is None:
        return function
    return numba.njit(no_cpython_wrapper=True, no_cfunc_wrapper=True, **OPTIONS)(function)

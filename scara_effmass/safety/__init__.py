# SPDX-License-Identifier: Apache-2.0
"""Verdicts: one per contact point and joint state. Pure: time is an argument, in nanoseconds."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from scara_effmass.safety.assessments import Assessments, unknown_assessments, unknown_contact
    from scara_effmass.safety.monitor import Cause, Monitor

__all__ = ["Assessments", "Cause", "Monitor", "unknown_assessments", "unknown_contact"]


def __getattr__(name: str) -> Any:  # noqa: ANN401
    """Import a public name on first use: the monitor loads Pinocchio, which most nodes do without."""
    if name in __all__:
        module = "monitor" if name in {"Cause", "Monitor"} else "assessments"
        return getattr(import_module(f"{__name__}.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

"""What a recording, a replay or the bench says of a run on `recording_info`: what is hit, in which configuration."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any, NamedTuple

from scara_effmass.errors import SettingsError
from scara_effmass.settings.validator import HEAVIEST

if TYPE_CHECKING:
    from collections.abc import Mapping

LATEST_NS = 2**63 - 1


class RunInfo(NamedTuple):
    """What is said of the run from `since_ns` on; None: nothing of that.

    `obstacle_mass` is m_H [kg], 0 where it is not given; `about` is all that is said.
    """

    since_ns: int
    obstacle_mass: float | None
    configuration: str | None
    about: Mapping[str, Any]


def json_object(text: str) -> dict[str, Any] | None:
    """Return the JSON object in `text`; None: it is none, and says nothing."""
    try:
        about = json.loads(text)
    except (ValueError, RecursionError):
        return None
    return about if isinstance(about, dict) else None


def run_info(text: str, said_ns: int) -> RunInfo | None:
    """Return what the JSON object `text` says, from `said_ns` on unless it says since when.

    None: it is no JSON object, and says nothing. Raises SettingsError for a value that cannot be one.
    """
    about = json_object(text)
    if about is None:
        return None
    mass, name, since_ns = (about.get(key) for key in ("obstacle_mass", "configuration", "since_ns"))
    since_ns = said_ns if since_ns is None else since_ns
    if isinstance(since_ns, bool) or not isinstance(since_ns, int) or abs(since_ns) > LATEST_NS:
        raise SettingsError(f"since_ns = {since_ns!r}: nanoseconds of ROS time, a whole number, would be right")
    if name is not None and not str(name).isprintable():
        raise SettingsError(f"configuration = {name!r}: a name that can be printed would be right")
    return RunInfo(since_ns, None if mass is None else obstacle_mass(mass), None if name is None else str(name), about)


def obstacle_mass(value: object) -> float:
    """Return `value` as a mass [kg], 0 for one that is not given. Raises SettingsError."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= HEAVIEST:
        wanted = f"0 (not given) to {HEAVIEST:g} kg would be right"
        raise SettingsError(f"obstacle_mass = {value!r}: {wanted}")
    return float(value)

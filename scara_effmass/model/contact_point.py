# SPDX-License-Identifier: Apache-2.0
"""Entries of the setting `contact_points`."""

import math
from typing import NamedTuple

from scara_effmass.errors import RobotError
from scara_effmass.values import Vector3


class ContactPoint(NamedTuple):
    """A point to watch: `at` [m] in the frame of `link`; an empty `link` leaves both to the robot file."""

    name: str
    link: str
    at: Vector3


def contact_point(entry: str) -> ContactPoint:
    """Return the contact point of `entry`: "name", "name=link", or "name=link: x y z" [m]. Raises RobotError."""
    name, equals, place = entry.partition("=")
    link, text = place.rsplit(":", 1) if ":" in place else (place, "0 0 0")
    try:
        at = tuple(float(word) for word in text.split())
    except ValueError:
        at = ()
    if not name or bool(equals) > bool(link.strip()) or len(at) != 3 or not all(map(math.isfinite, at)):
        raise RobotError(f"contact_points = {entry!r}: must be NAME or NAME=LINK: X Y Z, in metres")
    return ContactPoint(name.strip(), link.strip(), at)

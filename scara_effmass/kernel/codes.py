# SPDX-License-Identifier: Apache-2.0
"""Codes in the records of the kernel."""

from enum import IntEnum

from scara_effmass.settings import MassModel

MODELS = tuple(MassModel)
"""Settings in the order of `Model`."""
NORMALS = ("worst", "velocity")
"""Settings in the order of `Normal`."""


class Model(IntEnum):
    """Mass model that decides; the first three are models themselves."""

    LUMPED = 0
    FULL = 1
    ISO = 2
    LARGEST = 3
    AUTO = 4


class Normal(IntEnum):
    """Contact normal."""

    WORST = 0
    VELOCITY = 1
    FIXED = 2

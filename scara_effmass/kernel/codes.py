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


class Why(IntEnum):
    """Why a model decides. FULL plus a `NoLumped`: there is no lumped mass; as many further on: nor a full mass."""

    SETTING = 1
    HEAVY = 2
    LIGHTER = 3
    LARGEST = 4
    FULL = 5


class NoLumped(IntEnum):
    """Why there is no lumped mass; MASSLESS_JOINT plus the joint that moves the contact point, but no lumped mass."""

    NOT_THERE = 0
    NOT_DEFINITE = 1
    MASSLESS = 2
    MASSLESS_JOINT = 3


class Error(IntEnum):
    """Why the verdict is UNKNOWN; TOO_LIGHT and NO_WORST plus a `Model`, NO_LUMPED plus a `NoLumped`."""

    NONE = 0
    NO_MASSES = 1
    NO_FULL = 2
    NO_FORCE = 3
    TOO_LIGHT = 4
    NO_WORST = 7
    NO_LUMPED = 10

# SPDX-License-Identifier: Apache-2.0
"""Codes of an assessment: which model decides and why, which limit governs, and the reason of a verdict.

`safety.reasons` makes their texts. Codes that depend on a joint or a model are the member plus an index.
"""

from enum import IntEnum, IntFlag


class ModelCode(IntEnum):
    """Model of the effective mass."""

    NONE = 0
    LUMPED = 1
    FULL = 2
    ISO = 3


class CriterionCode(IntEnum):
    """Limit that governs a speed."""

    NONE = 0
    FORCE = 1
    PRESSURE = 2


class NoLumpedMass(IntEnum):
    """Why a contact point has no lumped mass along a direction, or along all of them (MASSLESS)."""

    NOT_THERE = 0
    NOT_DEFINITE = 1
    MASSLESS = 2
    MASSLESS_JOINT = 3
    """Plus the index of the joint that moves the contact point, but no lumped mass."""


class ModelReason(IntEnum):
    """Why a model decides."""

    NONE = 0
    SETTING = 1
    HEAVY_ENOUGH = 2
    LIGHTER = 3
    LARGEST = 4
    NO_LUMPED = 5
    """Plus `NoLumpedMass`: the full model decides alone. See `only_iso` for the case without a full model."""

    @classmethod
    def only_iso(cls, no_lumped: int, joints: int) -> int:
        """Return the code of ISO's mass that decides alone, of a robot with this number of `joints`."""
        return cls.NO_LUMPED + NoLumpedMass.MASSLESS_JOINT + joints + no_lumped


class UnknownReason(IntEnum):
    """Why a contact point has no verdict."""

    NONE = 0
    NO_MASSES = 1
    NO_FULL = 2
    NO_CLAMPING_FORCE = 3
    TOO_LIGHT = 4
    """Plus the model, 0 for lumped."""
    NO_WORST = 7
    """Plus the model, 0 for lumped."""
    NO_LUMPED = 10
    """Plus `NoLumpedMass`."""


class Remark(IntFlag):
    """Why a verdict is WARN or VIOLATION."""

    NONE = 0
    FAST = 1
    CLOSE = 2
    LIGHT = 4
    CLAMPED = 8

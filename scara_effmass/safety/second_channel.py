# SPDX-License-Identifier: Apache-2.0
"""The reference in place of the kernel, and beside it: what it computes, and where the two differ."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from scara_effmass.iso15066 import limits_of
from scara_effmass.kernel.records import CONTACT, FIELDS, REASON_SIZE, ByteArray
from scara_effmass.kernel.state import CODE, JOINT, STATE, VALUES
from scara_effmass.reference import ContactResult, JointAcceleration, RobotDynamics, assess
from scara_effmass.settings import ContactType, Drives, MonitorSettings
from scara_effmass.values import FloatArray

AGREEMENT = 1e-10
"""Tolerance of the agreement, relative for numbers above 1."""
CANCELLED = 1e-5
"""That with a servo or a clamped body part, whose bounds invert nearly singular matrices."""
SINGULAR = 1e-6
"""That where the smallest singular value of J_v is below it: there the leading digits cancel."""


class ReferenceChannel:
    """Assesses joint states one by one with the reference, in place of `ContactKernel`."""

    def __init__(self, dynamics: RobotDynamics, settings: MonitorSettings) -> None:
        """Assess contacts of `dynamics`. Raises LimitError."""
        self._dynamics, self._settings = dynamics, settings
        self._limits = limits_of(settings, dynamics.contact_points)
        cancels = settings.drives is Drives.SERVO or settings.contact is ContactType.QUASI_STATIC
        self._tolerance = CANCELLED if cancels else AGREEMENT

    def bind(self, states: ByteArray, motions: FloatArray, numbers: FloatArray) -> Callable[[], None]:
        """Return what writes the contacts, as `ContactKernel.bind`."""
        return partial(self.compute, states, motions, numbers)

    def compute(self, states: ByteArray, motions: FloatArray, numbers: FloatArray, chosen: slice = slice(None)) -> None:
        """Write the `chosen` contacts at the admitted ones of N joint states, as the kernel does all."""
        contacts = numbers.view(CONTACT)[..., 0][:, chosen]
        records = states.view(STATE)
        for row in np.flatnonzero(records["is_admitted"]).tolist():
            q, qd, tolerance, qdd, errors, replaced = motions[row]
            acceleration = JointAcceleration(qdd, errors, qdd + replaced, float(records["age"][row]))
            results = assess(
                self._dynamics, self._settings, self._limits, q, qd, tolerance.tolist(), acceleration, chosen
            )
            for contact, result in zip(contacts[row], results, strict=True):
                fill(contact, result)

    def difference(self, motion: FloatArray, numbers: FloatArray, age: float, chosen: slice = slice(None)) -> str:
        """Return the first field in which the `chosen` numbers (P, fields) at `motion` (6, n) differ, else empty."""
        expected = np.zeros((1, *numbers.shape))
        state = np.zeros(1, STATE)
        state["is_admitted"], state["age"] = 1, age
        self.compute(state.view(np.uint8), motion[None], expected, chosen)
        for own, other in zip(numbers[chosen], expected[0, chosen], strict=True):
            contact, reference = own.view(CONTACT)[0], other.view(CONTACT)[0]
            if is_unbounded(reference) and contact["force_bound"] >= 0.0:
                reference["force_bound"] = contact["force_bound"]
            tolerance = self._tolerance if reference["smallest_singular_value"] > SINGULAR else SINGULAR
            agrees = partial(np.allclose, rtol=tolerance, atol=tolerance, equal_nan=True)
            if not agrees(own, other):
                return next(name for name in FIELDS if not agrees(contact[name], reference[name]))
        return ""


def is_unbounded(contacts: Any) -> Any:  # noqa: ANN401 - records of CONTACT
    """Return whether rounding decides the force bound: that of an infinite mass which is allowed no speed."""
    return (contacts["smallest_singular_value"] < SINGULAR) & (contacts["allowable_speed"] == 0.0)


def fill(contact: Any, result: ContactResult) -> None:  # noqa: ANN401 - a record of CONTACT
    """Write a result of the reference into a record of CONTACT."""
    for name in FIELDS:
        if name != "reason":
            contact[name] = getattr(result, name)
    reason = np.zeros(REASON_SIZE)
    reason[CODE], reason[JOINT] = result.reason, result.reason_joint
    reason[VALUES : VALUES + len(result.reason_values)] = result.reason_values
    contact["reason"] = reason

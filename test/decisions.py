# SPDX-License-Identifier: Apache-2.0
"""Decisions made of contacts, for tests of what reads them."""

from typing import Any

from scara_effmass.safety import allowed
from scara_effmass.values import ContactAssessment, Decision


def decision_on(*contacts: ContactAssessment, stamp_ns: int = 1, **fields: Any) -> Decision:  # noqa: ANN401
    """Return the decision on `contacts`, with other values where `fields` state them."""
    decision = Decision(stamp_ns, 0.0, 0.0, "worst", False, contacts, *allowed(contacts, 0.0))  # noqa: FBT003
    return decision._replace(**fields)

# SPDX-License-Identifier: Apache-2.0
"""Verdicts: one per contact point and joint state. Pure: time is an argument, in nanoseconds."""

from scara_effmass.safety.assessments import Assessments, unknown_contact
from scara_effmass.safety.monitor import Cause, Monitor, unknown_assessments

__all__ = ["Assessments", "Cause", "Monitor", "unknown_assessments", "unknown_contact"]

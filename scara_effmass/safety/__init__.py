# SPDX-License-Identifier: Apache-2.0
"""Verdicts: one per contact point and joint state. Pure: time is an argument, in nanoseconds."""

from scara_effmass.safety.monitor import Admitted, Cause, Monitor, allowed, unknown_contact, unknown_decision

__all__ = ["Admitted", "Cause", "Monitor", "allowed", "unknown_contact", "unknown_decision"]

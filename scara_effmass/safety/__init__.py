"""Verdicts: one per contact point and joint state. Pure: time is an argument, in nanoseconds."""

from scara_effmass.safety.monitor import Monitor, no_robot_decision, unknown_contact

__all__ = ["Monitor", "no_robot_decision", "unknown_contact"]

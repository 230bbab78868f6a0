"""What is decided: a verdict per contact point and joint state. Pure: time is an argument, in nanoseconds."""

from scara_effmass.safety.monitor import SILENCE, Monitor, without_robot

__all__ = ["SILENCE", "Monitor", "without_robot"]

"""Checks of the RunInfo values that predictions depend on."""

from scara_effmass.errors import SettingsError
from scara_effmass.settings.validator import MAX_OBSTACLE_MASS
from scara_effmass.values import RunInfo

MAX_STAMP_NS = 2**63 - 1


def check_run_info(info: RunInfo) -> None:
    """Raise SettingsError for an invalid stamp, configuration or obstacle mass."""
    if abs(info.stamp_ns) > MAX_STAMP_NS:
        raise SettingsError(f"stamp = {info.stamp_ns} ns: must be ROS time")
    if not info.configuration.isprintable():
        raise SettingsError(f"configuration = {info.configuration!r}: must be printable")
    check_obstacle_mass(info.obstacle_mass)


def check_obstacle_mass(mass: float) -> None:
    """Raise SettingsError for an obstacle mass [kg] out of range; 0: not stated."""
    if not 0.0 <= mass <= MAX_OBSTACLE_MASS:
        raise SettingsError(f"obstacle_mass = {mass!r}: must be 0 (not stated) to {MAX_OBSTACLE_MASS:g} kg")

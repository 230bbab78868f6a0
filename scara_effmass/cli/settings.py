# SPDX-License-Identifier: Apache-2.0
"""Settings and robot from the options of a command."""

from __future__ import annotations

import argparse
from collections.abc import Collection
from typing import TYPE_CHECKING, Any

from scara_effmass.cli.options import options_of
from scara_effmass.errors import SettingsError
from scara_effmass.settings import MonitorSettings, checked, load_settings
from scara_effmass.settings.loading import Settings

if TYPE_CHECKING:
    from scara_effmass.reference import RobotDynamics


def monitor_settings(
    args: argparse.Namespace,
    others: Collection[str] = (),
    **overrides: Any,  # noqa: ANN401 - any setting
) -> MonitorSettings:
    """Return the monitor's settings: those of --params, overridden by the other options and by `overrides`.

    A parameter file with sections of the nodes `others` only leaves the defaults. Raises SettingsError.
    """
    settings = load_settings(MonitorSettings, args.params, "monitor", others) if args.params else MonitorSettings()
    return override(settings, {name: getattr(args, name, None) for name in MonitorSettings.model_fields} | overrides)


def selected(args: argparse.Namespace, *groups: str) -> dict[str, Any]:
    """Return the values of the options in `groups` by the name of the setting."""
    return {option.dest: getattr(args, option.dest) for option in options_of(*groups)}


def override(settings: Settings, chosen: dict[str, Any]) -> Settings:
    """Return `settings` changed to the `chosen` values that are not None. Raises SettingsError."""
    changes = {name: value for name, value in chosen.items() if value is not None}
    return checked(type(settings), {**settings.model_dump(), **changes}, "options")


def load_dynamics(settings: MonitorSettings) -> RobotDynamics:
    """Return the robot of `settings` with its mass models. Raises RobotError."""
    from scara_effmass.model.load import load_robot  # noqa: PLC0415
    from scara_effmass.reference import RobotDynamics  # noqa: PLC0415 - loads Pinocchio

    return RobotDynamics(load_robot(settings.robot_path, settings))


def require_no_payload_topic(settings: MonitorSettings, purpose: str) -> None:
    """Raise SettingsError if the payload comes by topic, because `purpose` needs it beforehand."""
    if settings.payload_topic:
        rule = f"must be empty for {purpose}: give --payload-topic ''"
        raise SettingsError(f"payload_topic = {settings.payload_topic!r}: {rule}")

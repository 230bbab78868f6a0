"""`scara-effmass doctor`."""

from __future__ import annotations

import math
import os
import platform
from contextlib import suppress
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any, NamedTuple

from rich import box
from rich.table import Table

from scara_effmass import __version__
from scara_effmass.cli.console import print_json, printer
from scara_effmass.cli.options import add_json, add_params, add_robot, load_dynamics, settings_from
from scara_effmass.errors import DaqError, LimitError, RobotError, SettingsError
from scara_effmass.iso15066 import EDITION, TABLE_HASH, limits_for
from scara_effmass.settings import DaqSettings, ForceSourceKind, MassModel, load_settings

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from scara_effmass.daq.ni_driver import Device
    from scara_effmass.model.dynamics import RobotDynamics
    from scara_effmass.settings import MonitorSettings

EXAMPLES = """\
Exit code 0: a monitor can run with this robot; 1: something that it needs is wrong.

examples:
  scara-effmass doctor
  scara-effmass doctor --robot my_robot.urdf --model full
  scara-effmass doctor --json
"""


class Finding(NamedTuple):
    """One line of the examination: `level` is "ok", "note" (worth knowing) or "wrong" (a monitor cannot run so)."""

    level: str
    subject: str
    text: str


def add_to(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = EXAMPLES
    add_robot(parser)
    add_params(parser, "monitor_node and daq_node")
    add_json(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Examine the installation, the environment and the robot."""
    settings = settings_from(args, others=("daq",))
    path = settings.robot_path
    if not path.is_file():
        raise RobotError(f"{path}: there is no such file; a URDF or DH YAML file would be right")
    findings = [*_installation(), *_environment(), *_converter(args.params), *_limits(settings)]
    joints: list[dict[str, Any]] = []
    try:
        arm = load_dynamics(settings)
    except RobotError as error:
        findings.append(Finding("wrong", "robot", str(error)))
    else:
        findings += _robot(arm, settings)
        joints = _joints(arm)
    healthy = all(finding.level != "wrong" for finding in findings)
    console = printer()
    if args.json:
        result = {"healthy": healthy, "findings": [finding._asdict() for finding in findings], "joints": joints}
        print_json(result)
    else:
        _show(findings, joints)
        console.print(
            "healthy: a monitor can run with this robot" if healthy else "not healthy: see what is wrong above"
        )
    return 0 if healthy else 1


def _installation() -> Iterator[Finding]:
    yield Finding("ok", "scara_effmass", f"{__version__}, Python {platform.python_version()}, {platform.platform()}")
    checks: dict[str, Callable[[], str]] = {
        "rclpy": lambda: _version("rclpy", "ros-jazzy-rclpy"),
        "middleware": lambda: str(import_module("rclpy").get_rmw_implementation_identifier()),
        "scara_effmass_msgs": _type_support,
        "pinocchio": lambda: str(import_module("pinocchio").__version__),
    }
    for subject, check in checks.items():
        yield _examined(subject, check)


def _examined(subject: str, check: Callable[[], str]) -> Finding:
    try:
        return Finding("ok", subject, check())
    except Exception as error:  # noqa: BLE001 - whatever a broken installation raises is the finding
        reason = " ".join(str(error).split()) or type(error).__name__
        return Finding("wrong", subject, f"cannot be used: {reason}; install scara_effmass again, or source ROS 2")


def _version(module: str, wheel: str) -> str:
    """Return the version of `module`, which apt installs under its own name and pip under that of `wheel`."""
    location = import_module(module).__file__
    for name in (module, wheel):
        with suppress(PackageNotFoundError):
            return f"{version(name)} ({location})"
    return f"version unknown ({location})"


def _type_support() -> str:
    message = import_module("scara_effmass_msgs.msg").ContactState
    kind = type(message)
    kind.__import_type_support__()
    if kind._TYPE_SUPPORT is None:  # noqa: SLF001 - the generated code offers no other way to ask
        raise ImportError("the type support of ContactState does not load")
    return f"type support of ContactState loads ({import_module('scara_effmass_msgs').__file__})"


def _environment() -> Iterator[Finding]:
    domain = os.environ.get("ROS_DOMAIN_ID") or "0 (the default)"
    reach = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE") or "SUBNET (the default)"
    wide = reach.startswith("SUBNET")
    yield Finding("ok", "ROS_DOMAIN_ID", domain)
    yield Finding(
        "note" if wide else "ok",
        "ROS_AUTOMATIC_DISCOVERY_RANGE",
        f"{reach}{'; nodes of the whole network are found: LOCALHOST keeps to this machine' if wide else ''}",
    )


def _converter(params: Path | None) -> Iterator[Finding]:
    """What `daq_node` would find of its converter; a monitor needs none, so nothing here is wrong."""
    settings = DaqSettings()
    if params is not None:
        try:
            settings = load_settings(DaqSettings, params, "daq")
        except SettingsError as error:
            yield Finding("note", "daq_node", f"{error}; what follows is about its defaults")
    try:
        driver = import_module("scara_effmass.daq.ni_driver")
        yield Finding("ok", "NI-DAQmx", driver.driver_version())
        devices: tuple[Device, ...] = driver.devices()
    except DaqError as error:
        yield Finding("note", "NI-DAQmx", str(error))
        return
    for device in devices:
        simulated = ", simulated by its driver" * device.simulated
        channels = f"; for an IEPE force sensor: {', '.join(device.channels)}" if device.channels else ""
        text = device.trouble or f"{device.product}{simulated}{channels}"
        yield Finding("note" if device.trouble or device.simulated else "ok", device.name, text)
    if settings.source is ForceSourceKind.NI9230:
        there = [channel for device in devices for channel in device.channels]
        missing = [name for name in settings.ni9230.channels if name.lower() not in {each.lower() for each in there}]
        yield (
            Finding("note", "ni9230.channels", f"{', '.join(missing)} not found; here: {', '.join(there) or 'none'}")
            if missing
            else Finding("ok", "ni9230.channels", f"{', '.join(settings.ni9230.channels)}: there")
        )


def _limits(settings: MonitorSettings) -> Iterator[Finding]:
    try:
        regions = ", ".join(limit.region for limit in limits_for(settings))
    except LimitError as error:
        yield Finding("wrong", "limits", str(error))
    else:
        yield Finding("ok", "limits", f"{EDITION}; hash {TABLE_HASH}; {settings.contact.value}: {regions}")


def _robot(arm: RobotDynamics, settings: MonitorSettings) -> Iterator[Finding]:
    robot = arm.robot
    yield Finding("ok", "robot", f"{robot.name} ({robot.origin}), base frame {robot.base_frame}")
    yield Finding("ok", "contact points", ", ".join(arm.contact_points))
    for subject, reason, otherwise in (
        ("masses", robot.masses_reason, "given"),
        ("centres of mass", robot.coms_reason, "given"),
        ("inertia tensors", robot.inertias_reason, "given, each that of a possible body"),
        ("lumped model", arm.lumped_reason, _lumped(arm)),
        ("full model", arm.full_reason, "the mass matrix is positive definite over the joint ranges"),
    ):
        yield Finding("note" if reason else "ok", subject, reason or otherwise)
    yield from _verdict_mass(arm, settings)
    if not robot.masses_reason:
        yield Finding("ok", "moving mass", f"{robot.moving_mass:.4g} kg without the payload")
        yield Finding("ok", "ISO mass", f"M/2 + m_L = {robot.iso_mass:.4g} kg")
    carried = f"{robot.payload_mass:.4g} kg"
    if robot.payload_mass:
        yield Finding("ok", "payload", carried)
    else:
        yield Finding("note", "payload", f"{carried}: is the tool, with what it carries, part of the last link?")
    for joint, armature in zip(robot.joint_names, robot.model.armature.tolist(), strict=True):
        if armature:
            yield Finding("ok", f"armature of {joint}", f"{armature:.4g} kg m² or kg")
    if not robot.model.armature.any():
        yield Finding("note", "armature", "none: rotors and gears, felt when joints are driven back, are not counted")
    for note in robot.notes:
        yield Finding("note", "robot file", note)


def _lumped(arm: RobotDynamics) -> str:
    return (
        ""
        if arm.lumped is None
        else f"masses {', '.join(f'{mass:.4g}' for mass in arm.lumped.aggregated)} kg, from base to tip"
    )


def _verdict_mass(arm: RobotDynamics, settings: MonitorSettings) -> Iterator[Finding]:
    """Whether the mass that the verdict needs exists for this robot."""
    chosen = settings.effective_mass_model
    needed = {
        MassModel.LUMPED: arm.lumped_reason,
        MassModel.FULL: arm.full_reason,
        MassModel.LARGEST: arm.lumped_reason or arm.full_reason,
        MassModel.ISO: "",
    }
    possible = [MassModel.LUMPED] * (not arm.lumped_reason) + [MassModel.FULL] * (not arm.full_reason) + [MassModel.ISO]
    if reason := arm.robot.masses_reason:
        text = f"{chosen.value}: every verdict will be UNKNOWN ({reason}); give the robot file its masses"
    elif reason := needed[chosen]:
        others = " or ".join(model.value for model in possible)
        text = (
            f"{chosen.value}: every verdict will be UNKNOWN, that model does not exist for this robot; choose {others}"
        )
    else:
        yield Finding("ok", "effective_mass_model", chosen.value)
        return
    yield Finding("wrong", "effective_mass_model", text)


def _joints(arm: RobotDynamics) -> list[dict[str, Any]]:
    model = arm.robot.model
    columns = (
        arm.robot.joint_names,
        arm.robot.revolute,
        model.lowerPositionLimit.tolist(),
        model.upperPositionLimit.tolist(),
        model.velocityLimit.tolist(),
        [float(body.mass) for body in list(model.inertias)[1:]],
    )
    return [
        {
            "name": name,
            "type": "revolute" if turns else "prismatic",
            "lower": _finite(lower),
            "upper": _finite(upper),
            "max_speed": _finite(speed),
            "link_mass_kg": mass,
        }
        for name, turns, lower, upper, speed, mass in zip(*columns, strict=True)
    ]


def _finite(value: float) -> float | None:
    """Return `value`, None where the robot file sets no bound, which JSON has no number for."""
    return value if math.isfinite(value) else None


def _shown(value: float | None) -> str:
    return "none" if value is None else f"{value:.4g}"


def _show(findings: list[Finding], joints: list[dict[str, Any]]) -> None:
    table = Table(box=None, show_header=False, padding=(0, 2, 0, 0))
    for width in (5, None, None):
        table.add_column(min_width=width, overflow="fold")
    for finding in findings:
        table.add_row(*finding)
    console = printer()
    console.print(table)
    if not joints:
        return
    table = Table(box=box.SIMPLE_HEAD)
    for heading in ("joint", "type"):
        table.add_column(heading)
    for heading in ("lower", "upper", "unit", "max. speed [unit/s]", "link mass [kg]"):
        table.add_column(heading, justify="right")
    for joint in joints:
        table.add_row(
            joint["name"],
            joint["type"],
            _shown(joint["lower"]),
            _shown(joint["upper"]),
            "rad" if joint["type"] == "revolute" else "m",
            _shown(joint["max_speed"]),
            f"{joint['link_mass_kg']:.4g}",
        )
    console.print(table)

# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass doctor`."""

from __future__ import annotations

import argparse
import os
import platform
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from scara_effmass import __version__
from scara_effmass.analysis.lumped_model import compare_models
from scara_effmass.analysis.output import atomic_file, check_output_path, json_types
from scara_effmass.analysis.summary import shares
from scara_effmass.cli.console import LEVEL_STYLES, print_findings, print_json, print_table, printer
from scara_effmass.cli.options import load_dynamics, monitor_settings
from scara_effmass.codes import ModelCode
from scara_effmass.errors import DaqError, EffmassError, LimitError, RobotError, SettingsError
from scara_effmass.extras import missing_extra
from scara_effmass.input_files import check_regular_file
from scara_effmass.iso15066 import EDITION, TABLE_HASH, limits_for
from scara_effmass.safety.assumptions import assumptions_of, deciding_mass, mass_source, scope
from scara_effmass.settings import DaqSettings, MassModel, MonitorSettings, load_settings
from scara_effmass.values import Verdict, at_most

if TYPE_CHECKING:
    from scara_effmass.reference import RobotDynamics


COMPARED_POSES = 300
"""Number of random poses and directions at which the lumped is compared with the full mass."""
PICTURES = (".png", ".svg")


class CheckResult(NamedTuple):
    """One line of the report: `level` is "ok", "note" or "wrong" (the monitor cannot run)."""

    level: str
    subject: str
    text: str

    @classmethod
    def of(cls, subject: str, text: str, problem: str = "", level: str = "note") -> CheckResult:
        """Return "ok" with `text`, or `level` with the `problem`."""
        return cls(level if problem else "ok", subject, problem or text)


def run(args: argparse.Namespace) -> int:
    """Check the installation, the environment, the DAQ device and the robot; return 1 if the monitor cannot run."""
    settings = monitor_settings(args, others=("daq",))
    if not settings.robot_path.exists():
        raise RobotError(f"{settings.robot_path}: no such file; must be a URDF or DH YAML file")
    check_regular_file(settings.robot_path, RobotError)
    if args.hulls:
        if args.hulls.suffix not in PICTURES:
            raise SettingsError(f"--hulls = {args.hulls}: must end with {' or '.join(PICTURES)}")
        check_output_path(args.hulls, overwrite=args.force)
    cell, dynamics = cell_results(settings)
    if args.hulls and dynamics:
        cell.append(_draw_hulls(dynamics, args.hulls, overwrite=args.force))
    results = [*_installation(), *_environment(), *_daq(args.params), *cell]
    joints = _joints(dynamics) if dynamics else []
    healthy = all(result.level != "wrong" for result in results)
    if args.json:
        findings = [result._asdict() for result in results]
        print_json({"healthy": healthy, "findings": findings, "joints": joints})
    else:
        print_findings(results)
        if joints:
            headings = ("joint", "unit", "lower", "upper", "speed [unit/s]", "link mass [kg]")
            rows = (
                (name, "rad" if kind == "revolute" else "m", *rest) for name, kind, *rest in map(dict.values, joints)
            )
            print_table("", headings, rows)
        problem = "not healthy: the monitor cannot run: see the lines marked wrong"
        verdict = "healthy: the monitor can run with this robot" if healthy else problem
        printer().print(verdict, style=LEVEL_STYLES["ok" if healthy else "wrong"])
    return 0 if healthy else 1


def _draw_hulls(dynamics: RobotDynamics, path: Path, *, overwrite: bool) -> CheckResult:
    """Draw the links that are watched as a whole. Raises SettingsError without any, and OutputError."""
    from scara_effmass.analysis.report import report_figure  # noqa: PLC0415 - as above
    from scara_effmass.analysis.robot_figures import draw_hulls  # noqa: PLC0415 - matplotlib, an extra

    if not dynamics.robot.hulls:
        raise SettingsError("--hulls: no link is watched as a whole; use --contact-point whole_arm")
    picture = report_figure("hulls", "", "", draw_hulls(dynamics.robot))
    with atomic_file(path, overwrite=overwrite) as file:
        file.write_bytes(picture.png if path.suffix == ".png" else picture.svg)
    return CheckResult("ok", "hulls", f"{path}: {', '.join(dynamics.robot.hulls)}")


def cell_results(settings: MonitorSettings) -> tuple[list[CheckResult], RobotDynamics | None]:
    """Return the results for limits and robot of `settings`, and the robot, None if it cannot be loaded."""
    results = [*_limits(settings), *(CheckResult("note", "settings", line) for line in settings.without_effect())]
    try:
        dynamics = load_dynamics(settings)
    except RobotError as error:
        return [*results, CheckResult("wrong", "robot", str(error))], None
    if settings.payload_topic:
        text = f"by topic {settings.payload_topic}, not in the masses here; UNKNOWN until it arrives"
        results.append(CheckResult("note", "payload", text))
    results += [*_robot(dynamics), *tightest(dynamics, settings), *_comparison(dynamics, settings.model_margin)]
    results.append(_mass_model(dynamics, settings.effective_mass_model))
    return [*results, *_assumptions(dynamics, settings)], dynamics


def _installation() -> Iterator[CheckResult]:
    yield CheckResult.of("scara_effmass", f"{__version__}, Python {platform.python_version()}, {platform.platform()}")
    checks: dict[str, Callable[[], str]] = {
        "rclpy": lambda: _version("rclpy", "ros-jazzy-rclpy"),
        "middleware": lambda: str(import_module("rclpy").get_rmw_implementation_identifier()),
        "scara_effmass_msgs": _type_support,
        "pinocchio": lambda: str(import_module("pinocchio").__version__),
    }
    for subject, check in checks.items():
        try:
            yield CheckResult("ok", subject, check())
        except Exception as error:  # noqa: BLE001, PERF203 - a broken installation may raise anything
            reason = " ".join(str(error).split()) or type(error).__name__
            yield CheckResult("wrong", subject, f"{reason}; install scara_effmass again, or source ROS 2")
    compiled = "compiled by numba, for the live monitor and for many joint states at once"
    yield CheckResult.of("kernel", compiled, _kernel_problem())


def _kernel_problem() -> str:
    """Return why the kernel cannot be compiled, or cannot be kept for the next start; empty if it is both."""
    from scara_effmass.kernel.compiled import FILE, cache_folders, why_not  # noqa: PLC0415 - loads the kernel

    folders = cache_folders()
    is_plain = os.environ.get("NUMBA_DISABLE_JIT", "0") != "0"
    if (reason := why_not()) or is_plain or any(os.path.exists(folder / FILE) for folder in folders):  # noqa: PTH110 - no right to look is no error
        return reason
    return f"every start compiles it for about a minute: must be able to write {folders[0]}, else set NUMBA_CACHE_DIR"


def _version(module: str, wheel: str) -> str:
    """Return version and location of `module`, which pip installs as `wheel` and apt under its own name."""
    location = import_module(module).__file__
    for name in (module, wheel):
        with suppress(PackageNotFoundError):
            return f"{version(name)} ({location})"
    return f"version unknown ({location})"


def _type_support() -> str:
    kind = type(import_module("scara_effmass_msgs.msg").ContactState)
    kind.__import_type_support__()
    if kind._TYPE_SUPPORT is None:  # noqa: SLF001 - the generated code has no public way
        raise ImportError("the type support of ContactState does not load")
    return f"type support of ContactState loads ({import_module('scara_effmass_msgs').__file__})"


def _environment() -> Iterator[CheckResult]:
    yield CheckResult("ok", "ROS_DOMAIN_ID", os.environ.get("ROS_DOMAIN_ID") or "0 (the default)")
    name = "ROS_AUTOMATIC_DISCOVERY_RANGE"
    discovery_range = os.environ.get(name) or "SUBNET (the default)"
    hint = f"{discovery_range}; nodes communicate with the whole network; LOCALHOST keeps to this machine"
    yield CheckResult.of(name, discovery_range, hint * discovery_range.startswith("SUBNET"))
    yield _log_folder()


def _log_folder() -> CheckResult:
    """Check that ROS finds a folder for the log; without one, no node starts."""
    name, remedy = "ROS_LOG_DIR", "must be a folder that can be written"
    try:
        folder = Path(str(import_module("rclpy.logging").get_logging_directory()))
        existing = next(path for path in (folder, *folder.parents) if path.exists())
        with TemporaryDirectory(dir=existing):
            pass
    except OSError as error:
        return CheckResult("wrong", name, f"{folder}: {error.strerror}: no node can write its log there: {remedy}")
    except Exception as error:  # noqa: BLE001 - as of `_installation`
        return CheckResult("wrong", name, f"{' '.join(str(error).split())}: {remedy}")
    return CheckResult("ok", name, f"{os.environ.get(name) or 'not set'}: logs go to {folder}")


def _daq(params: Path | None) -> Iterator[CheckResult]:
    """Check driver, devices and channels of `daq_node`; the monitor runs without them, so none is "wrong"."""
    try:
        settings = load_settings(DaqSettings, params, "daq")
    except SettingsError as error:
        settings = DaqSettings()
        yield CheckResult("note", "daq_node", f"{error}; the defaults are checked instead")
    yield from (CheckResult("note", "daq_node", line) for line in settings.without_effect())
    try:
        driver = import_module("scara_effmass.daq.ni_driver")
        yield CheckResult("ok", "NI-DAQmx", driver.driver_version())
        devices = driver.devices()
    except (DaqError, ImportError) as error:
        text = missing_extra(error) if isinstance(error, ImportError) else ""
        yield CheckResult("note", "NI-DAQmx", text or str(error))
        return
    for device in devices:
        simulated = ", simulated by its driver" if device.simulated else ""
        channels = f"; for an IEPE force sensor: {', '.join(device.channels)}" if device.channels else ""
        text = device.problem or f"{device.product}{simulated}{channels}"
        yield CheckResult("note" if device.problem or device.simulated else "ok", device.name, text)
    if settings.source == "ni9230":
        chosen, present = settings.ni9230.channels, [channel for device in devices for channel in device.channels]
        missing = {channel for channel in chosen if channel.lower() not in map(str.lower, present)}
        absence = f"{', '.join(sorted(missing))} not found; present: {', '.join(present) or 'none'}"
        yield CheckResult.of("ni9230.channels", f"{', '.join(chosen)}: present", absence * bool(missing))


def _limits(settings: MonitorSettings) -> Iterator[CheckResult]:
    try:
        regions = ", ".join(limit.region for limit in limits_for(settings))
        area = 1e4 * settings.contact_area_m2  # cm2
        contact = f"{settings.contact.value}, {area:g} cm², person at {settings.person_speed:g} m/s"
    except LimitError as error:
        yield CheckResult("wrong", "limits", str(error))
    else:
        yield CheckResult("ok", "limits", f"{EDITION}; hash {TABLE_HASH}; {contact}: {regions}")
        if area > 1.0:
            hint = f"{area:g} cm²: allows {area:g} times the pressure force of 1 cm², if the whole area bears"
            yield CheckResult("note", "contact area", hint)


def _robot(dynamics: RobotDynamics) -> Iterator[CheckResult]:
    robot = dynamics.robot
    aggregated = "" if dynamics.lumped is None else ", ".join(f"{mass:.4g}" for mass in dynamics.lumped.aggregated)
    yield CheckResult("ok", "robot", f"{robot.name} ({robot.origin}), base frame {robot.base_frame}")
    yield CheckResult("ok", "contact points", ", ".join(dynamics.contact_points))
    yield CheckResult.of("units", "plausible", robot.units_reason, "wrong")
    reach = f"at least {at_most(robot.reach, 3)} m from {robot.joint_names[0]}, in sampled poses"
    yield CheckResult("ok", "reach", reach)
    for subject, problem, text in (
        ("masses", robot.masses_reason, "present"),
        ("centres of mass", robot.coms_reason, "present"),
        ("inertia tensors", robot.inertias_reason, "present and physically consistent"),
        ("lumped model", dynamics.lumped_reason, f"masses {aggregated} kg, from base to tip"),
        ("full model", dynamics.full_reason, "the mass matrix is positive definite over the joint ranges"),
    ):
        yield CheckResult.of(subject, text, problem)
    if not robot.masses_reason:
        yield CheckResult("ok", "moving mass", f"{robot.moving_mass:.4g} kg without the payload")
        yield CheckResult("ok", "ISO mass", f"M/2 + m_L = {robot.iso_mass:.4g} kg")
    no_payload = "0 kg: the last link must include the tool and its load"
    yield CheckResult.of("payload", robot.payload_text, no_payload * (not robot.payload_mass))
    if held := [joint.name for joint in robot.held if not joint.is_harmless]:
        text = f"UNKNOWN while one of these moves, which the model holds fixed: {', '.join(held)}"
        yield CheckResult("note", "motion", f"{text}: ignored_joints states the harmless ones")
    if expected := [joint.name for joint in robot.held if joint.is_expected]:
        text = f"UNKNOWN unless joint states have these, too, which the model holds fixed: {', '.join(expected)}"
        yield CheckResult("note", "joint states", f"{text}: locked_joints states those that never move")
    for name, text in _home_masses(dynamics):
        yield CheckResult("ok", f"home pose, {name}", text)
    warning = robot.rotors.warning
    armatures = ", ".join(f"{value:.4g}" for value in robot.model.armature.tolist())
    yield CheckResult.of("armature", f"{armatures} kg m² or kg", warning)
    for note in (note for note in robot.notes if note != warning):
        yield CheckResult("note", "robot file", note)


def _home_masses(dynamics: RobotDynamics) -> Iterator[tuple[str, str]]:
    """Yield each named point and its masses along the base axes, all joints at 0 or their limit nearest to it."""
    model = dynamics.robot.model
    q = np.clip(np.zeros(model.nv), model.lowerPositionLimit, model.upperPositionLimit)
    for contact in (contact for contact in dynamics.at(q).contacts if contact.name in _points(dynamics)):
        for code, mobility in contact.mobilities.items():
            if code is ModelCode.FULL or contact.no_lumped_mass(None) is None:
                values = np.diagonal(mobility).tolist()
                axes = " / ".join(f"{1.0 / value:.3g}" if value > 1e-9 else "no motion" for value in values)
                yield contact.name, f"{code.name.lower()} mass {axes} kg along x / y / z of {dynamics.robot.base_frame}"


def tightest(dynamics: RobotDynamics, settings: MonitorSettings) -> Iterator[CheckResult]:
    """Say which contact has the largest share of its allowable speed in how many random motions."""
    from scara_effmass.kernel.contact_kernel import too_large  # noqa: PLC0415 - loads the kernel
    from scara_effmass.safety import Monitor  # noqa: PLC0415 - as above

    if reason := too_large(dynamics.robot):
        text = f"not sampled: {reason}; the reference is hundreds of times slower: watch few contacts live"
        yield CheckResult("note", "tightest contact", text)
        return
    if len(dynamics.contact_points) == 1:
        return
    try:
        monitor = Monitor(dynamics, settings)
    except EffmassError:  # a line of its own says so
        return
    q = dynamics.robot.sample_configurations(COMPARED_POSES)
    qd = np.random.default_rng(1).normal(size=q.shape)
    assessed = monitor.assess_configurations(q, qd)
    deciding = assessed.deciding()[(assessed.contacts["verdict"] != Verdict.UNKNOWN).all(axis=1)]
    if len(deciding):
        counts = Counter(dynamics.contact_points[index] for index in deciding.tolist())
        yield CheckResult("ok", "tightest contact", f"{shares(counts)} of {len(deciding)} random motions")


def _points(dynamics: RobotDynamics) -> tuple[str, ...]:
    """Return the contacts whose masses are shown: the place of a link depends on the motion."""
    return dynamics.robot.named_points or dynamics.contact_points[:1]


def _comparison(dynamics: RobotDynamics, margin: float) -> Iterator[CheckResult]:
    """Compare the lumped with the full mass of each named point, in one line."""
    if dynamics.lumped is None or dynamics.full_reason:
        return
    comparisons, missing = compare_models(dynamics, margin, COMPARED_POSES, seed=1)
    masses = {entry.contact_point: entry for entry in comparisons if entry.quantity == "mass"}
    points, lines = _points(dynamics), []
    for point, share in zip(dynamics.contact_points, missing, strict=True):
        if point in points:
            text = masses[point].text if point in masses else f"no lumped mass at {share:.0%} of the poses"
            lines.append(f"{point}: {text}")
    is_heavy = all(point in masses and not masses[point].too_light for point in points)
    yield CheckResult("ok" if is_heavy else "note", "lumped over full", "; ".join(lines))


def _mass_model(dynamics: RobotDynamics, model: MassModel) -> CheckResult:
    """Check that the effective mass that decides the verdict exists for this robot."""
    problems = {
        MassModel.LUMPED: dynamics.lumped_reason,
        MassModel.FULL: dynamics.full_reason,
        MassModel.LARGEST: dynamics.lumped_reason or dynamics.full_reason,
        MassModel.ISO: "",
        MassModel.AUTO: "",
    }
    if problem := dynamics.robot.masses_reason:
        remedy = f"add the masses to the robot file ({problem})"
    elif problems[model]:
        models = (name.value for name, reason in problems.items() if not reason and name is not MassModel.LARGEST)
        remedy = f"this model does not exist for this robot; choose {' or '.join(models)}"
    else:
        level = "note" if mass_source(dynamics.robot) else "ok"
        return CheckResult(level, "effective_mass_model", f"{model.value}: {deciding_mass(dynamics, model)}")
    return CheckResult("wrong", "effective_mass_model", f"{model.value}: every verdict will be UNKNOWN: {remedy}")


def _assumptions(dynamics: RobotDynamics, settings: MonitorSettings) -> Iterator[CheckResult]:
    """Yield what is assumed, and what an OK covers."""
    assumptions = assumptions_of(dynamics.robot, settings)
    for name, text in assumptions.lines:
        yield CheckResult("note", f"assumed: {name}", text)
    if assumptions.limiting:
        yield CheckResult("note", "an OK", "none while these are assumed: state them, or accept them by name")
    else:
        yield CheckResult("ok", "an OK covers", scope(dynamics.robot, settings))


def _joints(dynamics: RobotDynamics) -> list[dict[str, Any]]:
    """Return the joints for JSON; a bound that the robot file does not set is None."""
    robot, model = dynamics.robot, dynamics.robot.model
    lower, upper = np.where(robot.periods > 0.0, np.inf, (model.lowerPositionLimit, model.upperPositionLimit))
    joints: list[dict[str, Any]] = json_types(
        [
            {
                "name": name,
                "type": "revolute" if robot.revolute[index] else "prismatic",
                "lower": lower[index],
                "upper": upper[index],
                "max_speed": model.velocityLimit[index],
                "link_mass_kg": model.inertias[index + 1].mass,
            }
            for index, name in enumerate(robot.joint_names)
        ]
    )
    return joints

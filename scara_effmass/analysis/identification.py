# SPDX-License-Identifier: Apache-2.0
"""Identify the masses of an arm from a recording with effort, and report them."""

from __future__ import annotations

from collections import Counter, defaultdict, deque
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from scara_effmass.analysis.assessment import Time, joint_state_topic, require_stated_robot
from scara_effmass.analysis.output import json_types
from scara_effmass.bags.files import open_bag
from scara_effmass.codes import Reason
from scara_effmass.errors import BagError, RobotError, SettingsError
from scara_effmass.identification.arm import (
    ArmEstimate,
    EffectiveMasses,
    effective_mass,
    effective_masses,
    identify_arm,
    modelled_torques,
    with_parameters,
)
from scara_effmass.identification.regression import Z_95
from scara_effmass.kernel.intervals import TORQUE, Intervals
from scara_effmass.model.load import load_robot
from scara_effmass.model.robot import Robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety.joint_state_adapter import JointStateAdapter
from scara_effmass.settings import MassModel, MonitorSettings
from scara_effmass.values import FloatArray, ValidatedImpact
from scara_effmass.wire.cdr import NS

CONFIGURATIONS = 200
"""Number of configurations over the workspace at which effective masses are compared."""
LATEST = 1_000
"""Number of intervals, 20 s at 100 Hz, whose torques are drawn."""
MAX_CONDITION = 100.0
"""Condition number from which on the motion is called poor."""

HEADINGS = ("link behind", "file [kg]", "identified [kg]", "f_c", "f_v", "effort off [%]", "torque", "residual")
"""Masses, friction [N m, N; per rad/s or m/s], error of the effort, root mean squares in motion [N m, N]."""


class Torques(NamedTuple):
    """Torques (k, n) [N m, N] at the end of a recording: measured, and by what was identified, NaN without motion.

    `seconds` (k,) [s] are before the end.
    """

    seconds: FloatArray
    measured: FloatArray
    modelled: FloatArray


class Identification(NamedTuple):
    """The masses of `robot` by the recording at `path`, from `used` joint states with effort of `total`."""

    path: Path
    robot: Robot
    used: int
    total: int
    estimate: ArmEstimate
    masses: EffectiveMasses
    torques: Torques

    @property
    def ratios(self) -> FloatArray:
        """Effective masses as identified over those by the file."""
        return self.masses.identified / self.masses.stated

    @property
    def half_intervals(self) -> FloatArray:
        """Half the interval of 95 % over the identified effective mass."""
        return Z_95 * self.masses.deviations / self.masses.identified

    @property
    def mass_uncertainties(self) -> tuple[float, float]:
        """What `mass_uncertainty` must be for the robot file in use, and for the corrected one.

        They cover the upper bound of the effective mass in 95 % of the configurations and directions, and are rounded
        up to 0.001.
        """
        bounds = self.ratios * (1.0 + self.half_intervals) - 1.0, self.half_intervals
        of_file, corrected = np.ceil(1e3 * np.percentile(bounds, 95.0, axis=1)) / 1e3
        return max(0.0, float(of_file)), float(corrected)

    def as_dict(self) -> dict[str, Any]:
        """Return the result for JSON."""
        estimate, names = self.estimate, self.robot.joint_names
        solution, base = estimate.solution, estimate.base
        of_file, corrected = self.mass_uncertainties
        content = {
            "recording": self.path,
            "robot": self.robot.origin,
            "joint_states": self.total,
            "joint_states_used": self.used,
            "unfit": estimate.unfit,
            "rows": {"counted": solution.rows, "left_out": solution.left_out},
            "base_parameters": {
                "identifiable": base.identifiable,
                "rank": base.rank,
                "condition_number": base.condition_number,
            },
            "is_projected": estimate.is_projected,
            "links": [
                {
                    "joint": name,
                    "stated": estimate.stated[j],
                    "identified": estimate.parameters[j],
                    "deviations": estimate.deviations[j],
                    "is_identified": estimate.is_known[j],
                }
                for j, name in enumerate(names)
            ],
            "joints": [
                {
                    "joint": name,
                    "coulomb": solution.friction[j][0],
                    "viscous": solution.friction[j][1],
                    "effort_error": solution.scale_errors[j],
                    "rms": solution.residuals[j],
                }
                for j, name in enumerate(names)
            ],
            "point_masses": estimate.point_masses,
            "effective_mass": {
                "configurations": CONFIGURATIONS,
                "identified_over_file": _percentiles(self.ratios),
                "half_interval": _percentiles(self.half_intervals),
            },
            "mass_uncertainty": {"of_this_file": of_file, "of_the_corrected_file": corrected},
        }
        return {name: json_types(value) for name, value in content.items()}

    def lines(self) -> Iterator[tuple[str, str]]:
        """Yield subject and text of the report."""
        estimate, base = self.estimate, self.estimate.base
        yield "joint states", f"{self.used} with effort of {self.total}"
        if estimate.unfit:
            yield "no masses", f"{estimate.unfit}: check --torque-constants, masses and mounting of the file, payload"
            return
        rows = f"{estimate.solution.left_out} of {estimate.solution.rows + estimate.solution.left_out} rows stand out"
        text = f"{base.rank} of {base.identifiable} base parameters move the torques, {rows} and do not count"
        poor = base.rank < base.identifiable or base.condition_number > MAX_CONDITION
        advice = ": poor, move all joints to and fro, at several poses" if poor else ""
        yield "motion", f"{text}, condition number {base.condition_number:.3g}{advice}"
        if estimate.is_projected:
            yield "consistency", "projected to the nearest links that are physically possible"
        if estimate.point_masses:
            masses = zip(estimate.point_masses.on_axes, estimate.point_masses.axes_deviations, strict=True)
            text = ", ".join(f"{mass:.3f} ± {Z_95 * deviation:.3f}" for mass, deviation in masses)
            yield "lumped masses", f"by axis, from the base: {text} kg"
        ratio, half = _percentiles(self.ratios), _percentiles(self.half_intervals)
        text = "identified over file {median:.3f} (5 % {p5:.3f}, 95 % {p95:.3f})".format(**ratio)
        within = f"within {100 * half['median']:.1f} % (95 % of the workspace {100 * half['p95']:.1f} %)"
        yield "effective mass", f"{text}, {within}"
        of_file, corrected = self.mass_uncertainties
        text = f"{of_file:.3f} for the robot file as it is, {corrected:.3f} for the corrected one"
        advice = "; above 1 it cannot be stated: record more motion of all joints"
        yield "mass_uncertainty", text + advice * (max(of_file, corrected) > 1.0)

    def rows(self) -> Iterator[tuple[object, ...]]:
        """Yield what HEADINGS names, per joint."""
        estimate, solution = self.estimate, self.estimate.solution
        for j, name in enumerate(self.robot.joint_names):
            stated, mass, half = estimate.stated[j, 0], estimate.parameters[j, 0], Z_95 * estimate.deviations[j, 0]
            found = f"{mass:.3g} ± {half:.2g}" if estimate.is_known[j, 0] else "not by itself"
            if estimate.point_masses:
                found = " and ".join(f"{mass:.3g}" for mass in estimate.point_masses.identified[j])
            numbers = (
                *solution.friction[j],
                100.0 * solution.scale_errors[j],
                solution.torques[j],
                solution.residuals[j],
            )
            yield name, float(stated), found, *map(float, numbers)


def _percentiles(values: FloatArray) -> dict[str, float]:
    p5, median, p95 = np.percentile(values, [5.0, 50.0, 95.0]).tolist()
    return {"p5": p5, "median": median, "p95": p95, "largest": float(values.max())}


def identify(path: Path, settings: MonitorSettings, topic: str | None = None) -> Identification:
    """Return the masses of the robot of `settings` by the recording at `path`.

    They are those of the lumped model for a robot without inertia tensors, and where the settings choose it. Raises
    BagError for a recording without effort or motion, RobotError for a robot without masses or centres of mass, and
    SettingsError where velocities are not to count as reported.
    """
    if settings.filters_velocity:
        stated = f"velocity_source = {settings.velocity_source.value}, velocity_window = {settings.velocity_window:g}"
        raise SettingsError(f"{stated}: must be reported and 0 for identification")
    robot = load_robot(settings.robot_path, settings)
    dynamics = RobotDynamics(robot)
    is_lumped = dynamics.full_reason or settings.effective_mass_model is MassModel.LUMPED
    if is_lumped and dynamics.lumped is None:
        raise RobotError(
            f"{robot.origin}: identification starts from masses: {dynamics.full_reason or dynamics.lumped_reason}"
        )
    lumped, motion = dynamics.lumped if is_lumped else None, _Motion(robot, settings)
    estimate = identify_arm(robot, motion.means(path, topic), settings.effort_uncertainty, lumped)
    if not motion.has_torque:
        raise BagError(f"{path}: {motion.problem or 'the effort is 0 throughout'}: must hold the torques of the joints")
    if estimate is None:
        problem = motion.problem or "no joint moves for long enough"
        raise BagError(f"{path}: {problem}: must hold motion of the arm")
    masses = effective_masses(estimate, CONFIGURATIONS)
    stamps, latest = (np.array(values) for values in zip(*motion.latest, strict=True))
    seconds = (stamps - stamps[-1]) / NS
    torques = Torques(seconds, latest[:, TORQUE], modelled_torques(robot, estimate, latest))
    return Identification(path, robot, motion.used, motion.total, estimate, masses, torques)


class _Motion:
    """Reads motion with effort of `robot`; counts joint states, and those `used`, and keeps the `latest` intervals."""

    def __init__(self, robot: Robot, settings: MonitorSettings) -> None:
        self._robot, self._settings = robot, settings
        self._adapter = JointStateAdapter(robot.joint_names, settings, robot.periods, robot.held)
        self.used = self.total = 0
        self.has_torque = False
        self._problems = Counter[str]()
        self.latest = deque[tuple[int, FloatArray]](maxlen=LATEST)

    @property
    def problem(self) -> str:
        """What is wrong with most of the joint states that do not count; empty if all do."""
        if not self._problems:
            return ""
        ((text, count),) = self._problems.most_common(1)
        return f"{count} of {self.total} joint states: {text}" if count else ""

    def means(
        self,
        path: Path,
        topic: str | None,
        time: Time = Time.HEADER,
        stamps_ns: Sequence[int] = (),
        poses: dict[int, FloatArray] | None = None,
    ) -> Iterator[FloatArray]:
        """Yield the means (6, n) over the intervals of a recording; put q (n,) at `stamps_ns` into `poses`.

        A stamp without a joint state within `timeout` after it has none.
        """
        robot, adapter, waiting = self._robot, self._adapter, deque(sorted(stamps_ns))
        timeout_ns = round(self._settings.timeout * NS)
        intervals = Intervals(robot.periods, self._settings.timeout)
        with open_bag(path) as bag:
            require_stated_robot(bag, self._settings)
            for block in bag.joint_state_blocks(joint_state_topic(bag, topic)):
                layout, size = adapter.layout(block.names), len(block)
                self.total += size
                if not size:
                    continue
                if layout.is_foreign or layout.reason is not Reason.NONE:
                    named = f"they name {', '.join(block.names)}, not {', '.join(robot.joint_names)}: see joint_map"
                    self._problems[named] += size
                    continue
                q, qd = np.empty((2, size, robot.model.nv))
                reason, _ = adapter.read(layout, block.position, block.velocity, q, qd)
                if reason is not Reason.NONE or block.effort.shape[-1] != len(block.names) or not block.velocity.size:
                    self._problems["no velocity or no effort"] += size
                    continue
                stamps = block.log_time_ns if time is Time.LOG else block.stamp_ns
                effort = block.effort[:, layout.order]
                is_finite = np.isfinite(effort).all(axis=1)
                self._problems["the effort is not finite"] += int(np.sum(~is_finite))
                self._problems["their stamps do not increase"] += int(np.sum(np.diff(stamps) <= 0))
                self.has_torque |= bool(np.any(effort[is_finite] != 0.0))
                self.used += int(np.sum(is_finite))
                while poses is not None and waiting and waiting[0] <= stamps[-1]:
                    row = int(np.searchsorted(stamps, stamp_ns := waiting.popleft()))
                    if stamps[row] - stamp_ns <= timeout_ns:
                        poses[stamp_ns] = q[row]
                ends, means = intervals.add(stamps, q, qd, effort * robot.torque_constants)
                self.latest.extend(zip(stamps[ends].tolist(), means, strict=True))
                yield from means


class ScaleByMotion(NamedTuple):
    """Mean over `impacts` of the effective mass by the torques over that of a model, with half its interval of 95 %."""

    scale: float
    half: float
    impacts: int

    @property
    def text(self) -> str:
        """The scale with its interval."""
        return f"{self.scale:.3f} ({self.scale - self.half:.3f} to {self.scale + self.half:.3f})"


def scales_by_motion(
    recordings: Sequence[tuple[Path, str, Sequence[ValidatedImpact]]],
    robot: Robot,
    settings: MonitorSettings,
    time: Time,
) -> tuple[dict[str, ScaleByMotion], str]:
    """Return the factors on the masses of the models by the motion in recordings, and why there are none.

    Each recording has its topic of joint states and its impacts, in whose poses and directions the masses count.
    `time` is that of the stamps of the impacts.
    """
    poses: list[tuple[ValidatedImpact, FloatArray]] = []
    motion = _Motion(robot, settings)

    def all_means() -> Iterator[FloatArray]:
        for path, topic, impacts in recordings:
            by_stamp = dict[int, FloatArray]()
            yield from motion.means(path, topic, time, [impact.stamp_ns for impact in impacts], by_stamp)
            poses.extend((one, by_stamp[one.stamp_ns]) for one in impacts if one.stamp_ns in by_stamp)

    estimate = identify_arm(robot, all_means(), settings.effort_uncertainty)
    if not motion.has_torque:
        return {}, "the joint states carry no effort"
    if estimate is None:
        return {}, "no joint moves for long enough"
    if estimate.unfit:
        return {}, estimate.unfit
    model = with_parameters(robot.model, estimate.parameters)
    data = model.createData()
    ratios, gradients = defaultdict[str, list[float]](list), defaultdict[str, list[FloatArray]](list)
    for impact, q in poses:
        if impact.contact_point in robot.hulls:  # anywhere on a link
            continue
        frame, normal = robot.contact_frames[impact.contact_point], np.array([impact.direction])
        (mass,), (gradient,) = effective_mass(robot, model, data, q, normal, frame)
        for prediction in impact.predictions:
            ratios[prediction.model].append(mass / prediction.effective_mass)
            gradients[prediction.model].append(gradient / prediction.effective_mass)
    scales = {
        name: ScaleByMotion(
            float(np.mean(values)),
            Z_95 * float(np.linalg.norm(np.mean(gradients[name], axis=0) @ estimate.root)),
            len(values),
        )
        for name, values in ratios.items()
    }
    return scales, "" if scales else "no impact has joint states with effort and a contact point of known place"

# SPDX-License-Identifier: Apache-2.0
"""Validate recordings with the same monitor, detector and validator as the live nodes.

The log time of a message replaces its arrival time at a node.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from heapq import merge
from itertools import repeat
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from scara_effmass.analysis.assessment import AssessedState, Time, assessed_rows, joint_state_topic
from scara_effmass.analysis.forces import (
    ForceTrace,
    Measurement,
    check_other_forces,
    detected_impacts,
    file_measurements,
    file_traces,
    lost_samples,
    measurement_topic,
    measurements,
)
from scara_effmass.analysis.identification import ScaleByMotion, scales_by_motion
from scara_effmass.bags.bag import Bag
from scara_effmass.bags.bag import run_infos as stored_run_infos
from scara_effmass.bags.batches import LossLog
from scara_effmass.bags.files import open_bag
from scara_effmass.errors import BagError, SettingsError
from scara_effmass.impacts.detector import Detector
from scara_effmass.impacts.impact_matcher import check_run_info
from scara_effmass.impacts.state_history import recording_offset
from scara_effmass.impacts.validator import Result, Validator
from scara_effmass.importers.force import IMPORTERS
from scara_effmass.safety import Monitor
from scara_effmass.settings import DetectionSettings, ImportSettings, MonitorSettings, ValidatorSettings
from scara_effmass.values import ForceBlock, Impact, LeftOut, RefusedImpact, RunInfo, ValidatedImpact, Verdict
from scara_effmass.wire.cdr import NS

if TYPE_CHECKING:
    from scara_effmass.reference import RobotDynamics


@dataclass(frozen=True, slots=True)
class ValidationSettings:
    """Settings of monitor, validator and detection, and the topics to read; None: chosen automatically.

    `obstacle_mass` [kg] overrides the recordings; if both state none, `validator.obstacle_mass` applies. `force` states
    topic and import of the force, which is in the recordings or in `force_from`, one file for each of them.
    `force_offset` [s] is added to the stamps in these files; None: estimated from the velocity at the impacts.
    """

    monitor: MonitorSettings = field(default_factory=MonitorSettings)
    validator: ValidatorSettings = field(default_factory=ValidatorSettings)
    detection: DetectionSettings = field(default_factory=DetectionSettings)
    obstacle_mass: float | None = None
    topic: str | None = None
    time: Time = Time.LIVE
    force: ImportSettings = field(default_factory=ImportSettings)
    force_from: tuple[Path, ...] = ()
    force_offset: float | None = None


@dataclass(slots=True)
class ValidatedRecording:
    """Contents of one recording, and its part of the `impacts` and `refused` of the whole result.

    `dropouts`, `glitches` (single samples) and `sustained_contacts` (too long for impacts) are counted in force blocks;
    0 if `force_topic` holds impacts. `left_out` is force above the threshold that is in no impact.
    `relative_uncertainty` is the maximum stated for the force. `losses` lists unreadable parts. If the force is in
    another file, `force_topic` is its path, `force_offset` [s] was added to its
    stamps, and `force_clock` says so.
    """

    path: Path
    joint_state_topic: str
    force_topic: str
    infos: tuple[RunInfo, ...]
    simulated: bool
    joint_states: int = 0
    force_blocks: int = 0
    lost_samples: int = 0
    dropouts: int = 0
    glitches: int = 0
    sustained_contacts: int = 0
    left_out: tuple[LeftOut, ...] = ()
    force_offset: float = 0.0
    force_clock: str = ""
    sources: tuple[str, ...] = ()
    relative_uncertainty: float = 0.0
    impacts: tuple[ValidatedImpact, ...] = ()
    refused: tuple[RefusedImpact, ...] = ()
    losses: tuple[str, ...] = ()

    @property
    def files(self) -> tuple[Path, ...]:
        """The recording, and the file of the force if it is another one: the last is that of the force."""
        return (self.path, Path(self.force_topic)) if self.force_clock else (self.path,)

    def force_traces(
        self, contacts: Sequence[ValidatedImpact | RefusedImpact], settings: ImportSettings, after_s: float
    ) -> list[ForceTrace]:
        """Return the force of each of the `contacts` in order, up to `after_s` after its onset. Raises BagError."""
        onsets = [contact.stamp_ns for contact in contacts]
        if not self.force_clock:
            settings = settings.model_copy(update={"topic": self.force_topic})
        return file_traces(self.files[-1], settings, onsets, after_s, LossLog(), self.force_offset)

    def count(self, value: ForceBlock | Impact) -> None:
        """Count a force block, without lost samples, or an impact."""
        self.simulated |= value.simulated
        self.sources = tuple(sorted({*self.sources, value.source}))
        if isinstance(value, ForceBlock):
            self.force_blocks += 1
            self.relative_uncertainty = max(self.relative_uncertainty, value.relative_uncertainty)


class Validation(NamedTuple):
    """Result of a series and its recordings; no recordings if the series was live.

    `by_motion` are the factors on the masses of the models by the torques in motion, `no_motion` why there are none.
    """

    result: Result
    recordings: tuple[ValidatedRecording, ...]
    by_motion: Mapping[str, ScaleByMotion] = MappingProxyType({})
    no_motion: str = ""

    def names(self) -> list[str]:
        """Return the name of the recording of each impact."""
        if not self.recordings:
            return ["live"] * len(self.result.impacts)
        return [recording.path.name for recording in self.recordings for _ in recording.impacts]


def validate(
    paths: Sequence[Path],
    dynamics: RobotDynamics,
    settings: ValidationSettings,
    advance: Callable[[float], object] = lambda _: None,
) -> Validation:
    """Validate the models of `dynamics` with the recordings at `paths`, as one series.

    Calls `advance` with the fraction of a recording processed since the last call. Raises BagError, SettingsError,
    LimitError.
    """
    pairs = zip(paths, settings.force_from or repeat(None), strict=False)
    return joined([validate_recording(*pair, dynamics, settings, advance) for pair in pairs], settings)


def validate_recording(
    path: Path,
    force_path: Path | None,
    dynamics: RobotDynamics,
    settings: ValidationSettings,
    advance: Callable[[float], object],
) -> tuple[ValidatedRecording, Validator]:
    """Return the recording at `path` with its force, in `force_path` if given, and its validator, for `joined`.

    Raises as `validate`.
    """
    validator, losses = Validator(settings.validator), LossLog()
    with open_bag(path) as bag:
        states = joint_state_topic(bag, settings.topic)
        infos = tuple(run_infos(bag))
        recording = ValidatedRecording(bag.path, states, str(force_path), infos, any(info.simulated for info in infos))
        if force_path is None:
            force = measurement_topic(bag, settings.force.topic, "; if it is in another file, state --force-from")
            check_other_forces(bag, force, settings.force, settings.detection)
            recording.force_topic = force.name
            measured = measurements(bag, force, settings.force)
        else:
            if force_path.suffix.lower() not in IMPORTERS:
                with open_bag(force_path) as other:
                    topic = measurement_topic(other, settings.force.topic)
                    check_other_forces(other, topic, settings.force, settings.detection)
            foreign = list(file_measurements(force_path, settings.force, losses))
            measured = _on_joint_clock(foreign, bag, recording, Monitor(dynamics, settings.monitor), settings)
        defaults, mass = settings.validator, settings.obstacle_mass
        validator.runs.set(0, defaults.obstacle_mass if mass is None else mass, defaults.configuration)
        for info in infos:
            validator.runs.begin(info if mass is None else info._replace(obstacle_mass=mass), 0)
        detector = Detector(settings.detection)
        force_ns, monitor = 0, Monitor(dynamics, settings.monitor)
        contacts = _validated(monitor, defaults.contact_point)
        validator.know(dynamics.contact_points)
        before: ForceBlock | None = None
        records: tuple[Iterator[AssessedState | Measurement], ...] = (
            measured,
            assessed_rows(bag, states, monitor, settings.time, contacts, advance),
        )
        for item in merge(*records, key=lambda record: record.log_time_ns):
            if isinstance(item, AssessedState):
                recording.joint_states += 1
                validator.add_decision(item.decision, item.log_time_ns)
                continue
            value = item.value._replace(simulated=item.value.simulated or recording.simulated)
            force_ns = item.log_time_ns
            recording.count(value)
            if isinstance(value, ForceBlock):
                recording.lost_samples += lost_samples(value, before)
                before = value
                validator.add_force(value, force_ns)
            for impact in detector.feed(value) if isinstance(value, ForceBlock) else (value,):
                validator.add_impact(impact, force_ns)
        recording.joint_states += monitor.ignored
        for impact in detector.finish():
            validator.add_impact(impact, force_ns)
        recording.dropouts, recording.glitches = detector.dropouts, detector.glitches
        recording.sustained_contacts = detector.sustained_contacts
        validator.leave_out(detector.left_out)
        recording.left_out = validator.left_out
        losses.extend(bag.losses)
        recording.losses = tuple(losses)
    validator.begin_recording()
    return recording, validator


def joined(parts: Iterable[tuple[ValidatedRecording, Validator]], settings: ValidationSettings) -> Validation:
    """Return the validation of recordings as one series."""
    series = Validator(settings.validator)
    recordings: list[ValidatedRecording] = []
    ends = [(0, 0)]
    for recording, validator in parts:
        recordings.append(recording)
        ends.append(series.extend(validator))
    result = series.result()
    for recording, start, stop in zip(recordings, ends, ends[1:], strict=False):
        recording.impacts = result.impacts[start[0] : stop[0]]
        recording.refused = result.refused[start[1] : stop[1]]
    return Validation(result, tuple(recordings))


def with_motion(validation: Validation, dynamics: RobotDynamics, settings: ValidationSettings) -> Validation:
    """Return `validation` with what the torques of its recordings in motion say about the masses. Raises BagError."""
    if dynamics.full_reason:
        return validation._replace(no_motion=dynamics.full_reason)
    recordings = [(item.path, item.joint_state_topic, item.impacts) for item in validation.recordings]
    by_motion, no_motion = scales_by_motion(recordings, dynamics.robot, settings.monitor, settings.time)
    return validation._replace(by_motion=by_motion, no_motion=no_motion)


def _validated(monitor: Monitor, point: str) -> list[int]:
    """Return the number of the contact that is validated, `point` or the first one; none if there is no `point`.

    To build those of all links takes longer than to compute them.
    """
    names = monitor.dynamics.contact_points
    return [names.index(point or names[0])] if not point or point in names else []


def _on_joint_clock(
    measured: Sequence[Measurement],
    bag: Bag,
    recording: ValidatedRecording,
    monitor: Monitor,
    settings: ValidationSettings,
) -> Iterator[Measurement]:
    """Return what was `measured` by another clock, with stamps and log times of the joint states. Raises BagError."""
    stamps_ns, lags_ns, velocity = array("q"), array("q"), array("d")
    contacts = _validated(monitor, settings.validator.contact_point)
    for item in assessed_rows(bag, recording.joint_state_topic, monitor, settings.time, contacts=contacts):
        if item.decision.stamp_ns <= (stamps_ns[-1] if stamps_ns else 0):
            continue
        stamp_ns = item.decision.stamp_ns
        contact = next(iter(item.decision.contacts), None)
        if contact is not None and (contact.verdict is not Verdict.UNKNOWN or any(contact.direction)):
            stamps_ns.append(stamp_ns)
            lags_ns.append(item.log_time_ns - stamp_ns)
            velocity.extend(contact.speed * component for component in contact.direction)
    offset_ns, origin = round((settings.force_offset or 0.0) * NS), "as given"
    if settings.force_offset is None:
        found = detected_impacts((item.value for item in measured), Detector(settings.detection))
        impacts = [impact for impact in found if not (impact.incomplete or impact.rebound)]
        begin_ns, first_ns = (stamps_ns[0], impacts[0].stamp_ns) if stamps_ns and impacts else (0, 0)
        kink = recording_offset(
            np.array([(impact.stamp_ns - first_ns) / NS for impact in impacts]),
            np.array([impact.impulse for impact in impacts]),
            np.array([impact.duration for impact in impacts]),
            (np.frombuffer(stamps_ns, np.int64) - begin_ns) / NS,
            np.frombuffer(velocity).reshape(-1, 3),
        )
        if kink is None:
            problem = f"not one offset fits its {len(impacts)} impacts to the velocity in {bag.path}"
            raise BagError(f"{recording.force_topic}: {problem}; give --force-offset")
        offset_ns = round(kink.delay * NS) + begin_ns - first_ns
        origin = f"from the velocity (impacts: {len(impacts)}, resolution {1e3 * kink.resolution:.1f} ms)"
    recording.force_offset = offset_ns / NS
    recording.force_clock = f"{recording.force_topic}: its stamps {recording.force_offset:+.6f} s, {origin}"
    lag_ns = int(np.median(lags_ns)) if lags_ns else 0

    def moved(value: ForceBlock | Impact) -> Measurement:
        stamp_ns = value.stamp_ns + offset_ns
        span_s = len(value.force) / value.sample_rate if isinstance(value, ForceBlock) else 0.0
        value = value._replace(stamp_ns=stamp_ns, simulated=value.simulated or recording.simulated)
        return Measurement(stamp_ns + round(span_s * NS) + lag_ns, value)

    return (moved(value) for _, value in measured)


def run_infos(bag: Bag) -> list[RunInfo]:
    """Return the run information in `bag`; a missing stamp becomes the log time, or 0 in the first one.

    Raises BagError for an invalid value.
    """
    infos: list[RunInfo] = []
    for log_time_ns, info in stored_run_infos(bag):
        try:
            check_run_info(info)
        except SettingsError as error:
            raise BagError(f"{bag.path}: run information: {error}") from None
        infos.append(info._replace(stamp_ns=info.stamp_ns or (log_time_ns if infos else 0)))
    return infos

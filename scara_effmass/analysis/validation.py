"""Validate recordings with the same monitor, detector and validator as the live nodes.

The log time of a message replaces its arrival time at a node.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from scara_effmass.analysis.assessment import assess_joint_states, joint_state_topic
from scara_effmass.analysis.recorded_run import (
    Measurement,
    measurement_topic,
    measurements,
    merge_by_log_time,
    run_infos,
)
from scara_effmass.bags.bag import Bag
from scara_effmass.bags.files import open_bag
from scara_effmass.impacts.detector import Detector
from scara_effmass.impacts.result import Result
from scara_effmass.impacts.validator import Validator
from scara_effmass.safety import Monitor
from scara_effmass.settings import DetectionSettings, MonitorSettings, ValidatorSettings
from scara_effmass.values import ForceBlock, Impact, RefusedImpact, RunInfo, ValidatedImpact

if TYPE_CHECKING:
    from scara_effmass.model.dynamics import RobotDynamics


@dataclass(frozen=True, slots=True)
class ValidationSettings:
    """Settings of monitor, validator and detection, and the topics to read; None: chosen automatically.

    `obstacle_mass` [kg] overrides the recordings; if both state none, `validator.obstacle_mass` applies.
    """

    monitor: MonitorSettings = field(default_factory=MonitorSettings)
    validator: ValidatorSettings = field(default_factory=ValidatorSettings)
    detection: DetectionSettings = field(default_factory=DetectionSettings)
    obstacle_mass: float | None = None
    topic: str | None = None
    force_topic: str | None = None


class ValidatedRecording(NamedTuple):
    """Result of one recording: its part of the `impacts` and `refused` of the whole result.

    `dropouts` and `glitches` (single samples), and `pushes` (contacts too long for impacts) are counted in force
    blocks; 0 if `force_topic` holds impacts. `relative_uncertainty` is the maximum stated for the force. `losses`
    lists unreadable parts.
    """

    path: Path
    joint_states: int
    joint_state_topic: str
    force_topic: str
    force_blocks: int
    lost_samples: int
    dropouts: int
    glitches: int
    pushes: int
    simulated: bool
    sources: tuple[str, ...]
    relative_uncertainty: float
    infos: tuple[RunInfo, ...]
    impacts: tuple[ValidatedImpact, ...]
    refused: tuple[RefusedImpact, ...]
    losses: tuple[str, ...]


class Validation(NamedTuple):
    """Result of a series and its recordings; no recordings if the series was live."""

    result: Result
    recordings: tuple[ValidatedRecording, ...]

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
    validator = Validator(settings.validator)
    readers: list[_RecordingReader] = []
    ends = [(0, 0)]
    for path in paths:
        validator.begin_recording()
        with open_bag(path) as bag:
            reader = _RecordingReader(bag, Monitor(dynamics, settings.monitor), validator, settings)
            reader.run(advance)
        readers.append(reader)
        validator.finish()
        result = validator.result()
        ends.append((len(result.impacts), len(result.refused)))
    result = validator.result()
    recordings = [
        reader.recording(result.impacts[start[0] : stop[0]], result.refused[start[1] : stop[1]])
        for reader, start, stop in zip(readers, ends, ends[1:], strict=False)
    ]
    return Validation(result, tuple(recordings))


class _RecordingReader:
    """Feed one recording into monitor, detector and validator, and count its contents."""

    def __init__(self, bag: Bag, monitor: Monitor, validator: Validator, settings: ValidationSettings) -> None:
        self._bag = bag
        self._monitor = monitor
        self._validator = validator
        self._detector = Detector(settings.detection)
        self._states = joint_state_topic(bag, settings.topic)
        self._force = measurement_topic(bag, settings.force_topic)
        self._infos = tuple(run_infos(bag))
        self._joint_states = self._blocks = self._lost = self._last_force_ns = 0
        self._simulated = any(info.simulated for info in self._infos)
        self._sources: Counter[str] = Counter()
        self._uncertainty = 0.0
        self._unreadable: Counter[str] = Counter()
        self._set_runs(settings)

    def run(self, advance: Callable[[float], object]) -> None:
        """Feed the whole recording."""
        total = next(topic.count for topic in self._bag.topics if topic.name == self._states)
        states = assess_joint_states(self._bag, self._states, self._monitor)
        for record in merge_by_log_time(states, measurements(self._bag, self._force, self._unreadable)):
            if isinstance(record, Measurement):
                self._add_measurement(record)
                continue
            self._joint_states += 1
            advance(1.0 / total)
            for contact in record.decision.contacts if record.decision else ():
                self._validator.add_state(contact, record.log_time_ns)
        for impact in self._detector.finish():
            self._validator.add_impact(impact, self._last_force_ns)

    def recording(self, impacts: tuple[ValidatedImpact, ...], refused: tuple[RefusedImpact, ...]) -> ValidatedRecording:
        """Return the result of this recording."""
        unreadable = [f"{line} ({count} times)" if count > 1 else line for line, count in self._unreadable.items()]
        return ValidatedRecording(
            path=self._bag.path,
            joint_states=self._joint_states,
            joint_state_topic=self._states,
            force_topic=self._force.name,
            force_blocks=self._blocks,
            lost_samples=self._lost,
            dropouts=self._detector.dropouts,
            glitches=self._detector.glitches,
            pushes=self._detector.sustained_contacts,
            simulated=self._simulated,
            sources=tuple(sorted(self._sources)),
            relative_uncertainty=self._uncertainty,
            infos=self._infos,
            impacts=impacts,
            refused=refused,
            losses=(*self._bag.losses, *unreadable),
        )

    def _set_runs(self, settings: ValidationSettings) -> None:
        defaults, mass = settings.validator, settings.obstacle_mass
        # Replaces the run of the previous recording.
        initial_mass = defaults.obstacle_mass if mass is None else mass
        self._validator.set_run(0, obstacle_mass=initial_mass, configuration=defaults.configuration)
        for info in self._infos:
            self._validator.set_run_info(info if mass is None else info._replace(obstacle_mass=mass), 0)

    def _add_measurement(self, measurement: Measurement) -> None:
        value, self._last_force_ns = measurement.value, measurement.log_time_ns
        self._sources[value.source] += 1
        self._simulated |= value.simulated
        if isinstance(value, Impact):
            self._validator.add_impact(value, measurement.log_time_ns)
            return
        self._add_block(value, measurement.log_time_ns)

    def _add_block(self, block: ForceBlock, received_ns: int) -> None:
        # The first block counts samples lost before the recording began.
        self._lost += block.lost_samples if self._blocks else 0
        self._blocks += 1
        self._uncertainty = max(self._uncertainty, block.relative_uncertainty)
        self._validator.add_force(block, received_ns)
        for impact in self._detector.feed(block):
            self._validator.add_impact(impact, received_ns)

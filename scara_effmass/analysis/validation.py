"""Validate recordings with the same monitor, detector and validator as the live nodes.

The log time of a message replaces its arrival time at a node.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from heapq import merge
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from scara_effmass.analysis.assessment import AssessedState, assess_joint_states, joint_state_topic
from scara_effmass.analysis.recorded_run import Measurement, measurement_topic, measurements, run_infos
from scara_effmass.bags.bag import Bag
from scara_effmass.bags.files import open_bag
from scara_effmass.impacts.detector import Detector
from scara_effmass.impacts.validator import Result, Validator
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


@dataclass(slots=True)
class ValidatedRecording:
    """Contents of one recording, and its part of the `impacts` and `refused` of the whole result.

    `dropouts` and `glitches` (single samples), and `pushes` (contacts too long for impacts) are counted in force
    blocks; 0 if `force_topic` holds impacts. `relative_uncertainty` is the maximum stated for the force. `losses`
    lists unreadable parts.
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
    pushes: int = 0
    sources: tuple[str, ...] = ()
    relative_uncertainty: float = 0.0
    impacts: tuple[ValidatedImpact, ...] = ()
    refused: tuple[RefusedImpact, ...] = ()
    losses: tuple[str, ...] = ()

    def count(self, value: ForceBlock | Impact) -> None:
        """Count a force block or an impact."""
        self.simulated |= value.simulated
        self.sources = tuple(sorted({*self.sources, value.source}))
        if isinstance(value, ForceBlock):
            # The first block counts samples lost before the recording began.
            self.lost_samples += value.lost_samples if self.force_blocks else 0
            self.force_blocks += 1
            self.relative_uncertainty = max(self.relative_uncertainty, value.relative_uncertainty)


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
    recordings: list[ValidatedRecording] = []
    ends = [(0, 0)]
    for path in paths:
        validator.begin_recording()
        with open_bag(path) as bag:
            recordings.append(_feed(bag, Monitor(dynamics, settings.monitor), validator, settings, advance))
        validator.finish()
        result = validator.result()
        ends.append((len(result.impacts), len(result.refused)))
    result = validator.result()
    for recording, start, stop in zip(recordings, ends, ends[1:], strict=False):
        recording.impacts = result.impacts[start[0] : stop[0]]
        recording.refused = result.refused[start[1] : stop[1]]
    return Validation(result, tuple(recordings))


def _feed(
    bag: Bag, monitor: Monitor, validator: Validator, settings: ValidationSettings, advance: Callable[[float], object]
) -> ValidatedRecording:
    """Feed one recording into monitor, detector and validator, and return its contents."""
    states = joint_state_topic(bag, settings.topic)
    force = measurement_topic(bag, settings.force_topic)
    infos = tuple(run_infos(bag))
    _set_runs(validator, settings, infos)
    recording = ValidatedRecording(bag.path, states, force.name, infos, any(info.simulated for info in infos))
    detector = Detector(settings.detection)
    unreadable: Counter[str] = Counter()
    share = 1.0 / next(topic.count for topic in bag.topics if topic.name == states)
    force_ns = 0
    records: tuple[Iterator[AssessedState | Measurement], ...] = (
        measurements(bag, force, unreadable),
        assess_joint_states(bag, states, monitor),
    )
    for item in merge(*records, key=lambda record: record.log_time_ns):
        if isinstance(item, AssessedState):
            recording.joint_states += 1
            advance(share)
            for contact in item.decision.contacts if item.decision else ():
                validator.add_state(contact, item.log_time_ns)
            continue
        value, force_ns = item.value, item.log_time_ns
        recording.count(value)
        if isinstance(value, ForceBlock):
            validator.add_force(value, force_ns)
        for impact in detector.feed(value) if isinstance(value, ForceBlock) else (value,):
            validator.add_impact(impact, force_ns)
    for impact in detector.finish():
        validator.add_impact(impact, force_ns)
    recording.dropouts, recording.glitches = detector.dropouts, detector.glitches
    recording.pushes = detector.sustained_contacts
    undecoded = (f"{line} ({count} times)" if count > 1 else line for line, count in unreadable.items())
    recording.losses = (*bag.losses, *undecoded)
    return recording


def _set_runs(validator: Validator, settings: ValidationSettings, infos: Sequence[RunInfo]) -> None:
    """Set the obstacle masses and configurations of a recording, in place of those of the previous one."""
    defaults, mass = settings.validator, settings.obstacle_mass
    initial_mass = defaults.obstacle_mass if mass is None else mass
    validator.runs.set(0, initial_mass, defaults.configuration)
    for info in infos:
        validator.runs.begin(info if mass is None else info._replace(obstacle_mass=mass), 0)

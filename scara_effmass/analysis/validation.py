"""Recordings through the cores of monitor, force node and validator, one after the other.

The recorder's log time stands for the time at which a node would have heard of a message.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from scara_effmass.analysis.assessment import assess_joint_states, joint_state_topic
from scara_effmass.analysis.recorded_run import (
    Measured,
    in_order,
    measured,
    measured_topic,
    run_infos,
)
from scara_effmass.bags.files import open_bag
from scara_effmass.impacts.detector import Detector
from scara_effmass.impacts.validator import Validator
from scara_effmass.safety import Monitor
from scara_effmass.settings import DetectionSettings, MonitorSettings, ValidatorSettings
from scara_effmass.values import Impact

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from scara_effmass.bags.bag import Bag
    from scara_effmass.impacts.result import Result
    from scara_effmass.model.dynamics import RobotDynamics
    from scara_effmass.values import ForceBlock, RefusedImpact, RunInfo, ValidatedImpact


@dataclass(frozen=True, slots=True)
class ValidationSettings:
    """Settings of the cores, and what is to be read.

    `obstacle_mass` [kg] goes before what recordings say; where neither gives one, `validator.obstacle_mass` holds.
    Topics are found where they are None.
    """

    monitor: MonitorSettings = field(default_factory=MonitorSettings)
    validator: ValidatorSettings = field(default_factory=ValidatorSettings)
    detection: DetectionSettings = field(default_factory=DetectionSettings)
    obstacle_mass: float | None = None
    topic: str | None = None
    force_topic: str | None = None


class ValidatedRecording(NamedTuple):
    """What came of one recording.

    `impacts` are those of the whole result that are from it, `refused` likewise. `force_topic` holds force blocks, in
    which `dropouts` and `glitches` (single samples), and `pushes` that are too long for impacts were found, or else
    impacts. `relative_uncertainty` is that of the force, the largest one stated. `losses`: what could not be read.
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
    """The validator's result, and the recordings it is from; none where the series was live."""

    result: Result
    recordings: tuple[ValidatedRecording, ...]

    def names(self) -> list[str]:
        """Return for each impact the recording it is from."""
        if not self.recordings:
            return ["live"] * len(self.result.impacts)
        return [recording.path.name for recording in self.recordings for _ in recording.impacts]


def validate(
    paths: Sequence[Path],
    dynamics: RobotDynamics,
    settings: ValidationSettings,
    advance: Callable[[float], object] = lambda _: None,
) -> Validation:
    """Return what the recordings at `paths`, each for `open_bag`, say of the models of `dynamics`, as one series.

    `advance` is called with the share of a recording that has been done. Raises BagError, SettingsError, LimitError.
    """
    validator = Validator(settings.validator)
    feeds: list[_Feed] = []
    ends = [(0, 0)]
    for path in paths:
        validator.begin_recording()
        with open_bag(path) as bag:
            feed = _Feed(bag, Monitor(dynamics, settings.monitor), validator, settings)
            feed.run(advance)
        feeds.append(feed)
        validator.finish()
        result = validator.result()
        ends.append((len(result.impacts), len(result.refused)))
    result = validator.result()
    recordings = [
        feed.recording(result.impacts[start[0] : stop[0]], result.refused[start[1] : stop[1]])
        for feed, start, stop in zip(feeds, ends, ends[1:], strict=False)
    ]
    return Validation(result, tuple(recordings))


class _Feed:
    """One recording on its way into the validator."""

    def __init__(self, bag: Bag, monitor: Monitor, validator: Validator, settings: ValidationSettings) -> None:
        self._bag = bag
        self._monitor = monitor
        self._validator = validator
        self._detector = Detector(settings.detection)
        self._states = joint_state_topic(bag, settings.topic)
        self._force = measured_topic(bag, settings.force_topic)
        self._infos = tuple(run_infos(bag))
        self._joint_states = self._blocks = self._lost = self._heard_ns = 0
        self._simulated = any(info.simulated for info in self._infos)
        self._sources: Counter[str] = Counter()
        self._uncertainty = 0.0
        self._unreadable: Counter[str] = Counter()
        self._set_runs(settings)

    def run(self, advance: Callable[[float], object]) -> None:
        """Feed all of it."""
        total = next(each.count for each in self._bag.topics if each.name == self._states)
        states = assess_joint_states(self._bag, self._states, self._monitor)
        for each in in_order(states, measured(self._bag, self._force, self._unreadable)):
            if isinstance(each, Measured):
                self._measure(each)
                continue
            self._joint_states += 1
            advance(1.0 / total)
            for contact in each.decision.contacts if each.decision else ():
                self._validator.add_state(contact, each.log_time_ns)
        for impact in self._detector.finish():
            self._validator.add_impact(impact, self._heard_ns)

    def recording(self, impacts: tuple[ValidatedImpact, ...], refused: tuple[RefusedImpact, ...]) -> ValidatedRecording:
        """Return what came of it."""
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
        given, mass = settings.validator, settings.obstacle_mass
        # Nothing may be left over from the recording before.
        first = given.obstacle_mass if mass is None else mass
        self._validator.set_run(0, obstacle_mass=first, configuration=given.configuration)
        for info in self._infos:
            stated = info if mass is None else info._replace(obstacle_mass=mass)
            self._validator.set_run_info(stated, 0)

    def _measure(self, each: Measured) -> None:
        value, self._heard_ns = each.value, each.log_time_ns
        self._sources[value.source] += 1
        self._simulated |= value.simulated
        if isinstance(value, Impact):
            self._validator.add_impact(value, each.log_time_ns)
            return
        self._take_block(value, each.log_time_ns)

    def _take_block(self, block: ForceBlock, received_ns: int) -> None:
        # The first block may say what was lost before the recording began.
        self._lost += block.lost_samples if self._blocks else 0
        self._blocks += 1
        self._uncertainty = max(self._uncertainty, block.relative_uncertainty)
        self._validator.add_force(block, received_ns)
        for impact in self._detector.feed(block):
            self._validator.add_impact(impact, received_ns)

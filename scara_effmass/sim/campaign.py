"""The whole experiment as bags: every configuration and obstacle mass, several times, a little different each time."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING, NamedTuple

from scara_effmass.bags.files import open_bag
from scara_effmass.bags.run_info import run_infos
from scara_effmass.bags.writer import BagWriter
from scara_effmass.errors import BagError, OutputError
from scara_effmass.sim.adc import ForceSensor
from scara_effmass.sim.controller import DEFAULT_GAINS
from scara_effmass.sim.experiment import run_impact
from scara_effmass.sim.impact_setup import CONFIGURATIONS, DWELL_S, OBSTACLE_MASSES, ImpactSetup
from scara_effmass.sim.recordings import EPOCH_NS, SEED
from scara_effmass.sim.rng import uniform
from scara_effmass.sim.spring_contact import POLYETHYLENE
from scara_effmass.sim.topics import FORCE_TOPIC, JOINT_STATES_TOPIC, RUN_INFO_TOPIC
from scara_effmass.values import RunInfo
from scara_effmass.wire.force import force_block_message
from scara_effmass.wire.joint_state import joint_state_message
from scara_effmass.wire.message_types import FORCE_BLOCK, JOINT_STATE, RUN_INFO
from scara_effmass.wire.run_info import run_info_message

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from scara_effmass.sim.controller import ServoGains
    from scara_effmass.sim.experiment import ImpactRun, ImpactTruth
    from scara_effmass.sim.impact_setup import Configuration
    from scara_effmass.sim.spring_contact import SpringContact
    from scara_effmass.values import ForceBlock

REVISION = 2
"""To be raised when the recordings change."""
SUMMARY = "impact of the i4-550L on a cart, simulated with MuJoCo; nothing was measured"
SPEED_SPREAD = 0.02
"""Runs differ in speed by up to so much, relative, of either sign;"""
OFFSET_SPREAD_M = 1e-3
"""in where the cart waits;"""
START_SPREAD_S = 0.01
"""in when the robot sets off;"""
CLOCK_SPREAD = 50e-6
"""and in the rate of the converter's clock."""
RUN_SPACING_NS = 10_000_000_000
"""From the start of one run to that of the next."""
PUBLISHED_NS = 1_000_000
"""So long after its last sample came out of the converter, a block is published."""
_VARIATION = 6  # stream of the seed


@dataclass(frozen=True)
class Campaign:
    """What is to be done: `repetitions` runs of each configuration with each obstacle mass [kg]."""

    configurations: tuple[Configuration, ...] = CONFIGURATIONS
    obstacle_masses: tuple[float, ...] = OBSTACLE_MASSES
    repetitions: int = 3
    speed: float = 0.25
    """[m/s]"""
    contact: SpringContact = POLYETHYLENE
    servo: ServoGains = DEFAULT_GAINS
    noise: float = 0.1
    """of the force, standard deviation [N]"""
    tip_mass: float = 0.0
    """[kg]"""
    guide_friction: float = 0.5
    """[N]"""
    seed: int = SEED

    @cached_property
    def runs(self) -> tuple[Run, ...]:
        """The runs, in order."""
        series = product(self.configurations, self.obstacle_masses, range(1, self.repetitions + 1))
        return tuple(self._run(number, *which) for number, which in enumerate(series))

    def _run(self, number: int, configuration: Configuration, obstacle_mass: float, repetition: int) -> Run:
        speed, offset, start, clock = uniform((self.seed, _VARIATION, number), 4).tolist()
        seed = self.seed * 1000 + number
        setup = ImpactSetup(
            configuration=configuration,
            obstacle_mass=obstacle_mass,
            speed=self.speed * (1.0 + SPEED_SPREAD * (2.0 * speed - 1.0)),
            contact=self.contact,
            servo=self.servo,
            sensor=ForceSensor(clock_error=CLOCK_SPREAD * (2.0 * clock - 1.0), noise=self.noise, seed=seed),
            offset=OFFSET_SPREAD_M * (2.0 * offset - 1.0),
            dwell=DWELL_S + START_SPREAD_S * start,
            tip_mass=self.tip_mass,
            guide_friction=self.guide_friction,
            seed=seed,
            start_ns=EPOCH_NS + number * RUN_SPACING_NS,
        )
        return Run(f"{configuration.name}_{round(obstacle_mass * 1e3)}g_{repetition}", repetition, setup)


class Run(NamedTuple):
    """One run of a campaign, and the name of its bag."""

    name: str
    repetition: int
    setup: ImpactSetup

    @property
    def note(self) -> str:
        """All settings of the run as text; recordings with the same note are of the same run."""
        setup = self.setup
        settings = {
            "generator": "scara-effmass campaign",
            "revision": REVISION,
            "seed": setup.seed,
            "configuration": setup.configuration.name,
            "obstacle_mass": setup.obstacle_mass,
            "repetition": self.repetition,
            "speed": setup.speed,
            "stiffness": setup.contact.stiffness,
            "exponent": setup.contact.exponent,
            "damping": setup.contact.damping,
            "friction": setup.contact.friction,
            "tip_mass": setup.tip_mass,
            "guide_friction": setup.guide_friction,
            "noise": setup.sensor.noise,
            "servo_bandwidth": setup.servo.bandwidth,
            "servo_damping_ratio": setup.servo.damping_ratio,
        }
        return "\n".join([SUMMARY, *(f"{name} = {value}" for name, value in settings.items())])

    def info(self, truth: ImpactTruth) -> RunInfo:
        """Return the run information of its recording."""
        setup, impact = self.setup, truth.impact
        return RunInfo(
            stamp_ns=setup.start_ns,
            frame_id="base_link",
            configuration=setup.configuration.name,
            obstacle_mass=setup.obstacle_mass,
            impact_position=setup.impact_position,
            plate_normal=setup.plate_normal,
            simulated=True,
            note=self.note,
            contact_stiffness=setup.contact.stiffness,
            contact_exponent=setup.contact.exponent,
            true_onset_ns=impact.onset_ns,
            true_speed=impact.speed,
            true_effective_mass=truth.effective_mass,
            true_peak_force=impact.peak_force,
            true_duration=impact.duration,
            true_impulse=impact.impulse,
        )


class CampaignStep(NamedTuple):
    """A run that is recorded: the `number`-th of `total`; `kept` where the recording was there already."""

    number: int
    total: int
    path: Path
    kept: bool


def run_campaign(folder: Path, campaign: Campaign, *, overwrite: bool = False) -> Iterator[CampaignStep]:
    """Record every run of `campaign` as a bag in `folder`; yield after each.

    A recording that is there and says that it is of the same run is kept, so a campaign can be gone on with; with
    `overwrite` all are made anew. Raises OutputError where something else is in the way, or the disk takes no more.
    The same versions of the libraries give the same bytes.
    """
    runs = campaign.runs
    for number, run in enumerate(runs, 1):
        path = folder / run.name
        kept = not overwrite and path.exists()
        if kept and _recorded_note(path) != run.note:
            raise OutputError(f"{path}: is there, and not of this run; another folder, or replacing it, would be right")
        if not kept:
            record(path, run, overwrite=overwrite)
        yield CampaignStep(number, len(runs), path, kept)


def record(path: Path, run: Run, *, overwrite: bool = False) -> ImpactRun:
    """Do a run and record it as the live suite does: joint states and force as they come. Raises OutputError."""
    result = run_impact(run.setup)
    messages = [
        (state.stamp_ns, JOINT_STATES_TOPIC, JOINT_STATE, joint_state_message(state)) for state in result.joint_states
    ]
    messages += [
        (_published_ns(block), FORCE_TOPIC, FORCE_BLOCK, force_block_message(block)) for block in result.force_blocks
    ]
    with BagWriter(path, overwrite=overwrite) as bag:
        info = run_info_message(run.info(result.truth))
        bag.write(RUN_INFO_TOPIC, RUN_INFO, run.setup.start_ns, info)
        for log_time_ns, topic, kind, data in sorted(messages):
            bag.write(topic, kind, log_time_ns, data)
    return result


def _published_ns(block: ForceBlock) -> int:
    taken_s = (len(block.force) - 1) / block.sample_rate + block.filter_delay
    return block.stamp_ns + round(taken_s * 1e9) + PUBLISHED_NS


def _recorded_note(path: Path) -> str | None:
    """Return the note of the bag at `path`; None where it is no complete recording of one run."""
    try:
        with open_bag(path) as bag:
            notes = [info.note for _, info in run_infos(bag)]
            return notes[0] if len(notes) == 1 and not bag.losses else None
    except BagError:
        return None

# SPDX-License-Identifier: Apache-2.0
"""The paper's experiment as bags: repeated impacts in every configuration, with small random variations."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import NamedTuple

from scara_effmass.bags.bag import run_infos
from scara_effmass.bags.files import open_bag
from scara_effmass.errors import BagError, OutputError
from scara_effmass.sim.collision_sim import POLYETHYLENE, SpringContact
from scara_effmass.sim.experiment import (
    BANDWIDTH_HZ,
    CONFIGURATIONS,
    DAMPING_RATIO,
    DWELL_S,
    OBSTACLE_MASSES,
    SPEED,
    Configuration,
    ImpactRun,
    ImpactSetup,
    run_impact,
)
from scara_effmass.sim.measurement import ForceSensor, uniform
from scara_effmass.sim.recordings import EPOCH_NS, SEED, write_recording
from scara_effmass.values import RunInfo

REVISION = 2
"""Increase it when the recordings change."""
SUMMARY = "impact of the i4-550L on a cart, simulated with MuJoCo; nothing was measured"
SPEED_SPREAD = 0.02
"""Largest relative variation of the speed between runs."""
OFFSET_SPREAD_M = 1e-3
"""Largest variation of the cart's position."""
START_SPREAD_S = 0.01
"""Largest delay of the robot's start."""
CLOCK_SPREAD = 50e-6
"""Largest relative error of the converter clock."""
RUN_SPACING_NS = 10_000_000_000
"""Time from the start of one run to the start of the next."""
PUBLISH_DELAY_NS = 1_000_000
"""Time from the last sample of a block to its publication."""
_VARIATION_STREAM = 6


@dataclass(frozen=True)
class Campaign:
    """Parameters of a campaign: `repetitions` runs of each configuration with each obstacle mass [kg]."""

    configurations: tuple[Configuration, ...] = CONFIGURATIONS
    obstacle_masses: tuple[float, ...] = OBSTACLE_MASSES
    repetitions: int = 3
    contact: SpringContact = POLYETHYLENE
    seed: int = SEED

    @cached_property
    def runs(self) -> tuple[Run, ...]:
        """The runs, in order."""
        series = product(self.configurations, self.obstacle_masses, range(1, self.repetitions + 1))
        return tuple(self._run(number, *case) for number, case in enumerate(series))

    def _run(self, number: int, configuration: Configuration, obstacle_mass: float, repetition: int) -> Run:
        speed, offset, start, clock = uniform((self.seed, _VARIATION_STREAM, number), 4).tolist()
        seed = self.seed * 1000 + number
        setup = ImpactSetup(
            configuration=configuration,
            obstacle_mass=obstacle_mass,
            speed=SPEED * (1.0 + SPEED_SPREAD * (2.0 * speed - 1.0)),
            contact=self.contact,
            sensor=ForceSensor(clock_error=CLOCK_SPREAD * (2.0 * clock - 1.0), seed=seed),
            offset=OFFSET_SPREAD_M * (2.0 * offset - 1.0),
            dwell=DWELL_S + START_SPREAD_S * start,
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
        """All settings of the run as text, by which a recording of the same run is recognized."""
        setup = self.setup
        settings = {
            "generator": "scara-effmass campaign",
            "revision": REVISION,
            "seed": setup.seed,
            "configuration": setup.configuration.name,
            "obstacle_mass": setup.obstacle_mass,
            "repetition": self.repetition,
            "speed": setup.speed,
            **asdict(setup.contact),
            "tip_mass": 0.0,
            "guide_friction": setup.cart.guide_friction,
            "noise": setup.sensor.noise,
            "servo_bandwidth": BANDWIDTH_HZ,
            "servo_damping_ratio": DAMPING_RATIO,
        }
        return "\n".join([SUMMARY, *(f"{name} = {value}" for name, value in settings.items())])

    def info(self, result: ImpactRun) -> RunInfo:
        """Return the run information of its recording, with the ground truth."""
        impact = result.impact
        return self.setup.run_info(self.note)._replace(
            true_onset_ns=impact.onset_ns,
            true_speed=impact.speed,
            true_effective_mass=result.effective_mass,
            true_peak_force=impact.peak_force,
            true_duration=impact.duration,
            true_impulse=impact.impulse,
        )


class CampaignStep(NamedTuple):
    """A recorded run; `kept` if its recording existed already."""

    path: Path
    kept: bool


def run_campaign(folder: Path, campaign: Campaign, *, overwrite: bool = False) -> Iterator[CampaignStep]:
    """Record every run of `campaign` as a bag in `folder`; yield after each.

    An existing recording of the same run is kept, so that an interrupted campaign can be resumed; with `overwrite` all
    runs are recorded again. The same versions of the libraries give the same bytes. Raises OutputError if the bag of a
    run exists and is not of that run, or if the disk is full.
    """
    for run in campaign.runs:
        path = folder / run.name
        kept = not overwrite and path.exists()
        if kept and _recorded_note(path) != run.note:
            raise OutputError(f"{path}: exists and is not of this run; choose another folder or replace it")
        if not kept:
            result = run_impact(run.setup)
            blocks = []
            for block in result.force_blocks:
                duration_s = (len(block.force) - 1) / block.sample_rate + block.filter_delay
                blocks.append((block.stamp_ns + round(duration_s * 1e9) + PUBLISH_DELAY_NS, block))
            write_recording(path, run.info(result), result.joint_states, blocks, overwrite=overwrite)
        yield CampaignStep(path, kept)


def _recorded_note(path: Path) -> str | None:
    """Return the note of the bag at `path`, or None if the bag is not a complete recording of one run."""
    try:
        with open_bag(path) as bag:
            notes = [info.note for _, info in run_infos(bag)]
            return notes[0] if len(notes) == 1 and not bag.losses else None
    except BagError:
        return None

# SPDX-License-Identifier: Apache-2.0
"""Settings of the force: source, sensor, signal conditioning, impact detection, and import from files."""

from __future__ import annotations

import re
from typing import Literal

from pydantic import field_validator
from pydantic_core import PydanticCustomError

from scara_effmass.settings.loading import FrozenSettings, fixed, tunable

Axis = Literal["x", "y", "z", "norm"]
Unit = Literal["", "N", "kN", "daN", "lbf", "kgf", "V", "mV"]
ForceSourceKind = Literal["ni9230", "bag", "sim"]
FilterKind = Literal["none", "causal", "zero_phase"]
"""Low-pass of the force: second-order Butterworth, with a short delay that depends on the frequency, or Gaussian FIR,
with the same delay for all frequencies and no overshoot. The delay is subtracted from the stamps and published."""


class SensorSettings(FrozenSettings):
    """The force sensor."""

    sensitivity: float = fixed(
        2.248,
        "from the sensor's calibration certificate [mV/N]; the default is nominal for a PCB 208C03",
        gt=0.0,
        le=1e4,
    )
    sensitivity_uncertainty: float = fixed(
        0.15, "relative uncertainty of the sensitivity; the default is that of the nominal sensitivity", ge=0.0, le=1.0
    )
    range: float = fixed(2224.0, "end of the measuring range in compression and tension [N]", gt=0.0, le=1e6)
    invert: bool = fixed(default=False, description="the sensor reads compression as negative")


class TareSettings(FrozenSettings):
    """Tare of the force."""

    at_start: bool = fixed(default=True, description="tare at the start")
    time: float = fixed(0.5, "averaging time of a tare [s]", gt=0.0, le=60.0)
    tolerance: float = fixed(1.0, "a tare is refused when the force moves by more than this [N]", gt=0.0, le=1e6)


class FilterSettings(FrozenSettings):
    """Low-pass over the force."""

    kind: FilterKind = fixed("none", "none, causal (Butterworth) or zero_phase (Gaussian)")
    cutoff: float = fixed(2000.0, "frequency of half power [Hz]", gt=0.0, le=1e5)


class DetectionSettings(FrozenSettings):
    """Detection of impacts."""

    threshold: float = fixed(5.0, "smallest force of an impact above the baseline [N]", gt=0.0, le=1e5)
    noise_factor: float = fixed(
        8.0, "smallest force of an impact above the baseline, in standard deviations of the noise", ge=1.0, le=100.0
    )
    longest: float = fixed(1.0, "longest impact; a longer force is a sustained contact [s]", gt=0.0, le=10.0)
    rebound_time: float = fixed(
        0.5, "a contact that starts within this time of another is its rebound [s]", ge=0.0, le=60.0
    )


class Ni9230Settings(FrozenSettings):
    """The converter."""

    channels: tuple[str, ...] = fixed(
        ("cDAQ1Mod1/ai0",), "physical channels; the first publishes on force, the others below it, as force/ai1"
    )
    sample_rate: float = fixed(
        12_800.0, "requested rate; the device selects the nearest one that it has [Hz]", gt=0.0, le=1e6
    )
    samples: int = fixed(0, "samples of a finite acquisition, 10000 in the paper; 0: continuous", ge=0)
    coupling: Literal["AC", "DC"] = fixed("AC", "AC or DC")
    current: float = fixed(0.004, "excitation [A]", ge=0.0, le=0.02)
    filter_delay_samples: float = fixed(
        38.0, "delay of the converter's digital filter if the driver does not state it [samples]", ge=0.0, le=1000.0
    )
    retry_time: float = fixed(1.0, "pause between attempts to reconnect a device [s]", gt=0.0, le=60.0)

    @field_validator("channels")
    @classmethod
    def _check_channels(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        if not names or not all(re.fullmatch(r"[^\s/,:]+/[^\s/,:]+", name) for name in names):
            raise PydanticCustomError("channels", "must be a list of single channels, as cDAQ1Mod1/ai0")
        if len({name.lower() for name in names}) < len(names):
            raise PydanticCustomError("channels", "must name each channel once")
        return names


class BagSettings(FrozenSettings):
    """A bag as the source."""

    path: str = fixed("", "bag with ForceBlocks or wrenches: rosbag2 folder, .mcap, .db3 or .bag")
    topic: str = fixed("", "topic of the ForceBlocks, or of the wrenches if there are none; empty: the only one")
    axis: Axis = fixed("z", "force of a wrench: x, y, z, or norm, |F - F0| without a sign, F0 from the first second")
    unit: Unit = fixed("", "unit of wrenches: N, kN, daN, lbf, kgf, V or mV; empty: N")
    rate: float = fixed(1.0, "multiple of the recorded speed; 0: as fast as possible", ge=0.0, le=1e3)
    subscriber_timeout: float = fixed(3.0, "how long to wait for a subscriber before playing [s]", ge=0.0, le=3600.0)
    stamps: Literal["recorded", "now"] = fixed(
        "recorded", "recorded, or now: as if measured now; relative stamps are always now"
    )


class SimSettings(FrozenSettings):
    """Simulated force as the source."""

    scene: Literal["half_sines", "cell"] = fixed(
        "half_sines",
        "half_sines: noise and half-sine impacts on all channels; cell: the simulated cell, whose robot sim_node moves",
    )
    start: float = fixed(
        0.0, "ROS time at which the cell starts, the same as that of sim_node [s]; 0: now", ge=0.0, le=1e10
    )
    channels: int = fixed(1, "number of channels", ge=1, le=8)
    sample_rate: float = fixed(12_800.0, "nominal rate of the simulated converter [Hz]", gt=0.0, le=1e6)
    seed: int = fixed(0, "seed of noise and impacts", ge=0)
    impact_period: float = fixed(2.0, "mean time between impacts [s]", ge=0.1, le=3600.0)
    noise: float = fixed(0.1, "standard deviation of the noise [N]", ge=0.0, le=100.0)
    clock_error: float = fixed(20e-6, "relative error of the simulated converter's clock", ge=-1e-3, le=1e-3)


class DaqSettings(FrozenSettings):
    """All settings of `daq_node`."""

    source: ForceSourceKind = fixed("ni9230", "force source: ni9230, bag or sim")
    frame_id: str = fixed("force_sensor", "frame of the sensor; its z axis points along compression")
    block_time: float = fixed(0.1, "time between two reads, which is the length of a block [s]", ge=0.005, le=2.0)
    backlog: float = fixed(
        10.0, "longest queue of unpublished samples; more are dropped and counted as lost [s]", gt=0.0, le=600.0
    )
    wrench_rate: float = fixed(100.0, "rate of the decimated topic wrench [Hz]; 0: none", ge=0.0, le=1e4)
    sensor: SensorSettings = SensorSettings()
    tare: TareSettings = TareSettings()
    filter: FilterSettings = FilterSettings()
    detection: DetectionSettings = DetectionSettings()
    ni9230: Ni9230Settings = Ni9230Settings()
    bag: BagSettings = BagSettings()
    sim: SimSettings = SimSettings()

    def _needs(self) -> dict[str, tuple[bool, str]]:
        is_bag, needed = self.source == "bag", "source = bag"
        return {
            "filter.cutoff": (self.filter.kind != "none", "a filter.kind"),
            "bag.path": (is_bag, needed),
            "bag.topic": (is_bag, needed),
        }


class ImportSettings(FrozenSettings):
    """Select the force in a file, and state what the file does not."""

    topic: str = tunable("", "topic, CSV column or TDMS channel of the force; empty: the only one")
    axis: Axis = tunable("z", "force of a wrench: x, y, z, or norm, |F - F0| without a sign, F0 from the first second")
    unit: Unit = tunable(
        "", "unit of the values: N, kN, daN, lbf, kgf, V or mV; empty: as the file states, N for messages"
    )
    time_column: str = tunable(
        "", "CSV column (two: SECONDS,NANOSECONDS), or TDMS channel, of the times; empty: that beside the force"
    )
    rate: float = tunable(0.0, "constant rate of a file without times [Hz]; 0: the file has times", ge=0.0, lt=1e7)
    header: bool = tunable(True, "whether a CSV file names its columns in a header")  # noqa: FBT003
    frame_id: str = tunable("force_sensor", "frame of the sensor; its z axis points along compression")
    sensor: SensorSettings = tunable(SensorSettings(), "sensor that recorded the file")

"""Settings of the force measurement: source, sensor, signal conditioning and impact detection."""

from __future__ import annotations

import re
from enum import Enum
from functools import partial
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator
from pydantic_core import PydanticCustomError

from scara_effmass.settings.loading import READ_ONLY

_fixed = partial(Field, json_schema_extra=READ_ONLY)
"""A setting that a running node does not change."""


class ForceSourceKind(str, Enum):
    """Force source."""

    NI9230 = "ni9230"
    BAG = "bag"
    SIM = "sim"

    @classmethod
    def _missing_(cls, value: object) -> ForceSourceKind | None:
        """Accept the former name of `sim`."""
        return cls.SIM if value == "bench" else None


class FilterKind(str, Enum):
    """Low-pass over the force; its delay is subtracted from the stamps and published."""

    NONE = "none"
    CAUSAL = "causal"
    """Butterworth of second order: short delay, which depends on the frequency."""
    ZERO_PHASE = "zero_phase"
    """Gaussian FIR: the same delay for all frequencies, no overshoot."""


class Coupling(str, Enum):
    """Coupling of the converter."""

    AC = "AC"
    DC = "DC"


class Stamps(str, Enum):
    """Stamps of a played bag."""

    RECORDED = "recorded"
    NOW = "now"


class SimScene(str, Enum):
    """Simulated force."""

    HALF_SINES = "half_sines"
    CELL = "cell"


class _Group(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class SensorSettings(_Group):
    """The force sensor."""

    sensitivity: float = _fixed(
        2.248,
        gt=0.0,
        le=1e4,
        description="from the sensor's calibration certificate [mV/N]; the default is nominal for a PCB 208C03",
    )
    sensitivity_uncertainty: float = _fixed(
        0.15,
        ge=0.0,
        le=1.0,
        description="relative uncertainty of the sensitivity; the default is that of the nominal sensitivity",
    )
    range: float = _fixed(
        2224.0, gt=0.0, le=1e6, description="end of the measuring range in compression and tension [N]"
    )
    invert: bool = _fixed(default=False, description="the sensor reads compression as negative")


class TareSettings(_Group):
    """Tare of the force."""

    at_start: bool = _fixed(default=True, description="tare at the start")
    time: float = _fixed(0.5, gt=0.0, le=60.0, description="averaging time of a tare [s]")
    tolerance: float = _fixed(
        1.0, gt=0.0, le=1e6, description="a tare is refused when the force moves by more than this [N]"
    )


class FilterSettings(_Group):
    """Low-pass over the force."""

    kind: FilterKind = _fixed(FilterKind.NONE, description="none, causal (Butterworth) or zero_phase (Gaussian)")
    cutoff: float = _fixed(2000.0, gt=0.0, le=1e5, description="frequency of half power [Hz]")


class DetectionSettings(_Group):
    """Detection of impacts."""

    threshold: float = _fixed(5.0, gt=0.0, le=1e5, description="smallest force of an impact above the baseline [N]")
    noise_factor: float = _fixed(
        8.0,
        ge=1.0,
        le=100.0,
        description="smallest force of an impact above the baseline, in standard deviations of the noise",
    )
    longest: float = _fixed(
        1.0, gt=0.0, le=10.0, description="longest impact; a longer force is a sustained contact [s]"
    )
    rebound_time: float = _fixed(
        0.5, ge=0.0, le=60.0, description="a contact that starts within this time of another is its rebound [s]"
    )


class Ni9230Settings(_Group):
    """The converter."""

    channels: tuple[str, ...] = _fixed(
        ("cDAQ1Mod1/ai0",),
        description="physical channels; the first publishes on force, the others below it, as force/ai1",
    )
    sample_rate: float = _fixed(
        12_800.0, gt=0.0, le=1e6, description="requested rate; the device selects the nearest one that it has [Hz]"
    )
    samples: int = _fixed(0, ge=0, description="samples of a finite acquisition, 10000 in the paper; 0: continuous")
    coupling: Coupling = _fixed(Coupling.AC, description="AC or DC")
    current: float = _fixed(0.004, ge=0.0, le=0.02, description="excitation [A]")
    filter_delay_samples: float = _fixed(
        38.0,
        ge=0.0,
        le=1000.0,
        description="delay of the converter's digital filter if the driver does not state it [samples]",
    )
    retry_time: float = _fixed(1.0, gt=0.0, le=60.0, description="pause between attempts to reconnect a device [s]")

    @field_validator("channels")
    @classmethod
    def _check_channels(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        if not names or not all(re.fullmatch(r"[^\s/,:]+/[^\s/,:]+", name) for name in names):
            raise PydanticCustomError("channels", "must be a list of single channels, as cDAQ1Mod1/ai0")
        if len({name.lower() for name in names}) < len(names):
            raise PydanticCustomError("channels", "must name each channel once")
        return names


class BagSettings(_Group):
    """A bag as the source."""

    path: str = _fixed("", description="bag with ForceBlocks: rosbag2 folder, .mcap, .db3 or .bag")
    topic: str = _fixed("", description="topic of the ForceBlocks; empty: the only one")
    rate: float = _fixed(1.0, ge=0.0, le=1e3, description="multiple of the recorded speed; 0: as fast as possible")
    subscriber_timeout: float = _fixed(
        3.0, ge=0.0, le=3600.0, description="how long to wait for a subscriber before playing [s]"
    )
    stamps: Stamps = _fixed(
        Stamps.RECORDED, description="recorded, or now: as if measured now; relative stamps are always now"
    )


class SimSettings(_Group):
    """Simulated force as the source."""

    scene: SimScene = _fixed(
        SimScene.HALF_SINES,
        description=(
            "half_sines: noise and half-sine impacts on all channels; cell: the simulated cell, whose robot "
            "sim_node moves"
        ),
    )
    start: float = _fixed(
        0.0,
        ge=0.0,
        le=1e10,
        description="ROS time at which the cell starts, the same as that of sim_node [s]; 0: now",
    )
    channels: int = _fixed(1, ge=1, le=8, description="number of channels")
    sample_rate: float = _fixed(12_800.0, gt=0.0, le=1e6, description="nominal rate of the simulated converter [Hz]")
    seed: int = _fixed(0, ge=0, description="seed of noise and impacts")
    impact_period: float = _fixed(2.0, ge=0.1, le=3600.0, description="mean time between impacts [s]")
    noise: float = _fixed(0.1, ge=0.0, le=100.0, description="standard deviation of the noise [N]")
    clock_error: float = _fixed(
        20e-6, ge=-1e-3, le=1e-3, description="relative error of the simulated converter's clock"
    )


class DaqSettings(_Group):
    """All settings of `daq_node`. Raises pydantic's ValidationError; see `checked`."""

    source: ForceSourceKind = _fixed(ForceSourceKind.NI9230, description="force source: ni9230, bag or sim")
    frame_id: str = _fixed("force_sensor", description="frame of the sensor; its z axis points along compression")
    block_time: float = _fixed(
        0.1, ge=0.005, le=2.0, description="time between two reads, which is the length of a block [s]"
    )
    backlog: float = _fixed(
        5.0,
        gt=0.0,
        le=600.0,
        description="longest queue of unpublished samples; more are dropped and counted as lost [s]",
    )
    wrench_rate: float = _fixed(100.0, ge=0.0, le=1e4, description="rate of the decimated topic wrench [Hz]; 0: none")
    sensor: SensorSettings = SensorSettings()
    tare: TareSettings = TareSettings()
    filter: FilterSettings = FilterSettings()
    detection: DetectionSettings = DetectionSettings()
    ni9230: Ni9230Settings = Ni9230Settings()
    bag: BagSettings = BagSettings()
    sim: SimSettings = SimSettings()

    @model_validator(mode="before")
    @classmethod
    def _rename_bench(cls, values: Any) -> Any:  # noqa: ANN401 - anything, before it is checked
        """Accept the group `sim` under its former name."""
        if isinstance(values, dict) and "bench" in values and "sim" not in values:
            return {"sim" if name == "bench" else name: value for name, value in values.items()}
        return values

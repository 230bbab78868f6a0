"""Settings of the force measurement: the source, the sensor, what is done with its signal, and what an impact is."""

from __future__ import annotations

import re
from enum import Enum
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator
from pydantic_core import PydanticCustomError

from scara_effmass.settings.loading import READ_ONLY


class ForceSourceKind(str, Enum):
    """Where force comes from."""

    NI9230 = "ni9230"
    BAG = "bag"
    SIM = "sim"

    @classmethod
    def _missing_(cls, value: object) -> ForceSourceKind | None:
        """Accept the former name of `sim`."""
        return cls.SIM if value == "bench" else None


class FilterKind(str, Enum):
    """What low-pass the force goes through; the delay of either is taken off the stamps and published."""

    NONE = "none"
    CAUSAL = "causal"
    """Butterworth, second order: short delay, which depends on the frequency."""
    ZERO_PHASE = "zero_phase"
    """Gaussian FIR: one delay for all frequencies, so nothing is shifted in phase, and no overshoot."""


class Coupling(str, Enum):
    """How the converter is coupled to the sensor."""

    AC = "AC"
    DC = "DC"


class Stamps(str, Enum):
    """When samples of a recording are said to have been taken."""

    RECORDED = "recorded"
    NOW = "now"


class _Group(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class SensorSettings(_Group):
    """The force sensor."""

    sensitivity: float = Field(
        2.248,
        gt=0.0,
        le=1e4,
        description="from the sensor's calibration certificate [mV/N]; the default is the nominal one of a PCB 208C03",
        json_schema_extra=READ_ONLY,
    )
    sensitivity_uncertainty: float = Field(
        0.15,
        ge=0.0,
        le=1.0,
        description="relative uncertainty of the sensitivity; the nominal one of a PCB 208C03 is good to 0.15",
        json_schema_extra=READ_ONLY,
    )
    range: float = Field(
        2224.0,
        gt=0.0,
        le=1e6,
        description="end of the sensor's measuring range, in compression and tension [N]",
        json_schema_extra=READ_ONLY,
    )
    invert: bool = Field(
        default=False, description="the sensor reads compression as negative", json_schema_extra=READ_ONLY
    )


class TareSettings(_Group):
    """What is taken for zero force."""

    at_start: bool = Field(
        default=True, description="take the force during the first tare.time for zero", json_schema_extra=READ_ONLY
    )
    time: float = Field(0.5, gt=0.0, le=60.0, description="how long a tare averages [s]", json_schema_extra=READ_ONLY)
    tolerance: float = Field(
        1.0,
        gt=0.0,
        le=1e6,
        description="a tare is refused when the force moves by more than this meanwhile [N]",
        json_schema_extra=READ_ONLY,
    )


class FilterSettings(_Group):
    """The low-pass."""

    kind: FilterKind = Field(
        FilterKind.NONE, description="low-pass over the force: none, causal or zero_phase", json_schema_extra=READ_ONLY
    )
    cutoff: float = Field(
        2000.0,
        gt=0.0,
        le=1e5,
        description="frequency at which it lets half the power through [Hz]",
        json_schema_extra=READ_ONLY,
    )


class DetectionSettings(_Group):
    """What an impact is."""

    threshold: float = Field(
        5.0,
        gt=0.0,
        le=1e5,
        description="least force above the baseline that is an impact [N]",
        json_schema_extra=READ_ONLY,
    )
    noise_factor: float = Field(
        8.0,
        ge=1.0,
        le=100.0,
        description="least force above the baseline that is an impact, in standard deviations of the noise",
        json_schema_extra=READ_ONLY,
    )
    longest: float = Field(
        1.0,
        gt=0.0,
        le=10.0,
        description="a force that lasts longer is a push, not an impact [s]",
        json_schema_extra=READ_ONLY,
    )
    rebound_time: float = Field(
        0.5,
        ge=0.0,
        le=60.0,
        description="a contact that begins this soon after another one is its rebound [s]",
        json_schema_extra=READ_ONLY,
    )


class Ni9230Settings(_Group):
    """The converter."""

    channels: tuple[str, ...] = Field(
        ("cDAQ1Mod1/ai0",),
        description="physical channels; the first is on the topic force, each other one below it, as force/ai1",
        json_schema_extra=READ_ONLY,
    )
    sample_rate: float = Field(
        12_800.0,
        gt=0.0,
        le=1e6,
        description="asked for; the device chooses the nearest it has, which is then used [Hz]",
        json_schema_extra=READ_ONLY,
    )
    samples: int = Field(
        0,
        ge=0,
        description="finite acquisition of so many, 10000 in the paper; 0: continuous",
        json_schema_extra=READ_ONLY,
    )
    coupling: Coupling = Field(Coupling.AC, description="AC or DC", json_schema_extra=READ_ONLY)
    current: float = Field(0.004, ge=0.0, le=0.02, description="excitation [A]", json_schema_extra=READ_ONLY)
    filter_delay_samples: float = Field(
        38.0,
        ge=0.0,
        le=1000.0,
        description="delay of its digital filter, where the driver does not tell it [samples]",
        json_schema_extra=READ_ONLY,
    )
    retry_time: float = Field(
        1.0,
        gt=0.0,
        le=60.0,
        description="pause before an unplugged device is tried again [s]",
        json_schema_extra=READ_ONLY,
    )

    @field_validator("channels")
    @classmethod
    def _single_channels(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        if not names or not all(re.fullmatch(r"[^\s/,:]+/[^\s/,:]+", name) for name in names):
            raise PydanticCustomError("channels", "single channels, as cDAQ1Mod1/ai0 and cDAQ1Mod1/ai1, would be right")
        if len({name.lower() for name in names}) < len(names):
            raise PydanticCustomError("channels", "each channel only once would be right")
        return names


class BagSettings(_Group):
    """A recording as the source."""

    path: str = Field(
        "", description="recording: rosbag2 folder, .mcap, .db3, .bag, .csv or .tdms", json_schema_extra=READ_ONLY
    )
    topic: str = Field(
        "",
        description="topic, CSV column or TDMS channel of the force; empty: the only one there is",
        json_schema_extra=READ_ONLY,
    )
    axis: str = Field(
        "z",
        pattern="^[xyz]$",
        description="component of a wrench that is the force: x, y or z",
        json_schema_extra=READ_ONLY,
    )
    unit: str = Field(
        "",
        pattern="^(|N|kN|lbf|kgf|V|mV)$",
        description=(
            "of the numbers in the recording: N, kN, lbf, kgf, V or mV; empty: as the recording says, N for messages"
        ),
        json_schema_extra=READ_ONLY,
    )
    time_column: str = Field(
        "", description="CSV column of the times [s]; empty: the first one", json_schema_extra=READ_ONLY
    )
    rate: float = Field(
        1.0, ge=0.0, le=1e3, description="times the original speed; 0: as fast as possible", json_schema_extra=READ_ONLY
    )
    subscriber_timeout: float = Field(
        3.0,
        ge=0.0,
        le=3600.0,
        description="how long to wait for somebody to listen before it begins [s]",
        json_schema_extra=READ_ONLY,
    )
    stamps: Stamps = Field(
        Stamps.RECORDED,
        description="recorded, or now: as if it were measured now; files without absolute time are always now",
        json_schema_extra=READ_ONLY,
    )


class SimScene(str, Enum):
    """What is simulated."""

    HALF_SINES = "half_sines"
    CELL = "cell"


class SimSettings(_Group):
    """Simulated force as the source."""

    scene: SimScene = Field(
        SimScene.HALF_SINES,
        description=(
            "half_sines: noise and half-sine impacts on any number of channels; cell: the simulated cell, "
            "whose robot sim_node moves"
        ),
        json_schema_extra=READ_ONLY,
    )
    start: float = Field(
        0.0,
        ge=0.0,
        le=1e10,
        description="ROS time at which the cell begins, the same as that of sim_node [s]; 0: now",
        json_schema_extra=READ_ONLY,
    )

    channels: int = Field(1, ge=1, le=8, description="number of channels", json_schema_extra=READ_ONLY)
    sample_rate: float = Field(
        12_800.0, gt=0.0, le=1e6, description="nominal, of the simulated converter [Hz]", json_schema_extra=READ_ONLY
    )
    seed: int = Field(0, ge=0, description="of noise and impacts", json_schema_extra=READ_ONLY)
    impact_period: float = Field(
        2.0, ge=0.1, le=3600.0, description="mean time from impact to impact [s]", json_schema_extra=READ_ONLY
    )
    noise: float = Field(
        0.1, ge=0.0, le=100.0, description="standard deviation of the noise [N]", json_schema_extra=READ_ONLY
    )
    clock_error: float = Field(
        20e-6,
        ge=-1e-3,
        le=1e-3,
        description="relative error of the simulated converter's clock",
        json_schema_extra=READ_ONLY,
    )


class DaqSettings(_Group):
    """Everything that can be set on `daq_node`. Raises pydantic's ValidationError; see `checked`."""

    source: ForceSourceKind = Field(
        ForceSourceKind.NI9230, description="where force comes from: ni9230, bag or sim", json_schema_extra=READ_ONLY
    )
    frame_id: str = Field(
        "force_sensor",
        description="frame of the sensor, whose z axis is the direction of compression",
        json_schema_extra=READ_ONLY,
    )
    block_time: float = Field(
        0.1,
        ge=0.005,
        le=2.0,
        description="time between two reads, and thereby the length of a block [s]",
        json_schema_extra=READ_ONLY,
    )
    backlog: float = Field(
        5.0,
        gt=0.0,
        le=600.0,
        description="how much may wait to be published before samples are dropped, and counted as lost [s]",
        json_schema_extra=READ_ONLY,
    )
    wrench_rate: float = Field(
        100.0, ge=0.0, le=1e4, description="of the decimated topic wrench [Hz]; 0: none", json_schema_extra=READ_ONLY
    )
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

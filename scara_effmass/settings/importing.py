"""Settings of the force import."""

from pydantic import BaseModel, ConfigDict, Field

from scara_effmass.settings.daq import SensorSettings


class ImportSettings(BaseModel):
    """Select the force in a file and state what the file does not."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    topic: str = Field("", description="topic, CSV column or TDMS channel of the force; empty: the only one")
    axis: str = Field("z", pattern="^[xyz]$", description="component of a wrench: x, y or z")
    unit: str = Field(
        "",
        pattern="^(|N|kN|lbf|kgf|V|mV)$",
        description="unit of the values: N, kN, lbf, kgf, V or mV; empty: as the file states, N for messages",
    )
    time_column: str = Field("", description="CSV column of the times; empty: the first column")
    frame_id: str = Field("force_sensor", description="frame of the sensor; its z axis points along compression")
    sensor: SensorSettings = Field(SensorSettings(), description="sensor that recorded the file")

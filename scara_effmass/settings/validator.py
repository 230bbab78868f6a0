"""Settings of the validator: matching of impacts and contact states, and the acceptance criterion."""

from pydantic import BaseModel, ConfigDict, Field

from scara_effmass.settings.loading import READ_ONLY
from scara_effmass.settings.monitor import MassModel

MAX_OBSTACLE_MASS = 1000.0
"""Maximum obstacle mass [kg]."""


class CriterionSettings(BaseModel):
    """Acceptance criterion of a series: fixed at start, and published as a hash with every result."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    least_count: int = Field(3, ge=2, description="minimum number of impacts", json_schema_extra=READ_ONLY)
    least_correlation: float = Field(
        0.95,
        ge=-1.0,
        le=1.0,
        description="minimum Pearson correlation of the measured force and speed * sqrt(reduced mass)",
        json_schema_extra=READ_ONLY,
    )
    largest_relative_rmse: float = Field(
        0.1,
        gt=0.0,
        le=10.0,
        description="maximum RMSE of predicted and measured force, relative to the mean measured force",
        json_schema_extra=READ_ONLY,
    )
    shortfall_tolerance: float = Field(
        0.1,
        ge=0.0,
        le=1.0,
        description="tolerated relative shortfall of a prediction below the measured force",
        json_schema_extra=READ_ONLY,
    )
    largest_shortfall_share: float = Field(
        0.05,
        ge=0.0,
        le=1.0,
        description="maximum share of predictions with a larger shortfall",
        json_schema_extra=READ_ONLY,
    )
    least_paired_share: float = Field(
        0.5,
        ge=0.0,
        le=1.0,
        description="minimum share of impacts (without rebounds and invalid ones) matched with the robot state",
        json_schema_extra=READ_ONLY,
    )


class ValidatorSettings(BaseModel):
    """Settings of `validator_node` and `validate`. Raises pydantic's ValidationError; see `checked`."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    contact_point: str = Field(
        "", description="contact point of the impacts; empty: the first one received", json_schema_extra=READ_ONLY
    )
    effective_mass_model: MassModel = Field(
        MassModel.LUMPED,
        description="effective-mass model to accept: lumped, full, iso (M/2 + m_L), or largest of lumped and full",
        json_schema_extra=READ_ONLY,
    )
    obstacle_mass: float = Field(
        0.0,
        ge=0.0,
        le=MAX_OBSTACLE_MASS,
        description="mass of the obstacle, m_H [kg]; 0: unknown, no predictions",
    )
    configuration: str = Field("", description="name of the robot's configuration; results are grouped by it")
    stiffness: float = Field(
        0.0,
        ge=0.0,
        le=1e5,
        description="contact stiffness [N/mm]; 0: fitted to the series, including the current impact",
        json_schema_extra=READ_ONLY,
    )
    state_tolerance: float = Field(
        0.05,
        gt=0.0,
        le=1.0,
        description="maximum time between the onset and the contact states before and after it [s]",
        json_schema_extra=READ_ONLY,
    )
    speed_threshold: float = Field(
        0.005,
        gt=0.0,
        le=1.0,
        description="minimum speed [m/s]; below it the robot stands still and its impacts are rejected",
        json_schema_extra=READ_ONLY,
    )
    slowing: float = Field(
        0.02,
        gt=0.0,
        le=1.0,
        description="relative loss of speed from which a contact state is affected by the impact and is not used",
        json_schema_extra=READ_ONLY,
    )
    clock_uncertainty: float = Field(
        0.001,
        ge=0.0,
        le=0.1,
        description="uncertainty of the stamps of force and joint states, besides the published clock residual [s]",
        json_schema_extra=READ_ONLY,
    )
    clock_tolerance: float = Field(
        0.5,
        gt=0.0,
        le=60.0,
        description="maximum difference of the lags (arrival - stamp) of force and contact states on one clock [s]",
        json_schema_extra=READ_ONLY,
    )
    impact_delay: float = Field(
        1.5,
        ge=0.0,
        le=60.0,
        description="maximum delay between the onset and the report of an impact [s]",
        json_schema_extra=READ_ONLY,
    )
    history: float = Field(
        10.0,
        ge=1.0,
        le=3600.0,
        description="duration for which contact states are kept for late impacts [s]",
        json_schema_extra=READ_ONLY,
    )
    criterion: CriterionSettings = CriterionSettings()

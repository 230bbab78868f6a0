"""Settings of the validator: which contact states belong to an impact, and what a series has to show."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from scara_effmass.settings.loading import READ_ONLY
from scara_effmass.settings.monitor import MassModel

MAX_OBSTACLE_MASS = 1000.0
"""Largest mass of what is hit [kg]."""


class CriterionSettings(BaseModel):
    """When a series is accepted: fixed before it begins, and published as a hash with every result."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    least_count: int = Field(3, ge=2, description="least number of impacts", json_schema_extra=READ_ONLY)
    least_correlation: float = Field(
        0.95,
        ge=-1.0,
        le=1.0,
        description="least Pearson correlation of the measured force and speed * sqrt(reduced mass)",
        json_schema_extra=READ_ONLY,
    )
    largest_relative_rmse: float = Field(
        0.1,
        gt=0.0,
        le=10.0,
        description="largest RMSE of predicted and measured force, relative to the mean measured force",
        json_schema_extra=READ_ONLY,
    )
    shortfall_tolerance: float = Field(
        0.1,
        ge=0.0,
        le=1.0,
        description="by how much a prediction may lie below the measured force, relative to it, before it counts",
        json_schema_extra=READ_ONLY,
    )
    largest_shortfall_share: float = Field(
        0.05,
        ge=0.0,
        le=1.0,
        description="largest share of the impacts whose prediction lies lower than that",
        json_schema_extra=READ_ONLY,
    )
    least_paired_share: float = Field(
        0.5,
        ge=0.0,
        le=1.0,
        description="least share of the impacts (rebounds and spoilt ones aside) that could be paired with the robot",
        json_schema_extra=READ_ONLY,
    )


class ValidatorSettings(BaseModel):
    """Everything that can be set on `validator_node` and on `validate`.

    Raises pydantic's ValidationError; see `checked`.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    contact_point: str = Field(
        "", description="contact point that is hit; empty: the first one that is published", json_schema_extra=READ_ONLY
    )
    effective_mass_model: MassModel = Field(
        MassModel.LUMPED,
        description="the model that is judged: lumped, full, iso (M/2 + m_L), or largest of lumped and full",
        json_schema_extra=READ_ONLY,
    )
    obstacle_mass: float = Field(
        0.0,
        ge=0.0,
        le=MAX_OBSTACLE_MASS,
        description="mass of what is hit, m_H [kg]; 0: not given, then nothing can be predicted",
    )
    configuration: str = Field("", description="name of the robot's configuration, by which results are grouped")
    stiffness: float = Field(
        0.0,
        ge=0.0,
        le=1e5,
        description="contact stiffness [N/mm]; 0: the one that fits the series best, this impact included",
        json_schema_extra=READ_ONLY,
    )
    state_tolerance: float = Field(
        0.05,
        gt=0.0,
        le=1.0,
        description="how far from the onset the contact states before and after it may lie [s]",
        json_schema_extra=READ_ONLY,
    )
    speed_threshold: float = Field(
        0.005,
        gt=0.0,
        le=1.0,
        description="below this speed the robot stands still and no impact of it is predicted [m/s]",
        json_schema_extra=READ_ONLY,
    )
    slowing: float = Field(
        0.02,
        gt=0.0,
        le=1.0,
        description=(
            "a contact state this share slower than the motion before the impact was slowed by it, and is not used"
        ),
        json_schema_extra=READ_ONLY,
    )
    clock_uncertainty: float = Field(
        0.001,
        ge=0.0,
        le=0.1,
        description="what stamps of force and joint states may be off, besides the published clock residual [s]",
        json_schema_extra=READ_ONLY,
    )
    clock_tolerance: float = Field(
        0.5,
        gt=0.0,
        le=60.0,
        description="force and contact states further apart between stamp and arrival are on different clocks [s]",
        json_schema_extra=READ_ONLY,
    )
    impact_delay: float = Field(
        1.5,
        ge=0.0,
        le=60.0,
        description="an impact may be reported this long after its onset [s]",
        json_schema_extra=READ_ONLY,
    )
    history: float = Field(
        10.0,
        ge=1.0,
        le=3600.0,
        description="how long contact states are kept for impacts that arrive late [s]",
        json_schema_extra=READ_ONLY,
    )
    criterion: CriterionSettings = CriterionSettings()

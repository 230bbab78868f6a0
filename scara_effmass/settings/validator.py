# SPDX-License-Identifier: Apache-2.0
"""Settings of the validator: matching of impacts with contact states, and acceptance criterion."""

from pydantic import field_validator

from scara_effmass.settings.loading import FrozenSettings, fixed, tunable
from scara_effmass.settings.monitor import ContactType, MassModel, MonitorSettings, unit_vector
from scara_effmass.values import Vector3

MAX_OBSTACLE_MASS = 1000.0
"""Maximum obstacle mass [kg]."""


class CriterionSettings(FrozenSettings):
    """Acceptance criterion of a series; fixed at the start, and its hash is published with every result."""

    least_count: int = fixed(6, "minimum number of impacts", ge=2)
    mass_tolerance: float = fixed(
        0.1, "tolerated relative error of the robot's masses: their scale and its interval lie within", gt=0.0, le=1.0
    )
    gain_tolerance: float = fixed(
        0.05,
        "tolerated relative error of the force and the speed, where the force states no relative_uncertainty",
        gt=0.0,
        le=1.0,
    )
    largest_scatter: float = fixed(
        0.05, "maximum relative scatter of the impulses about the fit of mass scale and gain", gt=0.0, le=1.0
    )
    contact_exponent: float = fixed(
        1.0, "declared contact law, force ~ depth^n: 1 linear spring, 1.5 Hertz contact", ge=1.0, le=5.0
    )
    largest_clock_offset: float = fixed(
        0.005, "maximum offset between the clocks of force and joint states [s]", gt=0.0, le=0.05
    )
    least_correlation: float = fixed(
        0.95, "minimum Pearson correlation of the measured force and speed * sqrt(reduced mass)", ge=-1.0, le=1.0
    )
    largest_relative_rmse: float = fixed(
        0.1, "maximum RMSE of predicted and measured force, relative to the mean measured force", gt=0.0, le=10.0
    )
    shortfall_tolerance: float = fixed(
        0.1, "tolerated relative shortfall of a prediction below the measured force", ge=0.0, le=1.0
    )
    largest_shortfall_share: float = fixed(0.05, "maximum share of predictions with a larger shortfall", ge=0.0, le=1.0)
    least_paired_share: float = fixed(
        0.5, "minimum share of impacts (without rebounds and invalid ones) matched with the robot state", ge=0.0, le=1.0
    )


class ValidatorSettings(FrozenSettings):
    """Settings of `validator_node` and `validate`."""

    contact_point: str = fixed("", "contact point of the impacts; empty: the first one of a joint state")
    effective_mass_model: MassModel = fixed(
        MassModel.LUMPED,
        "effective-mass model to accept: lumped, full, iso (M/2 + m_L), the largest that exists, or auto: lumped, "
        "but full where the lumped mass is unknown or more than 10 % lighter",
    )
    obstacle_mass: float = tunable(
        0.0, "mass of the obstacle, m_H [kg]; 0: unknown, no predictions", ge=0.0, le=MAX_OBSTACLE_MASS
    )
    obstacle_fixed: bool = fixed(default=False, description="the obstacle cannot move: its mass is infinite")
    configuration: str = tunable("", "name of the robot's configuration; results are grouped by it")
    plate_normal: str = tunable(
        "",
        'normal of the plate, "x y z" in the base frame, if the run information states none; empty: along the motion',
    )
    stiffness_n_m: float = fixed(
        0.0,
        "stiffness of the contact, that is of the measuring device [N/m]; 0: fitted to the series",
        ge=0.0,
        le=1e8,
    )
    body_regions: tuple[str, ...] = fixed(
        (), "body regions with whose limits the forces are compared; empty: every region with a limit for this contact"
    )
    contact: ContactType = fixed(ContactType.TRANSIENT, "transient (free impact) or quasi_static (clamped)")
    contact_area_m2: float = fixed(1e-4, "contact area for the pressure limit [m2]", gt=0.0, le=0.1)
    state_tolerance: float = fixed(
        0.05, "maximum time between the onset and the contact states before and after it [s]", gt=0.0, le=1.0
    )
    speed_threshold: float = fixed(
        0.005, "minimum speed [m/s]; below it the robot stands still and its impacts are rejected", gt=0.0, le=1.0
    )
    slowing: float = fixed(
        0.005,
        "relative loss of speed from which a contact state is affected by the impact and is not used",
        gt=0.0,
        le=1.0,
    )
    clock_uncertainty: float = fixed(
        0.001,
        "uncertainty of the stamps of force and joint states, besides the published clock residual [s]",
        ge=0.0,
        le=0.1,
    )
    clock_tolerance: float = fixed(
        0.5,
        "maximum difference of the lags (arrival - stamp) of force and contact states on one clock [s]",
        gt=0.0,
        le=60.0,
    )
    impact_delay: float = fixed(
        1.5,
        "maximum delay between the onset and the report of an impact, or the end of one that stays [s]",
        ge=0.0,
        le=60.0,
    )
    history: float = fixed(10.0, "duration for which contact states are kept for late impacts [s]", ge=1.0, le=3600.0)
    criterion: CriterionSettings = CriterionSettings()

    @field_validator("plate_normal")
    @classmethod
    def _check_plate_normal(cls, text: str) -> str:
        if text and unit_vector(text) is None:
            raise ValueError('must be empty, or three numbers that are not all 0, such as "1 0 0"')
        return text

    def _needs(self) -> dict[str, tuple[bool, str]]:
        return {"obstacle_mass": (not self.obstacle_fixed, "an obstacle that can move (obstacle_fixed = false)")}

    @property
    def limit_settings(self) -> MonitorSettings:
        """Settings of a monitor with the limits of these body regions."""
        return MonitorSettings(
            body_regions=self.body_regions, contact=self.contact, contact_area_m2=self.contact_area_m2
        )

    @property
    def normal(self) -> Vector3 | None:
        """Unit vector of `plate_normal`, or None."""
        return unit_vector(self.plate_normal)

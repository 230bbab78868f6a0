"""Settings of the monitor."""

import math
from enum import Enum
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, field_validator

from scara_effmass.settings.loading import READ_ONLY
from scara_effmass.share import share
from scara_effmass.values import Vector3


class MassModel(str, Enum):
    """Effective mass behind the verdict."""

    LUMPED = "lumped"
    FULL = "full"
    ISO = "iso"
    LARGEST = "largest"


class ContactType(str, Enum):
    """Free impact, or body part clamped between the robot and a fixed object (ISO/TS 15066, 5.5.5.2)."""

    TRANSIENT = "transient"
    QUASI_STATIC = "quasi_static"


class Drives(str, Enum):
    """Reaction of the drives during a contact: joints free, on a servo whose reference moves on, or immovable."""

    FREE = "free"
    SERVO = "servo"
    IMMOVABLE = "immovable"


Offset = Annotated[float, Field(ge=-10.0, le=10.0)]
Fraction = Annotated[float, Field(ge=0.0, le=1.0)]


class ServoSettings(BaseModel):
    """Position control of the joints, for drives = servo."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    bandwidth: float = Field(5.0, gt=0.0, le=1000.0, description="natural frequency of the position control [Hz]")
    damping: float = Field(0.7, ge=0.05, le=5.0, description="damping ratio of the position control")


class MonitorSettings(BaseModel):
    """Settings of `monitor_node`, `assess` and `replay`, with safe defaults.

    Raises pydantic's ValidationError; `checked` turns it into a one-line SettingsError.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    robot: str = Field(
        "",
        description=(
            "robot file, URDF or DH YAML; empty: the robot_description topic with await_robot_description, else the "
            "shipped Omron i4-550L"
        ),
        json_schema_extra=READ_ONLY,
    )
    await_robot_description: bool = Field(
        default=False,
        description="load the robot from the robot_description topic; UNKNOWN until it arrives",
        json_schema_extra=READ_ONLY,
    )
    contact_points: tuple[str, ...] = Field(
        (),
        description=(
            'points to watch: a link (URDF) or point (DH YAML) by name, or "name=link: x y z", a point in the frame of '
            "a link [m]; empty: all points of a DH file, the tip of the longest chain of a URDF"
        ),
        json_schema_extra=READ_ONLY,
    )
    locked_joints: tuple[str, ...] = Field(
        ("*gripper*", "*finger*"),
        description=("joints, by name or glob pattern, fixed in the model: their mass counts, their motion does not"),
        json_schema_extra=READ_ONLY,
    )
    tool_links: tuple[str, ...] = Field(
        (),
        description="links of the tool, by name or glob pattern: their mass belongs to m_L instead of M (M/2 + m_L)",
        json_schema_extra=READ_ONLY,
    )
    payload_mass: float = Field(
        0.0, ge=0.0, le=1000.0, description="load in addition to the tool and payload of the robot file [kg]"
    )
    payload_com: tuple[Offset, Offset, Offset] = Field(
        (0.0, 0.0, 0.0),
        description="centre of mass of payload_mass in the frame of the first contact point on the last link [m]",
    )
    armature: tuple[str, ...] = Field(
        (),
        description=(
            'rotor and gear inertia reflected to the joints [kg m2, or kg for a sliding one]: "joint=value", '
            '"joint1,joint2=value" where a motor turns with both, or an arm of config/armatures.yaml; '
            "wins over the robot file"
        ),
        json_schema_extra=READ_ONLY,
    )
    effective_mass_model: MassModel = Field(
        MassModel.LUMPED,
        description=("effective mass behind the verdict: lumped, full, iso (M/2 + m_L), or the largest that exists"),
    )
    mass_cap: float = Field(
        1000.0,
        ge=100.0,
        le=1e6,
        description="upper bound of the published effective masses, reached near singular poses [kg]",
    )
    mass_uncertainty: Fraction = Field(0.1, description="relative uncertainty of the effective mass, added to it")
    stiffness_uncertainty: Fraction = Field(
        0.0, description="relative uncertainty of the contact stiffness, added to it"
    )
    speed_uncertainty: float = Field(
        0.0, ge=0.0, le=10.0, description="uncertainty of the measured speed, added to it [m/s]"
    )
    model_margin: Fraction = Field(
        0.1, description=("WARN when the lumped mass is smaller than the full one by more than this fraction")
    )
    speed_threshold: float = Field(
        0.005,
        gt=0.0,
        le=1.0,
        description="speed below which the direction is undefined and the worst one is used [m/s]",
    )
    person_speed: float = Field(0.0, ge=0.0, le=10.0, description="speed of the person towards the robot [m/s]")
    warn_ratio: float = Field(
        0.8, gt=0.0, le=1.0, description="fraction of the allowable speed above which the verdict is WARN"
    )
    reference_speed: float = Field(
        0.0,
        ge=0.0,
        le=100.0,
        description=(
            "speed at speed_scaling = 1 [m/s]; 0: the current speed, which suits a display but not a closed loop"
        ),
    )
    contact_normal: str = Field(
        "worst",
        description=(
            "normal of the surface that is hit: worst (any normal), velocity (the paper), or x y z for a fixed one, "
            'such as "0 0 1" of a table'
        ),
    )
    contact_normal_frame: str = Field(
        "", description="frame of a fixed contact_normal, from the robot description; empty: the base"
    )
    drives: Drives = Field(
        Drives.FREE,
        description="drives during a contact: free (the standard, the paper), servo (they push on), or immovable",
    )
    servo: ServoSettings = ServoSettings()
    external_force_limit: float = Field(
        0.0,
        ge=0.0,
        le=1e5,
        description=(
            "force at which the robot's own monitored safety function stops a quasi-static contact [N]; 0: none, the "
            "effort limits of the joints count"
        ),
    )
    body_regions: tuple[str, ...] = Field(
        (), description=("body regions that the robot can hit; empty: every region with a limit for this contact")
    )
    contact: ContactType = Field(ContactType.TRANSIENT, description="transient (free impact) or quasi_static (clamped)")
    contact_area: float = Field(1.0, gt=0.0, le=1000.0, description="contact area for the pressure limit [cm2]")
    max_force: float = Field(0.0, ge=0.0, description="own force limit, not above the standard's [N]; 0: none")
    max_pressure: float = Field(
        0.0, ge=0.0, description="own pressure limit, not above the standard's [N/cm2]; 0: none"
    )
    obstacle_mass: float = Field(
        0.0, ge=0.0, le=1000.0, description="mass of the body part, not below the standard's [kg]; 0: the standard's"
    )
    stiffness: float = Field(
        0.0, ge=0.0, le=1e4, description="contact stiffness, not below the standard's [N/mm]; 0: the standard's"
    )
    timeout: float = Field(
        0.2,
        gt=0.0,
        le=60.0,
        description="time without a joint state, or age of its stamp, that makes the verdict UNKNOWN [s]",
    )
    future_tolerance: float = Field(
        0.02, ge=0.0, le=10.0, description="maximum time by which a header stamp may lead the node's clock [s]"
    )
    release_time: float = Field(
        0.2, ge=0.0, le=60.0, description="time for which a verdict is held after its cause is gone [s]"
    )
    latch: bool = Field(default=False, description="hold the first VIOLATION or UNKNOWN until ~/reset")
    joint_limit_tolerance: float = Field(
        0.02, ge=0.0, le=1.0, description="tolerance of the joint position limits [rad or m]"
    )
    joint_speed_tolerance: float = Field(
        0.1, ge=0.0, le=10.0, description="relative tolerance of the joint speed limits"
    )
    position_tolerance: float = Field(
        0.01,
        ge=0.0,
        le=1.0,
        description=(
            "tolerance of a joint's displacement against the integral of its velocity, for resolution and noise [rad]; "
            "a quarter of it [m] for a prismatic joint"
        ),
    )
    velocity_tolerance: Fraction = Field(0.01, description="relative tolerance of the joint velocities")
    max_velocity_lag: float = Field(
        0.06,
        ge=0.0,
        le=0.5,
        description="maximum lag of the joint velocities behind the positions; the monitor estimates the lag [s]",
    )
    differentiate_velocity: bool = Field(
        default=False, description="compute an empty velocity from positions and header stamps"
    )

    @field_validator("contact_normal")
    @classmethod
    def _check_contact_normal(cls, text: str) -> str:
        if text not in {"worst", "velocity"} and _vector(text) is None:
            raise ValueError('must be worst, velocity, or three numbers that are not all 0, such as "0 0 1"')
        return text

    @property
    def fixed_normal(self) -> Vector3 | None:
        """Unit vector of a fixed contact normal in `contact_normal_frame`, or None."""
        return _vector(self.contact_normal)

    @property
    def robot_path(self) -> Path:
        """Path of the robot file: `robot`, or the shipped Omron i4-550L where that is empty."""
        return Path(self.robot) if self.robot else share("config", "omron_i4_550l.yaml")


def _vector(text: str) -> Vector3 | None:
    """Return the unit vector along the three numbers in `text`, or None if they give none."""
    try:
        x, y, z = map(float, text.split())
    except ValueError:
        return None
    length = math.hypot(x, y, z)
    return (x / length, y / length, z / length) if 0.0 < length < math.inf else None

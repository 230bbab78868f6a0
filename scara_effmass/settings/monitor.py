# SPDX-License-Identifier: Apache-2.0
"""Settings of the monitor."""

import math
import re
from enum import Enum
from pathlib import Path
from typing import Annotated, NamedTuple

from pydantic import Field, ValidationInfo, field_validator
from typing_extensions import Self

from scara_effmass.codes import Assumption
from scara_effmass.settings.loading import FrozenSettings, checked, fixed, nearest, tunable
from scara_effmass.share import share
from scara_effmass.values import Payload, Vector3

MAX_CONTACT_AREA_M2 = 0.1
"""Largest contact area that can be stated."""


class MassModel(str, Enum):
    """Effective mass on which the verdict is based."""

    LUMPED = "lumped"
    FULL = "full"
    ISO = "iso"
    LARGEST = "largest"
    AUTO = "auto"


class ContactType(str, Enum):
    """Free impact, or a body part clamped between the robot and a fixed object (ISO/TS 15066, 5.5.5.2)."""

    TRANSIENT = "transient"
    QUASI_STATIC = "quasi_static"


class Drives(str, Enum):
    """Reaction of the drives during a contact: free joints, a servo whose reference moves on, or immovable joints."""

    FREE = "free"
    SERVO = "servo"
    IMMOVABLE = "immovable"


class VelocitySource(str, Enum):
    """Source of the joint velocities: as reported, or computed from positions and header stamps."""

    REPORTED = "reported"
    FROM_POSITIONS = "from_positions"


Offset = Annotated[float, Field(ge=-2.0, le=2.0)]
InertiaEntry = Annotated[float, Field(ge=-1e4, le=1e4)]
Component = Annotated[float, Field(ge=-1e6, le=1e6)]
Fraction = Annotated[float, Field(ge=0.0, le=1.0)]


class ServoSettings(FrozenSettings):
    """Position control of the joints, for drives = servo."""

    bandwidth: float = tunable(5.0, "natural frequency of the position control [Hz]", gt=0.0, le=1000.0)
    damping: float = tunable(0.7, "damping ratio of the position control", ge=0.05, le=5.0)
    computed_torque: bool = tunable(
        default=False,
        description="the position control decouples the joints by the mass matrix, up to their effort limits; "
        "false: a controller per joint",
    )
    stopping_time: float = tunable(
        0.5,
        "time for which the reference moves on after the robot clamps a body part, until the robot stops [s]",
        gt=0.0,
        le=10.0,
    )


class LumpingPolicy(str, Enum):
    """Treatment of a link that two masses on its axes cannot reproduce."""

    REFUSE = "refuse"
    PROJECT_COM = "project_com"
    MASS_AT_COM = "mass_at_com"


class FreeParameters(str, Enum):
    """Choice among the pairs of masses that reproduce the mass and centre of mass of a link."""

    MINIMUM_SPREAD = "minimum_spread"
    FIT_INERTIA = "fit_inertia"


class LumpingSettings(FrozenSettings):
    """Lumped model: two masses on the axes of each link."""

    policy: LumpingPolicy = fixed(
        LumpingPolicy.REFUSE,
        "a link that two masses on its axes cannot reproduce: refuse (no lumped model), project_com (move its centre "
        "of mass to where they can), or mass_at_com (its whole mass at its centre of mass)",
    )
    free_parameters: FreeParameters = fixed(
        FreeParameters.MINIMUM_SPREAD,
        "masses where several pairs are possible: minimum_spread (closest to the centre of mass), or fit_inertia "
        "(closest to the inertia tensor)",
    )


SHAPE_SIZES = {"box": 3, "sphere": 1, "cylinder": 2, "capsule": 2}
"""Number of sizes of each shape: edges, or radius and length along z, of a capsule without its caps."""
MAX_SIZE_M = 10.0
"""Largest size and distance of a shape that can be stated."""


class Shape(NamedTuple):
    """Shape of a `kind` of SHAPE_SIZES with its `sizes` and its `centre` [m]."""

    kind: str
    sizes: tuple[float, ...]
    centre: tuple[float, ...]


PAYLOAD_CONTACT, WHOLE_ARM = "payload", "whole_arm"
"""Contact of `payload_shape`, and the contact point that stands for every link with geometry."""


class MonitorSettings(FrozenSettings):
    """Settings of `monitor_node`, `assess` and `replay`, with safe defaults.

    Raises pydantic's ValidationError; `checked` turns it into a one-line SettingsError.
    """

    robot: str = fixed(
        "",
        "robot file, URDF or DH YAML; empty: the robot_description topic with await_robot_description, else the "
        "shipped Omron i4-550L",
    )
    await_robot_description: bool = fixed(
        default=False, description="load the robot from the robot_description topic; UNKNOWN until it arrives"
    )
    contact_points: tuple[str, ...] = fixed(
        (),
        'points to watch: a link (URDF) or point (DH YAML) by name, or "name=link: x y z", a point in the frame '
        "of a link [m]; whole_arm: besides, every link with geometry; empty: all points of a DH file or the tip of the "
        "longest chain of a URDF, and whole_arm, if all meshes are found and contact_normal is worst",
    )
    contact_links: tuple[str, ...] = fixed(
        ("*",),
        "links that whole_arm watches, by name or glob pattern; name all but those that cannot touch a person",
        min_length=1,
    )
    package_dirs: tuple[str, ...] = fixed(
        (), "folders of the packages with the meshes of a URDF, besides those of ROS and those above the file"
    )
    joint_map: tuple[str, ...] = fixed(
        (),
        'names of the robot for those in the joint states: "reported=robot"; * on both sides stands for any text '
        '("left_*=*"); "re:REGEX=NAME" with groups \\1, \\2',
    )
    joint_names: tuple[str, ...] = fixed(
        (), "names of the positions in joint states without names; empty: such joint states give UNKNOWN"
    )
    joint_limits: tuple[str, ...] = fixed(
        (), 'position limits in place of those of the robot file [rad or m]: "joint=lower upper"'
    )
    locked_joints: tuple[str, ...] = fixed(
        (),
        "joints, by name or glob pattern, fixed in the model besides those of grippers: their mass counts; one that "
        "moves gives UNKNOWN",
    )
    ignored_joints: tuple[str, ...] = fixed(
        (),
        "joints of the joint states, by name or glob pattern, whose motion is harmless although the model does not "
        "have them; empty: one that moves gives UNKNOWN",
    )
    tool_links: tuple[str, ...] = fixed(
        (), "links of the tool, by name or glob pattern: their mass belongs to m_L instead of M (M/2 + m_L)"
    )
    moving_mass: float = fixed(
        0.0,
        "mass of all moving links, from the data sheet, in place of the masses in the robot file: ISO's mass M/2 + m_L "
        "decides [kg]; 0: the masses in the file",
        ge=0.0,
        le=10000.0,
    )
    payload_mass: float = tunable(
        0.0, "load in addition to the tool and payload of the robot file [kg]", ge=0.0, le=1000.0
    )
    payload_com: tuple[Offset, Offset, Offset] = tunable(
        (0.0, 0.0, 0.0), "centre of mass of payload_mass in the frame of the first contact point on the last link [m]"
    )
    payload_inertia: tuple[InertiaEntry, InertiaEntry, InertiaEntry, InertiaEntry, InertiaEntry, InertiaEntry] = (
        tunable(
            (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
            "inertia of payload_mass about its centre of mass, in the axes of payload_com, as ixx, iyy, izz, ixy, ixz, "
            "iyz [kg m2]; all 0: a point mass",
        )
    )
    payload_shape: tuple[str, ...] = fixed(
        (),
        "shapes around tool and payload in the frame of payload_com [m], watched as one link: box X Y Z, sphere "
        'RADIUS, cylinder or capsule RADIUS LENGTH along z, with a centre: "box 0.1 0.1 0.2 at 0 0 0.1"',
    )
    payload_topic: str = fixed(
        "",
        "latched topic of the payload (geometry_msgs/Inertia), in place of payload_mass, payload_com and "
        "payload_inertia: UNKNOWN without exactly one publisher and its valid message; empty: none",
    )
    armature: tuple[str, ...] = fixed(
        (),
        'rotor and gear inertia reflected to the joints [kg m2, or kg for a sliding one]: "joint=value", '
        '"joint1,joint2=value" where a motor turns with both, or an arm of config/armatures.yaml; wins over the '
        "robot file",
    )
    effective_mass_model: MassModel = tunable(
        MassModel.AUTO,
        "effective mass behind the verdict: lumped, full, iso (M/2 + m_L), the largest that exists, or auto: lumped "
        "where it exists and model_margin holds in every direction, else full; without inertia tensors lumped of a "
        "SCARA, the heavier of lumped and iso of another arm",
    )
    lumping: LumpingSettings = LumpingSettings()
    effort_uncertainty: Fraction = fixed(
        0.03,
        "relative standard deviation of the effort in joint states from the joint torque (errors of torque constants); "
        "0: no load is estimated from it",
    )
    link_uncertainty: Fraction = fixed(
        0.0,
        "relative standard deviation of mass and inertia of each link from the robot file, where the load is "
        "estimated; 0: they are known",
    )
    torque_constants: tuple[str, ...] = fixed(
        (),
        'torque per unit of effort, "joint=value", where the driver reports a motor current [N m/A, N/A]; by default '
        "torque_constant of a DH file, or 1",
    )
    mass_cap: float = tunable(
        1000.0, "upper bound of the published effective masses, reached near singular poses [kg]", ge=100.0, le=1e6
    )
    mass_uncertainty: Fraction = tunable(0.1, "relative uncertainty of the effective mass, added to it")
    stiffness_uncertainty: Fraction = tunable(0.0, "relative uncertainty of the contact stiffness, added to it")
    speed_uncertainty: float = tunable(0.0, "uncertainty of the measured speed, added to it [m/s]", ge=0.0, le=10.0)
    model_margin: Fraction = tunable(
        0.1, "fraction by which the lumped mass may be below the full one: beyond it WARN, and auto takes full"
    )
    speed_threshold: float = tunable(
        0.005, "speed below which the direction is undefined and the worst one is used [m/s]", gt=0.0, le=0.02
    )
    max_acceleration: float = tunable(
        0.0,
        "largest acceleration of the contact points that the controller may reach during a contact [m/s2]; 0: none "
        "beyond that of the joint states",
        ge=0.0,
        le=1000.0,
    )
    max_joint_acceleration: tuple[str, ...] = fixed(
        (),
        'largest accelerations that the controller may reach during a contact [rad/s2 or m/s2]: "joint=value", or a '
        "joint limits file as MoveIt writes it; of every joint",
    )
    reaction_time: float = tunable(
        0.0,
        "time from a joint state to the robot's reaction to its verdict, for which the acceleration goes on [s]",
        ge=0.0,
        le=10.0,
    )
    person_speed: float = tunable(
        0.0,
        "largest speed of the person, in any direction [m/s]: 1.6 for walking, 2.0 for reaching (ISO 13855)",
        ge=0.0,
        le=10.0,
    )
    person_direction: tuple[Component, Component, Component] = tunable(
        (0.0, 0.0, 0.0),
        "direction from the robot to the person, who moves against it and in no other; 0 0 0: any direction",
    )
    person_direction_frame: str = tunable("", "frame of person_direction, from the robot description; empty: the base")
    warn_ratio: float = tunable(0.8, "fraction of the allowable speed above which the verdict is WARN", gt=0.0, le=1.0)
    reference_speed: float = tunable(
        0.0,
        "speed at speed_scaling = 1 [m/s]; 0: the current speed, which suits a display but not a closed loop",
        ge=0.0,
        le=100.0,
    )
    contact_normal: str = tunable(
        "worst",
        "normal of the surface that is hit: worst (any normal), velocity (the paper), or x y z for a fixed one, "
        'such as "0 0 1" of a table',
    )
    contact_normal_frame: str = tunable(
        "", "frame of a fixed contact_normal, from the robot description; empty: the base"
    )
    test_direction: tuple[Component, Component, Component] = tunable(
        (0.0, 0.0, 0.0), "direction along which the effective mass is also published, as of a press test; 0 0 0: none"
    )
    test_direction_frame: str = tunable("", "frame of test_direction, from the robot description; empty: the base")
    drives: Drives = tunable(
        Drives.SERVO,
        "drives during a contact: servo (position control pushes on, as in most arms), free (joints that yield; the "
        "standard, the paper), or immovable",
    )
    servo: ServoSettings = ServoSettings()
    external_force_limit: float = tunable(
        0.0,
        "force at which the robot's own monitored safety function stops a quasi-static contact [N]; 0: none, the "
        "effort limits of the joints count",
        ge=0.0,
        le=1e5,
    )
    body_regions: tuple[str, ...] = tunable(
        (), "body regions that the robot can hit; empty: every region with a limit for this contact"
    )
    contact: ContactType = tunable(ContactType.TRANSIENT, "transient (free impact) or quasi_static (clamped)")
    contact_area_m2: float = tunable(1e-4, "contact area for the pressure limit [m2]", gt=0.0, le=MAX_CONTACT_AREA_M2)
    contact_areas: tuple[str, ...] = tunable(
        (),
        '"contact=area" [m2] in place of contact_area_m2 for a contact point or link, by name or glob pattern: the '
        "first that matches counts",
    )
    contact_damping: float = tunable(
        0.0,
        "damping ratio of the contact (Kelvin-Voigt), which can raise the peak force; 0: an elastic one",
        ge=0.0,
        le=2.0,
    )
    contact_friction: float = tunable(
        0.0,
        "friction coefficient of the contact, which raises the total force; 0: along the normal alone",
        ge=0.0,
        le=2.0,
    )
    max_force: float = tunable(0.0, "own force limit, not above the standard's [N]; 0: none", ge=0.0)
    max_pressure_pa: float = tunable(0.0, "own pressure limit, not above the standard's [Pa]; 0: none", ge=0.0, le=1e8)
    body_mass: float = tunable(
        0.0, "mass of the body part, not below the standard's [kg]; 0: the standard's", ge=0.0, le=1000.0
    )
    stiffness_n_m: float = tunable(
        0.0, "contact stiffness, not below the standard's [N/m]; 0: the standard's", ge=0.0, le=1e7
    )
    timeout: float = tunable(
        0.2, "time without a joint state, or age of its stamp, that makes the verdict UNKNOWN [s]", gt=0.0, le=60.0
    )
    future_tolerance: float = tunable(
        0.02,
        "maximum time by which a header stamp may lead the node's clock [s]; with use_sim_time besides the step of "
        "/clock, of which at most half the timeout counts",
        ge=0.0,
        le=10.0,
    )
    release_time: float = tunable(0.2, "time for which a verdict is held after its cause is gone [s]", ge=0.0, le=60.0)
    latch: bool = tunable(default=False, description="hold the first VIOLATION or UNKNOWN until ~/reset")
    joint_limit_tolerance: float = tunable(0.02, "tolerance of the joint position limits [rad or m]", ge=0.0, le=1.0)
    joint_speed_tolerance: float = tunable(0.1, "relative tolerance of the joint speed limits", ge=0.0, le=10.0)
    position_tolerance: float = tunable(
        0.01,
        "tolerance of a joint's displacement against the integral of its velocity, for resolution and noise "
        "[rad]; a quarter of it [m] for a prismatic joint",
        ge=0.0,
        le=1.0,
    )
    velocity_tolerance: Fraction = tunable(0.01, "relative tolerance of the joint velocities")
    max_velocity_lag: float = tunable(
        0.06,
        "maximum lag of the joint velocities behind the positions; the monitor estimates the lag [s]",
        ge=0.0,
        le=0.5,
    )
    velocity_source: VelocitySource = tunable(
        VelocitySource.REPORTED, "joint velocities: reported, or from_positions (and header stamps)"
    )
    velocity_window: float = tunable(
        0.0,
        "window of the velocity filter, which delays the velocity by half of it [s]: mean of the reported ones, or "
        "slope of a line through the positions; 0: none, or the last two positions",
        ge=0.0,
        le=1.0,
    )

    accept_assumptions: tuple[str, ...] = tunable(
        (),
        "assumptions, by name, that need not be stated for an OK: "
        + ", ".join(assumption.name.lower() for assumption in Assumption),
    )

    @field_validator("accept_assumptions")
    @classmethod
    def _check_accepted(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        known = [assumption.name.lower() for assumption in Assumption]
        for name in names:
            if name not in known:
                raise ValueError(f"{name!r}: {nearest(name, known)}")
        return names

    @field_validator("velocity_window")
    @classmethod
    def _check_window(cls, window_s: float, info: ValidationInfo) -> float:
        max_lag_s = info.data.get("max_velocity_lag", window_s)
        if window_s > max_lag_s:  # half of the lag is left to the driver
            raise ValueError(f"must be at most max_velocity_lag = {max_lag_s} s")
        return window_s

    @field_validator("joint_map", "joint_limits", "contact_areas", "payload_shape")
    @classmethod
    def _check_entries(cls, entries: tuple[str, ...], info: ValidationInfo) -> tuple[str, ...]:
        parsers = {"joint_map": _renames, "joint_limits": _limits, "contact_areas": _areas, "payload_shape": _shapes}
        parsers[str(info.field_name)](entries)
        return entries

    @field_validator("payload_topic")
    @classmethod
    def _check_payload_topic(cls, topic: str, info: ValidationInfo) -> str:
        for name in ("payload_mass", "payload_com", "payload_inertia"):
            unset = cls.model_fields[name].default
            if topic and info.data.get(name, unset) != unset:
                raise ValueError(f"must be empty with {name} = {info.data[name]}")
        return topic

    @field_validator("contact_normal")
    @classmethod
    def _check_contact_normal(cls, text: str, info: ValidationInfo) -> str:
        if text not in {"worst", "velocity"} and unit_vector(text) is None:
            raise ValueError('must be worst, velocity, or three numbers that are not all 0, such as "0 0 1"')
        shapes = info.data.get("payload_shape", ())
        if text != "worst" and (shapes or WHOLE_ARM in info.data.get("contact_points", ())):
            whole = f"payload_shape = {', '.join(shapes)}" if shapes else f"contact_points = {WHOLE_ARM}"
            raise ValueError(f"must be worst with {whole}: no bound holds for a known one")
        return text

    @field_validator("contact_friction")
    @classmethod
    def _check_friction(cls, friction: float, info: ValidationInfo) -> float:
        if friction > 0.0 and info.data.get("contact_normal", "worst") != "worst":
            raise ValueError("must be 0 unless contact_normal is worst: no bound holds for a known one")
        return friction

    def _needs(self) -> dict[str, tuple[bool, str]]:
        is_servo, is_clamped = self.drives is Drives.SERVO, self.contact is ContactType.QUASI_STATIC
        whole_arm = not self.contact_points or WHOLE_ARM in self.contact_points
        return {
            "contact_links": (whole_arm, f"{WHOLE_ARM} among contact_points"),
            "payload_com": (self.payload_mass > 0.0, "payload_mass"),
            "link_uncertainty": (self.effort_uncertainty > 0.0, "effort_uncertainty"),
            "person_direction": (self.person_speed > 0.0, "person_speed"),
            "person_direction_frame": (self.fixed_person_direction is not None, "person_direction"),
            "contact_normal_frame": (self.fixed_normal is not None, "a fixed contact_normal"),
            "test_direction_frame": (self.fixed_test_direction is not None, "test_direction"),
            "servo.bandwidth": (is_servo, "drives = servo"),
            "servo.damping": (is_servo, "drives = servo"),
            "servo.computed_torque": (is_servo, "drives = servo"),
            "servo.stopping_time": (
                is_clamped and self.drives is not Drives.FREE,
                "contact = quasi_static, and drives = servo or immovable",
            ),
            "external_force_limit": (is_clamped, "contact = quasi_static"),
        }

    @property
    def filters_velocity(self) -> bool:
        """Whether velocities are filtered or computed from positions, and so depend on earlier joint states."""
        return self.velocity_source is VelocitySource.FROM_POSITIONS or self.velocity_window > 0.0

    @property
    def fixed_normal(self) -> Vector3 | None:
        """Unit vector of a fixed contact normal in `contact_normal_frame`, or None."""
        return unit_vector(self.contact_normal)

    @property
    def fixed_test_direction(self) -> Vector3 | None:
        """Unit vector of `test_direction` in `test_direction_frame`, or None."""
        return _normalized(*self.test_direction)

    @property
    def fixed_person_direction(self) -> Vector3 | None:
        """Unit vector of `person_direction` in `person_direction_frame`, or None."""
        return _normalized(*self.person_direction)

    @property
    def counts_person_velocity(self) -> bool:
        """Whether the velocity of the person counts as a vector; for a known contact normal only a part of it does."""
        return self.person_speed > 0.0 and self.contact_normal == "worst"

    @property
    def payload(self) -> Payload:
        """Payload stated in the settings."""
        return Payload(self.payload_mass, self.payload_com, self.payload_inertia)

    def with_payload(self, payload: Payload) -> Self:
        """Return these settings with a `payload` from `payload_topic`. Raises SettingsError if it is out of range."""
        values = {f"payload_{name}": value for name, value in payload._asdict().items()}
        checked(MonitorSettings, values, self.payload_topic)
        return self.model_copy(update=values)

    @property
    def joint_renames(self) -> list[tuple[re.Pattern[str], str]]:
        """Pattern of the reported name, and template of the robot's name, for each entry of `joint_map`."""
        return _renames(self.joint_map)

    @property
    def payload_shapes(self) -> list[Shape]:
        """Each entry of `payload_shape`."""
        return _shapes(self.payload_shape)

    @property
    def stated_areas(self) -> dict[str, float]:
        """Contact area [m2] by glob pattern of the contact, of each entry of `contact_areas`."""
        return _areas(self.contact_areas)

    @property
    def position_limits(self) -> dict[str, tuple[float, float]]:
        """Lower and upper limit [rad or m] of the joints in `joint_limits`."""
        return _limits(self.joint_limits)

    @property
    def robot_path(self) -> Path:
        """Path of the robot file: `robot`, or the shipped Omron i4-550L if that is empty."""
        return Path(self.robot) if self.robot else share("config", "omron_i4_550l.yaml")


def _renames(entries: tuple[str, ...]) -> list[tuple[re.Pattern[str], str]]:
    renames = []
    for entry in entries:
        reported, _, name = entry.rpartition("=")
        is_regex = reported.startswith("re:")
        if not reported or not name or (not is_regex and max(reported.count("*"), name.count("*")) > 1):
            raise ValueError(f'{entry!r}: must be "reported=robot", "left_*=*" or "re:REGEX=NAME"')
        if not is_regex:
            reported, name = re.escape(reported).replace(r"\*", "(.*)"), name.replace("*", r"\1")
        try:
            pattern = re.compile(reported.removeprefix("re:"))
            re.sub(pattern, name, "")
        except (re.error, IndexError) as error:
            raise ValueError(f"{entry!r}: {error}: must be a regular expression and a name") from None
        renames.append((pattern, name))
    return renames


def _limits(entries: tuple[str, ...]) -> dict[str, tuple[float, float]]:
    limits: dict[str, tuple[float, float]] = {}
    for entry in entries:
        joint, _, numbers = entry.partition("=")
        joint = joint.strip()
        if joint in limits:
            raise ValueError(f"{entry!r}: must state the limits of {joint} once")
        try:
            lower, upper = map(float, numbers.split())
        except ValueError:
            lower = upper = 0.0
        if not joint or not -math.inf < lower < upper < math.inf:
            raise ValueError(f'{entry!r}: must be "joint=lower upper" with lower < upper')
        limits[joint] = lower, upper
    return limits


def _shapes(entries: tuple[str, ...]) -> list[Shape]:
    shapes = []
    for entry in entries:
        kind, _, rest = entry.strip().partition(" ")
        sizes, _, centre = rest.partition(" at ")
        try:
            shape = Shape(kind, _numbers(sizes), _numbers(centre or "0 0 0"))
        except ValueError:
            shape = Shape(kind, (), ())
        is_in_range = all(0.0 < size <= MAX_SIZE_M for size in shape.sizes)
        is_in_range &= all(abs(distance) <= MAX_SIZE_M for distance in shape.centre)
        if not is_in_range or len(shape.sizes) != SHAPE_SIZES.get(kind) or len(shape.centre) != len("xyz"):
            raise ValueError(
                f"{entry!r}: must be box X Y Z, sphere RADIUS, cylinder RADIUS LENGTH or capsule RADIUS LENGTH, then "
                f"at X Y Z or nothing; sizes above 0, all numbers at most {MAX_SIZE_M:g} m"
            )
        shapes.append(shape)
    return shapes


def _numbers(text: str) -> tuple[float, ...]:
    return tuple(map(float, text.split()))


def _areas(entries: tuple[str, ...]) -> dict[str, float]:
    areas: dict[str, float] = {}
    for entry in entries:
        contact, _, text = (part.strip() for part in entry.rpartition("="))
        try:
            area = float(text)
        except ValueError:
            area = 0.0
        if not contact or not 0.0 < area <= MAX_CONTACT_AREA_M2:
            raise ValueError(f'{entry!r}: must be "contact=area", above 0 and at most {MAX_CONTACT_AREA_M2:g} m2')
        if contact in areas:
            raise ValueError(f"{entry!r}: must state the area of {contact} once")
        areas[contact] = area
    return areas


def unit_vector(text: str) -> Vector3 | None:
    """Return the unit vector along the three numbers in `text`, or None if there is none."""
    try:
        x, y, z = map(float, text.split())
    except ValueError:
        return None
    return _normalized(x, y, z)


def _normalized(x: float, y: float, z: float) -> Vector3 | None:
    length = math.hypot(x, y, z)
    return (x / length, y / length, z / length) if 0.0 < length < math.inf else None

"""Parameters of one impact in the paper's experiment: configuration, cart, tip, speed, controller and force sensor."""

import math
from dataclasses import dataclass

from scara_effmass.errors import SettingsError
from scara_effmass.sim.adc import FORCE_SENSOR, ForceSensor
from scara_effmass.sim.cart import Cart
from scara_effmass.sim.controller import DEFAULT_GAINS, ServoGains
from scara_effmass.sim.motion import (
    JointPositions,
    LinearMove,
    Move,
    QuinticScaling,
    TrapezoidalScaling,
    joint_positions_at,
)
from scara_effmass.sim.recordings import EPOCH_NS
from scara_effmass.sim.scara_kinematics import ElbowConfig
from scara_effmass.sim.spring_contact import POLYETHYLENE, SpringContact
from scara_effmass.values import Vector3

PATH_M = 0.2
ACCELERATION = 2.5
"""On the path [m/s2]; length and acceleration are chosen here, as in the reference recordings."""
Q3 = 0.236
"""From the paper [m]."""
DWELL_S = 0.3


@dataclass(frozen=True, slots=True)
class Configuration:
    """Impact point, elbow configuration and path direction."""

    name: str
    point: tuple[float, float]
    """x, y of the impact [m]"""
    elbow_config: ElbowConfig = ElbowConfig.RIGHT
    heading: float = 0.0
    """of the path, from the x axis [rad]"""

    @property
    def direction(self) -> Vector3:
        """Unit vector along the path."""
        return (math.cos(self.heading), math.sin(self.heading), 0.0)

    def path_point(self, distance: float) -> tuple[float, float]:
        """Return x, y [m] of the path `distance` [m] behind the impact point."""
        x, y, _ = self.direction
        return self.point[0] + distance * x, self.point[1] + distance * y

    def path(self, speed: float) -> LinearMove:
        """Return the path at `speed` [m/s], with the impact in its middle."""
        start, end = self.path_point(-PATH_M / 2.0), self.path_point(PATH_M / 2.0)
        time_scaling = TrapezoidalScaling(length=PATH_M, speed=speed, acceleration=ACCELERATION)
        return LinearMove(start, end, self.elbow_config, Q3, time_scaling)

    def dwell(self, distance: float, seconds: float) -> LinearMove:
        """Return a dwell at the path point `distance` [m] behind the impact point."""
        point = self.path_point(distance)
        return LinearMove(point, point, self.elbow_config, Q3, QuinticScaling(seconds))

    @property
    def joint_positions(self) -> JointPositions:
        """Joint positions at the impact."""
        return joint_positions_at(self.point, self.elbow_config, Q3)


CONFIGURATIONS = (
    Configuration("300_200", (0.3, 0.2)),
    Configuration("300_0", (0.3, 0.0)),
    Configuration("300_-200", (0.3, -0.2)),
)
"""From light to heavy. Only (300, 200) mm is in the text of the paper; the other two are chosen here."""
OBSTACLE_MASSES = (0.50, 2.39, 3.72, 7.35)
"""Masses of the paper's cart [kg]."""


@dataclass(frozen=True, slots=True)
class ImpactSetup:
    """All parameters of one run. Raises SettingsError for a speed that the path is too short for."""

    configuration: Configuration
    obstacle_mass: float
    speed: float = 0.25
    """[m/s]"""
    contact: SpringContact = POLYETHYLENE
    servo: ServoGains = DEFAULT_GAINS
    sensor: ForceSensor = FORCE_SENSOR
    offset: float = 0.0
    """of the tip, along the path behind the impact point [m]"""
    dwell: float = DWELL_S
    """before and after the path [s]"""
    tip_mass: float = 0.0
    """in front of the force cell [kg]"""
    guide_friction: float = 0.5
    """[N]"""
    surface: Vector3 | None = None
    """unit normal of the plate; None: along the path"""
    seed: int = 0
    """of encoder noise and stamps; the sensor has its own"""
    start_ns: int = EPOCH_NS

    def __post_init__(self) -> None:
        max_speed = math.sqrt(PATH_M * ACCELERATION)
        if not 0.0 < self.speed < max_speed:
            raise SettingsError(f"speed = {self.speed}: must be > 0 and < {max_speed:.3f} m/s")

    @property
    def cart(self) -> Cart:
        """The cart at rest."""
        return Cart(
            tip=(*self.configuration.path_point(self.offset), -Q3),
            direction=self.configuration.direction,
            mass=self.obstacle_mass,
            tip_mass=self.tip_mass,
            surface=self.surface,
            guide_friction=self.guide_friction,
        )

    @property
    def impact_position(self) -> Vector3:
        """Nominal point of impact in the base frame [m]."""
        return (*self.configuration.point, -Q3)

    @property
    def plate_normal(self) -> Vector3:
        """Unit normal of the struck plate in the base frame, away from the robot."""
        return self.configuration.direction if self.surface is None else self.surface

    @property
    def moves(self) -> tuple[Move, ...]:
        """Dwell, path, dwell."""
        half, configuration = PATH_M / 2.0, self.configuration
        return (
            configuration.dwell(-half, self.dwell),
            configuration.path(self.speed),
            configuration.dwell(half, self.dwell),
        )

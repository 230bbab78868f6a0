"""What is varied in the paper's experiment: the configuration, the cart, the tip, the speed, and what measures."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from scara_effmass.errors import SettingsError
from scara_effmass.sim.cart import Cart
from scara_effmass.sim.converter import FORCE_SENSOR
from scara_effmass.sim.drive import SERVO
from scara_effmass.sim.motion import LineMove, Quintic, Trapezoid, pose_at
from scara_effmass.sim.recordings import EPOCH_NS
from scara_effmass.sim.scara_kinematics import ElbowConfig
from scara_effmass.sim.spring_contact import POLYETHYLENE

if TYPE_CHECKING:
    from scara_effmass.sim.converter import ForceSensor
    from scara_effmass.sim.drive import Servo
    from scara_effmass.sim.motion import Move, Pose
    from scara_effmass.sim.spring_contact import SpringContact
    from scara_effmass.values import Vector3

PATH_M = 0.2
ACCELERATION = 2.5
"""Of the path [m/s2]; length and acceleration are choices, as in the reference recordings."""
Q3 = 0.236
"""From the paper [m]."""
REST_S = 0.3


@dataclass(frozen=True, slots=True)
class Configuration:
    """Where the robot is hit, and how it gets there."""

    name: str
    point: tuple[float, float]
    """of the impact: x, y [m]"""
    arm: ElbowConfig = ElbowConfig.RIGHT
    heading: float = 0.0
    """of the path, from the x axis [rad]"""

    @property
    def direction(self) -> Vector3:
        """Unit vector along the path."""
        return (math.cos(self.heading), math.sin(self.heading), 0.0)

    def along(self, distance: float) -> tuple[float, float]:
        """Return x, y [m] of the point of the path so far behind that of the impact [m]."""
        x, y, _ = self.direction
        return self.point[0] + distance * x, self.point[1] + distance * y

    def line(self, speed: float) -> LineMove:
        """Return the path at `speed` [m/s], with the impact in its middle."""
        law = Trapezoid(length=PATH_M, speed=speed, acceleration=ACCELERATION)
        return LineMove(self.along(-PATH_M / 2.0), self.along(PATH_M / 2.0), self.arm, Q3, law)

    def rest(self, distance: float, seconds: float) -> LineMove:
        """Return a rest at the point of the path `distance` [m] behind that of the impact."""
        return LineMove(self.along(distance), self.along(distance), self.arm, Q3, Quintic(seconds))

    @property
    def pose(self) -> Pose:
        """Of the robot at the impact."""
        return pose_at(self.point, self.arm, Q3)


CONFIGURATIONS = (
    Configuration("300_200", (0.3, 0.2)),
    Configuration("300_0", (0.3, 0.0)),
    Configuration("300_-200", (0.3, -0.2)),
)
"""The paper's table of its three points is lost but for (300, 200) mm; these span the range, light to heavy."""
OBSTACLE_MASSES = (0.50, 2.39, 3.72, 7.35)
"""Of the paper's cart [kg]."""


@dataclass(frozen=True, slots=True)
class ImpactSetup:
    """One run: everything that decides about it. Raises SettingsError for a speed that the path is too short for."""

    configuration: Configuration
    obstacle_mass: float
    speed: float = 0.25
    """[m/s]"""
    contact: SpringContact = POLYETHYLENE
    servo: Servo = SERVO
    sensor: ForceSensor = FORCE_SENSOR
    offset: float = 0.0
    """of the tip, along the path behind the point of impact [m]"""
    rest: float = REST_S
    """before and after the path [s]"""
    tip_mass: float = 0.0
    """of the cart's, before the force cell [kg]"""
    guide_friction: float = 0.5
    """[N]"""
    surface: Vector3 | None = None
    """unit normal of the plate, where it is not along the path"""
    seed: int = 0
    """of encoders and stamps; the sensor has its own"""
    start_ns: int = EPOCH_NS

    def __post_init__(self) -> None:
        fastest = math.sqrt(PATH_M * ACCELERATION)
        if not 0.0 < self.speed < fastest:
            raise SettingsError(f"speed = {self.speed}: more than 0 and less than {fastest:.3f} m/s would be right")

    @property
    def cart(self) -> Cart:
        """The cart as it waits."""
        return Cart(
            tip=(*self.configuration.along(self.offset), -Q3),
            direction=self.configuration.direction,
            mass=self.obstacle_mass,
            tip_mass=self.tip_mass,
            surface=self.surface,
            guide_friction=self.guide_friction,
        )

    @property
    def moves(self) -> tuple[Move, ...]:
        """Rest, path, rest."""
        half = PATH_M / 2.0
        where = self.configuration
        return where.rest(-half, self.rest), where.line(self.speed), where.rest(half, self.rest)

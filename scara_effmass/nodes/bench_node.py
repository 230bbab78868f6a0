"""`bench_node`: the robot of the virtual test bench, live; `daq_node`, source bench, scene cell, has its force."""

from __future__ import annotations

import json
from array import array
from collections import deque
from typing import TYPE_CHECKING

from pydantic import BaseModel, ConfigDict, Field
from rclpy.clock import Clock, ClockType
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from scara_effmass.bag_io.definitions import RECORDING_INFO
from scara_effmass.bench.live import LiveBench, LiveSettings
from scara_effmass.nodes import parameters
from scara_effmass.nodes.running import SuiteNode, run
from scara_effmass.settings import READ_ONLY, checked

if TYPE_CHECKING:
    from collections.abc import Sequence

    from scara_effmass import values
    from scara_effmass.bench.live import PlacedCart

_NS = 1_000_000_000
_MS = 1_000_000
_PERIOD_S = 0.001
_AHEAD_NS = 20 * _MS
"""So far the cell is computed ahead of time, so that its impacts, which take longer, hold nothing up."""
_STATES_QOS = QoSProfile(reliability=ReliabilityPolicy.RELIABLE, history=HistoryPolicy.KEEP_LAST, depth=1000)
_INFO_QOS = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class NodeSettings(BaseModel):
    """What makes a cell the same as that of the force node."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    autostart: bool = Field(default=True, description="configure and activate at start", json_schema_extra=READ_ONLY)
    start: float = Field(
        0.0,
        ge=0.0,
        le=1e10,
        description="ROS time at which the cell begins, the same as bench.start of daq_node [s]; 0: now",
        json_schema_extra=READ_ONLY,
    )
    seed: int = Field(0, ge=0, description="the same as bench.seed of daq_node", json_schema_extra=READ_ONLY)


class BenchNode(SuiteNode):
    """Publishes `joint_states` at 1 kHz, and says on `recording_info` which cart waits, and that all is simulated."""

    def __init__(self) -> None:
        """Declare the parameters. Raises SettingsError for one that cannot be used."""
        super().__init__("bench")
        self._settings = checked(NodeSettings, parameters.declare(self, NodeSettings), self.get_name())
        self.autostart = self._settings.autostart
        self._states: deque[values.JointState] = deque()
        self._carts: deque[PlacedCart] = deque()

    def set_up(self) -> None:
        """Create the endpoints."""
        warn = self.get_logger().warning
        self._joint_states = self.publisher(JointState, "joint_states", _STATES_QOS, warn)
        self._info = self.publisher(String, RECORDING_INFO, _INFO_QOS, warn)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.keep(self.create_timer(_PERIOD_S, self._publish_what_is_due, clock=steady), self.destroy_timer)

    def start(self) -> None:
        """Put the robot at its start."""
        start_ns = round(self._settings.start * 1e3) * _MS or self._now_ns()
        self._bench = LiveBench(LiveSettings(seed=self._settings.seed), start_ns)
        self._states.clear()
        self._carts.clear()

    def _now_ns(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def _publish_what_is_due(self) -> None:
        if not self.active:
            return
        now_ns = self._now_ns()
        output = self._bench.advance_to(now_ns + _AHEAD_NS)
        self._states += output.joint_states
        self._carts += output.carts
        while self._carts and self._carts[0].stamp_ns <= now_ns:
            self._info.publish(String(data=json.dumps(_about(self._carts.popleft(), self._settings.seed))))
        while self._states and self._states[0].stamp_ns <= now_ns:
            self._joint_states.publish(_message(self._states.popleft()))


def _about(cart: PlacedCart, seed: int) -> dict[str, object]:
    return {
        "generated": True,
        "description": "simulated: virtual test bench (MuJoCo), the robot drives into a cart",
        "generator": "bench_node",
        "seed": seed,
        "configuration": cart.configuration,
        "obstacle_mass": cart.obstacle_mass,
        "since_ns": cart.stamp_ns,
    }


def _message(state: values.JointState) -> JointState:
    message = JointState(name=list(state.names))
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(state.stamp_ns, _NS)
    message.position, message.velocity = array("d", state.position), array("d", state.velocity)
    return message


def main(args: Sequence[str] | None = None) -> int:
    """Run the node with ROS arguments `args`, or those of the process."""
    return run(BenchNode, args)

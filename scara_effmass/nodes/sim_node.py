# SPDX-License-Identifier: Apache-2.0
"""`sim_node`: the robot of the simulated cell; `daq_node` with the scene `cell` publishes its force."""

import time
from collections import deque
from functools import partial

from rosgraph_msgs.msg import Clock as ClockMessage
from scara_effmass_msgs.msg import ContactStates, ForceBlock, RunInfo
from sensor_msgs.msg import JointState

from scara_effmass import values
from scara_effmass.errors import SettingsError
from scara_effmass.nodes import parameters
from scara_effmass.nodes.lifecycle import LifecycleBase, run
from scara_effmass.nodes.ros import qos_profile
from scara_effmass.settings.loading import fixed
from scara_effmass.sim.experiment import ImpactSetup, LiveSim
from scara_effmass.wire import topics
from scara_effmass.wire.cdr import NS, header_stamp_ns
from scara_effmass.wire.joint_state import joint_state_message
from scara_effmass.wire.run_info import run_info_message

_MS = 1_000_000
_PERIOD_S = 0.001
_AHEAD_NS = 20 * _MS
"""Lead of the simulation: an impact takes longer to compute than the rest."""
_BEHIND_NS = {topics.CONTACT_STATES: 50 * _MS, topics.FORCE: 400 * _MS}
"""Largest lag of the latest stamp behind the clock; a block of 0.1 s has the stamp of its first sample."""
_HOLD_PERIOD_NS = 50 * _MS
_MAX_STEP_NS = 100 * _MS
"""Longest time to simulate at once: on a busy machine each step would take longer than the last; signals wait."""
_NEVER_NS = 2**62
_MAX_PAST_NS = 60 * NS
"""Without a clock of its own, the node catches up with the ROS time."""


class NodeSettings(parameters.NodeParameters):
    """Parameters of `sim_node`; `start` and `seed` must equal those of the force node."""

    start: float = fixed(
        0.0, "ROS time at which the cell begins, the same as sim.start of daq_node [s]; 0: now", ge=0.0, le=1e10
    )
    seed: int = fixed(0, "the same as sim.seed of daq_node", ge=0)
    clock: bool = fixed(
        default=False,
        description="publish /clock at up to real time, and wait for monitor and force node if they fall behind",
    )
    listeners: tuple[str, ...] = fixed(
        (), "with clock: nodes that must have subscribed to joint_states before the start; empty: any one"
    )


class SimNode(LifecycleBase[NodeSettings]):
    """Publish `joint_states` at 1 kHz and the run information of the cart in place.

    Without `clock` the node runs on ROS time; with it the node publishes that time and waits for slower nodes.
    """

    def __init__(self) -> None:
        """Declare the parameters. Raises SettingsError for an invalid one."""
        super().__init__("sim", NodeSettings)
        self._states: deque[values.JointState] = deque()
        self._carts: deque[ImpactSetup] = deque()

    def configure(self) -> None:
        """Create the endpoints. Raises SettingsError for contradicting parameters."""
        if self.settings.clock and self.get_parameter("use_sim_time").value:
            raise SettingsError(f"{self.get_name()}: clock = true: use_sim_time must be false")
        self._joint_states = self.create_owned_publisher(JointState, topics.JOINT_STATES, topics.STREAM_QOS)
        self._info = self.create_owned_publisher(RunInfo, topics.RUN_INFO, topics.INFO_QOS)
        self._sim_clock = SimClock(self) if self.settings.clock else None
        self.create_steady_timer(_PERIOD_S, self._publish_due)
        self.create_status_timer(self._log_status)

    def activate(self) -> None:
        """Move the robot to its start."""
        now_ns = self.now_ns()
        start_ns = round(self.settings.start * 1e3) * _MS or now_ns
        if not self.settings.clock and start_ns < now_ns - _MAX_PAST_NS:
            raise SettingsError(f"{self.get_name()}: start = {self.settings.start}: must be at most 60 s ago")
        self._sim = LiveSim(start_ns, seed=self.settings.seed)
        self._states.clear()
        self._carts.clear()
        self._start_ns = self._time_ns = start_ns
        self._is_awaited = self._sim_clock is not None
        if self._sim_clock is not None:
            self._sim_clock.begin(start_ns)

    def _publish_due(self) -> None:
        if not self.active:
            return
        if self._sim_clock is None:
            now_ns = min(self.now_ns(), self._time_ns + _MAX_STEP_NS)
        elif self._is_awaited and self._missing():
            self._sim_clock.hold()
            return
        else:
            self._is_awaited = False
            now_ns = self._sim_clock.advance()
        output = self._sim.advance_to(now_ns + _AHEAD_NS)
        self._states += output.joint_states
        self._carts += output.carts
        while self._carts and self._carts[0].start_ns <= now_ns:
            note = f"simulated (MuJoCo): the robot hits a cart\ngenerator = sim_node, seed = {self.settings.seed}"
            info = self._carts.popleft().run_info(note)
            self._info.publish(run_info_message(info))
            self.get_logger().info(f"simulated cart of {info.obstacle_mass:.3g} kg in place: {info.configuration}")
        while self._states and self._states[0].stamp_ns <= now_ns:
            self._joint_states.publish(joint_state_message(self._states.popleft()))
        self._time_ns = now_ns

    def _missing(self) -> list[str]:
        """Return the listeners that have not subscribed yet; without any stated, one that stands for all nodes."""
        found = {info.node_name for info in self.get_subscriptions_info_by_topic(topics.JOINT_STATES)}
        return sorted({*self.settings.listeners} - found) or ([] if found else ["a subscriber"])

    def _log_status(self) -> None:
        count = self._joint_states.get_subscription_count()
        waits = f": waits for {', '.join(self._missing())}" * self._is_awaited
        simulated_s = (self._time_ns - self._start_ns) / NS
        self.get_logger().info(f"simulated {simulated_s:.1f} s, {count} subscribers of joint_states{waits}")


class SimClock:
    """Simulated time on /clock: real time, slowed down for the other nodes."""

    def __init__(self, node: SimNode) -> None:
        """Create the publisher of the clock and the subscriptions to the outputs of the other nodes."""
        self._publisher = node.own(
            node.create_publisher(ClockMessage, topics.CLOCK, qos_profile(topics.CLOCK_QOS)), node.destroy_publisher
        )
        self._done_ns: dict[str, int] = {}
        for topic, kind in ((topics.CONTACT_STATES, ContactStates), (topics.FORCE, ForceBlock)):
            on_done = partial(self._on_done, topic)
            node.create_owned_subscription(kind, topic, on_done, topics.STREAM_QOS, raw=True)

    def begin(self, start_ns: int) -> None:
        """Start the time at `start_ns`."""
        self._now_ns = start_ns
        self._steady_ns = time.monotonic_ns()
        self._done_ns.clear()

    def hold(self) -> None:
        """Publish the current time, without advancing it."""
        steady_ns = time.monotonic_ns()
        if steady_ns - self._steady_ns > _HOLD_PERIOD_NS:
            self._steady_ns = steady_ns
            self._publish()

    def advance(self) -> int:
        """Advance by the elapsed real time, as far as the other nodes follow; return the time."""
        steady_ns = time.monotonic_ns()
        limits_ns = [done_ns + _BEHIND_NS[topic] for topic, done_ns in self._done_ns.items()]
        step_ns = min(steady_ns - self._steady_ns, _MAX_STEP_NS)
        self._now_ns = max(self._now_ns, min(self._now_ns + step_ns, *limits_ns, _NEVER_NS))
        self._steady_ns = steady_ns
        self._publish()
        return self._now_ns

    def _publish(self) -> None:
        message = ClockMessage()
        message.clock.sec, message.clock.nanosec = divmod(self._now_ns, NS)
        self._publisher.publish(message)

    def _on_done(self, topic: str, data: bytes) -> None:
        self._done_ns[topic] = max(self._done_ns.get(topic, 0), header_stamp_ns(data))


main = partial(run, "sim", SimNode)

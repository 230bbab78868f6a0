# SPDX-License-Identifier: Apache-2.0
"""Tests of daq_node over DDS: topics, lifecycle, refusals and exit."""

import signal
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import rclpy
from builtin_interfaces.msg import Time
from geometry_msgs.msg import WrenchStamped
from lifecycle_msgs.msg import Transition, TransitionEvent
from lifecycle_msgs.srv import ChangeState
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock
from scara_effmass_msgs.msg import ForceBlock, Impact
from std_srvs.srv import Trigger

from scara_effmass.bags.writer import BagWriter
from scara_effmass.impacts.detector import Detector
from scara_effmass.nodes.daq_node import DaqNode
from scara_effmass.settings import DetectionSettings
from scara_effmass.values import ForceBlock as Block
from scara_effmass.values import Impact as ImpactValue
from scara_effmass.wire.force import decode_force_block, decode_impact, force_block_message, impact_message
from scara_effmass.wire.message_types import FORCE_BLOCK
from test.daq.conftest import NiDevice
from test.nodes.conftest import NodeHarness, ros_node, stamp_ns

EXECUTABLE = Path(sys.executable).with_name("daq_node")
DEEP = QoSProfile(depth=20_000)
RATE = 12_800.0
S = 1_000_000_000
SETTLED = 10
"""Blocks after which the clock fit has settled."""
SIM = ("-p", "source:=sim", "-p", "sim.impact_period:=0.5", "-p", "sim.seed:=7", "-p", "backlog:=600.0")
"""The long backlog keeps all samples on a busy machine."""


class ForceTopics:
    """Messages of the force topics of one channel; blocks and impacts as bytes."""

    def __init__(self, harness: NodeHarness, channel: str = "") -> None:
        self.blocks: list[bytes] = []
        self.impacts: list[bytes] = []
        self.wrenches: list[WrenchStamped] = []
        suffix = f"/{channel}" if channel else ""
        node = harness.node
        node.create_subscription(ForceBlock, f"force{suffix}", self.blocks.append, DEEP, raw=True)
        node.create_subscription(Impact, f"impact{suffix}", self.impacts.append, DEEP, raw=True)
        node.create_subscription(WrenchStamped, f"wrench{suffix}", self.wrenches.append, DEEP)


def first_samples(topics: ForceTopics) -> list[int]:
    return [decode_force_block(data).first_sample for data in topics.blocks]


def start_node(new_harness: Callable[..., NodeHarness], *arguments: str) -> NodeHarness:
    harness = new_harness(name="daq")
    harness.start("--ros-args", *arguments, command=[str(EXECUTABLE)])
    return harness


def write_recording(folder: Path, pulses: Sequence[float] = (0.6, 1.1)) -> Path:
    """Write 1.5 s or more of noise with half-sines of 2 ms and 100 N that start at `pulses` [s]."""
    path = folder / "force.mcap"
    n = round(0.1 * RATE)
    t = np.arange(max(15, round(10 * max(pulses)) + 3) * n) / RATE
    force = np.random.default_rng(3).normal(0.0, 0.1, t.size)
    for start in pulses:
        force += 100.0 * np.where((t > start) & (t < start + 0.002), np.sin(np.pi * (t - start) / 0.002), 0.0)
    begin_ns = 1_800_000_000 * S
    with BagWriter(path) as bag:
        for first in range(0, t.size, n):
            stamp_ns = begin_ns + round(first / RATE * S)
            block = Block(stamp_ns, "cell", first, RATE, force[first : first + n], filter_delay=0.003, simulated=True)
            bag.write("/force", FORCE_BLOCK, stamp_ns + S // 10, force_block_message(block))
    return path


def test_simulated_force_is_complete_and_marked_simulated(
    new_harness: Callable[..., NodeHarness],
) -> None:
    began_ns = time.time_ns()
    harness = start_node(new_harness, *SIM)
    harness.subscribe()
    topics = ForceTopics(harness)
    harness.spin_until(lambda: len(topics.blocks) >= 20 and len(topics.impacts) >= 2 and topics.wrenches)
    harness.spin_until(lambda: stamp_ns(topics.wrenches[-1]) - stamp_ns(topics.wrenches[0]) > 1.5 * S)
    blocks = [decode_force_block(data) for data in topics.blocks]
    harness.spin_until(lambda: stamp_ns(topics.wrenches[-1]) >= blocks[-1].stamp_ns)
    now_ns = time.time_ns()
    for before, after in pairwise(blocks):
        assert after.first_sample == before.first_sample + len(before.force) + after.lost_samples
    for before, after in pairwise(blocks[SETTLED:]):
        step_s = (after.stamp_ns - before.stamp_ns) / 1e9
        # The clock residual depends on the delay of the reads.
        assert step_s == pytest.approx(
            len(before.force) / before.sample_rate, abs=1e-3 + before.clock_residual + after.clock_residual
        )
    last = blocks[-1]
    assert sum(block.lost_samples for block in blocks) == 0
    assert last.simulated
    assert "simulated" in last.source
    assert last.frame_id == "force_sensor"
    assert began_ns <= blocks[0].stamp_ns
    assert last.stamp_ns + round(len(last.force) / last.sample_rate * S) <= now_ns
    assert blocks[0].sample_rate == pytest.approx(RATE, rel=1e-3)
    assert all(decode_impact(data).simulated for data in topics.impacts)
    # Wrenches are samples of the blocks, 100 of them in a second.
    samples = {value for block in blocks for value in block.force.tolist()}
    first = next(i for i, block in enumerate(blocks) if block.stamp_ns > stamp_ns(topics.wrenches[0]))
    some = [w for w in topics.wrenches if blocks[first].stamp_ns <= stamp_ns(w) < blocks[-1].stamp_ns]
    assert {w.wrench.force.z for w in some} <= samples
    assert len(some) == pytest.approx(100 * (blocks[-1].stamp_ns - blocks[first].stamp_ns) / 1e9, rel=0.1)
    assert harness.diagnostic("daq: source", "samples lost by the device", bool).endswith("0")
    assert harness.diagnostic("daq: source", "simulated", bool).endswith("True")
    assert float(harness.diagnostic("daq: channel sim0", "samples published", bool).rpartition(" ")[2]) > 0


def test_live_impacts_equal_offline_impacts_of_the_published_blocks(new_harness: Callable[..., NodeHarness]) -> None:
    harness = start_node(new_harness, *SIM, "-p", "autostart:=false")
    topics = ForceTopics(harness)
    assert harness.change_state(Transition.TRANSITION_CONFIGURE)
    harness.spin_until(lambda: harness.node.count_publishers("force") and harness.node.count_publishers("impact"))
    assert harness.change_state(Transition.TRANSITION_ACTIVATE)
    harness.spin_until(lambda: len(topics.impacts) >= 5)
    assert harness.change_state(Transition.TRANSITION_DEACTIVATE)
    live = [decode_impact(data) for data in topics.impacts]

    def offline_impacts() -> list[ImpactValue]:
        detector = Detector(DetectionSettings())
        return [impact for data in topics.blocks for impact in detector.feed(decode_force_block(data))]

    harness.spin_until(lambda: len(offline_impacts()) >= len(live))  # blocks and impacts arrive independently
    assert first_samples(topics)[0] == 0
    offline = {impact.onset_sample: impact for impact in offline_impacts()}
    assert [offline[impact.onset_sample] for impact in live] == live  # primary impacts may overtake rebounds


def test_each_channel_has_its_own_topics(new_harness: Callable[..., NodeHarness]) -> None:
    harness = start_node(new_harness, *SIM, "-p", "sim.channels:=3")
    channels = [ForceTopics(harness, channel) for channel in ("", "sim1", "sim2")]
    harness.spin_until(lambda: all(len(channel.blocks) >= 3 for channel in channels))
    frames = [decode_force_block(channel.blocks[-1]).frame_id for channel in channels]
    assert frames == ["force_sensor", "force_sensor_sim1", "force_sensor_sim2"]


def test_reset_tares(new_harness: Callable[..., NodeHarness]) -> None:
    harness = start_node(new_harness, *SIM, "-p", "tare.time:=0.2", "-p", "sim.impact_period:=3600.0")
    topics = ForceTopics(harness)
    harness.spin_until(lambda: topics.blocks and decode_force_block(topics.blocks[-1]).tare_stamp_ns)
    first = decode_force_block(topics.blocks[-1])
    answer = harness.call_service(Trigger, "reset", Trigger.Request())
    assert answer.success
    assert answer.message == "taring over the next 0.2 s"
    harness.spin_until(lambda: decode_force_block(topics.blocks[-1]).tare_stamp_ns > first.tare_stamp_ns)
    assert abs(decode_force_block(topics.blocks[-1]).tare) < 0.1


def test_inactive_node_publishes_and_acquires_nothing(new_harness: Callable[..., NodeHarness]) -> None:
    harness = start_node(new_harness, *SIM, "-p", "autostart:=false")
    topics = ForceTopics(harness)
    assert harness.change_state(Transition.TRANSITION_CONFIGURE)
    harness.spin_until(lambda: harness.node.count_publishers("force"))
    answer = harness.call_service(Trigger, "reset", Trigger.Request())
    assert (answer.success, answer.message) == (False, "refused: no acquisition is running")
    assert not topics.blocks
    for times in (1, 2):
        assert harness.change_state(Transition.TRANSITION_ACTIVATE)
        harness.spin_until(partial(has_restarted, topics, times))
        assert harness.change_state(Transition.TRANSITION_DEACTIVATE)


def has_restarted(topics: ForceTopics, times: int) -> bool:
    """Return whether the numbering started at 0 `times` times and continued."""
    numbers = first_samples(topics)
    return numbers.count(0) == times and numbers[-1] > 0


def test_stop_at_end_plays_the_recording_and_ends_the_process(
    new_harness: Callable[..., NodeHarness], tmp_path: Path
) -> None:
    harness = new_harness(name="daq")
    topics = ForceTopics(harness)
    words = ["-p", "source:=bag", "-p", f"bag.path:={write_recording(tmp_path)}", "-p", "stop_at_end:=true"]
    words += ["-p", "bag.rate:=0.0", "-p", "autostart:=false"]
    process = harness.start("--ros-args", *words, command=[str(EXECUTABLE)])
    assert harness.change_state(Transition.TRANSITION_CONFIGURE)
    harness.spin_until(lambda: harness.node.count_publishers("force") and harness.node.count_publishers("impact"))
    assert harness.change_state(Transition.TRANSITION_ACTIVATE)
    harness.process_may_end = True
    harness.spin_until(lambda: len(topics.blocks) == 15 and len(topics.impacts) == 2)
    process.communicate()
    assert process.returncode == 0
    blocks = [decode_force_block(data) for data in topics.blocks]
    assert [block.stamp_ns for block in blocks] == [1_800_000_000 * S + i * S // 10 for i in range(15)]
    impacts = [decode_impact(data) for data in topics.impacts]
    assert [i.peak_force for i in impacts] == pytest.approx([100.0, 100.0], rel=0.01)
    onsets = [(i.stamp_ns - 1_800_000_000 * S) / 1e9 for i in impacts]
    assert onsets == pytest.approx([0.6, 1.1], abs=1e-4)


def test_rebounds_push_no_primary_impact_out_of_a_queue_of_10(
    new_harness: Callable[..., NodeHarness], tmp_path: Path
) -> None:
    """A subscriber of depth 10, as rosbag2, that takes nothing until another one has two impacts."""
    pulses = (0.6, *(0.61 + 0.012 * i for i in range(24)), 1.7)
    harness = new_harness(name="daq")
    topics = ForceTopics(harness)
    words = ["-p", "source:=bag", "-p", f"bag.path:={write_recording(tmp_path, pulses)}", "-p", "stop_at_end:=true"]
    with ros_node("slow", domain=harness.domain) as slow:
        taken: list[bytes] = []
        slow.create_subscription(Impact, "impact", taken.append, QoSProfile(depth=10), raw=True)
        executor = SingleThreadedExecutor(context=slow.context)
        executor.add_node(slow)
        words += ["-p", "bag.rate:=0.0", "-p", "autostart:=false"]
        process = harness.start("--ros-args", *words, command=[str(EXECUTABLE)])
        assert harness.change_state(Transition.TRANSITION_CONFIGURE)
        harness.spin_until(lambda: slow.count_publishers("impact") and harness.node.count_publishers("impact"))
        assert harness.change_state(Transition.TRANSITION_ACTIVATE)
        harness.process_may_end = True
        harness.spin_until(lambda: len(topics.impacts) >= 2)

        def all_taken() -> bool:
            for _ in range(5):
                executor.spin_once(timeout_sec=0.0)
            return sum(decode_impact(data).rebound == 0 for data in taken) == 2

        harness.spin_until(all_taken, timeout_s=20.0)
        executor.shutdown()
    process.communicate()
    assert process.returncode == 0


def test_contact_that_lasts_at_the_end_of_the_process_is_published(
    new_harness: Callable[..., NodeHarness], tmp_path: Path
) -> None:
    force = np.random.default_rng(3).normal(0.0, 0.1, 2 * int(RATE))
    force[-int(0.2 * RATE) :] += 300.0
    begin_ns = 1_800_000_000 * S
    blocks = [
        Block(begin_ns, "cell", 0, RATE, force, simulated=True),
        Block(begin_ns + 1000 * S, "cell", force.size, RATE, force[:100], lost_samples=1, simulated=True),
    ]
    with BagWriter(tmp_path / "held.mcap") as bag:
        for block in blocks:
            bag.write("/force", FORCE_BLOCK, block.stamp_ns + 2 * S, force_block_message(block))
    harness = new_harness(name="daq")
    topics = ForceTopics(harness)
    source = ("-p", "source:=bag", "-p", f"bag.path:={tmp_path / 'held.mcap'}")
    process = harness.start("--ros-args", *source, command=[str(EXECUTABLE)])
    harness.spin_until(lambda: topics.blocks)
    assert not topics.impacts
    harness.process_may_end = True
    process.terminate()
    harness.spin_until(lambda: topics.impacts)
    impact = decode_impact(topics.impacts[0])
    assert (impact.incomplete, round(impact.peak_force, -1)) == (True, 300.0)


def test_stuck_subscriber_does_not_delay_others(new_harness: Callable[..., NodeHarness]) -> None:
    harness = start_node(new_harness, *SIM)
    with ros_node("asleep", domain=harness.domain) as asleep:
        asleep.create_subscription(ForceBlock, "force", print, QoSProfile(depth=1))  # never spun
        topics = ForceTopics(harness)
        harness.spin_until(lambda: harness.node.count_subscribers("force") == 2)
        topics.blocks.clear()
        harness.spin_until(lambda: len(topics.blocks) >= 20)
    blocks = [decode_force_block(data) for data in topics.blocks]
    assert blocks[-1].first_sample - blocks[0].first_sample == sum(len(block.force) for block in blocks[:-1])


@pytest.mark.parametrize(
    ("argument", "line"),
    [
        ("source:=guess", "daq: source = 'guess': must be 'ni9230', 'bag' or 'sim'"),
        ("nonsense:=1", "daq: no parameter 'nonsense': must be source,"),
        ("sensor.sensitivty:=2.3", "daq: no parameter 'sensor.sensitivty': must be sensor.sensitivity"),
        ("sensor.sensitivity:=0.0", "daq: sensor.sensitivity = 0.0: must be greater than 0"),
        ("sensor.sensitivity:=2", "daq: sensor.sensitivity = 2: must be DOUBLE, is INTEGER: write 2.0"),
        ("frame_id:=y", "daq: frame_id = True: must be STRING, is BOOL: YAML needs quotes, as in frame_id:=\"'y'\""),
        ("bag.path:=N", "daq: bag.path = False: must be STRING, is BOOL: YAML needs quotes, as in bag.path:=\"'N'\""),
        ("source:=7", "daq: source = 7: must be STRING, is INTEGER: YAML needs quotes, as in source:=\"'7'\""),
        ("frame_id:='y'", "the driver NI-DAQmx is not installed"),
        ("detection.threshold:=.nan", "daq: detection.threshold = nan: must be a finite number"),
        ("sim.channels:=0", "daq: sim.channels = 0: must be greater than or equal to 1"),
        ("bag.stamps:=then", "daq: bag.stamps = 'then': must be 'recorded' or 'now'"),
        ("use_sim_time:=true", "daq: use_sim_time = true: must be false, ni9230 measures in real time"),
        ("block_time:=0.1", "the driver NI-DAQmx is not installed; install it from ni.com/downloads"),
    ],
)
def test_invalid_parameter_is_refused_in_one_line(refusal_of: Callable[..., str], argument: str, line: str) -> None:
    assert refusal_of(DaqNode, argument).startswith(line)


def test_configured_node_imports_the_filter_and_refuses_simulated_time(
    own_domain: int,  # noqa: ARG001 - where it is alone
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path))
    monkeypatch.delitem(sys.modules, "scara_effmass.daq.lowpass", raising=False)
    words = ["--ros-args", *SIM, "-p", "filter.kind:=causal", "-p", "autostart:=false"]
    rclpy.init(args=words, signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = DaqNode()
        node.trigger_configure()
        assert "scara_effmass.daq.lowpass" in sys.modules
        (result,) = node.set_parameters([Parameter("use_sim_time", value=True)])
        assert result.reason == "daq: use_sim_time = true: must be false, sim measures in real time"
        assert not node.get_parameter("use_sim_time").value
        node.destroy_node()
    finally:
        rclpy.try_shutdown()


def test_contact_that_a_lost_device_cuts_is_published_while_it_is_lost(
    own_domain: int,  # noqa: ARG001 - where it is alone
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    device = NiDevice()
    monkeypatch.setattr("nidaqmx.utils._select_interpreter", lambda *_, **__: device)
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path))
    force = np.random.default_rng(3).normal(0.0, 0.1, 15_360)
    force[-1_280:] += 300.0

    def signal_of(_channel: int, numbers: np.ndarray) -> np.ndarray:
        if numbers[-1] == force.size - 1:
            device.unplug()
        return np.asarray(force[numbers])

    device.signal = signal_of
    published: list[ImpactValue] = []

    def message_of(impact: ImpactValue) -> bytes:
        published.append(impact)
        return impact_message(impact)

    monkeypatch.setattr("scara_effmass.nodes.daq_node.impact_message", message_of)
    rclpy.init(args=["--ros-args", "-p", "detection.longest:=0.2"], signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = DaqNode()
        node.trigger_configure()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        node.trigger_activate()
        deadline = time.monotonic() + 10.0
        while not published and time.monotonic() < deadline:
            executor.spin_once(0.1)
        assert published, "nothing was published while the device was lost"
        node.destroy_node()
    finally:
        rclpy.try_shutdown()
    (impact,) = published
    assert (impact.incomplete, round(impact.peak_force, -1)) == (True, 300.0)


def test_missing_driver_exits_with_2_and_one_line(new_harness: Callable[..., NodeHarness]) -> None:
    process = start_node(new_harness).process
    assert process is not None
    output, errors = process.communicate()
    assert (process.returncode, output) == (2, "")
    (only,) = [line for line in errors.splitlines() if not line.startswith("[")]  # no log line
    assert only.startswith("the driver NI-DAQmx is not installed")


def test_missing_recording_exits_with_2_and_one_line(new_harness: Callable[..., NodeHarness], tmp_path: Path) -> None:
    missing = tmp_path / "missing.mcap"
    process = start_node(new_harness, "-p", "source:=bag", "-p", f"bag.path:={missing}").process
    assert process is not None
    _, errors = process.communicate()
    assert process.returncode == 2
    assert errors.startswith(f"{missing}: ")
    assert len(errors.splitlines()) == 1


def test_rate_on_the_clock_of_a_replay_exits_with_2_and_one_line(
    new_harness: Callable[..., NodeHarness], tmp_path: Path
) -> None:
    words = ["-p", "source:=bag", "-p", f"bag.path:={write_recording(tmp_path)}", "-p", "bag.subscriber_timeout:=0.0"]
    harness = start_node(new_harness, *words, "-p", "bag.rate:=4.0", "-p", "use_sim_time:=true")
    harness.process_may_end = True
    process, publisher = harness.process, harness.node.create_publisher(Clock, "/clock", 1)
    assert process is not None

    def has_ended() -> bool:
        publisher.publish(Clock(clock=Time(sec=1_800_000_000)))
        return process.poll() is not None

    harness.spin_until(has_ended)
    output, errors = process.communicate()
    assert (process.returncode, output) == (2, "")
    (only,) = [line for line in errors.splitlines() if not line.startswith("[")]  # no log line
    assert only.endswith("force.mcap: bag.rate = 4: must be 1, the bag is replayed on this clock")


def test_parameters_are_read_only_while_running(new_harness: Callable[..., NodeHarness]) -> None:
    harness = start_node(new_harness, *SIM)
    topics = ForceTopics(harness)
    harness.spin_until(lambda: topics.blocks)
    assert "read-only" in harness.set_parameters(**{"sensor.sensitivity": 3.0})


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_exits_with_0(new_harness: Callable[..., NodeHarness], number: signal.Signals) -> None:
    harness = start_node(new_harness, *SIM)
    topics = ForceTopics(harness)
    harness.spin_until(lambda: topics.blocks)
    assert harness.process is not None
    harness.process.send_signal(number)
    output, errors = harness.process.communicate()
    assert harness.process.returncode == 0
    assert "Traceback" not in output + errors


def test_signal_while_waiting_for_a_subscriber_exits_with_0(
    new_harness: Callable[..., NodeHarness], tmp_path: Path
) -> None:
    words = ["-p", "source:=bag", "-p", f"bag.path:={write_recording(tmp_path)}", "-p", "autostart:=false"]
    harness = start_node(new_harness, *words, "-p", "bag.subscriber_timeout:=3600.0")
    states: list[str] = []

    def on_event(event: TransitionEvent) -> None:
        states.append(event.goal_state.label)

    harness.node.create_subscription(TransitionEvent, "daq/transition_event", on_event, DEEP)
    harness.spin_until(lambda: harness.node.count_publishers("daq/transition_event"))
    assert harness.change_state(Transition.TRANSITION_CONFIGURE)
    client = harness.node.create_client(ChangeState, "daq/change_state")
    harness.spin_until(client.service_is_ready)
    client.call_async(ChangeState.Request(transition=Transition(id=Transition.TRANSITION_ACTIVATE)))
    harness.spin_until(lambda: "activating" in states)
    assert harness.process is not None
    harness.process.send_signal(signal.SIGINT)
    output, errors = harness.process.communicate(timeout=60.0)
    assert harness.process.returncode == 0
    assert "Traceback" not in output + errors

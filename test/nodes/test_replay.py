# SPDX-License-Identifier: Apache-2.0
"""Replay of bags to live nodes."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial
from itertools import dropwhile, pairwise
from pathlib import Path
from typing import Any, final

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from hypothesis import given
from hypothesis import strategies as st
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.task import Future
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosgraph_msgs.msg import Clock
from scara_effmass_msgs.msg import NodeReadiness
from sensor_msgs.msg import JointState as JointStateMessage
from std_msgs.msg import Float64, Header, String

from scara_effmass.bags.bag import RawMessage
from scara_effmass.bags.writer import BagWriter
from scara_effmass.errors import BagError, EffmassError, SettingsError
from scara_effmass.nodes.replay import CLOCK_STEP_NS, OnProgress, ReplayOptions, ReplayReport, replay, timeline
from scara_effmass.values import JointState
from scara_effmass.wire.joint_state import JointStateDecoder, joint_state_message
from scara_effmass.wire.topics import READINESS
from test.bags.messages import serialized
from test.nodes.conftest import JOINTS, TIMEOUT_S, ros_node

START_NS = 1_767_225_600_000_000_000
MS = 1_000_000
TEXT = "std_msgs/msg/String"
DEEP = QoSProfile(depth=100_000)
LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
LATCHED_TOPICS = ("/robot_description",)


def state(number: int, names: tuple[str, ...] = JOINTS) -> JointState:
    return JointState(START_NS + number * MS, names, np.arange(4.0) + number, np.full(4, number / 7.0))


pytestmark = pytest.mark.usefixtures("own_domain")


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """Return a bag with 100 joint states at 1 kHz and a text every 25 ms."""
    path = tmp_path / "bag"
    with BagWriter(path) as writer:
        for number in range(100):
            if number % 25 == 0:
                writer.write("/remark", TEXT, START_NS + number * MS, serialized(TEXT, {"data": f"at {number}"}))
            writer.write_joint_states("/joint_states", [state(number)])
    return path


@final
class Receiver:
    """Node in its own thread that records messages.

    It reports that it is ready once it has discovered the replay: the replay discovers it earlier or later. Another
    `readiness` is reported as it is.
    """

    TYPES: Mapping[str, Any] = {
        "/clock": Clock,
        "/joint_states": JointStateMessage,
        "/left/joint_states": JointStateMessage,
        "/remark": String,
    }

    def __init__(self, *topics: str, readiness: NodeReadiness | None = None) -> None:
        self.received: dict[str, list[bytes]] = {topic: [] for topic in topics}
        self._decoder = JointStateDecoder()
        self._changed = threading.Condition()
        self._matched: set[str] = set()
        self._stop = Future()
        self._stack = ExitStack()
        self._node = self._stack.enter_context(ros_node("receiver"))
        # Subscribe to the joint states last: a replay that has matched them has matched the other topics.
        for topic in sorted(topics, key="/joint_states".__eq__):
            kind = self.TYPES.get(topic, String)
            self._node.create_subscription(
                kind,
                topic,
                partial(self._on_message, topic),
                LATCHED if topic in LATCHED_TOPICS else DEEP,
                raw=True,
                event_callbacks=SubscriptionEventCallbacks(matched=partial(self._on_matched, topic)),
            )
        self._reports_itself = readiness is None
        self._readiness = readiness or NodeReadiness(node="/receiver", peers=["/receiver"])
        reports = self._node.create_publisher(NodeReadiness, READINESS, DEEP)
        self._node.create_timer(0.05, lambda: reports.publish(self._readiness))
        self._executor = EventsExecutor(context=self._node.context)
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._spin)
        self._thread.start()

    def wait(self, topic: str, count: int) -> list[bytes]:
        """Return the messages on `topic` once there are `count`."""
        with self._changed:
            assert self._changed.wait_for(lambda: len(self.received[topic]) >= count, TIMEOUT_S), self.received[topic]
        return self.received[topic]

    def wait_matched(self) -> None:
        """Wait for a publisher of one of the topics."""
        with self._changed:
            assert self._changed.wait_for(lambda: bool(self._matched), TIMEOUT_S)

    def states(self, count: int) -> list[JointState]:
        return [self._decoder.decode(data) for data in self.wait("/joint_states", count)]

    def clock(self, count: int) -> list[int]:
        """Return the clock times once there are `count`; repetitions of the start count as one."""
        with self._changed:
            assert self._changed.wait_for(lambda: len(self._times()) >= count, TIMEOUT_S), self._times()
            return self._times()

    def _times(self) -> list[int]:
        clocks = (deserialize_message(data, Clock).clock for data in self.received["/clock"])
        times = [clock.sec * 1_000_000_000 + clock.nanosec for clock in clocks]
        return times[:1] + list(dropwhile(times[0].__eq__, times)) if times else []

    def __enter__(self) -> Receiver:
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set_result(None)
        self._executor.wake()
        self._thread.join()
        self._executor.shutdown()
        self._stack.close()

    def _spin(self) -> None:
        self._executor.spin_until_future_complete(self._stop, timeout_sec=1e6)

    def _on_matched(self, topic: str, _: object) -> None:
        with self._changed:
            self._matched.add(topic)
            self._changed.notify_all()
        if self._reports_itself:
            self._readiness.active = self._matched == self.received.keys()

    def _on_message(self, topic: str, data: bytes) -> None:
        with self._changed:
            self.received[topic].append(data)
            self._changed.notify_all()


def play(bag: Path, on_progress: OnProgress = lambda *_: None, **options: Any) -> ReplayReport:  # noqa: ANN401
    """Replay with long timeouts."""
    return replay(ReplayOptions(bag, **{"ready_timeout_s": TIMEOUT_S, **options}), on_progress)


def same_states(received: list[JointState], sent: list[JointState]) -> bool:
    return len(received) == len(sent) and all(
        (a.stamp_ns, a.names, a.position.tolist(), a.velocity.tolist())
        == (b.stamp_ns, b.names, b.position.tolist(), b.velocity.tolist())
        for a, b in zip(received, sent, strict=True)
    )


def test_messages_and_clock_arrive_once_in_order_and_unchanged(bag: Path) -> None:
    with Receiver("/joint_states", "/remark", "/clock") as receiver:
        report = play(bag, rate=2.0)
        assert receiver.clock(100) == [START_NS + number * MS for number in range(100)]
        assert same_states(receiver.states(100), [state(number) for number in range(100)])
        remarks = [deserialize_message(data, String).data for data in receiver.wait("/remark", 4)]
    assert remarks == ["at 0", "at 25", "at 50", "at 75"]
    assert report.sent == {"/joint_states": 100, "/remark": 4}
    assert (report.skipped, report.unheard, report.unacknowledged, report.warnings) == ({}, (), (), ())
    assert (report.passes, report.interrupted) == (1, False)


def test_topics_that_others_publish_too_are_named(bag: Path) -> None:
    with Receiver("/joint_states", "/clock"), ros_node("other") as other:
        other.create_publisher(Clock, "/clock", DEEP)
        other.create_publisher(JointStateMessage, "/joint_states", DEEP)
        report = play(bag)
    assert set(report.warnings) == {f"2 publishers of {topic}: must be one" for topic in ("/clock", "/joint_states")}


@pytest.mark.parametrize("rate", [0.5, 1.0, 4.0])
def test_messages_are_not_sent_early(bag: Path, rate: float) -> None:
    with Receiver("/joint_states") as receiver:
        report = play(bag, rate=rate)
        assert len(receiver.states(100)) == 100
    assert report.replayed_s == pytest.approx(0.099)
    assert report.wall_s >= 0.099 / rate
    assert report.achieved_rate <= rate
    assert report.worst_lateness_s >= 0.0


def test_start_and_duration_select_a_span(bag: Path) -> None:
    with Receiver("/joint_states", "/clock") as receiver:
        report = play(bag, start_s=0.0205, duration_s=0.03)
        assert same_states(receiver.states(30), [state(number) for number in range(21, 51)])
        clock = receiver.clock(31)
    assert clock[0] == START_NS + 20_500_000
    assert clock[-1] == START_NS + 50 * MS
    assert report.sent["/joint_states"] == 30


def test_latched_messages_before_the_start_are_sent(tmp_path: Path) -> None:
    path = tmp_path / "bag"
    with BagWriter(path) as writer:
        writer.write("/robot_description", TEXT, START_NS, serialized(TEXT, {"data": "<robot/>"}))
        writer.write_joint_states("/joint_states", [state(number) for number in range(50)])
    with Receiver("/joint_states", "/robot_description") as late:
        report = play(path, start_s=0.03)
        assert len(late.wait("/robot_description", 1)) == 1
    assert report.sent == {"/joint_states": 20, "/robot_description": 1}


def test_start_after_the_end_is_refused(bag: Path) -> None:
    with pytest.raises(SettingsError, match=r"start = 5\.0 s: must be within the 0\.099 s recorded"):
        play(bag, start_s=5.0)


def test_clock_jumps_back_between_passes(bag: Path) -> None:
    with Receiver("/joint_states", "/clock") as receiver:
        report = play(bag, rate=4.0, passes=2)
        once = [state(number) for number in range(100)]
        assert same_states(receiver.states(200), once + once)
        clock = receiver.clock(200)
    assert [b - a for a, b in pairwise(clock) if b <= a] == [-99 * MS]
    assert report.passes == 2
    assert report.replayed_s == pytest.approx(2 * 0.099)


def test_replay_without_subscribers_fails(bag: Path) -> None:
    with pytest.raises(EffmassError, match=r"within 0\.2 s: /joint_states: expected 1 subscribers, found 0"):
        play(bag, ready_timeout_s=0.2)


ACTIVE = {"node": "/receiver", "active": True, "use_sim_time": True, "peers": ["/receiver"]}
AT_START = {"header": Header(stamp=Time(sec=START_NS // 10**9))}


@pytest.mark.parametrize(
    ("report", "reason"),
    [
        ({"active": False, "use_sim_time": False}, "/receiver is not active"),
        ({}, "/receiver has not received the replay's /clock"),
        ({**AT_START, "peers": ["/receiver", "/cell/daq"]}, "/cell/daq has sent no readiness report"),
        ({**AT_START, "peers": []}, "/receiver has not discovered /receiver"),
    ],
)
def test_replay_waits_for_nodes_that_are_not_ready(bag: Path, report: dict[str, Any], reason: str) -> None:
    with Receiver("/joint_states", readiness=NodeReadiness(**{**ACTIVE, **report})) as receiver:
        with pytest.raises(EffmassError, match=rf"not ready within 5 s: {reason}$"):
            play(bag, ready_timeout_s=5.0)
        assert receiver.received == {"/joint_states": []}


def test_replay_starts_when_the_last_node_becomes_ready(bag: Path) -> None:
    report = NodeReadiness(**{**ACTIVE, "active": False, **AT_START})
    with Receiver("/joint_states", "/clock", readiness=report) as receiver:
        with ThreadPoolExecutor() as pool:
            replaying = pool.submit(play, bag)
            receiver.wait("/clock", 20)  # the clock shows the start meanwhile
            assert len(set(receiver.received["/clock"])) == 1
            report.active = True
            assert replaying.result().sent["/joint_states"] == 100
        assert len(receiver.states(100)) == 100


def test_topics_of_missing_different_or_mixed_types_are_skipped_with_the_reason(tmp_path: Path) -> None:
    types = get_typestore(Stores.ROS2_JAZZY)
    types.register(get_types_from_msg("float64 torque", "vendor_msgs/msg/Torque"))
    types.fielddefs.pop("geometry_msgs/msg/Point")
    types.types.pop("geometry_msgs/msg/Point")
    types.register(get_types_from_msg("float32 x\nfloat32 y", "geometry_msgs/msg/Point"))
    path = tmp_path / "bag"
    with BagWriter(path, types=types) as writer:
        writer.write("/mixed", TEXT, START_NS, serialized(TEXT, {"data": "1"}))
        writer.write("/mixed", "std_msgs/msg/Float64", START_NS, serialized("std_msgs/msg/Float64", {"data": 1.0}))
        for number in range(10):
            writer.write("/torque", "vendor_msgs/msg/Torque", START_NS + number * MS, bytes(12))
            writer.write("/point", "geometry_msgs/msg/Point", START_NS + number * MS, bytes(12))
            writer.write("/joint_states", "sensor_msgs/msg/JointState", *logged_joint_state(number))
    with Receiver("/joint_states") as receiver:
        report = play(path)
        assert len(receiver.states(10)) == 10
    assert report.sent == {"/joint_states": 10}
    assert report.skipped == {
        "/mixed": "it holds messages of more than one type",
        "/point": "its definition of geometry_msgs/msg/Point is not the installed one",
        "/torque": "its type vendor_msgs/msg/Torque is not installed",
    }


def logged_joint_state(number: int) -> tuple[int, bytes]:
    return START_NS + number * MS, joint_state_message(state(number))


def test_span_without_messages_moves_only_the_clock(tmp_path: Path) -> None:
    path = tmp_path / "bag"
    with BagWriter(path) as writer:
        writer.write_joint_states("/joint_states", [state(0), state(1000)])
    with Receiver("/joint_states", "/clock") as receiver:
        report = play(path, rate=10.0, start_s=0.2, duration_s=0.5)
        clock = receiver.clock(50)
    assert report.sent == {"/joint_states": 0}
    assert clock == [START_NS + 200 * MS + step * 10 * MS for step in range(50)]


def test_node_outputs_are_replayed_only_on_request(tmp_path: Path) -> None:
    number = serialized("std_msgs/msg/Float64", {"data": 1.0})
    path = tmp_path / "bag"
    with BagWriter(path) as writer:
        writer.write("/clock", "rosgraph_msgs/msg/Clock", START_NS, serialize_message(Clock()))
        writer.write("/cell/allowable_speed", "std_msgs/msg/Float64", START_NS, number)
        writer.write_joint_states("/joint_states", [state(1)])
    with Receiver("/joint_states"):
        report = play(path)
    assert report.sent == {"/joint_states": 1}
    assert report.skipped == {
        "/cell/allowable_speed": "the live nodes publish it",
        "/clock": "the replay publishes its own clock",
    }
    Receiver.TYPES = {**Receiver.TYPES, "/cell/allowable_speed": Float64}
    with Receiver("/cell/allowable_speed") as receiver:
        report = play(path, topics=("/cell/allowable_speed",))
        receiver.wait("/cell/allowable_speed", 1)
    assert report.skipped["/joint_states"] == "not selected"


def test_bag_without_a_topic_to_replay_is_refused_with_the_reasons(tmp_path: Path) -> None:
    path = tmp_path / "bag"
    with BagWriter(path) as writer:
        writer.write("/clock", "rosgraph_msgs/msg/Clock", START_NS, serialize_message(Clock()))
    with pytest.raises(SettingsError, match=r"nothing to replay: /clock: the replay publishes its own clock"):
        play(path)


def test_selected_topic_is_published_as_joint_states(tmp_path: Path) -> None:
    path = tmp_path / "bag"
    with BagWriter(path) as writer:
        writer.write_joint_states("/joint_states", [state(number) for number in range(5)])
        writer.write_joint_states("/arm/joint_states", [state(number) for number in range(5, 9)])
    with Receiver("/joint_states") as receiver:
        report = play(path, joint_state_topic="/arm/joint_states")
        assert same_states(receiver.states(4), [state(number) for number in range(5, 9)])
    assert report.sent == {"/joint_states": 4}
    assert report.skipped == {"/joint_states": "/arm/joint_states is published in its place"}


def test_replay_in_a_namespace_publishes_there(tmp_path: Path) -> None:
    """What was recorded there keeps its name, and what all cells share too."""
    path = tmp_path / "bag"
    with BagWriter(path) as writer:
        writer.write_joint_states("/joint_states", [state(number) for number in range(5)])
        for topic in ("/remark", "/left/note", "/tf"):
            writer.write(topic, TEXT, START_NS, serialized(TEXT, {"data": topic}))
    with Receiver("/left/remark", "/left/joint_states") as receiver:
        report = play(path, ros_arguments=("--ros-args", "-r", "__ns:=/left"))
        assert len(receiver.wait("/left/joint_states", 5)) == 5
        (remark,) = receiver.wait("/left/remark", 1)
    assert deserialize_message(remark, String).data == "/remark"
    assert report.sent == {"/left/joint_states": 5, "/left/remark": 1, "/left/note": 1, "/tf": 1}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"topics": ("/wrist",)}, r"bag: no topic /wrist; expected one of /joint_states, /remark"),
        ({"joint_state_topic": "/wrist"}, r"bag: no topic /wrist; expected one of /joint_states, /remark"),
        ({"joint_state_topic": "/remark"}, r"bag: /remark holds no joint states; topics that do: /joint_states"),
    ],
)
def test_missing_topics_are_refused(bag: Path, options: dict[str, Any], message: str) -> None:
    with pytest.raises(BagError, match=message):
        play(bag, **options)


def test_progress_increases_from_the_start(bag: Path) -> None:
    reports: list[tuple[int, float, float]] = []
    with Receiver("/joint_states"):
        play(bag, lambda *progress: reports.append(progress), rate=0.3)  # at least 0.3 s in total
    assert reports[0] == (1, 0.0, 0.099)
    assert len(reports) > 1
    assert all(before <= after for before, after in pairwise(reports))
    assert {span_s for *_, span_s in reports} == {0.099}


CHILD = """
import json, sys
from pathlib import Path
from scara_effmass.nodes.replay import ReplayOptions, replay
report = replay(ReplayOptions(Path(sys.argv[1]), passes=0, ready_timeout_s=600.0))
print(json.dumps({"interrupted": report.interrupted, "sent": report.sent, "passes": report.passes}))
"""


@pytest.fixture
def endless_replay(bag: Path) -> Iterator[subprocess.Popen[str]]:
    child = subprocess.Popen(
        [sys.executable, "-c", CHILD, str(bag)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    yield child
    if child.poll() is None:
        child.kill()
    child.communicate()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_ends_an_endless_replay_cleanly(endless_replay: subprocess.Popen[str], number: signal.Signals) -> None:
    with Receiver("/joint_states") as receiver:
        receiver.wait("/joint_states", 250)
        endless_replay.send_signal(number)
        output, errors = endless_replay.communicate(timeout=TIMEOUT_S)
    assert (endless_replay.returncode, errors) == (0, "")
    report = json.loads(output)
    assert report["interrupted"] is True
    assert report["passes"] >= 3
    assert report["sent"]["/joint_states"] >= 250


def test_signal_ends_the_wait_for_subscribers(bag: Path) -> None:
    code = CHILD.replace("passes=0", "passes=1")
    child = subprocess.Popen([sys.executable, "-c", code, str(bag)], stdout=subprocess.PIPE, text=True)
    with Receiver("/remark") as receiver:  # matches when the replay waits for joint state subscribers
        receiver.wait_matched()
        child.send_signal(signal.SIGINT)
        output, _ = child.communicate(timeout=TIMEOUT_S)
    assert child.returncode == 0
    assert json.loads(output)["interrupted"] is True
    assert receiver.received == {"/remark": []}


LOG_TIMES = st.lists(st.integers(0, 100 * MS), max_size=30).map(sorted)


@given(LOG_TIMES, st.integers(0, 100 * MS))
def test_timeline_has_all_messages_in_order_and_a_clock_step_every_10_ms(log_times: list[int], tail: int) -> None:
    end = (log_times[-1] if log_times else 0) + tail
    messages = [RawMessage("/topic", TEXT, time_ns, bytes([index])) for index, time_ns in enumerate(log_times)]
    steps = list(timeline(messages, 0, end))
    assert [message for _, message in steps if message] == messages
    assert all(time_ns == message.log_time_ns for time_ns, message in steps if message)
    times_ns = [time_ns for time_ns, _ in steps] + [end]
    assert times_ns[0] == 0
    assert all(0 <= b - a <= CLOCK_STEP_NS for a, b in pairwise(times_ns))

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import dropwhile, pairwise
from typing import TYPE_CHECKING, Any, final

import numpy as np
import pytest
import rclpy
from builtin_interfaces.msg import Time
from hypothesis import given
from hypothesis import strategies as st
from rclpy.context import Context
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosgraph_msgs.msg import Clock
from scara_effmass_msgs.msg import ContactState, NodeReadiness
from sensor_msgs.msg import JointState as JointStateMessage
from std_msgs.msg import Float64, Header, String

from scara_effmass.bags.bag import RawMessage
from scara_effmass.bags.messages import serialized
from scara_effmass.bags.writer import BagWriter
from scara_effmass.errors import BagError, EffmassError, SettingsError
from scara_effmass.nodes import lockstep
from scara_effmass.nodes.lockstep import MAX_UNANSWERED
from scara_effmass.nodes.replay import CLOCK_STEP_NS, ReplayOptions, replay, timeline
from scara_effmass.values import JointState
from scara_effmass.wire.joint_state import JointStateDecoder, joint_state_message
from scara_effmass.wire.topics import READINESS

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from rclpy.publisher import Publisher

    from scara_effmass.nodes.replay import ReplayProgress, ReplayReport

START_NS = 1_767_225_600_000_000_000
MS = 1_000_000
TEXT = "std_msgs/msg/String"
PATIENCE_S = 120.0
DEEP = QoSProfile(depth=100_000)
SHALLOW = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
LATCHED_TOPICS = ("/robot_description",)
JOINTS = ("joint1", "joint2", "joint3", "joint4")


def state(number: int, names: tuple[str, ...] = JOINTS) -> JointState:
    return JointState(START_NS + number * MS, names, np.arange(4.0) + number, np.full(4, number / 7.0))


pytestmark = pytest.mark.usefixtures("own_domain")


Leap = Callable[[Callable[[], int]], None]


@pytest.fixture
def leap(monkeypatch: pytest.MonkeyPatch) -> Leap:
    """Let steady time be an hour ahead for each of what a function counts: whatever waits then has waited enough."""
    now_ns = time.monotonic_ns
    monkeypatch.setattr(lockstep, "WAIT_SLICE_NS", 1 << 62)  # it counts leaps in full

    def by(hours: Callable[[], int]) -> None:
        monkeypatch.setattr("time.monotonic_ns", lambda: now_ns() + hours() * 3600 * 10**9)

    return by


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """100 joint states at 1 kHz, and a text every 25 ms."""
    path = tmp_path / "bag"
    with BagWriter(path) as writer:
        for number in range(100):
            if number % 25 == 0:
                writer.write("/remark", TEXT, START_NS + number * MS, serialized(TEXT, {"data": f"at {number}"}))
            writer.write_joint_states("/joint_states", [state(number)])
    return path


@final
class Listener:
    """A node in a thread of its own that keeps what it hears, and may answer joint states as the monitor does."""

    TYPES: Mapping[str, Any] = {"/clock": Clock, "/joint_states": JointStateMessage, "/remark": String}

    def __init__(
        self,
        *topics: str,
        qos: QoSProfile = DEEP,
        answers: bool = False,
        slowness_s: float = 0.0,
        foreign: tuple[str, ...] = (),
        leaves_after: int | None = None,
        readiness: NodeReadiness | None = None,
    ) -> None:
        self.heard: dict[str, list[bytes]] = {topic: [] for topic in topics}
        self.declined = 0
        self._slowness_s = slowness_s
        self._foreign = foreign
        self._leaves_after = leaves_after
        self._decoder = JointStateDecoder()
        self._changed = threading.Condition()
        self._matched = threading.Event()
        self._stop = Future()
        self._context = Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = Node("listener", context=self._context)
        self._is_to_answer = answers
        self._answers: Publisher | None = None
        # A replay waits for whoever listens to the joint states: by then it has found the others, which it is told of
        # before.
        for topic in sorted(topics, key="/joint_states".__eq__):
            kind = self.TYPES.get(topic, String)
            self._node.create_subscription(
                kind,
                topic,
                partial(self._hear, topic),
                LATCHED if topic in LATCHED_TOPICS else qos,
                raw=True,
                event_callbacks=SubscriptionEventCallbacks(matched=self._on_matched),
            )
        if readiness is not None:
            reports = self._node.create_publisher(NodeReadiness, READINESS, DEEP)
            self._node.create_timer(0.05, lambda: reports.publish(readiness))
        self._executor = EventsExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._spin)
        self._thread.start()

    def wait(self, topic: str, count: int) -> list[bytes]:
        """Return what was heard on `topic` once it is `count` messages."""
        with self._changed:
            assert self._changed.wait_for(lambda: len(self.heard[topic]) >= count, PATIENCE_S), self.heard[topic]
        return self.heard[topic]

    def wait_matched(self) -> None:
        """Return once a publisher of one of the topics has been found."""
        assert self._matched.wait(PATIENCE_S)

    def states(self, count: int) -> list[JointState]:
        return [self._decoder.decode(data) for data in self.wait("/joint_states", count)]

    def clock(self, count: int) -> list[int]:
        """Return what the clock showed once it is `count` times; its stand before the start is one."""
        with self._changed:
            assert self._changed.wait_for(lambda: len(self._times()) >= count, PATIENCE_S), self._times()
            return self._times()

    def _times(self) -> list[int]:
        clocks = (deserialize_message(data, Clock).clock for data in self.heard["/clock"])
        times = [clock.sec * 1_000_000_000 + clock.nanosec for clock in clocks]
        return times[:1] + list(dropwhile(times[0].__eq__, times)) if times else []

    def __enter__(self) -> Listener:
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set_result(None)
        self._executor.wake()
        self._thread.join()
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()

    def _spin(self) -> None:
        self._executor.spin_until_future_complete(self._stop, timeout_sec=1e6)

    def _on_matched(self, _: object) -> None:
        # A replay at rate 0 waits for whoever answers: by then this one hears it, also where nothing is repeated.
        if self._is_to_answer and self._answers is None:
            events = PublisherEventCallbacks(matched=self._say_that_all_is_silent)
            self._answers = self._node.create_publisher(ContactState, "contact_state", DEEP, event_callbacks=events)
        self._matched.set()

    def _say_that_all_is_silent(self, _: object) -> None:
        if self._answers is not None:
            self._answers.publish(ContactState(reason="no joint state yet"))

    def _hear(self, topic: str, data: bytes) -> None:
        with self._changed:
            self.heard[topic].append(data)
            self._changed.notify_all()
        if topic == "/joint_states" and self._answers is not None:
            self._answer(self._answers, data)

    def _answer(self, answers: Publisher, data: bytes) -> None:
        if len(self.heard["/joint_states"]) == self._leaves_after:
            self._is_to_answer = False
            self._node.destroy_publisher(answers)
            self._answers = None
            return
        time.sleep(self._slowness_s)  # this is the work that it takes so long for
        received = self._decoder.decode(data)
        if received.names == self._foreign:
            self.declined += 1
            return
        message = ContactState()
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(received.stamp_ns, 1_000_000_000)
        while not answers.get_subscription_count() and not self._stop.done():
            threading.Event().wait(0.001)  # the replay has found this one, but not the other way round yet
        answers.publish(message)


def play(bag: Path, progress: Callable[[ReplayProgress], None] | None = None, **options: Any) -> ReplayReport:  # noqa: ANN401
    """Replay, waiting for listeners and answers for as long as it takes."""
    return replay(
        ReplayOptions(bag, **{"ready_timeout_s": PATIENCE_S, "answer_timeout_s": PATIENCE_S, **options}), progress
    )


def same(received: list[JointState], sent: list[JointState]) -> bool:
    return len(received) == len(sent) and all(
        (a.stamp_ns, a.names, a.position.tolist(), a.velocity.tolist())
        == (b.stamp_ns, b.names, b.position.tolist(), b.velocity.tolist())
        for a, b in zip(received, sent, strict=True)
    )


def test_everything_arrives_once_in_order_and_unchanged(bag: Path) -> None:
    with Listener("/joint_states", "/remark", "/clock") as listener:
        report = play(bag, rate=2.0)
        assert same(listener.states(100), [state(number) for number in range(100)])
        remarks = [deserialize_message(data, String).data for data in listener.wait("/remark", 4)]
    assert remarks == ["at 0", "at 25", "at 50", "at 75"]
    assert report.sent == {"/joint_states": 100, "/remark": 4}
    assert (report.skipped, report.unheard, report.unacknowledged, report.warnings) == ({}, (), (), ())
    assert (report.passes, report.interrupted) == (1, False)


def test_the_clock_tells_every_log_time_and_does_not_go_back(bag: Path) -> None:
    with Listener("/joint_states", "/clock") as listener:
        play(bag, rate=2.0)
        clock = listener.clock(100)
    assert clock == [START_NS + number * MS for number in range(100)]


@pytest.mark.parametrize("rate", [0.5, 1.0, 4.0])
def test_nothing_is_sent_before_it_is_due(bag: Path, rate: float) -> None:
    with Listener("/joint_states") as listener:
        report = play(bag, rate=rate)
        assert len(listener.states(100)) == 100
    assert report.replayed_s == pytest.approx(0.099)
    assert report.wall_s >= 0.099 / rate
    assert report.achieved_rate <= rate
    assert report.worst_lateness_s >= 0.0


def test_start_and_duration_cut_the_recording(bag: Path) -> None:
    with Listener("/joint_states", "/clock") as listener:
        report = play(bag, start_s=0.0205, duration_s=0.03)
        assert same(listener.states(30), [state(number) for number in range(21, 51)])
        clock = listener.clock(31)
    assert clock[0] == START_NS + 20_500_000
    assert clock[-1] == START_NS + 50 * MS
    assert report.sent["/joint_states"] == 30


def test_what_is_latched_before_the_start_is_there(tmp_path: Path) -> None:
    path = tmp_path / "bag"
    with BagWriter(path) as writer:
        writer.write("/robot_description", TEXT, START_NS, serialized(TEXT, {"data": "<robot/>"}))
        writer.write_joint_states("/joint_states", [state(number) for number in range(50)])
    with Listener("/joint_states", "/robot_description") as late:
        report = play(path, start_s=0.03)
        assert len(late.wait("/robot_description", 1)) == 1
    assert report.sent == {"/joint_states": 20, "/robot_description": 1}


def test_a_start_behind_the_end_is_refused(bag: Path) -> None:
    with pytest.raises(SettingsError, match=r"start = 5\.0 s: must be within the 0\.099 s recorded"):
        play(bag, start_s=5.0)


def test_between_two_passes_the_clock_jumps_back(bag: Path) -> None:
    with Listener("/joint_states", "/clock") as listener:
        report = play(bag, rate=4.0, passes=2)
        once = [state(number) for number in range(100)]
        assert same(listener.states(200), once + once)
        clock = listener.clock(200)
    assert [b - a for a, b in pairwise(clock) if b <= a] == [-99 * MS]
    assert report.passes == 2
    assert report.replayed_s == pytest.approx(2 * 0.099)


def test_at_rate_0_a_slow_node_with_a_queue_of_one_misses_nothing(bag: Path) -> None:
    with Listener("/joint_states", qos=SHALLOW, answers=True, slowness_s=0.003) as listener:
        report = play(bag, rate=0.0)
        assert same(listener.states(100), [state(number) for number in range(100)])
    assert (report.answered, report.unanswered, report.not_awaited) == (100, 0, 0)
    assert report.wall_s >= 0.3
    assert (report.late, report.worst_lateness_s) == (0, 0.0)


def test_at_rate_0_joint_states_of_other_devices_do_not_stop_it(tmp_path: Path, leap: Leap) -> None:
    gripper = ("finger1", "finger2", "finger3", "finger4")
    states = [state(number, JOINTS if number % 2 else gripper) for number in range(60)]
    path = tmp_path / "bag"
    with BagWriter(path) as writer:
        writer.write_joint_states("/joint_states", states)
    with Listener("/joint_states", answers=True, foreign=gripper) as listener:
        leap(
            lambda: min(listener.declined, MAX_UNANSWERED)
        )  # who waits for the answer to one that is not answered is through
        report = play(path, rate=0.0)
        assert same(listener.states(60), states)
    assert report.answered == 30
    assert report.unanswered == MAX_UNANSWERED
    assert report.not_awaited == 30 - MAX_UNANSWERED


def test_at_rate_0_a_monitor_that_leaves_ends_it(bag: Path) -> None:
    with (
        Listener("/joint_states", answers=True, leaves_after=7),
        pytest.raises(EffmassError, match="/contact_state: its publisher left after 6 answers"),
    ):
        play(bag, rate=0.0)


def test_at_rate_0_the_live_monitor_answers_everything(bag: Path) -> None:
    monitor = subprocess.Popen(
        [sys.executable, "-c", "import sys; from scara_effmass.nodes.monitor_node import main; sys.exit(main())"]
    )
    try:
        report = play(bag, rate=0.0)
    finally:
        monitor.send_signal(signal.SIGTERM)
        assert monitor.wait(PATIENCE_S) == 0
    assert (report.sent["/joint_states"], report.answered, report.unanswered) == (100, 100, 0)


def test_replay_without_subscribers_fails(bag: Path) -> None:
    with pytest.raises(EffmassError, match=r"within 0\.2 s: /joint_states: expected 1 subscribers, found 0"):
        play(bag, ready_timeout_s=0.2)


def test_rate_0_without_a_monitor_fails(bag: Path) -> None:
    message = "/contact_state: no publisher; rate 0 needs a monitor"
    with Listener("/joint_states"), pytest.raises(EffmassError, match=message):
        play(bag, rate=0.0, ready_timeout_s=5.0)


ACTIVE = {"node": "/listener", "active": True, "use_sim_time": True, "peers": ["/listener"]}
AT_START = {"header": Header(stamp=Time(sec=START_NS // 10**9))}


@pytest.mark.parametrize(
    ("report", "reason"),
    [
        ({"active": False, "use_sim_time": False}, "/listener is not active"),
        ({}, "/listener has not received the replay's /clock"),
        ({**AT_START, "peers": ["/listener", "/cell/daq"]}, "/cell/daq has sent no readiness report"),
        ({**AT_START, "peers": []}, "/listener has not discovered /listener"),
    ],
)
def test_replay_waits_for_nodes_that_are_not_ready(bag: Path, report: dict[str, Any], reason: str) -> None:
    with Listener("/joint_states", readiness=NodeReadiness(**{**ACTIVE, **report})) as listener:
        with pytest.raises(EffmassError, match=rf"not ready within 5 s: {reason}$"):
            play(bag, ready_timeout_s=5.0)
        assert listener.heard == {"/joint_states": []}


def test_replay_starts_when_the_last_node_becomes_ready(bag: Path) -> None:
    report = NodeReadiness(**{**ACTIVE, "active": False, **AT_START})
    with Listener("/joint_states", "/clock", readiness=report) as listener:
        with ThreadPoolExecutor() as pool:
            replaying = pool.submit(play, bag)
            listener.wait("/clock", 20)  # the clock shows the start meanwhile
            assert len(set(listener.heard["/clock"])) == 1
            report.active = True
            assert replaying.result().sent["/joint_states"] == 100
        assert len(listener.states(100)) == 100


def test_types_that_are_not_installed_or_defined_otherwise_are_skipped_and_named(tmp_path: Path) -> None:
    types = get_typestore(Stores.ROS2_JAZZY)
    types.register(get_types_from_msg("float64 torque", "maker_of_arms/msg/Torque"))
    types.fielddefs.pop("geometry_msgs/msg/Point")
    types.types.pop("geometry_msgs/msg/Point")
    types.register(get_types_from_msg("float32 x\nfloat32 y", "geometry_msgs/msg/Point"))
    path = tmp_path / "bag"
    with BagWriter(path, types=types) as writer:
        for number in range(10):
            writer.write("/torque", "maker_of_arms/msg/Torque", START_NS + number * MS, bytes(12))
            writer.write("/point", "geometry_msgs/msg/Point", START_NS + number * MS, bytes(12))
            writer.write("/joint_states", "sensor_msgs/msg/JointState", *_logged(number))
    with Listener("/joint_states") as listener:
        report = play(path)
        assert len(listener.states(10)) == 10
    assert report.sent == {"/joint_states": 10}
    assert report.skipped == {
        "/point": "its definition of geometry_msgs/msg/Point is not the installed one",
        "/torque": "its type maker_of_arms/msg/Torque is not installed",
    }


def _logged(number: int) -> tuple[int, bytes]:
    return START_NS + number * MS, joint_state_message(state(number))


def test_a_topic_of_two_types_is_skipped(tmp_path: Path) -> None:
    path = tmp_path / "bag"
    with BagWriter(path) as writer:
        writer.write("/mixed", TEXT, START_NS, serialized(TEXT, {"data": "1"}))
        writer.write("/mixed", "std_msgs/msg/Float64", START_NS, serialized("std_msgs/msg/Float64", {"data": 1.0}))
        writer.write_joint_states("/joint_states", [state(1)])
    with Listener("/joint_states"):
        report = play(path)
    assert report.sent == {"/joint_states": 1}
    assert report.skipped == {"/mixed": "it holds messages of more than one type"}


def test_a_span_without_messages_moves_only_the_clock(tmp_path: Path) -> None:
    path = tmp_path / "bag"
    with BagWriter(path) as writer:
        writer.write_joint_states("/joint_states", [state(0), state(1000)])
    with Listener("/joint_states", "/clock") as listener:
        report = play(path, rate=10.0, start_s=0.2, duration_s=0.5)
        clock = listener.clock(50)
    assert report.sent == {"/joint_states": 0}
    assert clock == [START_NS + 200 * MS + step * 10 * MS for step in range(50)]


def test_what_live_nodes_publish_themselves_is_left_out_unless_asked_for(tmp_path: Path) -> None:
    number = serialized("std_msgs/msg/Float64", {"data": 1.0})
    path = tmp_path / "bag"
    with BagWriter(path) as writer:
        writer.write("/clock", "rosgraph_msgs/msg/Clock", START_NS, serialize_message(Clock()))
        writer.write("/cell/allowable_speed", "std_msgs/msg/Float64", START_NS, number)
        writer.write_joint_states("/joint_states", [state(1)])
    with Listener("/joint_states"):
        report = play(path)
    assert report.sent == {"/joint_states": 1}
    assert report.skipped == {
        "/cell/allowable_speed": "the live nodes publish it",
        "/clock": "the replay publishes its own clock",
    }
    Listener.TYPES = {**Listener.TYPES, "/cell/allowable_speed": Float64}
    with Listener("/cell/allowable_speed") as listener:
        report = play(path, topics=("/cell/allowable_speed",))
        listener.wait("/cell/allowable_speed", 1)
    assert report.skipped["/joint_states"] == "not selected"


def test_any_topic_of_joint_states_can_be_published_as_joint_states(tmp_path: Path) -> None:
    path = tmp_path / "bag"
    with BagWriter(path) as writer:
        writer.write_joint_states("/joint_states", [state(number) for number in range(5)])
        writer.write_joint_states("/arm/joint_states", [state(number) for number in range(5, 9)])
    with Listener("/joint_states") as listener:
        report = play(path, joint_state_topic="/arm/joint_states")
        assert same(listener.states(4), [state(number) for number in range(5, 9)])
    assert report.sent == {"/joint_states": 4}
    assert report.skipped == {"/joint_states": "/arm/joint_states is published in its place"}


def test_rate_0_needs_joint_states_to_set_the_pace(bag: Path) -> None:
    with pytest.raises(SettingsError, match="rate = 0: nothing is published as /joint_states"):
        play(bag, rate=0.0, topics=("/remark",))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"topics": ("/wrist",)}, r"bag: no topic /wrist; expected one of /joint_states, /remark"),
        ({"joint_state_topic": "/wrist"}, r"bag: no topic /wrist; expected one of /joint_states, /remark"),
        ({"joint_state_topic": "/remark"}, r"bag: /remark holds no joint states; topics that do: /joint_states"),
    ],
)
def test_topics_that_are_not_there_are_refused(bag: Path, options: dict[str, Any], message: str) -> None:
    with pytest.raises(BagError, match=message):
        play(bag, **options)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("rate", -1.0),
        ("rate", float("nan")),
        ("rate", float("inf")),
        ("start_s", -0.1),
        ("start_s", float("nan")),
        ("duration_s", 0.0),
        ("duration_s", float("nan")),
        ("passes", -1),
        ("ready_timeout_s", -1.0),
        ("answer_timeout_s", 0.0),
    ],
)
def test_options_that_mean_nothing_are_refused(tmp_path: Path, key: str, value: float) -> None:
    options: dict[str, Any] = {key: value}
    with pytest.raises(SettingsError, match=f"replay: {key.removesuffix('_s')} = {value}: must be .*"):
        ReplayOptions(tmp_path, **options)


def test_header_stamps_from_another_clock_are_warned_of(tmp_path: Path) -> None:
    path = tmp_path / "bag"
    with BagWriter(path) as writer:
        for number in range(10):
            log_time_ns, data = _logged(number)
            writer.write("/joint_states", "sensor_msgs/msg/JointState", log_time_ns + 200_000 * MS * (number > 5), data)
    with Listener("/joint_states"):
        report = play(path, rate=4000.0)
    (warning,) = report.warnings
    assert "4 of 10 joint states have header stamps up to 200.000 s behind their log time" in warning


def test_progress_goes_from_the_start_towards_the_end(bag: Path) -> None:
    seen: list[ReplayProgress] = []
    with Listener("/joint_states", answers=True, slowness_s=0.003):  # so it takes 0.3 s at least
        play(bag, seen.append, rate=0.0)
    assert seen[0].time_s == 0.0
    assert len(seen) > 1
    assert all(a.time_s <= b.time_s and a.sent <= b.sent for a, b in pairwise(seen))
    assert {progress.span_s for progress in seen} == {0.099}


CHILD = """
import json, sys
from pathlib import Path
from scara_effmass.nodes.replay import ReplayOptions, replay
report = replay(ReplayOptions(Path(sys.argv[1]), passes=0, ready_timeout_s=600.0))
print(json.dumps({"interrupted": report.interrupted, "sent": report.sent, "passes": report.passes}))
"""


@pytest.fixture
def endless(bag: Path) -> Iterator[subprocess.Popen[str]]:
    child = subprocess.Popen(
        [sys.executable, "-c", CHILD, str(bag)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    yield child
    if child.poll() is None:
        child.kill()
    child.communicate()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_an_endless_replay_cleanly(endless: subprocess.Popen[str], number: signal.Signals) -> None:
    with Listener("/joint_states") as listener:
        listener.wait("/joint_states", 250)
        endless.send_signal(number)
        output, errors = endless.communicate(timeout=PATIENCE_S)
    assert (endless.returncode, errors) == (0, "")
    report = json.loads(output)
    assert report["interrupted"] is True
    assert report["passes"] >= 3
    assert report["sent"]["/joint_states"] >= 250


def test_a_signal_ends_the_wait_for_somebody_who_listens(bag: Path) -> None:
    code = CHILD.replace("passes=0", "passes=1")
    child = subprocess.Popen([sys.executable, "-c", code, str(bag)], stdout=subprocess.PIPE, text=True)
    with Listener("/remark") as listener:  # which finds the topic only once the replay waits
        listener.wait_matched()
        child.send_signal(signal.SIGINT)
        output, _ = child.communicate(timeout=PATIENCE_S)
    assert child.returncode == 0
    assert json.loads(output)["interrupted"] is True
    assert listener.heard == {"/remark": []}


times = st.lists(st.integers(0, 100 * MS), max_size=30).map(sorted)


@given(times, st.integers(0, 100 * MS))
def test_the_timeline_holds_all_messages_in_order_and_leaves_no_gap(log_times: list[int], tail: int) -> None:
    end = (log_times[-1] if log_times else 0) + tail
    messages = [RawMessage("/topic", TEXT, time_ns, bytes([index])) for index, time_ns in enumerate(log_times)]
    due = list(timeline(messages, 0, end))
    assert [each.message for each in due if each.message] == messages
    assert all(each.time_ns == each.message.log_time_ns for each in due if each.message)
    moments = [each.time_ns for each in due] + [end]
    assert moments[0] == 0
    assert all(0 <= b - a <= CLOCK_STEP_NS for a, b in pairwise(moments))

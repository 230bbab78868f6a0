# SPDX-License-Identifier: Apache-2.0
"""The recorder on DDS: published messages are recorded byte by byte, with any QoS of their publishers."""

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader
from rosgraph_msgs.msg import Clock
from scara_effmass_msgs.msg import ForceBlock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, String

from scara_effmass.bags.files import open_bag
from scara_effmass.bags.recorder import BagRecorder, LossCounts, RecordingReport
from scara_effmass.errors import OutputError, SettingsError
from scara_effmass.nodes.record import QUEUE_DEPTH, RecordReport, TopicRecorder, record
from scara_effmass.wire.message_types import message_class, message_definition
from test.nodes.conftest import TIMEOUT_S, ros_node

DEEP = QoSProfile(depth=1000)
LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BEST_EFFORT = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)


class Rig:
    """A publishing node and a recorder."""

    def __init__(self, bag: Path, node: Node) -> None:
        self.node = node
        self.bag = bag
        self.warnings: list[str] = []
        self.report: RecordingReport | None = None

    def recorded(self, *topics: str) -> int:
        """Return the number of messages so far, of `topics` (none: all)."""
        reports = self.report.topics if self.report else {}
        return sum(report.recorded for topic, report in reports.items() if not topics or topic in topics)

    def record(self, script: Iterator[object], stop_signal: int = signal.SIGINT, **options: Any) -> RecordReport:  # noqa: ANN401
        """Record while advancing `script` at each progress call; end by a signal after its last step."""

        def step(report: RecordingReport, seconds: float) -> None:
            assert seconds < TIMEOUT_S, f"{report}, {self.warnings}"
            self.report = report
            if next(script, self) is self:
                os.kill(os.getpid(), stop_signal)

        return record(self.bag, progress=step, warn=self.warnings.append, **options)

    def read(self) -> list[tuple[str, bytes]]:
        """Return the recorded messages; rosbags must read the same."""
        with open_bag(self.bag) as bag:
            assert bag.losses == ()
            messages = [(raw.topic, raw.data) for raw in bag.messages()]
        with AnyReader([self.bag]) as reader:
            for connection, _, data in reader.messages():
                reader.deserialize(data, connection.msgtype)
            assert sorted((c.topic, data) for c, _, data in reader.messages()) == sorted(messages)
        return messages


@pytest.fixture
def make_rig(tmp_path: Path, own_domain: int) -> Iterator[Callable[..., Rig]]:  # noqa: ARG001 - sets the domain
    with ExitStack() as stack:
        yield lambda namespace="/": Rig(tmp_path / "bag", stack.enter_context(ros_node("publisher", namespace)))


@pytest.fixture
def rig(make_rig: Callable[..., Rig]) -> Rig:
    return make_rig()


def have_subscribers(*publishers: Publisher) -> bool:
    return all(publisher.get_subscription_count() for publisher in publishers)


def until(condition: Callable[[], object]) -> None:
    """Wait for discovery, which runs in a thread of the middleware."""
    deadline = time.monotonic() + TIMEOUT_S
    while not condition():
        assert time.monotonic() < deadline
        threading.Event().wait(0.01)


def joint_state(number: int) -> bytes:
    # No field is empty: then serialize_message, unlike publish, adds bytes that rosbags rejects.
    values = [0.1 * number, 2.0]
    message = JointState(name=["joint1", "joint2"], position=values, velocity=values, effort=values)
    message.header.stamp.sec = number
    return bytes(serialize_message(message))


def force(number: int) -> bytes:
    samples = [0.5 * number] * 1280
    message = ForceBlock(first_sample=1280 * number, force=samples, saturated_samples=[number], source="test")
    return bytes(serialize_message(message))


def text(content: str) -> bytes:
    return bytes(serialize_message(String(data=content)))


def test_messages_of_the_suite_are_recorded_byte_by_byte(rig: Rig) -> None:
    published = [("/joint_states", joint_state(i)) for i in range(500)]
    published += [(topic, force(i)) for i in range(20) for topic in ("/force", "/force/ai1")]

    def script() -> Iterator[None]:
        publishers = {
            "/joint_states": rig.node.create_publisher(JointState, "joint_states", DEEP),
            "/force": rig.node.create_publisher(ForceBlock, "force", DEEP),
            "/force/ai1": rig.node.create_publisher(ForceBlock, "force/ai1", DEEP),
        }
        rig.node.create_publisher(String, "other", DEEP)  # not a topic of the suite
        while not have_subscribers(*publishers.values()):
            yield
        for topic, data in published:
            publishers[topic].publish(data)
        while rig.recorded() < len(published):
            yield

    report = rig.record(script())
    assert sorted(rig.read()) == sorted(published)
    counts = {name: topic.recorded for name, topic in report.recording.topics.items()}
    assert counts == {"/joint_states": 500, "/force": 20, "/force/ai1": 20}
    assert (report.recording.lost, report.refused, rig.warnings) == (0, {}, [])
    assert "/tf" in report.unpublished
    assert not report.simulated_time


def test_messages_received_before_the_stop_signal_are_recorded(rig: Rig) -> None:
    published = [("/notes", text(str(number))) for number in range(100)]

    def script() -> Iterator[None]:
        notes = rig.node.create_publisher(String, "notes", DEEP)
        while not have_subscribers(notes):
            yield
        for _, data in published:
            notes.publish(data)
        # The recorder cannot take them before the script ends and stops it.
        assert notes.wait_for_all_acked(Duration(seconds=TIMEOUT_S))

    rig.record(script(), topics=("notes",))
    assert rig.read() == published


def test_topic_that_is_late_is_waited_for(rig: Rig) -> None:
    def script() -> Iterator[None]:
        publisher = rig.node.create_publisher(Float64, "data", DEEP)
        while not have_subscribers(publisher):
            yield
        while rig.recorded() < 15:
            publisher.publish(Float64())
            yield
        silent_since = time.monotonic()
        threading.Timer(2.2, publisher.publish, [Float64(data=7.0)]).start()  # as if it were held back
        while time.monotonic() < silent_since + 1.7:
            yield

    started = time.monotonic()
    report = rig.record(script(), topics=("data",))
    assert rig.read()[-1] == ("/data", serialize_message(Float64(data=7.0)))
    assert time.monotonic() - started < report.seconds + 2.0  # not all the time in which messages are repeated


def test_earlier_latched_message_is_recorded(rig: Rig) -> None:
    publisher = rig.node.create_publisher(String, "robot_description", LATCHED)
    publisher.publish(text("a robot"))

    def script() -> Iterator[None]:
        while not rig.recorded():
            yield

    rig.record(script())
    assert rig.read() == [("/robot_description", text("a robot"))]
    with AnyReader([rig.bag]) as reader:
        (connection,) = reader.connections
    (offered,) = connection.ext.offered_qos_profiles  # type: ignore[union-attr]
    assert (offered.durability.name, offered.reliability.name) == ("TRANSIENT_LOCAL", "RELIABLE")


def test_later_best_effort_publisher_is_recorded(rig: Rig) -> None:
    def script() -> Iterator[None]:
        reliable = rig.node.create_publisher(String, "notes", DEEP)
        while not have_subscribers(reliable):
            yield
        best_effort = rig.node.create_publisher(String, "notes", BEST_EFFORT)
        while not have_subscribers(best_effort, reliable):
            yield
        while rig.recorded() < 2:  # best effort may lose messages
            best_effort.publish(text("hello"))
            reliable.publish(text("hello"))
            yield

    report = rig.record(script(), topics=("notes",))
    assert {data for _, data in rig.read()} == {text("hello")}
    assert list(report.recording.topics) == ["/notes"]
    assert any("subscribing again" in line for line in rig.warnings)


def test_all_topics_records_all_but_hidden_topics(rig: Rig) -> None:
    def script() -> Iterator[None]:
        publishers = [
            rig.node.create_publisher(Float64, name, BEST_EFFORT) for name in ("/a", "/b/c", "/_hidden", "/b/_hidden")
        ]
        while not have_subscribers(*publishers[:2]):
            yield
        while not (rig.recorded("/a") and rig.recorded("/b/c")):
            for publisher in publishers:
                publisher.publish(Float64(data=1.0))
            yield

    report = rig.record(script(), topics=())
    names = set(report.recording.topics)
    assert {"/a", "/b/c", "/rosout"} <= names
    assert not any("hidden" in name for name in names)
    assert report.unpublished == ()


def test_topics_follow_namespace_and_remapping(make_rig: Callable[..., Rig]) -> None:
    rig = make_rig("/namespace")

    def script() -> Iterator[None]:
        publishers = [rig.node.create_publisher(String, name, DEEP) for name in ("a", "/b", "other")]
        while not have_subscribers(*publishers):
            yield
        for publisher in publishers:
            publisher.publish(String(data=publisher.topic_name))
        while rig.recorded() < 3:
            yield

    arguments = ("--ros-args", "-r", "__ns:=/namespace", "-r", "c:=other")
    rig.record(script(), topics=("a", "/b", "c"), ros_arguments=arguments)
    assert sorted(rig.read()) == [(name, text(name)) for name in ("/b", "/namespace/a", "/namespace/other")]


def test_simulated_time_gives_log_times_of_the_clock(rig: Rig) -> None:
    def script() -> Iterator[None]:
        clock = rig.node.create_publisher(Clock, "/clock", DEEP)
        notes = rig.node.create_publisher(String, "notes", DEEP)
        while not have_subscribers(clock):
            yield
        for _ in range(5):
            assert not have_subscribers(notes), "subscribed before /clock"
            yield
        while not have_subscribers(notes):
            now = Clock()
            now.clock.sec = 1000
            clock.publish(now)
            yield
        notes.publish(text("now"))
        while not rig.recorded():
            yield

    arguments = ("--ros-args", "-p", "use_sim_time:=true")
    assert rig.record(script(), topics=("notes",), ros_arguments=arguments).simulated_time
    with open_bag(rig.bag) as bag:
        assert [raw.log_time_ns for raw in bag.messages()] == [1000 * 10**9]


def test_topic_without_installed_type_is_refused_and_others_are_recorded(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    def installed(message_type: str) -> type | None:
        return None if message_type == "std_msgs/msg/Float64" else message_class(message_type)

    monkeypatch.setattr("scara_effmass.nodes.record.message_class", installed)

    def script() -> Iterator[None]:
        number = rig.node.create_publisher(Float64, "number", DEEP)
        notes = rig.node.create_publisher(String, "notes", DEEP)
        while not have_subscribers(notes):
            yield
        notes.publish(text("here"))
        while not rig.recorded() or not rig.warnings:
            yield
        del number

    report = rig.record(script(), topics=("number", "notes"))
    assert rig.read() == [("/notes", text("here"))]
    assert report.refused == {"/number": "its type std_msgs/msg/Float64 is not installed; install std_msgs"}
    assert rig.warnings == [f"/number: not recorded: {report.refused['/number']}"]
    assert report.unpublished == ()


def test_topic_of_several_types_is_refused(make_rig: Callable[..., Rig]) -> None:
    rig, other = make_rig(), make_rig()
    publishers = rig.node.create_publisher(String, "two", DEEP), other.node.create_publisher(JointState, "two", DEEP)
    until(lambda: len(rig.node.get_publishers_info_by_topic("/two")) == len(publishers))
    with BagRecorder(rig.bag) as recorder:
        topic_recorder = TopicRecorder(rig.node, recorder, ["/two"], rig.warnings.append)
        topic_recorder.discover()
    (reason,) = topic_recorder.refused.values()
    assert reason == "it has publishers of several types: sensor_msgs/msg/JointState, std_msgs/msg/String"


def test_later_type_of_a_topic_is_refused_and_the_first_is_recorded(make_rig: Callable[..., Rig]) -> None:
    rig, other = make_rig(), make_rig()
    number = rig.node.create_publisher(Float64, "load", LATCHED)
    number.publish(Float64(data=1.0))

    def script() -> Iterator[None]:
        while rig.recorded() < 1:
            yield
        other.node.create_publisher(String, "load", DEEP)
        while not rig.warnings:
            yield

    report = rig.record(script(), topics=("load",))
    reason = "it is also published as std_msgs/msg/String; only std_msgs/msg/Float64 is recorded"
    assert report.refused == {"/load": reason}
    assert rig.warnings == [f"/load: {reason}"]
    assert report.unpublished == ()
    assert [topic for topic, _ in rig.read()] == ["/load"]


def test_messages_that_wait_longer_than_a_second_are_recorded(rig: Rig) -> None:
    """The middleware drops what exceeds the queue without a word."""
    backlog = QUEUE_DEPTH

    def script() -> Iterator[None]:
        publisher = rig.node.create_publisher(String, "notes", QoSProfile(depth=backlog))
        while not have_subscribers(publisher):
            yield
        for number in range(backlog):  # while the recorder does not take any
            publisher.publish(text(str(number)))
        assert publisher.wait_for_all_acked(Duration(seconds=TIMEOUT_S))
        while rig.recorded() < backlog:
            yield

    report = rig.record(script(), topics=("notes",)).recording.topics["/notes"]
    assert (report.recorded, report.lost) == (backlog, LossCounts())


def test_messages_lost_by_the_middleware_are_counted_by_their_numbers(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    callbacks: list[Callable[..., None]] = []

    def create_subscription(
        _kind: type,
        _topic: str,
        callback: Callable[..., None],
        *_: object,
        event_callbacks: SubscriptionEventCallbacks,
        **__: object,
    ) -> None:
        callbacks.append(callback)
        assert event_callbacks.message_lost is None  # taking it can lock the process for ever

    monkeypatch.setattr(rig.node, "create_subscription", create_subscription)
    publisher = rig.node.create_publisher(String, "notes", DEEP)
    until(lambda: rig.node.get_publishers_info_by_topic("/notes"))
    with BagRecorder(rig.bag) as recorder:
        count_lost = recorder.count_lost_by_middleware
        topic_recorder = TopicRecorder(rig.node, recorder, ["/notes"], rig.warnings.append, count_lost=count_lost)
        topic_recorder.discover()
        for number in (7, 8, 11, 12, 1, 2, 5):  # the publisher starts again after 12
            callbacks[0](text(str(number)), {"publication_sequence_number": number, "source_timestamp": 0})
    assert recorder.report().topics["/notes"].lost == LossCounts(middleware=4)
    assert publisher.topic_name == "/notes"


def test_second_signal_does_not_interrupt_completion(rig: Rig) -> None:
    handlers = signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)

    def script() -> Iterator[None]:
        os.kill(os.getpid(), signal.SIGTERM)
        yield

    rig.record(script(), stop_signal=signal.SIGTERM)
    assert (rig.bag / "metadata.yaml").exists()
    assert (signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)) == handlers


def test_recorder_ends_after_its_duration(rig: Rig) -> None:
    report = record(rig.bag, duration_s=0.3)
    assert 0.3 <= report.seconds < TIMEOUT_S
    assert report.recording.files == ("bag_0.mcap",)


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"topics": ("no topic",)}, "record: topic 'no topic': .*must not contain characters other than"),
        ({"ros_arguments": ("--ros-args", "--nonsense")}, "ROS arguments: .*--nonsense"),
        ({"ros_arguments": ("--ros-args", "-p", "speed:=1")}, "recorder: no parameter 'speed'"),
    ],
)
def test_invalid_options_are_refused_before_anything_is_written(rig: Rig, options: dict[str, Any], reason: str) -> None:
    with pytest.raises(SettingsError, match=reason):
        record(rig.bag, **options)
    assert not rig.bag.exists()


def test_existing_folder_is_refused(rig: Rig) -> None:
    rig.bag.mkdir()
    with pytest.raises(OutputError, match="bag: already exists"):
        record(rig.bag)


def test_installed_classes_and_definitions() -> None:
    assert "float64[] position" in message_definition("sensor_msgs/msg/JointState")
    assert "first_sample" in message_definition("scara_effmass_msgs/msg/ForceBlock")
    assert message_definition("lab_msgs/msg/Nope") == message_definition("std_msgs/srv/Odd") == ""
    assert message_class("std_msgs/msg/String") is String
    assert message_class("lab_msgs/msg/Nope") is message_class("std_msgs/msg/Nope") is None
    assert message_class("os/msg/Path") is None

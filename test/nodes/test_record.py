"""The recorder on real DDS: what was published is recorded byte by byte, whatever its publishers offer."""

from __future__ import annotations

import os
import signal
import threading
import time
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
import rclpy
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from rclpy.signals import SignalHandlerOptions
from rosbags.highlevel import AnyReader
from rosgraph_msgs.msg import Clock
from scara_effmass_msgs.msg import ForceBlock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, String

from scara_effmass.bags.files import open_bag
from scara_effmass.bags.recorder import BagRecorder
from scara_effmass.bags.recording_report import LossCounts
from scara_effmass.errors import OutputError, SettingsError
from scara_effmass.nodes import topic_recorder
from scara_effmass.nodes.record import RecordOptions, record
from scara_effmass.nodes.topic_recorder import TopicRecorder
from scara_effmass.wire.message_types import message_class, message_definition

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from rclpy.event_handler import SubscriptionEventCallbacks
    from rclpy.publisher import Publisher

    from scara_effmass.bags.recording_report import RecordingReport
    from scara_effmass.nodes.record import RecordReport

PATIENCE_S = 120.0
DEEP = QoSProfile(depth=1000)
LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BEST_EFFORT = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)


class Cell:
    """A node that publishes, in a domain of its own, and a recorder that is driven along while it records."""

    def __init__(self, bag: Path, namespace: str) -> None:
        context = Context()
        rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node("cell", context=context, namespace=namespace)
        self.bag = bag
        self.warnings: list[str] = []
        self.now: RecordingReport | None = None
        self._context = context

    def close(self) -> None:
        self.node.destroy_node()
        self._context.try_shutdown()

    def recorded(self, *topics: str) -> int:
        """Messages so far, of all topics or of some."""
        reports = self.now.topics if self.now else {}
        return sum(report.recorded for topic, report in reports.items() if not topics or topic in topics)

    def record(self, script: Iterator[object], ending: int = signal.SIGINT, **options: Any) -> RecordReport:  # noqa: ANN401
        """Record while `script` goes on, step by step between what comes; end by a signal when it is through."""

        def step(now: RecordingReport, seconds: float) -> None:
            assert seconds < PATIENCE_S, f"nothing came of it: {now}, {self.warnings}"
            self.now = now
            if next(script, self) is self:
                os.kill(os.getpid(), ending)

        return record(RecordOptions(self.bag, **options), step, self.warnings.append)

    def read(self) -> list[tuple[str, bytes]]:
        """What was recorded, by us; rosbags must see the same."""
        with open_bag(self.bag) as bag:
            assert bag.losses == ()
            found = [(raw.topic, raw.data) for raw in bag.messages()]
        with AnyReader([self.bag]) as reader:
            for connection, _, data in reader.messages():
                reader.deserialize(data, connection.msgtype)
            assert sorted((c.topic, data) for c, _, data in reader.messages()) == sorted(found)
        return found


@pytest.fixture
def make_cell(tmp_path: Path, own_domain: int) -> Iterator[Callable[..., Cell]]:  # noqa: ARG001 - where they are
    made: list[Cell] = []

    def make(namespace: str = "/") -> Cell:
        made.append(Cell(tmp_path / "bag", namespace))
        return made[-1]

    yield make
    for cell in made:
        cell.close()


@pytest.fixture
def cell(make_cell: Callable[..., Cell]) -> Cell:
    return make_cell()


def heard(*publishers: Publisher) -> bool:
    return all(publisher.get_subscription_count() for publisher in publishers)


def until(condition: Callable[[], object]) -> None:
    """Wait for what the middleware finds out in a thread of its own."""
    began = time.monotonic()
    while not condition():
        assert time.monotonic() < began + PATIENCE_S, "nothing came of it"
        threading.Event().wait(0.01)


def joint_state(number: int) -> bytes:
    # No field is empty: serialize_message leaves bytes behind that rosbags objects to, where publishing does not.
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


def test_every_message_of_the_suite_equals_what_was_published(cell: Cell) -> None:
    published = [("/joint_states", joint_state(i)) for i in range(500)]
    published += [(topic, force(i)) for i in range(20) for topic in ("/force", "/force/ai1")]

    def script() -> Iterator[None]:
        publishers = {
            "/joint_states": cell.node.create_publisher(JointState, "joint_states", DEEP),
            "/force": cell.node.create_publisher(ForceBlock, "force", DEEP),
            "/force/ai1": cell.node.create_publisher(ForceBlock, "force/ai1", DEEP),
        }
        cell.node.create_publisher(String, "gossip", DEEP)  # not of the suite
        while not heard(*publishers.values()):
            yield
        for topic, data in published:
            publishers[topic].publish(data)
        while cell.recorded() < len(published):
            yield

    report = cell.record(script())
    assert sorted(cell.read()) == sorted(published)
    counts = {name: topic.recorded for name, topic in report.recording.topics.items()}
    assert counts == {"/joint_states": 500, "/force": 20, "/force/ai1": 20}
    assert (report.recording.lost, report.refused, cell.warnings) == (0, {}, [])
    assert "/tf" in report.unpublished
    assert not report.simulated_time


def test_what_has_come_when_it_is_told_to_stop_is_recorded(cell: Cell) -> None:
    published = [("/notes", text(str(number))) for number in range(100)]

    def script() -> Iterator[None]:
        notes = cell.node.create_publisher(String, "notes", DEEP)
        while not heard(notes):
            yield
        for _, data in published:
            notes.publish(data)
        # The recorder does nothing meanwhile, and is told to stop then.
        assert notes.wait_for_all_acked(Duration(seconds=PATIENCE_S))

    cell.record(script(), topics=("notes",))
    assert cell.read() == published


def test_what_was_latched_before_is_recorded(cell: Cell) -> None:
    publisher = cell.node.create_publisher(String, "robot_description", LATCHED)
    publisher.publish(text("a robot"))

    def script() -> Iterator[None]:
        while not cell.recorded():
            yield

    cell.record(script())
    assert cell.read() == [("/robot_description", text("a robot"))]
    with AnyReader([cell.bag]) as reader:
        (connection,) = reader.connections
    (offered,) = connection.ext.offered_qos_profiles  # type: ignore[union-attr]
    assert (offered.durability.name, offered.reliability.name) == ("TRANSIENT_LOCAL", "RELIABLE")


def test_a_publisher_that_offers_less_than_the_first_is_recorded_too(cell: Cell) -> None:
    def script() -> Iterator[None]:
        reliable = cell.node.create_publisher(String, "notes", DEEP)
        while not heard(reliable):
            yield
        best_effort = cell.node.create_publisher(String, "notes", BEST_EFFORT)
        while not heard(best_effort, reliable):
            yield
        while cell.recorded() < 2:  # nobody repeats what best effort loses
            best_effort.publish(text("hello"))
            reliable.publish(text("hello"))
            yield

    report = cell.record(script(), topics=("notes",))
    assert {data for _, data in cell.read()} == {text("hello")}
    assert list(report.recording.topics) == ["/notes"]
    assert any("subscribing again" in line for line in cell.warnings)


def test_all_but_hidden_topics_are_recorded_when_asked(cell: Cell) -> None:
    def script() -> Iterator[None]:
        publishers = [
            cell.node.create_publisher(Float64, name, BEST_EFFORT) for name in ("/a", "/b/c", "/_hidden", "/b/_hidden")
        ]
        while not heard(*publishers[:2]):
            yield
        while {"/a", "/b/c"} - set(cell.now.topics if cell.now else ()) or cell.recorded("/a", "/b/c") < 2:
            for publisher in publishers:
                publisher.publish(Float64(data=1.0))
            yield

    report = cell.record(script(), all_topics=True)
    names = set(report.recording.topics)
    assert {"/a", "/b/c", "/rosout"} <= names
    assert not any("hidden" in name for name in names)
    assert report.unpublished == ()


def test_relative_names_follow_namespace_and_remapping(make_cell: Callable[..., Cell]) -> None:
    cell = make_cell("/cell")

    def script() -> Iterator[None]:
        publishers = [cell.node.create_publisher(String, name, DEEP) for name in ("a", "/b", "other")]
        while not heard(*publishers):
            yield
        for publisher in publishers:
            publisher.publish(String(data=publisher.topic_name))
        while cell.recorded() < 3:
            yield

    words = ("--ros-args", "-r", "__ns:=/cell", "-r", "c:=other")
    cell.record(script(), topics=("a", "/b", "c"), ros_arguments=words)
    assert sorted(cell.read()) == [(name, text(name)) for name in ("/b", "/cell/a", "/cell/other")]


def test_on_simulated_time_log_times_are_of_the_clock(cell: Cell) -> None:
    def script() -> Iterator[None]:
        clock = cell.node.create_publisher(Clock, "/clock", DEEP)
        notes = cell.node.create_publisher(String, "notes", DEEP)
        while not heard(clock):
            yield
        for _ in range(5):
            assert not heard(notes), "it has no time to record at"
            yield
        while not heard(notes):
            now = Clock()
            now.clock.sec = 1000
            clock.publish(now)
            yield
        notes.publish(text("now"))
        while not cell.recorded():
            yield

    words = ("--ros-args", "-p", "use_sim_time:=true")
    assert cell.record(script(), topics=("notes",), ros_arguments=words).simulated_time
    with open_bag(cell.bag) as bag:
        assert [raw.log_time_ns for raw in bag.messages()] == [1000 * 10**9]


def test_a_topic_that_cannot_be_recorded_is_named_and_the_others_are(
    cell: Cell, monkeypatch: pytest.MonkeyPatch
) -> None:
    def installed(kind: str) -> type | None:
        return None if kind == "std_msgs/msg/Float64" else message_class(kind)

    monkeypatch.setattr(topic_recorder, "message_class", installed)

    def script() -> Iterator[None]:
        number = cell.node.create_publisher(Float64, "number", DEEP)
        notes = cell.node.create_publisher(String, "notes", DEEP)
        while not heard(notes):
            yield
        notes.publish(text("here"))
        while not cell.recorded() or not cell.warnings:
            yield
        del number

    report = cell.record(script(), topics=("number", "notes"))
    assert cell.read() == [("/notes", text("here"))]
    assert report.refused == {"/number": "its type std_msgs/msg/Float64 is not installed; install std_msgs"}
    assert cell.warnings == [f"/number: not recorded: {report.refused['/number']}"]
    assert report.unpublished == ()


def test_a_topic_of_several_types_is_refused(make_cell: Callable[..., Cell]) -> None:
    cell, other = make_cell(), make_cell()
    publishers = cell.node.create_publisher(String, "two", DEEP), other.node.create_publisher(JointState, "two", DEEP)
    until(lambda: len(cell.node.get_publishers_info_by_topic("/two")) == len(publishers))
    with BagRecorder(cell.bag) as recording:
        topic_recorder = TopicRecorder(cell.node, recording, ["/two"], cell.warnings.append)
        topic_recorder.discover()
    (reason,) = topic_recorder.refused.values()
    assert reason == "it has publishers of several types: sensor_msgs/msg/JointState, std_msgs/msg/String"


def test_a_topic_that_gets_another_type_is_named_and_the_first_one_is_kept(make_cell: Callable[..., Cell]) -> None:
    cell, other = make_cell(), make_cell()
    number = cell.node.create_publisher(Float64, "load", LATCHED)
    number.publish(Float64(data=1.0))

    def script() -> Iterator[None]:
        while cell.recorded() < 1:
            yield
        other.node.create_publisher(String, "load", DEEP)
        while not cell.warnings:
            yield

    report = cell.record(script(), topics=("load",))
    reason = "it is also published as std_msgs/msg/String; only std_msgs/msg/Float64 is recorded"
    assert report.refused == {"/load": reason}
    assert cell.warnings == [f"/load: {reason}"]
    assert report.unpublished == ()
    assert [topic for topic, _ in cell.read()] == ["/load"]


def test_messages_lost_by_the_middleware_are_counted(cell: Cell, monkeypatch: pytest.MonkeyPatch) -> None:
    subscribe = cell.node.create_subscription
    callbacks: list[SubscriptionEventCallbacks] = []

    def create_subscription(*args: Any, event_callbacks: SubscriptionEventCallbacks, **options: Any) -> object:  # noqa: ANN401
        callbacks.append(event_callbacks)
        return subscribe(*args, event_callbacks=event_callbacks, **options)

    monkeypatch.setattr(cell.node, "create_subscription", create_subscription)
    publisher = cell.node.create_publisher(String, "notes", DEEP)
    until(lambda: cell.node.get_publishers_info_by_topic("/notes"))
    with BagRecorder(cell.bag) as recording:
        topic_recorder = TopicRecorder(cell.node, recording, ["/notes"], cell.warnings.append)
        topic_recorder.discover()
        on_message_lost = callbacks[0].message_lost
        assert on_message_lost is not None
        for change in (3, 2):
            on_message_lost(SimpleNamespace(total_count=9, total_count_change=change))
    assert recording.report().topics["/notes"].lost == LossCounts(middleware=5)
    assert publisher.topic_name == "/notes"


def test_the_second_signal_does_not_break_into_the_end(cell: Cell) -> None:
    before = signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)

    def script() -> Iterator[None]:
        os.kill(os.getpid(), signal.SIGTERM)
        yield

    cell.record(script(), ending=signal.SIGTERM)
    assert (cell.bag / "metadata.yaml").exists()
    assert (signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)) == before


def test_it_ends_after_its_duration(cell: Cell) -> None:
    report = record(RecordOptions(cell.bag, duration_s=0.3))
    assert 0.3 <= report.seconds < PATIENCE_S
    assert report.recording.files == ("bag_0.mcap",)


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"duration_s": 0.0}, "record: duration = 0.0: must be > 0 s"),
        ({"duration_s": float("nan")}, "record: duration = nan: must be > 0"),
        ({"all_topics": True, "topics": ("a",)}, "record: topics = 'a': must be empty with --all"),
        ({"topics": ("no topic",)}, "record: topic 'no topic': .*must not contain characters other than"),
        ({"ros_arguments": ("--ros-args", "--nonsense")}, "ROS arguments: .*--nonsense"),
        ({"ros_arguments": ("--ros-args", "-p", "speed:=1")}, "recorder: no parameter 'speed'"),
    ],
)
def test_what_cannot_start_says_why_and_leaves_nothing(cell: Cell, options: dict[str, Any], reason: str) -> None:
    with pytest.raises(SettingsError, match=reason):
        record(RecordOptions(cell.bag, **options))
    assert not cell.bag.exists()


def test_a_place_that_is_taken_is_refused(cell: Cell) -> None:
    cell.bag.mkdir()
    with pytest.raises(OutputError, match="bag: already exists"):
        record(RecordOptions(cell.bag))


def test_installed_definitions_are_found() -> None:
    assert "float64[] position" in message_definition("sensor_msgs/msg/JointState")
    assert "first_sample" in message_definition("scara_effmass_msgs/msg/ForceBlock")
    assert message_definition("lab_msgs/msg/Nope") == message_definition("std_msgs/srv/Odd") == ""
    assert message_class("std_msgs/msg/String") is String
    assert message_class("lab_msgs/msg/Nope") is message_class("std_msgs/msg/Nope") is None
    assert message_class("os/msg/Path") is None

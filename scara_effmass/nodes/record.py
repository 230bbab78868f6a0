"""The recorder: live topics, as serialized bytes, into a recording that survives a crash.

The log time of a message is when this process got it, on the node's clock: system time, or with `use_sim_time` the
time of /clock, for whose first message it waits.
"""

from __future__ import annotations

import math
import signal
import threading
import time
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import rclpy
from pydantic import BaseModel
from rclpy.context import Context
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from scara_effmass.bags.definitions import known_types
from scara_effmass.bags.recording import BagRecorder
from scara_effmass.bags.recording_options import RecordingOptions
from scara_effmass.errors import SettingsError
from scara_effmass.nodes import parameters
from scara_effmass.nodes.lifecycle import spin_for
from scara_effmass.nodes.topic_recorder import TopicRecorder, resolved
from scara_effmass.wire.topics import FORCE_OUTPUTS, RECORDED

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path
    from types import FrameType

    from scara_effmass.bags.recording_report import RecordingReport

_SLICE_S = 0.1
"""How often it looks for new topics, and whether it has been told to stop."""
_QUEUED_S = 10.0
"""How long it may take, at the end, to record what has come already."""
_SIGNALS = (signal.SIGINT, signal.SIGTERM)


@dataclass(frozen=True, slots=True)
class RecordOptions:
    """What is recorded, and where to. Raises SettingsError for values that cannot be used."""

    folder: Path
    topics: tuple[str, ...] = ()
    """None: those of the suite."""
    everything: bool = False
    """Record all topics but hidden ones, with a token that begins with an underscore."""
    duration_s: float = math.inf
    overwrite: bool = False
    recording: RecordingOptions = field(default_factory=RecordingOptions)
    ros_arguments: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.duration_s > 0.0:
            raise SettingsError(f"record: duration = {self.duration_s}: more than 0 would be right")
        if self.everything and self.topics:
            raise SettingsError(
                f"record: topics = {self.topics[0]!r}: --all records every topic; leave out one of both"
            )


@dataclass(frozen=True, slots=True)
class RecordReport:
    """What was recorded."""

    recording: RecordingReport
    seconds: float
    simulated_time: bool
    """Whether log times are of /clock."""
    refused: Mapping[str, str]
    """Topics that could not be recorded, and why."""
    unheard: tuple[str, ...]
    """Topics that nobody published."""


def record(
    options: RecordOptions,
    progress: Callable[[RecordingReport, float], None] = lambda *_: None,
    say: Callable[[str], None] = lambda _: None,
) -> RecordReport:
    """Record until SIGINT, SIGTERM, or the end of `duration_s`; the recording is complete then.

    `progress` is called about ten times a second with the report so far and the seconds since the start; `say` with
    what a person should know, also from another thread. It runs in a ROS context of its own.
    Raises SettingsError and OutputError when it cannot start, OutputError when it had to break off.
    """
    known_types()  # takes a while the first time: now, not while messages come
    with ExitStack() as kept:
        told_to_stop = kept.enter_context(_signals_noted())
        node = kept.enter_context(_node(options.ros_arguments))
        context = node.context
        topics = () if options.everything else options.topics or RECORDED
        wanted = [resolved(node, topic) for topic in topics]
        below = [resolved(node, topic) for topic in FORCE_OUTPUTS if topics is RECORDED]
        executor = EventsExecutor(context=context)
        kept.callback(executor.shutdown)
        executor.add_node(node)
        with BagRecorder(options.folder, options.recording, overwrite=options.overwrite, say=say) as recording:
            inlets = TopicRecorder(node, recording, wanted, say, below)
            began = time.monotonic()
            seconds = 0.0
            while not told_to_stop and context.ok() and recording.running and seconds < options.duration_s:
                inlets.look()
                left_s = min(options.duration_s - seconds, _SLICE_S)
                spin_for(executor, left_s)
                seconds = time.monotonic() - began
                progress(recording.report(), seconds)
            if context.ok():
                # What has come by now stands in a queue before this task.
                spin_for(executor, _QUEUED_S, executor.create_task(lambda: None).done)
            report = recording.close()
        return RecordReport(
            report,
            seconds,
            bool(node.get_parameter("use_sim_time").value),
            inlets.refused,
            tuple(sorted(set(wanted) - set(inlets.found) - inlets.refused.keys())),
        )


@contextmanager
def _signals_noted() -> Iterator[list[int]]:
    """Give a list to which SIGINT and SIGTERM are added instead of what they do; not in other threads."""
    noted: list[int] = []

    def note(number: int, _frame: FrameType | None) -> None:
        noted.append(number)

    numbers = _SIGNALS if threading.current_thread() is threading.main_thread() else ()
    before = {number: signal.signal(number, note) for number in numbers}
    try:
        yield noted
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class _NoSettings(BaseModel):
    """The recorder has no parameters but those of every node."""


@contextmanager
def _node(ros_arguments: tuple[str, ...]) -> Iterator[Node]:
    """Make the node, in a context of its own. Raises SettingsError for arguments that it does not know."""
    context = Context()
    try:
        rclpy.init(args=list(ros_arguments), context=context, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        raise SettingsError(f"ROS arguments: {' '.join(str(error).split())}") from None
    try:
        # Not among what it records: no services, no log topic.
        node = Node("recorder", context=context, start_parameter_services=False, enable_rosout=False)
        try:
            parameters.declare(node, _NoSettings)
            yield node
        finally:
            node.destroy_node()
    finally:
        context.try_shutdown()

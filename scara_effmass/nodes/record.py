# SPDX-License-Identifier: Apache-2.0
"""Record live topics, as serialized bytes, into a bag that survives a crash.

The log time of a message is its receive time on the node's clock: system time, or /clock with `use_sim_time`.
"""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from scara_effmass.bags.definitions import known_types
from scara_effmass.bags.recorder import BagRecorder
from scara_effmass.bags.recording_report import RecordingReport
from scara_effmass.bags.split_writer import RecorderOptions
from scara_effmass.nodes import parameters
from scara_effmass.nodes.client import ClientNode, spin_for
from scara_effmass.nodes.topic_recorder import TopicRecorder, resolve_topic
from scara_effmass.settings.loading import FrozenSettings
from scara_effmass.wire.topics import FORCE_OUTPUTS, RECORDED

_PERIOD_S = 0.1
"""Period of topic discovery and of the check for a stop signal."""
_DRAIN_TIMEOUT_S = 10.0
"""Maximum time to record the messages that have arrived before the end."""


@dataclass(frozen=True, slots=True)
class RecordReport:
    """Result of a recording."""

    recording: RecordingReport
    seconds: float
    simulated_time: bool
    """Whether log times are from /clock."""
    refused: Mapping[str, str]
    """Topics that could not be recorded, and why."""
    unpublished: tuple[str, ...]
    """Topics without a publisher."""


def record(
    folder: Path,
    topics: Sequence[str] = RECORDED,
    options: RecorderOptions | None = None,
    *,
    duration_s: float = math.inf,
    overwrite: bool = False,
    ros_arguments: Sequence[str] = (),
    progress: Callable[[RecordingReport, float], None] = lambda *_: None,
    warn: Callable[[str], None] = lambda _: None,
) -> RecordReport:
    """Record until SIGINT, SIGTERM or the end of `duration_s`, in a ROS context of its own.

    Without `topics`, record all except hidden ones, which have a token that begins with an underscore. `progress` is
    called about ten times a second with the report and the elapsed time [s]; `warn` is called with warnings, also from
    another thread. Raises SettingsError or OutputError.
    """
    known_types()  # slow on the first call: before messages arrive
    with ClientNode("recorder", arguments=ros_arguments) as client:
        node, context = client.node, client.context
        parameters.declare(node, FrozenSettings)  # only the parameters of every node
        names = [resolve_topic(node, topic) for topic in topics]
        parents = [resolve_topic(node, topic) for topic in FORCE_OUTPUTS if topics is RECORDED]
        with BagRecorder(folder, options, overwrite=overwrite, warn=warn) as recorder:
            topic_recorder = TopicRecorder(node, recorder, names, warn, parents, recorder.count_lost_by_middleware)
            start = time.monotonic()
            seconds = 0.0
            while not client.signals and context.ok() and recorder.is_running and seconds < duration_s:
                topic_recorder.discover()
                client.spin_for(min(duration_s - seconds, _PERIOD_S))
                seconds = time.monotonic() - start
                progress(recorder.report(), seconds)
            if context.ok():
                # This task runs after the messages that have already arrived.
                spin_for(client.executor, _DRAIN_TIMEOUT_S, client.executor.create_task(lambda: None).done)
            report = recorder.close()
        return RecordReport(
            recording=report,
            seconds=seconds,
            simulated_time=bool(node.get_parameter("use_sim_time").value),
            refused=topic_recorder.refused,
            unpublished=tuple(sorted(set(names) - set(topic_recorder.recorded) - topic_recorder.refused.keys())),
        )

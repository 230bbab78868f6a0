# SPDX-License-Identifier: Apache-2.0
"""Assess one recording: verdicts into a table, and what a summary and a report need of it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

from scara_effmass.analysis.assessment import (
    ClockSkew,
    Time,
    assess_joint_states,
    generated_description,
    joint_state_topic,
    open_velocities,
)
from scara_effmass.analysis.cross_check import cross_checked
from scara_effmass.analysis.recorded_run import RecordedForce, read_force
from scara_effmass.analysis.summary import Summary
from scara_effmass.analysis.tables import AssessmentWriter
from scara_effmass.analysis.time_series import TimeSeries, TimeSeriesBuilder
from scara_effmass.bags.files import open_bag
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.settings import MonitorSettings

MAX_WAITING = 1
"""Most batches that wait for the writer."""


@dataclass(frozen=True, slots=True)
class BagTask:
    """What to do with each recording; can be pickled. `topic` None: the only one with joint states.

    `velocity_bag` holds the velocities, if given; `report` keeps the time series and the force; `cross_check` compares
    with the decisions of a second monitor.
    """

    settings: MonitorSettings
    time: Time = Time.LIVE
    topic: str | None = None
    velocity_bag: Path | None = None
    report: bool = False
    cross_check: bool = False


@dataclass(slots=True)
class BagResult:
    """Result of one recording; can be pickled. `series` by contact point and `force` are for the report."""

    summary: Summary
    counts: dict[str, int]
    losses: tuple[str, ...]
    notes: list[tuple[str, str]]
    generated: bool = False
    force: RecordedForce | None = None
    series: Mapping[str, TimeSeries] = field(default_factory=dict)


def assess_bag(
    path: Path, task: BagTask, dynamics: RobotDynamics, table: AssessmentWriter, advance: Callable[[int, int], object]
) -> BagResult:
    """Assess the joint states of the bag at `path` with a fresh monitor and write them to `table`.

    `dynamics` is the robot of the settings. `advance` is called with a number of further joint states and their total.
    Raises BagError, SettingsError and CrossCheckError.
    """
    settings, counts = task.settings, dict.fromkeys(("joint_states", "foreign", "refused"), 0)
    with (
        open_bag(path) as bag,
        open_velocities(task.velocity_bag, task.topic, settings) as velocities,
        ExitStack() as stack,
    ):
        topic = joint_state_topic(bag, task.topic)
        total = next(t.count for t in bag.topics if t.name == topic)
        series = [TimeSeriesBuilder() for _ in dynamics.contact_points] if task.report else []
        monitor, name = Monitor(dynamics, settings), str(bag.path)
        summary, skew = Summary(round(settings.timeout * 1e9)), ClockSkew()
        batches = assess_joint_states(bag, topic, monitor, task.time, velocities, skew)
        if task.cross_check:
            reference = Monitor(dynamics, settings, use_reference=True)
            second = stack.enter_context(open_bag(path))
            others = stack.enter_context(open_velocities(task.velocity_bag, task.topic, settings))
            expected = assess_joint_states(second, topic, reference, task.time, others)
            batches = cross_checked(name, batches, expected)
        with ThreadPoolExecutor(1) as writer:
            written: deque[Future[None]] = deque()
            for states in batches:
                advance(len(states), total)
                counts["joint_states"] += len(states)
                if len(written) == MAX_WAITING:
                    written.popleft().result()
                written.append(writer.submit(table.add, name, states))
                summary.add(states, name)
                for point, builder in enumerate(series):
                    builder.add(states, point)
            for add in written:
                add.result()
        counts["joint_states"] += monitor.ignored
        counts["foreign"], counts["refused"] = monitor.ignored, monitor.rejected
        result = BagResult(summary, counts, (), list(skew.lines(settings, task.time)))
        if task.report:
            builds = (builder.build() for builder in series)
            result.series = dict(zip(dynamics.contact_points, builds, strict=True))
            result.force, result.generated = read_force(bag), bool(generated_description(bag))
        result.losses = bag.losses
    return result

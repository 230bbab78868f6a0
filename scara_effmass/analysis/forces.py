# SPDX-License-Identifier: Apache-2.0
"""Force in recordings and files: impacts, other contacts and what is in none, and the force over time around each."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scara_effmass.analysis.time_series import decimate
from scara_effmass.bags.bag import Bag
from scara_effmass.bags.batches import LossLog, Topic
from scara_effmass.bags.files import open_bag
from scara_effmass.errors import BagError
from scara_effmass.impacts.detector import Detector
from scara_effmass.impacts.load import AC_COUPLED, MAX_HELD_S, NO_SIGNAL, READS_LOW, TENSION, left_out_text, reads_low
from scara_effmass.importers.force import IMPORTERS, import_force, import_wrenches
from scara_effmass.importers.force_file import TABLE_SETTINGS, refuse_settings
from scara_effmass.iso15066 import TRANSIENT_S
from scara_effmass.settings import DetectionSettings, ImportSettings
from scara_effmass.values import NAN, FloatArray, ForceBlock, Impact, LeftOut
from scara_effmass.wire.cdr import NS
from scara_effmass.wire.message_types import FORCE_BLOCK, IMPACT, WRENCH, WRENCH_STAMPED

MEASUREMENTS = (FORCE_BLOCK, IMPACT, WRENCH_STAMPED, WRENCH)
"""Types of measurements, in the order of preference."""
SENSOR_SETTINGS = ("sensor.invert", "sensor.sensitivity", "sensor.sensitivity_uncertainty", "sensor.range")
IMPORT_SETTINGS = (*TABLE_SETTINGS, "axis", "unit", *SENSOR_SETTINGS)
"""Settings without effect on force blocks and impacts."""
BEFORE_S = 0.01
"""Time before the onset; its median force is the baseline."""
LOW_SHARE = 0.1
"""Share of the peak; the contact lasts while the force is above it."""
NO_BLOCKS = "only impacts were recorded: what their detection left out is not known"
AFTER_S = 0.1
"""Time after the onset in a report of impacts."""
LEFT, RIGHT, BASE, TOP = 46.0, 314.0, 126.0, 16.0
"""Edges of the axes of a drawing [pixel]."""
COLUMNS = 120
"""Columns of pixels to which a drawn trace is decimated."""
SHOWN_DURATIONS = 4.0
"""Width of a drawing in durations of the contact; it is wider if a mark is later."""
MARK_MARGIN = 1.1
"""Smallest width of a drawing in times of its latest mark."""


class Measurement(NamedTuple):
    """A force block or an impact, and its log time."""

    log_time_ns: int
    value: ForceBlock | Impact


class RecordedForce(NamedTuple):
    """Force (n,) [N] at the ROS times `stamp_ns` (n,), with one NaN in each gap, and the impacts in it."""

    stamp_ns: NDArray[np.int64]
    force: FloatArray
    simulated: bool
    impacts: tuple[Impact, ...]


def read_force(bag: Bag) -> RecordedForce | None:
    """Return the force on the first force topic of `bag`, or None without force. Raises BagError."""
    topic, impact_topic = (
        next((topic.name for topic in bag.topics if topic.type == kind), "") for kind in (FORCE_BLOCK, IMPACT)
    )
    blocks = list(bag.force_blocks(topic)) if topic else []
    if not blocks:
        return None
    recorded = [impact for _, impact in bag.timed_impacts(impact_topic)] if impact_topic else blocks
    is_simulated = any(block.simulated for block in blocks)
    return RecordedForce(*_samples(blocks), is_simulated, detected_impacts(recorded))


def _samples(blocks: Sequence[ForceBlock]) -> tuple[NDArray[np.int64], FloatArray]:
    """Return stamps [ns] and forces [N] of `blocks` (n,), with one NaN in each gap."""
    stamps, forces = [], []
    for before, block in zip((None, *blocks), blocks, strict=False):
        if block.lost_since(before):
            stamps.append(np.array([block.stamp_ns], np.int64))
            forces.append(np.array([NAN]))
        stamps.append(block.stamp_ns + np.rint(np.arange(len(block.force)) / block.sample_rate * NS).astype(np.int64))
        forces.append(block.force)
    return np.concatenate(stamps), np.concatenate(forces)


def lost_samples(block: ForceBlock, before: ForceBlock | None) -> int:
    """Return the samples lost since `before`, and those of `block` that are not finite."""
    return block.lost_since(before) + int(np.count_nonzero(~np.isfinite(block.force)))


def detected_impacts(values: Iterable[ForceBlock | Impact], detector: Detector | None = None) -> tuple[Impact, ...]:
    """Return the impacts among `values`, and those that a new `detector` finds in the blocks, by default as usual."""
    detector = detector or Detector(DetectionSettings())
    found = (detector.feed(value) if isinstance(value, ForceBlock) else (value,) for value in values)
    return (*chain.from_iterable(found), *detector.finish())


def measurement_topic(bag: Bag, name: str, remedy: str = "") -> Topic:
    """Return the topic of force or impacts `name`, else as `Bag.find_topic`, which raises BagError with `remedy`."""
    return bag.find_topic(name, MEASUREMENTS, "--force-topic", remedy)


def force_topics(bag: Bag) -> list[Topic]:
    """Return the topics among which `measurement_topic` chooses: all of the preferred type that have messages."""
    types = {topic.type for topic in bag.topics if topic.count}
    preferred = next((kind for kind in MEASUREMENTS if kind in types), "")
    return [topic for topic in bag.topics if topic.count and topic.type == preferred]


def check_other_forces(bag: Bag, chosen: Topic, settings: ImportSettings, detection: DetectionSettings) -> None:
    """Raise BagError if the `settings` state no topic, and another one than the `chosen` one has force."""
    for topic in [] if settings.topic else force_topics(bag):
        if topic.name == chosen.name:
            continue
        detector = Detector(detection)
        contacts = detected_impacts((item.value for item in measurements(bag, topic, settings)), detector)
        peaks = [max(contact.peak_force, contact.held_force) for contact in contacts]
        peaks += [item.peak_force for item in detector.left_out if item.peak_force]
        if peaks:
            rule = f"must be {chosen.name} or {topic.name}, which has up to {max(peaks):.1f} N, too"
            raise BagError(f"{bag.path}: --force-topic is empty: {rule}")


def file_measurements(path: Path, settings: ImportSettings, losses: LossLog) -> Iterator[Measurement]:
    """Yield the measurements in a bag, or the force in a CSV or TDMS file, with the ends of its blocks as log times.

    At the end, `losses` has a line for each part that could not be read. Raises BagError or SettingsError.
    """
    if path.suffix.lower() in IMPORTERS:
        file, blocks = import_force(path, settings)
        for block in blocks:
            yield Measurement(block.stamp_ns + round(len(block.force) / block.sample_rate * NS), block)
        losses.extend(file.losses())
        return
    with open_bag(path) as bag:
        yield from measurements(bag, measurement_topic(bag, settings.topic), settings)
        losses.extend(bag.losses)


def measurements(bag: Bag, topic: Topic, settings: ImportSettings) -> Iterator[Measurement]:
    """Yield the force blocks or impacts of `topic`; wrenches are imported as force blocks with `settings`.

    Raises BagError if the recording has another definition of the type, or if wrenches cannot be imported.
    """
    if topic.type in {WRENCH_STAMPED, WRENCH}:
        yield from _import_wrenches(bag, settings.model_copy(update={"topic": topic.name}))
    else:
        refuse_settings(settings, IMPORT_SETTINGS, f"{bag.path}: {topic.name}", f"{topic.type} states it")
        read = bag.timed_force_blocks if topic.type == FORCE_BLOCK else bag.timed_impacts
        yield from (Measurement(*item) for item in read(topic.name))


def _import_wrenches(bag: Bag, settings: ImportSettings) -> Iterator[Measurement]:
    """Yield the force of a topic of wrenches; the log time of the first message places all blocks in log time."""
    first_log_ns = next(message.log_time_ns for message in bag.messages([settings.topic]))
    first_stamp_ns: int | None = None
    _, blocks = import_wrenches(bag, settings)
    for block in blocks:
        first_stamp_ns = block.stamp_ns if first_stamp_ns is None else first_stamp_ns
        end_ns = block.stamp_ns + round(len(block.force) / block.sample_rate * NS)
        yield Measurement(first_log_ns + end_ns - first_stamp_ns, block)


class ForceTrace(NamedTuple):
    """Force (n,) [N] above the baseline `level` at `time` (n,) [s] since the onset; empty without force blocks.

    `complete`: from the onset on no sample is lost, saturated or NaN. `relative_uncertainty` is the largest one of the
    file. `outside` is the largest force [N] of the file in none of its traces, above the same baseline. `ac_coupled`: a
    force that stays is larger than measured.
    """

    time: FloatArray
    force: FloatArray
    level: float = 0.0
    complete: bool = True
    relative_uncertainty: float = 0.0
    outside: float = -math.inf
    ac_coupled: bool = False

    @property
    def reaches_onset(self) -> bool:
        """Whether it has force after the onset."""
        return bool(self.time.size and self.time[-1] > 0.0)

    @property
    def duration(self) -> float | None:
        """Time above `LOW_SHARE` of the peak [s], None if the rising or falling edge is missing."""
        if not self.force.size:
            return None
        peak = int(self.force.argmax())
        low = np.flatnonzero(self.force < LOW_SHARE * self.force[peak])
        rise, fall = low[low < peak], low[low > peak]
        return float(self.time[fall[0]] - self.time[rise[-1]]) if rise.size and fall.size else None

    @property
    def has_ended(self) -> bool:
        """Whether the force is below `LOW_SHARE` of the peak at the end."""
        return bool(self.force[-1] <= LOW_SHARE * self.force.max())

    @property
    def sample_rate(self) -> float:
        """Sampling rate of two samples or more [Hz]."""
        return 1.0 / float(np.median(np.diff(self.time))) if self.time.size > 1 else math.inf

    @property
    def sampling_loss(self) -> float | None:
        """Largest share of the peak of a half-sine of this duration that can fall between two samples."""
        duration = self.duration
        return None if duration is None else sampling_loss(duration, self.sample_rate)

    @property
    def marks(self) -> list[int]:
        """Samples of the peak in the first 0.5 s, and of the peak later if the contact still lasts then."""
        peaks = [
            int(part[np.argmax(self.force[part])])
            for is_inside in ((self.time >= 0.0) & (self.time <= TRANSIENT_S), self.time > TRANSIENT_S)
            if (part := np.flatnonzero(is_inside)).size
        ]
        return [index for index in peaks if self.force[index] >= LOW_SHARE * self.force.max()]


class Drawing(NamedTuple):
    """A trace and its marks in SVG coordinates [pixel] for `macros.html`, and the ends of its axes [N, ms]."""

    points: str
    marks: list[tuple[float, float]]
    predicted_y: float | None
    top: str
    end: str
    zero: float
    left: float = LEFT
    base: float = BASE


class ShownTrace(NamedTuple):
    """One impact in a report, with a trace that reaches the onset; forces [N], speed [m/s]."""

    title: str
    stamp_ns: int
    trace: ForceTrace
    simulated: bool
    peak: float
    predicted: float | None = None
    speed: float | None = None
    held: float | None = None

    def drawing(self) -> Drawing:
        """Return the trace and the predicted peak as a report draws them."""
        trace = self.trace
        width = min(SHOWN_DURATIONS * (trace.duration or AFTER_S), float(trace.time[-1]))
        end = _round_up(max([width, *(MARK_MARGIN * trace.time[trace.marks])]))
        inside = (trace.time >= -0.2 * end) & (trace.time <= end)
        time, force = decimate(trace.time[inside], trace.force[inside], COLUMNS)
        top = _round_up(1.02 * max(float(force.max()), self.predicted or 0.0, 1e-9))

        def y(value: float) -> float:
            return round(BASE - (BASE - TOP) * value / top, 1)

        def x(seconds: float) -> float:
            return round(LEFT + (RIGHT - LEFT) * (seconds + 0.2 * end) / (1.2 * end), 1)

        points = " ".join(f"{x(t)},{y(value)}" for t, value in zip(time.tolist(), force.tolist(), strict=True))
        marks = [(x(float(trace.time[i])), y(float(trace.force[i]))) for i in trace.marks]
        predicted = y(self.predicted) if self.predicted else None
        return Drawing(points, marks, predicted, f"{top:g}", f"{1e3 * end:.3g}", x(0.0))


def sampling_loss(duration: float, rate: float) -> float:
    """Return 1 - cos(pi / (2 (T f - 2))) for a half-sine of `duration` T [s] sampled at `rate` f [Hz].

    A duration from the sample before the contact to that after it may be two sampling periods too long.
    """
    return 1.0 - math.cos(0.5 * math.pi / max(duration * rate - 2.0, 1.0))


NO_TRACE = ForceTrace(np.empty(0), np.empty(0))


def _round_up(value: float) -> float:
    """Return the next larger end of an axis: a number of two digits, the second one even."""
    step = 10.0 ** math.floor(math.log10(value)) / 5.0
    return float(f"{step * math.ceil(value / step):.2g}")


def file_traces(
    path: Path,
    settings: ImportSettings,
    onsets_ns: Iterable[int],
    after_s: float,
    losses: LossLog,
    offset_s: float = 0.0,
    known_ns: Iterable[int] = (),
) -> list[ForceTrace]:
    """Return the force in the file or bag at `path` from each of `onsets_ns` to the next one, at most for `after_s`.

    `offset_s` is added to the stamps of the file. `losses` receives a line for each part that could not be read; with
    one, no trace is complete. The force for `after_s` from each of `known_ns` is not `outside` either. Raises BagError,
    SettingsError.
    """
    onsets = np.array(list(onsets_ns), np.int64)
    following = [min(onsets[onsets > onset], default=math.inf) for onset in onsets]
    ends = np.minimum((np.array(following) - onsets) / NS, after_s)
    parts: list[list[tuple[FloatArray, FloatArray]]] = [[] for _ in onsets]
    complete = np.full(len(onsets), fill_value=True)
    begins_ns = np.array([*onsets.tolist(), *known_ns], np.int64)
    relative, outside, ac_coupled = 0.0, -math.inf, False
    before: ForceBlock | None = None
    for _, block in file_measurements(path, settings, losses):
        if not isinstance(block, ForceBlock):
            continue
        is_finite = np.isfinite(block.force)
        is_doubtful = ~is_finite
        is_doubtful[block.saturated_samples] = True
        is_doubtful[:1] |= block.lost_since(before) > 0
        before, relative = block, max(relative, block.relative_uncertainty)
        ac_coupled |= AC_COUPLED in block.source
        stamp_ns, seconds = block.stamp_ns + round(offset_s * NS), np.arange(len(block.force)) / block.sample_rate
        since = (stamp_ns - begins_ns) / NS
        near = since[(since <= after_s) & (since + len(block.force) / block.sample_rate > -BEFORE_S), None] + seconds
        is_outside = is_finite & ~((near >= -BEFORE_S) & (near <= after_s)).any(axis=0)
        outside = max(outside, float(block.force[is_outside].max(initial=-math.inf)))
        first = (stamp_ns - onsets) / NS
        last = first + len(block.force) / block.sample_rate
        for index in np.flatnonzero((first < ends) & (last > -BEFORE_S)):
            time = first[index] + seconds
            inside = (time >= -BEFORE_S) & (time <= ends[index])
            complete[index] &= not is_doubtful[inside & (time > 0.0)].any()
            inside &= is_finite
            parts[index].append((time[inside], block.force[inside]))
    complete &= not any(losses)
    traces = [_above_baseline(*map(np.concatenate, zip(*part, strict=True))) if part else NO_TRACE for part in parts]
    return [
        ForceTrace(trace.time, trace.force, trace.level, bool(intact), relative, outside - trace.level, ac_coupled)
        for trace, intact in zip(traces, complete, strict=True)
    ]


def file_rise_ns(path: Path, settings: ImportSettings) -> int | None:
    """Return the stamp [ns] from which the force in a file rises to its peak; None if it holds no rise.

    Raises BagError, SettingsError.
    """
    values = (value for _, value in file_measurements(path, settings, LossLog()))
    blocks = [value for value in values if isinstance(value, ForceBlock)]
    if not blocks:
        return None
    stamps_ns, force = _samples(blocks)
    is_finite = np.isfinite(force)
    stamps_ns, force = stamps_ns[is_finite], force[is_finite]
    if not len(force):
        return None
    peak, lowest = int(force.argmax()), float(force.min())
    low = np.flatnonzero(force[:peak] <= lowest + LOW_SHARE * (force[peak] - lowest))
    return int(stamps_ns[low[-1]]) if low.size else None


def recorded_traces(forces: RecordedForce, title: str) -> list[ShownTrace]:
    """Return the recorded impacts that are no rebounds."""
    traces = []
    for impact in forces.impacts:
        time = (forces.stamp_ns - impact.stamp_ns) / NS
        inside = (time >= -BEFORE_S) & (time <= AFTER_S) & np.isfinite(forces.force)
        if not impact.rebound and inside.any():
            trace = _above_baseline(time[inside], forces.force[inside])
            if trace.reaches_onset:
                traces.append(ShownTrace(title, impact.stamp_ns, trace, impact.simulated, impact.peak_force))
    return traces


def _above_baseline(time: FloatArray, force: FloatArray) -> ForceTrace:
    before = force[time < 0.0]
    level = float(np.median(before)) if before.size else 0.0
    return ForceTrace(time, force - level, level)


@dataclass(frozen=True, slots=True)
class RecordedContacts:
    """Contacts in one recording, by the detection of `daq_node`. `start_ns` is the stamp of its first sample or impact.

    `topic` is that of the force, empty if it is the only one. `left_out` counts the force above the threshold that is
    in no contact. `losses` are parts that could not be read.
    """

    path: Path
    topic: str
    source: str
    simulated: bool
    start_ns: int
    samples: int
    lost_samples: int
    contacts: tuple[Impact, ...]
    left_out: tuple[LeftOut, ...]
    losses: tuple[str, ...]
    doubts: tuple[str, ...] = ()

    @property
    def force_text(self) -> str:
        """The force in one line."""
        is_stated = "simulated" in self.source
        origin = f"{'simulated, ' * (not is_stated)}not measured" if self.simulated else "as recorded"
        topic = f"{self.topic}: " if self.topic else ""
        return f"{topic}{self.samples} samples, {self.lost_samples} lost; {origin}: {self.source}"

    def as_dict(self) -> dict[str, Any]:
        """Return everything as JSON types, in SI units, with times since the beginning of the recording."""
        contacts = [
            {
                "time_s": (contact.stamp_ns - self.start_ns) / NS,
                "stamp_ns": contact.stamp_ns,
                "peak_force_n": contact.peak_force,
                "impulse_n_s": contact.impulse,
                "duration_s": contact.duration,
                "held_force_n": contact.held_force,
                "load_force_n": contact.load_force,
                "compression_impulse_n_s": contact.compression_impulse,
                "rebound": contact.rebound,
                "press": contact.is_press,
                "clipped": contact.clipped,
                "incomplete": contact.incomplete,
            }
            for contact in self.contacts
        ]
        left_out = [
            {
                "reason": item.reason,
                "count": item.occurrences,
                "peak_force_n": item.peak_force or None,
                "time_s": (item.stamp_ns - self.start_ns) / NS,
            }
            for item in self.left_out
        ]
        return {
            "recording": str(self.path),
            "topic": self.topic,
            "source": self.source,
            "simulated": self.simulated,
            "start_ns": self.start_ns,
            "samples": self.samples,
            "lost_samples": self.lost_samples,
            "complete": not (self.losses or self.lost_samples or NO_SIGNAL in {item.reason for item in self.left_out}),
            "contacts": contacts,
            "left_out": left_out,
            "problems": [*self.losses, *self.doubts],
        }

    def rows(self) -> Iterator[tuple[str, ...]]:
        """Yield time, peak, impulse, duration, held force and remarks of each contact, for a table."""
        for contact in self.contacts:
            remarks = {
                f"on a load of {contact.load_force:.1f} N": contact.load_force,
                "press": contact.is_press,
                f"over {MAX_HELD_S:g} s: at least": contact.duration >= MAX_HELD_S,
                f"rebound {contact.rebound}": contact.rebound,
                "clipped: at least": contact.clipped,
                "incomplete: at least": contact.incomplete,
            }
            yield (
                f"{(contact.stamp_ns - self.start_ns) / NS:.3f}",
                f"{contact.peak_force:.1f}",
                f"{contact.impulse:.3f}",
                f"{1e3 * contact.duration:.1f}",
                f"{contact.held_force:.1f}" if contact.held_force else "-",
                ", ".join(text for text, applies in remarks.items() if applies),
            )

    def texts(self) -> Iterator[str]:
        """Yield the same in one line for each contact."""
        for time, peak, impulse, duration, held, remarks in self.rows():
            parts = [f"at {time} s: {peak} N", f"{impulse} N s", f"{duration} ms"]
            parts += [] if held == "-" else [f"held {held} N"]
            yield ", ".join([*parts, remarks] if remarks else parts)

    def lines(self) -> Iterator[tuple[str, str]]:
        """Yield subject and text of what is no contact."""
        for item in self.left_out:
            yield "left out", f"{left_out_text(item)} at {(item.stamp_ns - self.start_ns) / NS:.3f} s"
        for loss in self.losses:
            yield "not read", loss
        for doubt in self.doubts:
            yield "note", doubt


def recorded_contacts(path: Path, settings: ImportSettings, detection: DetectionSettings) -> RecordedContacts:
    """Return the contacts in the bag, CSV or TDMS file at `path`. Raises BagError, SettingsError."""
    losses = LossLog()
    detector = Detector(detection)
    contacts: list[Impact] = []
    samples = lost = 0
    start_ns: int | None = None
    sources: set[str] = set()
    simulated = False
    before: ForceBlock | None = None
    for _, value in file_measurements(path, settings, losses):
        start_ns = value.stamp_ns if start_ns is None else min(start_ns, value.stamp_ns)
        sources.add(value.source)
        simulated |= value.simulated
        if isinstance(value, Impact):
            contacts.append(value)
            continue
        lost += lost_samples(value, before)
        before = value
        samples += int(np.isfinite(value.force).sum())
        contacts += detector.feed(value)
    contacts += detector.finish()
    if start_ns is None:
        raise BagError("; ".join([f"{path}: must hold a force that can be read", *losses]))
    recorded = RecordedContacts(
        path=path,
        topic=settings.topic,
        source=", ".join(sorted(sources)),
        simulated=simulated,
        start_ns=start_ns,
        samples=samples,
        lost_samples=lost,
        contacts=tuple(contacts),
        left_out=tuple(detector.left_out),
        losses=tuple(losses),
    )
    doubts = _doubts(recorded, settings, is_settled=detector.settled)
    return replace(recorded, doubts=tuple(doubts))


def _doubts(recorded: RecordedContacts, settings: ImportSettings, *, is_settled: bool) -> Iterator[str]:
    """Yield what makes the list of contacts doubtful."""
    if not recorded.samples:
        yield NO_BLOCKS
    elif not is_settled:
        yield "no steady baseline at the end: contacts there are not known"
    if any(map(reads_low, recorded.contacts)):
        yield READS_LOW
    largest = max((contact.peak_force for contact in recorded.contacts), default=0.0)
    tension = max((item.peak_force for item in recorded.left_out if item.reason == TENSION), default=0.0)
    if settings.axis != "norm" and tension > largest:  # a norm has no sign
        sign = "the force goes further below the baseline than above it, but compression is positive"
        option = "without --invert" if settings.sensor.invert else "with --invert"
        yield f"{sign}; read files and wrenches {option}, and import force blocks again so"

# SPDX-License-Identifier: Apache-2.0
"""Fill recorded contacts into a measurement protocol, evaluate its test points, and report them.

The verdict on a test point is OK only if nothing is missing and nothing is doubtful.
"""

import math
import os
from base64 import b64encode
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import datetime, timezone
from functools import partial
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from scara_effmass.analysis.assessment import Time
from scara_effmass.analysis.forces import (
    BEFORE_S,
    LOW_SHARE,
    ForceTrace,
    ShownTrace,
    file_rise_ns,
    file_traces,
    sampling_loss,
)
from scara_effmass.analysis.protocol import (
    MAX_FORCE_N,
    MAX_SPEED_M_S,
    MIN_POSE_DISTANCE,
    MIN_REPETITIONS,
    ContactTest,
    Evaluation,
    Instrument,
    LeftOutForce,
    Motion,
    Protocol,
    Repetition,
    TestPoint,
    missing,
    nearest_turn,
)
from scara_effmass.analysis.report import PAGE, PageOptions, file_hashes, render, write_report_files
from scara_effmass.analysis.summary import worst
from scara_effmass.analysis.validation import ValidatedRecording, Validation
from scara_effmass.bags.batches import LossLog
from scara_effmass.bags.files import open_bag
from scara_effmass.errors import BagError, EffmassError, SettingsError
from scara_effmass.impacts.agreement import region_force
from scara_effmass.impacts.impact_matcher import CLIPPED, INCOMPLETE, PRESS
from scara_effmass.impacts.load import LATER_LOAD, NO_BASELINE, SLOW_CHANGE, SLOW_RISE_S
from scara_effmass.impacts.segment import STUCK
from scara_effmass.input_files import digest
from scara_effmass.iso15066 import TABLE_HASH, TRANSIENT_S, Limit, limits_for
from scara_effmass.settings import ContactType, ImportSettings, MonitorSettings, checked
from scara_effmass.values import FloatArray, RefusedImpact, ValidatedImpact, Vector3, Verdict, at_least

RECORD = "report.json"
PHOTO_TYPES = {".png": "png", ".jpg": "jpeg", ".jpeg": "jpeg", ".webp": "webp", ".gif": "gif"}
MAX_PHOTO_BYTES = 10_000_000
"""Size up to which a page holds a photo."""
MISSING = "missing: "
"""Prefix of the reasons that name a value to fill in."""
MAX_CONTACT_S = 10.0
"""Time after the onset in which the force counts, unless another contact begins."""
SPEED_TOLERANCE = 0.05
"""Share of the commanded speed by which a contact may be slower."""
IDENTITY = ("model", "serial", "calibration_date", "calibration_due")
"""What is stated of an instrument that measures pressure or speed alone."""
SOURCE = {"raw_data", "raw_offset_s", "raw_channel", "raw_unit", "raw_import"}
"""Fields of a contact that say where its force is."""
NO_FORCE = "raw data without force at the time of the contact"
RELEASED_PERCENT = 10
"""Share of the samples from a contact on that may be below the zero before it, as ringing [%]."""
ROUNDING = 1e-3
"""Relative difference of forces that are the same."""
STIFFNESS_TOLERANCE = 0.1
"""Largest relative difference of stiffness with which a device stands for the body region."""
RATE_TOLERANCE = 0.05
"""Largest relative difference between the stated sampling rate and that of the raw data."""
POSE_TOLERANCE = 0.5 * MIN_POSE_DISTANCE
"""Largest difference of a joint position [rad, m] from that of the test point."""
DIRECTION_TOLERANCE_DEG = 10.0
"""Largest angle to the direction of the test point [degrees]."""


def filled(
    test: ContactTest,
    validation: Validation,
    settings: ImportSettings,
    folder: Path,
    time: Time = Time.LIVE,
    names_of: Callable[[tuple[str, ...]], tuple[str, ...]] = tuple,
    turns: Mapping[str, float] | None = None,
) -> ContactTest:
    """Return `test` with the contacts of `validation`, and all other force in it; paths are relative to `folder`.

    A press is a contact if the test is one of clamping. `settings` and `time` are those of the validation, `names_of`
    gives the robot's names of reported joints, `turns` [rad] are those of its continuous joints. Raises BagError if
    there is no contact.
    """
    contacts: list[Repetition] = []
    problems = filter(None, (validation.result.clock, validation.result.force_sign))
    left_out = [LeftOutForce(reason=problem, count=1, complete=False) for problem in problems]
    for recording in validation.recordings:
        path = recording.files[-1]
        raw_data = os.path.relpath(path.resolve(), folder.resolve())
        raw: dict[str, Any] = {"raw_data": raw_data, "raw_sha256": digest(path, BagError)}
        found: list[ValidatedImpact | RefusedImpact] = [*recording.impacts]
        others = list(recording.refused)
        if test.point.contact is ContactType.QUASI_STATIC:
            found += [impact for impact in others if impact.reason == PRESS]
            others = [impact for impact in others if impact.reason != PRESS]
        found.sort(key=attrgetter("stamp_ns"))
        poses = _poses(recording, [contact.stamp_ns for contact in found], time, names_of)
        for item, pose in zip(_repetitions(recording, found, settings), poses, strict=True):
            near = nearest_turn(pose, turns or {}, test.motion.pose)
            contacts.append(item.model_copy(update={**raw, "pose": near or None}))
        rest = [item.model_copy(update=raw) for item in _left_out(recording, others)]
        left_out += rest if found or rest else [LeftOutForce(**raw, reason="no contact", count=1, complete=True)]
    if not contacts:
        refused = {**validation.result.excluded, **validation.result.unpaired}
        refused |= {item.reason: item.count for item in left_out if not item.complete}
        reasons = "; ".join(f"{count}: {reason}" for reason, count in refused.items())
        names = ", ".join(str(recording.path) for recording in validation.recordings)
        raise BagError(f"{names}: no contact ({reasons})" if reasons else f"{names}: no contact")
    return test.with_results(repetitions=tuple(contacts), left_out=tuple(left_out))


def _poses(
    recording: ValidatedRecording,
    onsets_ns: Sequence[int],
    time: Time,
    names_of: Callable[[tuple[str, ...]], tuple[str, ...]],
) -> list[dict[str, float]]:
    """Return the latest position of each joint [rad, m] at each of `onsets_ns`."""
    poses: list[dict[str, float]] = [{} for _ in onsets_ns]
    with open_bag(recording.path) as bag:
        for block in bag.joint_state_blocks(recording.joint_state_topic) if onsets_ns else ():
            stamps_ns = block.log_time_ns if time is Time.LOG else block.stamp_ns
            for onset_ns, pose in zip(onsets_ns, poses, strict=True):
                before = np.flatnonzero(stamps_ns <= onset_ns)
                if before.size:
                    position = (round(value, 4) for value in block.position[before[-1]].tolist())
                    pose.update(zip(names_of(block.names), position, strict=False))
    return poses


def _left_out(recording: ValidatedRecording, contacts: Sequence[RefusedImpact]) -> Iterator[LeftOutForce]:
    """Yield the force in a recording that is in no contact of the test: `contacts`, and force that is in none."""
    for reason in dict.fromkeys(contact.reason for contact in contacts):
        refused = [contact for contact in contacts if contact.reason == reason]
        largest = max(refused, key=attrgetter("total_peak"))
        peaks = [_force(contact.total_peak) for contact in refused]
        yield LeftOutForce(
            reason=reason,
            count=len(refused),
            time=_time(largest.stamp_ns),
            peak_n=None if None in peaks else max(filter(None, peaks), default=0.0),
            held_n=_force(max(contact.total_held or contact.load_force / contact.force_share for contact in refused)),
            complete=None not in peaks and reason not in {CLIPPED, INCOMPLETE},
        )
    for item in recording.left_out:
        peak = _force(item.peak_force or math.nan)
        yield LeftOutForce(
            reason=item.reason,
            count=item.occurrences,
            time=_time(item.stamp_ns),
            peak_n=peak,
            held_n=peak if item.reason in {LATER_LOAD, SLOW_CHANGE} else None,
            complete=peak is not None and item.reason not in {NO_BASELINE, STUCK},
        )
    lost = recording.lost_samples + recording.dropouts
    if lost:
        yield LeftOutForce(reason="lost samples", count=lost, complete=False)
    for loss in recording.losses:
        yield LeftOutForce(reason=loss, count=1, complete=False)


def _force(value: float) -> float | None:
    """Return a force [N] with six digits; None, not known, for one that is negative, NaN or above MAX_FORCE_N."""
    return float(f"{value:.6g}") if 0.0 <= value <= MAX_FORCE_N else None


def _time(stamp_ns: int) -> datetime:
    return datetime.fromtimestamp(stamp_ns / 1e9, timezone.utc).astimezone()  # the local day: the test date


def _repetitions(
    recording: ValidatedRecording, contacts: Sequence[ValidatedImpact | RefusedImpact], settings: ImportSettings
) -> Iterator[Repetition]:
    stated = settings.model_dump(mode="json", exclude_unset=True, exclude={"topic", "unit"})
    raw = {
        "raw_channel": (settings.topic if recording.force_clock else recording.force_topic) or None,
        "raw_unit": settings.unit or None,
        "raw_offset_s": recording.force_offset if recording.force_clock else None,
        "raw_import": stated or None,
    }
    for contact, trace in zip(contacts, recording.force_traces(contacts, settings, MAX_CONTACT_S), strict=True):
        yield _repetition(contact, trace).model_copy(update=raw)


def _repetition(contact: ValidatedImpact | RefusedImpact, trace: ForceTrace) -> Repetition:
    """Return one contact; without force blocks, or with samples lost or saturated after it, only its peak is known.

    A force that no sensor measures is not known.
    """

    def rounded(value: float) -> float:
        return float(f"{value:.6g}")

    predicted: dict[str, float | Vector3] = {}
    share = 1.0
    if isinstance(contact, RefusedImpact):
        measured = contact.peak_force
    else:
        measured, share = contact.measured_force, contact.force_share
        predicted = {
            "direction": (rounded(contact.direction[0]), rounded(contact.direction[1]), rounded(contact.direction[2])),
            "effective_mass_kg": rounded(contact.effective_mass),
            "reduced_mass_kg": rounded(contact.reduced_mass),
            "predicted_force_n": rounded(contact.predicted_force),
        }
    peak, beyond = measured, None
    if trace.complete and trace.reaches_onset:
        is_early = trace.time <= TRANSIENT_S
        early, late = trace.force[is_early], trace.force[~is_early]
        if late.size:
            # The interpolated peak of an impact may lie between two samples.
            peak = max(float(early.max()), measured if late.max() < early.max() else 0.0)
            beyond = _force((max(float(late.max()), 0.0) + contact.load_force) / share)
    return Repetition(
        time=_time(contact.stamp_ns),
        reached_speed_m_s=rounded(contact.speed) if 0.0 < contact.speed <= MAX_SPEED_M_S else None,
        transient_peak_n=_force((peak + contact.load_force) / share),
        force_beyond_0_5_s_n=beyond,
        load_n=_force(contact.load_force / share) or None,
        duration_s=trace.duration and rounded(trace.duration),
        simulated=contact.simulated,
        **predicted,
    )


def device_of(protocol: Protocol, test: ContactTest, origin: str) -> Instrument:
    """Return the device of `test`. Raises SettingsError if a value is missing that predictions need."""
    device = protocol.device(test)
    if device is None:
        raise SettingsError(
            f"{origin}: tests.{test.id}.instrument = {test.instrument}: must be the id of an instrument"
        )
    needed = {
        f"instruments.{device.id}.stiffness_n_m": device.stiffness_n_m,
        f"instruments.{device.id}.fixed": device.fixed,
        f"instruments.{device.id}.moving_mass_kg": device.fixed or device.moving_mass_kg,
        f"tests.{test.id}.point.body_region": test.point.body_region,
        f"tests.{test.id}.point.contact": test.point.contact,
        f"tests.{test.id}.point.contact_area_m2": test.point.contact_area_m2,
    }
    for name, value in needed.items():
        if value is None:
            raise SettingsError(f"{origin}: {name}: must be stated before contacts are filled in")
    return device


def evaluated(protocol: Protocol, folder: Path) -> Protocol:
    """Return `protocol` with hashes of all raw data and a new evaluation of every test. Raises SettingsError."""
    for test in protocol.tests:
        items = tuple(
            item.model_copy(update={"raw_sha256": digest(folder / item.raw_data, SettingsError)})
            if item.raw_data and not item.raw_sha256
            else item
            for item in test.results.repetitions
        )
        hashed = test.with_results(repetitions=items)
        protocol = protocol.replaced(hashed.with_results(evaluation=evaluate(protocol, hashed, folder)))
    return protocol


class Uncertainty(NamedTuple):
    """Sources of the uncertainty of the force, each relative and expanded (k = 2)."""

    calibration: float
    speed: float
    repeatability: float
    sampling: float

    @property
    def total(self) -> float:
        """Combined expanded uncertainty: root of the sum of squares (GUM)."""
        return math.hypot(*self)


def _uncertainty(test: ContactTest, instrument: Instrument, traces: Sequence[ForceTrace]) -> Uncertainty | None:
    """Return the uncertainty budget of a test with its raw data, None while values are missing.

    Calibration and sampling are the worse of what is stated and what the raw data has. Repeatability is twice the
    standard deviation of the peaks. The loss between two samples, at most that of the shortest contact, has a
    rectangular distribution. The force is proportional to the speed.
    """
    peaks = [item.transient_peak_n for item in test.results.repetitions if item.transient_peak_n is not None]
    durations = [item.duration_s for item in test.results.repetitions if item.duration_s is not None]
    force, speed, rate = instrument.force_uncertainty, instrument.speed_uncertainty, instrument.sample_rate_hz
    if force is None or speed is None or rate is None or len(peaks) < 2 or not durations or not min(peaks):
        return None
    lost = sampling_loss(min(durations), min([rate, *(trace.sample_rate for trace in traces)]))
    spread = 2.0 * float(np.std(peaks, ddof=1)) / float(np.mean(peaks))
    force = max([force, *(trace.relative_uncertainty for trace in traces)])
    return Uncertainty(force, speed, spread, 2.0 * lost / math.sqrt(3.0))


def evaluate(protocol: Protocol, test: ContactTest, folder: Path) -> Evaluation:
    """Return the evaluation of `test`, whose raw data is relative to `folder`. Raises SettingsError."""
    instrument = protocol.device(test)
    raw = list(_raw_contacts(protocol, test, folder))
    traces = [trace for _, _, trace, _ in raw if isinstance(trace, ForceTrace) and trace.reaches_onset]
    values: dict[str, Any] = _values(test, instrument) if instrument else {}
    budget = _uncertainty(test, instrument, traces) if instrument else None
    if budget:
        values |= {"uncertainty": budget.total, "budget": budget._asdict()}
    ratio, relative = values.get("ratio"), values.get("uncertainty")
    reasons = list(_unknown_reasons(protocol, test, instrument, folder))
    tolerance = instrument.force_uncertainty or 0.0 if instrument else 0.0
    reasons += dict.fromkeys(_raw_reasons(raw, tolerance, folder))  # a file that is none counts once
    if instrument:
        reasons += _sampling_reasons(instrument, traces)
        reasons += _other_reasons(test, instrument, traces, relative or 0.0)
    if ratio is None:
        return Evaluation(verdict=Verdict.UNKNOWN.name, reasons=reasons or ("no force",), **values)
    share = f"{at_least(100.0 * ratio, 0)}% of the limit"
    if relative is not None:
        share += f", ±{at_least(100.0 * ratio * relative, 0)}%"
    is_simulated = any(item.simulated for item in test.results.repetitions)
    if ratio > 1.0 and not is_simulated:  # what is doubtful besides makes it no safer
        verdict = Verdict.VIOLATION
    elif reasons or relative is None:
        verdict = Verdict.UNKNOWN
    else:
        verdict = Verdict.OK if ratio * (1.0 + relative) <= 1.0 else Verdict.WARN
    return Evaluation(verdict=verdict.name, reasons=(share, *reasons), **values)


def overall(protocol: Protocol) -> Verdict:
    """Return the verdict of an evaluated protocol: the worst of its test points."""
    return worst(Verdict[test.results.evaluation.verdict] for test in protocol.tests if test.results.evaluation)


def record(protocol: Protocol) -> dict[str, Any]:
    """Return the verdict on `protocol` and its content, for JSON."""
    return {"verdict": overall(protocol).name, **protocol.model_dump(mode="json")}


def _unknown_reasons(
    protocol: Protocol, test: ContactTest, instrument: Instrument | None, folder: Path
) -> Iterator[str]:
    """Yield what is missing or doubtful: unless a limit is exceeded, it makes the verdict UNKNOWN."""
    repetitions, identity, motion = test.results.repetitions, protocol.identity, test.motion
    if any(item.simulated for item in repetitions):
        yield "simulated: nothing was measured on a robot"
    gaps = [*missing(identity, "identity."), *missing(test, f"tests.{test.id}.")]
    gaps += missing(instrument, f"instruments.{instrument.id}.") if instrument else ()
    yield from (f"{MISSING}{name}" for name in gaps)
    if identity.limits_hash not in {None, TABLE_HASH}:
        yield f"another table of limits: identity.limits_hash must be {TABLE_HASH}"
    if len(repetitions) < MIN_REPETITIONS:
        yield f"too few contacts: {len(repetitions)} of {MIN_REPETITIONS}"
    times = [item.time for item in repetitions if item.time]
    if len(set(times)) < len(times):
        yield "the same contact twice: results.repetitions.time must differ"
    yield from _device_reasons(protocol, test)
    for number, item in enumerate(repetitions, start=1):
        if (item.reached_speed_m_s or math.inf) < (1.0 - SPEED_TOLERANCE) * (motion.commanded_speed_m_s or 0.0):
            yield f"slower than commanded: contact {number}, {item.reached_speed_m_s:.3f} m/s"
        duration_s, peak_n, held_n = item.duration_s or 0.0, item.transient_peak_n, item.force_beyond_0_5_s_n
        is_held = duration_s > TRANSIENT_S + BEFORE_S and peak_n is not None
        if is_held and held_n is not None and held_n < LOW_SHARE * (peak_n or 0.0):
            yield f"duration and held force disagree: contact {number}, {duration_s:.3g} s, {held_n:.3g} N after 0.5 s"
        yield from _pose_reasons(number, item, motion)
    yield from _changed_data([*repetitions, *test.results.left_out], folder)
    yield from (f"photo not found: {name}" for name in test.results.photos or () if not (folder / name).is_file())


def _pose_reasons(number: int, item: Repetition, motion: Motion) -> Iterator[str]:
    """Yield where a recorded contact was in another pose or direction than that of the test point."""
    recorded = item.pose or motion.pose or {}
    others = [
        f"{joint} {recorded.get(joint, math.nan):.3f}, not {position:.3f}"
        for joint, position in (motion.pose or {}).items()
        if not abs(recorded.get(joint, math.nan) - position) <= POSE_TOLERANCE
    ]
    if others:
        yield f"another pose than stated: contact {number}: {'; '.join(others)}"
    if item.direction and motion.direction:
        moved, stated = np.array(item.direction), np.array(motion.direction)
        angle = math.degrees(math.atan2(np.linalg.norm(np.cross(moved, stated)), moved @ stated))
        if not angle <= DIRECTION_TOLERANCE_DEG:
            yield f"another direction than stated: contact {number}, by {angle:.0f} degrees"


def _sampling_reasons(instrument: Instrument, traces: Sequence[ForceTrace]) -> Iterator[str]:
    """Yield the sampling rates of the raw data that are not that of `instrument`."""
    stated = instrument.sample_rate_hz
    if stated:
        for rate in sorted({f"{trace.sample_rate:.5g}" for trace in traces}):
            if not abs(float(rate) / stated - 1.0) <= RATE_TOLERANCE:
                yield f"another sampling rate than stated: {rate} Hz in the raw data, not {stated:.5g} Hz"


def _other_reasons(
    test: ContactTest, instrument: Instrument, traces: Sequence[ForceTrace], relative: float
) -> Iterator[str]:
    """Yield the force in none of the contacts that may exceed a limit; `relative` is the uncertainty of the force."""
    left_out, largest, limits = test.results.left_out, _largest(test), _limits(test.point)
    if limits is None:
        return
    transient, held = limits
    harmless_n = held.permissible_force_n / (1.0 + relative)  # even if it stays
    judged_n = math.inf if _needs_no_mass(instrument, transient) else largest
    for item in left_out:
        bound_n, peak_n = judged_n if item.held_n is not None else min(judged_n, harmless_n), item.peak_n or 0.0
        if not item.complete or peak_n > bound_n:
            size = f"{at_least(peak_n, 1)} N" if item.peak_n is not None else f"{item.count} times"
            yield f"left out: {size} in {item.raw_data or 'the recordings'}: {item.reason}"
    known_n = min(harmless_n, max([largest, *(item.peak_n or 0.0 for item in left_out)]))
    outside_n = max((trace.outside for trace in traces), default=0.0)
    if outside_n > known_n * (1.0 + ROUNDING):
        yield f"raw data shows force outside of the contacts that were entered: {at_least(outside_n, 1)} N"


def _device_reasons(protocol: Protocol, test: ContactTest) -> Iterator[str]:
    """Yield what is doubtful about the instruments of a test."""
    day, point, instrument = protocol.identity.test_date, test.point, protocol.device(test)
    for name, device in protocol.devices(test).items():
        if device is None:
            yield f"unknown instrument: {name}"
            continue
        if device is not instrument:
            yield from (f"{MISSING}instruments.{name}.{field}" for field in IDENTITY if getattr(device, field) is None)
        due, done = device.calibration_due, device.calibration_date
        if day and done and due and not done <= day <= due:
            yield f"not calibrated on the day of the test: {name}"
    other_days = sorted({item.time.date() for item in test.results.repetitions if item.time} - {day})
    if instrument and day and other_days:
        yield f"not measured on identity.test_date: {', '.join(map(str, other_days))}"
    if instrument and instrument.fixed is False:
        if instrument.moving_mass_kg is None:
            yield f"{MISSING}instruments.{instrument.id}.moving_mass_kg"
        if point.contact is ContactType.QUASI_STATIC:
            yield f"clamping needs a fixed device: instruments.{instrument.id}.fixed must be true"
    if instrument and instrument.fixed is not None and instrument.stiffness_n_m:
        yield from _missing_masses(test, instrument)


def _missing_masses(test: ContactTest, instrument: Instrument) -> Iterator[str]:
    """Yield the contacts whose force cannot be judged on their device without the mass of the robot."""
    limits = _limits(test.point)
    if limits is not None and not _needs_no_mass(instrument, limits[0]):
        kind = "the device is softer than the region" if instrument.fixed else "the device moves"
        for number, item in enumerate(test.results.repetitions, start=1):
            if item.effective_mass_kg is None:
                yield f"{kind}; missing: tests.{test.id}.results.repetitions.{number}.effective_mass_kg"


def _changed_data(repetitions: Iterable[Repetition | LeftOutForce], folder: Path) -> Iterator[str]:
    for name, sha256 in dict.fromkeys((item.raw_data, item.raw_sha256) for item in repetitions):
        if name and sha256:
            path = folder / name
            if not path.exists():
                yield f"raw data not found: {name}"
            elif digest(path, SettingsError) != sha256:
                yield f"raw data changed: {name}"


def _onset_ns(item: Repetition | LeftOutForce) -> int:
    return round(item.time.timestamp() * 1e6) * 1000 if item.time else 0


def _raw_contacts(
    protocol: Protocol, test: ContactTest, folder: Path
) -> Iterator[tuple[int, Repetition, ForceTrace | str, list[str]]]:
    """Yield number and values of each contact with a time and a peak, its force in the raw data, and remarks on those.

    The force is that above the load, or a text that says why there is none. Remarks on a file come with its first
    contact. A file may hold contacts of other tests.
    """
    timed = [item for one in protocol.tests for item in one.results.repetitions if item.time]
    numbered = enumerate(test.results.repetitions, start=1)
    entered = [(number, item) for number, item in numbered if item.time and item.transient_peak_n is not None]
    for source, group in groupby(entered, lambda pair: pair[1].model_dump(include=SOURCE)):  # to read each file once
        numbers, items = zip(*group, strict=True)
        onsets_ns, losses, remarks = [_onset_ns(item) for item in items], LossLog(), list[str]()
        path, offset_s = folder / (source["raw_data"] or ""), source["raw_offset_s"]
        others_ns = {_onset_ns(item) for item in timed if item.model_dump(include=SOURCE) == source}
        onsets_ns += sorted(others_ns.difference(onsets_ns))
        left_out = [item for item in test.results.left_out if item.time and item.raw_data == source["raw_data"]]
        stated = (source["raw_import"] or {}) | {"topic": source["raw_channel"] or "", "unit": source["raw_unit"] or ""}
        traces: Sequence[ForceTrace | str] = ["no raw data is named"] * len(items)
        try:
            if source["raw_data"]:
                settings = checked(ImportSettings, stated, "raw_import")
                known_ns = [_onset_ns(item) for item in left_out]
                read = partial(file_traces, path, settings, onsets_ns, MAX_CONTACT_S, losses, known_ns=known_ns)
                traces = found = read(offset_s or 0.0)
                if len(onsets_ns) == 1 and offset_s is None and not found[0].reaches_onset:  # typed in by hand
                    rise_ns = file_rise_ns(path, settings)
                    if rise_ns is not None:
                        traces = read((onsets_ns[0] - rise_ns) / 1e9)
                        remarks.append("drawn from its rise on, because the file has another clock")
        except EffmassError as error:
            traces = [str(error).removeprefix(f"{path}: ")] * len(items)
        remarks += [line.removeprefix(f"{path}: ") for line in losses]
        for number, item, trace in zip(numbers, items, traces, strict=False):
            yield number, item, trace, remarks
            remarks = []


def _raw_reasons(
    contacts: Iterable[tuple[int, Repetition, ForceTrace | str, list[str]]], tolerance: float, folder: Path
) -> Iterator[str]:
    """Yield where the raw data is no force, incomplete, or shows more than was entered; `tolerance` is relative."""
    for number, item, trace, _ in contacts:
        name = item.raw_data
        if not name or not (folder / name).exists():
            continue  # named as missing, or as not found
        if isinstance(trace, str):
            yield f"raw data is no force: {trace}"
            continue
        peak_n, held_n = item.transient_peak_n or 0.0, item.force_beyond_0_5_s_n or 0.0
        is_early, total = trace.time <= TRANSIENT_S, trace.force + (item.load_n or 0.0)
        contact, early, late = f"contact {number}, {name}", total[is_early], total[~is_early]
        if problem := _other_force(trace, total, LOW_SHARE * peak_n):
            yield f"{problem}: {contact}"
            continue
        if not trace.complete:
            yield f"raw data is incomplete, lost, saturated or NaN after the onset: {contact}"
        if not trace.has_ended:
            yield f"the force had not ended, record until the release, within {MAX_CONTACT_S:g} s: {contact}"
        if trace.ac_coupled and (late.max(initial=0.0) > LOW_SHARE * peak_n or _rises_slowly(trace.time, total)):
            yield f"AC coupling removes a force that stays or rises slowly, measure with DC coupling: {contact}"
        for force, entered_n in ((early, peak_n), (late, max(held_n, LOW_SHARE * peak_n))):
            if force.max(initial=0.0) > entered_n * (1.0 + max(tolerance, ROUNDING)):
                text = f"contact {number}, {at_least(force.max(), 1)} N in {name}"
                yield f"raw data shows more force than was entered: {text}"


def _rises_slowly(time: FloatArray, force: FloatArray) -> bool:
    """Return whether AC coupling lowers the peak of `force` (n,) [N] from `time` (n,) 0 [s] on, see SLOW_RISE_S."""
    rise_s = float(time[np.argmax(force)])
    rising = force[(time >= 0.0) & (time <= rise_s)]
    return rising.size > 0 and rise_s * float(rising.mean()) > SLOW_RISE_S * float(force.max())


def _other_force(trace: ForceTrace, total: FloatArray, low_n: float) -> str:
    """Return why the `total` force (n,) [N] of a trace is not that of a contact, which exceeds `low_n`; else empty.

    If the zero is a force of the contact, the force ends below it; with AC coupling, after any that stays.
    """
    if not trace.reaches_onset:
        return NO_FORCE
    if not trace.ac_coupled and np.percentile(total, RELEASED_PERCENT) < -low_n:
        return "the contact began before its time"
    return NO_FORCE if total.max() < low_n else ""


def _values(test: ContactTest, instrument: Instrument) -> dict[str, float | bool]:
    """Return the numbers of the evaluation for which the protocol states enough, or an excess."""
    point, repetitions = test.point, test.results.repetitions
    values: dict[str, float | bool] = {}
    errors = [residual for item in repetitions if (residual := item.residual) is not None]
    if errors:
        values["residual"] = float(np.mean(errors))
    limits = _limits(point)
    if limits is None:
        return values
    transient, held = limits
    pressures = [item.peak_pressure_n_cm2 for item in repetitions if item.peak_pressure_n_cm2 is not None]
    pressure_limit = held if point.contact is ContactType.QUASI_STATIC else transient
    # A force is judged without the contact area only if every contact has a pressure that is judged by the same limit.
    all_measured = bool(repetitions) and len(pressures) == len(repetitions)
    values["transient_limit_n"] = transient.force_n if all_measured else transient.permissible_force_n
    held_measured = all_measured and pressure_limit is held
    values["quasi_static_limit_n"] = held.force_n if held_measured else held.permissible_force_n
    judged = [force for item in repetitions if (force := _judged_force(transient, instrument, item)) is not None]
    later = [item.force_beyond_0_5_s_n for item in repetitions if item.force_beyond_0_5_s_n is not None]
    is_complete = bool(repetitions) and len(judged) == len(later) == len(repetitions)
    for item in test.results.left_out:
        if item.held_n is not None:
            later.append(item.held_n)
            other = Repetition(transient_peak_n=item.peak_n)
            if (item.peak_n or 0.0) > _largest(test) and (force := _judged_force(transient, instrument, other)):
                judged.append(force)
    ratios = []
    judging: dict[str, float | bool] = {}
    if judged and instrument.stiffness_n_m:
        is_converted = any(item.effective_mass_kg for item in repetitions)
        judging["converted"] = is_converted and not _stands_for(instrument.stiffness_n_m, transient)
        judging["judged_force_n"] = max(judged)
        ratios.append(judging["judged_force_n"] / values["transient_limit_n"])
    if later:
        judging["held_force_n"] = max(later)
        ratios.append(judging["held_force_n"] / values["quasi_static_limit_n"])
    if pressures:
        judging |= {"pressure_n_cm2": max(pressures), "pressure_limit_n_cm2": pressure_limit.pressure_n_cm2}
        ratios.append(max(pressures) / pressure_limit.pressure_n_cm2)
    judging["ratio"] = max(ratios, default=0.0)
    return values | judging if is_complete or judging["ratio"] > 1.0 else values


def _largest(test: ContactTest) -> float:
    """Return the largest transient force of the contacts [N]; another one up to it harms no more."""
    return max((item.transient_peak_n or 0.0 for item in test.results.repetitions), default=0.0)


def _limits(point: TestPoint) -> tuple[Limit, Limit] | None:
    """Return the transient and the quasi-static limit of a region, None without region or area: they are named."""
    if not (point.body_region and point.contact_area_m2):
        return None
    settings = MonitorSettings(body_regions=(point.body_region,), contact_area_m2=point.contact_area_m2)
    transient, held = (
        limits_for(settings.model_copy(update={"contact": kind}))[0]
        for kind in (ContactType.TRANSIENT, ContactType.QUASI_STATIC)
    )
    if point.contact is ContactType.QUASI_STATIC:  # a clamped body part cannot move
        transient = replace(transient, body_mass_kg=held.body_mass_kg)
    return transient, held


def _stands_for(stiffness_n_m: float, limit: Limit) -> bool:
    return abs(stiffness_n_m / limit.stiffness_n_m - 1.0) <= STIFFNESS_TOLERANCE


def _needs_no_mass(instrument: Instrument, limit: Limit) -> bool:
    """Return whether the force on the device is an upper bound of that on the region, whatever the robot's mass.

    A fixed device yields less than the body part. A free one may be lighter than the body part and show less force.
    """
    stiffness = instrument.stiffness_n_m or 0.0
    return bool(instrument.fixed) and (stiffness > limit.stiffness_n_m or _stands_for(stiffness, limit))


def _judged_force(limit: Limit, instrument: Instrument, item: Repetition) -> float | None:
    """Return the transient force [N] on the region of `limit`, None while values are missing.

    The force on a device is converted to the region at equal speed. A device with the stiffness of the region stands
    for it: there the larger one of measured and converted force counts. Without the mass of the robot, the force on a
    fixed device that is not softer than the region counts. A load from before the contact is added as measured.
    """
    total, load = item.transient_peak_n, item.load_n or 0.0
    mass, stiffness = item.effective_mass_kg, instrument.stiffness_n_m
    device = math.inf if instrument.fixed else instrument.moving_mass_kg
    if total is None or device is None or stiffness is None:
        return None
    peak = max(total - load, 0.0)
    if mass is None:
        if not _needs_no_mass(instrument, limit):
            return None
        return peak * math.sqrt(max(1.0, limit.stiffness_n_m / stiffness)) + load  # of the lightest robot
    force = region_force([limit], peak, [mass], device, stiffness, load).force
    return max(force, total) if _stands_for(stiffness, limit) else force


def write_report(protocol: Protocol, path: Path, folder: Path, options: PageOptions, *, overwrite: bool) -> None:
    """Write the report of the evaluated `protocol` in the file at `path` into `folder`. Raises OutputError."""
    content = record(protocol)
    contacts = [item for test in protocol.tests for item in test.results.repetitions]
    left_out = [item for test in protocol.tests for item in test.results.left_out]
    names = [item.raw_data for item in contacts] + [item.raw_data for item in left_out]
    data = [path.parent / name for name in names if name]
    photos = [path.parent / name for test in protocol.tests for name in test.results.photos or ()]
    traces, notes = _curves(protocol, path.parent)
    page = render(
        "protocol.html",
        options.language,
        protocol=protocol,
        verdict=content["verdict"],
        running=protocol.identity.robot_model or path.name,
        simulated=any(item.simulated for item in contacts),
        traces=traces,
        curve_notes=notes,
        photos=list(_photos(protocol, path.parent)),
        files=file_hashes(Path(os.path.normpath(item)) for item in (path, *data, *photos)),
    )
    write_report_files(folder, {PAGE: page, RECORD: content}, options=options, overwrite=overwrite)


def _curves(protocol: Protocol, folder: Path) -> tuple[list[ShownTrace], list[tuple[str, str, str]]]:
    """Return the force over time of each contact, and remarks on contact and file, as why there is none."""
    curves: list[ShownTrace] = []
    notes: list[tuple[str, str, str]] = []
    for test in protocol.tests:
        for number, item, trace, remarks in _raw_contacts(protocol, test, folder):
            title = f"{test.id}, {number}"
            if isinstance(trace, str):
                remarks.append(trace)
            elif trace.reaches_onset:
                shown = trace._replace(force=trace.force + (item.load_n or 0.0))
                held = item.force_beyond_0_5_s_n if len(shown.marks) > 1 else None
                values = item.transient_peak_n or 0.0, item.predicted_force_n, item.reached_speed_m_s, held
                curves.append(ShownTrace(title, _onset_ns(item), shown, bool(item.simulated), *values))
            else:
                remarks.append("no force at the time of the contact: state raw_offset_s")
            notes += [(title, item.raw_data or "", text) for text in remarks]
    return curves, notes


def _photos(protocol: Protocol, folder: Path) -> Iterator[tuple[str, str, str]]:
    """Yield test, name and `data:` URI of each photo; the URI is empty for a file that a page cannot show."""
    for test in protocol.tests:
        for name in test.results.photos or ():
            path = folder / name
            kind = PHOTO_TYPES.get(path.suffix.lower(), "")
            shows = bool(kind) and path.is_file() and path.stat().st_size <= MAX_PHOTO_BYTES
            content = b64encode(path.read_bytes()).decode("ascii") if shows else ""
            yield test.id, name, f"data:image/{kind};base64,{content}" if shows else ""

# SPDX-License-Identifier: Apache-2.0
"""Fill recorded contacts into a measurement protocol, evaluate its test points, and report them.

The verdict on a test point is OK only if nothing is missing and nothing is doubtful.
"""

import math
import os
from base64 import b64encode
from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import datetime, timezone
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from scara_effmass.analysis.forces import (
    AFTER_S,
    BEFORE_S,
    LOW_SHARE,
    ForceTrace,
    ShownTrace,
    file_rise_ns,
    file_traces,
    sampling_loss,
)
from scara_effmass.analysis.protocol import (
    MIN_REPETITIONS,
    ContactTest,
    Evaluation,
    Instrument,
    Protocol,
    Repetition,
    missing,
)
from scara_effmass.analysis.report import PAGE, PageOptions, file_hashes, render, write_report_files
from scara_effmass.analysis.summary import worst
from scara_effmass.analysis.validation import ValidatedRecording, Validation
from scara_effmass.bags.batches import LossLog
from scara_effmass.errors import BagError, EffmassError, SettingsError
from scara_effmass.impacts.agreement import region_force
from scara_effmass.impacts.impact_matcher import PRESS
from scara_effmass.input_files import digest
from scara_effmass.iso15066 import TABLE_HASH, TRANSIENT_S, Limit, limits_for
from scara_effmass.settings import ContactType, ImportSettings, MonitorSettings, checked
from scara_effmass.values import RefusedImpact, ValidatedImpact, Verdict, at_least

RECORD = "report.json"
PHOTO_TYPES = {".png": "png", ".jpg": "jpeg", ".jpeg": "jpeg", ".webp": "webp", ".gif": "gif"}
MAX_PHOTO_BYTES = 10_000_000
"""Size up to which a page holds a photo."""
MAX_CONTACT_S = 10.0
"""Time after the onset in which the force counts, unless another contact begins."""
SPEED_TOLERANCE = 0.05
"""Share of the commanded speed by which a contact may be slower."""
IDENTITY = ("model", "serial", "calibration_date", "calibration_due")
"""What is stated of an instrument that measures pressure or speed alone."""
SOURCE = {"raw_data", "raw_offset_s", "raw_channel", "raw_unit", "raw_import"}
"""Fields of a contact that say where its force is."""
ROUNDING = 1e-3
"""Relative difference of forces that are the same."""
STIFFNESS_TOLERANCE = 0.1
"""Largest relative difference of stiffness with which a device stands for the body region."""


def repetitions(
    validation: Validation, settings: ImportSettings, folder: Path, *, presses: bool = False
) -> tuple[Repetition, ...]:
    """Return the contacts of `validation`, those that are a press only with `presses`; paths are relative to `folder`.

    Raises BagError if there is none.
    """
    contacts: list[Repetition] = []
    for recording in validation.recordings:
        found: list[ValidatedImpact | RefusedImpact] = [*recording.impacts]
        if presses:
            found += [impact for impact in recording.refused if impact.reason == PRESS]
        contacts += _repetitions(recording, sorted(found, key=attrgetter("stamp_ns")), settings, folder)
    if not contacts:
        left_out = {**validation.result.excluded, **validation.result.unpaired}
        reasons = "; ".join(f"{count}: {reason}" for reason, count in left_out.items())
        names = ", ".join(str(recording.path) for recording in validation.recordings)
        raise BagError(f"{names}: no contact ({reasons})" if reasons else f"{names}: no contact")
    return tuple(contacts)


def _repetitions(
    recording: ValidatedRecording,
    contacts: Sequence[ValidatedImpact | RefusedImpact],
    settings: ImportSettings,
    folder: Path,
) -> Iterator[Repetition]:
    path = recording.files[-1]
    stated = settings.model_dump(mode="json", exclude_defaults=True, exclude={"topic", "unit"})
    raw = {
        "raw_data": os.path.relpath(path.resolve(), folder.resolve()),
        "raw_sha256": digest(path, BagError),
        "raw_channel": (settings.topic if recording.force_clock else recording.force_topic) or None,
        "raw_unit": settings.unit or None,
        "raw_offset_s": recording.force_offset if recording.force_clock else None,
        "raw_import": stated or None,
    }
    for contact, trace in zip(contacts, recording.force_traces(contacts, settings, MAX_CONTACT_S), strict=True):
        yield _repetition(contact, trace).model_copy(update=raw)


def _repetition(contact: ValidatedImpact | RefusedImpact, trace: ForceTrace) -> Repetition:
    """Return one contact; without force blocks, or with samples lost or saturated after it, only its peak is known."""

    def rounded(value: float) -> float:
        return float(f"{value:.6g}")

    predicted: dict[str, float] = {}
    if isinstance(contact, RefusedImpact):
        measured = contact.peak_force
    else:
        measured = contact.measured_force
        predicted = {
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
            beyond = rounded(max(float(late.max()), 0.0))
    return Repetition(
        time=datetime.fromtimestamp(contact.stamp_ns / 1e9, timezone.utc).astimezone(),  # the local day: the test date
        reached_speed_m_s=rounded(contact.speed) or None,
        transient_peak_n=rounded(peak),
        force_beyond_0_5_s_n=beyond,
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


def uncertainty(test: ContactTest, instrument: Instrument) -> Uncertainty | None:
    """Return the uncertainty budget of a test, None while values are missing.

    Repeatability is twice the standard deviation of the peaks. The loss between two samples, at most that of the
    shortest contact, has a rectangular distribution. The force is proportional to the speed.
    """
    peaks = [item.transient_peak_n for item in test.results.repetitions if item.transient_peak_n is not None]
    durations = [item.duration_s for item in test.results.repetitions if item.duration_s is not None]
    force, speed, rate = instrument.force_uncertainty, instrument.speed_uncertainty, instrument.sample_rate_hz
    if force is None or speed is None or rate is None or len(peaks) < 2 or not durations or not min(peaks):
        return None
    lost = sampling_loss(min(durations), rate)
    spread = 2.0 * float(np.std(peaks, ddof=1)) / float(np.mean(peaks))
    return Uncertainty(force, speed, spread, 2.0 * lost / math.sqrt(3.0))


def evaluate(protocol: Protocol, test: ContactTest, folder: Path) -> Evaluation:
    """Return the evaluation of `test`, whose raw data is relative to `folder`. Raises SettingsError."""
    instrument = protocol.device(test)
    values = _values(test, instrument) if instrument else {}
    ratio, relative = values.get("ratio"), values.get("uncertainty")
    reasons = list(_unknown_reasons(protocol, test, instrument, folder))
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
    yield from (f"missing: {name}" for name in gaps)
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
    yield from _changed_data(repetitions, folder)
    tolerance = instrument.force_uncertainty or 0.0 if instrument else 0.0
    yield from dict.fromkeys(_raw_reasons(test, tolerance, folder))  # a file that is none counts once
    yield from (f"photo not found: {name}" for name in test.results.photos or () if not (folder / name).is_file())


def _device_reasons(protocol: Protocol, test: ContactTest) -> Iterator[str]:
    """Yield what is doubtful about the instruments of a test."""
    day, point, instrument = protocol.identity.test_date, test.point, protocol.device(test)
    for name, device in protocol.devices(test).items():
        if device is None:
            yield f"unknown instrument: {name}"
            continue
        if device is not instrument:
            yield from (f"missing: instruments.{name}.{field}" for field in IDENTITY if getattr(device, field) is None)
        due, done = device.calibration_due, device.calibration_date
        if day and done and due and not done <= day <= due:
            yield f"not calibrated on the day of the test: {name}"
    other_days = sorted({item.time.date() for item in test.results.repetitions if item.time} - {day})
    if instrument and day and other_days:
        yield f"not measured on identity.test_date: {', '.join(map(str, other_days))}"
    if instrument and instrument.fixed is False:
        if instrument.moving_mass_kg is None:
            yield f"missing: instruments.{instrument.id}.moving_mass_kg"
        if point.contact is ContactType.QUASI_STATIC:
            yield f"clamping needs a fixed device: instruments.{instrument.id}.fixed must be true"
    if instrument and instrument.fixed is not None and instrument.stiffness_n_m:
        yield from _missing_masses(test, instrument)


def _missing_masses(test: ContactTest, instrument: Instrument) -> Iterator[str]:
    """Yield the contacts whose force cannot be judged on their device without the mass of the robot."""
    point = test.point
    if not (point.body_region and point.contact_area_m2):
        return  # named as missing themselves
    transient, _ = _limits(point.body_region, point.contact_area_m2, point.contact)
    if not _needs_no_mass(instrument, transient):
        kind = "the device is softer than the region" if instrument.fixed else "the device moves"
        for number, item in enumerate(test.results.repetitions, start=1):
            if item.effective_mass_kg is None:
                yield f"{kind}; missing: tests.{test.id}.results.repetitions.{number}.effective_mass_kg"


def _changed_data(repetitions: tuple[Repetition, ...], folder: Path) -> Iterator[str]:
    for name, sha256 in dict.fromkeys((item.raw_data, item.raw_sha256) for item in repetitions):
        if name and sha256:
            path = folder / name
            if not path.exists():
                yield f"raw data not found: {name}"
            elif digest(path, SettingsError) != sha256:
                yield f"raw data changed: {name}"


def _onset_ns(item: Repetition) -> int:
    return round(item.time.timestamp() * 1e6) * 1000 if item.time else 0


def _raw_contacts(
    test: ContactTest, folder: Path, after_s: float
) -> Iterator[tuple[int, Repetition, ForceTrace | str, list[str]]]:
    """Yield number and values of each contact with a time and a peak, its force in the raw data, and remarks on those.

    The force is up to `after_s`, or a text that says why there is none. Remarks on a file come with its first contact.
    """
    numbered = enumerate(test.results.repetitions, start=1)
    entered = [(number, item) for number, item in numbered if item.time and item.transient_peak_n is not None]
    for source, group in groupby(entered, lambda pair: pair[1].model_dump(include=SOURCE)):  # to read each file once
        numbers, items = zip(*group, strict=True)
        onsets_ns, losses, remarks = [_onset_ns(item) for item in items], LossLog(), list[str]()
        path, offset_s = folder / (source["raw_data"] or ""), source["raw_offset_s"]
        stated = (source["raw_import"] or {}) | {"topic": source["raw_channel"] or "", "unit": source["raw_unit"] or ""}
        traces: Sequence[ForceTrace | str] = ["no raw data is named"] * len(items)
        try:
            if source["raw_data"]:
                settings = checked(ImportSettings, stated, "raw_import")
                traces = found = file_traces(path, settings, onsets_ns, after_s, losses, offset_s or 0.0)
                if len(items) == 1 and offset_s is None and not found[0].reaches_onset:  # typed in by hand
                    rise_ns = file_rise_ns(path, settings)
                    if rise_ns is not None:
                        traces = file_traces(path, settings, onsets_ns, after_s, losses, (onsets_ns[0] - rise_ns) / 1e9)
                        remarks.append("drawn from its rise on, because the file has another clock")
        except EffmassError as error:
            traces = [str(error).removeprefix(f"{path}: ")] * len(items)
        remarks += [line.removeprefix(f"{path}: ") for line in losses]
        for number, item, trace in zip(numbers, items, traces, strict=True):
            yield number, item, trace, remarks
            remarks = []


def _raw_reasons(test: ContactTest, tolerance: float, folder: Path) -> Iterator[str]:
    """Yield where the raw data is no force, or shows more than was entered; `tolerance` is relative."""
    for number, item, trace, _ in _raw_contacts(test, folder, MAX_CONTACT_S):
        name = item.raw_data
        if not name or not (folder / name).exists():
            continue  # named as missing, or as not found
        if isinstance(trace, str):
            yield f"raw data is no force: {trace}"
            continue
        if not trace.reaches_onset:
            yield f"raw data without force at the time of the contact: contact {number}, {name}"
            continue
        peak_n, held_n = item.transient_peak_n or 0.0, item.force_beyond_0_5_s_n or 0.0
        is_early = trace.time <= TRANSIENT_S
        for force, entered_n in (
            (trace.force[is_early], peak_n),
            (trace.force[~is_early], max(held_n, LOW_SHARE * peak_n)),
        ):
            if force.max(initial=0.0) > entered_n * (1.0 + max(tolerance, ROUNDING)):
                text = f"{at_least(force.max(), 1)} N in {name}"
                yield f"raw data shows more force than was entered: contact {number}, {text}"


def _values(test: ContactTest, instrument: Instrument) -> dict[str, float | bool]:
    """Return the numbers of the evaluation for which the protocol states enough, or an excess."""
    point, repetitions = test.point, test.results.repetitions
    values: dict[str, float | bool] = {}
    budget = uncertainty(test, instrument)
    if budget:
        values["uncertainty"] = budget.total
    errors = [
        item.predicted_force_n / item.transient_peak_n - 1.0
        for item in repetitions
        if item.predicted_force_n and item.transient_peak_n
    ]
    if errors:
        values["residual"] = float(np.mean(errors))
    if not (point.body_region and point.contact_area_m2):
        return values
    transient, held = _limits(point.body_region, point.contact_area_m2, point.contact)
    pressures = [item.peak_pressure_n_cm2 for item in repetitions if item.peak_pressure_n_cm2 is not None]
    pressure_limit = held if point.contact is ContactType.QUASI_STATIC else transient
    # A force is judged without the contact area only if every contact has a pressure that is judged by the same limit.
    all_measured = bool(repetitions) and len(pressures) == len(repetitions)
    values["transient_limit_n"] = transient.force_n if all_measured else transient.permissible_force_n
    held_measured = all_measured and pressure_limit is held
    values["quasi_static_limit_n"] = held.force_n if held_measured else held.permissible_force_n
    judged = [force for item in repetitions if (force := _judged_force(transient, instrument, item)) is not None]
    later = [item.force_beyond_0_5_s_n for item in repetitions if item.force_beyond_0_5_s_n is not None]
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
    is_complete = bool(repetitions) and len(judged) == len(later) == len(repetitions)
    return values | judging if is_complete or judging["ratio"] > 1.0 else values


def _limits(region: str, area_m2: float, contact: ContactType | None) -> tuple[Limit, Limit]:
    """Return the transient and the quasi-static limit of a region."""
    settings = MonitorSettings(body_regions=(region,), contact_area_m2=area_m2)
    transient, held = (
        limits_for(settings.model_copy(update={"contact": kind}))[0]
        for kind in (ContactType.TRANSIENT, ContactType.QUASI_STATIC)
    )
    if contact is ContactType.QUASI_STATIC:  # a clamped body part cannot move
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
    fixed device that is not softer than the region counts.
    """
    peak, mass, stiffness = item.transient_peak_n, item.effective_mass_kg, instrument.stiffness_n_m
    device = math.inf if instrument.fixed else instrument.moving_mass_kg
    if peak is None or device is None or stiffness is None:
        return None
    if mass is None:
        if not _needs_no_mass(instrument, limit):
            return None
        return peak * math.sqrt(max(1.0, limit.stiffness_n_m / stiffness))  # of the lightest robot
    force = region_force([limit], peak, [mass], device, stiffness).force
    return max(force, peak) if _stands_for(stiffness, limit) else force


def write_report(protocol: Protocol, path: Path, folder: Path, options: PageOptions, *, overwrite: bool) -> None:
    """Write the report of the evaluated `protocol` in the file at `path` into `folder`. Raises OutputError."""
    content = record(protocol)
    contacts = [item for test in protocol.tests for item in test.results.repetitions]
    data = [path.parent / item.raw_data for item in contacts if item.raw_data]
    photos = [path.parent / name for test in protocol.tests for name in test.results.photos or ()]
    traces, notes = _curves(protocol, path.parent)
    devices = [(test, protocol.device(test)) for test in protocol.tests]
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
        budgets=[(test.id, uncertainty(test, device) if device else None) for test, device in devices],
        files=file_hashes(Path(os.path.normpath(item)) for item in (path, *data, *photos)),
    )
    write_report_files(folder, {PAGE: page, RECORD: content}, options=options, overwrite=overwrite)


def _curves(protocol: Protocol, folder: Path) -> tuple[list[ShownTrace], list[tuple[str, str, str]]]:
    """Return the force over time of each contact, and remarks on contact and file, as why there is none."""
    curves: list[ShownTrace] = []
    notes: list[tuple[str, str, str]] = []
    for test in protocol.tests:
        for number, item, trace, remarks in _raw_contacts(test, folder, AFTER_S):
            title = f"{test.id}, {number}"
            if isinstance(trace, str):
                remarks.append(trace)
            elif trace.reaches_onset:
                values = item.transient_peak_n or 0.0, item.predicted_force_n, item.reached_speed_m_s
                curves.append(ShownTrace(title, _onset_ns(item), trace, bool(item.simulated), *values))
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

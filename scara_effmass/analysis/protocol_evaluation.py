# SPDX-License-Identifier: Apache-2.0
"""Verdict on the test points of a measurement protocol: OK only if nothing is missing and nothing is doubtful."""

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from scara_effmass.analysis.force_traces import sampling_loss
from scara_effmass.analysis.protocol import (
    MIN_REPETITIONS,
    ContactTest,
    Evaluation,
    Instrument,
    Protocol,
    Repetition,
    missing,
)
from scara_effmass.analysis.summary import worst
from scara_effmass.errors import SettingsError
from scara_effmass.impacts.agreement import region_force
from scara_effmass.input_files import digest
from scara_effmass.iso15066 import TABLE_HASH, Limit, limits_for
from scara_effmass.settings import ContactType, MonitorSettings
from scara_effmass.values import Verdict

SPEED_TOLERANCE = 0.05
"""Share of the commanded speed by which a contact may be slower."""
STIFFNESS_TOLERANCE = 0.1
"""Largest relative difference of stiffness with which a device stands for the body region."""


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
    if ratio is None or relative is None:
        return Evaluation(verdict=Verdict.UNKNOWN.name, reasons=reasons or ("no force",), **values)
    verdict = Verdict.OK if ratio * (1.0 + relative) <= 1.0 else Verdict.WARN if ratio <= 1.0 else Verdict.VIOLATION
    return Evaluation(
        verdict=(Verdict.UNKNOWN if reasons else verdict).name,
        reasons=(f"{ratio:.0%} of the limit, ±{ratio * relative:.0%}", *reasons),
        **values,
    )


def overall(protocol: Protocol) -> Verdict:
    """Return the verdict of an evaluated protocol: the worst of its test points."""
    return worst(Verdict[test.results.evaluation.verdict] for test in protocol.tests if test.results.evaluation)


def record(protocol: Protocol) -> dict[str, Any]:
    """Return the verdict on `protocol` and its content, for JSON."""
    return {"verdict": overall(protocol).name, **protocol.model_dump(mode="json")}


def _unknown_reasons(
    protocol: Protocol, test: ContactTest, instrument: Instrument | None, folder: Path
) -> Iterator[str]:
    """Yield the reasons that make the verdict UNKNOWN."""
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
    if instrument:
        yield from _instrument_reasons(instrument, protocol, test)
    elif test.instrument:
        yield f"unknown instrument: {test.instrument}"
    for number, item in enumerate(repetitions, start=1):
        if (item.reached_speed_m_s or math.inf) < (1.0 - SPEED_TOLERANCE) * (motion.commanded_speed_m_s or 0.0):
            yield f"slower than commanded: contact {number}, {item.reached_speed_m_s:.3f} m/s"
    yield from _changed_data(repetitions, folder)
    yield from (f"photo not found: {name}" for name in test.results.photos or () if not (folder / name).is_file())


def _instrument_reasons(instrument: Instrument, protocol: Protocol, test: ContactTest) -> Iterator[str]:
    day, due, done = protocol.identity.test_date, instrument.calibration_due, instrument.calibration_date
    if instrument.fixed is False and instrument.moving_mass_kg is None:
        yield f"missing: instruments.{instrument.id}.moving_mass_kg"
    if instrument.fixed is False and test.point.contact is ContactType.QUASI_STATIC:
        yield f"clamping needs a fixed device: instruments.{instrument.id}.fixed must be true"
    if day and done and due and not done <= day <= due:
        yield f"not calibrated on the day of the test: {instrument.id}"
    other_days = sorted({item.time.date() for item in test.results.repetitions if item.time} - {day})
    if day and other_days:
        yield f"not measured on identity.test_date: {', '.join(map(str, other_days))}"


def _changed_data(repetitions: tuple[Repetition, ...], folder: Path) -> Iterator[str]:
    for name, sha256 in dict.fromkeys((item.raw_data, item.raw_sha256) for item in repetitions):
        if name and sha256:
            path = folder / name
            if not path.exists():
                yield f"raw data not found: {name}"
            elif digest(path, SettingsError) != sha256:
                yield f"raw data changed: {name}"


def _values(test: ContactTest, instrument: Instrument) -> dict[str, float | bool]:
    """Return the numbers of the evaluation for which the protocol states enough."""
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
    transient, held = (
        limits_for(
            MonitorSettings(body_regions=(point.body_region,), contact=contact, contact_area_m2=point.contact_area_m2)
        )[0]
        for contact in (ContactType.TRANSIENT, ContactType.QUASI_STATIC)
    )
    if point.contact is ContactType.QUASI_STATIC:  # a clamped body part cannot move
        transient = replace(transient, body_mass_kg=held.body_mass_kg)
    pressures = [item.peak_pressure_n_cm2 for item in repetitions if item.peak_pressure_n_cm2 is not None]
    pressure_limit = held if point.contact is ContactType.QUASI_STATIC else transient
    # A force is judged without the contact area only if every contact has a pressure that is judged by the same limit.
    all_measured = bool(repetitions) and len(pressures) == len(repetitions)
    values["transient_limit_n"] = transient.force_n if all_measured else transient.permissible_force_n
    held_measured = all_measured and pressure_limit is held
    values["quasi_static_limit_n"] = held.force_n if held_measured else held.permissible_force_n
    judged = [_judged_force(transient, instrument, item) for item in repetitions]
    later = [item.force_beyond_0_5_s_n for item in repetitions if item.force_beyond_0_5_s_n is not None]
    if not judged or None in judged or len(later) < len(judged) or instrument.stiffness_n_m is None:
        return values
    values["converted"] = not _stands_for(instrument.stiffness_n_m, transient)
    values["judged_force_n"], values["held_force_n"] = max(filter(None, judged), default=0.0), max(later)
    ratios = [
        values["judged_force_n"] / values["transient_limit_n"],
        values["held_force_n"] / values["quasi_static_limit_n"],
    ]
    if pressures:
        values["pressure_n_cm2"], values["pressure_limit_n_cm2"] = max(pressures), pressure_limit.pressure_n_cm2
        ratios.append(max(pressures) / pressure_limit.pressure_n_cm2)
    values["ratio"] = max(ratios)
    return values


def _stands_for(stiffness_n_m: float, limit: Limit) -> bool:
    return abs(stiffness_n_m / limit.stiffness_n_m - 1.0) <= STIFFNESS_TOLERANCE


def _judged_force(limit: Limit, instrument: Instrument, item: Repetition) -> float | None:
    """Return the transient force [N] on the region of `limit`, None while values are missing.

    The force on a device is converted to the region at equal speed. A device with the stiffness of the region stands
    for it: there the larger one of measured and converted force counts.
    """
    peak, mass = item.transient_peak_n, item.effective_mass_kg
    device = math.inf if instrument.fixed else instrument.moving_mass_kg
    if peak is None or mass is None or device is None or instrument.stiffness_n_m is None:
        return None
    force = region_force([limit], peak, [mass], device, instrument.stiffness_n_m).force
    return max(force, peak) if _stands_for(instrument.stiffness_n_m, limit) else force

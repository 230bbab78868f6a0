# SPDX-License-Identifier: Apache-2.0
"""Enter recorded contacts into a measurement protocol, and evaluate it."""

import os
from collections.abc import Iterator
from datetime import datetime, timezone
from pathlib import Path

from scara_effmass.analysis.force_traces import ForceTrace, force_traces
from scara_effmass.analysis.protocol import ContactTest, Instrument, Protocol, Repetition
from scara_effmass.analysis.protocol_evaluation import evaluate
from scara_effmass.analysis.validation import ValidatedRecording, Validation
from scara_effmass.errors import BagError, SettingsError
from scara_effmass.input_files import digest
from scara_effmass.iso15066 import TRANSIENT_S
from scara_effmass.settings import ImportSettings
from scara_effmass.values import ValidatedImpact

AFTER_S = 10.0
"""Time after the onset in which the force counts, unless another contact begins."""


def repetitions(validation: Validation, settings: ImportSettings, folder: Path) -> tuple[Repetition, ...]:
    """Return the contacts of `validation`; paths are relative to `folder`. Raises BagError if there is none."""
    contacts = tuple(item for recording in validation.recordings for item in _repetitions(recording, settings, folder))
    if not contacts:
        left_out = {**validation.result.excluded, **validation.result.unpaired}
        reasons = "; ".join(f"{count}: {reason}" for reason, count in left_out.items())
        names = ", ".join(str(recording.path) for recording in validation.recordings)
        raise BagError(f"{names}: no contact ({reasons})" if reasons else f"{names}: no contact")
    return contacts


def _repetitions(recording: ValidatedRecording, settings: ImportSettings, folder: Path) -> Iterator[Repetition]:
    path = recording.files[-1]
    sha256, name = digest(path, BagError), os.path.relpath(path.resolve(), folder.resolve())
    for impact, trace in zip(recording.impacts, force_traces(recording, settings, AFTER_S), strict=True):
        item = _repetition(impact, trace, name, sha256)
        yield item.model_copy(update={"raw_offset_s": recording.force_offset}) if recording.force_clock else item


def _rounded(value: float) -> float:
    return float(f"{value:.6g}")


def _repetition(impact: ValidatedImpact, trace: ForceTrace, name: str, sha256: str) -> Repetition:
    """Return one contact; without force blocks, or with samples lost or saturated after it, only its peak is known."""
    peak, beyond = impact.measured_force, None
    if trace.complete and trace.time.size and trace.time[-1] > 0.0:
        is_early = trace.time <= TRANSIENT_S
        early, late = trace.force[is_early], trace.force[~is_early]
        if late.size:
            # The interpolated peak of an impact may lie between two samples.
            peak = max(float(early.max()), impact.measured_force if late.max() < early.max() else 0.0)
            beyond = _rounded(max(float(late.max()), 0.0))
    return Repetition(
        time=datetime.fromtimestamp(impact.stamp_ns / 1e9, timezone.utc).astimezone(),  # the local day is the test date
        raw_data=name,
        raw_sha256=sha256,
        reached_speed_m_s=_rounded(impact.speed),
        transient_peak_n=_rounded(peak),
        force_beyond_0_5_s_n=beyond,
        duration_s=trace.duration and _rounded(trace.duration),
        effective_mass_kg=_rounded(impact.effective_mass),
        reduced_mass_kg=_rounded(impact.reduced_mass),
        predicted_force_n=_rounded(impact.predicted_force),
        simulated=impact.simulated,
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

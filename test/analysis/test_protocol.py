# SPDX-License-Identifier: Apache-2.0
"""Measurement protocol: schema, gaps, evaluation, proposed test points, and recorded contacts."""

import json
import math
import re
import time
from collections.abc import Callable, Iterator
from datetime import datetime, timedelta
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel, ValidationError

from scara_effmass.analysis.forces import detected_impacts
from scara_effmass.analysis.protocol import (
    ContactTest,
    Evaluation,
    Motion,
    Plan,
    Protocol,
    Repetition,
    missing,
    nearest_turn,
    protocol_yaml,
    read_protocol,
)
from scara_effmass.analysis.protocol_evaluation import evaluate, evaluated, filled, overall, write_report
from scara_effmass.analysis.report import PageOptions
from scara_effmass.analysis.validation import Validation, ValidationSettings, validate
from scara_effmass.analysis.validation_report import summary_lines
from scara_effmass.bags.files import open_bag
from scara_effmass.bags.writer import BagWriter
from scara_effmass.errors import BagError, SettingsError
from scara_effmass.importers.force import import_force
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.settings import ImportSettings, MonitorSettings, SensorSettings, ValidatorSettings
from scara_effmass.values import ContactAssessment, ForceBlock, JointState, Verdict, severity
from scara_effmass.wire.force import force_block_message, impact_message
from scara_effmass.wire.message_types import FORCE_BLOCK, IMPACT
from test.analysis.conftest import ONSET_S, RAW, Altered, changed, content

HAND_LIMIT_N = 280.0


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Folder with the raw data, which is read once: else that takes nearly all of the time of each evaluation."""
    path = tmp_path_factory.mktemp("protocol")
    (path / "raw.csv").write_bytes(RAW)

    @cache
    def read(file: Path, settings: ImportSettings) -> tuple[Any, list[ForceBlock]]:
        force, blocks = import_force(file, settings)
        return force, list(blocks)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "scara_effmass.analysis.forces.import_force",
            lambda file, settings: (read if file == path / "raw.csv" else import_force)(file, settings),
        )
        yield path


def result(values: dict[str, Any], folder: Path) -> Evaluation:
    protocol = Protocol.model_validate(values)
    return evaluate(protocol, protocol.tests[0], folder)


def leaves(item: BaseModel, path: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """Yield the path of each field that may be empty."""
    for name in type(item).model_fields:
        value = getattr(item, name)
        if isinstance(value, BaseModel):
            yield from leaves(value, (*path, name))
        elif isinstance(value, tuple) and value and isinstance(value[0], BaseModel):
            for number, part in enumerate(value):
                yield from leaves(part, (*path, name, number))
        elif name != "id":
            yield (*path, name)


PREDICTED = ("effective_mass_kg", "reduced_mass_kg", "predicted_force_n")
OPTIONAL = {
    *("moving_mass_kg", "peak_pressure_n_cm2", *PREDICTED),
    *("raw_offset_s", "raw_channel", "raw_unit", "raw_import", "load_n", "left_out"),
    *("report_number", "report_date", "site", "cell", "temperature_c", "certificate", "hazard_id", "tool"),
    *("pressure_instrument", "speed_instrument"),
}
PATHS = [path for path in leaves(Protocol.model_validate(content())) if path[-1] not in {"note", "evaluation"}]
RECORDED = {"pose", "direction"}
"""What fill enters of each contact, and a test point states."""


def without(path: tuple[str | int, ...]) -> dict[str, Any]:
    values: Any = content()
    part = values
    for key in path[:-1]:
        part = part[key]
    part.pop(path[-1], None)
    return dict(values)


@pytest.mark.parametrize("path", PATHS, ids=lambda path: ".".join(map(str, path)))
def test_a_missing_field_is_named_and_makes_the_verdict_unknown(path: tuple[str | int, ...], folder: Path) -> None:
    evaluation = result(without(path), folder)
    if path[-1] in OPTIONAL or ("repetitions" in path and path[-1] in RECORDED):
        assert evaluation.verdict == "OK"
        return
    named = [reason for reason in evaluation.reasons if reason.endswith(f".{path[-1]}")]
    assert (evaluation.verdict, len(named)) == ("UNKNOWN", 1), evaluation.reasons


@pytest.mark.parametrize(
    ("peak_n", "verdict"),
    [(100.0, "OK"), (0.95 * HAND_LIMIT_N, "OK"), (0.99 * HAND_LIMIT_N, "WARN"), (281.0, "VIOLATION")],
)
def test_the_verdict_needs_a_distance_of_the_uncertainty_from_the_limit(
    peak_n: float, verdict: str, folder: Path
) -> None:
    evaluation = result(content(peak_n), folder)
    assert (evaluation.verdict, evaluation.transient_limit_n) == (verdict, HAND_LIMIT_N)
    assert evaluation.ratio == pytest.approx(peak_n / HAND_LIMIT_N)
    assert evaluation.uncertainty == pytest.approx(np.hypot(0.03, 0.02), rel=1e-3)
    assert evaluation.residual == pytest.approx(0.1)
    assert evaluation.converted is False


@pytest.mark.parametrize(
    ("field", "values", "part"),
    [
        ("transient_peak_n", (98.0, 100.0, 102.0), 2.0 * 2.0 / 100.0),
        ("duration_s", (0.01, 0.005, 0.02), 2.0 * (1.0 - np.cos(np.pi / 16.0)) / np.sqrt(3.0)),
    ],
    ids=["twice_the_deviation_of_the_peaks", "loss_between_samples_of_the_shortest_contact"],
)
def test_the_contacts_add_to_the_uncertainty_of_the_device(
    field: str, values: tuple[float, ...], part: float, folder: Path
) -> None:
    protocol = content()
    for item, value in zip(protocol["tests"][0]["results"]["repetitions"], values, strict=True):
        item[field] = value
    assert result(protocol, folder).uncertainty == pytest.approx(np.hypot(np.hypot(0.03, 0.02), part), rel=1e-3)


def test_the_held_force_has_the_quasi_static_limit(folder: Path) -> None:
    values = content()
    values["tests"][0]["results"]["repetitions"][1]["force_beyond_0_5_s_n"] = 141.0
    evaluation = result(values, folder)
    assert (evaluation.verdict, evaluation.held_force_n, evaluation.quasi_static_limit_n) == ("VIOLATION", 141.0, 140.0)


def test_a_measured_pressure_has_its_own_limit(folder: Path) -> None:
    values = content()
    for item in values["tests"][0]["results"]["repetitions"]:
        item["peak_pressure_n_cm2"] = 381.0
    evaluation = result(values, folder)
    assert (evaluation.verdict, evaluation.pressure_n_cm2, evaluation.pressure_limit_n_cm2) == (
        "VIOLATION",
        381.0,
        380.0,
    )


def test_one_measured_pressure_above_its_limit_is_a_violation(folder: Path) -> None:
    values = content()
    values["tests"][0]["results"]["repetitions"][1]["peak_pressure_n_cm2"] = 381.0
    evaluation = result(values, folder)
    assert (evaluation.verdict, evaluation.pressure_n_cm2) == ("VIOLATION", 381.0)


@pytest.mark.parametrize(("contact", "limit_n"), [("transient", 19.0), ("quasi_static", 140.0)])
def test_a_peak_pressure_does_not_replace_that_of_the_held_force(folder: Path, contact: str, limit_n: float) -> None:
    """A transient limit allows twice the pressure of a held contact: 190 N/cm2 on 0.1 cm2 of the hand."""
    values = content(50.0)
    values["tests"][0]["point"] |= {"contact": contact, "contact_area_m2": 1e-5}
    for item in values["tests"][0]["results"]["repetitions"]:
        item |= {"peak_pressure_n_cm2": 150.0, "force_beyond_0_5_s_n": 25.0}
    evaluation = result(values, folder)
    assert evaluation.quasi_static_limit_n == pytest.approx(limit_n)
    assert evaluation.verdict == ("VIOLATION" if contact == "transient" else "OK")


@pytest.mark.parametrize("stiffness", [60e3, 83e3])
def test_clamped_body_part_does_not_yield(folder: Path, stiffness: float) -> None:
    """Fixed device and clamped hand: the force scales with the root of the stiffness alone."""
    values = {"instruments": [{"stiffness_n_m": stiffness, "fixed": True}]}
    evaluation = result(changed(content(400.0), values | {"tests": [{"point": {"contact": "quasi_static"}}]}), folder)
    assert evaluation.judged_force_n == pytest.approx(400.0 * np.sqrt(75e3 / stiffness), rel=1e-3)
    assert evaluation.verdict == "VIOLATION"


def test_force_on_another_stiffness_is_converted(folder: Path) -> None:
    values = content(400.0)
    values["instruments"][0]["stiffness_n_m"] = 300e3
    evaluation = result(values, folder)
    # mu 0.4615 kg with the hand, 2 kg with the fixed device, of a quarter of its stiffness.
    assert evaluation.judged_force_n == pytest.approx(400.0 * np.sqrt(0.25 * (1.0 / (0.5 + 1.0 / 0.6)) / 2.0))
    assert (evaluation.converted, evaluation.verdict) == (True, "OK")


def unpredicted(values: dict[str, Any], **instrument: object) -> dict[str, Any]:
    """Return the protocol without predictions, and with changes of its device."""
    for item in values["tests"][0]["results"]["repetitions"]:
        for name in PREDICTED:
            del item[name]
    return dict(changed(values, {"instruments": [instrument]}))


@pytest.mark.parametrize("contact", ["transient", "quasi_static"])
@pytest.mark.parametrize("stiffness", [75e3, 300e3])
@pytest.mark.parametrize(("peak_n", "verdict"), [(100.0, "OK"), (303.0, "VIOLATION")])
def test_a_measured_force_is_judged_without_predictions(
    contact: str, stiffness: float, peak_n: float, verdict: str, folder: Path
) -> None:
    values = unpredicted(content(peak_n), stiffness_n_m=stiffness)
    values["tests"][0]["point"]["contact"] = contact
    evaluation = result(values, folder)
    assert (evaluation.verdict, evaluation.judged_force_n, evaluation.converted) == (verdict, peak_n, False)
    assert evaluation.residual is None


@pytest.mark.parametrize(
    ("instrument", "reason"),
    [
        ({"stiffness_n_m": 25e3}, "the device is softer than the region"),
        ({"fixed": False, "moving_mass_kg": 0.2}, "the device moves"),
        ({"stiffness_n_m": 300e3, "fixed": False, "moving_mass_kg": 2.0}, "the device moves"),
    ],
)
def test_a_softer_or_moving_device_needs_the_mass_of_the_robot(
    instrument: dict[str, Any], reason: str, folder: Path
) -> None:
    evaluation = result(unpredicted(content(50.0), **instrument), folder)
    names = [f"{reason}; missing: tests.1.results.repetitions.{number}.effective_mass_kg" for number in (1, 2, 3)]
    assert (evaluation.verdict, list(evaluation.reasons)) == ("UNKNOWN", names)


@given(
    st.floats(50.0, 400.0), st.floats(0.3, 5.0), st.floats(0.1, 50.0), st.sampled_from(["transient", "quasi_static"])
)
def test_a_missing_prediction_never_improves_the_verdict(
    folder: Path, peak_n: float, relative: float, mass: float, contact: str
) -> None:
    def rank(values: dict[str, Any]) -> int:
        change = {"instruments": [{"stiffness_n_m": relative * 75e3}], "tests": [{"point": {"contact": contact}}]}
        return severity(Verdict[result(changed(values, change), folder).verdict])

    known = content(peak_n)
    for item in known["tests"][0]["results"]["repetitions"]:
        item["effective_mass_kg"] = mass
    assert rank(known) <= rank(unpredicted(content(peak_n)))


LIGHT = {"transient_peak_n": 51.0, "force_beyond_0_5_s_n": 0.0}
CHANGES: dict[str, dict[str, Any]] = {
    "another table of limits": {"identity": {"limits_hash": "0"}},
    "not calibrated on the day of the test": {"instruments": [{"calibration_due": "2026-03-03"}]},
    "not measured on identity.test_date": {"identity": {"test_date": "2026-03-05"}},
    "unknown instrument": {"tests": [{"instrument": "gauge"}]},
    "slower than commanded": {"tests": [{"motion": {"commanded_speed_m_s": 0.3}}]},
    "clamping needs a fixed device": {
        "instruments": [{"fixed": False, "moving_mass_kg": 2.0}],
        "tests": [{"point": {"contact": "quasi_static"}}],
    },
    "missing: instruments.device.moving_mass_kg": {"instruments": [{"fixed": False}]},
    "the same contact twice": {"tests": [{"results": {"repetitions": [{}, {"time": "2026-03-04T09:00:00Z"}]}}]},
    "simulated": {"tests": [{"results": {"repetitions": [{"simulated": True}]}}]},
    "raw data not found": {"tests": [{"results": {"repetitions": [{"raw_data": "lost.csv"}]}}]},
    "raw data changed": {"tests": [{"results": {"repetitions": [{"raw_sha256": 64 * "0"}]}}]},
    "raw data is no force: topic = Kraft (N)": {
        "tests": [{"results": {"repetitions": [{"raw_channel": "Kraft (N)"}]}}]
    },
    "raw data without force at the time of the contact: contact 1": {
        "tests": [{"results": {"repetitions": [{"raw_offset_s": -60.0}]}}]
    },
    "raw data shows more force than was entered: contact 3, 50.0 N": {
        "tests": [{"results": {"repetitions": [{}, {}, {"transient_peak_n": 40.0}]}}]
    },
    "raw data shows more force than was entered: contact 2, 50.0 N": {
        "tests": [{"results": {"repetitions": [{}, {"raw_offset_s": 0.7, **LIGHT}]}}]
    },
    "duration and held force disagree: contact 2, 3 s, 9 N": {
        "tests": [{"results": {"repetitions": [{}, {"duration_s": 3.0, "force_beyond_0_5_s_n": 9.0}]}}]
    },
    "another sampling rate than stated: 2000 Hz in the raw data, not 12800 Hz": {
        "instruments": [{"sample_rate_hz": 12800.0}]
    },
    "another pose than stated: contact 1: joint1 0.551, not 0.500": {
        "tests": [{"results": {"repetitions": [{"pose": {"joint1": 0.551, "gripper": 0.0}}]}}]
    },
    "another pose than stated: contact 2: joint1 nan, not 0.500": {
        "tests": [{"results": {"repetitions": [{}, {"pose": {"gripper": 0.0}}]}}]
    },
    "another direction than stated: contact 1, by 11 degrees": {
        "tests": [{"results": {"repetitions": [{"direction": (1.0, 0.2, 0.0)}]}}]
    },
}


@pytest.mark.parametrize("doubt", CHANGES)
def test_what_is_doubtful_is_unknown(doubt: str, folder: Path) -> None:
    evaluation = result(changed(content(), CHANGES[doubt]), folder)
    assert evaluation.verdict == "UNKNOWN"
    assert any(reason.startswith(doubt) for reason in evaluation.reasons), evaluation.reasons


@pytest.mark.parametrize("doubt", [*CHANGES, "missing: tests.1.results.photos", "missing: instruments.device.force_un"])
def test_what_is_doubtful_does_not_hide_an_excess(doubt: str, folder: Path) -> None:
    values = changed(content(300.0), CHANGES.get(doubt, {}))
    values["tests"][0]["results"]["repetitions"][1]["transient_peak_n"] = 600.0
    if "photos" in doubt:
        values["tests"][0]["results"]["photos"] = None
    if "force_un" in doubt:
        values["instruments"][0]["force_uncertainty"] = None
    evaluation = result(values, folder)
    is_judged = doubt not in {"simulated", "unknown instrument", "missing: instruments.device.moving_mass_kg"}
    assert evaluation.verdict == ("VIOLATION" if is_judged else "UNKNOWN"), evaluation.reasons


def test_each_quantity_may_have_an_instrument_of_its_own_which_must_be_calibrated(folder: Path) -> None:
    values = content()
    film = {"id": "film", "model": "film", "serial": "2", "calibration_date": "2026-01-01"}
    values["instruments"].append({**film, "calibration_due": "2026-12-31"})
    values["tests"][0] |= {"pressure_instrument": "film", "speed_instrument": "device"}
    assert result(values, folder).verdict == "OK"
    values["instruments"][1]["calibration_due"] = "2026-03-03"
    assert result(values, folder).reasons[1:] == ("not calibrated on the day of the test: film",)
    values["instruments"][1]["calibration_due"] = None
    assert result(values, folder).reasons[1:] == ("missing: instruments.film.calibration_due",)
    values["tests"][0]["speed_instrument"] = "laser"
    assert "unknown instrument: laser" in result(values, folder).reasons


CLIPPED = "clipped: the force reached the end of the measuring range"
REBOUND = "rebound of an earlier impact"
OTHERS: dict[str, tuple[dict[str, Any], str]] = {
    "above a limit": ({"reason": CLIPPED, "peak_n": 281.0, "held_n": 0.0, "complete": False}, "VIOLATION"),
    "held above its limit": ({"reason": "press", "peak_n": 150.0, "held_n": 150.0}, "VIOLATION"),
    "within the uncertainty": ({"reason": "the robot stands still", "peak_n": 275.0, "held_n": 0.0}, "WARN"),
    "may be larger": ({"reason": CLIPPED, "peak_n": 10.0, "held_n": 0.0, "complete": False}, "UNKNOWN"),
    "no contact, above the held limit": ({"reason": "single samples", "peak_n": 138.0}, "UNKNOWN"),
    "no contact, below it": ({"reason": "single samples", "peak_n": 134.0}, "OK"),
    "unknown": ({"reason": "lost samples", "complete": False}, "UNKNOWN"),
    "known": ({"reason": REBOUND, "peak_n": 200.0, "held_n": 0.0}, "OK"),
    "nothing": ({"reason": "no contact"}, "OK"),
}


@pytest.mark.parametrize("case", OTHERS)
def test_other_force_in_the_recordings_counts(case: str, folder: Path) -> None:
    other, verdict = OTHERS[case]
    stated = {"count": 1, "complete": True, "raw_data": "raw.csv", "time": "2026-03-04T10:00:00+01:00", **other}
    values = content()
    values["tests"][0]["results"]["left_out"] = [stated]
    evaluation = result(values, folder)
    assert evaluation.verdict == verdict, evaluation.reasons
    named = [reason for reason in evaluation.reasons if other["reason"] in reason]
    assert bool(named) is (not stated["complete"] or verdict == "UNKNOWN")
    page = report_page(values, folder)
    assert f"<td>{other['reason']}</td>" in page
    assert page.count(">raw.csv</td>") == 1


@pytest.mark.parametrize(("peak_n", "verdict"), [(100.0, "OK"), (101.0, "UNKNOWN")])
def test_a_rebound_on_a_moving_device_is_judged_by_a_larger_contact(peak_n: float, verdict: str, folder: Path) -> None:
    values = changed(content(), {"instruments": [{"fixed": False, "moving_mass_kg": 2.0}]})
    rebound = {"reason": REBOUND, "count": 1, "peak_n": peak_n, "held_n": 0.0, "complete": True}
    values["tests"][0]["results"]["left_out"] = [rebound]
    assert result(values, folder).verdict == verdict


@pytest.mark.parametrize(("stiffness", "judged_n"), [(75e3, 150.0), (300e3, 50.0 + 100.0 * np.sqrt(0.25 * 0.2308))])
def test_a_load_from_before_a_contact_is_in_the_force_as_measured(
    stiffness: float, judged_n: float, folder: Path
) -> None:
    """Only the impact above it is converted to the region, and is predicted."""
    values = changed(content(150.0), {"instruments": [{"stiffness_n_m": stiffness}]})
    for item in values["tests"][0]["results"]["repetitions"]:
        item |= {"load_n": 50.0, "force_beyond_0_5_s_n": 50.0, "predicted_force_n": 110.0}
    evaluation = result(values, folder)
    assert evaluation.judged_force_n == pytest.approx(judged_n, rel=1e-3)
    assert evaluation.residual == pytest.approx(0.1)


def force_csv(path: Path, force: Callable[[float], float], seconds: float = 3.2) -> str:
    """Write `force` [N] at 2 kHz from 0.1 s before the first contact of `content`; return the name of the file."""
    rows = (f"{ONSET_S + t:.4f},{force(t):.3f}" for t in np.arange(-0.1, seconds, 5e-4))
    path.write_text("\n".join(["Time (s),Force (N)", *rows]) + "\n", encoding="utf-8")
    return path.name


def pulses(*peaks: tuple[float, float]) -> Callable[[float], float]:
    """Return pulses of 20 ms at times [s], with peaks [N]."""
    return lambda t: sum(peak * np.sin(np.pi * (t - at) / 0.02) for at, peak in peaks if 0.0 < t - at < 0.02)


ENTERED = pulses((0.0, 100.0), (1.0, 100.0), (2.0, 100.0))
RAW_FORCES: dict[str, tuple[Callable[[float], float], str]] = {
    "entered": (ENTERED, ""),
    "much less": (
        pulses((0.0, 100.0), (1.0, 9.0), (2.0, 100.0)),
        "raw data without force at the time of the contact: contact 2, force.csv",
    ),
    "from before the time": (
        lambda t: ENTERED(t) + 300.0 * (0.7 < t < 1.5),
        "the contact began before its time: contact 2, force.csv",
    ),
    "before the contacts": (
        pulses((-0.05, 140.0), (0.0, 100.0), (1.0, 100.0)),
        "raw data shows force outside of the contacts that were entered: 140.0 N",
    ),
    "of another test": (pulses((0.0, 100.0), (1.0, 100.0), (2.0, 100.0), (2.8, 400.0)), ""),
    "goes on": (
        lambda t: 100.0 * (t > 2.0),
        "the force had not ended, record until the release, within 10 s: contact 3, force.csv",
    ),
    "not a number": (
        lambda t: math.nan if 0.25 < t < 0.26 else ENTERED(t),
        "raw data is incomplete, lost, saturated or NaN after the onset: contact 1, force.csv",
    ),
}


@pytest.mark.parametrize("case", RAW_FORCES)
def test_raw_data_shows_what_nobody_entered(case: str, tmp_path: Path) -> None:
    force, reason = RAW_FORCES[case]
    values = content()
    for item in values["tests"][0]["results"]["repetitions"]:
        item |= {"raw_data": force_csv(tmp_path / "force.csv", force), "raw_sha256": None}
    if case == "of another test":
        other = {**values["tests"][0]["results"]["repetitions"][0], "time": "2026-03-04T10:00:02.8+01:00"}
        values["tests"].append({"id": "2", "results": {"repetitions": [other]}})
    protocol = evaluated(Protocol.model_validate(values), tmp_path)
    evaluation = protocol.tests[0].results.evaluation
    assert evaluation
    assert evaluation.verdict == ("UNKNOWN" if reason else "OK"), evaluation.reasons
    assert not reason or reason in evaluation.reasons


@pytest.mark.parametrize(
    ("coupling", "seconds", "rises"),
    [("AC", 0.8, False), ("AC", 0.3, False), ("DC", 0.8, False), ("AC", 0.3, True), ("DC", 0.3, True)],
)
def test_a_force_that_lasts_is_not_known_with_ac_coupling(
    coupling: str, seconds: float, tmp_path: Path, *, rises: bool
) -> None:
    """A corner frequency of 0.1 Hz takes 27 % in 0.5 s: 115 N were 160 N, more than the limit of 140 N."""
    values = content(160.0)
    time = np.arange(-500, 3000) / 1e3
    decay = 2.0 * np.pi * 0.1 * (coupling == "AC")
    held = 160.0 * np.exp(-decay * time) * ((time > 0.0) & (time < seconds))
    force = held + (held[(time > 0.0) & (time < seconds)][-1] - 160.0) * np.exp(-decay * (time - seconds)) * (
        time >= seconds
    )
    if rises:
        force = 160.0 * np.sin(np.pi * np.clip(time / seconds, 0.0, 1.0))
    items = values["tests"][0]["results"]["repetitions"]
    with BagWriter(tmp_path / "force.mcap") as bag:
        for number, item in enumerate(items):
            first_ns = round(datetime.fromisoformat(item["time"]).timestamp() * 1e9) - 500 * 10**6
            source = f"cDAQ1Mod1/ai0, IEPE, {coupling} coupling"
            block = ForceBlock(first_ns, "cell", 0, 1e3, force, source=source)
            bag.write(f"/force{number}", FORCE_BLOCK, first_ns, force_block_message(block))
            item |= {"raw_data": "force.mcap", "raw_sha256": None, "raw_channel": f"/force{number}"}
            late = force[time > 0.5].max() * (seconds > 0.5)
            item |= {"duration_s": seconds, "force_beyond_0_5_s_n": float(late)}
    values["instruments"][0]["sample_rate_hz"] = 1000.0
    evaluation = evaluated(Protocol.model_validate(values), tmp_path).tests[0].results.evaluation
    assert evaluation
    is_known = coupling == "DC" or (seconds < 0.5 and not rises)
    assert evaluation.verdict == (("VIOLATION" if seconds > 0.5 else "OK") if is_known else "UNKNOWN")
    reasons = [reason for reason in evaluation.reasons if reason.startswith("AC coupling removes a force that stays")]
    assert len(reasons) == (0 if is_known else 3), evaluation.reasons


def test_the_calibration_is_no_better_than_that_of_the_raw_data(tmp_path: Path) -> None:
    values = content()
    (tmp_path / "volts.csv").write_bytes(RAW.replace(b"(N)", b"(V)"))
    sensor = {"sensitivity": 1000.0, "sensitivity_uncertainty": 0.1}
    for item in values["tests"][0]["results"]["repetitions"]:
        item |= {"raw_data": "volts.csv", "raw_sha256": None, "raw_import": {"sensor": sensor}}
    evaluation = result(values, tmp_path)
    assert evaluation.budget
    assert evaluation.budget["calibration"] == 0.1
    del sensor["sensitivity"]
    rule = "raw data is no force: sensor.sensitivity: must be stated for values in V"
    assert any(reason.startswith(rule) for reason in result(values, tmp_path).reasons)


def test_the_sampling_is_that_of_the_raw_data(tmp_path: Path) -> None:
    """Two samples in a contact do not show its peak."""
    values = content(250.0)
    rows = (f"{ONSET_S + i / 200 + 1e-3},{250.0 * (i % 200 in {0, 1})}" for i in range(-20, 700))
    (tmp_path / "slow.csv").write_text("\n".join(["Time (s),Force (N)", *rows]), encoding="utf-8")
    for item in values["tests"][0]["results"]["repetitions"]:
        item |= {"raw_data": "slow.csv", "raw_sha256": None, "duration_s": 0.015}
    evaluation = result(values, tmp_path)
    assert evaluation.verdict == "UNKNOWN"
    assert evaluation.budget
    assert evaluation.budget["sampling"] == pytest.approx(2.0 / np.sqrt(3.0))


STATED = {
    "identity": {"report_number": "R-17", "report_date": "2026-03-06", "site": "Hall 3", "cell": "Cell 7"},
    "instruments": [{"certificate": "DKD-4711"}],
    "tests": [{"point": {"hazard_id": "H-12", "tool": "gripper G2"}, "speed_instrument": "device"}],
}


def report_page(values: dict[str, Any], folder: Path, language: str = "en") -> str:
    protocol = evaluated(Protocol.model_validate(values), folder)
    output = folder / f"report_{language}"
    write_report(protocol, folder / "protocol.yaml", output, PageOptions(language), overwrite=True)
    return (output / "report.html").read_text(encoding="utf-8")


def test_a_report_has_number_date_site_tool_hazard_and_certificate(folder: Path) -> None:
    values = changed(content(), STATED)
    values["identity"]["temperature_c"] = 21.5
    page = report_page(values, folder)
    for text in ("R-17, 2026-03-06", "Hall 3, Cell 7", "21.5 °C", "H-12", "gripper G2", "DKD-4711"):
        assert f"<td>{text}</td>" in page, text


def pulse_csv(path: Path, column: str = "Force (N)") -> None:
    """Write 0.3 s of a pulse of 100 N at 0.1 s, times from 0 on, beside a column of another force."""
    rows = (f"{i / 1000},{100.0 * np.sin(np.pi * max(0, min(i - 100, 20)) / 20):.3f},7" for i in range(300))
    path.write_text("\n".join([f"Time (s),{column},Other (N)", *rows]) + "\n", encoding="utf-8")


def test_a_report_draws_the_curves_of_files_that_were_named_by_hand(tmp_path: Path) -> None:
    """Each contact has a file with times from 0 on; a curve that cannot be drawn says why."""
    values = content()
    for number, item in enumerate(values["tests"][0]["results"]["repetitions"]):
        pulse_csv(tmp_path / f"{number}.csv")
        item |= {"raw_data": f"{number}.csv", "raw_sha256": None, "raw_channel": "Force (N)"}
    page = report_page(values, tmp_path)
    assert page.count("<polyline") == 3
    assert page.count("drawn from its rise on, because the file has another clock") == 3
    values["tests"][0]["results"]["repetitions"][1]["raw_channel"] = "Kraft (N)"
    values["tests"][0]["results"]["repetitions"][2]["raw_offset_s"] = 3.0
    page = report_page(values, tmp_path)
    assert page.count("<polyline") == 1
    assert "1, 2, 1.csv: topic = Kraft (N): must be one of Time (s), Force (N), Other (N)" in page
    assert "1, 3, 2.csv: no force at the time of the contact: state raw_offset_s" in page
    values["tests"][0]["results"]["repetitions"][2]["raw_offset_s"] = 1e300
    with pytest.raises(ValidationError, match="raw_offset_s"):
        Protocol.model_validate(values)


def test_a_report_says_which_part_of_a_file_cannot_be_read(tmp_path: Path) -> None:
    values = content()
    item = values["tests"][0]["results"]["repetitions"][0]
    onset_ns = round(datetime.fromisoformat(item["time"]).timestamp() * 1e9)
    with BagWriter(tmp_path / "force.mcap") as bag:
        for number in range(10):
            stamp_ns = onset_ns + (number - 5) * 10**8
            data = force_block_message(ForceBlock(stamp_ns, "cell", 100 * number, 1e3, np.arange(100.0), source="test"))
            bag.write("/force", FORCE_BLOCK, stamp_ns, data if number < 9 else data[:20])
    item |= {"raw_data": "force.mcap", "raw_sha256": None, "raw_channel": None}
    assert "1, 1, force.mcap: /force: left out: " in report_page(values, tmp_path)


PIXEL = bytes.fromhex(
    "89504e470d0a1a0a0000000d4948445200000001000000010802000000907753de0000000c4944415408d763f8cfc000000301010018dd8db00000"
    "000049454e44ae426082"
)


def test_a_report_shows_the_photos(tmp_path: Path) -> None:
    (tmp_path / "raw.csv").write_bytes(RAW)
    (tmp_path / "set-up.png").write_bytes(PIXEL)
    (tmp_path / "device.heic").write_bytes(b"?")
    values = content()
    values["tests"][0]["results"]["photos"] = ["set-up.png", "device.heic"]
    page = report_page(values, tmp_path)
    assert page.count("data:image/png;base64,iVBORw0KGgo") == 1
    assert "device.heic: not found, larger than 10 MB, or no PNG, JPEG, WebP or GIF" in page
    assert "Foto zu Prüfpunkt 1" in report_page(values, tmp_path, "de")


def test_fewer_than_three_contacts_are_unknown(folder: Path) -> None:
    values = content()
    del values["tests"][0]["results"]["repetitions"][2]
    evaluation = result(values, folder)
    assert (evaluation.verdict, evaluation.reasons[1]) == ("UNKNOWN", "too few contacts: 2 of 3")


@given(st.floats(50.0, 400.0), st.floats(1.0, 1.5), st.floats(0.0, 0.3), st.floats(0.0, 0.3), st.floats(1.0, 400.0))
def test_more_force_or_uncertainty_never_improves_the_verdict(
    folder: Path, peak_n: float, factor: float, relative: float, more: float, held_n: float
) -> None:
    """Unless the raw data shows more than was entered."""

    def rank(peak: float, share: float) -> int:
        values = changed(content(peak), {"instruments": [{"force_uncertainty": share}]})
        values["tests"][0]["results"]["repetitions"][0]["force_beyond_0_5_s_n"] = held_n
        return severity(Verdict[result(values, folder).verdict])

    assert rank(peak_n, relative) <= rank(factor * peak_n, relative)
    assert rank(peak_n, relative) <= rank(peak_n, relative + more)


def test_the_worst_test_point_decides() -> None:
    def of(*verdicts: str) -> Verdict:
        tests = [
            {"id": str(number), "results": {"evaluation": {"verdict": verdict, "reasons": []}}}
            for number, verdict in enumerate(verdicts)
        ]
        return overall(Protocol.model_validate({"tests": tests}))

    assert of() is Verdict.UNKNOWN
    assert of("OK", "WARN", "OK") is Verdict.WARN
    assert of("OK", "UNKNOWN", "WARN") is Verdict.UNKNOWN
    assert of("OK", "UNKNOWN", "VIOLATION") is Verdict.VIOLATION


def test_yaml_keeps_every_value_and_explains_every_field(folder: Path) -> None:
    path = folder / "protocol.yaml"
    protocol = evaluated(Protocol.model_validate(content()), folder)
    text = protocol_yaml(protocol)
    path.write_text(text, encoding="utf-8")
    assert read_protocol(path) == protocol
    assert list(missing(protocol)) == []
    lines = text.splitlines()
    for field in ("robot_serial", "stiffness_n_m", "contact_area_m2", "direction", "force_beyond_0_5_s_n", "ratio"):
        number = next(number for number, line in enumerate(lines) if re.match(rf"[ -]*{field}:", line))
        assert lines[number - 1].lstrip().startswith("# ")


def test_an_edited_evaluation_does_not_count(folder: Path) -> None:
    values = content(281.0)
    values["tests"][0]["results"]["evaluation"] = {"verdict": "OK", "reasons": []}
    (test,) = evaluated(Protocol.model_validate(values), folder).tests
    assert test.results.evaluation
    assert test.results.evaluation.verdict == "VIOLATION"


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("- 1", "must hold identity, instruments, tests"),
        ("identity: {serial: 1}", "identity.serial: unknown: must be"),
        ("instruments: [{id: a, stiffness_n_m: 75}]", "stiffness_n_m = 75: must be greater than or equal to 1000"),
        ("instruments: [{id: a, stiffness_n_m: 75e+6}]", "stiffness_n_m = 75000000.0: must be less than or equal"),
        ("tests: [{id: a}, {id: a}]", "id must be unique, but there are a, a"),
        ("tests: [{id: a, point: {body_region: face}}]", "the standard permits no contact"),
        ("tests: [{id: a, point: {contact_area_m2: 1}}]", "contact_area_m2 = 1: must be less than or equal to 0.1"),
        ("tests: [{id: a, motion: {commanded_speed_m_s: -1}}]", "commanded_speed_m_s = -1: must be greater than 0"),
        (
            "tests: [{id: a, results: {repetitions: [{reached_speed_m_s: 180}]}}]",
            "_m_s = 180: must be less than or equal",
        ),
        ("tests: [{id: a, results: {repetitions: [{time: '2026-01-01T00:00:00'}]}}]", "timezone"),
    ],
)
def test_a_wrong_protocol_is_refused(tmp_path: Path, text: str, problem: str) -> None:
    (tmp_path / "protocol.yaml").write_text(text)
    with pytest.raises(SettingsError, match=re.escape(problem)) as caught:
        read_protocol(tmp_path / "protocol.yaml")
    assert str(caught.value).startswith(str(tmp_path / "protocol.yaml"))


def test_schema_describes_every_field() -> None:
    schema = Protocol.model_json_schema()
    text = json.dumps(schema)
    for group in schema["$defs"].values():
        for name, field in group.get("properties", {}).items():
            assert "description" in field or "$ref" in json.dumps(field), name
    assert "m/s" in text


def assessment(monitor: Monitor, q2: float, speed: float) -> ContactAssessment:
    q = np.array([0.0, q2, 0.15, 0.0])
    monitor.clear_history()
    decision = monitor.assess(
        JointState(10**9, monitor.dynamics.robot.joint_names, q, np.array([speed, 1e-9, 1e-9, 1e-9])), 10**9
    )
    assert decision
    return decision.contacts[0]


def test_plan_keeps_the_worst_contacts_in_different_poses(dynamics: RobotDynamics) -> None:
    settings = MonitorSettings(body_regions=("hand_fingers", "chest"))
    monitor, plan = Monitor(dynamics, settings), Plan(settings, 2)
    speeds = {0.5: 0.4, 0.55: 0.6, 1.0: 0.9, 1.5: 0.5}
    for q2, speed in speeds.items():
        plan.add(assessment(monitor, q2, speed), {"joint2": q2})
    plan.add(assessment(monitor, 2.0, 3.0)._replace(verdict=Verdict.UNKNOWN), {"joint2": 2.0})
    plan.add(assessment(monitor, 2.0, 0.4)._replace(direction=(0.0, 0.0, 0.0)), {"joint2": 2.0})
    protocol = plan.protocol("arm")
    assert (plan.unknown, plan.at_rest) == (1, 1)
    assert [test.id for test in protocol.tests] == ["chest_1", "chest_2", "hand_fingers_1", "hand_fingers_2"]
    for region in ("chest", "hand_fingers"):
        poses = [test.motion.pose for test in protocol.tests if test.point.body_region == region]
        assert poses == [{"joint2": 1.0}, {"joint2": 0.55}]
    assert [device.id for device in protocol.instruments] == ["25_N_mm", "75_N_mm"]
    assert "tests.chest_1.results.repetitions.3.transient_peak_n" in set(missing(protocol))


def test_plan_of_a_map_commands_the_speed_of_the_limit(dynamics: RobotDynamics) -> None:
    settings = MonitorSettings(body_regions=("hand_fingers",))
    plan = Plan(settings, 1)
    plan.add(assessment(Monitor(dynamics, settings), 1.0, 0.3), {"joint2": 1.0}, at_limit=True)
    (test,) = plan.protocol("arm").tests
    assert test.note
    assert test.note.startswith("predicted: 280 N of 280 N")


def measured(block: ForceBlock) -> ForceBlock:
    return block._replace(simulated=False)


@pytest.fixture(scope="session")
def device_settings() -> ValidationSettings:
    validator = ValidatorSettings(stiffness_n_m=2e6, body_regions=("chest",))
    return ValidationSettings(validator=validator)


def entered(validation: Validation, folder: Path = Path()) -> tuple[Repetition, ...]:
    test = Protocol.model_validate(content()).tests[0]
    return filled(test, validation, ImportSettings(), folder).results.repetitions


def test_contacts_are_those_of_the_validation(
    campaign: list[Path], dynamics: RobotDynamics, device_settings: ValidationSettings, altered: Altered
) -> None:
    bags = [altered(path, block=measured, info={"simulated": False}) for path in campaign[:2]]
    validation = validate(bags, dynamics, device_settings)
    contacts = entered(validation, bags[0].parent)
    for impact, item, bag in zip(validation.result.impacts, contacts, bags, strict=True):
        assert item.time
        assert item.time.timestamp() == pytest.approx(impact.stamp_ns / 1e9, abs=1e-6)
        assert item.transient_peak_n == pytest.approx(impact.measured_force, rel=0.01)
        assert item.predicted_force_n == pytest.approx(impact.predicted_force, rel=1e-5)
        assert item.raw_data == bag.name
        assert item.force_beyond_0_5_s_n == pytest.approx(0.0, abs=1.0)
        assert item.duration_s == pytest.approx(np.pi * np.sqrt(impact.reduced_mass / 2e6), rel=0.2)
        assert item.simulated is False
        assert item.direction == pytest.approx(impact.direction, abs=1e-5)
        assert item.pose
        assert {"joint1", "joint2", "joint3", "joint4"} <= item.pose.keys()


def test_a_continuous_joint_is_in_the_same_pose_some_turns_later(
    campaign: list[Path], dynamics: RobotDynamics, device_settings: ValidationSettings
) -> None:
    validation = validate(campaign[:1], dynamics, device_settings)
    (item,) = entered(validation)
    assert item.pose
    later = {joint: position + 112.0 * math.pi for joint, position in item.pose.items()}
    protocol = Protocol.model_validate(content())
    test = protocol.tests[0].model_copy(update={"motion": Motion(pose=later)})
    turns = {"joint1": 2.0 * math.pi}
    found = filled(test, validation, ImportSettings(), Path(), turns=turns)
    (again,) = found.results.repetitions
    assert again.pose == pytest.approx({**item.pose, "joint1": later["joint1"]})
    (reason,) = [text for text in evaluate(protocol, found, Path()).reasons if text.startswith("another pose")]
    assert "joint1" not in reason
    assert "joint2" in reason


@given(st.floats(-1e3, 1e3), st.floats(-10.0, 10.0))
def test_nearest_turn_is_the_same_angle_within_half_a_turn(position: float, stated: float) -> None:
    (near,) = nearest_turn({"a": position}, {"a": math.tau}, {"a": stated}).values()
    assert abs(near - stated) <= math.pi + 1e-9
    assert math.remainder(near - position, math.tau) == pytest.approx(0.0, abs=1e-9)
    for other in (math.nan, math.inf, position):
        assert str(nearest_turn({"b": other}, {"a": math.tau})["b"]) == str(other)
    assert math.isnan(nearest_turn({"a": math.nan}, {"a": math.tau})["a"])


def test_a_stated_setting_is_entered_whatever_its_value(
    campaign: list[Path], dynamics: RobotDynamics, device_settings: ValidationSettings
) -> None:
    """A file in volts cannot be read again without it."""
    test = ContactTest(id="1")
    settings = ImportSettings(sensor=SensorSettings(sensitivity=2.248))
    (item,) = filled(test, validate(campaign[:1], dynamics, device_settings), settings, Path()).results.repetitions
    assert item.raw_import == {"sensor": {"sensitivity": 2.248}}


@pytest.fixture
def los_angeles() -> Iterator[None]:
    """Set the time zone."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TZ", "PST8")
        time.tzset()
        yield
    time.tzset()


@pytest.mark.usefixtures("los_angeles")
def test_contact_has_the_local_day(
    campaign: list[Path], dynamics: RobotDynamics, device_settings: ValidationSettings
) -> None:
    """That is the test date of a protocol; the recording is of 0:00 UTC."""
    (item,) = entered(validate(campaign[:1], dynamics, device_settings))
    assert item.time
    assert item.time.isoformat()[:10] == "2025-12-31"
    assert item.time.utcoffset() == timedelta(hours=-8)


def test_force_that_is_held_counts_beyond_half_a_second(
    campaign: list[Path], dynamics: RobotDynamics, device_settings: ValidationSettings, altered: Altered
) -> None:
    onset_ns = validate(campaign[:1], dynamics, device_settings).result.impacts[0].stamp_ns

    def held(block: ForceBlock) -> ForceBlock:
        seconds = (block.stamp_ns - onset_ns) / 1e9 + np.arange(len(block.force)) / block.sample_rate
        return block._replace(force=np.where(seconds > 0.52, block.force + 50.0, block.force))

    validation = validate([altered(campaign[0], block=held)], dynamics, device_settings)
    (item,) = entered(validation)
    assert item.force_beyond_0_5_s_n == pytest.approx(50.0, abs=1.0)
    assert item.simulated is True


FORCE_FAULTS: dict[str, Callable[[ForceBlock], ForceBlock]] = {
    "lost samples": lambda block: block._replace(lost_samples=100),
    "saturated": lambda block: block._replace(saturated_samples=np.array([3], np.uint32)),
    "NaN": lambda block: block._replace(force=np.where(np.arange(len(block.force)) == 3, np.nan, block.force)),
}


@pytest.mark.parametrize("after_s", [0.6, -0.3])
@pytest.mark.parametrize("fault", FORCE_FAULTS)
def test_faults_of_the_force_after_the_contact_make_the_held_force_unknown(
    fault: str,
    after_s: float,
    campaign: list[Path],
    altered: Altered,
    dynamics: RobotDynamics,
    device_settings: ValidationSettings,
) -> None:
    onset_ns = validate(campaign[:1], dynamics, device_settings).result.impacts[0].stamp_ns

    def faulty(block: ForceBlock) -> ForceBlock:
        is_near = 0.0 <= (block.stamp_ns - onset_ns) / 1e9 - after_s < 0.1
        return FORCE_FAULTS[fault](block) if is_near else block

    validation = validate([altered(campaign[0], block=faulty)], dynamics, device_settings)
    (item,) = entered(validation)
    assert (item.force_beyond_0_5_s_n is None) is (after_s > 0.0)
    assert item.transient_peak_n


def test_a_force_above_a_million_newtons_is_not_known(
    campaign: list[Path], dynamics: RobotDynamics, device_settings: ValidationSettings, altered: Altered
) -> None:
    bag = altered(campaign[0], block=lambda block: block._replace(force=1e5 * block.force))
    protocol = Protocol.model_validate(content())
    test = filled(protocol.tests[0], validate([bag], dynamics, device_settings), ImportSettings(), bag.parent)
    (item,) = test.results.repetitions
    assert item.transient_peak_n is None
    evaluation = evaluate(protocol, test, bag.parent)
    assert evaluation.verdict == "UNKNOWN"
    assert "missing: tests.1.results.repetitions.1.transient_peak_n" in evaluation.reasons


@pytest.mark.parametrize("peak", [2e6, -5.0])  # decoding refuses NaN and infinity
def test_a_press_whose_peak_is_no_force_is_entered_without_it(
    peak: float,
    campaign: list[Path],
    dynamics: RobotDynamics,
    device_settings: ValidationSettings,
    altered: Altered,
    tmp_path: Path,
) -> None:
    """As another program may publish it, without its samples."""
    with open_bag(campaign[0]) as bag:
        first = next(impact for impact in detected_impacts(bag.force_blocks("/force")) if not impact.rebound)
    press = first._replace(peak_force=peak, held_force=60.0, compression_impulse=0.0)
    with open_bag(altered(campaign[0], without="/force")) as bag, BagWriter(tmp_path / "press.mcap") as writer:
        for message in bag.messages():
            writer.write(*message)
        writer.write("/impact", IMPACT, press.stamp_ns + 10**9, impact_message(press))
    values = content()
    values["tests"][0]["point"]["contact"] = "quasi_static"
    test = Protocol.model_validate(values).tests[0]
    validation = validate([tmp_path / "press.mcap"], dynamics, device_settings)
    (item,) = filled(test, validation, ImportSettings(), tmp_path).results.repetitions
    assert (item.transient_peak_n, item.time is None) == (None, False)


def test_a_recording_without_a_contact_is_refused(
    campaign: list[Path], dynamics: RobotDynamics, altered: Altered
) -> None:
    quiet = altered(campaign[0], block=lambda block: block._replace(force=1e-3 * block.force))
    with pytest.raises(BagError, match=r"no contact$"):
        entered(validate([quiet], dynamics, ValidationSettings()))


def test_a_recording_of_an_open_sensor_is_not_said_to_have_no_contact_alone(
    campaign: list[Path], dynamics: RobotDynamics, altered: Altered
) -> None:
    def is_open(block: ForceBlock) -> ForceBlock:
        return block._replace(force=0.0 * block.force, saturated_samples=np.arange(len(block.force), dtype=np.uint32))

    validation = validate([altered(campaign[0], block=is_open)], dynamics, ValidationSettings())
    assert "without signal: force not known" in dict(summary_lines(validation))["limit"]
    with pytest.raises(BagError, match=r"no contact \(.*1: no valid sample: sensor open"):
        entered(validation)


def test_all_other_force_of_the_recordings_is_entered(
    campaign: list[Path], dynamics: RobotDynamics, device_settings: ValidationSettings, altered: Altered
) -> None:
    """Contacts that are refused, force in no contact, lost samples, and a recording in which nothing happens."""
    onset_ns = validate(campaign[:1], dynamics, device_settings).result.impacts[0].stamp_ns

    def clipped(block: ForceBlock) -> ForceBlock:
        return block._replace(saturated_samples=np.flatnonzero(block.force >= 30.0).astype(np.uint32))

    def spoiled(block: ForceBlock) -> ForceBlock:
        after_s = (block.stamp_ns - onset_ns) / 1e9 - 0.3
        force = block.force.copy()
        force[5] += 400.0 * (0.0 <= after_s < 0.1)
        return block._replace(force=force, lost_samples=7 * (0.1 <= after_s < 0.2))

    def quiet(block: ForceBlock) -> ForceBlock:
        return block._replace(force=1e-3 * block.force)

    bags = [campaign[0], *(altered(campaign[0], block=change) for change in (clipped, spoiled, quiet))]
    test = ContactTest(id="1")
    left_out = filled(test, validate(bags, dynamics, device_settings), ImportSettings(), Path("/")).results.left_out
    by_reason = {(item.reason, Path(item.raw_data or "").name): item for item in left_out}
    clip = by_reason[CLIPPED, bags[1].name]
    assert (clip.complete, clip.held_n) == (False, 0.0)
    assert clip.raw_sha256
    assert by_reason[REBOUND, campaign[0].name].complete
    single = by_reason["single samples", bags[2].name]
    assert single.peak_n == pytest.approx(400.0, abs=3.0)
    assert single.held_n is None
    assert by_reason["lost samples", bags[2].name].count == 7
    assert by_reason["no contact", bags[3].name].complete


def test_a_contact_on_a_load_includes_it(
    campaign: list[Path], dynamics: RobotDynamics, device_settings: ValidationSettings, altered: Altered
) -> None:
    plain = entered(validate(campaign[:1], dynamics, device_settings))[0]
    assert plain.time
    assert plain.transient_peak_n
    onset_ns = round(plain.time.timestamp() * 1e9)

    def loaded(block: ForceBlock) -> ForceBlock:
        return block._replace(force=block.force + 50.0 * (block.stamp_ns - onset_ns > -0.6e9))

    (item,) = entered(validate([altered(campaign[0], block=loaded)], dynamics, device_settings))
    assert item.load_n == pytest.approx(50.0, abs=0.5)
    assert item.transient_peak_n == pytest.approx(plain.transient_peak_n + 50.0, abs=1.0)
    assert item.force_beyond_0_5_s_n == pytest.approx(50.0, abs=1.0)
    assert item.duration_s == plain.duration_s


def test_the_force_is_that_along_the_normal_of_the_plate(
    campaign: list[Path], dynamics: RobotDynamics, device_settings: ValidationSettings, altered: Altered
) -> None:
    """A sensor at 60 degrees to it measures half of the force."""
    along = {"plate_normal": (1.0, 0.0, 0.0), "guide_direction": (0.5, math.sqrt(0.75), 0.0)}
    (plain,) = entered(validate(campaign[:1], dynamics, device_settings))
    (item,) = entered(validate([altered(campaign[0], info=along)], dynamics, device_settings))
    assert plain.transient_peak_n
    assert item.transient_peak_n == pytest.approx(2.0 * plain.transient_peak_n, rel=1e-4)

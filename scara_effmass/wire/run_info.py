# SPDX-License-Identifier: Apache-2.0
"""Convert run information to and from CDR (`RunInfo.msg`), and from the JSON text in older recordings."""

import json
import math
from typing import Any

from scara_effmass.values import RunInfo, Vector3
from scara_effmass.wire.cdr import decode, encode

LATEST_NS = 2**63 - 1
UNUSABLE_NS = LATEST_NS + 1
"""Stands for an invalid time in JSON."""


def run_info_message(info: RunInfo) -> bytes:
    """Return the CDR bytes of a RunInfo."""
    return encode("RunInfo", info._asdict())


def decode_run_info(data: bytes) -> RunInfo:
    """Return the RunInfo in `data` (CDR of either byte order), unchecked. Raises DecodeError."""
    return RunInfo(**decode(data, "RunInfo"))


def run_info_from_json(text: str) -> RunInfo | None:
    """Return the run information in the JSON `text` of an older recording; None if it is not a JSON object.

    A value of the wrong type is replaced with one that `impacts.impact_matcher.check_run_info` refuses.
    """
    try:
        fields = json.loads(text)
    except (ValueError, RecursionError):
        return None
    if not isinstance(fields, dict):
        return None
    truth = fields["truth"] if isinstance(fields.get("truth"), dict) else {}
    has_plate = "point" in fields and "direction" in fields
    return RunInfo(
        stamp_ns=_nanoseconds(fields.get("since_ns")),
        configuration="" if fields.get("configuration") is None else str(fields["configuration"]),
        obstacle_mass=_number(fields.get("obstacle_mass")),
        impact_position=_vector_from(fields["point"]) if has_plate else (0.0, 0.0, 0.0),
        plate_normal=_vector_from(fields["direction"]) if has_plate else (0.0, 0.0, 0.0),
        simulated=bool(fields.get("simulated") or fields.get("generated")),
        note=str(fields.get("description", "")),
        contact_stiffness=_known(fields.get("stiffness")),
        contact_exponent=_known(fields.get("exponent")),
        true_onset_ns=_nanoseconds(truth.get("onset_ns")),
        true_speed=_known(truth.get("speed")),
        true_effective_mass=_known(truth.get("effective_mass")),
        true_peak_force=_known(truth.get("peak_force")),
        true_duration=_known(truth.get("duration")),
        true_impulse=_known(truth.get("impulse")),
    )


def _number(value: Any) -> float:  # noqa: ANN401 - any JSON value
    """Return `value` as a float: 0 if it is missing, NaN if it is not a number."""
    if value is None:
        return 0.0
    if isinstance(value, bool) or not isinstance(value, int | float):
        return math.nan
    return float(value) if abs(value) <= LATEST_NS else math.nan


def _known(value: Any) -> float:  # noqa: ANN401 - any JSON value
    """Return a value of the ground truth; 0 if it is unknown or not a positive number."""
    number = _number(value)
    return number if 0.0 < number < math.inf else 0.0


def _vector_from(values: Any) -> Vector3:  # noqa: ANN401 - any JSON value
    """Return a list of two or three numbers as a vector; NaN for anything else."""
    numbers = [_number(value) for value in values] if isinstance(values, list) else []
    x, y, z = {2: [*numbers, 0.0], 3: numbers}.get(len(numbers), [math.nan] * 3)
    return (x, y, z)


def _nanoseconds(value: Any) -> int:  # noqa: ANN401 - any JSON value
    """Return `value` as ROS time [ns]: 0 if it is missing, UNUSABLE_NS if it is invalid."""
    if value is None:
        return 0
    whole = isinstance(value, int) and not isinstance(value, bool) and abs(value) <= LATEST_NS
    return value if whole else UNUSABLE_NS

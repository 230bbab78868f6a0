# SPDX-License-Identifier: Apache-2.0
"""Compare the bulk assessment of joint states with that of the monitor, which serves as a second channel."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import zip_longest
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scara_effmass.analysis.assessment import AssessedStates
from scara_effmass.errors import CrossCheckError
from scara_effmass.kernel.records import FIELDS
from scara_effmass.values import BoolArray

TOLERANCE = 1e-10
"""Largest difference of two numbers, relative for numbers above 1."""


def cross_checked(
    source: str, states: Iterator[AssessedStates], reference: Iterator[AssessedStates]
) -> Iterator[AssessedStates]:
    """Yield the batches of `states`, from the recording `source`, while they agree with those of `reference`.

    Raises CrossCheckError, which names the first difference.
    """
    count = 0
    for own, other in zip_longest(states, reference):
        if own is None or other is None or len(own) != len(other):
            raise CrossCheckError(f"{source}: cross-check: the number of joint states differs from the monitor's")
        if difference := first_difference(own, other):
            row, text = difference
            where = f"joint state {count + row + 1} at {own.log_time_ns[row]} ns"
            raise CrossCheckError(f"{source}: cross-check: {where}: {text} by the monitor")
        count += len(own)
        yield own


def first_difference(states: AssessedStates, reference: AssessedStates) -> tuple[int, str] | None:
    """Return the first row in which `states` differs from `reference`, and the difference in words."""
    return min(differences(states, reference), key=lambda difference: difference[0], default=None)


def differences(states: AssessedStates, reference: AssessedStates) -> Iterator[tuple[int, str]]:
    """Yield for each column of `states` the first row that differs from `reference`, and the difference in words."""
    for (name, own), (_, other) in zip(_columns(states), _columns(reference), strict=True):
        differs = _differs(own, other)
        if differs.any():
            row = int(differs.argmax())
            yield row, f"{name} = {own[row : row + 1].tolist()[0]!r}, but {other[row : row + 1].tolist()[0]!r}"


def _differs(own: NDArray[Any], other: NDArray[Any]) -> BoolArray:
    """Return which rows differ (m,)."""
    if own.dtype.kind != "f":
        return np.asarray(own != other)
    with np.errstate(invalid="ignore"):
        is_close = np.abs(own - other) <= TOLERANCE * np.maximum(1.0, np.abs(other))
    is_equal = (own == other) | (np.isnan(own) & np.isnan(other)) | is_close
    return np.asarray(~is_equal.reshape(len(own), -1).all(axis=1))


def _columns(states: AssessedStates) -> Iterator[tuple[str, NDArray[Any]]]:
    assessments = states.assessments
    yield "log_time_ns", states.log_time_ns
    for name in ("stamp_ns", "age", "delay", "is_admitted"):
        yield name, assessments.states[name]
    for point, contact in enumerate(assessments.points):
        indices, texts = assessments.reasons(point)
        yield f"{contact}: reason", np.array(texts, object)[indices]
        for name in FIELDS:
            if name != "reason":
                yield f"{contact}: {name}", assessments.contacts[name][:, point]

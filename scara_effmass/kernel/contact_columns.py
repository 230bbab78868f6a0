# SPDX-License-Identifier: Apache-2.0
"""Assessments of one contact point at many joint states, as arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scara_effmass.kernel.records import OFFSETS
from scara_effmass.values import BoolArray, ContactAssessment, FloatArray

CodeArray = NDArray[np.int16]
VECTORS = {"direction": 3, "lumped_mobility": 6, "full_mobility": 6, "test_direction": 3}
"""Number of entries of the fields that are vectors."""


class ContactColumns(NamedTuple):
    """Assessments of one contact point at N joint states: the numbers of `ContactAssessment`, field by field.

    Arrays are (N,), (N, 3) of vectors and (N, 6) of mobilities. `verdict` holds the numbers of `Verdict` before
    debouncing. `body_region` to `mass_model_reason` are indices of the texts in `body_regions` to
    `mass_model_reasons`. `reason_at` makes the reason of one joint state.
    """

    contact_point: str
    contact_normal: str
    direction: FloatArray
    speed: FloatArray
    effective_mass: FloatArray
    lumped_mass: FloatArray
    full_mass: FloatArray
    iso_mass: FloatArray
    worst_direction_mass: FloatArray
    body_mass: FloatArray
    reduced_mass: FloatArray
    stiffness: FloatArray
    predicted_force: FloatArray
    allowable_speed: FloatArray
    margin: FloatArray
    smallest_singular_value: FloatArray
    worst_normal_reduced_mass: FloatArray
    force_bound: FloatArray
    clamping_force: FloatArray
    lumped_mobility: FloatArray
    full_mobility: FloatArray
    test_direction: FloatArray
    test_effective_mass: FloatArray
    worst_direction_used: BoolArray
    mass_capped: BoolArray
    verdict: NDArray[np.int8]
    body_region: CodeArray
    criterion: CodeArray
    mass_model: CodeArray
    mass_model_reason: CodeArray
    body_regions: tuple[str, ...]
    criteria: tuple[str, ...]
    mass_models: tuple[str, ...]
    mass_model_reasons: tuple[str, ...]
    reason_at: Callable[[int], str]

    def reasons(self, indices: Iterable[int]) -> list[str]:
        """Return the reasons of the joint states at `indices`, before debouncing; empty where the verdict is OK."""
        return [self.reason_at(index) for index in indices]

    def labels(self) -> list[tuple[str, ...]]:
        """Return body region, criterion, mass model and its reason of each joint state."""
        codes = zip(self.body_region, self.criterion, self.mass_model, self.mass_model_reason, strict=True)
        texts = self.body_regions, self.criteria, self.mass_models, self.mass_model_reasons
        return [tuple(text[code] for text, code in zip(texts, row, strict=True)) for row in codes]


LABELS = {
    "body_region": "body_regions",
    "criterion": "criteria",
    "mass_model": "mass_models",
    "mass_model_reason": "mass_model_reasons",
}
"""The fields that are indices, and those of their texts."""
_FIRST, _LAST = (ContactColumns._fields.index(name) for name in ("direction", "verdict"))
NUMBERS = ContactColumns._fields[_FIRST : _LAST + 1]
"""The fields that are numbers, flags and the verdict."""
_TYPES = {"worst_direction_used": np.bool_, "mass_capped": np.bool_, "verdict": np.int8}


def columns_of(point: str, normal: str, contacts: list[ContactAssessment]) -> ContactColumns:
    """Return `contacts`, assessments of the contact `point` for the contact `normal` before debouncing, as arrays."""
    fields = dict(zip(ContactAssessment._fields, zip(*contacts, strict=True), strict=True)) if contacts else {}
    numbers = {
        name: np.array(fields.get(name, ()), np.float64).reshape((-1, VECTORS[name]) if name in VECTORS else -1)
        for name in NUMBERS
    }
    labels: dict[str, CodeArray | tuple[str, ...]] = {}
    for name, of_name in LABELS.items():
        values = fields.get(name, ())
        labels[of_name] = texts = tuple(dict.fromkeys(values))
        labels[name] = np.array([texts.index(value) for value in values], np.int16)
    return assembled(point, normal, numbers, labels, lambda index: contacts[index].reason)


def columns_of_kernel(
    point: str, normal: str, columns: FloatArray, texts: Mapping[str, tuple[str, ...]], reason_at: Callable[[int], str]
) -> ContactColumns:
    """Return the `columns` (fields, N) of the kernel by name; `texts` are those of the fields in LABELS."""
    numbers = {
        name: columns[OFFSETS[name] : OFFSETS[name] + VECTORS[name]].T if name in VECTORS else columns[OFFSETS[name]]
        for name in NUMBERS
    }
    labels: dict[str, CodeArray | tuple[str, ...]] = {of_name: texts[name] for name, of_name in LABELS.items()}
    labels |= {name: columns[OFFSETS[name]].astype(np.int16) for name in LABELS}
    return assembled(point, normal, numbers, labels, reason_at)


def assembled(
    point: str,
    normal: str,
    numbers: Mapping[str, FloatArray],
    labels: Mapping[str, CodeArray | tuple[str, ...]],
    reason_at: Callable[[int], str],
) -> ContactColumns:
    """Return the columns with float `numbers` of each field in NUMBERS, in the types of `ContactColumns`."""
    fields = {"contact_point": point, "contact_normal": normal, **numbers, **labels, "reason_at": reason_at}
    for name, kind in _TYPES.items():
        fields[name] = numbers[name].astype(kind)
    return ContactColumns._make(fields[name] for name in ContactColumns._fields)


def joined(parts: Sequence[ContactColumns]) -> ContactColumns:
    """Return the columns of one contact point whose joint states are those of `parts`, one after the other."""
    fields: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in NUMBERS}
    for name, of_name in LABELS.items():
        texts = tuple(dict.fromkeys(text for part in parts for text in getattr(part, of_name)))
        codes = [np.array([texts.index(text) for text in getattr(part, of_name)], np.int16) for part in parts]
        pairs = zip(codes, parts, strict=True)
        fields |= {name: np.concatenate([own[getattr(part, name)] for own, part in pairs]), of_name: texts}
    starts = np.cumsum([0, *(len(part.verdict) for part in parts)])

    def reason_at(index: int) -> str:
        number = int(np.searchsorted(starts, index, "right")) - 1
        return parts[number].reason_at(index - int(starts[number]))

    return parts[0]._replace(**fields, reason_at=reason_at)

# SPDX-License-Identifier: Apache-2.0
"""Assessed joint states as columns: what tables, summaries and reports are made of."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from scara_effmass.bags.batches import IntArray
from scara_effmass.kernel.contact_columns import LABELS, NUMBERS, VECTORS, ContactColumns, columns_of
from scara_effmass.safety import allowed
from scara_effmass.values import BoolArray, ContactAssessment, Decision, FloatArray, Verdict

ROWS = 49_152
"""Most rows in one batch of columns: smaller batches cost time, larger ones memory."""
Positions = Callable[[int], Mapping[str, float]]


@dataclass(frozen=True, slots=True)
class AssessedStates:
    """Joint states (m,) of one robot in order, and their assessments at each contact point.

    `log_time_ns`, `stamp_ns`, `input_age` [s] and `velocity_delay` [s] are (m,); `refused` (m,) marks those without
    numbers. The verdicts in `contacts` are debounced; `reasons` (m,) of each contact point are indices of its
    `reason_texts`. `positions` gives the joint positions of one state by name [rad, m].
    """

    log_time_ns: IntArray
    stamp_ns: IntArray
    input_age: FloatArray
    velocity_delay: FloatArray
    refused: BoolArray
    contacts: tuple[ContactColumns, ...]
    reasons: tuple[IntArray, ...]
    reason_texts: tuple[Sequence[str], ...]
    positions: Positions

    def __len__(self) -> int:
        return len(self.log_time_ns)

    def assessments(self, point: int, rows: slice) -> list[ContactAssessment]:
        """Return the assessments of contact point number `point` in `rows`."""
        contact, count = self.contacts[point], len(self.log_time_ns[rows])
        fields: dict[str, Sequence[object]] = {name: getattr(contact, name)[rows].tolist() for name in NUMBERS}
        for name, texts in LABELS.items():
            fields[name] = [getattr(contact, texts)[index] for index in getattr(contact, name)[rows].tolist()]
        for name in VECTORS:
            fields[name] = list(map(tuple, getattr(contact, name)[rows].tolist()))
        fields["verdict"] = list(map(Verdict, contact.verdict[rows].tolist()))
        fields["reason"] = [self.reason_texts[point][index] for index in self.reasons[point][rows].tolist()]
        fields["contact_point"] = [contact.contact_point] * count
        columns = (fields[name] for name in ContactAssessment._fields)
        return list(map(ContactAssessment._make, zip(*columns, strict=True)))

    def contact(self, point: int, row: int) -> ContactAssessment:
        """Return the assessment of contact point number `point` in `row`."""
        return self.assessments(point, slice(row, row + 1))[0]

    def decisions(self, reference_speed: float) -> Iterator[Decision]:
        """Yield the decision on each joint state, with the speed scaling for `reference_speed`; see `allowed`."""
        normal = self.contacts[0].contact_normal
        contacts = zip(*(self.assessments(point, slice(None)) for point in range(len(self.contacts))), strict=True)
        columns = (self.stamp_ns, self.input_age, self.velocity_delay, self.refused)
        for stamp_ns, age, delay, refused, own in zip(*(column.tolist() for column in columns), contacts, strict=True):
            contact_normal = "" if refused else normal
            yield Decision(stamp_ns, age, delay, contact_normal, False, own, *allowed(own, reference_speed))  # noqa: FBT003


def batch_size(points: int) -> int:
    """Return the joint states in one batch: each has a row for each of `points` contact points."""
    return max(ROWS // points, 1)


def states_of(
    log_time_ns: Sequence[int], decisions: Sequence[Decision], positions: Positions = lambda _: {}
) -> AssessedStates:
    """Return the decisions at `log_time_ns`, one per joint state, as columns."""
    points = list(zip(*(decision.contacts for decision in decisions), strict=True))
    texts = tuple(list(dict.fromkeys(contact.reason for contact in contacts)) for contacts in points)
    indices = [{text: index for index, text in enumerate(own)} for own in texts]
    normal = max(decision.contact_normal for decision in decisions)  # empty where a state is refused
    return AssessedStates(
        log_time_ns=np.array(log_time_ns, np.int64),
        stamp_ns=np.array([decision.stamp_ns for decision in decisions], np.int64),
        input_age=np.array([decision.input_age for decision in decisions]),
        velocity_delay=np.array([decision.velocity_delay for decision in decisions]),
        refused=np.array([not decision.contact_normal for decision in decisions]),
        contacts=tuple(columns_of(contacts[0].contact_point, normal, list(contacts)) for contacts in points),
        reasons=tuple(
            np.array([index[contact.reason] for contact in contacts], np.int64)
            for index, contacts in zip(indices, points, strict=True)
        ),
        reason_texts=texts,
        positions=positions,
    )

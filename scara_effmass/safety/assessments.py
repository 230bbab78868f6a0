# SPDX-License-Identifier: Apache-2.0
"""Assessments of contacts at joint states: one structured array, with the texts of its codes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scara_effmass.codes import Reason
from scara_effmass.kernel.records import CONTACT, FIELDS, PLACES, REASON_SIZE
from scara_effmass.kernel.state import CODE, DETAIL, STATE
from scara_effmass.safety.assumptions import NO_ASSUMPTIONS, Assumptions
from scara_effmass.safety.reasons import CRITERIA, MODELS, NO_TEXTS, ReasonTexts
from scara_effmass.values import ContactAssessment, Decision, FloatArray, Verdict

BLOCK = 64
"""Number of contacts that are turned into columns together: few enough for the first-level cache."""
Records = np.ndarray[Any, np.dtype[np.void]]
_PLACED = [(name, shape, PLACES[name]) for name, shape in FIELDS.items()]
_fields: Callable[[tuple[float, ...]], tuple[Any, ...]] = itemgetter(
    *(slice(at, at + shape[0]) if shape else at for _, shape, at in _PLACED)
)
"""Returns the fields of a contact from its numbers, in order."""
_REASON = slice(PLACES["reason"], PLACES["reason"] + REASON_SIZE)
_STATE_FIELDS = STATE.names or ()


@dataclass(eq=False, slots=True)
class Assessments:
    """Assessments of P contacts at N joint states, in order.

    `state_bytes` are the bytes of N `State`s, `numbers` (N, P, fields) those of the `Contact`s. `points` names the
    contacts, `normal` the contact normal; `details` are texts of reasons, `assumptions` what is not stated.
    """

    state_bytes: NDArray[np.uint8]
    numbers: FloatArray
    points: tuple[str, ...]
    normal: str
    details: Sequence[str]
    texts: ReasonTexts
    assumptions: Assumptions

    def __len__(self) -> int:
        return len(self.numbers)

    @property
    def states(self) -> Records:
        """The joint states (N,), of dtype STATE."""
        return self.state_bytes.view(STATE)

    @property
    def contacts(self) -> Records:
        """The contacts (N, P), of dtype CONTACT."""
        return self.numbers.view(CONTACT)[..., 0]

    @property
    def labels(self) -> Mapping[str, tuple[str, ...]]:
        """Texts of the fields that are codes, by code."""
        return {
            "body_region": self.texts.regions,
            "criterion": CRITERIA,
            "mass_model": MODELS,
            "mass_model_reason": self.texts.whys,
        }

    def reason(self, row: int, point: int) -> str:
        """Return the reason of one contact at one joint state, empty if it is OK."""
        return self.texts.text(self.contacts["reason"][row, point].tolist(), self.details)

    def reasons(self, point: int) -> tuple[NDArray[np.int64], list[str]]:
        """Return for each joint state (N,) the index of the reason of one contact, and the texts.

        Equal reasons that follow each other share one text.
        """
        rows = self.contacts["reason"][:, point]
        changes = np.any(rows[1:] != rows[:-1], axis=1)
        indices = np.concatenate((np.zeros(min(len(rows), 1), np.int64), np.cumsum(changes)))
        firsts = np.flatnonzero(np.concatenate((np.ones(min(len(rows), 1), np.bool_), changes)))
        return indices, [self.texts.text(reason, self.details) for reason in rows[firsts].tolist()]

    @property
    def limit_shares(self) -> FloatArray:
        """Speed over allowable speed (N, P); infinite where nothing is allowed."""
        speed, allowed = self.contacts["speed"], self.contacts["allowable_speed"]
        return np.asarray(np.divide(speed, allowed, out=np.full(speed.shape, np.inf), where=allowed > 0.0))

    def deciding(self) -> NDArray[np.int64]:
        """Return the contact (N,) that decides: one without a verdict, else that with the largest share of its limit.

        Among several, the first with the smallest margin decides, as in `kernel.settle`.
        """
        contacts = self.contacts
        keys = contacts["margin"], -self.limit_shares, contacts["verdict"] != Verdict.UNKNOWN
        order: NDArray[np.int64] = np.lexsort(keys, axis=1)
        return order[:, 0]

    def columns(self) -> Mapping[str, FloatArray]:
        """Return the fields of the contacts by name, each (N * P,) or (k, N * P) and contiguous."""
        rows = self.numbers.reshape(-1, self.numbers.shape[-1])
        columns = np.empty(rows.shape[::-1])
        for first in range(0, len(rows), BLOCK):
            columns[:, first : first + BLOCK] = rows[first : first + BLOCK].T
        return {name: columns[at : at + shape[0]] if shape else columns[at] for name, shape, at in _PLACED}

    def decision(self, row: int, contacts: Sequence[int] | None = None) -> Decision:
        """Return the assessment at joint state number `row` of the `contacts` with these numbers, by default of all."""
        state = dict(zip(_STATE_FIELDS, self.states[row].item(), strict=True))  # once: an access by name takes long
        return Decision(
            stamp_ns=state["stamp_ns"],
            input_age=state["age"],
            velocity_delay=state["delay"],
            contact_normal=self.normal if state["is_admitted"] else "",
            watchdog=bool(state["is_watchdog"]),
            contacts=self._contacts(row, range(len(self.points)) if contacts is None else contacts),
            allowable_speed=state["allowable_speed"],
            speed_scaling=state["speed_scaling"],
            assumptions=self.assumptions.assumed,
            accepted_assumptions=self.assumptions.accepted,
            scope=self.texts.scope,
        )

    def decisions(self, contacts: Sequence[int] | None = None) -> Iterator[Decision]:
        """Yield the `decision` at each joint state."""
        return (self.decision(row, contacts) for row in range(len(self)))

    def _contacts(self, row: int, chosen: Sequence[int]) -> tuple[ContactAssessment, ...]:
        labels, contacts = self.labels, list[ContactAssessment]()
        for point in chosen:
            numbers: list[float] = self.numbers[row, point].tolist()
            text = self.texts.text(numbers[_REASON], self.details)
            contacts.append(contact_of(numbers, self.points[point], text, labels))
        return tuple(contacts)


def contact_of(
    numbers: Sequence[float], point: str, reason: str, labels: Mapping[str, tuple[str, ...]]
) -> ContactAssessment:
    """Return the contact with these `numbers`, with the text of its reason; `labels` are the texts of its codes."""
    fields: dict[str, Any] = dict(zip(FIELDS, _fields(tuple(numbers)), strict=True))
    fields |= {name: texts[int(fields[name])] for name, texts in labels.items()}
    fields |= {
        "worst_direction_used": bool(fields["worst_direction_used"]),
        "mass_capped": bool(fields["mass_capped"]),
        "verdict": Verdict(int(fields["verdict"])),
        "reason_code": Reason(int(fields["reason"][CODE])),
        "contact_point": point,
        "reason": reason,
    }
    return ContactAssessment(**fields)


def joined(parts: Sequence[Assessments], numbers: FloatArray | None = None) -> Assessments:
    """Return the assessments of joint states that follow each other, whose codes have the same texts.

    `numbers` are those of all parts, where they lie together already: to copy them takes as long as to admit.
    """
    if len(parts) == 1:
        return parts[0]
    if numbers is None:
        numbers = np.concatenate([part.numbers for part in parts])
    return replace(parts[-1], state_bytes=np.concatenate([part.state_bytes for part in parts]), numbers=numbers)


def unknown_numbers(iso_mass: float = 0.0) -> FloatArray:
    """Return a contact (fields,) without numbers: all are 0, the masses of the models NaN."""
    contact = np.zeros(1, CONTACT)
    contact["lumped_mass"] = contact["full_mass"] = np.nan
    contact["iso_mass"] = iso_mass
    return contact.view(np.float64)


_NO_LABELS = dict.fromkeys(("body_region", "criterion", "mass_model", "mass_model_reason"), ("",))


def unknown_contact(point: str, reason: str, code: Reason = Reason.STATED) -> ContactAssessment:
    """Return an UNKNOWN without numbers."""
    contact = contact_of(unknown_numbers().tolist(), point, reason, _NO_LABELS)
    return contact._replace(reason_code=code)


def unknown_assessments(
    reason: Reason, detail: str = "", stamp_ns: int = 0, points: tuple[str, ...] = ("",), *, watchdog: bool = False
) -> Assessments:
    """Return UNKNOWN for each contact point without a monitor; `watchdog`: it answers no joint state.

    Without a robot there is one contact point, without a name.
    """
    record = np.zeros(1, STATE)
    record["stamp_ns"], record["is_watchdog"] = max(stamp_ns, 0), watchdog
    numbers = np.tile(unknown_numbers(), (1, len(points), 1))
    numbers.view(CONTACT)["reason"][..., [CODE, DETAIL]] = reason, 1.0
    record["verdict"] = Verdict.UNKNOWN
    return Assessments(record.view(np.uint8), numbers, points, "", ("", detail), NO_TEXTS, NO_ASSUMPTIONS)

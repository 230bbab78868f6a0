# SPDX-License-Identifier: Apache-2.0
"""Decisions and assessments made of contacts, for tests of what reads them."""

from typing import Any

import numpy as np

from scara_effmass.analysis.assessment import AssessedStates, Source
from scara_effmass.bags.batches import IntArray, JointStateBlock
from scara_effmass.codes import Reason
from scara_effmass.kernel.records import CONTACT, FIELDS
from scara_effmass.kernel.state import CODE, DETAIL, STATE
from scara_effmass.safety import Assessments
from scara_effmass.safety.assumptions import Assumptions
from scara_effmass.safety.reasons import CRITERIA, MODELS, ReasonTexts
from scara_effmass.values import ContactAssessment, Decision, Verdict


def decision_on(*contacts: ContactAssessment, stamp_ns: int = 1, **fields: Any) -> Decision:  # noqa: ANN401
    """Return the decision on `contacts`, with other values where `fields` state them."""
    is_known = all(contact.verdict is not Verdict.UNKNOWN for contact in contacts)
    speed = min(contact.allowable_speed for contact in contacts) if is_known else 0.0
    ratios = [contact.allowable_speed / max(contact.speed, contact.allowable_speed, 1e-9) for contact in contacts]
    decision = Decision(
        stamp_ns=stamp_ns,
        input_age=0.0,
        velocity_delay=0.0,
        contact_normal="worst",
        watchdog=False,
        contacts=contacts,
        allowable_speed=speed,
        speed_scaling=min(ratios) if is_known else 0.0,
    )
    return decision._replace(**fields)


def assessments_of(*decisions: Decision) -> Assessments:
    """Return decisions on the same contact points as arrays; a reason without a code keeps its text alone."""
    contacts = [contact for decision in decisions for contact in decision.contacts]
    texts = ReasonTexts(
        regions=tuple(dict.fromkeys(["", *(contact.body_region for contact in contacts)])),
        whys=tuple(dict.fromkeys(["", *(contact.mass_model_reason for contact in contacts)])),
        scope=decisions[0].scope,
    )
    details = list(dict.fromkeys(["", *(contact.reason for contact in contacts)]))
    numbers = np.zeros((len(decisions), len(decisions[0].contacts), CONTACT.itemsize // 8))
    for record, contact in zip(numbers.view(CONTACT).reshape(-1), contacts, strict=True):
        codes = {
            "body_region": texts.regions.index(contact.body_region),
            "criterion": CRITERIA.index(contact.criterion),
            "mass_model": MODELS.index(contact.mass_model),
            "mass_model_reason": texts.whys.index(contact.mass_model_reason),
        }
        for name in FIELDS.keys() - {"reason"}:
            record[name] = codes.get(name, getattr(contact, name))
        if contact.reason:
            record["reason"][[CODE, DETAIL]] = contact.reason_code or Reason.STATED, details.index(contact.reason)
    states = np.zeros(len(decisions), STATE)
    for state, decision in zip(states, decisions, strict=True):
        state["stamp_ns"], state["age"], state["delay"] = decision.stamp_ns, decision.input_age, decision.velocity_delay
        state["is_admitted"], state["is_watchdog"] = bool(decision.contact_normal), decision.watchdog
        state["verdict"], state["contact"] = decision.verdict, decision.contacts.index(decision.worst)
        state["allowable_speed"], state["speed_scaling"] = decision.allowable_speed, decision.speed_scaling
    points = tuple(contact.contact_point for contact in decisions[0].contacts)
    assumptions = Assumptions(decisions[0].assumptions, decisions[0].accepted_assumptions)
    normal = decisions[0].contact_normal
    return Assessments(states.view(np.uint8), numbers, points, normal, details, texts, assumptions)


def states_of(
    *decisions: Decision, log_time_ns: int | IntArray, positions: dict[str, float] | None = None
) -> AssessedStates:
    """Return decisions on joint states that were recorded at `log_time_ns`, all at `positions` if they are given."""
    source, times = Source(0, None, 0), np.full(len(decisions), log_time_ns)
    if positions is not None:
        rows = np.tile(list(positions.values()), (len(decisions), 1))
        source = Source(0, JointStateBlock(times, times, tuple(positions), rows, np.zeros_like(rows), rows[:, :0]), 0)
    return AssessedStates(times, assessments_of(*decisions), [source], lambda names: names)

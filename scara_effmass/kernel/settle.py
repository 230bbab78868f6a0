# SPDX-License-Identifier: Apache-2.0
"""From verdicts on single joint states to those that are published: assumptions, debouncing, cause, latch and minima.

A worse verdict shows at once. A better one shows after the release time, in which the worse one is held.
"""

from __future__ import annotations

import math
from typing import Any

from scara_effmass import values
from scara_effmass.codes import Reason
from scara_effmass.kernel.compiled import BYTES, MATRICES, VECTOR, compiled, inlined
from scara_effmass.kernel.records import CONTACT, ByteArray, Contact
from scara_effmass.kernel.state import (
    CODE,
    DEBOUNCE,
    DETAIL,
    HELD,
    LATCHED,
    MEMORY,
    RULES,
    STATE,
    Debounce,
    Memory,
    State,
    copy_reason,
    set_reason,
)
from scara_effmass.values import FloatArray, Verdict

UNKNOWN, OK, WARN, VIOLATION = int(Verdict.UNKNOWN), int(Verdict.OK), int(Verdict.WARN), int(Verdict.VIOLATION)
WORST_FIRST = UNKNOWN, VIOLATION, WARN


severity, limit_share = inlined(values.severity), inlined(values.limit_share)


@inlined
def allow_nothing(contact: Contact, verdict: int) -> None:
    """Write a verdict under which the contact point must not move."""
    contact.verdict, contact.allowable_speed, contact.margin = verdict, 0.0, -contact.speed


@inlined
def debounce(contact: Contact, stamp_ns: int, release_ns: int, memory: Debounce) -> None:
    """Write the verdict that shows at `stamp_ns`, and its reason."""
    if memory.is_stale != 0:
        memory.seen_ns[UNKNOWN], memory.has_seen[UNKNOWN], memory.is_stale = stamp_ns, 1, 0
        copy_reason(memory.stale_reason, memory.reasons[UNKNOWN])
    verdict = int(contact.verdict)
    if verdict != OK:
        memory.seen_ns[verdict], memory.has_seen[verdict] = stamp_ns, 1
        copy_reason(contact.reason, memory.reasons[verdict])
    for worse in WORST_FIRST:
        if worse == verdict:
            break
        if memory.has_seen[worse] == 0:
            continue
        if stamp_ns - memory.seen_ns[worse] < release_ns:
            copy_reason(memory.reasons[worse], contact.reason)
            contact.reason[HELD] = 1.0
            contact.verdict = worse
            if worse == UNKNOWN:
                allow_nothing(contact, UNKNOWN)
            break
        memory.has_seen[worse] = 0


@inlined
def note_cause(state: State, contacts: tuple[Contact, ...], memory: Memory) -> None:
    """Count the verdicts, and remember the first cause."""
    for p in range(len(contacts)):
        verdict = int(contacts[p].verdict)
        memory.counts[verdict] += 1
        if verdict != UNKNOWN:
            memory.had_valid_input = 1
        if (verdict in (UNKNOWN, VIOLATION)) and memory.had_valid_input != 0 and memory.has_cause == 0:
            memory.has_cause, memory.cause_stamp_ns, memory.cause_point = 1, state.stamp_ns, p + 1
            memory.cause_verdict = verdict
            copy_reason(contacts[p].reason, memory.cause_reason)


@inlined
def latch(contacts: tuple[Contact, ...], memory: Memory) -> None:
    """Write the verdict of the first cause, unless that of a contact is worse; nothing is allowed."""
    for p in range(len(contacts)):
        contact = contacts[p]
        if severity(int(contact.verdict)) <= severity(memory.cause_verdict):
            copy_reason(memory.cause_reason, contact.reason)
            contact.reason[LATCHED] = memory.cause_point + 1.0
            allow_nothing(contact, memory.cause_verdict)


@inlined
def is_worse(contact: Contact, other: Contact) -> bool:
    """Return whether a contact has a worse verdict than another, or the same one and a larger share of its limit."""
    worse = severity(int(contact.verdict)) - severity(int(other.verdict))
    share = limit_share(contact.speed, contact.allowable_speed)
    other_share = limit_share(other.speed, other.allowable_speed)
    closer = share > other_share or (share == other_share and contact.margin < other.margin)
    return worse > 0 or (worse == 0 and closer)


@inlined
def summarize(state: State, contacts: tuple[Contact, ...], reference_speed: float) -> None:
    """Write the worst verdict of all contacts, the smallest allowable speed, and the speed scaling."""
    state.allowable_speed, state.speed_scaling, state.contact = math.inf, 1.0, 0
    for p in range(len(contacts)):
        contact = contacts[p]
        allowed, verdict = contact.allowable_speed, int(contact.verdict)
        speed = reference_speed if reference_speed > 0.0 else contact.speed
        state.allowable_speed = min(state.allowable_speed, allowed)
        if verdict == UNKNOWN or allowed <= 0.0:
            state.speed_scaling = 0.0
        elif speed > allowed:
            state.speed_scaling = min(state.speed_scaling, allowed / speed)
        if p > 0 and is_worse(contact, contacts[state.contact]):
            state.contact = p
    state.verdict = int(contacts[state.contact].verdict)


@compiled(BYTES, MATRICES, VECTOR, BYTES, BYTES, BYTES)
def settle(
    states: ByteArray,
    numbers: FloatArray,
    unknown: FloatArray,
    rules_of: ByteArray,
    memory_of: ByteArray,
    debounces: ByteArray,
) -> None:
    """Settle the verdicts of P contacts at N joint states in order.

    `numbers` (N, P, fields) are Contacts, `unknown` (fields,) one without numbers. The others are the bytes of State,
    Rules, Memory and, per contact, Debounce.
    """
    contacts_of: Any = numbers.view(CONTACT)
    rows = states.view(STATE)
    rules, memory, remembered = rules_of.view(RULES)[0], memory_of.view(MEMORY)[0], debounces.view(DEBOUNCE)
    for row in range(len(rows)):
        state, contacts = rows[row], contacts_of[row, :, 0]
        has_reason = state.reason[CODE] != 0.0
        for p in range(len(contacts)):
            contact, debouncer = contacts[p], remembered[p]
            if state.is_cleared != 0:
                debouncer.has_seen[:] = 0
                debouncer.is_stale = 0
            if has_reason and state.is_watchdog == 0:
                debouncer.is_stale = 1
                copy_reason(state.reason, debouncer.stale_reason)
            if state.is_admitted != 0:
                if state.doubt != 0 and int(contact.verdict) == OK:
                    contact.verdict = WARN
                    set_reason(contact.reason, Reason.HEAVIER_LOAD, 0, 0.0, 0.0, 0.0)
                    contact.reason[DETAIL] = state.doubt
                if rules.is_assumed and int(contact.verdict) == OK:
                    contact.verdict = WARN
                    set_reason(contact.reason, Reason.ASSUMED, 0, 0.0, 0.0, 0.0)
                debounce(contact, state.stamp_ns, rules.release_ns, debouncer)
            else:
                for field in range(len(unknown)):
                    numbers[row, p, field] = unknown[field]
                copy_reason(state.reason, contact.reason)
        note_cause(state, contacts, memory)
        if rules.latches and memory.has_cause != 0:
            latch(contacts, memory)
        summarize(state, contacts, rules.reference_speed)

# SPDX-License-Identifier: Apache-2.0
"""Records of joint states on their way through the monitor, of what it remembers between them, and reasons in them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from scara_effmass.codes import Reason
from scara_effmass.kernel.compiled import inlined
from scara_effmass.kernel.records import REASON_SIZE, IntArray, dtype_of
from scara_effmass.values import FloatArray

CODE, JOINT, DETAIL, HELD, LATCHED, WORDS, VALUES = range(7)
"""Places in a reason: its code, a joint, a text beside it; 1 if held from an earlier joint state; the text that names
the contact that latched it, plus 1; its whole text if it is of earlier settings; from VALUES on up to six numbers."""
ReasonArray = Annotated[FloatArray, (REASON_SIZE,)]
NO_SEQUENCE = -1


@dataclass
class State:
    """One joint state: stamp and receive time on the node's clock [ns], number at its publisher, and what became of it.

    `reason` says why it is refused; that of an admitted one, which gap lies before it. `is_cleared`: the clock jumped
    back, so all that came before is forgotten. `is_watchdog`: it stands for none that came. `verdict`, `contact` (the
    worst one), `allowable_speed` [m/s] and `speed_scaling` are those of all contacts. `doubt` is the text that says why
    it is not OK though it is admitted, 0 without one.
    """

    stamp_ns: int
    now_ns: int
    sequence: int
    reason: ReasonArray
    is_admitted: int
    is_cleared: int
    is_watchdog: int
    age: float
    delay: float
    verdict: int
    contact: int
    allowable_speed: float
    speed_scaling: float
    doubt: int


@dataclass
class Rules:
    """Settings of admission, debouncing and latch.

    `filters_velocity`: qd is filtered. `distrusted_code` and `distrusted_detail`: the reason why an input is not
    trusted, 0 if all are. `is_assumed`: an assumption allows no OK.
    """

    timeout_ns: int
    future_tolerance_ns: int
    clock_step_ns: int
    velocity_tolerance: float
    max_lag: float
    filters_velocity: bool
    expects_commands: bool
    distrusted_code: int
    distrusted_detail: int
    release_ns: int
    latches: bool
    reference_speed: float
    is_assumed: bool


@dataclass
class Memory:
    """What admission and the latch remember.

    The cause is the first VIOLATION or UNKNOWN after the first valid joint state; `cause_point` is the text that
    names its contact.
    """

    last_stamp_ns: int
    sequence: int
    observed_ns: int
    is_comparing: int
    command_ns: int
    has_command: int
    lag_correlation: float
    lag_excitation: float
    had_valid_input: int
    has_cause: int
    cause_stamp_ns: int
    cause_point: int
    cause_verdict: int
    cause_reason: ReasonArray
    rejected: int
    counts: Annotated[IntArray, (4,)]


@dataclass
class JointMemory:
    """Limits and comparison of one joint [rad, m], whose positions are the same modulo its `period`, 0 for none.

    `since_ns` is the stamp of its last disagreement, or of the start of the comparison, `since_position` its position
    then. `error` to `allowance` fade with WINDOW_S: displacement minus integral of the velocity; mean velocity; largest
    difference between the velocity and its mean; error that its scale and its sampling explain. The accelerations
    [rad/s2, m/s2] are low-passed with FAST_S and SLOW_S.
    """

    lower: float
    upper: float
    max_speed: float
    period: float
    position_tolerance: float
    command_tolerance: float
    command: float
    position: float
    velocity: float
    error: float
    mean_velocity: float
    peak: float
    allowance: float
    fast_acceleration: float
    slow_acceleration: float
    is_unconfirmed: int
    since_ns: int
    since_position: float


@dataclass
class Debounce:
    """Last time and reason of each verdict of one contact, by its number; `is_stale`: UNKNOWN holds from the next."""

    seen_ns: Annotated[IntArray, (4,)]
    has_seen: Annotated[IntArray, (4,)]
    reasons: Annotated[FloatArray, (4, REASON_SIZE)]
    is_stale: int
    stale_reason: ReasonArray


STATE, RULES, MEMORY = dtype_of(State), dtype_of(Rules), dtype_of(Memory)
JOINT_MEMORY, DEBOUNCE = dtype_of(JointMemory), dtype_of(Debounce)


@inlined
def set_reason(reason: FloatArray, code: Reason, joint: int, a: float, b: float, c: float) -> None:
    """Write a reason with its joint and up to three numbers."""
    for i in range(REASON_SIZE):
        reason[i] = 0.0
    reason[CODE], reason[JOINT] = code.value, joint
    reason[VALUES], reason[VALUES + 1], reason[VALUES + 2] = a, b, c


@inlined
def copy_reason(source: FloatArray, target: FloatArray) -> None:
    """Copy a reason."""
    for i in range(REASON_SIZE):
        target[i] = source[i]

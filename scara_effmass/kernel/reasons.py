# SPDX-License-Identifier: Apache-2.0
"""Reasons of verdicts, as the kernel writes them; `state` has their places and does without numba."""

from scara_effmass.codes import Reason
from scara_effmass.kernel.jit import inlined
from scara_effmass.kernel.records import REASON_SIZE
from scara_effmass.kernel.state import CODE, JOINT, VALUES
from scara_effmass.values import FloatArray


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

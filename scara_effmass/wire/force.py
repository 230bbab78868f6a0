# SPDX-License-Identifier: Apache-2.0
"""Convert ForceBlock and Impact messages to and from the values of the same names.

Tests compare both layouts with rclpy and rosbags.
"""

import numpy as np

from scara_effmass.errors import DecodeError
from scara_effmass.values import MAX_LOST_SAMPLES, ForceBlock, Impact
from scara_effmass.wire.cdr import decode, encode
from scara_effmass.wire.message_types import IMPACT

_SAMPLE_RATES = (1e-3, 1e9)
"""Range of sample rates [Hz]; with others, computed times would overflow."""
_MAX_SAMPLE = 2**53
"""Maximum index that a 64-bit float counts exactly, and maximum size of the numbers of an impact."""
_IMPACT_NUMBERS = (
    *("peak_force", "duration", "impulse", "onset_sample", "baseline", "noise", "compression_impulse"),
    *("held_force", "load_force"),
)
ADDED_FIELDS = {IMPACT: 2}
"""Number of fields at the end of a message that recordings of earlier versions do not have; they have defaults."""


def force_block_message(block: ForceBlock) -> bytes:
    """Return the CDR bytes of a ForceBlock; `lost_samples` is limited to the range of the field."""
    lost_samples, saturated = min(block.lost_samples, MAX_LOST_SAMPLES), bool(len(block.saturated_samples))
    return encode("ForceBlock", {**block._asdict(), "lost_samples": lost_samples, "saturated": saturated})


def decode_force_block(data: bytes) -> ForceBlock:
    """Return the ForceBlock in `data` (CDR of either byte order). Raises DecodeError.

    If `saturated` is true without `saturated_samples`, all samples count as saturated.
    """
    values = decode(data, "ForceBlock")
    lowest, highest = _SAMPLE_RATES
    if not lowest <= values["sample_rate"] <= highest:
        rate = values["sample_rate"]
        raise DecodeError(f"ForceBlock: sample_rate = {rate:g}: must be from {lowest:g} to {highest:g}")
    if not 0.0 <= values["relative_uncertainty"] <= 1.0:  # otherwise the criterion could tolerate any force
        raise DecodeError(f"ForceBlock: relative_uncertainty = {values['relative_uncertainty']:g}: must be 0 to 1")
    if values["first_sample"] > _MAX_SAMPLE:
        raise DecodeError(f"ForceBlock: first_sample = {values['first_sample']}: must be at most {_MAX_SAMPLE}")
    saturated, count = values.pop("saturated"), len(values["force"])
    indices = values["saturated_samples"]
    if len(indices):
        if not saturated:
            raise DecodeError(f"ForceBlock: saturated = false: must be true with {len(indices)} saturated_samples")
        if (index := int(indices.max())) >= count:
            raise DecodeError(f"ForceBlock: saturated_samples = {index}: must be < {count}, the number of samples")
    elif saturated:
        values["saturated_samples"] = np.arange(count, dtype=np.uint32)
        values["saturated_samples"].flags.writeable = False
    return ForceBlock(**values)


def impact_message(impact: Impact) -> bytes:
    """Return the CDR bytes of an Impact."""
    return encode("Impact", impact._asdict())


def decode_impact(data: bytes, *, is_earlier: bool = False) -> Impact:
    """Return the Impact in `data` (CDR of either byte order). Raises DecodeError.

    `is_earlier`: it is one of an earlier version, without `ADDED_FIELDS`.
    """
    values = decode(data, "Impact", ADDED_FIELDS[IMPACT] if is_earlier else 0)
    for name in _IMPACT_NUMBERS:
        if not abs(values.get(name, 0.0)) <= _MAX_SAMPLE:
            raise DecodeError(f"Impact: {name} = {values[name]}: must be finite and at most {_MAX_SAMPLE} in size")
    return Impact(**values)

"""Convert the ForceBlock and Impact messages to and from the values of the same names.

Tests compare both layouts with rclpy and rosbags.
"""

import struct

import numpy as np

from scara_effmass.values import MAX_LOST_SAMPLES, ForceBlock, Impact
from scara_effmass.wire.cdr import LITTLE_ENDIAN, STAMP, Cursor, padded, sec_and_nanosec, with_text

_BLOCK_START = struct.Struct("<QdI")
"""From first_sample to the length of force."""
_BLOCK_LOSSES = struct.Struct("<I?3xI")
"""From lost_samples to the length of saturated_samples."""
_BLOCK_CLOCK = struct.Struct("<dd")
_BLOCK_END = struct.Struct("<diId")
"""From tare to relative_uncertainty."""
_IMPACT_NUMBERS = struct.Struct("<dddd??2xIddd")
"""From peak_force to clock_residual."""


def force_block_message(block: ForceBlock) -> bytes:
    """Return the CDR bytes of a ForceBlock; `lost_samples` is limited to the range of its field."""
    force = np.ascontiguousarray(block.force, "<f8").tobytes()
    saturated = np.ascontiguousarray(block.saturated_samples, "<u4").tobytes()
    start = _BLOCK_START.pack(block.first_sample, block.sample_rate, len(block.force))
    losses = _BLOCK_LOSSES.pack(
        min(block.lost_samples, MAX_LOST_SAMPLES), bool(saturated), len(block.saturated_samples)
    )
    clock = _BLOCK_CLOCK.pack(block.clock_residual, block.filter_delay)
    end = _BLOCK_END.pack(block.tare, *sec_and_nanosec(block.tare_stamp_ns), block.relative_uncertainty)
    return b"".join(
        (
            LITTLE_ENDIAN,
            _header(block.stamp_ns, block.frame_id),
            # An empty sequence has no padding after its length.
            padded(start) if force else start,
            force,
            padded(losses + saturated) if force else padded(start + losses + saturated)[len(start) :],
            padded(with_text(clock, block.source) + bytes((block.simulated,))),
            end,
        )
    )


def decode_force_block(data: bytes) -> ForceBlock:
    """Return the ForceBlock in `data`, CDR of either byte order. Raises DecodeError.

    If `saturated` is true without `saturated_samples`, all samples count as saturated.
    """
    cursor = Cursor(data, "ForceBlock")
    stamp_ns, frame_id = cursor.header()
    first_sample = cursor.integer("first_sample", 8)
    sample_rate = cursor.float64("sample_rate")
    force = cursor.array("force", np.float64)
    lost_samples = cursor.integer("lost_samples", 4)
    saturated = cursor.flag("saturated")
    saturated_samples = cursor.array("saturated_samples", np.uint32)
    if len(saturated_samples):
        if not saturated:
            raise cursor.error(f"saturated = false: must be true with {len(saturated_samples)} saturated_samples")
        if (index := int(saturated_samples.max())) >= len(force):
            raise cursor.error(f"saturated_samples = {index}: must be < {len(force)}, the number of samples")
    elif saturated:
        saturated_samples = np.arange(len(force), dtype=np.uint32)
        saturated_samples.flags.writeable = False
    block = ForceBlock(
        stamp_ns=stamp_ns,
        frame_id=frame_id,
        first_sample=first_sample,
        sample_rate=sample_rate,
        force=force,
        lost_samples=lost_samples,
        saturated_samples=saturated_samples,
        clock_residual=cursor.float64("clock_residual"),
        filter_delay=cursor.float64("filter_delay"),
        source=cursor.text("source"),
        simulated=cursor.flag("simulated"),
        tare=cursor.float64("tare"),
        tare_stamp_ns=cursor.stamp_ns("tare_stamp"),
        relative_uncertainty=cursor.float64("relative_uncertainty"),
    )
    cursor.end("relative_uncertainty")
    return block


def impact_message(impact: Impact) -> bytes:
    """Return the CDR bytes of an Impact."""
    numbers = _IMPACT_NUMBERS.pack(
        impact.peak_force,
        impact.duration,
        impact.impulse,
        impact.onset_sample,
        impact.clipped,
        impact.incomplete,
        impact.rebound,
        impact.baseline,
        impact.noise,
        impact.clock_residual,
    )
    end = with_text(numbers, impact.source) + bytes((impact.simulated,))
    return LITTLE_ENDIAN + _header(impact.stamp_ns, impact.frame_id) + end


def decode_impact(data: bytes) -> Impact:
    """Return the Impact in `data`, CDR of either byte order. Raises DecodeError."""
    cursor = Cursor(data, "Impact")
    stamp_ns, frame_id = cursor.header()
    impact = Impact(
        stamp_ns=stamp_ns,
        frame_id=frame_id,
        peak_force=cursor.float64("peak_force"),
        duration=cursor.float64("duration"),
        impulse=cursor.float64("impulse"),
        onset_sample=cursor.float64("onset_sample"),
        clipped=cursor.flag("clipped"),
        incomplete=cursor.flag("incomplete"),
        rebound=cursor.integer("rebound", 4),
        baseline=cursor.float64("baseline"),
        noise=cursor.float64("noise"),
        clock_residual=cursor.float64("clock_residual"),
        source=cursor.text("source"),
        simulated=cursor.flag("simulated"),
    )
    cursor.end("simulated")
    return impact


def _header(stamp_ns: int, frame_id: str) -> bytes:
    """Return a std_msgs/Header, padded for a float64."""
    return padded(with_text(STAMP.pack(*sec_and_nanosec(stamp_ns)), frame_id))

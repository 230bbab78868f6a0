"""Buffer of the latest samples of a stream of force blocks, addressed by sample number."""

from collections import deque

import numpy as np

from scara_effmass.impacts.segment import runs
from scara_effmass.values import BoolArray, FloatArray, ForceBlock


class SampleBuffer:
    """Consecutive samples as the sensor read them: the tare is added back, so a new tare is no step."""

    def __init__(self, first_sample: int) -> None:
        self.first = self.end = first_sample
        self._blocks: deque[ForceBlock] = deque()

    def append(self, block: ForceBlock) -> None:
        """Add the samples of the next block."""
        self._blocks.append(block)
        self.end += block.force.size

    def discard_before(self, index: int) -> None:
        """Discard samples older than sample `index`."""
        self.first = max(self.first, index)
        while self._blocks and self._blocks[0].first_sample + self._blocks[0].force.size <= index:
            self._blocks.popleft()

    def samples(self, start: int, stop: int) -> FloatArray:
        """Return the samples in [start, stop) [N], read-only; the newest are the fastest to get."""
        parts: list[FloatArray] = []
        for block in reversed(self._blocks):
            first = block.first_sample
            if first < stop:
                force = block.force[max(start - first, 0) : stop - first]
                parts.append(force + block.tare if block.tare else force)
                if first <= start:
                    break
        return parts[0] if len(parts) == 1 else np.concatenate(parts[::-1] or [np.empty(0)])

    def saturated(self, start: int, stop: int) -> BoolArray:
        """Return a mask of the samples in [start, stop) at the end of the measuring range."""
        mask = np.zeros(stop - start, dtype=np.bool_)
        for block in self._blocks:
            if block.saturated_samples.size:
                index = block.saturated_samples.astype(np.int64) + (block.first_sample - start)
                mask[index[(index >= 0) & (index < mask.size)]] = True
        return mask

    def block_at(self, index: int) -> ForceBlock:
        """Return the block that contains sample `index`, or the oldest one."""
        for block in reversed(self._blocks):
            if block.first_sample <= index:
                return block
        return self._blocks[0]


def finite_parts(block: ForceBlock) -> list[ForceBlock]:
    """Split `block` at samples that are not finite, which are left out."""
    finite = np.isfinite(block.force)
    if finite.all():
        return [block] if block.force.size else []
    saturated = block.saturated_samples
    return [
        block._replace(
            stamp_ns=block.stamp_ns + round(int(start) / block.sample_rate * 1e9),
            first_sample=block.first_sample + int(start),
            force=block.force[start:stop],
            saturated_samples=saturated[(saturated >= start) & (saturated < stop)] - np.uint32(start),
        )
        for start, stop in zip(*runs(finite), strict=True)
    ]

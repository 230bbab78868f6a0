"""Buffer of the latest samples of a stream of force blocks, addressed by sample number."""

from collections import deque

import numpy as np

from scara_effmass.impacts.baseline import runs
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
        """Return the samples in [start, stop) [N]."""
        parts = [
            block.force[max(start - block.first_sample, 0) : stop - block.first_sample] + block.tare
            for block in self._blocks
            if block.first_sample < stop
        ]
        return np.concatenate(parts or [np.empty(0)])

    def saturated(self, start: int, stop: int) -> BoolArray:
        """Return a mask of the samples in [start, stop) at the end of the measuring range."""
        mask = np.zeros(stop - start, dtype=np.bool_)
        for block in self._blocks:
            index = block.saturated_samples.astype(np.int64) + (block.first_sample - start)
            mask[index[(index >= 0) & (index < mask.size)]] = True
        return mask

    def block_at(self, index: int) -> ForceBlock:
        """Return the block that contains sample `index`, or the oldest one."""
        return next((block for block in reversed(self._blocks) if block.first_sample <= index), self._blocks[0])


def finite_parts(block: ForceBlock) -> list[ForceBlock]:
    """Split `block` at samples that are not finite, which are left out."""
    saturated = block.saturated_samples
    return [
        block._replace(
            stamp_ns=block.stamp_ns + round(int(start) / block.sample_rate * 1e9),
            first_sample=block.first_sample + int(start),
            force=block.force[start:stop],
            saturated_samples=saturated[(saturated >= start) & (saturated < stop)] - np.uint32(start),
        )
        for start, stop in zip(*runs(np.isfinite(block.force)), strict=True)
    ]

"""Random numbers that stay the same from version to version: from the raw bits of PCG64, which numpy promises to keep.

Those of numpy's distributions it does not.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.random import PCG64

if TYPE_CHECKING:
    from scara_effmass.values import FloatArray

_CHUNK = 4096


def uniform(key: tuple[int, ...], count: int) -> FloatArray:
    """Return `count` numbers from 0 to below 1, with 53 random bits each; the same ones for the same `key`."""
    return np.asarray((PCG64(list(key)).random_raw(count) >> np.uint64(11)) * 2.0**-53)


def normal(key: tuple[int, ...], first: int, count: int) -> FloatArray:
    """Return the numbers from number `first` on of an endless normal sequence of mean 0 and standard deviation 1.

    It has no memory: any part of it can be asked for, in any order.
    """
    chunks = range(first // _CHUNK, (first + count - 1) // _CHUNK + 1)
    parts = [_normal_chunk(key, chunk) for chunk in chunks]
    joined = np.concatenate(parts) if parts else np.empty(0)
    skipped = first % _CHUNK
    return joined[skipped : skipped + count]


@lru_cache(maxsize=4)
def _normal_chunk(key: tuple[int, ...], chunk: int) -> FloatArray:
    """Return _CHUNK numbers by the method of Box and Muller."""
    radius, angle = uniform((*key, chunk), _CHUNK).reshape(2, -1)
    radius = np.sqrt(-2.0 * np.log1p(-radius))
    return np.concatenate((radius * np.cos(2.0 * np.pi * angle), radius * np.sin(2.0 * np.pi * angle)))

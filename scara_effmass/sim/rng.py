"""Random numbers that do not change with the numpy version.

They use the raw bits of PCG64, which numpy keeps stable; its distributions may change.
"""

from functools import lru_cache

import numpy as np
from numpy.random import PCG64

from scara_effmass.values import FloatArray

_CHUNK = 4096


def uniform(key: tuple[int, ...], count: int) -> FloatArray:
    """Return the first `count` numbers in [0, 1) of the stream `key`, with 53 random bits each."""
    return next_uniform(PCG64(list(key)), count)


def next_uniform(bits: PCG64, count: int) -> FloatArray:
    """Return the next `count` numbers in [0, 1) of a stream, with 53 random bits each."""
    return np.asarray((bits.random_raw(count) >> np.uint64(11)) * 2.0**-53)


def normal_pair(radius: FloatArray, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return two arrays of standard normal numbers from two uniform ones (Box-Muller)."""
    radius = np.sqrt(-2.0 * np.log1p(-radius))
    return radius * np.cos(2.0 * np.pi * angle), radius * np.sin(2.0 * np.pi * angle)


def normal(key: tuple[int, ...], first: int, count: int) -> FloatArray:
    """Return `count` standard normal numbers of the endless stream `key`, from number `first` on.

    Any part of the stream can be requested, in any order.
    """
    chunks = range(first // _CHUNK, (first + count - 1) // _CHUNK + 1)
    parts = [_normal_chunk(key, chunk) for chunk in chunks]
    joined = np.concatenate(parts) if parts else np.empty(0)
    skipped = first % _CHUNK
    return joined[skipped : skipped + count]


@lru_cache(maxsize=4)
def _normal_chunk(key: tuple[int, ...], chunk: int) -> FloatArray:
    radius, angle = uniform((*key, chunk), _CHUNK).reshape(2, -1)
    return np.concatenate(normal_pair(radius, angle))

# SPDX-License-Identifier: Apache-2.0
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
    return _next_uniform(PCG64(list(key)), count)


def next_normal(bits: PCG64, count: int) -> FloatArray:
    """Return `count` standard normal numbers from the next bits of a stream (Box-Muller); `count` is even."""
    radius, angle = _next_uniform(bits, count).reshape(2, -1)
    radius = np.sqrt(-2.0 * np.log1p(-radius))
    return np.concatenate((radius * np.cos(2.0 * np.pi * angle), radius * np.sin(2.0 * np.pi * angle)))


def normal(key: tuple[int, ...], first: int, count: int) -> FloatArray:
    """Return `count` standard normal numbers of the endless stream `key`, from number `first` on.

    Any part of the stream can be requested, in any order.
    """
    chunks = range(first // _CHUNK, (first + count - 1) // _CHUNK + 1)
    joined = np.concatenate([np.empty(0), *(_normal_chunk(key, chunk) for chunk in chunks)])
    return joined[first % _CHUNK :][:count]


@lru_cache(maxsize=4)
def _normal_chunk(key: tuple[int, ...], chunk: int) -> FloatArray:
    return next_normal(PCG64([*key, chunk]), _CHUNK)


def _next_uniform(bits: PCG64, count: int) -> FloatArray:
    return np.asarray((bits.random_raw(count) >> np.uint64(11)) * 2.0**-53)

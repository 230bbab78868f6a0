# SPDX-License-Identifier: Apache-2.0
import math
import pickle
from statistics import median

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.daq.acquisition import LATENCY_WINDOW_S, ReadLatency
from scara_effmass.wire.cdr import NS

RATE = 10_000.0
BLOCK = 1000
BLOCK_NS = round(BLOCK / RATE * NS)


def test_no_read_gives_no_latency() -> None:
    assert all(math.isnan(latency) for latency in ReadLatency(RATE).latencies())


@given(st.lists(st.integers(0, 50_000_000), min_size=1, max_size=99), st.integers(0, 2**62))
def test_latency_is_the_delay_against_the_earliest_read(delays_ns: list[int], start_ns: int) -> None:
    pace = ReadLatency(RATE)
    for number, delay_ns in enumerate(delays_ns, 1):
        pace.add(number * BLOCK, start_ns + number * BLOCK_NS + delay_ns)
    late_s = [(delay_ns - min(delays_ns[: i + 1])) / NS for i, delay_ns in enumerate(delays_ns)]
    assert pace.latencies() == pytest.approx((median(late_s), max(late_s)), abs=1e-6)
    assert pace.time_ns(7 * BLOCK) == pytest.approx(start_ns + 7 * BLOCK_NS + min(delays_ns), abs=1000)


@pytest.mark.parametrize("drift", [-100e-6, 100e-6])
def test_clock_drift_is_no_latency(drift: float) -> None:
    pace = ReadLatency(RATE)
    for number in range(1, 10_000):
        pace.add(number * BLOCK, round(number * BLOCK_NS * (1.0 + drift)))
    _, largest = pace.latencies()
    assert largest <= LATENCY_WINDOW_S * 100e-6 * 1.05
    assert pace.time_ns(9999 * BLOCK) == pytest.approx(9999 * BLOCK_NS * (1.0 + drift), abs=1.1e6)


def test_old_reads_expire() -> None:
    pace = ReadLatency(RATE)
    for number in range(1, 1000):
        pace.add(number * BLOCK, number * BLOCK_NS + (900_000_000 if number == 1 else 0))
    assert pace.latencies() == (0.0, 0.0)
    size = len(pickle.dumps(pace))
    for number in range(1000, 2000):
        pace.add(number * BLOCK, number * BLOCK_NS)
    assert len(pickle.dumps(pace)) < 1.1 * size

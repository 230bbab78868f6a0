# SPDX-License-Identifier: Apache-2.0
"""A detector that starts late in a stream finds the same impacts as one that ran from the beginning."""

from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scara_effmass.impacts.detector import Detector
from scara_effmass.impacts.segment import BASELINE_FRAMES
from scara_effmass.settings import DetectionSettings
from scara_effmass.values import FloatArray, ForceBlock, Impact
from test.impacts.conftest import AddPulse, Detect, MakeBlock

RATE = 12_800.0
FRAME = 640
SIZE = 160_000
FIRST = 1_000_003
"""First sample number; the stream began long before."""
SETTLING = max((BASELINE_FRAMES + 3) * FRAME, round(DetectionSettings().rebound_time * RATE)) + FRAME


class Busy(NamedTuple):
    force: FloatArray
    events: list[tuple[int, int]]
    """First and last sample of each disturbance, including the time to learn another load."""


@pytest.fixture(scope="module")
def busy(add_pulse: AddPulse) -> Busy:
    """Return impacts with rebounds, a sustained contact, another load, a dropout, a glitch, and a tensile pulse."""
    force = np.random.default_rng(3).normal(3.0, 0.1, SIZE)
    events = []
    for onset in (300, 9_000.3, 21_000.9, 33_333, 100_000.1, 112_000.7, 124_000, 138_000.5, 152_000.2):
        for apart, duration, peak in ((0, 3e-3, 90.0), (400, 5e-3, 40.0), (2_000, 8e-3, 12.0)):
            add_pulse(force, onset + apart, duration, peak)
        events.append((int(onset), int(onset) + 2_200))
    force[42_000:] += 25.0
    events.append((42_000, 42_000 + 12_800 + 10 * FRAME))
    force[70_000:90_000] += 60.0
    events.append((70_000, 90_000 + 10 * FRAME))
    force[105_000:105_050] = 0.0
    events.append((105_000, 105_050))
    force[118_000] += 200.0
    events.append((118_000, 118_001))
    add_pulse(force, 131_000, 4e-3, -50.0)
    events.append((131_000, 131_060))
    return Busy(force, sorted(events))


def settled_from(start: int, events: list[tuple[int, int]]) -> int:
    """Return the first sample after `start` that follows a quiet time of SETTLING."""
    for first, last in events:
        if first >= start + SETTLING:
            break
        start = max(start, last)
    return start + SETTLING


def detect_in(blocks: list[ForceBlock]) -> list[Impact]:
    detector = Detector(DetectionSettings())
    return [impact for block in blocks for impact in detector.feed(block)] + detector.finish()


def live(force: FloatArray, make_block: MakeBlock) -> list[ForceBlock]:
    """Return `force` in blocks of 0.1 s, with rates that vary as those of a clock fit."""
    drift = np.random.default_rng(0).normal(0.0, 1e-4, SIZE // 1_280)
    return [
        make_block(part, FIRST + 1_280 * number, RATE * (1.0 + drift[number]))
        for number, part in enumerate(force.reshape(-1, 1_280))
    ]


@pytest.fixture(scope="module")
def elder_impacts(make_block: MakeBlock, busy: Busy) -> list[Impact]:
    """Impacts that a detector finds from the beginning."""
    return detect_in(live(busy.force, make_block))


@settings(max_examples=60)
@given(st.integers(0, SIZE - 30_000))
def test_after_it_has_settled_every_impact_is_the_same(
    make_block: MakeBlock, busy: Busy, elder_impacts: list[Impact], dropped: int
) -> None:
    blocks = live(busy.force, make_block)
    number, within = divmod(dropped, 1_280)
    cut = blocks[number]
    part = cut._replace(
        force=cut.force[within:],
        first_sample=cut.first_sample + within,
        stamp_ns=cut.stamp_ns + round(within / cut.sample_rate * 1e9),
    )
    since = FIRST + settled_from(dropped, busy.events)
    # Only the elder one knows how much of the baseline is a load.
    elder, younger = (
        [impact._replace(load_force=0.0) for impact in impacts if impact.onset_sample >= since]
        for impacts in (elder_impacts, detect_in([part, *blocks[number + 1 :]]))
    )
    assert younger == elder
    assert len(elder) >= 3


def test_there_is_something_to_compare(busy: Busy, elder_impacts: list[Impact]) -> None:
    impacts = elder_impacts
    assert [impact.rebound for impact in impacts if not impact.held_force] == 9 * [0, 1, 2]
    assert [round(impact.held_force) for impact in impacts if impact.held_force] == [25, 60]
    assert settled_from(0, busy.events) < 21_000


@given(st.integers(0, 10**12), st.integers(0, 2_000))
def test_an_impact_soon_after_any_beginning_is_found(
    make_block: MakeBlock, add_pulse: AddPulse, first: int, onset: int
) -> None:
    force = np.random.default_rng(0).normal(0.0, 0.1, 10_000)
    add_pulse(force, onset, 3e-3, 100.0)
    (impact,) = detect_in([make_block(force, first)])
    assert impact.onset_sample - first == pytest.approx(onset, abs=1.0)
    assert impact.peak_force == pytest.approx(100.0, rel=0.01)


def test_whether_the_baseline_was_known_stays_known(make_block: MakeBlock, detect: Detect) -> None:
    force = np.random.default_rng(0).normal(0.0, 0.1, 20_000)
    assert detect(force).detector.settled
    assert not detect(np.linspace(0.0, 1e3, 20_000)).detector.settled
    detector = detect(force).detector
    settled = []
    for first, stop in ((0, 0), (0, 700), (700, 20_000)):  # nothing new; something new, as yet too little; enough
        assert detector.finish() == []
        settled.append(detector.settled)
        assert detector.feed(make_block(force[first:stop], first)) == []
        settled.append(detector.settled)
    assert settled == [True, True, True, False, True, True]

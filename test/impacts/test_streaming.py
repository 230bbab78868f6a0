# SPDX-License-Identifier: Apache-2.0
"""Impacts do not depend on how samples arrive, and missing or wrong samples give none."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scara_effmass.impacts.detector import Detector
from scara_effmass.impacts.segment import SINGLE_SAMPLE, STUCK
from scara_effmass.settings import DetectionSettings

if TYPE_CHECKING:
    from scara_effmass.values import FloatArray, Impact
    from test.impacts.conftest import AddPulse, Detect, MakeBlock

RATE = 12_800.0
SIZE = 60_000


def counts(detector: Detector) -> tuple[int, int, int]:
    return detector.dropouts, detector.glitches, detector.sustained_contacts


@pytest.fixture(scope="module")
def eventful(add_pulse: AddPulse) -> FloatArray:
    """Return impacts, rebounds, a clipped impact, a sustained contact, dropouts, glitches and a change of load."""
    force = np.random.default_rng(0).normal(30.0, 0.1, SIZE)
    for onset, duration, peak in [(300, 4e-3, 90), (9_000.3, 1e-3, 300), (9_100, 5e-3, 40), (9_600, 5e-3, 20)]:
        add_pulse(force, onset, duration, peak)
    force[12_000:12_100] = 0.0
    force[13_000] += 80.0
    add_pulse(force, 14_000, 20e-3, 60)
    force[14_100:14_120] = force[14_100]
    force[20_000:40_000] += 25.0
    add_pulse(force, 36_000.7, 3e-3, 70)
    add_pulse(force, 52_000.1, 3e-3, 70)
    add_pulse(force, SIZE - 20, 3e-3, 70)
    return force


def test_the_eventful_signal(detect: Detect, eventful: FloatArray) -> None:
    impacts, detector = detect(eventful)
    onsets = [300, 9_000.3, 9_100, 9_600, 14_000, 20_000, 36_000.7, 52_000.1, SIZE - 20]
    assert [impact.onset_sample for impact in impacts] == pytest.approx(onsets, abs=2)
    assert [impact.rebound for impact in impacts] == [0, 0, 1, 2, 3, 4, 0, 0, 0]
    assert [impact.incomplete for impact in impacts] == [False] * 4 + [True] + [False] * 3 + [True]
    assert [impact.held_force for impact in impacts] == pytest.approx([0.0] * 5 + [25.0] + [0.0] * 3, abs=0.5)
    assert [impact.load_force for impact in impacts] == pytest.approx([0.0] * 6 + [25.0] + [0.0] * 2, abs=0.1)
    assert {(item.reason, item.occurrences) for item in detector.left_out} == {(SINGLE_SAMPLE, 1), (STUCK, 1)}
    assert [item.peak_force for item in detector.left_out] == pytest.approx([80.0, 57.0], abs=1.0)
    assert (detector.dropouts, detector.glitches, detector.sustained_contacts) == (2, 1, 1)


@settings(max_examples=40)
@given(st.lists(st.integers(1, SIZE - 1), max_size=60))
def test_cutting_into_blocks_changes_nothing(detect: Detect, eventful: FloatArray, cuts: list[int]) -> None:
    whole, detector = detect(eventful)
    parts, same = detect(eventful, cuts=cuts)
    assert [impact._replace(stamp_ns=0) for impact in parts] == [impact._replace(stamp_ns=0) for impact in whole]
    assert [impact.stamp_ns for impact in parts] == pytest.approx([impact.stamp_ns for impact in whole], abs=2)
    assert counts(same) == counts(detector)


def test_single_samples_change_nothing(detect: Detect, eventful: FloatArray) -> None:
    force = eventful[8_000:16_000]
    whole, parts = detect(force).impacts, detect(force, cuts=range(force.size)).impacts
    assert len(whole) == 4
    assert [impact._replace(stamp_ns=0) for impact in parts] == [impact._replace(stamp_ns=0) for impact in whole]


def mess(generator: np.random.Generator) -> FloatArray:
    """Return a signal with all kinds of faults, and a few contacts."""
    force = generator.normal(generator.choice([0.0, 30.0, -30.0]), generator.choice([0.0, 0.1, 1.0]), 12_000)
    for _ in range(generator.integers(25)):
        start = int(generator.integers(force.size))
        part = force[start : start + int(generator.choice([1, 2, 3, 8, 50, 500, 5_000]))]
        rise, phase = generator.choice([-50.0, 8.0, 50.0, 500.0]), np.linspace(0.0, 1.0, part.size)
        shapes = [
            np.zeros(part.size),
            np.full(part.size, part[0]),
            np.full(part.size, np.nan),
            np.round(part),
            part + rise,
            part + rise * phase,
            part + rise * np.sin(np.pi * phase),
            part + generator.normal(0.0, 10.0, part.size),
        ]
        part[:] = shapes[generator.integers(len(shapes))]
    return force


@settings(max_examples=60)
@given(st.integers(0, 2**32), st.sampled_from([20.0, 1_000.0, RATE]), st.sampled_from([0.05, 1.0]), st.integers(2, 40))
def test_any_mess_gives_sound_impacts_and_the_same_in_blocks(
    detect: Detect, seed: int, rate: float, longest: float, blocks: int
) -> None:
    generator, limits = np.random.default_rng(seed), DetectionSettings(longest=longest)
    force = mess(generator)
    whole, detector = detect(force, rate, settings=limits)
    parts, same = detect(force, rate, settings=limits, cuts=generator.integers(1, force.size, blocks).tolist())
    assert [impact._replace(stamp_ns=0) for impact in parts] == [impact._replace(stamp_ns=0) for impact in whole]
    assert counts(same) == counts(detector)
    onsets = [impact.onset_sample for impact in whole]
    assert onsets == sorted(onsets)
    for impact in whole:
        assert 0.0 <= impact.onset_sample < force.size
        assert 0.0 < impact.peak_force < 4_000.0
        assert impact.impulse > 0.0
        assert impact.duration >= 0.0
        assert np.isfinite([impact.duration, impact.impulse, impact.baseline, impact.noise]).all()


@pytest.mark.parametrize("power", [-3, 5])
def test_scaling_force_and_threshold_scales_the_impacts(detect: Detect, eventful: FloatArray, power: int) -> None:
    factor = 2.0**power  # exact, so that every number is
    scaled = detect(eventful * factor, settings=DetectionSettings(threshold=5.0 * factor)).impacts
    assert scaled == [
        impact._replace(
            peak_force=impact.peak_force * factor,
            impulse=impact.impulse * factor,
            baseline=impact.baseline * factor,
            noise=impact.noise * factor,
            compression_impulse=impact.compression_impulse * factor,
            held_force=impact.held_force * factor,
            load_force=impact.load_force * factor,
        )
        for impact in detect(eventful).impacts
    ]


@settings(max_examples=30)
@given(st.floats(1e-2, 1e3), st.floats(-500.0, 500.0), st.floats(0.0, 1.0), st.integers(0, 2_000))
def test_scale_offset_and_shift(
    detect: Detect, add_pulse: AddPulse, scale: float, offset: float, phase: float, shift: int
) -> None:
    force = np.zeros(8_000)
    add_pulse(force, 3_000 + phase, 3e-3, 100.0)
    ((here,), _), limits = detect(force), DetectionSettings(threshold=5.0 * scale)
    ((there,), _) = detect(scale * np.roll(force, shift) + offset, settings=limits)
    assert there.onset_sample - shift == pytest.approx(here.onset_sample, abs=1e-6)
    assert there.duration == pytest.approx(here.duration, rel=1e-6)
    assert there.peak_force == pytest.approx(scale * here.peak_force, rel=1e-6)
    assert there.impulse == pytest.approx(scale * here.impulse, rel=1e-6)
    assert there.baseline == pytest.approx(offset)


def test_a_tare_is_no_step(make_block: MakeBlock, add_pulse: AddPulse) -> None:
    force = np.random.default_rng(0).normal(30.0, 0.1, 20_000)
    add_pulse(force, 9_990, 4e-3, 100.0)
    detector = Detector(DetectionSettings())
    impacts = detector.feed(make_block(force[:10_000]))
    impacts += detector.feed(make_block(force[10_000:] - 30.0, 10_000, tare=30.0))
    (impact,) = [*impacts, *detector.finish()]
    assert impact.peak_force == pytest.approx(100.0, rel=0.005)
    assert impact.baseline == pytest.approx(30.0, abs=0.05)


def test_time_is_that_of_the_block_that_holds_the_onset(make_block: MakeBlock, add_pulse: AddPulse) -> None:
    """The clock fit changes, so each block has its own stamp and rate."""
    force = np.zeros(20_480)
    add_pulse(force, 12_000.25, 20e-3, 100.0)
    detector, impacts = Detector(DetectionSettings()), []
    for number, part in enumerate(force.reshape(16, 1_280)):
        block = make_block(part, 1_280 * number, RATE * (1.0 + 1e-5 * number))
        impacts += detector.feed(block._replace(stamp_ns=10**18 + number, clock_residual=float(number)))
    (impact,) = [*impacts, *detector.finish()]
    assert impact.clock_residual == 9.0
    since = (impact.onset_sample - 9 * 1_280) / (RATE * (1.0 + 9e-5))
    assert impact.stamp_ns == 10**18 + 9 + round(since * 1e9)


def run(detector: Detector, make_block: MakeBlock, force: FloatArray, edges: list[int], lost: int) -> list[Impact]:
    """Feed `force` up to the first of `edges`, and then from `lost` samples later on."""
    impacts = detector.feed(make_block(force[: edges[0]]))
    for first, stop in pairwise([edges[0] + lost, *edges[1:]]):
        impacts += detector.feed(make_block(force[first:stop], first, lost=lost if first == edges[0] + lost else 0))
    return [*impacts, *detector.finish()]


@pytest.mark.parametrize("lost", [1, 10, 500])
def test_a_contact_with_lost_samples_is_one_incomplete_impact(
    make_block: MakeBlock, add_pulse: AddPulse, lost: int
) -> None:
    force = np.random.default_rng(0).normal(0.0, 0.1, 20_000)
    add_pulse(force, 10_000, 4e-3, 100.0)
    (impact,) = run(Detector(DetectionSettings()), make_block, force, [10_020, 20_000], lost)
    assert impact.incomplete
    assert impact.onset_sample == pytest.approx(10_000, abs=1)
    assert impact.peak_force == max(force[9_990:10_020].max(), force[10_020 + lost :].max()) - impact.baseline


def test_lost_samples_in_quiet_do_not_cost_the_next_impact(make_block: MakeBlock, add_pulse: AddPulse) -> None:
    force = np.random.default_rng(0).normal(0.0, 0.1, 20_000)
    add_pulse(force, 9_500, 4e-3, 100.0)
    for lost in (1, 400):
        (impact,) = run(Detector(DetectionSettings()), make_block, force, [9_000, 10_000, 20_000], lost)
        assert not impact.incomplete
    (hidden,) = run(Detector(DetectionSettings()), make_block, force, [9_490, 20_000], 20)
    assert hidden.incomplete


def test_lost_samples_that_the_numbers_do_not_show_count(make_block: MakeBlock, add_pulse: AddPulse) -> None:
    force = np.random.default_rng(0).normal(0.0, 0.1, 20_000)
    add_pulse(force, 10_000, 4e-3, 100.0)
    detector = Detector(DetectionSettings())
    impacts = detector.feed(make_block(force[:10_020])) + detector.feed(make_block(force[10_020:], 10_020, lost=3))
    assert [impact.incomplete for impact in impacts + detector.finish()] == [True, True]


def test_going_back_is_another_recording(make_block: MakeBlock, add_pulse: AddPulse) -> None:
    force = np.random.default_rng(0).normal(0.0, 0.1, 10_000)
    add_pulse(force, 9_000, 4e-3, 100.0)
    detector = Detector(DetectionSettings(rebound_time=10.0))
    impacts = detector.feed(make_block(force)) + detector.feed(make_block(force + 40.0))
    impacts += detector.feed(make_block(force, rate=RATE / 2.0)) + detector.finish()
    assert [impact.rebound for impact in impacts] == [0, 0, 0]
    assert [impact.baseline for impact in impacts] == pytest.approx([0.0, 40.0, 0.0], abs=0.05)
    assert not any(impact.incomplete for impact in impacts)


@pytest.mark.parametrize(("factor", "rebound"), [(1.01, 1), (1.011, 0), (0.991, 1), (0.989, 0)])
def test_another_sample_rate_is_another_recording(
    make_block: MakeBlock, add_pulse: AddPulse, factor: float, rebound: int
) -> None:
    """The clock fit varies the rate by at most 1 %."""
    force = np.random.default_rng(0).normal(0.0, 0.1, 20_000)
    for onset in (9_000, 11_000):
        add_pulse(force, onset, 4e-3, 100.0)
    detector = Detector(DetectionSettings())
    impacts = detector.feed(make_block(force[:10_000]))
    impacts += detector.feed(make_block(force[10_000:], 10_000, RATE * factor)) + detector.finish()
    assert [impact.rebound for impact in impacts] == [0, rebound]


@pytest.mark.parametrize(("pause", "count"), [(2, 1), (3, 1), (5, 2), (8, 2)])
def test_contacts_are_apart_after_a_third_of_a_millisecond(
    detect: Detect, add_pulse: AddPulse, pause: int, count: int
) -> None:
    force = np.zeros(20_000)
    for onset in (9_999.5, 9_999.5 + 51 + pause):  # `pause` samples of zero between them
        add_pulse(force, onset, 51 / RATE, 100.0)
    assert len(detect(force).impacts) == count


def test_samples_that_are_not_finite_are_lost(detect: Detect, add_pulse: AddPulse) -> None:
    force = np.random.default_rng(0).normal(0.0, 0.1, 20_000)
    add_pulse(force, 10_000, 4e-3, 100.0)
    force[[0, 5]] = np.inf
    force[10_020:10_023] = np.nan
    force[15_000:] = np.nan
    for cuts in ([], [10_021], [10_020, 10_023, 15_500]):
        (impact,), _ = detect(force, cuts=cuts)
        assert impact.incomplete
        assert impact.onset_sample == pytest.approx(10_000, abs=0.6)


@pytest.mark.parametrize("bias", [0.0, 30.0, -30.0])
@pytest.mark.parametrize("tare", [0.0, 1.0])
@pytest.mark.parametrize("length", [2, 3, 50, 6_000])
def test_a_dropout_is_no_impact(detect: Detect, bias: float, tare: float, length: int) -> None:
    force = np.random.default_rng(0).normal(bias, 0.1, 40_000)
    force[10_000 : 10_000 + length] = 0.0
    impacts, detector = detect(force, tare=tare * bias)
    assert not impacts
    assert detector.sustained_contacts == detector.glitches == 0
    assert detector.dropouts == (0 if bias == 0.0 and length < 4 else 1)  # two zeros near zero may be chance


@pytest.mark.parametrize("bias", [0.0, 30.0])
@pytest.mark.parametrize("value", ["zero", "repeated"])
def test_a_dropout_in_a_contact_leaves_it_incomplete(
    detect: Detect, add_pulse: AddPulse, bias: float, value: str
) -> None:
    force = np.random.default_rng(0).normal(bias, 0.1, 40_000)
    add_pulse(force, 20_000, 0.1, 60.0)
    force[20_500:20_540] = 0.0 if value == "zero" else force[20_500]
    (impact,), detector = detect(force)
    assert impact.incomplete
    assert impact.onset_sample == pytest.approx(20_000, abs=8.0)
    assert impact.peak_force <= 60.5
    assert impact.impulse < 60.0 * 0.1 * 2.0 / np.pi
    assert (detector.dropouts, detector.glitches) == (1, 0)


def test_repeated_rows_in_quiet_are_counted(detect: Detect) -> None:
    force = np.random.default_rng(0).normal(0.0, 0.1, 40_000)
    force[10_000:10_100] = force[10_000]
    force[20_000:26_000] = force[20_000]
    impacts, detector = detect(force)
    assert (len(impacts), detector.dropouts) == (0, 2)


def test_glitches_are_counted(detect: Detect, add_pulse: AddPulse) -> None:
    force = np.random.default_rng(0).normal(0.0, 0.1, 40_000)
    force[10_000] += 300.0
    force[12_000] -= 300.0
    add_pulse(force, 20_000, 20e-3, 60.0)
    force[20_050] += 500.0
    (impact,), detector = detect(force)
    assert detector.glitches == 3
    assert not detect(force[:10_001]).impacts
    assert impact.incomplete
    assert impact.peak_force == pytest.approx(535.0, rel=0.01)
    (left_out,) = detector.left_out
    assert left_out.peak_force == pytest.approx(300.0, abs=1.0)


@pytest.mark.parametrize("seed", range(12))
def test_a_single_sample_in_or_beside_a_contact_may_be_its_top(detect: Detect, add_pulse: AddPulse, seed: int) -> None:
    """Two samples of 200 Hz or fewer in an impact of 6 to 12 ms: no contact has less than the largest sample."""
    generator = np.random.default_rng(seed)
    force = generator.normal(0.0, 0.2, 800)
    add_pulse(force, 400.0 + generator.uniform(0.0, 1.0), generator.uniform(0.006, 0.012), 300.0, rate=200.0)
    impacts, _ = detect(force, 200.0)
    assert all(impact.peak_force > 0.8 * force.max() for impact in impacts)


@pytest.mark.parametrize("wait", [0.22, 0.24, 0.26])
def test_an_impact_soon_after_a_falling_zero_is_reported_once(detect: Detect, add_pulse: AddPulse, wait: float) -> None:
    """Whatever the phase of the frames of 640 samples, at one of which the search for another baseline begins."""
    for phase in range(0, 640, 32):
        force = np.random.default_rng(phase).normal(0.0, 0.3, 40_000)
        add_pulse(force, 20_000.0 + phase, 15e-3, 290.0)
        force[20_000 + phase - round(wait * RATE) :] -= 20.0
        (impact,), _ = detect(force)
        assert impact.incomplete or impact.peak_force > 285.0
        assert impact.rebound == 0


def test_a_glitch_at_the_first_sample_after_an_impact_counts(detect: Detect, add_pulse: AddPulse) -> None:
    """The impact in the frame of 640 samples from 12 800 on is classified with the quiet frame after it."""
    force = np.random.default_rng(0).normal(0.0, 0.1, 25_600)
    add_pulse(force, 12_900, 2e-3, 100.0)
    force[14_080] += 300.0
    impacts, detector = detect(force)
    assert (len(impacts), detector.glitches) == (1, 1)


def test_a_push_is_no_impact_and_does_not_blind(detect: Detect, add_pulse: AddPulse) -> None:
    generator = np.random.default_rng(0)
    steady, hand = generator.normal(0.0, 0.1, (2, 80_000))
    steady[10_000:40_000] += 40.0
    hand[10_000:40_000] += 40.0 + 20.0 * np.sin(np.arange(30_000) / RATE * 9.0)
    add_pulse(steady, 35_000, 4e-3, 100.0)
    for force in (steady, hand):
        add_pulse(force, 50_000, 4e-3, 100.0)
    (push, *impacts), detector = detect(steady)
    assert push.onset_sample == pytest.approx(10_000, abs=2)
    assert push.held_force == pytest.approx(40.0, abs=0.5)
    assert [impact.onset_sample for impact in impacts] == pytest.approx([35_000, 50_000], abs=1)
    assert [impact.baseline for impact in impacts] == pytest.approx([40.0, 0.0], abs=0.1)
    assert [impact.load_force for impact in impacts] == pytest.approx([40.0, 0.0], abs=0.1)
    assert detector.sustained_contacts == 1
    (push, impact), detector = detect(hand)
    assert push.onset_sample == pytest.approx(10_000, abs=2)
    assert push.duration == pytest.approx(30_000 / RATE, rel=0.01)
    assert push.held_force == pytest.approx(60.0, abs=0.5)
    assert push.load_force == 0.0
    assert impact.peak_force == pytest.approx(100.0, rel=0.005)
    assert detector.sustained_contacts == 1


def test_an_impact_on_a_baseline_that_has_gone_is_incomplete(detect: Detect, add_pulse: AddPulse) -> None:
    force = np.random.default_rng(0).normal(0.0, 0.1, 60_000)
    force[:40_000] += 40.0
    add_pulse(force, 41_500, 4e-3, 100.0)
    (impact,), _ = detect(force)
    assert impact.incomplete
    assert impact.peak_force == pytest.approx(60.0, abs=1.0)


@pytest.mark.parametrize("value", [0.0, 7.0])
def test_a_constant_is_no_impact(detect: Detect, value: float) -> None:
    for size in (1, 8, 100, 40_000):
        impacts, detector = detect(np.full(size, value))
        assert not impacts
        assert detector.sustained_contacts == detector.dropouts == detector.glitches == 0


def test_nothing_is_nothing(make_block: MakeBlock) -> None:
    detector = Detector(DetectionSettings())
    assert detector.feed(make_block(np.empty(0))) == []
    assert detector.finish() == []
    assert not detector.settled

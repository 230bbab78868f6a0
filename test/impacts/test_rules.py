# SPDX-License-Identifier: Apache-2.0
"""Each rule of the detection on its own; without it, its test fails."""

import numpy as np
import pytest

from scara_effmass.impacts.detector import Detector, SampleBuffer
from scara_effmass.impacts.segment import BASELINE_FRAMES, Baseline, Frame, classify, flank_onset, measure
from scara_effmass.settings import DetectionSettings
from scara_effmass.values import FloatArray, Impact
from test.impacts.conftest import AddPulse, Detect, MakeBlock

RATE = 12_800.0
FRAME = 640
LONGEST = 12_800


def noise(size: int, level: float = 0.0) -> FloatArray:
    return np.random.default_rng(0).normal(level, 0.1, size)


@pytest.mark.parametrize(
    ("force", "first", "expected"),
    [
        ([3.0, 4.0, 6.0, 10.0], 1, 0.0),  # the line would reach zero at -2: before the first sample
        ([-20.0, 1.2, 4.0, 8.0, 10.0], 1, 20.0 / 21.2),  # and here at 0.68, where the force is negative
        ([0.0, 0.0, 4.0, 10.0], 1, 1.0),  # at 1.25, when there certainly was contact
        ([2.0, 0.0, 0.0, 4.0, 10.0], 3, 2.25 - 0.25 * (19 / 6 - 2.25)),  # after the end of another contact
        ([0.0, 0.0, 1.2, 2.0, 3.0, 4.0, 5.0, 10.0], 2, 1.0),  # and here at 0.79, before a sample of exactly zero
    ],
)
def test_the_onset_is_between_the_last_sample_below_zero_and_the_first_contact(
    force: list[float], first: int, expected: float
) -> None:
    assert flank_onset(np.array(force), first, 10.0)[0] == pytest.approx(expected)


def test_what_pulls_more_than_it_pushes_is_no_contact() -> None:
    baseline = Baseline(DetectionSettings(), [Frame(noise(FRAME)) for _ in range(BASELINE_FRAMES)])
    samples = noise(FRAME)
    samples[300:306] += [20.0, 20.0, -90.0, -90.0, 20.0, 20.0]
    marks = np.zeros(FRAME, dtype=np.bool_)
    assert not classify(samples, marks, baseline, 4, 10).contacts
    samples[302:304] += 85.0
    assert len(classify(samples, marks, baseline, 4, 10).contacts) == 1


def test_contact_ends_before_the_first_sample_of_the_next_one() -> None:
    """Extrapolated to zero, the slow fall would end inside the next contact."""
    baseline = Baseline(DetectionSettings(), [Frame(noise(FRAME)) for _ in range(BASELINE_FRAMES)])
    force = np.zeros(60)
    force[20:33] = [8.0, 16.0, 12.0, 9.0, 7.0, 6.0, 5.0, 2.45, 2.3, 60.0, 80.0, 60.0, 30.0]
    first, second = classify(force, np.zeros(60, dtype=np.bool_), baseline, 2, 10).contacts
    assert (first.end, second.first) == (28.0, 29)


@pytest.mark.parametrize(("below", "complete"), [(5, [False, True]), (30, [True, True])])
def test_force_below_the_baseline_before_a_contact_is_a_released_load_unless_another_contact_rings(
    below: int, complete: list[bool]
) -> None:
    baseline = Baseline(DetectionSettings(), [Frame(noise(FRAME)) for _ in range(BASELINE_FRAMES)])
    force = noise(60)
    force[below : below + 4] -= 8.0
    for first in (20, 45):
        force[first : first + 5] += [20.0, 60.0, 80.0, 60.0, 20.0]
    contacts = classify(force, np.zeros(60, dtype=np.bool_), baseline, 4, 20).contacts
    assert [contact.complete for contact in contacts] == complete


@pytest.mark.parametrize("rising", [True, False])
def test_contact_of_which_one_flank_is_missing_is_not_complete(*, rising: bool) -> None:
    """At the other end, the force is 40 % of the peak."""
    force = np.array([0.0, 0.0, 3.0, 6.0, 5.0, 2.4])[:: 1 if rising else -1]
    first, last = (2, 4) if rising else (1, 3)
    assert not measure(force, first, last, 0, 5, intact=False).complete
    force[-1 if rising else 0] = 0.0
    assert measure(force, first, last, 0, 5, intact=False).complete


@pytest.mark.parametrize(("index", "clipped"), [(19, False), (20, True), (24, True), (25, False)])
def test_saturated_samples_beside_a_contact_do_not_clip_it(index: int, *, clipped: bool) -> None:
    baseline = Baseline(DetectionSettings(), [Frame(noise(FRAME)) for _ in range(BASELINE_FRAMES)])
    force, saturated = noise(60), np.zeros(60, dtype=np.bool_)
    force[20:25] += [20.0, 60.0, 80.0, 60.0, 20.0]
    saturated[index] = True
    (contact,) = classify(force, saturated, baseline, 4, 20).contacts
    assert contact.clipped == clipped


def test_hole_in_a_contact_is_filled_with_the_mean_of_its_neighbours() -> None:
    baseline = Baseline(DetectionSettings(), [Frame(noise(FRAME)) for _ in range(BASELINE_FRAMES)])
    force = noise(60)
    force[20:27] += [20.0, 50.0, 70.0, 0.0, 80.0, 50.0, 20.0]
    segment = classify(force, np.zeros(60, dtype=np.bool_), baseline, 4, 20)
    (contact,) = segment.contacts
    assert segment.glitches.tolist() == [23]
    assert contact.area == pytest.approx(365.0, rel=0.01)


def test_buffer_without_blocks_has_no_samples() -> None:
    assert SampleBuffer(100).samples(100, 110).size == 0


def test_frames_beside_a_contact_do_not_enter_the_noise(detect: Detect, add_pulse: AddPulse) -> None:
    plain = noise(300 * FRAME)
    for first in range(9, 300, 5):
        add_pulse(plain, first * FRAME + 100, 4e-3, 100.0)
    shouldered = plain.copy()
    for first in range(9, 299, 5):
        for beside in (first - 1, first + 1):
            shouldered[beside * FRAME : (beside + 1) * FRAME] += 3.0  # below the threshold, so quiet
    expected, impacts = detect(plain).impacts, detect(shouldered).impacts
    assert len(impacts) == len(expected) == 59
    assert [(i.baseline, i.noise) for i in impacts] == [(i.baseline, i.noise) for i in expected]


def test_nor_does_the_frame_after_a_gap_that_may_hide_one(make_block: MakeBlock, add_pulse: AddPulse) -> None:
    before, after = noise(10 * FRAME), noise(10 * FRAME)
    add_pulse(after, 4 * FRAME + 100, 4e-3, 100.0)
    known = []
    for shoulder in (0.0, 3.0):
        after[:FRAME] += shoulder
        detector = Detector(DetectionSettings())
        assert detector.feed(make_block(before)) == []
        impacts = detector.feed(make_block(after, 11 * FRAME, lost=FRAME)) + detector.finish()
        known.append([(impact.baseline, impact.noise) for impact in impacts])
    assert len(known[0]) == 1
    assert known[0] == known[1]


def test_a_dropout_that_outlasts_the_baseline_counts_once(detect: Detect) -> None:
    force = noise(60_000)
    force[10_000:40_100] = force[10_000]  # its end is among the frames that give the next baseline
    assert detect(force).detector.dropouts == 1


def test_a_stuck_signal_is_no_baseline(make_block: MakeBlock) -> None:
    force = noise(60_000)
    force[20_000:] = 40.0
    detector = Detector(DetectionSettings())
    settled = []
    for first, part in ((0, force[:20_000]), (20_000, force[20_000:]), (60_000, noise(10_000, 40.0))):
        assert detector.feed(make_block(part, first)) == []
        settled.append(detector.settled)
    assert settled == [True, False, True]
    assert detector.dropouts == 1


def test_contacts_of_a_train_without_end_are_reported_once(detect: Detect, add_pulse: AddPulse) -> None:
    force = noise(100_000)
    onsets = np.arange(10_000.0, 90_000.0, 300.0)
    for onset in onsets:
        add_pulse(force, onset, 280 / RATE, 100.0)  # less than a frame apart
    impacts = detect(force).impacts
    assert [impact.onset_sample for impact in impacts] == pytest.approx(onsets, abs=3.0)
    assert not any(impact.incomplete for impact in impacts)


@pytest.mark.parametrize(("levels", "settled"), [([0, 0, 0, 40, 80], True), ([0, 0, -40, 40, 80], False)])
def test_a_short_recording_needs_most_of_its_frames_at_one_level(
    detect: Detect, levels: list[float], *, settled: bool
) -> None:
    assert detect(noise(5 * FRAME) + np.repeat(levels, FRAME)).detector.settled == settled


@pytest.mark.parametrize(("missing", "baseline"), [(LONGEST, 0.0), (LONGEST + 1, 8.0)])
def test_after_a_long_gap_the_baseline_is_another(
    make_block: MakeBlock, add_pulse: AddPulse, missing: int, baseline: float
) -> None:
    before, after = noise(20_000), noise(5_000, 8.0)
    add_pulse(after, 100, 4e-3, 100.0)
    detector = Detector(DetectionSettings())
    impacts: list[Impact] = detector.feed(make_block(before))
    impacts += detector.feed(make_block(after, 20_000 + missing, lost=missing)) + detector.finish()
    assert impacts[0].baseline == pytest.approx(baseline, abs=0.05)

# SPDX-License-Identifier: Apache-2.0
"""A contact is a peak and, where the force stays, a held force; what is in no contact is counted with its peak."""

import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scara_effmass.impacts.detector import Detector
from scara_effmass.impacts.load import EARLIER_LOAD, LATER_LOAD, MAX_HELD_S, NO_BASELINE, SLOW_CHANGE, TENSION
from scara_effmass.impacts.segment import SINGLE_SAMPLE
from scara_effmass.iso15066 import TRANSIENT_S
from scara_effmass.settings import DetectionSettings
from scara_effmass.values import BoolArray, FloatArray, Impact
from test.impacts.conftest import Detect, MakeBlock

CASES = Path(__file__).parents[1] / "recordings" / "contacts"
RATES = (200.0, 1_000.0, 12_800.0)
NOISE = 0.1
rates = pytest.mark.parametrize("rate", RATES)


def time_axis(duration: float, rate: float) -> FloatArray:
    return np.arange(round(duration * rate)) / rate


def noise(time: FloatArray) -> FloatArray:
    return np.random.default_rng(0).normal(0.0, NOISE, time.size)


def drop(time: FloatArray, start: float, weight: float, peak: float) -> FloatArray:
    """Return the force of a thing that strikes with `peak` for 20 ms and stays with its `weight` [N]."""
    since = time - start
    strike = (peak - weight) * np.sin(np.pi * np.clip(since / 0.02, 0.0, 1.0))
    return np.where(since >= 0.0, weight + strike, 0.0)


def press(time: FloatArray, start: float, force: float, rise: float, hold: float, fall: float = 0.1) -> FloatArray:
    corners = np.cumsum([start, rise, hold, fall])
    return np.interp(time, corners, [0.0, force, force, 0.0])


def peaks_by_reason(detector: Detector) -> dict[str, float]:
    return {item.reason: item.peak_force for item in detector.left_out}


@pytest.mark.parametrize(("name", "duration"), [("0.6s", 0.6), ("2s", 2.0)])
def test_an_impact_before_a_clamping_has_both_forces(detect: Detect, name: str, duration: float) -> None:
    force = np.genfromtxt(CASES / f"impact_then_clamping_50N_{name}.csv", delimiter=",", skip_header=1)[:, 1]
    (impact,), detector = detect(force, 1_000.0)
    assert impact.onset_sample == pytest.approx(2_000, abs=2)
    assert impact.peak_force == pytest.approx(158.0, abs=1.0)
    assert impact.held_force == pytest.approx(50.0, abs=1.5)
    assert impact.duration == pytest.approx(duration, abs=0.01)
    assert 0.0 < impact.compression_impulse < 3.0  # that of the strike alone
    assert (impact.incomplete, impact.is_press, impact.load_force) == (False, False, 0.0)
    assert list(detector.left_out) == []


@rates
@pytest.mark.parametrize("every", [1.2, 3.0])
def test_things_that_are_dropped_and_stay_are_found_each_on_the_load_of_the_others(
    detect: Detect, rate: float, every: float
) -> None:
    time = time_axis(6 * every + 6.0, rate)
    starts = 2.0 + every * np.arange(6)
    impacts, detector = detect(noise(time) + sum(drop(time, start, 10.0, 80.0) for start in starts), rate)
    assert [impact.onset_sample / rate for impact in impacts] == pytest.approx(starts.tolist(), abs=0.01)
    assert [impact.peak_force for impact in impacts] == pytest.approx([80.0] * 6, rel=0.03)
    assert [impact.held_force for impact in impacts] == pytest.approx([10.0] * 6, abs=0.6)
    assert [impact.load_force for impact in impacts] == pytest.approx(10.0 * np.arange(6), abs=0.5)
    assert [impact.duration for impact in impacts[:5]] == pytest.approx([every] * 5, abs=0.05)
    assert MAX_HELD_S <= impacts[5].duration < MAX_HELD_S + 0.5
    assert not any(impact.is_press or impact.incomplete for impact in impacts)
    assert list(detector.left_out) == []


@rates
@pytest.mark.parametrize("step", [4.8, 5.2, 20.0])  # [N] noise brings the smallest one to the threshold
@pytest.mark.parametrize("later", [0.4, 0.6, 0.613, 0.8])
def test_an_impact_soon_after_a_step_of_the_zero_is_a_contact_on_it(
    detect: Detect, rate: float, step: float, later: float
) -> None:
    """The step is a press, which has no rebounds, and no force of the impact is in it."""
    time = time_axis(6.0, rate)
    force = noise(time) + step * (time >= 3.0)
    force += 173.0 * np.sin(np.pi * np.clip((time - 3.0 - later) / 0.03, 0.0, 1.0))
    (press_, impact), detector = detect(force, rate)
    assert press_.is_press
    assert (press_.peak_force, press_.held_force) == pytest.approx((step, step), abs=0.7)
    assert impact.onset_sample / rate == pytest.approx(3.0 + later, abs=0.003)
    assert impact.peak_force == pytest.approx(173.0, rel=0.02)
    assert impact.load_force == pytest.approx(step if step > 5.0 else 0.0, abs=0.3)
    assert (impact.rebound, impact.is_press, impact.incomplete) == (0, False, False)
    assert list(detector.left_out) == []


@rates
def test_a_single_sample_after_a_step_of_the_zero_is_counted(detect: Detect, rate: float) -> None:
    time = time_axis(6.0, rate)
    force = noise(time) + 5.2 * (time >= 3.0)
    force[round(3.5 * rate)] += 300.0
    (impact,), detector = detect(force, rate)
    assert (impact.peak_force, impact.held_force) == pytest.approx((5.4, 5.4), abs=0.3)
    assert peaks_by_reason(detector) == pytest.approx({SINGLE_SAMPLE: 305.2}, abs=0.5)


@rates
@pytest.mark.parametrize("start", [0.06, 0.11])
@pytest.mark.parametrize("end", [0.9, 4.0, 9.0])
def test_a_load_that_comes_before_any_baseline_is_counted(
    detect: Detect, rate: float, start: float, end: float
) -> None:
    time = time_axis(8.0, rate)
    impacts, detector = detect(noise(time) + 100.0 * ((time >= start) & (time < end)), rate)
    assert impacts == []
    assert peaks_by_reason(detector) == pytest.approx({NO_BASELINE: 100.0}, abs=0.5)


@rates
@pytest.mark.parametrize("later", [2.0, 6.0])  # before and after the contact is reported
def test_what_is_left_out_on_a_load_counts_with_the_load(detect: Detect, rate: float, later: float) -> None:
    time = time_axis(10.0, rate)
    force = noise(time) + 100.0 * (time >= 2.0)
    force[round((2.0 + later) * rate)] += 60.0
    (impact,), detector = detect(force, rate)
    assert (impact.peak_force, impact.held_force) == pytest.approx((100.0, 100.0), abs=0.6)
    assert [item.reason for item in detector.left_out] == [SINGLE_SAMPLE]
    (item,) = detector.left_out
    assert (item.peak_force, item.load_force) == pytest.approx((160.0, 100.0), abs=1.0)


@rates
@pytest.mark.parametrize("rise", [4.0, 8.0])
def test_an_impact_on_a_slow_press_states_the_press_as_its_load(detect: Detect, rate: float, rise: float) -> None:
    time = time_axis(20.0, rate)
    force = noise(time) + press(time, 2.0, 60.0, rise, 8.0, 4.0)
    force += 150.0 * np.sin(np.pi * np.clip((time - rise - 4.0) / 0.03, 0.0, 1.0))
    (impact,), detector = detect(force, rate)
    assert (impact.peak_force, impact.load_force) == pytest.approx((150.0, 60.0), abs=3.0)
    assert peaks_by_reason(detector)[SLOW_CHANGE] == pytest.approx(60.0, abs=3.0)


@rates
def test_a_slow_press_on_the_load_of_a_contact_is_in_its_held_force(detect: Detect, rate: float) -> None:
    """It is no contact of its own, which would come before the other one though it began later."""
    time = time_axis(20.0, rate)
    force = noise(time) + 50.0 * (time >= 3.0) + press(time, 4.0, 60.0, 3.5, 0.0, 0.05)
    (impact,), detector = detect(force, rate)
    assert (impact.onset_sample / rate, impact.held_force) == pytest.approx((3.0, 110.0), abs=0.5)
    assert list(detector.left_out) == []


@rates
def test_presses_are_found_also_after_short_pauses(detect: Detect, rate: float) -> None:
    time = time_axis(20.0, rate)
    starts = 2.0 + 2.1 * np.arange(8)
    force = noise(time) + sum(press(time, start, 40.0, 0.3, 1.4, 0.2) for start in starts)
    impacts, detector = detect(force, rate)
    assert [impact.onset_sample / rate for impact in impacts] == pytest.approx(starts.tolist(), abs=0.05)
    assert [impact.held_force for impact in impacts] == pytest.approx([40.0] * 8, abs=0.6)
    assert [impact.duration for impact in impacts] == pytest.approx([1.9] * 8, abs=0.1)
    assert all(impact.is_press for impact in impacts)
    assert (detector.sustained_contacts, list(detector.left_out)) == (8, [])


@rates
def test_the_peak_of_a_press_that_rises_on_is_that_of_its_first_half_second(detect: Detect, rate: float) -> None:
    time = time_axis(8.0, rate)
    force = noise(time) + np.interp(time, [2.0, 2.2, 2.6, 3.0, 3.1], [0.0, 25.0, 32.0, 34.0, 0.0])
    (impact,) = detect(force, rate).impacts
    assert impact.peak_force == pytest.approx(30.5, abs=0.6)
    assert impact.held_force == pytest.approx(34.0, abs=0.6)


@rates
def test_a_contact_that_stays_ends_with_its_last_sample(detect: Detect, rate: float) -> None:
    time = time_axis(8.0, rate)
    (impact,), _ = detect(noise(time) + drop(time, 2.0, 50.0, 158.0) * (time < 5.0), rate)
    assert impact.onset_sample + impact.duration * rate == pytest.approx(5.0 * rate, abs=0.1)


@pytest.mark.parametrize("rate", [50.0, 100.0, 125.0, 1000.0])
def test_the_held_force_is_its_largest_sample_unless_that_stands_alone(detect: Detect, rate: float) -> None:
    """A push of 60 ms on the load counts, a single sample does not, wherever in a frame it is."""
    time = time_axis(9.0, rate)
    moving = np.where((time > 2.05) & (time < 7.0), 50.0 + 15.0 * np.sin(8.0 * time), 0.0)
    load = noise(time) + press(time, 2.0, 160.0, 0.03, 0.0, 0.03) + moving
    pushed = load + 250.0 * np.sin(np.pi * np.clip((time - 4.189) / 0.06, 0.0, 1.0))
    (impact,), detector = detect(pushed, rate)
    assert impact.held_force == pytest.approx(pushed[time > 2.6].max(), abs=0.5)
    assert list(detector.left_out) == []
    for at in range(round(4.0 * rate), round(4.0 * rate) + 11):
        force = load.copy()
        force[at] = 300.0
        (impact,), detector = detect(force, rate)
        assert impact.held_force == pytest.approx(load[time > 2.6].max(), abs=0.5)
        assert peaks_by_reason(detector) == pytest.approx({SINGLE_SAMPLE: 300.0}, abs=0.5)
        assert detector.glitches == 1


def test_a_single_sample_before_any_baseline_is_counted(detect: Detect) -> None:
    force = np.zeros(8)
    force[3] = 200.0
    impacts, detector = detect(force, 100.0)
    assert (impacts, peaks_by_reason(detector)) == ([], {NO_BASELINE: 200.0})


@rates
def test_force_that_moves_for_long_is_reported_and_the_rest_counted(detect: Detect, rate: float) -> None:
    time = time_axis(25.0, rate)
    swing = np.where((time > 2.5) & (time < 20.0), 15.0 * np.sin(9.0 * time), 0.0)
    late = np.where((time > 15.0) & (time < 16.0), 40.0, 0.0)
    impacts, detector = detect(noise(time) + drop(time, 2.0, 50.0, 158.0) * (time < 20.0) + swing + late, rate)
    assert len(impacts) == 1
    assert impacts[0].peak_force == pytest.approx(158.0, rel=0.02)
    assert impacts[0].held_force == pytest.approx(65.0, abs=1.0)
    assert impacts[0].duration == pytest.approx(MAX_HELD_S, abs=0.2)
    assert [(item.reason, item.occurrences) for item in detector.left_out] == [(LATER_LOAD, 1)]
    assert peaks_by_reason(detector)[LATER_LOAD] == pytest.approx(105.0, abs=1.0)


@rates
def test_a_slow_press_is_found_by_its_end_and_otherwise_counted_with_its_peak(detect: Detect, rate: float) -> None:
    """The baseline follows both, at 10 N/s; drift does not end at once."""
    time = time_axis(25.0, rate)
    impacts, detector = detect(noise(time) + press(time, 5.0, 60.0, 6.0, 1.0, 0.05), rate)
    (impact,) = impacts
    assert impact.onset_sample / rate == pytest.approx(5.6, abs=0.5)
    transient_end = impact.onset_sample / rate + TRANSIENT_S
    assert impact.peak_force == pytest.approx(10.0 * (transient_end - 5.0), abs=0.5)
    assert impact.held_force == pytest.approx(60.0, abs=2.0)
    assert impact.is_press
    assert list(detector.left_out) == []
    impacts, detector = detect(noise(time) + press(time, 5.0, 60.0, 6.0, 1.0, 6.0), rate)
    assert impacts == []
    assert [(item.reason, item.occurrences) for item in detector.left_out] == [(SLOW_CHANGE, 1)]
    assert peaks_by_reason(detector)[SLOW_CHANGE] == pytest.approx(60.0, abs=1.0)


@rates
@pytest.mark.parametrize("later", [0.7, 3.0])
def test_a_recording_that_ends_during_the_load_has_the_contact(detect: Detect, rate: float, later: float) -> None:
    time = time_axis(2.0 + later, rate)
    (impact,), _ = detect(noise(time) + drop(time, 2.0, 50.0, 158.0), rate)
    assert impact.peak_force == pytest.approx(158.0, rel=0.02)
    assert impact.held_force == pytest.approx(50.0, abs=0.6)
    assert impact.duration == pytest.approx(later, abs=0.02)
    assert not impact.incomplete


@rates
def test_a_load_that_was_there_before_the_recording_is_counted_when_it_goes(detect: Detect, rate: float) -> None:
    time = time_axis(15.0, rate)
    impacts, detector = detect(noise(time) + 50.0 * (time < 2.0), rate)
    assert impacts == []
    assert set(peaks_by_reason(detector)) == {TENSION, EARLIER_LOAD}
    assert list(peaks_by_reason(detector).values()) == pytest.approx([50.0, 50.0], abs=1.0)


@rates
def test_compression_with_the_wrong_sign_is_counted_with_its_force(detect: Detect, rate: float) -> None:
    time = time_axis(8.0, rate)
    _, detector = detect(-noise(time) - drop(time, 2.0, 50.0, 158.0) * (time < 5.0), rate)
    assert peaks_by_reason(detector)[TENSION] == pytest.approx(158.0, rel=0.02)


def test_force_without_a_baseline_is_counted(detect: Detect) -> None:
    time = time_axis(10.0, 1_000.0)
    impacts, detector = detect(100.0 * time, 1_000.0)
    assert impacts == []
    assert not detector.settled
    assert peaks_by_reason(detector)[NO_BASELINE] == pytest.approx(1_000.0, rel=0.05)


def test_a_tare_makes_the_load_the_zero(make_block: MakeBlock) -> None:
    time = time_axis(12.0, 1_000.0)
    force = noise(time) + drop(time, 2.0, 30.0, 60.0) + 100.0 * np.sin(np.pi * np.clip((time - 10.0) / 0.02, 0.0, 1.0))
    detector = Detector(DetectionSettings())
    first = make_block(force[:8_000], 0, 1_000.0)
    second = make_block(force[8_000:] - 30.0, 8_000, 1_000.0, tare=30.0)._replace(tare_stamp_ns=1)
    impacts = [*detector.feed(first), *detector.feed(second), *detector.finish()]
    assert [impact.load_force for impact in impacts] == [0.0, 0.0]


@pytest.mark.parametrize("rate", RATES[:2])
@pytest.mark.parametrize("rise", [0.5, 4.0])  # [s] the second one is as slow as drift
def test_a_drop_soon_after_a_press_is_measured_from_zero(detect: Detect, rate: float, rise: float) -> None:
    """The force is at zero for 80 ms between the two."""
    time, end = time_axis(15.0, rate), 2.0 + rise + 1.5 + 0.1
    force = noise(time) + press(time, 2.0, 60.0, rise, 1.5) + drop(time, end + 0.08, 42.0, 106.0) * (time < end + 2.0)
    impacts, _ = detect(force, rate)
    impact = impacts[-1]
    assert impact.onset_sample / rate == pytest.approx(end + 0.08, abs=0.01)
    assert (impact.peak_force, impact.held_force, impact.load_force) == pytest.approx((106.0, 42.0, 0.0), abs=1.0)


def end_of(impact: Impact, force: FloatArray, rate: float) -> float:
    """Return the end of `impact` [s]; one that was published after MAX_HELD_S ends with the load that it leaves."""
    end = impact.onset_sample + impact.duration * rate
    if impact.duration >= MAX_HELD_S:
        end += float(np.argmax(force[math.floor(end) :] < DetectionSettings().threshold))
    return end / rate


def covered(impacts: Iterable[tuple[float, float]], time: FloatArray) -> BoolArray:
    mask = np.zeros(time.size, dtype=np.bool_)
    for begin, end in impacts:
        mask |= (time >= begin - 0.05) & (time <= end + 0.05)
    return mask


@settings(max_examples=40, deadline=None)
@given(
    rate=st.sampled_from(RATES[:2]),
    events=st.lists(
        st.tuples(
            st.sampled_from(["drop", "press", "strike"]),
            st.floats(0.05, 3.0),
            st.floats(10.0, 200.0),
            st.floats(0.02, 4.0),
            st.floats(0.02, 1.0),
        ),
        min_size=1,
        max_size=6,
    ),
)
def test_no_force_above_the_threshold_is_in_neither_list(
    detect: Detect, rate: float, events: list[tuple[str, float, float, float, float]]
) -> None:
    """What is larger than any peak that was left out lies in a contact."""
    time = time_axis(60.0, rate)
    force, start = noise(time), 2.0
    for kind, pause, size, hold, rise in events:
        shapes = {
            "drop": drop(time, start, 0.4 * size, size) * (time < start + 0.03 + hold),
            "press": press(time, start, size, rise, hold),
            "strike": size * np.sin(np.pi * np.clip((time - start) / 0.03, 0.0, 1.0)),
        }
        force += shapes[kind]
        start += 0.03 + hold + rise + pause + 0.1
    impacts, detector = detect(force, rate)
    spans = [(impact.onset_sample / rate, end_of(impact, force, rate)) for impact in impacts]
    pairs = np.minimum(force[1:], force[:-1])[~covered(spans, time)[1:]]  # a single sample can be a glitch
    largest = float(pairs.max(initial=0.0))
    left_out = max(peaks_by_reason(detector).values(), default=DetectionSettings().threshold)
    assert largest <= left_out + 4.0 * NOISE
    for impact, (begin, end) in zip(impacts, spans, strict=True):
        inside = force[(time >= begin) & (time <= end)]
        most = max(impact.peak_force, impact.held_force) + impact.baseline
        assert inside.max(initial=0.0) <= most + 6.0 * NOISE + 0.2 * most
        assert most <= inside.max(initial=0.0) + 6.0 * NOISE + 0.1 * most

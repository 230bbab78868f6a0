# SPDX-License-Identifier: Apache-2.0
"""A load that nobody stated, seen in the torques of simulated joint states."""

import math
import re
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from scara_effmass.codes import Reason
from scara_effmass.errors import RobotError
from scara_effmass.identification.payload import PayloadEstimate, PayloadEstimator
from scara_effmass.kernel.records import IntArray
from scara_effmass.kernel.state import CODE
from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor, load_watch
from scara_effmass.safety.assessments import Assessments
from scara_effmass.safety.load_watch import Doubt
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import FloatArray, JointState, Verdict

UR10 = Path(__file__).parents[2] / "config/robots/ur10_robot.urdf"
SETTINGS = MonitorSettings(
    contact_points=("ee_link",),
    accept_assumptions=("payload", "rotor_inertia", "drives", "contact_area", "contact_surface"),
)
RATE_HZ, SECONDS = 100, 6.0
START_NS = 1_000_000_000


class Motion(NamedTuple):
    """Simulated joint states."""

    names: tuple[str, ...]
    stamps: IntArray
    q: FloatArray
    qd: FloatArray
    effort: FloatArray


def motion(load: float, *, scale: float = 1.0, noise: float = 0.2, only: int | None = None) -> Motion:
    """Simulate a UR10 with a `load` [kg] 5 cm beyond its flange; `scale` turns torque into effort.

    The joint `only` moves alone.
    """
    robot = load_robot(UR10, SETTINGS)
    model, t = robot.model.copy(), np.arange(0.0, SECONDS, 1.0 / RATE_HZ)
    model.appendBodyToJoint(
        6, pin.Inertia(load, np.array([0.0, 0.14, 0.0]), 1e-3 * load * np.eye(3)), pin.SE3.Identity()
    )
    data, w = model.createData(), np.array([0.5, 0.8, 1.1, 1.7, 1.4, 2.0])
    middle, size = np.array([0.0, -1.2, 1.0, -0.5, 0.7, 0.0]), np.array([0.5, 0.4, 0.5, 0.6, 0.6, 0.8])
    size = size if only is None else size * (np.arange(6) == only)
    phase = np.outer(t, w) + np.arange(6)
    q, qd, qdd = middle + size * np.sin(phase), size * w * np.cos(phase), -size * w**2 * np.sin(phase)
    torque = np.array([pin.rnea(model, data, *row) for row in zip(q, qd, qdd, strict=True)])
    torque += np.array([4.0, 4.0, 2.0, 0.5, 0.5, 0.5]) * (np.sign(qd) + 0.3 * qd)
    torque *= 1.0 + np.array([0.02, -0.01, 0.03, -0.02, 0.01, -0.03])
    torque += noise * np.random.default_rng(3).normal(size=torque.shape)
    return Motion(robot.joint_names, START_NS + np.round(1e9 * t).astype(np.int64), q, qd, scale * torque)


def monitor(**changes: object) -> Monitor:
    settings = SETTINGS.model_copy(update=changes)
    return Monitor(RobotDynamics(load_robot(UR10, settings)), settings)


def assessed(watcher: Monitor, states: Motion, start: int, stop: int) -> Assessments:
    rows = slice(start, stop)
    numbers = states.q[rows], states.qd[rows], states.effort[rows]
    pending = watcher.admit(states.names, states.stamps[rows], states.stamps[rows], *numbers)
    assert pending is not None
    watcher.compute(pending)
    return watcher.settle(pending)


def codes(watcher: Monitor, states: Motion) -> set[int]:
    """Return the codes of the reasons of all joint states."""
    contacts = assessed(watcher, states, 0, len(states.stamps)).contacts
    return {int(code) for code in contacts["reason"][..., CODE].ravel()}


def test_unstated_load_is_found_and_named() -> None:
    watcher = monitor()
    assert Reason.UNSTATED_LOAD in codes(watcher, motion(2.0))
    estimate = watcher.load_watch.estimate
    assert estimate is not None
    lower, upper = estimate.interval
    assert lower < 2.0 < upper < 2.4
    last, now_ns = motion(2.0), START_NS + round(1e9 * SECONDS)
    decision = watcher.assess(JointState(now_ns, last.names, last.q[-1], last.qd[-1], last.effort[-1]), now_ns)
    assert decision is not None
    (contact,) = decision.contacts
    assert contact.verdict is Verdict.UNKNOWN
    assert contact.allowable_speed == 0.0
    assert contact.reason.startswith("the torques show a load of ")
    assert "not the stated 0.00 kg" in contact.reason


@pytest.mark.parametrize("value", [math.nan, 1e200, -1e300])
def test_effort_that_no_drive_has_hides_no_load(value: float) -> None:
    states = motion(4.0)
    states.effort[100, 2] = value
    assert Reason.UNSTATED_LOAD in codes(monitor(), states)


def test_clock_that_jumps_back_ends_what_is_known_of_the_load() -> None:
    watcher = monitor()
    assert Reason.UNSTATED_LOAD in codes(watcher, motion(2.0))
    watcher.clear_history()
    assert (watcher.load_watch.estimate, watcher.load_watch.doubt) == (None, Doubt())


def test_stated_load_is_no_doubt() -> None:
    """Nor is one that is stated heavier than it is: `payload_mass` is the heaviest load."""
    for stated in (2.0, 5.0):
        watcher = monitor(payload_mass=stated, payload_com=(0.05, 0.0, 0.0))
        assert not {Reason.UNSTATED_LOAD, Reason.HEAVIER_LOAD} & codes(watcher, motion(2.0))
        estimate = watcher.load_watch.estimate
        assert estimate is not None
        assert estimate.stated == stated
        assert estimate.interval[0] < 2.0 < estimate.interval[1]
        assert watcher.load_text == watcher.load_watch.text


def test_small_unstated_load_warns() -> None:
    """It adds less than `mass_uncertainty` to every mass: the speed is still not too high."""
    watcher = monitor(mass_uncertainty=0.9)
    found = codes(watcher, motion(1.0))
    assert Reason.HEAVIER_LOAD in found
    assert Reason.UNSTATED_LOAD not in found
    assert watcher.verdicts[Verdict.OK] < len(motion(1.0).stamps)


def after(states: Motion, seconds: float) -> Motion:
    return states._replace(stamps=states.stamps + round(1e9 * seconds))


@pytest.mark.parametrize(
    ("changes", "first", "last"),
    [
        ({"timeout": 0.3}, Reason.UNSTATED_LOAD, Reason.UNSTATED_LOAD),
        ({"velocity_window": 0.03}, Reason.UNSTATED_LOAD, Reason.UNSTATED_LOAD),
        ({"mass_uncertainty": 0.9}, Reason.UNSTATED_LOAD, Reason.HEAVIER_LOAD),
        ({"payload_mass": 0.001}, Reason.UNSTATED_LOAD, Reason.UNSTATED_LOAD),
        ({"payload_mass": 0.0, "payload_com": (0.0, 0.0, 0.1)}, Reason.UNSTATED_LOAD, Reason.UNSTATED_LOAD),
        ({"payload_mass": 2.0, "payload_com": (0.05, 0.0, 0.0)}, Reason.NONE, Reason.NONE),
    ],
    ids=lambda value: "" if isinstance(value, Reason) else str(value),
)
def test_changed_setting_ends_no_doubt_unless_it_states_the_load(
    changes: dict[str, Any], first: Reason, last: Reason
) -> None:
    watcher, states = monitor(), motion(2.0)
    codes(watcher, states)
    watcher.apply(watcher.settings.model_copy(update=changes))
    assert watcher.load_watch.doubt.reason is first
    codes(watcher, after(states, SECONDS))
    assert watcher.load_watch.doubt.reason is last


def test_a_load_that_grows_is_told_anew() -> None:
    watcher = monitor(mass_uncertainty=0.9)
    assert Reason.UNSTATED_LOAD not in codes(watcher, motion(1.0))
    first = watcher.load_watch.doubt
    assert first.reason is Reason.HEAVIER_LOAD
    for part in range(1, 4):
        last = codes(watcher, after(motion(12.0), part * SECONDS))
    assert Reason.UNSTATED_LOAD in last
    assert not {Reason.HEAVIER_LOAD, Reason.NONE} & last
    found = re.search(r"a load of (\d+\.\d\d) kg", watcher.load_watch.doubt.text)
    assert found
    assert float(found[1]) == pytest.approx(12.0, abs=1.0)


@pytest.mark.parametrize("joint", [0, 5])
def test_motion_that_shows_nothing_ends_no_doubt(joint: int) -> None:
    """Only the stated load ends it."""
    watcher = monitor()
    codes(watcher, motion(4.0))
    alone = motion(4.0, only=joint)
    for part in range(1, 4):
        last = codes(watcher, after(alone, part * SECONDS))
    assert Reason.UNSTATED_LOAD in last
    assert not {Reason.HEAVIER_LOAD, Reason.NONE} & last
    for part in range(4, 7):
        last = codes(watcher, after(motion(0.0), part * SECONDS))
    assert not {Reason.UNSTATED_LOAD, Reason.HEAVIER_LOAD} & last


def test_interval_that_holds_both_loads_ends_no_doubt() -> None:
    """Noise leaves an estimate of 0.8 kg within 0.9 kg: neither no load nor the one in doubt."""
    watcher = monitor()
    codes(watcher, motion(1.0))
    for part in range(1, 3):
        last = codes(watcher, after(motion(1.0, noise=80.0), part * SECONDS))
        assert Reason.UNSTATED_LOAD in last
        assert not {Reason.HEAVIER_LOAD, Reason.NONE} & last
    estimate = watcher.load_watch.estimate
    assert estimate is not None
    assert estimate.is_observable
    assert estimate.interval[0] == 0.0
    for part in range(3, 6):
        last = codes(watcher, after(motion(0.0), part * SECONDS))
    assert not {Reason.UNSTATED_LOAD, Reason.HEAVIER_LOAD} & last


@pytest.mark.parametrize(
    ("first_gain", "gain", "changes"),
    [
        (3.0, 1.05, {"mass": 1.0, "is_observable": False}),
        (1.05, 0.9, {"mass": 0.0, "is_observable": False}),
        (1.05, 0.9, {"mass": 0.0, "deviation": 1.0}),
        (3.0, 0.9, {"mass": 0.0, "unfit": "the effort of elbow_joint is 0 while it moves"}),
    ],
    ids=["less heavy", "lighter", "lighter or not", "unfit"],
)
def test_estimate_that_tells_nothing_weakens_no_doubt(
    monkeypatch: pytest.MonkeyPatch, first_gain: float, gain: float, changes: dict[str, Any]
) -> None:
    """Of the load that it states, it would: the motion does not show it, or the torques do not fit."""
    nothing = np.zeros((6, 2))
    first = PayloadEstimate(1, 2.0, 0.05, 0.0, np.zeros(3), np.full(3, 0.001), True, "", "", nothing, nothing[:, 0])  # noqa: FBT003
    then = first._replace(moment=np.array([0.5, 0.0, 0.0]), **changes)
    found = iter([first, then])
    monkeypatch.setattr(PayloadEstimator, "add", lambda *_: next(found, None))
    monkeypatch.setattr(load_watch, "mass_gain", lambda _, load, __: gain if load < first.mass else first_gain)
    watcher = monitor(mass_uncertainty=0.1)
    codes(watcher, motion(0.0))
    assert watcher.load_watch.estimate is then
    assert watcher.load_watch.doubt.reason is (Reason.UNSTATED_LOAD if first_gain > 1.1 else Reason.HEAVIER_LOAD)


@pytest.mark.parametrize(("mass", "expected"), [(0.25, Reason.NONE), (0.5, Reason.UNSTATED_LOAD)])
def test_difference_that_raises_no_doubt_keeps_none(
    monkeypatch: pytest.MonkeyPatch, mass: float, expected: Reason
) -> None:
    """It is below 1 % of the mass of the arm, 0.3 kg, although the interval does not hold the stated load."""
    nothing = np.zeros((6, 2))
    first = PayloadEstimate(1, 2.0, 0.05, 0.0, np.zeros(3), np.full(3, 0.001), True, "", "", nothing, nothing[:, 0])  # noqa: FBT003
    found = iter([first, first._replace(mass=mass)])
    monkeypatch.setattr(PayloadEstimator, "add", lambda *_: next(found, None))
    monkeypatch.setattr(load_watch, "mass_gain", lambda *_: 3.0)
    watcher = monitor()
    codes(watcher, motion(0.0))
    assert watcher.load_watch.doubt.reason is expected


def test_stated_mass_at_another_place_is_told() -> None:
    """The load of 2 kg is 5 cm beyond the flange, as stated, or was said to be 5 cm before it."""
    for place, expected in ((0.05, Reason.NONE), (-0.05, Reason.UNSTATED_LOAD)):
        watcher = monitor(payload_mass=2.0, payload_com=(place, 0.0, 0.0))
        codes(watcher, motion(2.0))
        assert watcher.load_watch.doubt.reason is expected
    assert re.search(r"centre of mass: the moment is 0\.\d\d\d kg m off", watcher.load_watch.doubt.text)


def test_no_load_and_no_effort_raise_no_doubt() -> None:
    watcher = monitor()
    assert not {Reason.UNSTATED_LOAD, Reason.HEAVIER_LOAD} & codes(watcher, motion(0.0))
    assert "0.0" in watcher.load_watch.text
    assert watcher.load_text == watcher.load_watch.text  # the payload is accepted as assumed
    without = motion(2.0)._replace(effort=np.empty((len(motion(2.0).stamps), 0)))
    watcher = monitor()
    assert Reason.UNSTATED_LOAD not in codes(watcher, without)
    assert watcher.load_watch.text.startswith("unknown: it needs joint states with finite effort of all joints")


def test_interval_is_rounded_outwards() -> None:
    watcher = monitor()
    codes(watcher, motion(2.0, noise=4.0))
    estimate, found = watcher.load_watch.estimate, re.search(r"\((.*) to (.*)\)", watcher.load_watch.text)
    assert estimate is not None
    assert found
    assert float(found[1]) <= estimate.interval[0]
    assert estimate.interval[1] <= float(found[2])


def test_assumed_payload_says_what_the_torques_show() -> None:
    watcher = monitor(accept_assumptions=())
    assert watcher.load_text.startswith("unknown: it needs")
    codes(watcher, motion(0.0))
    found = re.fullmatch(
        r".*: up to (0\.\d\d) kg are not stated: state payload_mass and payload_com", watcher.load_text
    )
    assert found
    assert 0.0 < float(found[1]) < 0.3


def test_motor_current_is_no_torque_unless_stated() -> None:
    watcher = monitor()
    assert Reason.UNSTATED_LOAD not in codes(watcher, motion(2.0, scale=0.1))
    assert "off the torque of the model" in watcher.load_watch.text
    constants = tuple(f"{name}=10" for name in motion(0.0).names)
    assert Reason.UNSTATED_LOAD in codes(monitor(torque_constants=constants), motion(2.0, scale=0.1))


def test_switched_off() -> None:
    watcher = monitor(effort_uncertainty=0.0)
    assert Reason.UNSTATED_LOAD not in codes(watcher, motion(2.0))
    assert watcher.load_watch.text == "unknown: effort_uncertainty is 0"


@pytest.mark.parametrize("entry", ["elbow=1", "elbow_joint=x", "elbow_joint=-1"])
def test_bad_torque_constants_are_refused(entry: str) -> None:
    with pytest.raises(RobotError, match=f"torque_constants = '{entry}'"):
        monitor(torque_constants=(entry,))


@settings(max_examples=5, deadline=None)
@example(list(range(400, 420)))
@given(st.lists(st.integers(1, int(RATE_HZ * SECONDS) - 1), max_size=8, unique=True))
def test_batches_do_not_matter(cuts: list[int]) -> None:
    """In the example, joint states come one by one while the load is in doubt, as they do live."""
    states = motion(1.5)
    whole, parts = monitor(), monitor()
    expected = assessed(whole, states, 0, len(states.stamps))
    edges = [0, *sorted(cuts), len(states.stamps)]
    found = [assessed(parts, states, start, stop) for start, stop in pairwise(edges)]
    assert np.concatenate([part.contacts.view(np.uint8) for part in found]).tobytes() == expected.contacts.tobytes()
    assert parts.load_watch.text == whole.load_watch.text

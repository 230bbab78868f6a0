# SPDX-License-Identifier: Apache-2.0
"""Joint states in batches of any size give, bit for bit, the assessments of one joint state after another."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from scara_effmass.codes import Reason
from scara_effmass.kernel.records import IntArray
from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Assessments, Monitor
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import FloatArray, JointState, Payload

NAMES = ("joint1", "joint2", "joint3", "joint4")
CENTRE, SIZE = np.array([0.2, 0.4, 0.1, -0.3]), np.array([0.4, 0.3, 0.02, 0.5])
START_NS, STEP_NS, COUNT = 10**15, 8_000_000, 120
PAYLOAD = Payload(1.5, (0.05, 0.0, 0.1), (0.01, 0.01, 0.01, 0.0, 0.0, 0.0))
FAULTS = (
    *("repeated", "late", "old", "future", "zero stamp", "jump", "wrong velocity", "limit", "speed", "nan"),
    *("nan velocity", "zero velocity", "no velocity", "short", "other names", "twice", "missing", "no names"),
    *(
        "other device",
        "its motion",
        "rail",
        "undecodable",
        "clock back",
        "payload",
        "no payload",
        "watchdog",
        "fast",
        "command",
    ),
)
SETTINGS: tuple[dict[str, Any], ...] = (
    {},
    {"release_time": 0.0},
    {"latch": True},
    {"latch": True, "release_time": 0.0, "reference_speed": 1.0},
    {"velocity_window": 0.03},
    {"velocity_source": "from_positions"},
    {"velocity_source": "from_positions", "velocity_window": 0.05},
    {"drives": "servo", "contact_normal": "0 0 1"},
    {"effective_mass_model": "lumped", "contact_normal": "velocity"},
    {"payload_topic": "payload"},
)


@pytest.fixture(scope="module")
def two_contacts() -> RobotDynamics:
    """The shipped SCARA with two contact points."""
    return RobotDynamics(load_robot(settings=MonitorSettings(contact_points=("tool", "rim=link4: 0.05 0 0"))))


class Item(NamedTuple):
    """A joint state with the time of its arrival [ns], or another event."""

    event: str
    state: JointState
    now_ns: int


def recording(seed: int, rate: float, faults: list[tuple[int, str]]) -> list[Item]:
    """Return a motion with noise, damaged at the given rows."""
    rng = np.random.default_rng(seed)
    stamps = START_NS + np.cumsum(rng.integers(STEP_NS // 2, 2 * STEP_NS, COUNT))
    clocks = stamps + rng.integers(0, 10**6, COUNT)
    phase = rate * np.array([1.0, 1.4, 0.6, 2.1])
    angle = phase * (stamps - START_NS)[:, None] / 1e9
    q, qd = CENTRE + SIZE * np.sin(angle), SIZE * phase * np.cos(angle) + rng.normal(0.0, 1e-3, (COUNT, 4))
    items = [Item("", JointState(0, NAMES, q[row], qd[row]), 0) for row in range(COUNT)]
    for row, kind in faults:
        items[row] = damaged(kind, row, items[row], stamps, clocks, q, qd)
    return [
        item._replace(state=item.state._replace(stamp_ns=int(stamps[row])), now_ns=int(clocks[row]))
        for row, item in enumerate(items)
    ]


def damaged(kind: str, row: int, item: Item, stamps: IntArray, clocks: IntArray, q: FloatArray, qd: FloatArray) -> Item:
    """Put a fault into the joint state number `row`, or begin one there; return what comes in its place."""
    state, later = item.state, {"late": 201_000_000, "old": 10**9, "clock back": -(10**10)}.get(kind, 0)
    stamps[row:] += later
    clocks[row:] += later
    stamp_ns = {"repeated": stamps[row - 1], "old": clocks[row] - 200_000_001, "future": clocks[row] + 20_000_001}
    stamps[row] = 0 if kind == "zero stamp" else stamp_ns.get(kind, stamps[row])
    if kind == "jump":
        q[row:, 1] += 0.1
    elif kind in {"wrong velocity", "zero velocity", "fast"}:
        qd[row : row + 40] *= {"wrong velocity": -1.0, "fast": 6.0}.get(kind, 0.0)
    elif kind in {"limit", "nan", "speed", "nan velocity"}:
        column, value = {"limit": (q, 3.0), "nan": (q, np.nan), "speed": (qd, -40.0)}.get(kind, (qd, np.nan))
        column[row, 1] = value
    names = {
        "other names": (*NAMES[1:], "gripper", NAMES[0]),
        "rail": (*NAMES[1:], "gripper", NAMES[0]),
        "twice": ("joint1",) * 4,
        "missing": (*NAMES[:3], "joint_4"),
        "no names": (),
        "other device": ("left", "right", "a", "b"),
        "its motion": ("left", "right", "a", "b"),
    }.get(kind, state.names)
    position, velocity = q[row], qd[row]
    if kind in {"other names", "rail"}:
        speed = 9.0 if kind == "rail" else 0.0
        position, velocity = (np.array([*x[1:], y, x[0]]) for x, y in ((position, 9.0), (velocity, speed)))
    if kind == "other device":
        position, velocity = np.zeros(4), np.zeros(4)
    if kind == "no velocity":
        velocity = np.empty(0)
    if kind == "short":
        position = position[:3]
    is_event = kind in {"undecodable", "payload", "no payload", "watchdog", "command"}
    return Item(kind if is_event else "", JointState(0, names, position, velocity), 0)


def handle(monitor: Monitor, item: Item) -> list[Assessments]:
    """Give an event that is no joint state to the monitor."""
    if item.event == "undecodable":
        return [monitor.settle(monitor.refuse(Reason.UNDECODABLE, "not CDR", item.state.stamp_ns))]
    if item.event == "watchdog":
        return [monitor.watchdog_decision(10**9, item.now_ns)]
    if item.event == "command":
        monitor.expect_commands(0.2)
        monitor.take_command(item.state, item.now_ns)
    elif monitor.settings.payload_topic:
        monitor.take_payload(PAYLOAD if item.event == "payload" else "2 publishers")
    return []


def one_by_one(monitor: Monitor, items: list[Item]) -> list[Assessments]:
    """Return the assessments of joint states that come one after another, as the node gets them."""
    parts = []
    for item in items:
        if item.event:
            parts += handle(monitor, item)
        elif (one := monitor.assess_one(item.state, item.now_ns)) is not None:
            parts.append(one)
    return parts


def in_batches(monitor: Monitor, items: list[Item], cuts: list[int]) -> list[Assessments]:
    """Return the assessments of batches that end at the rows `cuts`, at events, and where the layout changes."""

    def layout(item: Item) -> object:
        return item.state.names, len(item.state.position), len(item.state.velocity)

    ends = {0, len(items), *cuts}
    ends |= {row for row in range(1, len(items)) if layout(items[row]) != layout(items[row - 1])}
    ends |= {end for row, item in enumerate(items) if item.event for end in (row, row + 1)}
    parts = []
    for first, end in pairwise(sorted(ends)):
        batch = items[first:end]
        if batch[0].event:
            parts += handle(monitor, batch[0])
            continue
        pending = monitor.admit(
            batch[0].state.names,
            np.array([item.state.stamp_ns for item in batch]),
            np.array([item.now_ns for item in batch]),
            np.array([item.state.position for item in batch]),
            np.array([item.state.velocity for item in batch]),
        )
        if pending is not None:
            monitor.compute(pending)
            parts.append(monitor.settle(pending))
    return parts


def texts(parts: list[Assessments]) -> list[str]:
    return [part.reason(row, point) for part in parts for row in range(len(part)) for point in range(2)]


@given(
    seed=st.integers(0, 2**32 - 1),
    rate=st.floats(0.0, 6.0),
    faults=st.lists(st.tuples(st.integers(2, COUNT - 1), st.sampled_from(FAULTS)), max_size=8),
    cuts=st.lists(st.integers(1, COUNT - 1), max_size=20),
    values=st.sampled_from(SETTINGS),
)
@example(1, 2.0, [], [], {})
@example(2, 3.0, [(4 + 4 * row, kind) for row, kind in enumerate(FAULTS)], [30, 31], {"latch": True})
@example(3, 3.0, [(4 + 4 * row, kind) for row, kind in enumerate(FAULTS[::-1])], [], SETTINGS[-1])
@example(4, 3.0, [(4 + 4 * row, kind) for row, kind in enumerate(FAULTS)], [9], SETTINGS[6])
def test_batches_give_bit_identical_assessments(
    two_contacts: RobotDynamics,
    seed: int,
    rate: float,
    faults: list[tuple[int, str]],
    cuts: list[int],
    values: dict[str, Any],
) -> None:
    items = recording(seed, rate, faults)
    settings = MonitorSettings.model_validate(values)
    live, offline = Monitor(two_contacts, settings), Monitor(two_contacts, settings)
    expected, batches = one_by_one(live, items), in_batches(offline, items, cuts)
    singles = np.concatenate([part.states for part in expected])
    states = np.concatenate([part.states for part in batches])
    for name in singles.dtype.names or ():
        np.testing.assert_array_equal(states[name], singles[name], err_msg=name)
    contacts = [np.concatenate([part.numbers for part in parts]) for parts in (batches, expected)]
    assert contacts[0].tobytes() == contacts[1].tobytes()
    assert texts(batches) == texts(expected)
    assert (offline.verdicts, offline.rejected, offline.ignored) == (live.verdicts, live.rejected, live.ignored)
    assert offline.first_cause == live.first_cause


@pytest.mark.parametrize("values", SETTINGS, ids=str)
def test_recordings_have_several_verdicts(two_contacts: RobotDynamics, values: dict[str, Any]) -> None:
    """Otherwise the comparison would mean little."""
    monitor = Monitor(two_contacts, MonitorSettings.model_validate(values))
    monitor.take_payload(PAYLOAD)
    one_by_one(monitor, recording(5, 3.0, [(60, "fast"), (100, "nan")]))
    assert sum(count > 0 for count in monitor.verdicts.values()) >= 2

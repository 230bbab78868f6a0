# SPDX-License-Identifier: Apache-2.0
"""A payload by topic: no speed is allowed before its first message, nor after an impossible one."""

import math

import numpy as np
import pytest

from scara_effmass.errors import SettingsError
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.settings import MonitorSettings, checked
from scara_effmass.values import ContactAssessment, JointState, Payload, Verdict

JOINTS = ("joint1", "joint2", "joint3", "joint4")
NOW = 1_700_000_000_000_000_000
NONE = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
PAYLOAD = Payload(2.5, (0.05, 0.0, 0.1), (0.1, 0.1, 0.15, 0.01, 0.0, 0.0))
NAN, INF = math.nan, math.inf


def first_of(monitor: Monitor, number: int = 0) -> ContactAssessment:
    """Return the assessment of the joint state `number`, 1 ms after the one before it."""
    state = JointState(NOW + number * 1_000_000, JOINTS, np.array([0.3, 1.2, 0.1, -0.4]), np.full(4, 0.01))
    decision = monitor.assess(state, state.stamp_ns)
    assert decision is not None
    assert (decision.allowable_speed > 0.0) == (decision.contacts[0].verdict is not Verdict.UNKNOWN)
    return decision.contacts[0]


@pytest.fixture
def awaiting(scara: RobotDynamics) -> Monitor:
    """A monitor whose payload comes by topic."""
    return Monitor(scara, MonitorSettings(release_time=0.0, payload_topic="payload"))


def test_verdict_waits_for_the_payload_and_is_that_of_the_parameters(awaiting: Monitor, scara: RobotDynamics) -> None:
    waiting = first_of(awaiting)
    assert (waiting.verdict, waiting.reason) == (Verdict.UNKNOWN, "no payload on payload yet")
    assert (waiting.effective_mass, waiting.allowable_speed, waiting.margin) == (0.0, 0.0, 0.0)
    assert math.isnan(waiting.full_mass)
    awaiting.take_payload(PAYLOAD)
    names = {f"payload_{name}": value for name, value in PAYLOAD._asdict().items()}
    settings = checked(MonitorSettings, {"release_time": 0.0, **names}, "test")
    by_parameter = Monitor(scara.with_payload(settings), settings)
    first_of(by_parameter)
    # As text, because a NaN is equal to itself only as the same object.
    assert repr(first_of(awaiting, 1)) == repr(first_of(by_parameter, 1))
    assert awaiting.payload_text == "0.25 kg (robot file) + 2.5 kg (topic payload)"
    awaiting.take_payload(Payload(0.0, (0.0, 0.0, 0.0), NONE))
    assert awaiting.payload_text == "0.25 kg (robot file) + 0 kg (topic payload)"
    assert awaiting.rejected == 0


@pytest.mark.parametrize(
    ("payload", "reason"),
    [
        (PAYLOAD._replace(mass=NAN), "payload: payload_mass = nan: "),
        (PAYLOAD._replace(mass=INF), "payload: payload_mass = inf: "),
        (PAYLOAD._replace(mass=-0.1), "payload: payload_mass = -0.1: "),
        (PAYLOAD._replace(mass=2000.0), "payload: payload_mass = 2000.0: "),
        (PAYLOAD._replace(com=(0.0, NAN, 0.0)), "payload: payload_com.1 = nan: "),
        (PAYLOAD._replace(com=(0.0, 0.0, 100.0)), "payload: payload_com.2 = 100.0: "),
        (PAYLOAD._replace(inertia=(NAN, *NONE[1:])), "payload: payload_inertia.0 = nan: "),
        (PAYLOAD._replace(inertia=(0.1, 0.1, -0.1, 0.0, 0.0, 0.0)), "payload_inertia = "),
        (PAYLOAD._replace(inertia=(0.1, 0.1, 0.3, 0.0, 0.0, 0.0)), "payload_inertia = "),
        (PAYLOAD._replace(mass=0.0), "payload_inertia = "),
        ("2 publishers", "2 publishers"),
    ],
)
def test_doubtful_payload_gives_unknown_until_the_next_valid_one(
    payload: Payload | str, reason: str, awaiting: Monitor
) -> None:
    awaiting.take_payload(PAYLOAD)
    known = first_of(awaiting)
    awaiting.take_payload(payload)
    unknown = first_of(awaiting, 1)
    assert unknown.verdict is Verdict.UNKNOWN
    assert unknown.reason.startswith(reason if isinstance(payload, str) else f"the payload is unknown: {reason}")
    assert (unknown.effective_mass, unknown.allowable_speed) == (0.0, 0.0)
    assert awaiting.payload_text == unknown.reason
    awaiting.take_payload(PAYLOAD)
    again = first_of(awaiting, 2)
    assert (again.verdict, again.full_mass) == (known.verdict, known.full_mass)


def test_settings_changed_meanwhile_keep_the_payload(awaiting: Monitor) -> None:
    awaiting.take_payload(PAYLOAD)
    heavy = first_of(awaiting)
    awaiting.apply(awaiting.settings.model_copy(update={"person_speed": 0.1}))
    assert first_of(awaiting, 1).full_mass == heavy.full_mass


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("payload_mass", 2.0, "2.0"),
        ("payload_com", (0.0, 0.0, 0.1), r"\(0.0, 0.0, 0.1\)"),
        ("payload_inertia", (0.0, 0.0, 0.1, 0.0, 0.0, 0.0), r"\(0.0, 0.0, 0.1, 0.0, 0.0, 0.0\)"),
    ],
)
def test_topic_and_parameters_exclude_each_other(name: str, value: object, text: str) -> None:
    """A parameter that changed beside the topic would replace the payload that the topic stated."""
    with pytest.raises(SettingsError, match=rf"payload_topic = 'payload': .*must be empty with {name} = {text}"):
        checked(MonitorSettings, {name: value, "payload_topic": "payload"}, "cell.yaml")

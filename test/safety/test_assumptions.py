# SPDX-License-Identifier: Apache-2.0
"""What nothing states is assumed, reported, and allows no OK unless it is accepted by name."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from scara_effmass.codes import Assumption, Reason
from scara_effmass.errors import SettingsError
from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.safety.assumptions import RULES, Assumptions, assumptions_of, mass_source, name_of
from scara_effmass.settings import MonitorSettings, checked, load_settings
from scara_effmass.share import share
from scara_effmass.values import JointState, Payload, Verdict

UR5 = share("config", "robots", "ur5_robot.urdf")
NAMES = tuple(map(name_of, Assumption))
STATED: dict[Assumption, dict[str, Any]] = {
    Assumption.PAYLOAD: {"payload_mass": 0.0},
    Assumption.ROTOR_INERTIA: {"armature": tuple(f"{joint}=0.0" for joint in load_robot(UR5).joint_names)},
    Assumption.DRIVES: {"drives": "servo"},
    Assumption.CONTACT_AREA: {"contact_area_m2": 1e-4},
    Assumption.CONTACT_SURFACE: {"contact_normal": "worst"},
    Assumption.PERSON_SPEED: {"person_speed": 0.0},
    Assumption.CONTACT_POINTS: {"contact_points": ("ee_link",)},
    Assumption.ACCELERATION: {"max_acceleration": 0.0},
    Assumption.CONTACT_DAMPING: {"contact_damping": 0.0},
    Assumption.CONTACT_FRICTION: {"contact_friction": 0.0},
}
"""The defaults of the parameters, stated."""
CAUTIOUS = {Assumption.DRIVES, Assumption.CONTACT_SURFACE}
"""Those that cannot raise the allowable speed. All others are permissive."""
ALL_STATED: dict[str, Any] = {name: value for values in STATED.values() for name, value in values.items()}


def monitor_of(*, use_reference: bool = False, **settings: Any) -> Monitor:  # noqa: ANN401
    values = MonitorSettings.model_validate({"robot": str(UR5), **settings})
    return Monitor(RobotDynamics(load_robot(settings=values)), values, use_reference=use_reference)


def states(monitor: Monitor, count: int = 5) -> list[JointState]:
    """Return joint states of a robot that moves slowly."""
    names = monitor.dynamics.robot.joint_names
    q, qd = np.linspace(-1.0, 1.0, len(names)), np.full(len(names), 0.01)
    return [JointState(10**9 + 10**7 * i, names, q + 0.01 * i * qd, qd) for i in range(count)]


def outcome(monitor: Monitor) -> list[tuple[Verdict, Reason, str]]:
    decisions = [monitor.assess(state, state.stamp_ns) for state in states(monitor)]
    return [(d.verdict, d.reason_code, d.reason) for d in decisions if d is not None]


def test_urdf_without_parameters_states_its_masses_alone() -> None:
    assumptions = monitor_of().assumptions
    assert assumptions.assumed == tuple(code for code in Assumption if code is not Assumption.MASSES)
    assert not assumptions.accepted


def test_shipped_parameter_file_states_nothing_of_the_cell() -> None:
    settings = load_settings(MonitorSettings, share("config", "monitor.yaml"), "monitor")
    assert assumptions_of(load_robot(UR5), settings) == monitor_of().assumptions
    assert not monitor_of(**ALL_STATED).assumptions.assumed


@pytest.mark.parametrize("code", STATED)
def test_parameter_that_is_set_to_its_default_is_stated(code: Assumption) -> None:
    assert code not in monitor_of(**STATED[code]).assumptions.assumed
    others = {name: value for name, value in ALL_STATED.items() if name not in STATED[code]}
    assert monitor_of(**others).assumptions.assumed == (code,)


def test_load_without_its_centre_of_mass_is_not_stated() -> None:
    """It counts at the origin of the frame; 3 kg 0.2 m before the hand of a Panda allow up to 40 % less speed."""
    monitor = monitor_of(**ALL_STATED)
    for mass, com, is_stated in ((2.0, {}, False), (2.0, {"payload_com": (0.0, 0.0, 0.0)}, True), (0.0, {}, True)):
        assert (not monitor_of(**ALL_STATED | {"payload_mass": mass} | com).assumptions.assumed) is is_stated
    monitor.apply(MonitorSettings.model_validate({"robot": str(UR5), **ALL_STATED, "payload_mass": 2.0}))
    assert monitor.assumptions.assumed == (Assumption.PAYLOAD,)
    scara = load_robot()  # whose file states the payload
    assert Assumption.PAYLOAD not in assumptions_of(scara, MonitorSettings()).assumed
    assert Assumption.PAYLOAD in assumptions_of(scara, MonitorSettings(payload_mass=2.0)).assumed


@pytest.mark.parametrize("use_reference", [False, True])
@pytest.mark.parametrize("code", STATED)
def test_verdict_is_at_most_warn_while_a_permissive_assumption_is_not_stated(
    code: Assumption,
    use_reference: bool,  # noqa: FBT001 - a parameter
) -> None:
    others = {name: value for name, value in ALL_STATED.items() if name not in STATED[code]}
    verdicts = {*outcome(monitor_of(use_reference=use_reference, **others))}
    if code in CAUTIOUS:
        assert verdicts == {(Verdict.OK, Reason.NONE, "")}
    else:
        assert verdicts == {(Verdict.WARN, Reason.ASSUMED, RULES[code].text)}
    accepted = monitor_of(use_reference=use_reference, **others, accept_assumptions=(name_of(code),))
    assert {*outcome(accepted)} == {(Verdict.OK, Reason.NONE, "")}
    assert accepted.assumptions == Assumptions((), (code,))


def test_batches_give_the_verdicts_of_the_live_monitor() -> None:
    live, batch = monitor_of(), monitor_of()
    rows = states(live)
    stamps = np.array([state.stamp_ns for state in rows])
    q, qd = np.array([state.position for state in rows]), np.array([state.velocity for state in rows])
    pending = batch.admit(rows[0].names, stamps, stamps, q, qd)
    assert pending is not None
    batch.compute(pending)
    settled = batch.settle(pending)
    one_by_one = [live.assess_one(state, state.stamp_ns) for state in rows]
    assert settled.numbers.tobytes() == b"".join(a.numbers.tobytes() for a in one_by_one if a is not None)
    assert [d.reason_code for d in settled.decisions()] == [Reason.ASSUMED] * len(rows)


def test_assumption_leaves_worse_verdicts_and_their_reasons() -> None:
    monitor = monitor_of()
    (state, *_) = states(monitor)
    fast = state._replace(velocity=np.ones(6))
    decision = monitor.assess(fast, fast.stamp_ns)
    assert decision is not None
    assert (decision.verdict, decision.reason_code) == (Verdict.VIOLATION, Reason.TOO_FAST)


def test_decision_holds_the_codes_and_the_reason_names_the_others() -> None:
    monitor = monitor_of(accept_assumptions=("drives",))
    (state, *_) = states(monitor)
    decision = monitor.assess(state, state.stamp_ns)
    assert decision is not None
    assert decision.assumptions == monitor.assumptions.assumed
    assert decision.accepted_assumptions == (Assumption.DRIVES,)
    others = "rotor_inertia, contact_area, person_speed, contact_points, acceleration, contact_damping, "
    others += "contact_friction"
    assert decision.reason == f"{RULES[Assumption.PAYLOAD].text}; also assumed: {others}"
    assert ("drives", f"accepted: {RULES[Assumption.DRIVES].text}") in monitor.assumptions.lines
    assert set(monitor.assumptions.as_dict()["accepted"]) == {"drives"}


def test_verdict_follows_accepted_assumptions_of_a_running_monitor() -> None:
    monitor = monitor_of(release_time=0.0)
    first, second, *_ = states(monitor)
    assert monitor.assess(first, first.stamp_ns).verdict is Verdict.WARN  # type: ignore[union-attr]
    monitor.apply(monitor.settings.model_copy(update={"accept_assumptions": NAMES}))
    assert monitor.assess(second, second.stamp_ns).verdict is Verdict.OK  # type: ignore[union-attr]


def test_payload_topic_states_the_payload() -> None:
    monitor = monitor_of(payload_topic="payload")
    assert Assumption.PAYLOAD not in monitor.assumptions.assumed
    monitor.take_payload(Payload(2.0, (0.0, 0.0, 0.1), (0.0,) * 6))
    assert Assumption.PAYLOAD not in monitor.assumptions.assumed
    assert Assumption.PAYLOAD in monitor_of(payload_topic="").assumptions.assumed


def test_shipped_robot_states_all() -> None:
    assert assumptions_of(load_robot(), MonitorSettings()) == Assumptions()


def test_dh_file_states_its_payload_and_the_defaults_that_hold(
    scara_variant: Callable[[Callable[[dict[str, Any]], object]], RobotDynamics],
) -> None:
    def strip(file: dict[str, Any]) -> None:
        del file["payload"], file["defaults_hold"]

    robot = scara_variant(strip).robot
    stated = {Assumption.CONTACT_POINTS, Assumption.MASSES}
    assert assumptions_of(robot, MonitorSettings()).assumed == tuple(c for c in Assumption if c not in stated)
    robot = scara_variant(lambda file: file.update(defaults_hold=["drives"], payload={"mass": 0.0})).robot
    stated |= {Assumption.PAYLOAD, Assumption.DRIVES}
    assert assumptions_of(robot, MonitorSettings()).assumed == tuple(c for c in Assumption if c not in stated)


def test_placeholders_leave_the_masses_assumed(
    scara_variant: Callable[[Callable[[dict[str, Any]], object]], RobotDynamics],
) -> None:
    def at_origins(file: dict[str, Any]) -> None:
        for link in file["links"]:
            link["com"] = [0.0, 0.0, 0.0]

    robot = scara_variant(at_origins).robot
    assert mass_source(robot) == "every centre of mass lies at its link's origin: placeholders, not data"
    assumptions = assumptions_of(robot, MonitorSettings())
    assert assumptions.assumed == assumptions.limiting == (Assumption.MASSES,)


def test_scara_needs_no_inertia_tensors(bare_scara: RobotDynamics) -> None:
    assert not assumptions_of(bare_scara.robot, MonitorSettings()).assumed


def test_unknown_name_is_refused_in_one_line() -> None:
    with pytest.raises(SettingsError, match=r"accept_assumptions = .*'drive': must be drives"):
        checked(MonitorSettings, {"accept_assumptions": ("drive",)}, "options")


def test_each_assumption_has_a_row() -> None:
    assert list(RULES) == list(Assumption)
    for rule in RULES.values():
        assert {*rule.parameters} <= MonitorSettings.model_fields.keys()

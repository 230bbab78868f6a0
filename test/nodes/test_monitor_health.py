# SPDX-License-Identifier: Apache-2.0
"""Diagnostic status of the monitor's robot model."""

from collections.abc import Mapping

import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from scara_effmass.codes import Reason
from scara_effmass.model.load import load_robot
from scara_effmass.nodes.monitor_health import contact_status, model_status, worst_contacts
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Cause, Monitor, unknown_assessments, unknown_contact
from scara_effmass.safety.second_channel import ReferenceChannel
from scara_effmass.settings import MassModel, MonitorSettings
from scara_effmass.share import share
from scara_effmass.values import Decision, Verdict
from test.decisions import decision_on

DISAGREES = "the compiled kernel disagrees with the reference in speed"


def status_of(settings: MonitorSettings) -> tuple[DiagnosticStatus, Mapping[str, str]]:
    monitor = Monitor(RobotDynamics(load_robot(settings=settings)), settings)
    status = model_status(monitor)
    return status, {pair.key: pair.value for pair in status.values}


def test_unknown_is_an_error() -> None:
    decision = unknown_assessments(Reason.STATED, "no robot_description yet").decision(0)
    assert contact_status(decision.worst, 0, 0.0).level == DiagnosticStatus.ERROR


def test_numbers_of_an_unknown_contact_are_unknown() -> None:
    values = {pair.key: pair.value for pair in contact_status(unknown_contact("tool", ""), 0, 0.0).values}
    assert (values["speed [m/s]"], values["margin [m/s]"], values["effective mass [kg]"]) == ("unknown",) * 3
    assert float(values["allowable speed [m/s]"]) == 0.0


def test_joints_without_rotor_inertia_are_a_warning() -> None:
    status, values = status_of(MonitorSettings())
    assert status.level == DiagnosticStatus.WARN
    assert status.message.startswith("no rotor inertia for joint1, joint2, joint3, joint4: ")
    assert status.message in values["notes"]


def test_stated_rotor_inertia_gives_no_warning() -> None:
    status, values = status_of(MonitorSettings(armature=("joint1=0.3", "joint2=0", "joint3=0", "joint4=0")))
    assert status.level == DiagnosticStatus.OK
    assert "rotor inertia from the setting armature: joint1 0.3, joint2 0" in values["notes"]


def test_kernel_that_disagreed_is_a_warning_and_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    settings = MonitorSettings()
    monitor = Monitor(RobotDynamics(load_robot(settings=settings)), settings)
    for field, fault, core, count in (
        ("", "", "compiled kernel", "0"),
        ("speed", DISAGREES, f"reference: {DISAGREES}", "1"),
    ):
        monkeypatch.setattr(ReferenceChannel, "difference", lambda *_, field=field: field)
        monitor.compile()
        status = model_status(monitor)
        values = {pair.key: pair.value for pair in status.values}
        assert values["core"] == core
        assert values["kernel disagreements"] == count
        assert status.message.startswith(fault)
        assert status.level == DiagnosticStatus.WARN


def decision(*verdicts: tuple[str, Verdict]) -> Decision:
    return decision_on(*(unknown_contact(name, f"of {name}")._replace(verdict=verdict) for name, verdict in verdicts))


def test_first_cause_names_its_contact_point() -> None:
    monitor = Monitor(RobotDynamics(load_robot()), MonitorSettings())
    monitor.first_cause = Cause(1_500_000_000, "elbow", Verdict.VIOLATION, "too fast")
    status = model_status(monitor)
    values = {pair.key: pair.value for pair in status.values}
    assert values["first cause"] == "VIOLATION at 1.500000 s: elbow: too fast"


def test_each_contact_point_reports_its_own_worst_since_the_last_report() -> None:
    changes = [
        decision(("elbow", Verdict.VIOLATION), ("tool", Verdict.OK), ("rim", Verdict.WARN)),
        decision(("elbow", Verdict.OK), ("tool", Verdict.UNKNOWN), ("rim", Verdict.OK)),
        decision(("elbow", Verdict.OK), ("tool", Verdict.WARN), ("rim", Verdict.OK)),
    ]
    latest = decision(("elbow", Verdict.OK), ("tool", Verdict.OK), ("rim", Verdict.VIOLATION))
    worst = worst_contacts(latest, changes)
    assert {contact.contact_point: contact.verdict.name for contact in worst} == {
        "elbow": "VIOLATION",
        "tool": "UNKNOWN",
        "rim": "VIOLATION",
    }
    statuses = [contact_status(contact, 0, 0.0) for contact in worst]
    assert [status.name for status in statuses] == ["contact elbow", "contact tool", "contact rim"]
    assert {status.level for status in statuses} == {DiagnosticStatus.ERROR}


def test_missing_lumped_model_is_a_warning_only_where_it_decides() -> None:
    panda = MonitorSettings(robot=str(share("config", "robots", "panda.urdf")), armature=("menagerie/panda",))
    for model, level in (("auto", DiagnosticStatus.OK), ("lumped", DiagnosticStatus.WARN)):
        status, values = status_of(panda.model_copy(update={"effective_mass_model": MassModel(model)}))
        assert status.level == level, status.message
        assert values["lumped mass"].startswith(
            "link behind panda_joint1: its centre of mass lies 3.9 mm off the plane"
        )

# SPDX-License-Identifier: Apache-2.0
"""The live validator: the same as offline, and what it says of itself."""

import json
import math
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcl_interfaces.msg import Log
from rclpy.qos import DurabilityPolicy, QoSProfile
from scara_effmass_msgs.msg import ContactStates, ForceBlock, Impact, ImpactValidation, RunInfo
from std_srvs.srv import Trigger

from scara_effmass.impacts.validator import Validator
from scara_effmass.nodes.validator_node import ValidatorNode
from scara_effmass.safety import unknown_contact
from scara_effmass.settings import ValidatorSettings
from scara_effmass.values import Decision, Verdict
from scara_effmass.values import Impact as ImpactValue
from scara_effmass.values import RunInfo as RunInfoValue
from scara_effmass.wire.contact_states import ContactStatesEncoder
from scara_effmass.wire.force import force_block_message, impact_message
from scara_effmass.wire.run_info import run_info_message
from test.daq.force_bag import force_block
from test.decisions import assessments_of, decision_on
from test.nodes.conftest import NodeHarness

EXECUTABLE = Path(sys.executable).with_name("validator_node")
DEEP = QoSProfile(depth=20_000)
LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
S, MS = 1_000_000_000, 1_000_000
START_NS = 1_800_000_000 * S
PEAKS = (200.0, 290.0, 331.0, 302.0)


def decision(number: int) -> Decision:
    """Return a decision each millisecond, its mass and speed slowly changing."""
    mass = 1.0 + number * 1e-4
    contact = unknown_contact("tool", "")._replace(
        verdict=Verdict.OK,
        direction=(1.0, 0.0, 0.0),
        speed=0.25 + number * 1e-6,
        effective_mass=mass,
        lumped_mass=mass,
        full_mass=0.97 * mass,
        iso_mass=2.77,
        allowable_speed=1.0,
    )
    return decision_on(contact, stamp_ns=START_NS + number * MS)


def impact(number: int, peak: float) -> ImpactValue:
    stamp_ns = START_NS + (number * 1000 + 500) * MS + 300_000
    return ImpactValue(
        stamp_ns, "cell", peak, 2e-3, 0.3, 0.0, *(False, False, 0, 0.0, 0.1, 1e-4, "test", True), 1e-3 * peak
    )


class ValidatorHarness:
    """Publishes the inputs of a validator node and receives its results."""

    def __init__(self, harness: NodeHarness) -> None:
        self.harness = harness
        self.received: list[ImpactValidation] = []
        node = harness.node
        # Before the diagnostics, of which a test waits for one: the validator has found this one too by then.
        node.create_subscription(ImpactValidation, "impact_validation", self.received.append, DEEP)
        harness.subscribe()
        self.states = node.create_publisher(ContactStates, "contact_states", DEEP)
        self.impacts = node.create_publisher(Impact, "impact", DEEP)
        self.force = node.create_publisher(ForceBlock, "force", DEEP)
        self.run_info = node.create_publisher(RunInfo, "run_info", LATCHED)
        ends = (self.states, self.impacts, self.force, self.run_info)
        harness.spin_until(
            lambda: all(end.get_subscription_count() for end in ends) and node.count_publishers("impact_validation")
        )

    def state_run(self, mass: float, *infos: bytes | RunInfoValue) -> None:
        """Publish run information, and wait until the obstacle mass is `mass` [kg]."""
        for info in infos:
            self.run_info.publish(info if isinstance(info, bytes) else run_info_message(info))
        self.harness.diagnostic("validator: series", "obstacle mass [kg]", f"{mass:g}".__eq__)

    def run(self, *masses: float, first: int = 0) -> None:
        """Let the robot hit something of each mass, told before unless it is 0."""
        infos = [
            RunInfoValue(obstacle_mass=mass, stamp_ns=START_NS + n * S) for n, mass in enumerate(masses, first) if mass
        ]
        if infos:
            self.state_run(masses[-1], *infos)
        encoder = ContactStatesEncoder("base_link")
        for number in range(first, first + len(masses)):
            for millisecond in range(number * 1000 + 400, number * 1000 + 600):
                self.states.publish(encoder.encode(assessments_of(decision(millisecond))))
            self.impacts.publish(impact_message(impact(number, PEAKS[number % len(PEAKS)])))


@pytest.fixture
def node(new_harness: Callable[..., NodeHarness], tmp_path: Path) -> ValidatorHarness:
    harness = new_harness(name="validator")
    # What is sent is of another time than the node's, all of it alike. An impact that DDS loses in the burst comes
    # again after up to 3 s, later than its contact states.
    words = ["-p", "criterion.least_count:=2", "-p", f"report_folder:={tmp_path}"]
    words += ["-p", "clock_tolerance:=60.0", "-p", "impact_delay:=60.0"]
    harness.start("--ros-args", *words, command=[str(EXECUTABLE)])
    return ValidatorHarness(harness)


def plain(value: Any) -> Any:  # noqa: ANN401 - any field
    """Return lists and arrays as tuples, NaN as text: it equals nothing."""
    if isinstance(value, tuple | list | np.ndarray):
        return tuple(map(plain, map(float, value)))
    return "NaN" if isinstance(value, float) and math.isnan(value) else value


def test_what_it_publishes_is_what_the_core_gives_offline(node: ValidatorHarness) -> None:
    masses = (0.5, 2.39, 3.72, 7.35)
    logs: list[Log] = []
    node.harness.node.create_subscription(Log, "/rosout", logs.append, LATCHED)
    node.run(*masses)
    node.harness.spin_until(lambda: len(node.received) == 4)
    validator = Validator(ValidatorSettings.model_validate({"criterion": {"least_count": 2}}))
    expected = []
    for number, (mass, peak) in enumerate(zip(masses, PEAKS, strict=True)):
        validator.runs.set(START_NS + number * S, obstacle_mass=mass)
        for millisecond in range(number * 1000 + 400, number * 1000 + 600):
            expected += validator.add_decision(decision(millisecond), 0)
        expected += validator.add_impact(impact(number, peak), 0)
    assert len(expected) == 4
    names = set(ImpactValidation.get_fields_and_field_types()) - {"header", "series"}
    for message, validated in zip(node.received, expected, strict=True):
        assert message.header.stamp.sec * S + message.header.stamp.nanosec == validated.stamp_ns
        assert {name: plain(getattr(message, name)) for name in names} == {
            name: plain(getattr(validated, name)) for name in names
        }
        for name in message.series.get_fields_and_field_types():
            assert plain(getattr(message.series, name)) == plain(getattr(validated.series, name))
        line = f"simulated impact: peak {validated.measured_force:.1f} N, predicted {validated.predicted_force:.1f} N"
        limit = f" N on {validated.body_region}, {'ABOVE' if validated.exceeds_limit else 'below'} its limit of "
        node.harness.spin_until(lambda: any(line in log.msg and limit in log.msg for log in logs))  # noqa: B023


def test_without_a_mass_an_impact_is_counted_and_not_predicted(node: ValidatorHarness) -> None:
    node.run(0.0, 0.0, 0.0, 0.0)
    report = node.harness.diagnostic("validator: series", "not paired: obstacle_mass is not given", "4".__eq__)
    assert report.startswith("left out of the series and above a limit: ")  # as measured
    assert "; 4 impacts could not be paired" in report
    node.harness.diagnostic("validator: series", "correlation", lambda value: not value.startswith("0."))
    assert not node.received
    assert node.harness.set_parameters(obstacle_mass=-1.0)
    assert node.harness.set_parameters(obstacle_mass=2.39) == ""


def test_malformed_run_information_makes_the_obstacle_mass_unknown(node: ValidatorHarness) -> None:
    malformed: list[bytes | RunInfoValue] = [
        b"\x00\x01\x00\x00 too short",
        RunInfoValue(obstacle_mass=math.nan),
        RunInfoValue(obstacle_mass=2.39, configuration="a\nb"),
    ]
    assert node.harness.set_parameters(obstacle_mass=2.39) == ""
    node.run(0.0)
    node.harness.spin_until(lambda: len(node.received) == 1)
    for number, info in enumerate(malformed, start=1):
        node.state_run(0.0, info)
        node.run(0.0, first=2 * number - 1)
        not_paired = "not paired: obstacle_mass is not given"
        assert node.harness.diagnostic("validator: series", not_paired, f"{number}".__eq__).endswith(f"| {number}")
        node.state_run(0.5, RunInfoValue(obstacle_mass=0.5))
        node.run(0.0, first=2 * number)
        node.harness.spin_until(lambda: len(node.received) == number + 1)  # noqa: B023


def test_second_publisher_of_run_information_makes_the_obstacle_mass_unknown(node: ValidatorHarness) -> None:
    node.state_run(2.39, RunInfoValue(obstacle_mass=2.39, stamp_ns=1))
    second = node.harness.node.create_publisher(RunInfo, "run_info", LATCHED)
    second.publish(run_info_message(RunInfoValue(obstacle_mass=7.35)))
    node.state_run(0.0)
    node.run(0.0)
    node.harness.diagnostic("validator: series", "not paired: obstacle_mass is not given", "1".__eq__)
    node.harness.node.destroy_publisher(second)
    node.state_run(2.39)  # the latched one of the publisher that is left
    node.run(0.0, first=1)
    node.harness.spin_until(lambda: len(node.received) == 1)
    mass = node.received[0].effective_mass
    assert node.received[0].reduced_mass == pytest.approx(mass * 2.39 / (mass + 2.39))


def test_run_information_without_a_mass_leaves_that_of_the_parameter(node: ValidatorHarness) -> None:
    assert node.harness.set_parameters(obstacle_mass=2.39) == ""
    node.state_run(0.5, RunInfoValue(obstacle_mass=0.5))
    node.state_run(2.39, RunInfoValue(configuration="near"))


def test_configuration_parameter_leaves_the_stated_mass(node: ValidatorHarness) -> None:
    node.state_run(0.5, RunInfoValue(obstacle_mass=0.5))
    assert node.harness.set_parameters(configuration="elbow up") == ""
    node.run(0.0)
    node.harness.spin_until(lambda: len(node.received) == 1)
    mass = node.received[0].effective_mass
    assert node.received[0].reduced_mass == pytest.approx(mass * 0.5 / (mass + 0.5))


def test_write_report_service_writes_the_report(node: ValidatorHarness) -> None:
    node.run(0.5, 2.39, 3.72, 7.35)
    node.harness.spin_until(lambda: len(node.received) == 4)
    answer: Any = node.harness.call_service(Trigger, "write_report", Trigger.Request())
    assert answer.success, answer.message
    page = Path(answer.message)
    assert page.is_absolute()
    assert page.name == "report.html"
    record = json.loads(page.with_name("report.json").read_text(encoding="utf-8"))
    assert record["models"][0]["count"] == 4
    assert record["models"][0]["correlation"] == node.received[-1].series.correlation


def test_reports_in_simulated_time_that_stands_still_are_all_written(node: ValidatorHarness) -> None:
    assert node.harness.set_parameters(use_sim_time=True) == ""
    answers: list[Any] = [node.harness.call_service(Trigger, "write_report", Trigger.Request()) for _ in range(2)]
    assert [answer.success for answer in answers] == [True, True], answers
    assert len({answer.message for answer in answers}) == 2


def test_second_validator_on_the_same_topic_is_a_warning(node: ValidatorHarness) -> None:
    second = node.harness.node.create_publisher(ImpactValidation, "impact_validation", DEEP)
    warning = "2 publishers of /impact_validation: must be one"
    node.harness.spin_until(lambda: any(warning in s.message for d in node.harness.diagnostics for s in d.status))
    node.harness.node.destroy_publisher(second)


def test_folder_that_the_file_system_refuses_does_not_end_the_node(new_harness: Callable[..., NodeHarness]) -> None:
    harness = new_harness(name="validator")
    harness.start("--ros-args", "-p", f"report_folder:={300 * 'x'}", command=[str(EXECUTABLE)])
    for _ in range(2):
        answer: Any = harness.call_service(Trigger, "write_report", Trigger.Request())
        assert not answer.success
        assert "File name too long" in answer.message


def test_reset_begins_a_new_series(node: ValidatorHarness) -> None:
    node.run(0.5, 2.39, 3.72, 7.35)
    node.harness.spin_until(lambda: len(node.received) == 4)
    answer: Any = node.harness.call_service(Trigger, "reset", Trigger.Request())
    assert answer.success
    assert answer.message == "new series started; the previous one had 4 impacts"
    node.harness.diagnostic("validator: series", "impacts seen", lambda value: value == "0")


def test_undecodable_messages_are_counted_by_type_until_a_reset(node: ValidatorHarness) -> None:
    for number in range(1, 4):
        node.impacts.publish(impact_message(impact(0, 1e300 * number)))
    report = node.harness.diagnostic("validator: series", "undecodable: Impact", "3".__eq__)
    assert report.count("peak_force") == 1
    assert node.harness.call_service(Trigger, "reset", Trigger.Request()).success
    assert "peak_force" not in node.harness.diagnostic("validator: series", "undecodable messages", "0".__eq__)


def test_force_of_an_open_sensor_is_not_known(node: ValidatorHarness) -> None:
    marks = np.arange(100, dtype=np.uint32)
    for first in (0, 100, 200, 500):
        block = force_block(first, force=np.zeros(100), saturated_samples=marks if first else marks[:0])
        node.force.publish(force_block_message(block))
    report = node.harness.diagnostic("validator: series", "contacts of unknown force", "1".__eq__)
    assert "1 contacts clipped, incomplete, stuck or without signal: their force is not known" in report
    assert node.harness.call_service(Trigger, "reset", Trigger.Request()).success
    node.harness.diagnostic("validator: series", "contacts of unknown force", "0".__eq__)


def test_impact_without_a_monitor_is_decided_after_its_wait(new_harness: Callable[..., NodeHarness]) -> None:
    harness = new_harness(name="validator")
    harness.start("--ros-args", command=[str(EXECUTABLE)])
    node = ValidatorHarness(harness)
    node.impacts.publish(impact_message(impact(0, 300.0)))
    report = harness.diagnostic("validator: series", "not paired: no contact state", "1".__eq__)
    assert "1 impact could not be paired: no contact state; no contact states" in report


@pytest.mark.parametrize(
    ("argument", "line"),
    [
        ("obstacle_mass:=-1.0", "validator: obstacle_mass = -1.0: must be greater than or equal to 0"),
        ("nonsense:=1", "validator: no parameter 'nonsense': must be contact_point,"),
        (
            "criterion.least_count:=1",
            "validator: criterion.least_count = 1: must be greater than or equal to 2",
        ),
        ("effective_mass_model:=none", "validator: effective_mass_model = 'none': must be 'lumped', "),
    ],
)
def test_invalid_parameter_is_refused(refusal_of: Callable[..., str], argument: str, line: str) -> None:
    assert refusal_of(ValidatorNode, argument).startswith(line)


def test_sigint_ends_with_status_0(node: ValidatorHarness) -> None:
    process = node.harness.process
    assert process is not None
    process.send_signal(signal.SIGINT)
    output, errors = process.communicate()
    assert process.returncode == 0
    assert "Traceback" not in output + errors


def test_second_monitor_is_a_warning(node: ValidatorHarness) -> None:
    other = node.harness.node.create_publisher(ContactStates, "contact_states", DEEP)
    node.harness.spin_until(
        lambda: any(
            status.message.startswith("2 publishers of /contact_states: must be one")
            for array in node.harness.diagnostics
            for status in array.status
        )
    )
    node.harness.node.destroy_publisher(other)

# SPDX-License-Identifier: Apache-2.0
"""No permissive value outlives its reason: end of the monitor, busy callbacks, latch, QoS and start-up refusals."""

import signal
import sys
import time
from collections.abc import Callable
from functools import partial

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from rcl_interfaces.msg import Log
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile
from scara_effmass_msgs.msg import ContactState
from std_msgs.msg import String
from std_srvs.srv import Trigger

from scara_effmass.codes import Assumption
from test.nodes.conftest import JOINTS, TIMEOUT_S, Answer, NodeHarness, Q, joint_state, stamp_ns

S = 1_000_000_000
STILL = (0.0,) * 4
PATIENT = ("--ros-args", "-p", "timeout:=60.0", "-p", "release_time:=0.0")
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
ONE_LINK = """<robot name="one_link"><link name="base"/>
  <link name="arm"><inertial><origin xyz="0.3 0 0"/><mass value="2.0"/>
    <inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="tip"/>
  <joint name="hinge" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" velocity="3" effort="9"/></joint>
  <joint name="flange" type="fixed"><parent link="arm"/><child link="tip"/><origin xyz="0.5 0 0"/></joint></robot>"""


def _first(received: list[DiagnosticArray]) -> DiagnosticArray | None:
    return received[0] if received else None


def answer(harness: NodeHarness, verdict: int, **fields: object) -> Answer:
    """Send joint states until one gets `verdict`; return its contact state."""
    harness.contact_states.clear()

    def send() -> None:
        harness.send(joint_state(**{"velocity": STILL, **fields}))  # type: ignore[arg-type]

    def answered() -> Answer | None:
        return next((c for c in harness.contact_states if c.verdict == verdict and not c.watchdog), None)

    contact: Answer = harness.spin_until(answered, repeat=send)
    harness.spin_until(lambda: harness.scalars["speed_scaling"])
    return contact


END = {
    "deactivate": [Transition.TRANSITION_DEACTIVATE],
    "cleanup": [Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP],
    "shutdown": [Transition.TRANSITION_ACTIVE_SHUTDOWN],
    "SIGINT": signal.SIGINT,
    "SIGTERM": signal.SIGTERM,
    "SIGHUP": signal.SIGHUP,
    "SIGQUIT": signal.SIGQUIT,
    "SIGUSR1": signal.SIGUSR1,
}


@pytest.mark.parametrize("end", END.values(), ids=END.keys())
def test_last_message_before_the_end_is_unknown(
    new_harness: Callable[..., NodeHarness], end: list[int] | signal.Signals
) -> None:
    harness = new_harness(*PATIENT)
    harness.subscribe()
    contact = answer(harness, ContactState.OK)
    assert contact.allowable_speed > 0.0
    if isinstance(end, list):
        assert harness.change_state(*end)
    else:
        harness.process_may_end = True
        assert harness.process is not None
        harness.process.send_signal(end)
        harness.process.send_signal(end)
    harness.spin_until(
        lambda: (
            harness.contact_states[-1].verdict == ContactState.UNKNOWN
            and not any(values[-1] for values in harness.scalars.values())
        )
    )
    last = harness.contact_states[-1]
    assert last.reason == ("the monitor was deactivated" if isinstance(end, list) else "the node shuts down")
    assert (last.contact_point, last.watchdog, last.allowable_speed) == (contact.contact_point, True, 0.0)
    assert stamp_ns(last) >= stamp_ns(contact)
    if not isinstance(end, list):
        assert harness.process is not None
        assert harness.process.wait(TIMEOUT_S) == 0


SLOW_ACKNOWLEDGEMENT = """
import time
from rclpy.publisher import Publisher
from scara_effmass.nodes import monitor_node
wait_for_all_acked = Publisher.wait_for_all_acked
def slowly(publisher, timeout):
    print(publisher.topic_name, flush=True)
    time.sleep(1.0)
    return wait_for_all_acked(publisher, timeout)
Publisher.wait_for_all_acked = slowly
raise SystemExit(monitor_node.main())
"""


def test_nothing_follows_the_last_message_and_a_second_signal_changes_nothing(
    new_harness: Callable[..., NodeHarness],
) -> None:
    harness = new_harness()
    process = harness.start(*PATIENT, command=(sys.executable, "-c", SLOW_ACKNOWLEDGEMENT))
    harness.subscribe()
    answer(harness, ContactState.OK)
    harness.process_may_end = True

    def send() -> None:
        harness.send(joint_state(velocity=STILL))

    process.send_signal(signal.SIGTERM)
    harness.spin_until(lambda: harness.contact_states[-1].verdict == ContactState.UNKNOWN, repeat=send)
    process.send_signal(signal.SIGTERM)
    harness.spin_until(lambda: process.poll() is not None, repeat=send)
    harness.spin_until(lambda: not harness.node.count_publishers("contact_states"))
    assert process.returncode == 0
    assert process.stdout is not None
    assert process.stdout.read().split() == ["/contact_states", "/allowable_speed", "/speed_scaling"]
    assert harness.contact_states[-1].reason == "the node shuts down"
    verdicts = [c.verdict for c in harness.contact_states]
    from_ok = verdicts[verdicts.index(ContactState.OK) :]
    assert from_ok == [*[ContactState.OK] * (len(from_ok) - 1), ContactState.UNKNOWN]
    assert [received[-1] for received in harness.scalars.values()] == [0.0, 0.0]


def test_deactivation_leaves_latch_and_debounce_alone(new_harness: Callable[..., NodeHarness]) -> None:
    harness = new_harness(*PATIENT, "-p", "latch:=true")
    harness.subscribe()
    answer(harness, ContactState.OK)
    assert harness.change_state(Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_ACTIVATE)
    harness.spin_until(lambda: harness.contact_states[-1].watchdog)
    answer(harness, ContactState.OK)
    assert {c.verdict for c in harness.contact_states} == {ContactState.OK}


def test_names_of_diagnostics_differ_between_cells(new_harness: Callable[..., NodeHarness]) -> None:
    names = []
    for cell in ("/cell1", "/cell2"):
        harness = new_harness(namespace=cell)
        harness.start("--ros-args", "-r", f"__ns:={cell}")
        harness.subscribe()
        array = harness.spin_until(partial(_first, harness.diagnostics))
        names += [status.name for status in array.status]
        assert all(status.name.startswith(f"{cell}/monitor: ") for status in array.status)
        assert all(status.hardware_id == "omron_i4_550l" for status in array.status)
    assert len(set(names)) == len(names)


BUSY = """
import time
from scara_effmass.nodes import monitor_node
class SlowMonitor(monitor_node.Monitor):
    def assess_one(self, state, *arguments):
        decision = super().assess_one(state, *arguments)
        if "slow" in state.names:
            time.sleep(6.0)
        return decision
monitor_node.Monitor = SlowMonitor
raise SystemExit(monitor_node.main())
"""


def test_watchdog_speaks_while_a_callback_takes_long(
    new_harness: Callable[..., NodeHarness],
) -> None:
    harness = new_harness()
    harness.start("--ros-args", "-p", "timeout:=1.0", "-p", "release_time:=0.0", command=(sys.executable, "-c", BUSY))
    harness.subscribe()
    answer(harness, ContactState.OK)
    sent_s = time.monotonic()
    slow = joint_state(names=(*JOINTS, "slow"), position=(*Q, 0.0), velocity=(*STILL, 0.0))
    harness.send(slow)
    harness.spin_until(lambda: any(c.reason.startswith("the assessment of") for c in harness.contact_states))
    assert time.monotonic() - sent_s < 5.0  # of the 6 s that the assessment takes
    harness.spin_until(lambda: not any(values[-1] for values in harness.scalars.values()))
    # The late answer is no OK either.
    late = harness.spin_until(lambda: [c for c in harness.contact_states if stamp_ns(c) == stamp_ns(slow)])[0]
    assert late.verdict == ContactState.UNKNOWN
    assert late.reason.startswith("the assessment took ")


def test_latch_survives_a_new_robot_and_cleanup_and_ends_by_reset(new_harness: Callable[..., NodeHarness]) -> None:
    accepted = "accept_assumptions:=[" + ", ".join(assumption.name.lower() for assumption in Assumption) + "]"
    options = ("latch:=true", "await_robot_description:=true", "effective_mass_model:=full", accepted)
    harness = new_harness(*PATIENT, *(word for option in options for word in ("-p", option)))
    harness.subscribe()
    descriptions = harness.node.create_publisher(String, "robot_description", LATCHED)
    valid = {"names": ("hinge",), "position": (0.3,), "velocity": (0.0,)}

    def latched_answer() -> str:
        return str(answer(harness, ContactState.UNKNOWN, **valid).reason)

    descriptions.publish(String(data=ONE_LINK))
    answer(harness, ContactState.OK, **valid)
    descriptions.publish(String(data="<robot>"))
    assert latched_answer().startswith("robot_description: ")
    descriptions.publish(String(data=ONE_LINK))
    harness.spin_until(lambda: latched_answer().startswith("latched until reset: tip: robot_description: "))
    assert harness.change_state(Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP)
    assert harness.change_state(Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE)
    harness.spin_until(lambda: latched_answer().startswith("latched until reset: tip: robot_description: "))
    response = harness.call_service(Trigger, "reset", Trigger.Request())
    assert response.message.startswith("cleared: UNKNOWN: tip: robot_description: ")
    answer(harness, ContactState.OK, **valid)
    # A reset without a robot clears what the next one would take over.
    descriptions.publish(String(data="<robot>"))
    assert latched_answer().startswith("robot_description: ")
    assert harness.call_service(Trigger, "reset", Trigger.Request()).message.startswith("cleared: UNKNOWN: ")
    descriptions.publish(String(data=ONE_LINK))
    answer(harness, ContactState.OK, **valid)


def test_deadline_lifespan_and_lease_are_offered_and_can_be_overridden(new_harness: Callable[..., NodeHarness]) -> None:
    """They follow `timeout` each time the node is configured."""
    override = "qos_overrides./allowable_speed.publisher.deadline:=700000000"
    harness = new_harness("--ros-args", "-p", "timeout:=0.3", "-p", override)
    publishers, offered = harness.node.get_publishers_info_by_topic, dict[str, tuple[int, int]]()
    for lease_ns in (600_000_000, 2 * S):
        if lease_ns == 2 * S:
            assert harness.change_state(Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP)
            harness.spin_until(lambda: not any(map(publishers, offered)))  # noqa: B023 - called at once
            assert harness.set_parameters(timeout=1.0) == ""
            assert harness.change_state(Transition.TRANSITION_CONFIGURE)
        offered = {}
        for topic in ("contact_states", "allowable_speed", "speed_scaling"):
            (info,) = harness.spin_until(partial(publishers, topic))
            qos = info.qos_profile
            assert qos.liveliness == LivelinessPolicy.AUTOMATIC
            assert qos.liveliness_lease_duration.nanoseconds == lease_ns
            offered[topic] = (qos.deadline.nanoseconds, min(qos.lifespan.nanoseconds, 10 * S))
        assert offered == {
            "contact_states": (lease_ns, 10 * S),
            "allowable_speed": (700_000_000, 2 * S),
            "speed_scaling": (lease_ns, 2 * S),
        }


@pytest.mark.parametrize("option", ["await_robot_description:=true", "timeout:=0.2"])
def test_states_without_input_have_a_stamp(new_harness: Callable[..., NodeHarness], option: str) -> None:
    harness = new_harness("--ros-args", "-p", option)
    harness.subscribe()
    started_ns = time.time_ns()
    harness.spin_until(lambda: len(harness.contact_states) > 20)
    assert {c.verdict for c in harness.contact_states} == {ContactState.UNKNOWN}
    assert min(map(stamp_ns, harness.contact_states)) >= started_ns


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ("-p timeout:=-1.0", "monitor: timeout = -1.0: "),
        ("-p robot:=missing.yaml", "missing.yaml: cannot be read"),
        ("--no-such-option", "ROS arguments: "),
    ],
)
def test_refusal_to_start_reaches_rosout(new_harness: Callable[..., NodeHarness], arguments: str, text: str) -> None:
    harness = new_harness()
    logs: list[Log] = []
    harness.node.create_subscription(Log, "/rosout", logs.append, QoSProfile(depth=100))
    harness.process_may_end = True
    # The refusal waits 2 s for a subscriber, which a busy machine may not discover in time: start again.
    for _ in range(5):
        process = harness.start("--ros-args", *arguments.split())
        process.communicate(timeout=TIMEOUT_S)
        ended = time.monotonic()
        harness.spin_until(lambda: logs or time.monotonic() > ended + 1.0)  # noqa: B023 - called at once
        if logs:
            break
    log = next(log for log in logs if log.level == Log.FATAL)
    assert log.name == "monitor"
    assert log.msg.startswith(text)
    assert process.returncode == 2

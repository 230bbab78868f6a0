"""Assess every joint state of a recording; its log time replaces the clock of the live node."""

import math
from collections.abc import Iterator
from typing import NamedTuple

from scara_effmass.bags.bag import Bag
from scara_effmass.bags.run_info import first_run_info
from scara_effmass.errors import BagError
from scara_effmass.safety import Monitor
from scara_effmass.values import Decision, JointState
from scara_effmass.wire.message_types import INERTIA
from scara_effmass.wire.payload import decode_payload

_NO_PAYLOAD = (math.inf, "")


class AssessedState(NamedTuple):
    """One recorded joint state and its decision.

    `state` is None for an undecodable message, `decision` for a joint state without a joint of the robot.
    """

    log_time_ns: int
    state: JointState | None
    decision: Decision | None


def joint_state_topic(bag: Bag, requested: str | None) -> str:
    """Return the topic to assess: the requested one, else `joint_states`, else the only one with joint states.

    Raises BagError, which lists the candidates, if no topic or several topics match.
    """
    topics = bag.joint_state_topics
    if requested is not None:
        names = [requested]
    elif "/joint_states" in topics:
        names = ["/joint_states"]
    else:
        names = list(topics)
    # ROS 1 recorders omit the leading slash, and so do users.
    matches = [topic for topic in topics if topic.lstrip("/") in {name.lstrip("/") for name in names}]
    if len(matches) == 1:
        return matches[0]
    if not topics:
        raise BagError(f"{bag.path}: no topic holds joint states (sensor_msgs/JointState)")
    problem = "several topics hold joint states" if requested is None else f"no joint states on {requested}"
    raise BagError(f"{bag.path}: {problem}; --topic must be one of {', '.join(topics)}")


def assess_joint_states(bag: Bag, topic: str, monitor: Monitor) -> Iterator[AssessedState]:
    """Yield the decision of `monitor` for each joint state on `topic`, decoded as the live node decodes it.

    An undecodable message gives UNKNOWN and debounces the following verdicts, as in the live node. Payloads that were
    recorded on the `payload_topic` of the settings count from their log times on.
    Raises BagError, at the end also if no joint state names a joint of the robot.
    """
    count = 0
    loads = payload_topics(bag, monitor.settings.payload_topic)
    messages = bag.messages(loads) if loads else iter(())
    payloads = ((message.log_time_ns, decode_payload(message.data)) for message in messages)
    payload_ns, payload = next(payloads, _NO_PAYLOAD)
    for block in bag.joint_state_blocks(topic):
        for log_time_ns, reason in block.decode_failures:
            count += 1
            yield AssessedState(log_time_ns, None, monitor.reject(reason))
        for log_time_ns, state in zip(block.log_time_ns.tolist(), block.states(), strict=True):
            count += 1
            while payload_ns <= log_time_ns:
                monitor.take_payload(payload)
                payload_ns, payload = next(payloads, _NO_PAYLOAD)
            yield AssessedState(log_time_ns, state, monitor.assess(state, log_time_ns))
    if monitor.ignored == count > 0:
        names = ", ".join(monitor.dynamics.robot.joint_names)
        raise BagError(f"{bag.path}: {topic}: none of its joint states names a joint of the robot ({names})")


def payload_topics(bag: Bag, name: str) -> list[str]:
    """Return the topic `name` of the payload as `bag` writes it; empty if it has none."""
    topics = (topic.name for topic in bag.topics if topic.type == INERTIA)
    return [topic for topic in topics if name and topic.lstrip("/") == name.lstrip("/")]


def generated_description(bag: Bag) -> str:
    """Return the description of a generated motion; empty if `bag` has no run information or was measured."""
    info = first_run_info(bag)
    return info.note.partition("\n")[0] if info is not None and info.simulated else ""

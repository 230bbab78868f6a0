"""Assess every joint state of a recording with the live core; its log times stand for the node's clock."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from scara_effmass.bags.run_info import first_run_info
from scara_effmass.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from scara_effmass.bags.bag import Bag
    from scara_effmass.safety import Monitor
    from scara_effmass.values import Decision, JointState


class Cycle(NamedTuple):
    """One recorded joint state and its decision.

    `state` is None where the message cannot be decoded, `decision` where it names none of the robot's joints.
    """

    log_time_ns: int
    state: JointState | None
    decision: Decision | None


def joint_state_topic(bag: Bag, requested: str | None) -> str:
    """Return the topic to assess: the requested one, else `joint_states`, else the only one with joint states.

    Raises BagError, which lists the candidates, when that leaves none or several.
    """
    topics = bag.joint_state_topics
    if requested is not None:
        names = [requested]
    elif "/joint_states" in topics:
        names = ["/joint_states"]
    else:
        names = list(topics)
    # A leading slash is easily forgotten, and ROS 1 recorders left it out.
    matches = [topic for topic in topics if topic.lstrip("/") in {name.lstrip("/") for name in names}]
    if len(matches) == 1:
        return matches[0]
    if not topics:
        raise BagError(f"{bag.path}: no topic holds joint states (sensor_msgs/JointState)")
    problem = "several topics hold joint states" if requested is None else f"no joint states on {requested}"
    raise BagError(f"{bag.path}: {problem}; --topic must be one of {', '.join(topics)}")


def assess_joint_states(bag: Bag, topic: str, monitor: Monitor) -> Iterator[Cycle]:
    """Yield the decision of `monitor` for each joint state on `topic`, decoded as the live node decodes it.

    A message that cannot be decoded gives UNKNOWN, as it does live, and later verdicts are held for a while.
    Raises BagError, at the end also where all joint states come from other devices.
    """
    count = 0
    for block in bag.joint_state_blocks(topic):
        for log_time_ns, reason in block.decode_failures:
            count += 1
            yield Cycle(log_time_ns, None, monitor.reject(reason))
        for log_time_ns, state in zip(block.log_time_ns.tolist(), block.states(), strict=True):
            count += 1
            yield Cycle(log_time_ns, state, monitor.assess(state, log_time_ns))
    if monitor.ignored == count > 0:
        names = ", ".join(monitor.dynamics.robot.joint_names)
        raise BagError(f"{bag.path}: {topic}: none of its joint states names a joint of the robot ({names})")


def generated_description(bag: Bag) -> str:
    """Return how the motion in `bag` was generated, empty if it was measured or the bag does not state it."""
    info = first_run_info(bag)
    return info.note.partition("\n")[0] if info is not None and info.simulated else ""

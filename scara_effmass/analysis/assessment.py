"""Every joint state of a recording through the live core; the recorder's log time stands for the node's clock."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from scara_effmass.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from scara_effmass.bags.bag import Bag
    from scara_effmass.safety import Monitor
    from scara_effmass.values import Decision, JointState


class Cycle(NamedTuple):
    """One recorded joint state and what was decided.

    `state` is None where the bytes were none, `decision` where it names none of the robot's joints.
    """

    log_time_ns: int
    state: JointState | None
    decision: Decision | None


def joint_state_topic(bag: Bag, asked: str | None) -> str:
    """Return the topic to assess: the one asked for, else `joint_states`, else the only one that has joint states.

    Raises BagError, with those there are, when that leaves none or several.
    """
    topics = bag.joint_state_topics
    if asked is not None:
        wanted = [asked]
    elif "/joint_states" in topics:
        wanted = ["/joint_states"]
    else:
        wanted = list(topics)
    # A leading slash is easily forgotten, and ROS 1 recorders left it out.
    found = [topic for topic in topics if topic.lstrip("/") in {name.lstrip("/") for name in wanted}]
    if len(found) == 1:
        return found[0]
    if not topics:
        raise BagError(f"{bag.path}: no topic holds joint states (sensor_msgs/JointState)")
    problem = "several topics hold joint states" if asked is None else f"no joint states on {asked}"
    raise BagError(f"{bag.path}: {problem}; give --topic one of {', '.join(topics)}")


def cycles(bag: Bag, topic: str, monitor: Monitor) -> Iterator[Cycle]:
    """Yield what `monitor` decides for each joint state on `topic`, decoded as the live node decodes it.

    Bytes that are no joint state are refused as there: the verdict is UNKNOWN, and what follows is held for a while.
    Raises BagError.
    """
    for block in bag.joint_state_blocks(topic):
        for log_time_ns, reason in block.unreadable:
            yield Cycle(log_time_ns, None, monitor.reject(reason))
        for log_time_ns, state in zip(block.log_time_ns.tolist(), block.states(), strict=True):
            yield Cycle(log_time_ns, state, monitor.assess(state, log_time_ns))

"""Spinning of nodes."""

import pytest
from rclpy.experimental.events_executor import EventsExecutor

from scara_effmass.nodes.client import spin_for
from test.nodes.conftest import ros_node


@pytest.mark.usefixtures("own_domain")
def test_spinning_ends_under_constant_load() -> None:
    calls = 0

    def again() -> None:
        nonlocal calls
        calls += 1
        executor.create_task(again)

    with ros_node("busy") as node:
        executor = EventsExecutor(context=node.context)
        executor.create_task(again)
        spin_for(executor, 0.05)
        assert calls > 0
        before = calls
        spin_for(executor, 600.0, lambda: calls >= before + 10)
        assert calls == before + 10
        executor.shutdown()

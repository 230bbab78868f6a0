"""Spinning of nodes."""

import rclpy
from rclpy.context import Context
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.signals import SignalHandlerOptions

from scara_effmass.nodes.client import spin_for


def test_spinning_ends_under_constant_load(own_domain: int) -> None:
    context = Context()
    rclpy.init(context=context, domain_id=own_domain, signal_handler_options=SignalHandlerOptions.NO)
    executor = EventsExecutor(context=context)
    calls = 0

    def again() -> None:
        nonlocal calls
        calls += 1
        executor.create_task(again)

    executor.create_task(again)
    spin_for(executor, 0.05)
    assert calls > 0
    before = calls
    spin_for(executor, 600.0, lambda: calls >= before + 10)
    assert calls == before + 10
    executor.shutdown()
    context.try_shutdown()

"""How every node of the suite starts, spins and ends."""

from __future__ import annotations

import gc
import signal
import sys
from typing import TYPE_CHECKING

import rclpy
from rclpy.exceptions import ROSInterruptException
from rclpy.executors import ExternalShutdownException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.task import Future

from scara_effmass.errors import EffmassError, SettingsError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rclpy.lifecycle import State

_ONE_SPIN_S = 1e6
"""EventsExecutor.spin() without a time-out keeps a core busy in rclpy 7.1; with one it sleeps."""


class SuiteNode(LifecycleNode):
    """A lifecycle node that tells why a transition failed, and can bring itself up."""

    def __init__(self, name: str) -> None:
        """Make the node; its parameters are declared by the subclass."""
        super().__init__(name, automatically_declare_parameters_from_overrides=True)
        self.failure: EffmassError | None = None
        self.autostart = True

    def on_configure(self, state: State) -> TransitionCallbackReturn:
        """Set up; a refusal leaves the node unconfigured, with its reason in the log and in `failure`."""
        try:
            self.set_up()
        except EffmassError as error:
            self.failure = error
            self.get_logger().error(str(error))
            self.tear_down()
            return TransitionCallbackReturn.FAILURE
        return super().on_configure(state)

    def on_cleanup(self, state: State) -> TransitionCallbackReturn:
        """Give back what `set_up` took."""
        self.tear_down()
        return super().on_cleanup(state)

    def on_shutdown(self, state: State) -> TransitionCallbackReturn:
        """Give back what `set_up` took."""
        self.tear_down()
        return super().on_shutdown(state)

    def set_up(self) -> None:
        """Load what the parameters name and create the endpoints. Raises EffmassError."""
        raise NotImplementedError

    def tear_down(self) -> None:
        """Destroy what `set_up` made, as far as it came."""
        raise NotImplementedError

    def bring_up(self) -> None:
        """Configure and activate. Raises the EffmassError that prevented it."""
        if self.trigger_configure() is not TransitionCallbackReturn.SUCCESS:
            raise self.failure or SettingsError(f"{self.get_name()}: could not be configured")
        if self.trigger_activate() is not TransitionCallbackReturn.SUCCESS:
            raise self.failure or SettingsError(f"{self.get_name()}: could not be activated")


def run(make: Callable[[], SuiteNode], args: Sequence[str] | None) -> int:
    """Run one node until it is told to stop. Return 0, or 2 with one line on stderr where it cannot start."""
    node: SuiteNode | None = None
    executor: EventsExecutor | None = None
    try:
        rclpy.init(args=args)
        node = make()
        executor = EventsExecutor()
        executor.add_node(node)
        if node.autostart:
            node.bring_up()
        # What exists by now stays: without this a full collection stops a 1 kHz stream for milliseconds.
        gc.collect()
        gc.freeze()
        while rclpy.ok():
            executor.spin_until_future_complete(Future(), timeout_sec=_ONE_SPIN_S)
    except (KeyboardInterrupt, ExternalShutdownException, ROSInterruptException):
        pass
    except EffmassError as error:
        print(error, file=sys.stderr)
        return 2
    finally:
        # A launcher sends SIGINT twice; the second must not break into the clean-up.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        if executor is not None:
            executor.shutdown()
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0

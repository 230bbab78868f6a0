"""How every node of the suite starts, spins and ends."""

from __future__ import annotations

import argparse
import gc
import signal
import sys
import time
from contextlib import ExitStack
from functools import partial
from typing import TYPE_CHECKING, TypeVar

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.exceptions import ROSInterruptException
from rclpy.executors import ExternalShutdownException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.qos import qos_policy_name_from_kind
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.task import Future
from rclpy.utilities import remove_ros_args

from scara_effmass.errors import EffmassError, SettingsError
from scara_effmass.nodes.qos import qos_profile
from scara_effmass.nodes.readiness import report_readiness

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from lifecycle_msgs.srv import ChangeState
    from rclpy.event_handler import QoSRequestedIncompatibleQoSInfo
    from rclpy.executors import Executor
    from rclpy.lifecycle import LifecyclePublisher, State
    from rclpy.timer import Timer

    from scara_effmass.wire.topics import Qos

Endpoint = TypeVar("Endpoint")

RCLError = rclpy_implementation.RCLError

_ONE_SPIN_S = 1e6
"""EventsExecutor.spin() without a time-out keeps a core busy in rclpy 7.1; with one it sleeps."""

_SPIN_SLICE_S = 0.1


def spin_for(executor: Executor, seconds: float, done: Callable[[], bool] = bool) -> None:
    """Handle events for `seconds` or until `done`, which is called after each event.

    EventsExecutor applies its timeout to each wait for an event, so spinning it under constant load has no end in
    rclpy 7.1. It does not notice signals; Python handles them between two slices.
    """
    end_ns = time.monotonic_ns() + round(seconds * 1e9)
    while not done() and (left_ns := end_ns - time.monotonic_ns()) > 0:
        executor.spin_once(timeout_sec=min(left_ns / 1e9, _SPIN_SLICE_S))


class LifecycleBase(LifecycleNode):
    """A lifecycle node that tells why a transition failed, can bring itself up, and can end the process.

    A subclass says what to do in `set_up`, `start` and `stop`; what it hands to `keep` is destroyed by itself.
    """

    def __init__(self, name: str) -> None:
        """Make the node; its parameters are declared by the subclass."""
        super().__init__(name)
        self.autostart = True
        self.active = False
        self._fatal: EffmassError | None = None
        self._kept = ExitStack()
        self._failure: Exception | None = None
        self._change_state = self._service_change_state.callback
        self._service_change_state.callback = self._on_change_state
        report_readiness(self)

    def on_configure(self, state: State) -> TransitionCallbackReturn:
        """Set up; a refusal leaves the node unconfigured, with its reason in the log."""
        return self._tried(self.set_up, self._clean_up) or super().on_configure(state)

    def on_activate(self, state: State) -> TransitionCallbackReturn:
        """Start; a refusal leaves the node inactive, with its reason in the log."""
        refused = self._tried(self.start, self.stop)
        self.active = refused is None
        return refused or super().on_activate(state)

    def on_deactivate(self, state: State) -> TransitionCallbackReturn:
        """Fall silent."""
        self.active = False
        self.stop()
        return super().on_deactivate(state)

    def on_cleanup(self, state: State) -> TransitionCallbackReturn:
        """Give back what `set_up` took."""
        self._clean_up()
        return super().on_cleanup(state)

    def on_shutdown(self, state: State) -> TransitionCallbackReturn:
        """Give back what `start` and `set_up` took."""
        self._clean_up()
        return super().on_shutdown(state)

    def set_up(self) -> None:
        """Load what the parameters name and create the endpoints. Raises EffmassError."""
        raise NotImplementedError

    def start(self) -> None:
        """Begin to work; what is published from here on is heard. Raises EffmassError."""

    def stop(self) -> None:
        """Undo `start`, as far as it came; may be called again."""

    def own(self, endpoint: Endpoint, destroy: Callable[[Endpoint], object]) -> Endpoint:
        """Return `endpoint`, to be destroyed when the node is cleaned up or ends."""
        self._kept.callback(destroy, endpoint)
        return endpoint

    def publisher(self, kind: type, topic: str, qos: Qos, on_incompatible: Callable[[str], None]) -> LifecyclePublisher:
        """Return a publisher, kept, whose QoS parameters may override; `on_incompatible` gets a line about a misfit."""
        misfit = partial(incompatible, f"a subscriber of {topic}", on_incompatible)
        publisher: LifecyclePublisher = self.create_lifecycle_publisher(
            kind,
            topic,
            qos_profile(qos),
            event_callbacks=PublisherEventCallbacks(incompatible_qos=misfit),
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )
        return self.own(publisher, self.destroy_lifecycle_publisher)

    def create_steady_timer(self, period_s: float, callback: Callable[[], None]) -> Timer:
        """Return a timer, kept, in steady time: a /clock that stands or jumps does not keep it from being called."""
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        return self.own(self.create_timer(period_s, callback, clock=steady), self.destroy_timer)

    def fail(self, error: EffmassError) -> None:
        """End the process with `error` as its line: it cannot do what it is there for."""
        self._fatal = error
        rclpy.try_shutdown()

    def raise_fatal(self) -> None:
        """Raise what `fail` was given, if it was."""
        if self._fatal is not None:
            raise self._fatal

    def destroy_node(self) -> None:
        """End; nothing that was kept stays behind."""
        self._clean_up()
        super().destroy_node()  # type: ignore[no-untyped-call]

    def bring_up(self) -> None:
        """Configure and activate. Raises what prevented it, such as an EffmassError."""
        done = TransitionCallbackReturn.SUCCESS
        if self.trigger_configure() is not done or self.trigger_activate() is not done:
            raise self._failure or SettingsError(f"{self.get_name()}: could not be brought up")

    def _tried(self, step: Callable[[], None], undo: Callable[[], None]) -> TransitionCallbackReturn | None:
        self._failure = None
        try:
            step()
        except Exception as error:  # noqa: BLE001 - rclpy would drop it
            self._failure = _explained(self.get_name(), error)
            undo()
            return TransitionCallbackReturn.FAILURE
        return None

    def _clean_up(self) -> None:
        self.active = False
        self.stop()
        self._kept.close()

    def _on_change_state(self, request: ChangeState.Request, response: ChangeState.Response) -> ChangeState.Response:
        """Answer a request that comes at the wrong time with a refusal: rclpy raises, which would end the process."""
        try:
            response = self._change_state(request, response)
        except RCLError:
            response.success = False
            asked = request.transition.label or request.transition.id
            self.get_logger().error(f"no transition {asked} from {self._state_machine.current_state[1]}: refused")
        if self._failure is not None:
            self.get_logger().error(str(self._failure))
            self._failure = None
        return response


def incompatible(endpoint: str, tell: Callable[[str], None], event: QoSRequestedIncompatibleQoSInfo) -> None:
    """Tell, in one line, that `endpoint` is not connected, and for which policy."""
    tell(f"{endpoint} cannot be connected: its {qos_policy_name_from_kind(event.last_policy_kind)} does not fit")


def run(make: Callable[[], LifecycleBase], args: Sequence[str] | None) -> int:
    """Run one node until it is told to stop. Return 0, or 2 with one line on stderr where it cannot start.

    `args` are those of the process when None; they begin with the first argument otherwise.
    """
    node: LifecycleBase | None = None
    executor: Executor | None = None
    # From here on a signal does what rclpy makes it do, which is to end the context, and never interrupts Python:
    # a launcher sends SIGINT twice, and the second one would break into the clean-up.
    ending = {signal.SIGINT, signal.SIGTERM}
    signal.pthread_sigmask(signal.SIG_BLOCK, ending)
    for number in ending:
        signal.signal(number, signal.SIG_IGN)
    try:
        _init(args)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, ending)
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
        node.raise_fatal()
    except (ExternalShutdownException, ROSInterruptException):
        pass
    except EffmassError as error:
        print(error, file=sys.stderr)  # noqa: T201 - the one line for every refusal
        return 2
    except Exception:
        if rclpy.ok():
            raise
        # Told to stop while starting: whatever was being made missed its context.
    finally:
        _end(node, executor)
    return 0


def _end(node: LifecycleBase | None, executor: Executor | None) -> None:
    """Destroy what `run` made, as far as it came."""
    if node is not None:
        node.stop()  # no thread of it may wake an executor that has gone
    if executor is not None:
        executor.shutdown()
    if node is not None:
        node.destroy_node()
    rclpy.try_shutdown()


def _init(args: Sequence[str] | None) -> None:
    """Start ROS. Raises SettingsError for arguments that it, or the node, does not know."""
    words = sys.argv[1:] if args is None else list(args)
    parser = argparse.ArgumentParser(
        usage="%(prog)s [--ros-args ...]", description="Run one node until it is told to stop.", allow_abbrev=False
    )
    try:
        _, strays = parser.parse_known_args(remove_ros_args(words))
        rclpy.init(args=words)
    except RuntimeError as error:
        reason = " ".join(str(error).split()).partition(", at /")[0]
        raise SettingsError(f"ROS arguments: {reason}") from None
    if strays:
        raise SettingsError(f"{strays[0]!r}: not known; ROS arguments stand behind --ros-args")


def _explained(node: str, error: Exception) -> Exception:
    """Return `error`, as a SettingsError where rclpy did not like a qos_overrides parameter."""
    return SettingsError(f"{node}: qos_overrides: {error}") if "QoS override" in str(error) else error

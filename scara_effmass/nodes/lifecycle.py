# SPDX-License-Identifier: Apache-2.0
"""Lifecycle of every node of the suite: start, spin, end."""

import argparse
import faulthandler
import gc
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from collections.abc import Set as AbstractSet
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from itertools import pairwise
from typing import Any, Generic, TypeVar

import rclpy
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import Log, SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.event_handler import (
    PublisherEventCallbacks,
    QoSRequestedIncompatibleQoSInfo,
    QoSSubscriptionMatchedInfo,
    SubscriptionEventCallbacks,
)
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import Executor
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecyclePublisher, State, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.qos import (
    QoSCompatibility,
    QoSPolicyKind,
    qos_check_compatible,
    qos_policy_name_from_kind,
)
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription
from rclpy.task import Future
from rclpy.timer import Timer
from rclpy.utilities import remove_ros_args
from std_srvs.srv import Trigger

from scara_effmass.codes import Reason
from scara_effmass.errors import EffmassError, SettingsError
from scara_effmass.nodes import parameters
from scara_effmass.nodes.parameters import Parameters
from scara_effmass.nodes.readiness import PERIOD_S, readiness_reporter
from scara_effmass.nodes.ros import (
    END_SIGNALS,
    ClientNode,
    catch,
    ignoring_late_events,
    one_line,
    qos_profile,
    start_refusal,
    start_ros,
    use_realtime,
)
from scara_effmass.settings.loading import READ_ONLY, flat_fields
from scara_effmass.streams import open_standard_streams
from scara_effmass.wire.topics import INFO_QOS, Qos

Entity = TypeVar("Entity")

RCLError = rclpy_implementation.RCLError
REFUSALS = (RCLError, ParameterException, NameValidationException)
"""Errors of ROS about names, and about parameters that it declares itself."""

_SPIN_S = 1e6
"""Timeout of each spin [s]: without one, EventsExecutor.spin() keeps a core busy in rclpy 7.1."""
_ROSOUT_WAIT_S = 2.0
_ROSOUT_ACK_S = 5.0
"""Fast DDS repeats after 3 s what a subscriber missed."""
_SETTLE_S = 0.2
"""Time for a subscriber to discover a publisher that has discovered it."""
_POLL_S = 0.01
_LOADING_S = 1.0
"""Time for which a signal lets a node go on loading."""
_END_S = 8.0
"""Time for which a signal lets a node end; `ros2 launch` kills it after 10 s."""
_EXIT_BY_SIGNAL = 128
"""What a shell adds to the number of the signal that ended a process."""
_STDERR_WAIT_S = 1.0
"""Time for which the end of the process waits until the terminal has printed the log."""
_PUBLISHER_OVERRIDES = (
    *(QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY, QoSPolicyKind.DEADLINE),
    *(QoSPolicyKind.LIFESPAN, QoSPolicyKind.LIVELINESS, QoSPolicyKind.LIVELINESS_LEASE_DURATION),
)
"""QoS policies of publishers that parameters may override."""
_QOS_OVERRIDES = "qos_overrides"
"""Prefix of the parameters that ROS declares with an endpoint."""


class LifecycleBase(LifecycleNode, Generic[Parameters]):
    """Lifecycle node that logs why a transition failed, can bring itself up, and can end the process with an error.

    Subclasses implement `configure`, `activate`, `deactivate` and, if parameters may change while the node is
    configured, `check_settings` and `apply_settings`. Entities that `own` or a method `create_owned_*` returns are
    destroyed at clean-up.
    """

    def __init__(self, name: str, kind: type[Parameters]) -> None:
        """Create the node, and declare the parameters of its `kind`. Raises SettingsError for an invalid one.

        A parameter that is fixed can change only while the node is unconfigured.
        """
        try:
            super().__init__(name)
        except REFUSALS as error:  # such as security that the middleware does not have
            if not rclpy.ok():  # a signal has ended ROS meanwhile
                raise
            raise SettingsError(f"{name}: {one_line(error)}") from None
        self.settings = parameters.declare(self, kind)
        self._fields = flat_fields(kind)
        self.set_read_only(read_only=False)
        self.add_on_set_parameters_callback(self._on_set)
        self.add_post_set_parameters_callback(self._after_set)
        self.active = False
        self.stopping = threading.Event()
        """Set by a signal that ends the process, so that a transition can stop waiting."""
        self._mismatches: dict[str, str] = {}
        """The topic of each line of `incompatible_qos`."""
        self._is_starting = False
        self.abort_error: EffmassError | None = None
        """The error passed to `abort`."""
        self._owned = ExitStack()
        self._transition_error: Exception | None = None
        self._change_state = self._service_change_state.callback
        self._service_change_state.callback = self._on_change_state
        # Steady time: the clock of a replay stands still until the nodes are ready.
        self.create_steady_timer(PERIOD_S, readiness_reporter(self, lambda: self.active), owned=False)

    def configure(self) -> None:
        """Load what the parameters name and create the endpoints. Raises EffmassError."""
        raise NotImplementedError

    def activate(self) -> None:
        """Start to work and publish. Raises EffmassError."""

    def deactivate(self) -> None:
        """Undo `activate`, even if it failed halfway; may be called repeatedly."""

    def publish_last(self, reason: Reason, detail: str = "") -> None:
        """Publish the last message before the outputs end for `reason`, in any thread; later calls do nothing."""

    def on_configure(self, state: State) -> TransitionCallbackReturn:
        """Configure; after an error the node stays unconfigured."""
        self.set_read_only(read_only=True)
        return self._attempt(self.configure, self._clean_up) or self._done(
            state, "inactive", super().on_configure(state)
        )

    def on_activate(self, state: State) -> TransitionCallbackReturn:
        """Activate; after an error the node stays inactive."""
        failure = self._attempt(self.activate, self.deactivate)
        self.active = failure is None
        return failure or self._done(state, "active", super().on_activate(state))

    def on_deactivate(self, state: State) -> TransitionCallbackReturn:
        """Stop publishing."""
        self.active = False
        self.deactivate()
        return self._done(state, "inactive", super().on_deactivate(state))

    def on_cleanup(self, state: State) -> TransitionCallbackReturn:
        """Release what `configure` created."""
        self._clean_up()
        return self._done(state, "unconfigured", super().on_cleanup(state))

    def on_shutdown(self, state: State) -> TransitionCallbackReturn:
        """Release what `activate` and `configure` created."""
        self._clean_up()
        return self._done(state, "finalized", super().on_shutdown(state))

    def own(self, entity: Entity, destroy: Callable[[Entity], object]) -> Entity:
        """Return `entity`; call `destroy` with it when the node is cleaned up or destroyed."""
        self._owned.callback(destroy, entity)
        return entity

    def create_owned_publisher(self, message_type: type, topic: str, qos: Qos) -> LifecyclePublisher:
        """Return a publisher whose QoS parameters may override."""
        publisher: LifecyclePublisher = self.create_lifecycle_publisher(
            message_type,
            topic,
            qos_profile(qos),
            event_callbacks=PublisherEventCallbacks(
                incompatible_qos=partial(self._on_incompatible, f"a subscriber of {topic}", topic)
            ),
            qos_overriding_options=QoSOverridingOptions(_PUBLISHER_OVERRIDES),
        )
        return self.own(publisher, self.destroy_lifecycle_publisher)

    def create_owned_subscription(
        self,
        message_type: type,
        topic: str,
        callback: Callable[..., None],
        qos: Qos,
        *,
        raw: bool = False,
        matched: Callable[[QoSSubscriptionMatchedInfo], object] = lambda _: None,
        **events: Any,  # noqa: ANN401 - those of rclpy
    ) -> Subscription:
        """Return a subscription whose QoS parameters may override.

        The loss and the return of its last publisher are logged, except of a latched topic, which outlives its sender.
        `events` are further callbacks of rclpy's SubscriptionEventCallbacks, but not `message_lost`, which can lock the
        process for ever: see `nodes.ros.SequenceGaps`.
        """

        def on_matched(info: QoSSubscriptionMatchedInfo) -> None:
            if not info.current_count and not qos.latched:
                self.get_logger().warning(f"lost the publisher of {subscription.topic_name}")
            elif info.current_count == info.current_count_change and info.total_count > info.current_count:
                self.get_logger().info(f"reconnected: {subscription.topic_name} has a publisher again")
            matched(info)

        subscription = self.create_subscription(
            message_type,
            topic,
            callback,
            qos_profile(qos),
            raw=raw,
            event_callbacks=SubscriptionEventCallbacks(
                incompatible_qos=partial(self._on_incompatible, f"a publisher of {topic}", topic),
                matched=on_matched,
                **events,
            ),
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )
        return self.own(subscription, self.destroy_subscription)

    def create_owned_trigger(self, name: str, action: Callable[[], str]) -> None:
        """Offer a Trigger service that returns the text of `action`, or refuses with the text of its EffmassError."""

        def respond(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            try:
                response.message, response.success = action(), True
            except (EffmassError, OSError) as error:
                response.message = str(error)
            return response

        self.own(self.create_service(Trigger, name, respond), self.destroy_service)

    def create_steady_timer(self, period_s: float, callback: Callable[[], None], *, owned: bool = True) -> Timer:
        """Return a timer in steady time, which runs even if /clock stands still or jumps."""
        ended = threading.Event()

        def call() -> None:
            if ended.is_set():  # the executor had it in its queue
                return
            try:
                callback()
            except RCLError:
                if self.context.ok():  # else a signal has ended it meanwhile
                    raise

        def destroy(timer: Timer) -> None:
            ended.set()
            self.destroy_timer(timer)

        timer = self.create_timer(period_s, call, clock=Clock(clock_type=ClockType.STEADY_TIME))
        return self.own(timer, destroy) if owned else timer

    def create_status_timer(self, log: Callable[[], None]) -> None:
        """Call `log` every `status_period` while the node is active; 0: never."""
        if period_s := self.settings.status_period:
            self.create_steady_timer(period_s, lambda: log() if self.active else None)

    def check_settings(self, settings: Parameters) -> None:
        """Raise EffmassError, whose text becomes the reason, for settings that the node refuses."""

    def apply_settings(self, changed: AbstractSet[str]) -> None:
        """Use `settings`, in which the parameters `changed` are new."""

    def _with_changes(self, changes: list[Parameter]) -> Parameters | None:
        """Return the settings with `changes`. Raises SettingsError.

        Return None if there is no setting among them: each endpoint declares several parameters of its own.
        """
        if self._fields.keys().isdisjoint(change.name for change in changes):
            return None
        return parameters.changed_settings(self.settings, changes, self.get_name())

    def _on_set(self, changes: list[Parameter]) -> SetParametersResult:
        try:
            if (settings := self._with_changes(changes)) is not None:
                self.check_settings(settings)
        except EffmassError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _after_set(self, changes: list[Parameter]) -> None:
        if (settings := self._with_changes(changes)) is not None:
            self.settings = settings
            self.apply_settings({change.name for change in changes})

    def set_read_only(self, *, read_only: bool) -> None:
        """Mark the fixed parameters as read-only or writable; `autostart` has no effect after the start."""
        for name, field in self._fields.items():
            if field.json_schema_extra == READ_ONLY and name != "autostart":
                self.describe_parameter(name).read_only = read_only

    def now_ns(self) -> int:
        """Return the time of the node's clock [ns]."""
        # Not `now()`: its Time object costs several times as much as the reading.
        return int(self.get_clock().handle.get_now().nanoseconds)

    def abort(self, error: EffmassError) -> None:
        """End the process; `run` prints `error` and returns 2."""
        self.abort_error = error
        self.publish_last(Reason.STATED, str(error))
        rclpy.try_shutdown()

    def destroy_node(self) -> None:
        """Destroy the node and everything it owns."""
        self._clean_up()
        super().destroy_node()  # type: ignore[no-untyped-call]

    def bring_up(self) -> None:
        """Configure and activate. Raises the error that prevented it."""
        self._is_starting, success = True, TransitionCallbackReturn.SUCCESS
        if self.trigger_configure() is not success or self.trigger_activate() is not success:
            raise self._transition_error or SettingsError(f"{self.get_name()}: could not be brought up")
        self._is_starting = False
        self.get_logger().info("unconfigured -> active")

    def _attempt(self, step: Callable[[], None], undo: Callable[[], None]) -> TransitionCallbackReturn | None:
        """Run `step`; after an error run `undo` and return FAILURE."""
        self._transition_error = None
        try:
            step()
        except Exception as error:  # noqa: BLE001 - rclpy would drop it
            self._transition_error = error
            if "QoS override" in str(error):  # rclpy rejected a parameter
                self._transition_error = SettingsError(f"{self.get_name()}: qos_overrides: {error}")
            elif isinstance(error, REFUSALS) and self.context.ok():  # else a signal has ended it meanwhile
                self._transition_error = SettingsError(f"{self.get_name()}: {one_line(error)}")
            undo()
            return TransitionCallbackReturn.FAILURE
        return None

    def _done(self, state: State, goal: str, result: TransitionCallbackReturn) -> TransitionCallbackReturn:
        if not self._is_starting:
            self.get_logger().info(f"{state.label} -> {goal}")
        return result

    def _clean_up(self) -> None:
        self.active = False
        self.set_read_only(read_only=False)
        self.deactivate()
        self._owned.close()
        self._mismatches.clear()
        self._forget_qos()

    def _forget_qos(self) -> None:
        """Undeclare the QoS of the endpoints, else it would override that of the next ones; what was stated is kept."""
        for name in self.get_parameters_by_prefix(_QOS_OVERRIDES):
            parameter = f"{_QOS_OVERRIDES}.{name}"
            self.describe_parameter(parameter).read_only = False
            self.undeclare_parameter(parameter)

    @property
    def incompatible_qos(self) -> str:
        """The endpoints that cannot be connected now, each with its QoS policy that does not fit."""
        self._mismatches = {line: topic for line, topic in self._mismatches.items() if self._has_mismatch(topic)}
        return "; ".join(sorted(self._mismatches))

    def _has_mismatch(self, topic: str) -> bool:
        """Return whether an endpoint of this node does not fit another one of the topic."""
        name = self.resolve_topic_name(topic)
        publishers, subscribers = self.get_publishers_info_by_topic(name), self.get_subscriptions_info_by_topic(name)
        own = self.get_namespace(), self.get_name()
        return any(
            qos_check_compatible(publisher.qos_profile, subscriber.qos_profile)[0] == QoSCompatibility.ERROR
            for publisher in publishers
            for subscriber in subscribers
            if own in {(end.node_namespace, end.node_name) for end in (publisher, subscriber)}
        )

    def _on_incompatible(self, endpoint: str, topic: str, event: QoSRequestedIncompatibleQoSInfo) -> None:
        line = f"{endpoint} cannot be connected: its {qos_policy_name_from_kind(event.last_policy_kind)} does not fit"
        self._mismatches[line] = topic
        self.get_logger().warning(line)

    def _on_change_state(self, request: ChangeState.Request, response: ChangeState.Response) -> ChangeState.Response:
        """Refuse a transition that the state does not allow; rclpy would raise and end the process."""
        try:
            response = self._change_state(request, response)
        except RCLError:
            response.success = False
            transition = request.transition.label or request.transition.id
            self.get_logger().error(f"no transition {transition} from {self._state_machine.current_state[1]}: refused")
        if self._transition_error is not None:
            self.get_logger().error(str(self._transition_error))
            self._transition_error = None
        return response


AnyNode = LifecycleBase[Any]


def run(name: str, node_class: Callable[[], AnyNode], args: Sequence[str] | None = None) -> int:
    """Run the node `name` until a signal ends it. Return 0, or 2 with one line on stderr and /rosout after an error.

    `args` are the arguments without the program name; None means those of the process.
    """
    arguments = sys.argv[1:] if args is None else list(args)
    node: AnyNode | None = None
    executor: Executor | None = None

    stopped = False
    spin = _Spin()
    ros_arguments: list[str] = []

    def stop(number: int) -> None:
        nonlocal stopped
        stopped = True
        if node is not None:
            node.stopping.set()
        try:
            _publish_last(node, Reason.SHUTDOWN)
        finally:
            spin.end(number)

    try:
        with _stderr_that_never_blocks() as terminal, _on_signal(stop):
            try:
                parameters.ARGUMENTS.set(arguments)
                _init(arguments)
                ros_arguments = arguments
                if stopped:
                    return 0
                node = node_class()
                executor = EventsExecutor()
                faulthandler.enable(terminal)  # the executor lets it write to a pipe, which a crash would not empty
                executor.add_node(node)
                if node.settings.autostart:
                    node.bring_up()
                # Exempt existing objects: a full garbage collection would stop a 1 kHz stream for milliseconds.
                gc.collect()
                gc.freeze()
                _use_thread_priority(node)
                spin.run(executor)
            except EffmassError:
                raise
            except Exception as error:
                if rclpy.ok():
                    _publish_last(node, Reason.NODE_ERROR, repr(error))
                    raise
                # A signal or `abort` ended the context.
            finally:
                _end(node, executor, spin)
            if node is not None and node.abort_error is not None:
                raise node.abort_error
    except EffmassError as error:
        print(error, file=sys.stderr)  # noqa: T201
        with suppress(EffmassError, *REFUSALS):  # without ROS there is no /rosout either
            _log_refusal(name, error, ros_arguments)
        return 2
    return 0


class _Spin:
    """Spins an executor until another thread ends it.

    The context stays valid meanwhile: EventsExecutor crashes if it ends while the executor collects its entities.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._has_begun = False
        self.loaded = threading.Event()
        """Set when the node has been loaded, or will not be."""
        self.ended = threading.Event()
        """Set when what the node used has been released."""
        self._end: Future = Future()

    def run(self, executor: Executor) -> None:
        """Spin until `end` is called or the context is shut down."""
        self.loaded.set()
        with self._lock:
            self._has_begun = rclpy.ok()
        while rclpy.ok() and not self._end.done():
            with ignoring_late_events():
                executor.spin_until_future_complete(self._end, timeout_sec=_SPIN_S)

    def end(self, number: int) -> None:
        """End `run` at the signal `number`. If it has not begun, shut the context down, which ends the start.

        A node that loads, or hangs in a driver, does not notice it: end the process after a while.
        """
        with self._lock:
            if self._has_begun:
                self._end.set_result(None)
            else:
                rclpy.try_shutdown()
        if not (self.loaded.wait(_LOADING_S) and self.ended.wait(_END_S)):
            os._exit(_EXIT_BY_SIGNAL + number)


@contextmanager
def _stderr_that_never_blocks() -> Iterator[int]:
    """Pass stderr on in a thread and give its descriptor. While a terminal stands still (Ctrl-S), output is lost.

    rclpy holds the interpreter while it logs, so every thread of the node would otherwise wait for that terminal.
    """
    open_standard_streams()
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    terminal = os.dup(2)
    os.environ.setdefault("RCUTILS_COLORIZED_OUTPUT", str(int(os.isatty(2))))
    os.dup2(writer, 2)
    os.close(writer)

    def pass_on() -> None:
        with suppress(OSError), open(terminal, "wb", buffering=0, closefd=False) as output:
            while data := os.read(reader, 65536):
                output.write(data)

    thread = threading.Thread(target=pass_on, name="stderr", daemon=True)
    thread.start()
    try:
        yield terminal
    finally:
        os.dup2(terminal, 2)
        thread.join(_STDERR_WAIT_S)


@contextmanager
def _on_signal(stop: Callable[[int], None]) -> Iterator[None]:
    """Call `stop` with the number of the first of END_SIGNALS, in a thread of its own; further ones do nothing.

    rclpy would end the context at once, before a last message. A handler in Python would not run while the executor
    waits or a callback takes long.
    """
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    for number in END_SIGNALS:
        catch(number, lambda *_: None)
    signal.set_wakeup_fd(writer, warn_on_full_buffer=False)

    def await_signal() -> None:
        if numbers := os.read(reader, 1):
            stop(numbers[0])

    thread = threading.Thread(target=await_signal, name="signals", daemon=True)
    thread.start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(-1)
        os.close(writer)
        thread.join()
        os.close(reader)


def _log_refusal(name: str, error: EffmassError, arguments: list[str]) -> None:
    """Publish `error` on /rosout for the node `name`, which may not exist; wait up to 2 s for a subscriber."""
    with ClientNode(name, arguments) as client:
        node = client.node
        publisher = node.create_publisher(Log, "/rosout", qos_profile(INFO_QOS))
        end = time.monotonic() + _ROSOUT_WAIT_S
        while not publisher.get_subscription_count() and time.monotonic() < end:
            time.sleep(_POLL_S)
        time.sleep(_SETTLE_S)
        message = Log(level=Log.FATAL, name=node.get_logger().name, msg=str(error))
        message.stamp = node.get_clock().now().to_msg()
        publisher.publish(message)
        publisher.wait_for_all_acked(Duration(seconds=_ROSOUT_ACK_S))


def _publish_last(node: AnyNode | None, reason: Reason, detail: str = "") -> None:
    if node is not None:
        node.publish_last(reason, detail)


def _use_thread_priority(node: AnyNode) -> None:
    if priority := node.settings.thread_priority:
        if refusal := use_realtime(priority):
            node.get_logger().warning(f"thread_priority = {priority}: not permitted: {refusal}; goes on without")
        else:
            node.get_logger().info(f"SCHED_FIFO at priority {priority}, memory locked")


def _end(node: AnyNode | None, executor: Executor | None, spin: _Spin) -> None:
    """Destroy what `run` created."""
    spin.loaded.set()
    try:
        if node is not None:
            node.deactivate()  # its threads must not wake the executor after its shutdown
        if executor is not None:
            executor.shutdown()
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    finally:
        spin.ended.set()


def _init(arguments: list[str]) -> None:
    """Initialise ROS. Raises SettingsError for unknown arguments."""
    for option, assignment in pairwise(arguments):
        if option in {"-p", "--param", "-r", "--remap"} and ":=" not in assignment:
            name, _, value = assignment.partition("=")
            raise SettingsError(f"{option} {assignment}: must be NAME:=VALUE{f': write {name}:={value}' * bool(value)}")
    parser = argparse.ArgumentParser(
        usage="%(prog)s [--ros-args ...]", description="Run one node until a signal ends it.", allow_abbrev=False
    )
    try:
        _, unknown = parser.parse_known_args(remove_ros_args(arguments))
    except RuntimeError as error:
        raise start_refusal(error) from None
    start_ros(arguments)
    if unknown:
        raise SettingsError(f"{unknown[0]!r}: unknown argument; ROS arguments must follow --ros-args")

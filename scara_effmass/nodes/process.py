# SPDX-License-Identifier: Apache-2.0
"""What every process with ROS has: the signals that end it, and the refusals of its start."""

import os
import re
import signal
from collections.abc import Callable, Sequence
from types import FrameType
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.signals import SignalHandlerOptions

from scara_effmass.errors import SettingsError

END_SIGNALS = (
    *(signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT),
    *(signal.SIGUSR1, signal.SIGUSR2, signal.SIGXCPU),
)
"""Those of terminals, service managers and operators that would end the process at once: all but faults and SIGKILL."""
_MAX_DOMAIN = 232
"""Above it, the UDP ports of DDS exceed 65535."""


def catch(number: int, handler: Callable[[int, FrameType | None], Any]) -> Any:  # noqa: ANN401 - as signal.signal
    """Call `handler` at the signal `number` and return the handler before; leave SIGHUP ignored, as nohup does."""
    before = signal.getsignal(number)
    if number == signal.SIGHUP and before == signal.SIG_IGN:
        return before
    return signal.signal(number, handler)


def one_line(error: Exception) -> str:
    """Return the text of an error of ROS in one line, without the place in its sources."""
    return " ".join(str(error).split()).partition(", at /")[0].removesuffix(" ^")


def start_ros(arguments: Sequence[str], context: Context | None = None) -> None:
    """Initialise ROS, without its handlers of signals. Raises SettingsError."""
    domain = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not re.fullmatch("0*[0-9]{1,3}", domain) or int(domain) > _MAX_DOMAIN:
        raise SettingsError(f"ROS_DOMAIN_ID = {domain!r}: must be a whole number from 0 to {_MAX_DOMAIN}")
    try:
        rclpy.init(args=list(arguments), context=context, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        raise start_refusal(error) from None


def start_refusal(error: RuntimeError) -> SettingsError:
    """Return why ROS does not start: its arguments, or no folder for its log."""
    text = one_line(error)
    subject, remedy = "ROS arguments", ""
    if "initialize logging" in text:
        subject, remedy = "ROS_LOG_DIR", ": must be a folder that can be written; without it, ~/.ros/log must be one"
    return SettingsError(f"{subject}: {text.removesuffix(' >>>').removesuffix(' <<<')}{remedy}")

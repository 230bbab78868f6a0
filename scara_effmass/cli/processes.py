"""Child processes of a demo: commands of the suite in a ROS domain of their own."""

from __future__ import annotations

import argparse
import ctypes
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Self

from scara_effmass.errors import EffmassError

if TYPE_CHECKING:
    from scara_effmass.settings import MonitorSettings

RECORDING = "recording"
"""Folder of the recording below the output folder of a demo."""
SIM_TIME = ["--ros-args", "-p", "use_sim_time:=true"]
START_TIMEOUT_S = 60.0
STOP_TIMEOUT_S = 30.0
DOMAINS = 101
"""Highest ROS domain id whose ports lie below the ephemeral ports of Linux."""
_PARTICIPANTS = 16
"""Number of participant ports to probe in a domain."""
_PR_SET_PDEATHSIG = 1


class ChildProcess:
    """A running `scara-effmass` command with captured output; use it in a `with`, which ends it."""

    def __init__(self, command: Sequence[str]) -> None:
        """Start the command in a new session, so that Ctrl-C at the terminal reaches this process only."""
        self._name = command[0]
        self._output = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the process
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115
        self._process = subprocess.Popen(  # noqa: S603 - starts this program
            [sys.executable, "-m", "scara_effmass", *command],
            stdin=subprocess.DEVNULL,
            stdout=self._output,
            stderr=self._errors,
            start_new_session=True,
            preexec_fn=_end_with_parent,  # noqa: PLW1509 - no thread runs yet where commands are started
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self._interrupt()
        self._output.close()
        self._errors.close()

    @property
    def ended(self) -> bool:
        """Whether the process has ended."""
        return self._process.poll() is not None

    def output(self) -> str:
        """Wait for the end of the process and return its stdout. Raises EffmassError if it failed."""
        if self._process.wait() != 0:
            self.fail()
        self._output.seek(0)
        return self._output.read().decode()

    def finish(self) -> str:
        """Interrupt the process and return its stdout. Raises EffmassError if it failed."""
        self._interrupt()
        return self.output()

    def fail(self) -> None:
        """Raise EffmassError with the last line that the process wrote to stderr."""
        self._errors.seek(0)
        lines = self._errors.read().decode(errors="replace").strip().splitlines()
        reason = lines[-1] if lines else f"exit code {self._process.returncode}"
        raise EffmassError(f"{self._name} has ended: {reason}")

    def _interrupt(self) -> None:
        """Interrupt the process, and kill it if it does not end in time."""
        if self.ended:
            return
        self._process.send_signal(signal.SIGINT)
        try:
            self._process.wait(STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def _end_with_parent() -> None:
    """Have Linux send SIGTERM to this process when its parent dies, even by SIGKILL: no node outlives a demo."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def require_running(processes: Iterable[ChildProcess]) -> None:
    """Raise EffmassError with the message of a process that has ended."""
    for process in processes:
        if process.ended:
            process.fail()


@contextmanager
def removed_on_failure(folder: Path) -> Iterator[None]:
    """Remove `folder` if the `with` block raises."""
    try:
        yield
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise


def monitor_command(args: argparse.Namespace, settings: MonitorSettings) -> list[str]:
    """Return the command that runs the monitor with the settings of the demo."""
    command = ["monitor", "--robot", str(settings.robot_path), "--model", settings.effective_mass_model.value]
    if args.params:
        command += ["--params", str(args.params)]
    return command + SIM_TIME


def record_command(args: argparse.Namespace) -> list[str]:
    """Return the command that records the topics of the suite."""
    return ["record", "-o", str(args.out / RECORDING), "--json", *(["--force"] if args.force else []), *SIM_TIME]


def isolate_ros_domain() -> None:
    """Put this process and its children into a free ROS domain that other machines cannot reach.

    A recorded motion must never reach the nodes of a real cell.
    """
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    domains = (1 + (os.getpid() + turn) % DOMAINS for turn in range(DOMAINS))
    os.environ["ROS_DOMAIN_ID"] = str(next(filter(domain_is_free, domains), 1 + os.getpid() % DOMAINS))


def domain_is_free(domain: int) -> bool:
    """Return whether no process on this machine uses the first participant ports of a ROS domain."""
    for participant in range(_PARTICIPANTS):
        with socket.socket(type=socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("", 7400 + 250 * domain + 10 + 2 * participant))
            except OSError:
                return False
    return True

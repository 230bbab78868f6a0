"""Commands of the suite as processes of their own."""

from __future__ import annotations

import ctypes
import os
import signal
import socket
import subprocess
import sys
import tempfile
from contextlib import contextmanager
from typing import TYPE_CHECKING

from scara_effmass.errors import EffmassError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

_PR_SET_PDEATHSIG = 1
END_WITHIN_S = 30.0
DOMAINS = 101
"""Up to 101 the ports of a domain lie below those that Linux hands out by itself."""
_PARTICIPANTS = 16
"""So many of the first places of a domain are looked at."""


class ChildProcess:
    """A running `scara-effmass` command, whose output is kept."""

    def __init__(self, words: Sequence[str]) -> None:
        """Start it, in a session of its own: an interrupt at the terminal reaches it only through its owner."""
        self._name = words[0]
        self._output = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the process
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115
        self._process = subprocess.Popen(  # noqa: S603 - this very program
            [sys.executable, "-m", "scara_effmass", *words],
            stdin=subprocess.DEVNULL,
            stdout=self._output,
            stderr=self._errors,
            start_new_session=True,
            preexec_fn=_end_with_parent,  # noqa: PLW1509 - no thread runs yet where commands are started
        )

    @property
    def ended(self) -> bool:
        """Whether it has ended by itself."""
        return self._process.poll() is not None

    def output(self) -> str:
        """Return what it printed. Raises EffmassError, with its own line, when it failed."""
        if self._process.wait() != 0:
            self.fail()
        self._output.seek(0)
        return self._output.read().decode()

    def finish(self) -> str:
        """Tell it to stop, as Ctrl-C would, and return what it printed. Raises EffmassError when it failed."""
        self._interrupt()
        return self.output()

    def fail(self) -> None:
        """Raise EffmassError for a command that ended when it should not."""
        self._errors.seek(0)
        lines = self._errors.read().decode(errors="replace").strip().splitlines()
        reason = lines[-1] if lines else f"exit code {self._process.returncode}"
        raise EffmassError(f"{self._name} has ended: {reason}")

    def end(self) -> None:
        """End it as Ctrl-C would, and forget what it printed."""
        self._interrupt()
        self._output.close()
        self._errors.close()

    def _interrupt(self) -> None:
        """Interrupt it, and end it by force if it does not listen."""
        if self.ended:
            return
        self._process.send_signal(signal.SIGINT)
        try:
            self._process.wait(END_WITHIN_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def _end_with_parent() -> None:
    """Have Linux send SIGTERM to this process when its parent dies, even by SIGKILL: nodes must not outlive a demo."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def require_running(processes: Iterable[ChildProcess]) -> None:
    """Raise EffmassError with the line of a command that has ended."""
    for process in processes:
        if process.ended:
            process.fail()


@contextmanager
def child_process(words: Sequence[str]) -> Iterator[ChildProcess]:
    """Run a `scara-effmass` command beside a `with`, at whose end it is ended."""
    process = ChildProcess(words)
    try:
        yield process
    finally:
        process.end()


def keep_to_this_machine() -> None:
    """Give this process and those it starts a ROS domain of their own, not found from elsewhere.

    A recorded motion must never reach the nodes of a real cell.
    """
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    domains = (1 + (os.getpid() + turn) % DOMAINS for turn in range(DOMAINS))
    os.environ["ROS_DOMAIN_ID"] = str(next(filter(domain_is_free, domains), 1 + os.getpid() % DOMAINS))


def domain_is_free(domain: int) -> bool:
    """Return whether nobody on this machine is in a ROS domain: whether its first ports are free."""
    for participant in range(_PARTICIPANTS):
        with socket.socket(type=socket.SOCK_DGRAM) as place:
            try:
                place.bind(("", 7400 + 250 * domain + 10 + 2 * participant))
            except OSError:
                return False
    return True

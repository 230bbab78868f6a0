# SPDX-License-Identifier: Apache-2.0
"""End a process that stands still, also where a thread holds Python's lock and no signal handler can run.

The guard is a child process that runs this file: no thread of the guarded process is as independent of its locks. It
imports nothing but the standard library.
"""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
from contextlib import suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from typing_extensions import Self

_TICK_S = 0.5


class HangGuard:
    """Kills this process with SIGKILL, and prints `line`, if `beat` is not called for `timeout_s`. Use it in a `with`.

    Time for which the process is stopped (SIGSTOP, Ctrl-Z, a debugger) does not count.
    """

    def __init__(self, timeout_s: float, line: str) -> None:
        self._timeout_s, self._line = timeout_s, line
        self._pipe = -1

    def beat(self) -> None:
        """State that the process is at work."""
        with suppress(OSError):  # the guard has not started, or someone has stopped or ended it
            os.write(self._pipe, b".")

    def __enter__(self) -> Self:
        reader, self._pipe = os.pipe()
        os.set_blocking(self._pipe, False)
        self._child = subprocess.Popen(  # noqa: S603 - this file
            [sys.executable, "-I", "-S", __file__, str(os.getpid()), str(self._timeout_s), self._line],
            stdin=reader,
            stdout=subprocess.DEVNULL,
            start_new_session=True,  # no Ctrl-C of the terminal
        )
        os.close(reader)
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._pipe)
        self._child.kill()
        self._child.wait()


def _is_stopped(pid: int) -> bool:
    try:
        with open(f"/proc/{pid}/stat", encoding="utf-8") as file:  # noqa: PTH123 - pathlib takes time to import
            return file.read().rpartition(")")[2].split()[0] in "tT"
    except (OSError, IndexError):
        return False


def _guard(pid: int, timeout_s: float, line: str) -> None:
    """Kill the process `pid` if stdin gives nothing for `timeout_s`; return when stdin ends."""
    silent_s = 0.0  # counted in ticks, so that a suspended machine or a stopped guard adds at most one
    while silent_s < timeout_s:
        if select.select([0], [], [], _TICK_S)[0]:
            if not os.read(0, 65536):
                return
            silent_s = 0.0
        elif not _is_stopped(pid):
            silent_s += _TICK_S
    print(line, file=sys.stderr)  # noqa: T201
    os.kill(pid, signal.SIGKILL)


if __name__ == "__main__":
    _guard(int(sys.argv[1]), float(sys.argv[2]), sys.argv[3])

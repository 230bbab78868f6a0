# SPDX-License-Identifier: Apache-2.0
"""Processes of the package as forks of one that has imported what they need, which takes each seconds by itself.

They are processes as others: with their own ROS context, environment, pipes, signals and exit code. What a start by
the interpreter does, the tests of installation, entry points and documentation show.
"""

import atexit
import ctypes
import gc
import json
import os
import random
import signal
import socket
import subprocess
import sys
import threading
import traceback
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

NODES = ("monitor", "daq", "speed_scaling", "validator", "visualization")
SCRIPTS = {e.name: e for e in entry_points(group="console_scripts") if e.value.startswith("scara_effmass.")}
SCRIPT_FOLDERS = {Path(sys.executable).parent, Path(sys.prefix, "lib", "scara_effmass")}
MODULE = (sys.executable, "-m", "scara_effmass")
READ_AT_IMPORT = ("LD_", "NUMBA_", "OMP_", "OPENBLAS_", "PATH", "PYTHON", "XDG_CACHE_HOME", "HOME")
AT_START = dict(os.environ)
"""Environment of the server, before a test changes it."""
PR_SET_CHILD_SUBREAPER = 36


def can_fork(command: list[str], environment: Mapping[str, str]) -> bool:
    """Return whether a fork does what `command` does, with what libraries read when they are imported."""
    is_known = tuple(command[:3]) == MODULE or (
        Path(command[0]).parent in SCRIPT_FOLDERS and Path(command[0]).name in SCRIPTS
    )
    names = {name for name in {*environment, *os.environ} if name.startswith(READ_AT_IMPORT)}
    return is_known and all(environment.get(name) == AT_START.get(name) for name in names)


@cache
def _server() -> tuple[socket.socket, subprocess.Popen[bytes]]:
    """Start the process that forks, until its socket is closed."""
    own, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with other:
        descriptor = other.fileno()
        words = [sys.executable, __file__, str(descriptor)]
        return own, subprocess.Popen(words, pass_fds=[descriptor], env=AT_START)


class Forked(subprocess.Popen[str]):
    """A process that the server forks; commands that it does not know start as usual."""

    def _execute_child(self, args: Any, executable: Any, preexec_fn: Any, *more: Any) -> None:  # noqa: ANN401
        request, streams = as_request(args, more)
        if preexec_fn or not can_fork(request["command"], request["environment"]):
            super()._execute_child(args, executable, preexec_fn, *more)  # type: ignore[misc]
            return
        server, _ = _server()
        # The fork becomes a child of this process. Other orphans must not, since nothing here waits for them.
        ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1)
        socket.send_fds(server, [json.dumps(request).encode()], streams)
        self.pid = int(server.recv(64))
        ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 0)
        self._child_created = True
        self._close_pipe_fds(*more[7:13])  # type: ignore[attr-defined]


def as_request(args: Any, more: Sequence[Any]) -> tuple[dict[str, Any], list[int]]:  # noqa: ANN401
    """Return what the fork has to do, and its standard streams, from the arguments of `_execute_child`."""
    _, _, folder, environment, _, _, _, p2cread, _, _, c2pwrite, _, errwrite, _, _, _, _, _, new_session, *_ = more
    request = {
        "command": [str(word) for word in args],
        "environment": dict(os.environ if environment is None else environment),
        "folder": str(folder or Path.cwd()),
        "new_session": new_session,
    }
    return request, [max(p2cread, 0), c2pwrite if c2pwrite >= 0 else 1, errwrite if errwrite >= 0 else 2]


def fork_child(self: Any, args: Any, executable: Any, preexec_fn: Any, *more: Any) -> None:  # noqa: ANN401
    """Start a child of a fork as a fork of that one, unless it has other threads, as those of DDS."""
    if len([*Path("/proc/self/task").iterdir()]) > 1:
        subprocess.Popen._execute_child(self, args, executable, preexec_fn, *more)  # type: ignore[attr-defined]  # noqa: SLF001
        return
    request, streams = as_request(args, more)
    sys.stdout.flush()
    self.pid = os.fork()
    if self.pid == 0:
        for number, stream in enumerate(streams):
            os.dup2(stream, number)
        sys.stdout = sys.__stdout__  # which the command of the parent has replaced
        preexec_fn()
        run_to_end(request)
    self._child_created = True
    self._close_pipe_fds(*more[7:13])


def serve(connection: socket.socket) -> dict[str, Any] | None:
    """Fork for each request, and return it in the fork; return None if nobody asks any more."""
    while True:
        message, streams, _, _ = socket.recv_fds(connection, 1 << 20, 3)
        if not message:
            return None
        read, write = os.pipe()
        if (between := os.fork()) == 0:
            if (pid := os.fork()) == 0:
                for number, stream in enumerate(streams):
                    os.dup2(stream, number)
                for descriptor in (*streams, read, write, connection.detach()):
                    os.close(descriptor)
                request: dict[str, Any] = json.loads(message)
                return request
            os.write(write, str(pid).encode())
            os._exit(0)
        os.waitpid(between, 0)  # the fork has another parent now
        connection.send(os.read(read, 64))
        for descriptor in (*streams, read, write):
            os.close(descriptor)


def import_all() -> None:
    """Import what the nodes need, and load the kernel; let a demo fork its nodes too."""
    from scara_effmass.cli.processes import ChildProcess  # noqa: PLC0415
    from scara_effmass.model.load import load_robot  # noqa: PLC0415
    from scara_effmass.reference.dynamics import RobotDynamics  # noqa: PLC0415
    from scara_effmass.safety.monitor import Monitor  # noqa: PLC0415
    from scara_effmass.settings import MonitorSettings  # noqa: PLC0415
    from scara_effmass.share import share  # noqa: PLC0415

    for node in NODES:
        import_module(f"scara_effmass.nodes.{node}_node")
    for path in Path(__file__).parents[1].glob("scara_effmass/cli/[a-z]*.py"):
        import_module(f"scara_effmass.cli.{path.stem}")
    ChildProcess._execute_child = fork_child  # type: ignore[attr-defined]  # noqa: SLF001
    settings = MonitorSettings()
    Monitor(RobotDynamics(load_robot(share("config", "omron_i4_550l.yaml"), settings)), settings)


def run(request: dict[str, Any]) -> int:
    """Run the command in this process."""
    os.environ.clear()
    os.environ.update(request["environment"])
    os.chdir(request["folder"])
    if request["new_session"]:
        os.setsid()
    signal.signal(signal.SIGINT, signal.default_int_handler)
    random.seed()
    command = request["command"]
    if tuple(command[:3]) == MODULE:
        module = import_module("scara_effmass.__main__")
        sys.argv, main = [str(module.__file__), *command[3:]], module.main
    else:
        sys.argv = command
        main = SCRIPTS[Path(command[0]).name].load()
    return int(main() or 0)


def run_to_end(request: dict[str, Any]) -> None:
    """Run the command and end this process as the interpreter does."""
    try:
        code = run(request)
    except SystemExit as ending:
        code = ending.code if isinstance(ending.code, int) else 0
    except BaseException:  # noqa: BLE001 - as the interpreter does
        traceback.print_exc()
        code = 1
    end(code)


def end(code: int) -> None:
    """End as the interpreter does, but for the destructors of libraries, which wait for threads that a fork lacks."""
    threading._shutdown()  # type: ignore[attr-defined]  # noqa: SLF001
    atexit._run_exitfuncs()  # noqa: SLF001
    with suppress(OSError):
        sys.stdout.flush()
    os._exit(code)


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    import_all()
    gc.freeze()  # else each fork copies the memory of all imports at its first collection
    if asked := serve(socket.socket(fileno=int(sys.argv[1]))):
        run_to_end(asked)

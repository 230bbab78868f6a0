# SPDX-License-Identifier: Apache-2.0
"""Child processes of a demo: commands of the suite in a ROS domain of their own."""

import argparse
import ctypes
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import IO, Any

from scara_effmass.cli.displays import has_display
from scara_effmass.cli.nodes import node_arguments
from scara_effmass.cli.options import SHOWN, options_of, selected
from scara_effmass.errors import EffmassError
from scara_effmass.extras import pip_line
from scara_effmass.nodes.cell_client import CellClient
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


class ChildProcess(subprocess.Popen[bytes]):
    """A running `scara-effmass` command with captured output; use it in a `with`, which ends it."""

    def __init__(self, command: Sequence[str]) -> None:
        """Start the command in a new session, so that Ctrl-C at the terminal reaches this process only."""
        self._name = command[0]
        self._output, self._errors = tempfile.TemporaryFile(), tempfile.TemporaryFile()  # noqa: SIM115 - until the end
        super().__init__(
            [sys.executable, "-m", "scara_effmass", *command],
            stdin=subprocess.DEVNULL,
            stdout=self._output,
            stderr=self._errors,
            start_new_session=True,
            preexec_fn=_end_with_parent,
        )

    def __exit__(self, *_error: object) -> None:
        self.interrupt()
        self._output.close()
        self._errors.close()

    @property
    def ended(self) -> bool:
        """Whether the process has ended."""
        return self.poll() is not None

    def interrupt(self) -> None:
        """Interrupt the process if it runs, and kill it if it does not end in time."""
        self.send_signal(signal.SIGINT)  # sends nothing to a process that has ended
        try:
            self.wait(STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self.kill()
            self.wait()

    def output(self) -> str:
        """Wait for the end of the process and return its stdout. Raises EffmassError if it failed."""
        if self.wait() != 0:
            self.fail()
        return _text(self._output)

    def recording(self) -> dict[str, Any]:
        """End `record --json` and return its report, with lost messages or not. Raises EffmassError if it failed."""
        self.interrupt()
        text = _text(self._output)
        report: dict[str, Any] = json.loads(text) if text else {}
        if not report or report["stopped_by_disk"]:
            self.fail()
        return report

    def fail(self) -> None:
        """Raise EffmassError with the last line that the process wrote to stderr."""
        lines = _text(self._errors).strip().splitlines()
        raise EffmassError(f"{self._name} has ended: {lines[-1] if lines else f'exit code {self.returncode}'}")


def _text(file: IO[bytes]) -> str:
    file.seek(0)
    return file.read().decode(errors="replace")


def _end_with_parent() -> None:
    """Have Linux send SIGTERM to this process when its parent dies, even by SIGKILL: no node outlives a demo."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def spin_until(
    done: Callable[[], bool], client: CellClient, processes: Sequence[ChildProcess], timeout_s: float, name: str = ""
) -> None:
    """Receive until `done` or the timeout. Raises EffmassError for an ended process, and if `name` is not running."""
    is_done = client.spin(timeout_s, lambda: done() or any(process.ended for process in processes))
    for process in processes:
        if process.ended:
            process.fail()
    if name and not is_done:
        raise EffmassError(f"{name}: not running after {timeout_s:g} s")


@contextmanager
def removed_on_failure(folder: Path) -> Iterator[None]:
    """Remove `folder` if the `with` block raises."""
    try:
        yield
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise


def commands(args: argparse.Namespace, settings: MonitorSettings) -> list[list[str]]:
    """Return the commands of every demo: the recorder, the monitor, and the markers of the robot for viewers."""
    params = ["--params", str(args.params)] if args.params else []
    chosen = {"robot": str(settings.robot_path), "effective_mass_model": settings.effective_mass_model.value}
    shown = settings.model_dump(mode="json", include={*SHOWN}, exclude_unset=True)
    return [
        ["record", "-o", str(args.out / RECORDING), "--json", *(["--force"] * args.force), *SIM_TIME],
        ["monitor", *params, *node_arguments(None, selected(args, "cell") | chosen, SIM_TIME)],
        ["visualization", *node_arguments(None, shown | {"robot": str(settings.robot_path)}, SIM_TIME)],
    ]


def recorded_line(recorded: dict[str, Any]) -> str:
    """Return one line about a recording: messages, losses by topic, and its path."""
    losses = [(name, sum(topic["lost"].values())) for name, topic in recorded["topics"].items()]
    of = ", ".join(f"{count} of {name}" for name, count in losses if count)
    lost = f"{recorded['lost']} lost{f' ({of})' * bool(of)}"
    return f"{recorded['messages']} messages, {lost}: {recorded['bag']}"


def dashboard_command(args: argparse.Namespace) -> tuple[list[str], str]:
    """Return the command of the dashboard and its address, or no command and the reason."""
    if not find_spec("nicegui"):
        return [], f"needs NiceGUI: {pip_line('nicegui')}"
    if not (has_display() or sys.stdout.isatty()):
        return [], "not started: there is no display and no terminal"
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    params = ["--params", str(args.params)] if args.params else []
    options = ((option.names[0], getattr(args, option.dest) or ()) for option in options_of("contact_point"))
    params += [f"{name}={value}" for name, values in options for value in values]
    return ["dashboard", "--open", "--port", str(port), *params], f"http://127.0.0.1:{port}/ until the demo ends"


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

# SPDX-License-Identifier: Apache-2.0
"""A process that stands still is ended, even where it holds Python's lock; one that was stopped goes on."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytestmark = pytest.mark.live

BEATS = """
import ctypes, sys, time
from scara_effmass.nodes.hang_guard import HangGuard
with HangGuard(1.5, "run1: stands still") as guard:
    print("begun", flush=True)
    end = time.monotonic() + {seconds}
    while time.monotonic() < end:
        guard.beat()
        time.sleep(0.05)
    {then}
print("ended", flush=True)
"""


def start(seconds: float, then: str = "pass") -> subprocess.Popen[str]:
    code = BEATS.format(seconds=seconds, then=then)
    return subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.parametrize("then", ["ctypes.PyDLL(None).sleep(60)", "time.sleep(60)"])
def test_standing_still_ends_the_process(then: str) -> None:
    process = start(0.2, then)
    process.send_signal(0)
    output, errors = process.communicate(timeout=20)
    assert (process.returncode, output, errors) == (-signal.SIGKILL, "begun\n", "run1: stands still\n")


def test_a_stop_is_no_hang_and_the_end_leaves_nothing() -> None:
    process = start(4.0)
    assert process.stdout is not None
    assert process.stdout.readline() == "begun\n"
    os.kill(process.pid, signal.SIGSTOP)
    time.sleep(3.0)
    os.kill(process.pid, signal.SIGCONT)
    output, errors = process.communicate(timeout=20)
    assert (process.returncode, output, errors) == (0, "ended\n", "")


RECORD = """
import ctypes, sys, time
from pathlib import Path
from rclpy.context import Context
from scara_effmass.nodes.record import record
hang = {"lock": ctypes.PyDLL(None).sleep, "executor": time.sleep, "end of ROS": time.sleep}[sys.argv[2]]
if sys.argv[2] == "end of ROS":
    Context.try_shutdown = lambda *_: hang(60)
    record(Path(sys.argv[1]), hang_timeout_s=2.0, duration_s=0.5)
record(Path(sys.argv[1]), hang_timeout_s=2.0, progress=lambda *_: hang(60))
"""


@pytest.mark.parametrize("hang", ["lock", "executor", "end of ROS"])
@pytest.mark.usefixtures("own_domain")
def test_a_recorder_that_stands_still_is_ended_and_named(tmp_path: Path, hang: str) -> None:
    bag = tmp_path / "run"
    arguments = [sys.executable, "-c", RECORD, str(bag), hang]
    result = subprocess.run(arguments, capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode == -signal.SIGKILL
    assert f"{bag}: the recorder has stood still for 2 s and is killed" in result.stderr
    assert f"record --repair {bag}" in result.stderr

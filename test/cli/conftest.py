# SPDX-License-Identifier: Apache-2.0
"""Recordings, and the command line in this process or in one of its own."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from scara_effmass.bags.writer import BagWriter
from scara_effmass.cli import main
from scara_effmass.values import JointState
from test.forked import Forked

Cli = Callable[..., subprocess.CompletedProcess[str]]
Refused = Callable[..., str]

START_NS = 1_767_225_600_000_000_000
STEP_NS = 2_000_000
JOINTS = ("joint1", "joint2", "joint3", "joint4")


def swing(count: int) -> Iterator[JointState]:
    """Yield joint states of the shipped robot every `STEP_NS`, some below and some above the allowable speed."""
    t = np.arange(count) * STEP_NS / 1e9
    swell = 0.5 + 0.4 * np.sin(0.7 * t)
    q = np.stack(
        (swell * np.sin(2.0 * t), 1.2 + 0.5 * np.cos(1.5 * t), 0.2 + 0.01 * np.sin(t), 0.1 * np.sin(t)), axis=1
    )
    qd = np.gradient(q, t, axis=0)
    for number in range(count):
        yield JointState(START_NS + number * STEP_NS, JOINTS, q[number], qd[number])


def swing_recording(path: Path, count: int) -> Path:
    """Write `count` joint states of `swing` to the recording `path`; return it."""
    with BagWriter(path) as bag:
        bag.write_joint_states("/joint_states", swing(count))
    return path


@pytest.fixture(scope="session")
def swing_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of 2 s at 500 Hz."""
    return swing_recording(tmp_path_factory.mktemp("bags") / "swing", 1000)


@pytest.fixture(scope="session")
def long_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of 60 s at 500 Hz, which takes seconds to assess."""
    return swing_recording(tmp_path_factory.mktemp("bags") / "long.mcap", 30_000)


@pytest.fixture
def cli_process(tmp_path: Path, domain: dict[str, str]) -> Cli:
    """Run `python -m scara_effmass` in a process of its own, in an empty folder."""

    def run(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "scara_effmass", *map(str, arguments)]
        with Forked(
            command, cwd=tmp_path, env=domain, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        ) as process:
            output, errors = process.communicate()
        return subprocess.CompletedProcess(command, process.returncode, output, errors)

    return run


@pytest.fixture
def cli(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Cli:
    """Run a command in this process, in an empty folder."""

    def run(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr("faulthandler.enable", lambda: None)  # by rclpy; captured stderr has no descriptor
        command = [str(argument) for argument in arguments]
        try:
            code = main(command)
        except SystemExit as end:  # argparse
            code = int(end.code or 0)
        output, errors = capsys.readouterr()
        return subprocess.CompletedProcess(command, code, output, errors)

    return run


@pytest.fixture
def refused(cli: Cli, tmp_path: Path) -> Refused:
    """Run a command that must fail with exit code 2, write no file, and print one line, which is returned."""

    def run(*arguments: str | Path) -> str:
        def files() -> dict[Path, int]:
            return {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}

        before = files()
        done = cli(*arguments)
        assert (done.returncode, done.stdout) == (2, ""), done.stderr
        (line,) = done.stderr.splitlines()
        assert files() == before
        return line

    return run


@pytest.fixture
def domain(own_domain: int) -> dict[str, str]:  # noqa: ARG001 - sets os.environ
    """Environment with a ROS domain of this test, on this machine."""
    return dict(os.environ)


@pytest.fixture
def start(domain: dict[str, str]) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Start `python -m scara_effmass` with arguments; kill it at the end of the test if it still runs."""
    with ExitStack() as running:

        def run(*arguments: str | Path) -> subprocess.Popen[str]:
            words = [sys.executable, "-m", "scara_effmass", *map(str, arguments)]
            process = Forked(words, env=domain, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
            running.enter_context(process)
            running.callback(process.kill)
            return process

        yield run

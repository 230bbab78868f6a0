"""The command line as a user has it: a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import TYPE_CHECKING

import numpy as np
import pytest

from scara_effmass.bag_io.writer import BagWriter
from scara_effmass.cli import main
from scara_effmass.values import JointState

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    Cli = Callable[..., subprocess.CompletedProcess[str]]

START_NS = 1_767_225_600_000_000_000
STEP_NS = 2_000_000
JOINTS = ("joint1", "joint2", "joint3", "joint4")


def swing(count: int) -> Iterator[JointState]:
    """Yield a swing of the shipped robot, slow and too fast by turns, `STEP_NS` apart."""
    t = np.arange(count) * STEP_NS / 1e9
    swell = 0.5 + 0.4 * np.sin(0.7 * t)
    q = np.stack(
        (swell * np.sin(2.0 * t), 1.2 + 0.5 * np.cos(1.5 * t), 0.2 + 0.01 * np.sin(t), 0.1 * np.sin(t)), axis=1
    )
    qd = np.gradient(q, t, axis=0)
    for number in range(count):
        yield JointState(START_NS + number * STEP_NS, JOINTS, q[number], qd[number])


@pytest.fixture(scope="session")
def swing_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of 2 s at 500 Hz."""
    path = tmp_path_factory.mktemp("bags") / "swing"
    with BagWriter(path) as bag:
        bag.write_joint_states("/joint_states", swing(1000))
    return path


@pytest.fixture(scope="session")
def long_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of 60 s at 500 Hz, which takes seconds to assess."""
    path = tmp_path_factory.mktemp("bags") / "long.mcap"
    with BagWriter(path) as bag:
        bag.write_joint_states("/joint_states", swing(30_000))
    return path


@pytest.fixture
def cli(tmp_path: Path) -> Cli:
    """Run `python -m scara_effmass` with arguments, in an empty folder."""

    def run(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "scara_effmass", *map(str, arguments)],
            cwd=tmp_path,
            env=quiet_environment(),
            capture_output=True,
            text=True,
            timeout=50,
            check=False,
        )

    return run


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Cli:
    """Do the same as `cli` within this process, which is faster."""

    def run(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
        monkeypatch.chdir(tmp_path)
        words = [str(argument) for argument in arguments]
        code = main(words)
        output, errors = capsys.readouterr()
        return subprocess.CompletedProcess(words, code, output, errors)

    return run


@pytest.fixture
def domain() -> dict[str, str]:
    """The environment of `cli`."""
    return quiet_environment()


def quiet_environment() -> dict[str, str]:
    """Return an environment that keeps ROS on this machine, in a domain of this test process."""
    own = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": str(1 + os.getpid() % 101)}
    return {**os.environ, **own}

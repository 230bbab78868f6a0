"""How the monitor starts and ends: one line and 2 for what it cannot use, 0 for every way of being told to stop."""

from __future__ import annotations

import signal
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from conftest import Cell

PARAMS = "/**:\n  ros__parameters:\n    {}\n"


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        ("-p nonsense:=1", "monitor: no parameter 'nonsense': it has robot, await_robot_description"),
        ("--params-file {typo}", "monitor: no parameter 'time_out': it has robot,"),
        ("-p timeout:=1", "monitor: timeout = 1: must be DOUBLE, is INTEGER: write 1.0"),
        ("-p timeout:=.nan", "monitor: timeout = nan: must be 0 to 60"),
        ("-p mass_cap:=0.0", "monitor: mass_cap = 0.0: Input should be greater than"),
        ("-p contact_points:=tool", "monitor: contact_points = 'tool': must be STRING_ARRAY, is STRING"),
        ("-p contact:=never", "monitor: contact = 'never': Input should be 'transient' or 'quasi_static'"),
        ("-p body_regions:=[face]", "body_regions = 'face': the standard gives no transient limit"),
        ("-p max_force:=1000.0", "max_force = 1000 N: looser than the standard's"),
        ("-p robot:={missing}", "{missing}: cannot be read: No such file or directory"),
        ("-p robot:={typo}", "{typo}: robot: Field required"),
        ("-p contact_points:=[nose]", "no contact point 'nose': it has tool"),
        ("-p await_robot_description:=true -p robot:=a.urdf", "monitor: robot = 'a.urdf': must be empty with await_robot"),
        ("-p qos_overrides./joint_states.subscription.reliability:=often", "monitor: qos_overrides: "),
        ("--params-file {missing}", "ROS arguments: "),
        ("--params-file {broken}", "ROS arguments: "),
        ("--no-such-option", "ROS arguments: ['--no-such-option']"),
        ("-p timeout", "ROS arguments: "),
        ("-- timeout:=0.1", "'timeout:=0.1': not known; ROS arguments stand behind --ros-args"),
    ],
)
def test_what_it_cannot_use_is_one_line_and_2(
    new_cell: Callable[..., Cell], tmp_path: Path, arguments: str, line: str
) -> None:
    paths = {name: tmp_path / f"{name}.yaml" for name in ("missing", "typo", "broken")}
    paths["typo"].write_text(PARAMS.format("time_out: 1.0"), encoding="utf-8")
    paths["broken"].write_text("/**: [1\n", encoding="utf-8")
    cell = new_cell("--ros-args", *arguments.format(**paths).split())
    assert cell.process is not None
    output, errors = cell.process.communicate(timeout=25)
    (only,) = [text for text in (output + errors).splitlines() if not text.startswith("[INFO]")]
    assert line.format(**paths) in only
    assert cell.process.returncode == 2


def test_help_needs_no_ros(new_cell: Callable[..., Cell]) -> None:
    process = new_cell("--help").process
    assert process is not None
    output, errors = process.communicate(timeout=25)
    assert (process.returncode, errors) == (0, "")
    assert output.startswith("usage: monitor_node [--ros-args ...]")


@pytest.mark.parametrize(
    "signals",
    [[signal.SIGINT], [signal.SIGTERM], [signal.SIGINT, signal.SIGINT], [signal.SIGTERM, signal.SIGINT]],
    ids=["SIGINT", "SIGTERM", "SIGINT twice", "SIGTERM, SIGINT"],
)
@pytest.mark.parametrize("command", [None, "-m scara_effmass monitor"], ids=["node", "command line"])
def test_ends_with_0_when_told_to(
    new_cell: Callable[..., Cell], command: str | None, signals: list[signal.Signals]
) -> None:
    cell = new_cell()
    process = cell.start(**{} if command is None else {"command": (sys.executable, *command.split())})
    cell.listen()
    cell.until(lambda: cell.contacts)  # the silence of the first fifth of a second
    for number in signals:
        process.send_signal(number)
    output, errors = process.communicate(timeout=25)
    assert process.returncode == 0
    assert "Traceback" not in output + errors
    assert "Exception ignored" not in output + errors


def test_ends_with_0_while_it_starts(new_cell: Callable[..., Cell]) -> None:
    """Told between its first word and its last: the context goes away under whatever is being made."""
    process = new_cell("--ros-args", "-p", "autostart:=true").process
    assert process is not None
    assert process.stderr is not None
    assert "watching omron_i4_550l" in process.stderr.readline()
    process.send_signal(signal.SIGINT)
    errors = process.stderr.read()
    assert process.wait(timeout=25) == 0
    assert "Traceback" not in errors


def test_module_is_importable_without_starting_ros() -> None:
    check = "import scara_effmass.nodes.monitor_node, rclpy; raise SystemExit(rclpy.ok())"
    assert subprocess.run([sys.executable, "-c", check], check=False).returncode == 0

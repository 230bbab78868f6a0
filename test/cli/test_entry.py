"""What holds for every command: help, version, one line per refusal, signals, nothing imported in vain."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from scara_effmass import __version__
from scara_effmass.cli import COMMANDS, main
from scara_effmass.share import share

if TYPE_CHECKING:
    from collections.abc import Callable

    Cli = Callable[..., subprocess.CompletedProcess[str]]

HEAVY = ("rclpy", "pinocchio", "matplotlib", "pyarrow", "rosbags", "scara_effmass_msgs")
LOADED_BY_HELP = """
import json, sys
from scara_effmass.cli import main
try:
    main(sys.argv[1:])
except SystemExit:
    pass
print(json.dumps([name for name in {heavy!r} if name in sys.modules]), file=sys.stderr)
"""


@pytest.mark.live
@pytest.mark.parametrize("words", [["--help"], *([name, "--help"] for name in COMMANDS)], ids=" ".join)
def test_help_loads_nothing_heavy(words: list[str]) -> None:
    code = LOADED_BY_HELP.format(heavy=HEAVY)
    done = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("usage: scara-effmass")
    assert json.loads(done.stderr) == []


@pytest.mark.parametrize("command", COMMANDS)
def test_help_shows_examples_that_begin_with_the_command(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main([command, "--help"])
    assert ended.value.code == 0
    examples = capsys.readouterr().out.partition("examples:\n")[2].strip().splitlines()
    assert examples
    assert all(example.strip().startswith("scara-effmass ") for example in examples)
    assert any(example.split()[1] == command for example in examples)


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["--version"])
    assert ended.value.code == 0
    assert capsys.readouterr().out == f"scara-effmass {__version__}\n"


@pytest.mark.live
def test_the_console_script_is_the_module() -> None:
    script = Path(sys.executable).with_name("scara-effmass")
    done = subprocess.run([script, "--version"], capture_output=True, text=True, check=True)
    assert done.stdout == f"scara-effmass {__version__}\n"


def test_without_a_command_the_help_is_shown_and_that_is_an_error(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    assert "COMMAND" in capsys.readouterr().out


TOUR = str(share("bags", "tour"))
ROBOT = str(share("config", "omron_i4_550l.yaml"))

REFUSALS: dict[str, tuple[list[str], str]] = {
    "unknown command": (["walk"], "invalid choice: 'walk'"),
    "unknown option": (["limits", "--colour"], "--colour"),
    "missing argument": (["assess", TOUR], "-o/--output"),
    "unknown model": (["doctor", "--model", "heavy"], "'heavy'"),
    "unknown region": (["limits", "--region", "tail"], "body_regions = 'tail': must be one of skull"),
    "region without a limit": (["limits", "--region", "face"], "no transient limit"),
    "mass that is none": (["limits", "--mass", "nan"], "argument --mass: nan: must be a number >= 1e-06 kg"),
    "ROS arguments where no node runs": (["limits", "--ros-args", "-p", "a:=1"], "--ros-args"),
    "missing robot": (["doctor", "--robot", "no.urdf"], "no.urdf: no such file; must be a URDF or DH YAML file"),
    "missing parameters": (["assess", TOUR, "-o", "a.csv", "--params", "no.yaml"], "no.yaml: cannot be read"),
    "missing parameters of a node": (["monitor", "--params", "no.yaml"], "no.yaml: cannot be read"),
    "missing bag": (["assess", "no.mcap", "-o", "a.csv"], "no.mcap: does not exist"),
    "not a bag": (["assess", ROBOT, "-o", "a.csv"], "is not a bag; expected MCAP"),
    "wrong topic": (
        ["assess", TOUR, "-o", "a.csv", "--topic", "/arm"],
        "no joint states on /arm; --topic must be one",
    ),
    "wrong topic of a demo": (
        ["demo", "--bag", TOUR, "--topic", "/arm"],
        "no joint states on /arm; --topic must be one of /joint_states",
    ),
    "topic of a demo without a bag": (["demo", "--topic", "/arm"], "demo: --topic = /arm: the simulated cell has"),
    "robot of a demo without a bag": (
        ["demo", "--robot", ROBOT],
        "demo: --robot: the simulated cell has its own robot",
    ),
    "region of an assessment": (["assess", TOUR, "-o", "a.csv", "--region", "tail"], "must be one of skull"),
    "wrong suffix": (["assess", TOUR, "-o", "a.xls"], "must be one of .parquet, .csv, .mcap"),
    "unwritable folder": (["assess", TOUR, "-o", "/proc/none/a.csv"], "/proc/none/a.csv: cannot be written"),
    "unwritable folder for a bag": (
        ["assess", TOUR, "-o", "/proc/none/a.mcap"],
        "/proc/none/a.mcap: cannot be written",
    ),
    "negative rate": (["replay", TOUR, "--rate", "-1"], "rate = -1.0: must be 0 or more"),
    "missing bag to replay": (["replay", "no.mcap"], "no.mcap: does not exist"),
}


@pytest.mark.parametrize("name", REFUSALS)
def test_a_refusal_is_one_line_and_exit_code_2(name: str, refused: Callable[..., str]) -> None:
    arguments, expected = REFUSALS[name]
    assert expected in refused(*arguments)


def test_parameters_are_checked_with_file_key_and_value(cli: Cli, tmp_path: Path) -> None:
    file = tmp_path / "cell.yaml"
    file.write_text("/**:\n  ros__parameters:\n    contact_area: -1.0\n", encoding="utf-8")
    done = cli("limits", "--params", file)
    assert done.returncode == 2
    assert done.stderr.startswith(f"{file}: contact_area = -1.0: ")


def test_options_win_over_the_parameter_file(cli: Cli, tmp_path: Path) -> None:
    file = tmp_path / "cell.yaml"
    file.write_text(
        "/**:\n  ros__parameters:\n    body_regions: [chest]\n    contact: quasi_static\n", encoding="utf-8"
    )
    from_file = json.loads(cli("limits", "--params", file, "--json").stdout)
    assert [region["name"] for region in from_file["body_regions"]] == ["chest"]
    assert from_file["contact"] == "quasi_static"
    done = json.loads(cli("limits", "--params", file, "--region", "pelvis", "--contact", "transient", "--json").stdout)
    assert [region["name"] for region in done["body_regions"]] == ["pelvis"]
    assert done["contact"] == "transient"


@pytest.mark.live
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
@pytest.mark.parametrize("suffix", [".parquet", ".csv", ".mcap"])
def test_an_interrupted_command_leaves_nothing_behind(
    number: signal.Signals, code: int, suffix: str, long_bag: Path, tmp_path: Path
) -> None:
    words = [sys.executable, "-m", "scara_effmass", "assess", str(long_bag), "-o", str(tmp_path / f"a{suffix}")]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        while process.poll() is None and not any(tmp_path.iterdir()):
            with suppress(subprocess.TimeoutExpired):
                process.wait(0.02)
        process.send_signal(number)
        output, errors = process.communicate()
    assert (output, errors) == (b"", b"")
    # Where the signal meets exec(), as in the making of a dataclass, CPython ends by the signal itself; a shell says
    # 130 to both.
    assert process.returncode in {code, -number}
    assert list(tmp_path.iterdir()) == []


@pytest.mark.live
def test_a_reader_that_has_gone_is_no_trouble() -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "scara_effmass", "limits"], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.close()
    assert process.stderr.read() == b""
    process.stderr.close()
    assert process.wait() == 1

# SPDX-License-Identifier: Apache-2.0
"""All commands: help, version, errors in one line, signals, and no slow imports for --help."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from scara_effmass import __version__
from scara_effmass.cli import main, make_parser
from scara_effmass.cli.commands import COMMANDS, NODES
from scara_effmass.cli.options import options_of
from scara_effmass.errors import OutputError
from scara_effmass.settings import MonitorSettings
from scara_effmass.share import share
from test.cli.conftest import Cli, Refused
from test.forked import Forked

HEAVY = ("rclpy", "pinocchio", "matplotlib", "pyarrow", "rosbags", "scara_effmass_msgs")
LOADED_BY_HELP = """
import json, sys
from scara_effmass.cli import main
from scara_effmass.cli.commands import COMMANDS
for arguments in ["--help"], *([*name.split(), "--help"] for name in COMMANDS):
    try:
        main(arguments)
    except SystemExit:
        loaded = [module for module in {heavy!r} if module in sys.modules]
        print(json.dumps([*arguments, *loaded]), file=sys.stderr)
"""


@pytest.mark.live
def test_help_loads_nothing_heavy() -> None:
    code = LOADED_BY_HELP.format(heavy=HEAVY)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.count("usage: scara-effmass") == 1 + len(COMMANDS)
    expected = [["--help"], *([*name.split(), "--help"] for name in COMMANDS)]
    assert [json.loads(line) for line in done.stderr.splitlines()] == expected


@pytest.mark.parametrize("command", COMMANDS)
def test_help_has_an_example_of_the_command(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main([*command.split(), "--help"])
    assert end.value.code == 0
    examples = capsys.readouterr().out.partition("examples:\n")[2].strip().splitlines()
    assert examples
    assert all(example.strip().startswith("scara-effmass ") for example in examples)
    assert any(example.strip().startswith(f"scara-effmass {command}") for example in examples)


@pytest.mark.parametrize("columns", [80, 120])
@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_help_fits_into_the_terminal(
    command: str, columns: int, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    with pytest.raises(SystemExit):
        main([*command.split(), "--help"])
    lines = [line for line in capsys.readouterr().out.splitlines() if not line.startswith("  scara-effmass ")]
    assert max(map(len, lines)) <= columns
    words = COMMANDS[command].epilog.partition("examples:")[0].split() if command else []
    assert " ".join(words) in " ".join(" ".join(lines).split())


def test_help_lists_every_command_in_one_group(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="0"):
        main(["--help"])
    words = [line.split()[0] for line in capsys.readouterr().out.splitlines() if re.match(r"  \S", line)]
    assert sorted(words) == sorted({*(name.split()[0] for name in COMMANDS), "-h,", "--version"})


def test_help_of_an_option_is_the_description_of_its_setting() -> None:
    (option,) = options_of({"--warn": {"dest": "warn_ratio"}})
    description = MonitorSettings.model_fields["warn_ratio"].description
    assert option.keywords["help"] == f"{description} (default: 0.8)"


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["--version"])
    assert end.value.code == 0
    assert capsys.readouterr().out == f"scara-effmass {__version__}\n"


@pytest.mark.live
@pytest.mark.parametrize("folder", ["bin", "lib/scara_effmass"])  # where `ros2 run` and launch files look
def test_console_script_runs_the_module(folder: str) -> None:
    script = Path(sys.prefix, folder, "scara-effmass")
    done = subprocess.run([script, "--version"], capture_output=True, text=True, check=True)
    assert done.stdout == f"scara-effmass {__version__}\n"


def test_missing_command_prints_the_help_and_exits_with_2(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    assert "COMMAND" in capsys.readouterr().out


TOUR = str(share("bags", "tour"))
NO_OUTPUT = {
    *NODES,
    "completion",
    "dashboard",
    "doctor",
    "foxglove",
    "impacts",
    "limits",
    "protocol schema",
    "replay",
    "watch",
}
ROBOT = str(share("config", "omron_i4_550l.yaml"))

REFUSALS: dict[str, tuple[list[str], str]] = {
    "unknown command": (["walk"], "invalid choice: 'walk'"),
    "unknown option": (["limits", "--colour"], "--colour"),
    "missing argument": (["assess", TOUR], "-o/--output"),
    "unknown model": (["doctor", "--model", "heavy"], "'heavy'"),
    "unknown region": (["limits", "--region", "tail"], "body_regions = 'tail': must be one of skull"),
    "region without a limit": (["limits", "--region", "face"], "permits no contact"),
    "decimal comma": (["limits", "--mass", "2,77"], "argument --mass: 2,77: must be a number >= 1e-06 kg: write 2.77"),
    "decimal comma of a stiffness": (
        ["validate", TOUR, "-o", "out", "--stiffness-n-m", "2,77"],
        "argument --stiffness-n-m: 2,77: must be a number: write 2.77",
    ),
    "two parameter files": (
        ["assess", "bag", "--params", "a.yaml", "--params", "b.yaml"],
        "--params b.yaml: must be given once, not also with a.yaml",
    ),
    "abbreviated option": (["limits", "--contact-area", "2"], "unrecognized arguments: --contact-area 2"),
    "option of other commands": (
        ["impacts", TOUR, "--topic=/f"],
        "unrecognized arguments: --topic=/f; use --force-topic",
    ),
    "pi as a mass": (["limits", "--mass", "2*pi"], "must be a number >= 1e-06 kg: write 3.14159265 for pi"),
    "parameters as a robot": (
        ["assess", TOUR, "-o", "a.csv", "--robot", str(share("config", "monitor.yaml"))],
        "monitor.yaml: holds parameters of /**/monitor: must be a robot; use --params for it",
    ),
    "device as a robot": (["assess", TOUR, "-o", "a.csv", "--robot", "/dev/zero"], "must be a regular file"),
    "robot as parameters": (["assess", TOUR, "-o", "a.csv", "--params", ROBOT], ": must hold monitor (or /**)"),
    "mass of NaN": (["limits", "--mass", "nan"], "argument --mass: nan: must be a number >= 1e-06 kg"),
    "ROS arguments of a command without a node": (["limits", "--ros-args", "-p", "a:=1"], "--ros-args"),
    "robot is a folder": (["doctor", "--robot", "/"], "/: cannot be read: must be a regular file"),
    "missing robot": (["doctor", "--robot", "no.urdf"], "no.urdf: no such file; must be a URDF or DH YAML file"),
    "missing parameters": (["assess", TOUR, "-o", "a.csv", "--params", "no.yaml"], "no.yaml: cannot be read"),
    "missing parameters of a node": (["monitor", "--params", "no.yaml"], "no.yaml: cannot be read"),
    "missing bag": (["assess", "no.mcap", "-o", "a.csv"], "no.mcap: does not exist"),
    "not a bag": (
        ["assess", ROBOT, "-o", "a.csv"],
        "is not a bag; expected MCAP, SQLite (rosbag2) or ROS 1; `scara-effmass import` converts text (CSV), TDMS",
    ),
    "wrong topic": (
        ["assess", TOUR, "-o", "a.csv", "--topic", "/arm"],
        "--topic = /arm: must be one of /",
    ),
    "wrong topic of a demo": (
        ["demo", "--bag", TOUR, "--topic", "/arm"],
        "--topic = /arm: must be one of /joint_states (sensor_msgs/msg/JointState)",
    ),
    "topic of a demo without a bag": (["demo", "--topic", "/arm"], "--topic = /arm: must come with --bag"),
    "rate of a demo without a bag": (["demo", "--rate", "2"], "--rate = 2.0: must come with --bag"),
    "topic of a cell without a bag": (["init", "--topic", "/arm"], "--topic = /arm: must come with --bag"),
    "language without a report": (
        ["assess", TOUR, "-o", "a.csv", "--language", "de"],
        "--language = de: must come with --report",
    ),
    "memory of a scheduler": (
        ["assess", TOUR, "-o", "a.csv", "--scheduler", "tcp://127.0.0.1:1", "--memory-limit", "4"],
        "--scheduler = tcp://127.0.0.1:1: must be without --jobs and --memory-limit",
    ),
    "replacement without output": (["lump", "--force"], "--force: must come with --output"),
    "replacement without a picture": (["doctor", "--force"], "--force: must come with --hulls"),
    "contact without a mass": (["limits", "--contact", "transient"], "--contact = transient: must come with --mass"),
    "quiet and verbose": (["monitor", "-q", "-v"], "--quiet: must be without --verbose"),
    "force of a protocol without a bag": (
        ["protocol", "fill", "protocol.yaml", "--force-from", "device.csv"],
        "--force-from = device.csv: must come with BAG",
    ),
    "axis of a protocol without a bag": (
        ["protocol", "fill", "protocol.yaml", "--axis", "x"],
        "--axis = x: must come with BAG",
    ),
    "points of an empty protocol": (
        ["protocol", "init", "-o", "new.yaml", "--points", "5"],
        "--points = 5: must come with --from or --map",
    ),
    "samples of a recording": (
        ["protocol", "init", "-o", "new.yaml", "--from", TOUR, "--samples", "5"],
        "--samples = 5: must come with --map",
    ),
    "topic of a protocol without a bag": (
        ["protocol", "init", "-o", "new.yaml", "--topic", "/arm"],
        "--topic = /arm: must come with --from",
    ),
    "robot of a demo without a bag": (
        ["demo", "--robot", ROBOT],
        "demo: --robot: the simulated cell has its own robot",
    ),
    "wrong suffix": (["assess", TOUR, "-o", "a.xls"], "must be one of .parquet, .csv, .mcap"),
    "unwritable folder": (["assess", TOUR, "-o", "/proc/none/a.csv"], "/proc/none/a.csv: cannot be written"),
    "unwritable folder for a bag": (
        ["assess", TOUR, "-o", "/proc/none/a.mcap"],
        "/proc/none/a.mcap: cannot be written",
    ),
    "negative rate": (["replay", TOUR, "--rate", "-1"], "argument --rate: -1: must be a number > 0"),
    "infinite rate": (["replay", TOUR, "--rate", "inf"], "argument --rate: inf: must be a number > 0"),
    "negative start": (["replay", TOUR, "--start", "-0.1"], "argument --start: -0.1: must be a number >= 0"),
    "duration of NaN": (["replay", TOUR, "--duration", "nan"], "argument --duration: nan: must be a number > 0"),
    "no subscribers": (["replay", TOUR, "--subscribers", "0"], "--subscribers: 0: must be a whole number from 1"),
    "negative wait": (["replay", TOUR, "--wait", "-1"], "argument --wait: -1: must be a number >= 0"),
    "text as a centre of mass": (
        ["doctor", "--payload-com", "0", "0", "up"],
        "--payload-com: up: must be a number",
    ),
    "two numbers as a centre of mass": (["doctor", "--payload-com", "0", "0"], "--payload-com: expected 3 arguments"),
    "payload of NaN": (["doctor", "--payload", "nan"], "argument --payload: nan: must be a number >= 0"),
    "centre of mass in mm": (["doctor", "--payload-com", "0", "0", "120"], "options: payload_com.2 = 120.0: "),
    "payload of a demo without a bag": (["demo", "--payload", "1"], "demo: payload: the simulated robot carries none"),
    "payload topic of a map": (
        ["map", "-o", "m", "--payload-topic", "load"],
        "payload_topic = 'load': must be empty for",
    ),
    "missing bag to replay": (["replay", "no.mcap"], "no.mcap: does not exist"),
}


@pytest.mark.parametrize("name", REFUSALS)
def test_invalid_input_gives_one_line_and_exit_code_2(name: str, refused: Refused) -> None:
    arguments, message = REFUSALS[name]
    assert message in refused(*arguments)


def test_refused_replay_shows_its_reason_on_a_terminal(cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)  # shows a progress bar
    done = cli("replay", "no.mcap")
    assert (done.returncode, "no.mcap: does not exist" in done.stderr) == (2, True)


@pytest.mark.parametrize(
    "command",
    [
        ["validate", "IN", "-o", "NAME"],
        ["map", "-o", "NAME"],
        pytest.param(["record", "-o", "NAME"], marks=pytest.mark.live),
        ["record", "--repair", "NAME"],
    ],
)
def test_path_that_the_system_refuses_gives_one_line(command: list[str], refused: Refused, swing_bag: Path) -> None:
    """As folders of other users do."""
    name = 300 * "x"
    line = refused(*({"IN": str(swing_bag), "NAME": name}.get(argument, argument) for argument in command))
    assert line == f"{name}: File name too long"


def test_invalid_parameter_is_named_with_file_key_and_value(cli_process: Cli, tmp_path: Path) -> None:
    file = tmp_path / "cell.yaml"
    file.write_text("/**:\n  ros__parameters:\n    contact_area_m2: -1.0\n", encoding="utf-8")
    done = cli_process("limits", "--params", file)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith(f"{file}: contact_area_m2 = -1.0: ")


def test_options_override_the_parameter_file(cli: Cli, tmp_path: Path) -> None:
    file = tmp_path / "cell.yaml"
    parameters = "/**:\n  ros__parameters:\n    body_regions: [chest]\n    contact: quasi_static\n"
    file.write_text(parameters, encoding="utf-8")
    for options, region, contact in (
        ((), "chest", "quasi_static"),
        (("--region", "pelvis", "--contact", "transient"), "pelvis", "transient"),
    ):
        result = json.loads(cli("limits", "--params", file, *options, "--json").stdout)
        assert [row["name"] for row in result["body_regions"]] == [region]
        assert result["contact"] == contact


VERDICT_OPTIONS = {
    "contact_areas",
    "max_acceleration",
    "max_joint_acceleration",
    "reaction_time",
    "contact_damping",
    "contact_friction",
    "person_speed",
    "person_direction",
    "drives",
    "contact_normal",
    "accept_assumptions",
}


@pytest.mark.parametrize("command", ["assess", "demo", "doctor", "init", "map", "monitor", "validate"])
def test_every_command_that_assesses_has_the_options_of_the_cell(command: str) -> None:
    """`validate` has no options that change the verdict alone, and not a measured impact."""
    own = {option.dest for option in COMMANDS[command].options.values()}
    cell = {option.dest for option in options_of("cell")}
    assert cell <= set(MonitorSettings.model_fields)
    assert cell - own == (VERDICT_OPTIONS if command == "validate" else set())


def test_what_fails_while_ctrl_c_is_handled_counts_as_interrupted(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As where shutil.rmtree removes a folder: it closes a descriptor twice, and a caller explains that."""

    def run(_: object) -> int:
        try:
            try:
                raise KeyboardInterrupt
            finally:
                os.close(-1)
        except OSError as error:
            raise OutputError(f"a.mcap: cannot be written: {error.strerror}") from None

    monkeypatch.setattr("scara_effmass.cli.limits.run", run)
    assert main(["limits"]) == 130
    assert capsys.readouterr() == ("", "interrupted\n")


@pytest.mark.live
@pytest.mark.parametrize(
    ("suffix", "number", "code"),
    [(".parquet", signal.SIGINT, 130), (".csv", signal.SIGTERM, 143), (".mcap", signal.SIGINT, 130)],
)
def test_interrupted_command_leaves_no_file(
    suffix: str, number: signal.Signals, code: int, long_bag: Path, tmp_path: Path
) -> None:
    slow = ["assess", str(long_bag), "-o", str(tmp_path / f"a{suffix}"), "--cross-check"]
    command = [sys.executable, "-m", "scara_effmass", *slow]
    with Forked(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        while process.poll() is None and not any(tmp_path.iterdir()):
            with suppress(subprocess.TimeoutExpired):
                process.wait(0.02)
        process.send_signal(number)
        output, errors = process.communicate()
    assert output == ""
    assert errors == ("interrupted\n" if number == signal.SIGINT else "")
    # During exec(), as in the creation of a dataclass, the signal itself ends CPython; a shell reports 130 for both.
    assert process.returncode in {code, -number}
    assert list(tmp_path.iterdir()) == []


@pytest.mark.live
def test_closed_pipe_gives_no_error_message() -> None:
    command = [sys.executable, "-m", "scara_effmass", "limits"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.close()
    assert process.stderr.read() == b""
    process.stderr.close()
    assert process.wait() == 1


@pytest.mark.live
@pytest.mark.parametrize("closed", ["<&-", ">&-", "2>&-", "<&- >&- 2>&-"])
def test_closed_streams_change_neither_status_nor_files(closed: str, tmp_path: Path) -> None:
    words = f"{sys.executable} -m scara_effmass lump --poses 1 -o {tmp_path}/out"
    ended = subprocess.run(["sh", "-c", f"exec {words} {closed}"], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (0, "")
    assert json.loads((tmp_path / "out" / "lump.json").read_text())


@pytest.mark.parametrize("option", ["-o", "--output", "--out"])
def test_demo_takes_its_output_folder_as_every_command(option: str) -> None:
    assert make_parser().parse_args(["demo", option, "here"]).out == Path("here")


@pytest.mark.parametrize("name", sorted(set(COMMANDS) - NO_OUTPUT))
def test_every_command_that_writes_has_the_option_o(name: str) -> None:
    assert "-o" in COMMANDS[name].options


@pytest.mark.live
@pytest.mark.parametrize("arguments", [["limits", "--json"], ["limits"], ["--help"]])
def test_full_stdout_gives_one_line(arguments: list[str]) -> None:
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        command = [sys.executable, "-m", "scara_effmass", *arguments]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr == "stdout: No space left on device\n"


BOTH_OUTPUTS = """
import sys
from scara_effmass.__main__ import main
for option in [], ["--json"]:
    sys.argv[1:] = ["assess", RECORDING, "-o", "a.csv", "--force", *option]
    print(main())
"""


@pytest.mark.live
@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "utf-8"])
def test_output_in_any_encoding(swing_bag: Path, tmp_path: Path, encoding: str) -> None:
    """Names of files may be bytes that no encoding has; JSON stays JSON."""
    path = os.fsencode(tmp_path) + b"/\xce\xbc \xff.mcap"
    shutil.copyfile(next(swing_bag.glob("*.mcap")), path)
    code = BOTH_OUTPUTS.replace("RECORDING", ascii(os.fsdecode(path)))
    environment = os.environ | {"PYTHONIOENCODING": encoding}
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, env=environment, check=True)
    assert done.stderr == b""
    _, result, end = done.stdout.decode(encoding).split("\n0\n")
    assert "\u03bc \udcff.mcap" in json.loads(result)["tightest"]["bag"]
    assert not end


@pytest.mark.parametrize("value", ["9" * 26, "9" * 5000, "1e3", "-1", "0.5", "nan"])
@pytest.mark.parametrize("command", ["map -o out --samples", "lump --poses", "evidence -o out --seed"])
def test_impossible_count_is_refused_in_one_line(refused: Refused, command: str, value: str) -> None:
    assert "must be a whole number from" in refused(*command.split(), value)

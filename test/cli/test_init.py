# SPDX-License-Identifier: Apache-2.0
"""`init`: what it writes passes `doctor`, holds the options, and serves every node and command."""

import io
import json
import shlex
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from rclpy.signals import SignalHandlerOptions

from scara_effmass.bags.files import open_bag
from scara_effmass.bags.writer import BagWriter
from scara_effmass.nodes.daq_node import DaqNode
from scara_effmass.nodes.monitor_node import MonitorNode
from scara_effmass.nodes.validator_node import ValidatorNode
from scara_effmass.settings import ContactType, DaqSettings, MonitorSettings, ValidatorSettings, load_settings
from scara_effmass.share import share
from scara_effmass.values import JointState
from test.cli.conftest import START_NS, Cli, Refused

ROBOTS = Path(__file__).parents[1] / "robots"
UR5 = share("config", "robots", "ur5_robot.urdf")
UR5_JOINTS = (
    *("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"),
    *("wrist_1_joint", "wrist_2_joint", "wrist_3_joint"),
)
DESCRIPTIONS = (
    *sorted(share("config", "robots").glob("*.urdf")),
    *sorted(path for path in ROBOTS.glob("*.urdf") if "denso" not in path.name),  # whose masses are placeholders
    share("config", "omron_i4_550l.yaml"),
)
CELL = (
    *("--contact-point", "ee_link", "--contact-point", "y=upper_arm_link: -0.1 0 1e-3"),
    *(
        "--payload",
        "2.5",
        "--payload-com",
        "-0.01",
        "0",
        "0.1",
        "--payload-inertia",
        "0.01",
        "0.01",
        "0.01",
        "0",
        "0",
        "0",
    ),
    *("--region", "chest", "--region", "hand_fingers", "--contact-area-m2", "2e-4", "--person-speed", "0.2"),
)


@pytest.fixture(scope="module")
def motion(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A generated motion of a UR5, 1 s at 100 Hz."""
    path = tmp_path_factory.mktemp("bags") / "motion"
    t = np.arange(100) / 100.0
    q = np.stack([centre + 0.2 * np.sin(t + i) for i, centre in enumerate((0.0, -1.2, 1.5, -1.5, -1.5, 0.0))], axis=1)
    qd = np.gradient(q, t, axis=0)
    with BagWriter(path) as bag:
        states = (JointState(START_NS + 10_000_000 * i, UR5_JOINTS, q[i], qd[i]) for i in range(len(t)))
        bag.write_joint_states("/arm/joint_states", states)
    return path


@pytest.mark.parametrize("robot", DESCRIPTIONS, ids=lambda robot: robot.stem)
def test_written_file_passes_doctor(robot: Path, cli: Cli) -> None:
    done = cli("init", "--robot", robot)
    assert (done.returncode, done.stderr) == (0, "")
    checked = cli("doctor", "--params", "cell.yaml", "--json")
    assert (checked.returncode, json.loads(checked.stdout)["healthy"]) == (0, True)


def test_next_command_draws_the_links_that_are_watched(cli: Cli, tmp_path: Path) -> None:
    named = cli("init", "--contact-point", "tool").stdout
    assert "--hulls" not in named
    assert "tightest" not in named
    done = cli("init", "--contact-point", "tool", "--contact-point", "whole_arm", "-o", "a cell/i4.yaml")
    assert "\ntightest        link" in done.stdout
    command = next(line for line in done.stdout.splitlines() if line.startswith("next ")).split(None, 2)[2]
    assert cli(*shlex.split(command)).returncode == 0
    assert (tmp_path / "a cell" / "hulls.png").read_bytes().startswith(b"\x89PNG")


def test_file_holds_the_options_and_the_meaning_of_each_parameter(cli: Cli, motion: Path, tmp_path: Path) -> None:
    done = cli("init", "--robot", UR5, "--bag", motion, *CELL, "-o", "new/ur5.yaml")
    assert (done.returncode, done.stderr) == (0, "")
    assert f"recording       {motion}, /arm/joint_states\nWARN " in done.stdout
    file = tmp_path / "new" / "ur5.yaml"
    assert load_settings(MonitorSettings, file, "monitor") == MonitorSettings(
        robot=str(UR5),
        contact_points=("ee_link", "y=upper_arm_link: -0.1 0 1e-3"),
        payload_mass=2.5,
        payload_com=(-0.01, 0.0, 0.1),
        payload_inertia=(0.01, 0.01, 0.01, 0.0, 0.0, 0.0),
        body_regions=("chest", "hand_fingers"),
        contact_area_m2=2e-4,
        person_speed=0.2,
    )
    assert "rotor inertia not stated" in done.stdout
    assert "acceleration not stated" in done.stdout
    validator = load_settings(ValidatorSettings, file, "validator")
    assert (validator.body_regions, validator.contact_area_m2) == (("chest", "hand_fingers"), 2e-4)
    assert load_settings(DaqSettings, file, "daq") == DaqSettings()
    shown = load_settings(MonitorSettings, file, "visualization")
    assert (shown.robot, shown.contact_points[0], shown.payload_mass) == (str(UR5), "ee_link", 2.5)
    text = file.read_text(encoding="utf-8")
    assert "-- -r joint_states:=/arm/joint_states" in text
    for line, before in zip(text.splitlines()[1:], text.splitlines(), strict=False):
        is_parameter = line.startswith("    ") and not line.startswith("    #")
        assert not is_parameter or before.startswith("    # "), line


def test_comments_hold_the_defaults_of_their_node(cli: Cli, tmp_path: Path) -> None:
    assert cli("init", "--robot", UR5, "-o", "cell.yaml").returncode == 0
    validator = (tmp_path / "cell.yaml").read_text(encoding="utf-8").partition("/**/validator:")[2]
    assert f"# effective_mass_model: {ValidatorSettings().effective_mass_model.value}\n" in validator


def test_table_of_other_values_has_no_empty_row(cli: Cli) -> None:
    table = cli("init", "--robot", UR5).stdout.partition("with another value  ")[2].splitlines()[2:]
    assert [line for line in table if line.strip() and line.split()[-1][0] not in "+-"] == []
    assert len(table) > 5


def test_every_command_takes_the_file(cli: Cli, motion: Path, tmp_path: Path) -> None:
    assert cli("init", "--robot", UR5, *CELL).returncode == 0
    params = ("--params", "cell.yaml", "--json")
    assert json.loads(cli("limits", *params).stdout)["contact_area_m2"] == 2e-4
    result = json.loads(cli("assess", motion, "-o", "a.csv", *params).stdout)
    assert result["cycles_by_verdict"]["UNKNOWN"] == 0
    assert '"y"' in (tmp_path / "a.csv").read_text(encoding="utf-8")
    refusal = cli("validate", motion, "-o", "report", *params)
    assert "has no topic of type scara_effmass_msgs/msg/ForceBlock" in refusal.stderr  # the parameters were accepted
    mapped = cli("map", UR5, "-o", "map", "--samples", "100", *params)
    assert (mapped.returncode, json.loads(mapped.stdout)["contact_point"]) == (0, "ee_link")


def test_every_node_takes_the_file(
    cli: Cli,
    tmp_path: Path,
    own_domain: int,  # noqa: ARG001
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """ROS reads the file with a parser of its own."""
    assert cli("init", "--robot", UR5, *CELL).returncode == 0
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path))
    rclpy.init(args=["--ros-args", "--params-file", "cell.yaml"], signal_handler_options=SignalHandlerOptions.NO)
    try:
        monitor, validator, daq = MonitorNode(), ValidatorNode(), DaqNode()
        monitor.bring_up()
        values: dict[str, Any] = {
            name: monitor.get_parameter(name).value
            for name in ("robot", "contact_points", "payload_mass", "payload_com")
        }
        assert values == {
            "robot": str(UR5),
            "contact_points": ["ee_link", "y=upper_arm_link: -0.1 0 1e-3"],
            "payload_mass": 2.5,
            "payload_com": pytest.approx([-0.01, 0.0, 0.1]),
        }
        assert validator.get_parameter("robot").value == str(UR5)
        assert daq.get_parameter("sensor.sensitivity").value == 2.248
        for node in (monitor, validator, daq):
            node.destroy_node()
    finally:
        rclpy.try_shutdown()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--robot", "no.urdf"), "no.urdf: cannot be read"),
        (
            ("--robot", share("config", "robots", "panda.urdf"), "--model", "lumped"),
            "lumped: every verdict will be UNKNOWN",
        ),
        (("--robot", ROBOTS / "scara_denso_hsr065a1_n32.urdf"), "every verdict will be UNKNOWN"),
        (("--robot", UR5, "--region", "tail"), "limits: body_regions = 'tail': must be one of"),
        (("--robot", UR5, "--contact-point", "hand"), "contact_points = 'hand': must be one of"),
        (("--payload-inertia", "1", "1", "1", "0", "0", "0"), "must be 0 without payload_mass"),
        (("--bag", "no.mcap"), "no.mcap: does not exist"),
    ],
)
def test_what_doctor_finds_wrong_is_not_written(words: tuple[str | Path, ...], message: str, refused: Refused) -> None:
    assert message in refused("init", *words)


@pytest.fixture
def renamed(motion: Path, tmp_path: Path) -> Path:
    """The motion, with other names of the joints."""
    with open_bag(motion) as bag, BagWriter(tmp_path / "left") as left:
        for message in bag.messages():
            data = message.data.replace(b"_joint", b"_motor")
            left.write("/joint_states", message.type, message.log_time_ns, data)
    return tmp_path / "left"


def test_recording_with_other_names_needs_a_map(cli: Cli, refused: Refused, renamed: Path, tmp_path: Path) -> None:
    hint = "; try joint_map shoulder_pan_motor=shoulder_pan_joint,"
    assert hint in refused("init", "--robot", UR5, "--bag", renamed)
    assert "joint_map = 'a=b': b: must be" in refused("init", "--robot", UR5, "--joint-map", "a=b")
    done = cli("init", "--robot", UR5, "--bag", renamed, "--joint-map", "*_motor=*_joint")
    assert (done.returncode, done.stderr) == (0, "")
    assert load_settings(MonitorSettings, tmp_path / "cell.yaml", "monitor").joint_map == ("*_motor=*_joint",)
    assert cli("doctor", "--params", "cell.yaml").returncode == 0
    result = json.loads(cli("assess", renamed, "-o", "a.csv", "--params", "cell.yaml", "--json").stdout)
    assert result["cycles_by_verdict"]["UNKNOWN"] == 0


def test_a_terminal_is_asked_for_the_map_only_where_names_differ(
    cli: Cli, renamed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers = [str(renamed), "full", "a=b", "*_motor=*_joint", *[""] * 7]
    monkeypatch.setattr(sys, "stdin", Terminal("\n".join([*answers, ""])))
    done = cli("init", "--robot", UR5)
    assert (done.returncode, done.stderr) == (0, "")
    assert "; try joint_map shoulder_pan_motor=" in done.stdout
    assert load_settings(MonitorSettings, tmp_path / "cell.yaml", "monitor").joint_map == ("*_motor=*_joint",)


def test_existing_file_is_kept_without_force(cli: Cli, refused: Refused, tmp_path: Path) -> None:
    (tmp_path / "cell.yaml").write_text("monitor: {ros__parameters: {}}", encoding="utf-8")
    assert refused("init") == "cell.yaml: already exists; use --force to replace it"
    assert cli("init", "--force").returncode == 0
    written = load_settings(MonitorSettings, tmp_path / "cell.yaml", "monitor")
    assert (written, written.model_fields_set) == (MonitorSettings(), {"robot"})


def test_centre_of_mass_without_a_payload_is_refused(refused: Refused, motion: Path) -> None:
    com = ("--payload-com", "0", "0", "0.1")
    for words in (("init", *com), ("assess", motion, "-o", "a.csv", *com)):
        assert refused(*words).endswith("payload_com = [0.0, 0.0, 0.1]: must be 0 without payload_mass")


def test_end_of_the_input_ends_the_questions(cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", Terminal(b"\xff\n".decode(errors="surrogateescape")))
    done = cli("init")
    assert (done.returncode, done.stderr) == (130, "interrupted\n")
    assert "\ufffd" in done.stdout
    assert not (tmp_path / "cell.yaml").exists()


class Terminal(io.StringIO):
    """Answers typed at a terminal."""

    def isatty(self) -> bool:
        return True


def test_a_terminal_is_asked_for_what_is_missing(
    cli: Cli, motion: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A wrong answer is explained and asked again; Enter states nothing."""
    answers = {
        "bag": [str(motion)],
        "effective_mass_model": ["light", "full"],
        "contact_points": ["hand", "ee_link, elbow=upper_arm_link: 0 0 0.4"],
        "payload_mass": ["2,5", "-1", "2.5"],
        "payload_com": ["0 0", "0 0 0.1"],
        "payload_inertia": ["0.1 0.1 0.5 0 0 0", ""],
        "body_regions": ["chest,tail", "chest, hand_fingers"],
        "contact": [""],
        "contact_area_m2": ["0", "2e-4"],
        "max_acceleration": [""],
    }
    typed = "".join(f"{answer}\n" for given in answers.values() for answer in given)
    monkeypatch.setattr(sys, "stdin", Terminal(typed))
    done = cli("init", "--robot", UR5, "--person-speed", "0.2")
    assert (done.returncode, done.stderr) == (0, "")
    for text in ("effective_mass_model = 'light'", "contact_points = 'hand'", "2,5: must be a number", "payload_com.2"):
        assert text in done.stdout
    settings = load_settings(MonitorSettings, tmp_path / "cell.yaml", "monitor")
    assert settings.contact_points == ("ee_link", "elbow=upper_arm_link: 0 0 0.4")
    assert (settings.payload_mass, settings.payload_com) == (2.5, (0.0, 0.0, 0.1))
    assert settings.payload_inertia == (0.0,) * 6
    assert (settings.body_regions, settings.contact) == (("chest", "hand_fingers"), ContactType.TRANSIENT)
    assert (settings.contact_area_m2, settings.person_speed) == (2e-4, 0.2)
    assert not {"payload_inertia", "contact", "max_acceleration"} & settings.model_fields_set

# SPDX-License-Identifier: Apache-2.0
"""`doctor`: the shipped robot is healthy, and each missing prerequisite is named."""

import json
import re
import sys
from ctypes.util import find_library
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scara_effmass.cli import main
from scara_effmass.daq import ni_driver
from scara_effmass.daq.ni9230 import Ni9230Source
from scara_effmass.errors import DriverMissingError
from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.settings import DaqSettings
from scara_effmass.share import share

SHIPPED = share("config", "omron_i4_550l.yaml")

ARM = """<robot name="arm">
<link name="base"/>{links}
<joint name="a" type="revolute"><parent link="base"/><child link="l1"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" velocity="2" effort="1"/></joint>
<joint name="b" type="{kind}"><parent link="l1"/><child link="l2"/><axis xyz="0 1 0"/><origin xyz="0.3 0 0"/>
<limit lower="-1" upper="1" velocity="2" effort="1"/></joint>
<joint name="c" type="fixed"><parent link="l2"/><child link="tip"/><origin xyz="0.3 0 0"/></joint>
</robot>"""
LINK = """<link name="{name}"><inertial><origin xyz="{x} 0.01 0"/><mass value="{mass}"/>
<inertia ixx="{i}" iyy="{i}" izz="{i}" ixy="0" ixz="0" iyz="0"/></inertial></link>"""


def arm(path: Path, *, inertia: float = 0.01, mass: float = 1.5, x: float = 0.1, kind: str = "revolute") -> Path:
    """Write a URDF of two skew joints."""
    links = "".join(LINK.format(name=name, x=x, mass=mass, i=inertia) for name in ("l1", "l2"))
    path.write_text(ARM.format(links=links + '<link name="tip"/>', kind=kind), encoding="utf-8")
    return path


def run_doctor(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, dict[str, Any]]:
    code = main(["doctor", "--json", *words])
    return code, json.loads(capsys.readouterr().out)


def texts(result: dict[str, Any], level: str) -> dict[str, str]:
    return {finding["subject"]: finding["text"] for finding in result["findings"] if finding["level"] == level}


@pytest.mark.parametrize(
    "words", [(), ("--robot", str(share("config", "robots", "ur10_robot.urdf")))], ids=["shipped", "ur10"]
)
def test_results_fit_into_80_columns_and_keep_their_words(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    _, result = run_doctor(capsys, *words)
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("TERM", "dumb")
    assert main(["doctor", *words]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if len(line) > 80 and len(line.split()) > 1] == []
    shown = set(" ".join(lines).split())
    assert {word for finding in result["findings"] for word in finding["text"].split() if len(word) < 74} <= shown
    assert {joint["name"] for joint in result["joints"]} <= shown
    assert len(lines) < 90


def test_kernel_that_cannot_be_kept_is_a_note(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    _, result = run_doctor(capsys)
    assert "compiled by numba" in texts(result, "ok")["kernel"]
    monkeypatch.setenv("NUMBA_CACHE_DIR", "/dev/null")  # the library has been loaded before
    code, result = run_doctor(capsys)
    assert code == 0
    assert (
        "every start compiles it for about a minute: must be able to write /dev/null/kernel-"
        in texts(result, "note")["kernel"]
    )


def test_shipped_robot_is_healthy(capsys: pytest.CaptureFixture[str]) -> None:
    code, result = run_doctor(capsys)
    assert code == 0
    assert result["healthy"] is True
    assert texts(result, "wrong") == {}
    ok = texts(result, "ok")
    assert re.match(r"\d+\.\d+\.\d+ ", ok["rclpy"])
    assert ok["middleware"].startswith("rmw_")
    assert "type support of ContactState loads" in ok["scara_effmass_msgs"]
    assert "2.77 kg" in ok["ISO mass"]
    assert "1.94, 2.38" in ok["lumped model"]
    assert [joint["name"] for joint in result["joints"]] == ["joint1", "joint2", "joint3", "joint4"]
    assert sum(joint["link_mass_kg"] for joint in result["joints"]) == pytest.approx(5.04 + 0.25)


def test_reach_moving_mass_and_masses_at_the_home_pose_are_printed(capsys: pytest.CaptureFixture[str]) -> None:
    ok = texts(run_doctor(capsys, "--robot", str(share("config", "robots", "ur5_robot.urdf")))[1], "ok")
    assert ok["units"] == "plausible"
    assert ok["reach"] == "at least 0.930 m from shoulder_pan_joint, in sampled poses"
    assert ok["moving mass"] == "16.99 kg without the payload"
    robot = load_robot(share("config", "robots", "ur5_robot.urdf"))
    q = np.zeros(6)
    jacobian = RobotDynamics(robot).at(q).contacts[0].jacobian
    matrix = robot.mass_matrix(robot.model, robot.model.createData(), q)
    masses = 1.0 / np.diag(jacobian @ np.linalg.inv(np.triu(matrix) + np.triu(matrix, 1).T) @ jacobian.T)
    stated = re.search(r"full mass (\S+) / (\S+) / (\S+) kg along x / y / z of world", ok["home pose, ee_link"])
    assert stated is not None
    assert [float(text) for text in stated.groups()] == pytest.approx(masses.tolist(), rel=0.005)


def test_robot_in_millimetres_grams_and_degrees_is_wrong(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = SHIPPED.read_text(encoding="utf-8").replace("a: 0.275", "a: 325")
    for old, new in (("2.3736", "132"), ("2.5831", "148"), ("6.2832", "360")):
        text = text.replace(old, new)
    text = re.sub(r"- \{name: link(.), mass: (\S+), com: \[(\S+), 0.0, 0.0\].*", _in_grams, text)
    robot = tmp_path / "scara.yaml"
    robot.write_text(text, encoding="utf-8")
    code, result = run_doctor(capsys, "--robot", str(robot))
    assert (code, result["healthy"]) == (1, False)
    units = texts(result, "wrong")["units"]
    for rule in (
        "325 m long: must be in metres, not in mill",
        "5040 kg move at a reach",
        "720 rad: must be in radians",
    ):
        assert rule in units
    assert "moving mass" in texts(result, "ok")
    assert [joint["upper"] for joint in result["joints"]] == [132.0, 148.0, 0.45, 360.0]


def test_continuous_joint_has_no_bounds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, result = run_doctor(capsys, "--robot", str(arm(tmp_path / "arm.urdf", kind="continuous")))
    assert [(joint["lower"], joint["upper"]) for joint in result["joints"]] == [(-1.0, 1.0), (None, None)]


def test_robot_that_the_kernel_is_not_for_is_checked_without_minutes_of_sampling(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    box = '<collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>'
    links = "".join(LINK.format(name=f"l{i}", x=0.1, mass=1.5, i=0.01).replace("</link>", box) for i in range(17))
    joints = "".join(
        f'<joint name="j{i}" type="revolute"><parent link="{f"l{i - 1}" if i else "base"}"/><child link="l{i}"/>'
        f'<origin xyz="0.1 0 0"/><axis xyz="0 {i % 2} {1 - i % 2}"/>'
        '<limit lower="-1" upper="1" velocity="2" effort="9"/></joint>'
        for i in range(17)
    )
    (tmp_path / "snake.urdf").write_text(f'<robot name="snake"><link name="base"/>{links}{joints}</robot>', "utf-8")
    monkeypatch.setattr("scara_effmass.safety.Monitor.assess_configurations", pytest.fail)
    code, result = run_doctor(capsys, "--robot", str(tmp_path / "snake.urdf"), "--contact-point", "whole_arm")
    assert (code, result["healthy"]) == (0, True)
    rule = "not sampled: the compiled kernel is for at most 16 joints, the robot has 17; the reference is hundreds"
    assert texts(result, "note")["tightest contact"].startswith(rule)


def _in_grams(row: re.Match[str]) -> str:
    mass, com = (1e3 * float(text) for text in row.groups()[1:])
    return f"- {{name: link{row[1]}, mass: {mass}, com: [{com}, 0.0, 0.0]}}"


def test_contact_that_decides_most_random_motions_comes_first(capsys: pytest.CaptureFixture[str]) -> None:
    rows = texts(run_doctor(capsys, "--contact-point", "near=link1: -0.2 0 0", "--contact-point", "tool")[1], "ok")
    assert rows["tightest contact"] == "tool 99.7%, near 0.3% of 300 random motions"
    whole = texts(run_doctor(capsys, "--contact-point", "whole_arm")[1], "ok")["tightest contact"]
    shares = [float(share) for share in re.findall(r"([\d.]+)%", whole)]
    assert shares == sorted(shares, reverse=True)
    assert sum(shares) == pytest.approx(100.0, abs=0.3)
    assert "tightest contact" not in texts(run_doctor(capsys, "--contact-point", "tool")[1], "ok")


@pytest.mark.parametrize("suffix", [".png", ".svg"])
def test_picture_of_the_hulls(suffix: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / f"hulls{suffix}"
    words = ("--contact-point", "whole_arm", "--hulls", str(path))
    code, result = run_doctor(capsys, *words)
    assert (code, texts(result, "ok")["hulls"]) == (0, f"{path}: link1, link2, link3, link4")
    start = path.read_bytes()[:5]
    assert start == (b"\x89PNG\r" if suffix == ".png" else b"<?xml")
    assert main(["doctor", *words]) == 2
    assert "already exists; use --force" in capsys.readouterr().err
    path.write_bytes(b"")
    assert main(["doctor", *words, "--force"]) == 0
    assert path.stat().st_size > 1000


@pytest.mark.parametrize(
    ("words", "rule"),
    [
        (("--hulls", "hulls.jpg", "--contact-point", "whole_arm"), "--hulls = hulls.jpg: must end with .png or .svg"),
        (
            ("--hulls", "hulls.png", "--contact-point", "tool"),
            "--hulls: no link is watched as a whole; use --contact-point whole_arm",
        ),
    ],
)
def test_picture_without_hulls_is_refused(
    words: tuple[str, ...],
    rule: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["doctor", *words]) == 2
    assert capsys.readouterr().err == f"{rule}\n"
    assert not [*tmp_path.iterdir()]


def test_large_contact_area_gives_a_note(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "contact area" not in texts(run_doctor(capsys)[1], "note")
    params = tmp_path / "cell.yaml"
    params.write_text("/**:\n  ros__parameters:\n    contact_area_m2: 1.0e-3\n", encoding="utf-8")
    note = texts(run_doctor(capsys, "--params", str(params))[1], "note")["contact area"]
    assert note == "10 cm²: allows 10 times the pressure force of 1 cm², if the whole area bears"


def test_settings_without_effect_give_notes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    params = tmp_path / "cell.yaml"
    params.write_text("/**:\n  ros__parameters: {person_direction_frame: link1, filter: {cutoff: 100.0}}\n")
    notes = texts(run_doctor(capsys, "--params", str(params))[1], "note")
    assert notes["settings"] == "person_direction_frame = link1 has no effect without person_direction"
    assert notes["daq_node"] == "filter.cutoff = 100.0 has no effect without a filter.kind"


def test_robot_without_the_chosen_mass_model_is_not_healthy(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    robot = str(arm(tmp_path / "arm.urdf", x=1e-4))  # a lumped mass would lie 30 m away
    assert run_doctor(capsys, "--robot", robot)[0] == 0
    code, result = run_doctor(capsys, "--robot", robot, "--model", "lumped")
    assert code == 1
    assert result["healthy"] is False
    (wrong,) = texts(result, "wrong").values()
    assert "choose full or iso or auto" in wrong
    assert "the last link must include the tool" in texts(result, "note")["payload"]
    code, result = run_doctor(capsys, "--robot", robot, "--model", "full")
    assert code == 0
    assert texts(result, "wrong") == {}


def test_joints_without_rotor_inertia_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    warning = texts(run_doctor(capsys)[1], "note")["armature"]
    assert warning.startswith("no rotor inertia for joint1, joint2, joint3, joint4: ")
    params = tmp_path / "cell.yaml"
    params.write_text("/**:\n  ros__parameters:\n    armature: [joint1=0.3, joint2=0.2, joint3=0, joint4=0]\n")
    _, result = run_doctor(capsys, "--params", str(params))
    assert texts(result, "ok")["armature"] == "0.3, 0.2, 0, 0 kg m² or kg"


def test_payload_and_limits_of_the_options_are_reported(capsys: pytest.CaptureFixture[str]) -> None:
    _, result = run_doctor(capsys, "--payload", "2", "--contact-area-m2", "3e-4", "--person-speed", "1.6")
    assert texts(result, "ok")["payload"] == "0.25 kg (robot file) + 2 kg (parameter payload_mass)"
    assert "3 cm², person at 1.6 m/s: " in texts(result, "ok")["limits"]
    assert "the payload counts as a point mass" in " ".join(texts(result, "note").values())
    code, result = run_doctor(capsys, "--payload-topic", "load")
    assert (code, texts(result, "note")["payload"].split(";")[0]) == (0, "by topic load, not in the masses here")


def test_placeholder_inertias_are_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    robot = str(arm(tmp_path / "arm.urdf", inertia=1.0, mass=1.0))
    code, result = run_doctor(capsys, "--robot", robot, "--model", "iso")
    assert code == 1
    assert "placeholders" in texts(result, "note")["inertia tensors"]
    assert "placeholders" in texts(result, "wrong")["effective_mass_model"]


def test_unreadable_robot_file_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    robot = tmp_path / "arm.urdf"
    robot.write_text("<robot", encoding="utf-8")
    code, result = run_doctor(capsys, "--robot", str(robot))
    assert code == 1
    assert str(robot) in texts(result, "wrong")["robot"]
    assert result["joints"] == []


def test_missing_limit_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "cell.yaml"
    file.write_text("/**:\n  ros__parameters:\n    body_regions: [face]\n", encoding="utf-8")
    code, result = run_doctor(capsys, "--params", str(file))
    assert code == 1
    assert "permits no contact" in texts(result, "wrong")["limits"]


def test_joint_without_limits_is_accepted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    robot = str(arm(tmp_path / "arm.urdf", kind="continuous"))
    assert main(["doctor", "--robot", robot, "--model", "full"]) == 0
    assert "link mass [kg]" in capsys.readouterr().out
    assert run_doctor(capsys, "--robot", robot, "--model", "full")[0] == 0


def test_discovery_range_of_the_whole_network_gives_a_note(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("ROS_AUTOMATIC_DISCOVERY_RANGE", raising=False)
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    _, result = run_doctor(capsys)
    assert "LOCALHOST keeps to this machine" in texts(result, "note")["ROS_AUTOMATIC_DISCOVERY_RANGE"]
    assert texts(result, "ok")["ROS_DOMAIN_ID"] == "7"
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    _, result = run_doctor(capsys)
    assert "ROS_AUTOMATIC_DISCOVERY_RANGE" in texts(result, "ok")


def test_missing_type_support_is_reported(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setitem(sys.modules, "scara_effmass_msgs.msg", None)
    code, result = run_doctor(capsys)
    assert code == 1
    assert "install scara_effmass again" in texts(result, "wrong")["scara_effmass_msgs"]


MODULE = ni_driver.Device("cDAQ1Mod1", "NI 9230", False, ("cDAQ1Mod1/ai0", "cDAQ1Mod1/ai1"), "")  # noqa: FBT003
DEVICES = (ni_driver.Device("cDAQ1", "cDAQ-9171", False, (), ""), MODULE)  # noqa: FBT003


@pytest.fixture
def driver(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """A driver that lists `DEVICES`."""
    monkeypatch.setattr(ni_driver, "driver_version", lambda: "24.5.1")
    monkeypatch.setattr(ni_driver, "devices", lambda: DEVICES)
    return monkeypatch


@pytest.mark.skipif(find_library("nidaqmx") is not None, reason="NI-DAQmx is installed here")
def test_missing_driver_gives_the_note_of_the_source(capsys: pytest.CaptureFixture[str]) -> None:
    code, result = run_doctor(capsys)
    assert code == 0
    with pytest.raises(DriverMissingError) as missing:
        Ni9230Source(DaqSettings(), lambda: 0).start()
    assert texts(result, "note")["NI-DAQmx"] == str(missing.value)
    assert "ni9230.channels" not in texts(result, "note")


@pytest.mark.usefixtures("driver")
def test_connected_device_is_listed(capsys: pytest.CaptureFixture[str]) -> None:
    code, result = run_doctor(capsys)
    assert code == 0
    ok = texts(result, "ok")
    assert ok["NI-DAQmx"] == "24.5.1"
    assert ok["cDAQ1"] == "cDAQ-9171"
    assert ok["cDAQ1Mod1"] == "NI 9230; for an IEPE force sensor: cDAQ1Mod1/ai0, cDAQ1Mod1/ai1"
    assert ok["ni9230.channels"] == "cDAQ1Mod1/ai0: present"


@pytest.mark.parametrize(
    ("devices", "note"),
    [
        ((), "cDAQ1Mod1/ai0 not found; present: none"),
        ((MODULE._replace(channels=("Dev2/ai0",)),), "cDAQ1Mod1/ai0 not found; present: Dev2/ai0"),
    ],
)
def test_missing_channel_gives_a_note(
    devices: tuple[ni_driver.Device, ...],
    note: str,
    driver: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    driver.setattr(ni_driver, "devices", lambda: devices)
    code, result = run_doctor(capsys)
    assert code == 0
    assert texts(result, "note")["ni9230.channels"] == note


def test_simulated_and_unreachable_devices_give_notes(
    driver: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    driver.setattr(ni_driver, "devices", lambda: (MODULE._replace(simulated=True), DEVICES[0]._replace(problem="gone")))
    _, result = run_doctor(capsys)
    notes = texts(result, "note")
    assert "simulated by its driver" in notes["cDAQ1Mod1"]
    assert notes["cDAQ1"] == "gone"


@pytest.mark.usefixtures("driver")
def test_channel_of_the_parameter_file_is_checked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "cell.yaml"
    daq = "daq:\n  ros__parameters:\n    {}\n"
    monitor = "monitor:\n  ros__parameters:\n    contact: transient\n"
    file.write_text(monitor + daq.format("ni9230.channels: [cDAQ1Mod1/ai2]"), encoding="utf-8")
    _, result = run_doctor(capsys, "--params", str(file))
    assert texts(result, "note")["ni9230.channels"].startswith("cDAQ1Mod1/ai2 not found")
    file.write_text(monitor + daq.format("source: sim"), encoding="utf-8")
    _, result = run_doctor(capsys, "--params", str(file))
    assert "ni9230.channels" not in texts(result, "note") | texts(result, "ok")
    file.write_text(monitor, encoding="utf-8")
    _, result = run_doctor(capsys, "--params", str(file))
    assert "; the defaults are checked instead" in texts(result, "note")["daq_node"]


@pytest.mark.usefixtures("driver")
def test_parameter_file_of_daq_node_alone_is_accepted(capsys: pytest.CaptureFixture[str]) -> None:
    code, result = run_doctor(capsys, "--params", str(share("config", "daq.yaml")))
    assert code == 0
    assert texts(result, "ok")["ni9230.channels"] == "cDAQ1Mod1/ai0: present"


@pytest.mark.parametrize("on_terminal", [True, False])
def test_levels_have_a_colour_on_a_terminal_only(
    *, on_terminal: bool, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys.stdout, "isatty", lambda: on_terminal)
    assert main(["doctor"]) == 0
    output = capsys.readouterr().out
    assert ("\x1b[32mok" in output, "\x1b[33mnote" in output) == (on_terminal, on_terminal)
    assert ("\x1b" in output) == on_terminal


def test_doctor_says_what_is_assumed_and_which_mass_decides(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    _, result = run_doctor(capsys)
    assert texts(result, "ok")["an OK covers"].startswith(
        "slower than the allowable speed at tool, elbow, link1, link2, link3, link4, for a person "
    )
    _, result = run_doctor(capsys, "--robot", str(arm(tmp_path / "arm.urdf", x=0.0, inertia=1.0)))
    notes = texts(result, "note")
    assert notes["assumed: payload"] == "payload not stated: --payload 0 if there is none, else with its --payload-com"
    assert "state mass, centre of mass" in notes["assumed: masses"]
    assert "ISO's M/2 + m_L" in notes["effective_mass_model"]
    _, result = run_doctor(
        capsys, "--robot", str(arm(tmp_path / "arm.urdf")), "--payload", "0", "--accept-assumptions", "drives"
    )
    assert "assumed: payload" not in texts(result, "note")
    assert texts(result, "note")["assumed: drives"].startswith("accepted: ")


def test_unknown_assumption_is_refused_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "--accept-assumptions", "drive"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "'drive': must be drives" in line


@pytest.mark.parametrize("is_set", [True, False])
def test_home_in_which_no_node_can_log_is_wrong(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, *, is_set: bool
) -> None:
    for name in ("ROS_LOG_DIR", "ROS_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)
    if is_set:
        monkeypatch.setenv("HOME", "/proc/nobody")  # where not even root can make a folder
    code, result = run_doctor(capsys)
    assert (code, result["healthy"]) == (1, False)
    assert texts(result, "wrong")["ROS_LOG_DIR"].endswith("must be a folder that can be written")
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "logs"))
    code, result = run_doctor(capsys)
    assert (code, texts(result, "ok")["ROS_LOG_DIR"]) == (0, f"{tmp_path}/logs: logs go to {tmp_path}/logs")


def test_joints_held_fixed_are_listed_with_the_chain_and_why(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """`init` prints the same."""
    path = arm(tmp_path / "two.urdf")
    side = (
        LINK.format(name="s1", x=0.1, mass=1.5, i=0.01)
        + LINK.format(name="s2", x=0.1, mass=1.5, i=0.01)
        + "".join(
            f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/><axis xyz="0 0 1"/>'
            '<origin xyz="0.3 0 0"/><limit lower="-1" upper="1" velocity="2" effort="1"/></joint>'
            for name, parent, child in (("x", "base", "s1"), ("y", "s1", "s2"))
        )
    )
    path.write_text(path.read_text(encoding="utf-8").replace("</robot>", f"{side}</robot>"), encoding="utf-8")
    notes = [
        "contact point tip: the end of the longest chain (set contact_points for another): a, b",
        "chains of as many joints end at s2: tip comes first by length and name",
        "held fixed in the model: x, y",
    ]
    _, result = run_doctor(capsys, "--robot", str(path))
    found = [finding["text"] for finding in result["findings"] if finding["subject"] == "robot file"]
    assert found[:3] == notes
    assert "UNKNOWN while one of these moves, which the model holds fixed: x, y" in texts(result, "note")["motion"]
    main(["init", "--robot", str(path), "-o", str(tmp_path / "cell.yaml")])
    lines = [line.strip() for line in capsys.readouterr().out.splitlines()]
    assert lines[0] == f"robot           arm ({path})"
    assert lines[2:5] == notes

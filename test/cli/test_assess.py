# SPDX-License-Identifier: Apache-2.0
"""`assess`: output files contain the verdicts of `safety.Monitor`, in bounded memory, and replace no file."""

import csv
import json
import os
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from functools import cache
from pathlib import Path
from shutil import copytree
from typing import Any

import numpy as np
import pytest
import yaml
from geometry_msgs.msg import Inertia, Vector3
from pyarrow import parquet
from rclpy.serialization import serialize_message

from scara_effmass import __version__
from scara_effmass.analysis import dataset
from scara_effmass.analysis.assessment import cross_checked
from scara_effmass.analysis.properties import PROPERTIES
from scara_effmass.analysis.tables import SCHEMA
from scara_effmass.bags.bag import run_infos
from scara_effmass.bags.files import open_bag
from scara_effmass.bags.writer import BagWriter
from scara_effmass.codes import Reason
from scara_effmass.iso15066 import EDITION, TABLE_HASH
from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor, unknown_contact
from scara_effmass.safety.remedies import remedy
from scara_effmass.settings import MassModel, MonitorSettings
from scara_effmass.share import share
from scara_effmass.values import ContactAssessment, Decision, Verdict, severity
from scara_effmass.wire.contact_states import ContactStatesEncoder, decode_contact_states
from scara_effmass.wire.joint_state import JointStateDecoder
from scara_effmass.wire.message_types import CONTACT_STATES, INERTIA
from test.cli.conftest import Cli, Refused, swing, swing_recording
from test.decisions import assessments_of, decision_on

JOINT_STATE = "sensor_msgs/msg/JointState"
UNITS = ("", "_m_s", "_kg", "_n_m", "_n", "_j", "_s")


def core_decisions(path: Path, settings: MonitorSettings | None = None) -> list[Decision]:
    """Return the decisions that `safety.Monitor` gives for every joint state of a recording."""
    settings = settings or MonitorSettings()
    monitor = Monitor(RobotDynamics(load_robot(share("config", "omron_i4_550l.yaml"), settings)), settings)
    decoder = JointStateDecoder()
    decisions: list[Decision] = []
    with open_bag(path) as bag:
        for message in bag.messages(["/joint_states"]):
            decision = monitor.assess(decoder.decode(message.data), message.log_time_ns)
            assert decision is not None
            decisions.append(decision)
    return decisions


@cache
def columns_of(field: str) -> list[str]:
    """Return the columns of a table that hold a field of the assessment."""
    if field in {"direction", "test_direction"}:
        return [f"{field}_{axis}" for axis in "xyz"]
    if field.startswith("position"):
        return [f"{field}_{axis}_m" for axis in "xyz"]
    if field.endswith("_mobility"):
        return [f"{field}_{entry}_1_kg" for entry in ("xx", "xy", "xz", "yy", "yz", "zz")]
    return [name for unit in UNITS if (name := f"{field}{unit}") in SCHEMA.names]


OF_STATE = ("stamp_ns", "input_age", "velocity_delay", "contact_normal", "watchdog")


def assert_equal(rows: list[dict[str, Any]], decisions: list[Decision]) -> None:
    contacts = [(decision, contact) for decision in decisions for contact in decision.contacts]
    assert len(rows) == len(contacts)
    for field in (*OF_STATE, *(name for name in ContactAssessment._fields if name != "reason_code")):
        found = np.array([[row[column] for column in columns_of(field)] for row in rows])
        values = [getattr(decision if field in OF_STATE else contact, field) for decision, contact in contacts]
        wanted = np.array([value.name for value in values] if field == "verdict" else values).reshape(found.shape)
        if wanted.dtype == float:
            np.testing.assert_allclose(found, wanted, 1e-10, 1e-10, err_msg=field)
        else:
            np.testing.assert_array_equal(found, wanted, err_msg=field)


@pytest.fixture(scope="module")
def short_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of 0.12 s at 500 Hz: the reference takes 10 ms for each joint state."""
    return swing_recording(tmp_path_factory.mktemp("bags") / "short", 60)


def test_a_region_that_a_walking_person_leaves_no_speed_is_named(short_bag: Path, cli: Cli, tmp_path: Path) -> None:
    done = cli("assess", short_bag, "-o", tmp_path / "short.parquet", "--person-speed", "1.6")
    assert "a person at 1.600 m/s leaves no speed: the force limit of lower_leg allows" in done.stdout
    assert "state a lower person_speed" in done.stdout


CROSS_CHECKED = {
    "defaults": (),
    "payload topic": ("--payload-topic", "load"),
    "velocity bag": ("--velocity-bag", ""),
    "latch": ("--params", "latch: true"),
    "filtered velocity": ("--params", "velocity_window: 0.01"),
}


@pytest.mark.parametrize("case", CROSS_CHECKED)
def test_cross_check_compares_every_setting_with_the_reference(
    case: str, short_bag: Path, cli: Cli, tmp_path: Path
) -> None:
    words: tuple[Any, ...] = CROSS_CHECKED[case]
    if case == "velocity bag":
        words = ("--velocity-bag", short_bag)
    elif words[:1] == ("--params",):
        (tmp_path / "cell.yaml").write_text(f"/**:\n  ros__parameters:\n    {words[1]}\n", encoding="utf-8")
        words = ("--params", tmp_path / "cell.yaml")
    out = tmp_path / "short.parquet"
    done = cli("assess", short_bag, "-o", out, "--cross-check", *words)
    assert (done.returncode, done.stderr) == (int(case == "payload topic"), "")  # no payload: all are UNKNOWN
    if not words:
        assert_equal(parquet.read_table(out).to_pylist(), core_decisions(short_bag))


def test_difference_found_by_the_cross_check_leaves_no_file(
    swing_bag: Path, cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dataset, "cross_checked", lambda name, own, _: cross_checked(name, own, iter(())))
    done = cli("assess", swing_bag, "-o", tmp_path / "swing.parquet", "--cross-check")
    assert (done.returncode, done.stdout) == (1, "")
    assert "cross-check: the number of joint states differs" in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_parquet_contains_the_assessments(swing_bag: Path, cli: Cli, tmp_path: Path) -> None:
    out = tmp_path / "new" / "swing.parquet"
    done = cli("assess", swing_bag, "-o", out)
    assert (done.returncode, done.stderr) == (0, "")
    rows = parquet.read_table(out).to_pylist()
    assert_equal(rows, core_decisions(swing_bag))
    assert {row["bag"] for row in rows} == {str(swing_bag)}
    assert all(row["log_time_ns"] == row["stamp_ns"] for row in rows)
    metadata = {key.decode(): value.decode() for key, value in parquet.read_schema(out).metadata.items()}
    assert metadata["scara_effmass_version"] == __version__
    assert (metadata["limits_edition"], metadata["limits_hash"]) == (EDITION, TABLE_HASH)
    assert MonitorSettings.model_validate_json(metadata["settings"]) == MonitorSettings()
    assert metadata["robot"].endswith("omron_i4_550l.yaml")
    assert json.loads(metadata["bags"]) == [str(swing_bag)]


def test_direction_adds_the_mass_along_it(swing_bag: Path, cli: Cli, tmp_path: Path) -> None:
    out = tmp_path / "a.parquet"
    assert (
        cli("assess", swing_bag, "-o", out, "--direction", "1", "0", "0", "--direction-frame", "tool").returncode == 0
    )
    settings = MonitorSettings(test_direction=(1.0, 0.0, 0.0), test_direction_frame="tool")
    rows = parquet.read_table(out).to_pylist()
    assert_equal(rows, core_decisions(swing_bag, settings))
    assert len({row["test_direction_x"] for row in rows}) > 100
    points = [row for row in rows if row["contact_point"] in {"tool", "elbow"}]
    assert min(row["test_effective_mass_kg"] for row in points if row["verdict"] != "UNKNOWN") > 0.9


def test_options_of_the_cell_apply(swing_bag: Path, cli: Cli, tmp_path: Path) -> None:
    points = ("--contact-point", "tool", "--contact-point", "hand=link4: 0.1 0 0")
    load = ("--payload", "2", "--payload-com", "-0.1", "0", "0.1", "--payload-inertia", *("0.1",) * 3, *("0",) * 3)
    words = (
        *points,
        *load,
        "--contact-area-m2",
        "3e-4",
        "--person-speed",
        "0.4",
        "--contact",
        "transient",
        "--model",
        "full",
    )
    assert cli("assess", swing_bag, "-o", tmp_path / "a.parquet", *words).returncode == 0
    settings = MonitorSettings(
        contact_points=("tool", "hand=link4: 0.1 0 0"),
        payload_mass=2.0,
        payload_com=(-0.1, 0.0, 0.1),
        payload_inertia=(0.1, 0.1, 0.1, 0.0, 0.0, 0.0),
        contact_area_m2=3e-4,
        person_speed=0.4,
        effective_mass_model=MassModel.FULL,
    )
    rows = parquet.read_table(tmp_path / "a.parquet").to_pylist()
    assert_equal(rows, core_decisions(swing_bag, settings))
    assert {row["contact_point"] for row in rows} == {"tool", "hand"}


def test_recorded_payload_counts_from_its_log_time_on(swing_bag: Path, cli: Cli, tmp_path: Path) -> None:
    """UNKNOWN before it, then the verdicts of the parameter; the other topic of payloads is another robot's."""
    with open_bag(swing_bag) as bag, BagWriter(tmp_path / "cell.mcap") as cell:
        for number, message in enumerate(bag.messages(["/joint_states"])):
            for topic, mass in (("/payload", 2.0), ("/left/payload", 5.0)):
                if number == 500:
                    load = bytes(serialize_message(Inertia(m=mass, com=Vector3(z=0.1))))
                    cell.write(topic, INERTIA, message.log_time_ns, load)
            cell.write("/joint_states", JOINT_STATE, message.log_time_ns, message.data)
    words = ("assess", tmp_path / "cell.mcap", "--payload-topic", "payload", "--params", tmp_path / "cell.yaml")
    (tmp_path / "cell.yaml").write_text("/**:\n  ros__parameters:\n    release_time: 0.0\n", encoding="utf-8")
    assert cli(*words, "-o", tmp_path / "a.parquet").returncode == 0
    rows = parquet.read_table(tmp_path / "a.parquet").to_pylist()
    assert {row["reason"] for row in rows[:3000]} == {"no payload on payload yet"}
    assert {(row["verdict"], row["allowable_speed_m_s"]) for row in rows[:3000]} == {("UNKNOWN", 0.0)}
    settings = MonitorSettings(payload_mass=2.0, payload_com=(0.0, 0.0, 0.1), release_time=0.0)
    assert_equal([{**row, "bag": ""} for row in rows[3000:]], core_decisions(swing_bag, settings)[500:])


EMPTY_HAND = """
<robot name="arm">
  <link name="base"/>
  <link name="arm"><inertial><origin xyz="0.1 0 0"/><mass value="2"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="hand"/>
  <link name="tip"/>
  <joint name="joint1" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="10" velocity="3"/></joint>
  <joint name="joint2" type="revolute"><parent link="arm"/><child link="hand"/><origin xyz="0.3 0 0"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="10" velocity="3"/></joint>
  <joint name="mount" type="fixed"><parent link="hand"/><child link="tip"/><origin xyz="0.2 0 0"/></joint>
</robot>
"""


def test_reason_that_a_payload_ends_stays_on_the_joint_states_before_it(
    swing_bag: Path, cli: Cli, tmp_path: Path
) -> None:
    """A link without mass has one as soon as it carries a load, and the text of the reason is another then."""
    (tmp_path / "arm.urdf").write_text(EMPTY_HAND, encoding="utf-8")
    with open_bag(swing_bag) as bag, BagWriter(tmp_path / "cell.mcap") as cell:
        for number, message in enumerate(bag.messages(["/joint_states"])):
            if number in {0, 500}:
                load = bytes(serialize_message(Inertia(m=number / 500.0)))
                cell.write("/payload", INERTIA, message.log_time_ns, load)
            cell.write("/joint_states", JOINT_STATE, message.log_time_ns, message.data)
    words = ("assess", tmp_path / "cell.mcap", "--robot", tmp_path / "arm.urdf", "--payload-topic", "payload")
    ignored = ("--ignored-joints", "joint3,joint4")  # of the shipped robot
    assert cli(*words, *ignored, "-o", tmp_path / "a.parquet").returncode == 0
    rows = parquet.read_table(tmp_path / "a.parquet").to_pylist()
    reason = "no mass behind joint2: the robot is heavier than the file says: correct the masses, or state moving_mass"
    assert {row["reason"] for row in rows[:500]} == {reason}
    assert {row["verdict"] for row in rows[:500]} == {"UNKNOWN"}
    assert f"held after: {reason}" in {row["reason"] for row in rows[500:]}
    assert all(row["reason"] for row in rows if row["verdict"] != "OK")


def test_recording_without_a_readable_joint_state_gives_status_1(swing_bag: Path, cli: Cli, tmp_path: Path) -> None:
    (recording,) = swing_bag.glob("*.mcap")
    content = bytearray(recording.read_bytes())
    middle = slice(len(content) // 3, len(content) // 3 + 200)
    content[middle] = bytes(255 - byte for byte in content[middle])
    (tmp_path / "damaged.mcap").write_bytes(content)
    done = cli("assess", tmp_path / "damaged.mcap", "-o", tmp_path / "a.csv")
    assert done.returncode == 1
    assert "no verdict      there was no joint state to read" in done.stdout
    assert "not read        " in done.stdout


def test_csv_contains_the_exact_assessments(swing_bag: Path, cli: Cli, tmp_path: Path) -> None:
    assert cli("assess", swing_bag, "-o", tmp_path / "a.csv").returncode == 0
    with (tmp_path / "a.csv").open(encoding="utf-8", newline="") as file:
        lines = file.readlines()
    origin = dict(line[2:].rstrip("\n").split(": ", 1) for line in lines if line.startswith("# "))
    assert (origin["scara_effmass_version"], origin["limits_hash"]) == (__version__, TABLE_HASH)
    assert MonitorSettings.model_validate_json(origin["settings"]) == MonitorSettings()
    rows: list[dict[str, Any]] = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    kinds: dict[str, Callable[[str], Any]] = {"double": float, "int64": int, "bool": "true".__eq__, "string": str}
    for row in rows:
        row.update({name: kinds[str(SCHEMA.field(name).type)](value) for name, value in row.items()})
    assert_equal(rows, core_decisions(swing_bag))


def test_mcap_contains_contact_states_at_the_recorded_times(swing_bag: Path, cli: Cli, tmp_path: Path) -> None:
    assert cli("assess", swing_bag, "-o", tmp_path / "a.mcap").returncode == 0
    decisions = core_decisions(swing_bag)
    with open_bag(tmp_path / "a.mcap") as bag:
        messages = list(bag.messages(["/contact_states"]))
        assert len(messages) == len(decisions)
        for number, (message, decision) in enumerate(zip(messages, decisions, strict=True), 1):
            assert message.log_time_ns == decision.stamp_ns
            expected = decision._replace(sequence_number=number)
            assert repr(decode_contact_states(message.data)) == repr(expected)  # NaN is equal to itself
        assert bag.deserialize(messages[0]).header.frame_id == "base_link"
        ((_, info),) = run_infos(bag)
        assert json.loads(info.note)["limits_hash"] == TABLE_HASH


def test_options_reach_the_core(swing_bag: Path, cli: Cli, tmp_path: Path) -> None:
    words = ("--region", "chest", "--region", "pelvis", "--contact", "quasi_static", "--model", "largest")
    assert cli("assess", swing_bag, "-o", tmp_path / "a.parquet", *words).returncode == 0
    settings = MonitorSettings.model_validate(
        {"body_regions": ("chest", "pelvis"), "contact": "quasi_static", "effective_mass_model": "largest"}
    )
    assert_equal(parquet.read_table(tmp_path / "a.parquet").to_pylist(), core_decisions(swing_bag, settings))


def test_summary_matches_the_rows(swing_bag: Path, cli: Cli, tmp_path: Path) -> None:
    result = json.loads(cli("assess", swing_bag, "-o", tmp_path / "a.csv", "--json").stdout)
    assert any(note.startswith("no rotor inertia for joint1") for note in result["robot_notes"])
    decisions = core_decisions(swing_bag)
    contacts = [(decision.stamp_ns, contact) for decision in decisions for contact in decision.contacts]
    counts = Counter(contact.verdict for _, contact in contacts)
    assert result["joint_states"] == result["cycles"] == len(decisions)
    worst = Counter(max((c.verdict for c in decision.contacts), key=severity) for decision in decisions)
    assert result["cycles_by_verdict"] == {verdict.name: worst[verdict] for verdict in Verdict}
    assert counts[Verdict.OK]
    assert counts[Verdict.VIOLATION]
    known = ((stamp_ns, contact) for stamp_ns, contact in contacts if contact.verdict is not Verdict.UNKNOWN)
    stamp_ns, tightest = min(known, key=lambda pair: pair[1].margin)
    assert result["tightest"]["margin_m_s"] == tightest.margin
    assert result["tightest"]["stamp_ns"] == stamp_ns
    assert result["tightest"]["body_region"] == tightest.body_region
    assert set(result["tightest"]["positions"]) == {"joint1", "joint2", "joint3", "joint4"}
    assert sum(result["seconds_by_verdict"].values()) == pytest.approx(999 * 0.002)
    assert sum(result["unknown_reasons"].values()) == worst[Verdict.UNKNOWN]


def test_several_bags_share_a_table_with_one_monitor_per_bag(swing_bag: Path, cli: Cli, tmp_path: Path) -> None:
    second = swing_recording(tmp_path / "second", 500)
    done = cli("assess", swing_bag, second, "-o", tmp_path / "a.parquet", "--json")
    rows = parquet.read_table(tmp_path / "a.parquet").to_pylist()
    assert_equal(rows, core_decisions(swing_bag) + core_decisions(second))
    assert json.loads(done.stdout)["gaps"] == 0
    assert cli("assess", swing_bag, second, "-o", tmp_path / "a.mcap").returncode == 0
    with open_bag(tmp_path / "a.mcap") as bag:
        counts = {topic.name: topic.count for topic in bag.topics}
    assert counts == {"/run_info": 1, "/bag_0_swing/contact_states": 1000, "/bag_1_second/contact_states": 500}


def test_a_recording_given_twice_counts_once(swing_bag: Path, cli: Cli, tmp_path: Path) -> None:
    copy = copytree(swing_bag, tmp_path / "copy")
    done = cli("assess", swing_bag, copy, "-o", tmp_path / "a.csv", "--json")
    assert json.loads(done.stdout)["joint_states"] == 1000
    assert f"{copy}: same content as {swing_bag}" in str(json.loads(done.stdout)["input"])


def test_undecodable_joint_state_gives_unknown_and_the_run_continues(swing_bag: Path, cli: Cli, tmp_path: Path) -> None:
    with open_bag(swing_bag) as bag, BagWriter(tmp_path / "torn.mcap") as torn:
        for number, message in enumerate(bag.messages(["/joint_states"])):
            data = message.data[:40] if number == 500 else message.data
            torn.write("/joint_states", JOINT_STATE, message.log_time_ns, data)
    done = cli("assess", tmp_path / "torn.mcap", "-o", tmp_path / "a.parquet", "--json")
    assert done.returncode == 0
    result = json.loads(done.stdout)
    assert result["joint_states"] == 1000
    rows = parquet.read_table(tmp_path / "a.parquet").to_pylist()
    rows = [row for row in rows if row["contact_point"] == "tool"]
    assert len(rows) == 1000
    assert rows[500]["verdict"] == "UNKNOWN"
    assert rows[500]["stamp_ns"] == rows[500]["log_time_ns"]
    assert rows[500]["reason"].startswith("JointState: ")
    assert rows[501]["verdict"] == "UNKNOWN"
    assert rows[501]["reason"] == f"held after: {rows[500]['reason']}"
    assert rows[499]["verdict"] != "UNKNOWN" != rows[800]["verdict"]


@pytest.mark.usefixtures("unrendered")
def test_only_unknown_is_no_success_and_says_the_remedy(swing_bag: Path, cli: Cli, tmp_path: Path) -> None:
    """A contact point that joint 4 moves has no lumped mass; auto takes another model."""
    file = yaml.safe_load(share("config", "omron_i4_550l.yaml").read_text(encoding="utf-8"))
    file["contact_points"] = {"rim": [0.05, 0.0, 0.0]}
    robot = tmp_path / "robot.yaml"
    robot.write_text(yaml.safe_dump(file), encoding="utf-8")
    words = ("--robot", robot, "--contact-point", "rim")
    done = cli("assess", swing_bag, "-o", "lumped.csv", *words, "--model", "lumped")
    assert done.returncode == 1
    assert "no verdict" in done.stdout
    assert "choose effective_mass_model auto" in done.stdout
    assert (tmp_path / "lumped.csv").is_file()
    done = cli("assess", swing_bag, "-o", "auto.csv", *words, "--report", "report", "--json")
    assert done.returncode == 0
    (model,) = json.loads(done.stdout)["mass_models"]
    assert model.startswith("full: no lumped mass: joint4 moves the contact point")


def test_wrong_robot_is_refused(swing_bag: Path, refused: Refused, tmp_path: Path) -> None:
    robot = tmp_path / "other.yaml"
    text = share("config", "omron_i4_550l.yaml").read_text(encoding="utf-8")
    robot.write_text(text.replace("name: joint", "name: axis"), encoding="utf-8")
    line = refused("assess", swing_bag, "-o", tmp_path / "a.csv", "--robot", robot)
    assert "none of its joint states names a joint of the robot (axis1, axis2, axis3, axis4)" in line
    assert "give its robot file (--robot)" in line


def test_robot_of_a_topic_is_not_replaced_by_the_default(
    swing_bag: Path, cli: Cli, refused: Refused, tmp_path: Path
) -> None:
    params = tmp_path / "cell.yaml"
    params.write_text("monitor: {ros__parameters: {await_robot_description: true}}", encoding="utf-8")
    words = ("assess", swing_bag, "-o", tmp_path / "a.csv", "--params", params)
    rule = "must be false where no topic is read, or come with the robot file by --robot"
    assert refused(*words) == f"await_robot_description = true: {rule}"
    assert cli(*words, "--robot", share("config", "omron_i4_550l.yaml")).returncode == 0


@pytest.mark.parametrize("command", ["assess", "advise"])
def test_figures_take_any_name_of_a_file(swing_bag: Path, cli: Cli, tmp_path: Path, command: str) -> None:
    path = tmp_path / os.fsdecode(b"\xff $\\frac$")
    copytree(swing_bag, path)
    report = ("-o", tmp_path / "a.csv", "--report") if command == "assess" else ("-o",)
    done = cli(command, path, "--contact-point", "tool", *report, tmp_path / "out", "--json")
    assert done.returncode == 0, done.stderr


def test_gaps_and_joint_states_of_other_devices_are_counted(swing_bag: Path, cli: Cli, tmp_path: Path) -> None:
    with open_bag(swing_bag) as bag, BagWriter(tmp_path / "mixed.mcap") as mixed:
        for number, message in enumerate(bag.messages(["/joint_states"])):
            if not 300 <= number < 600:
                mixed.write("/joint_states", JOINT_STATE, message.log_time_ns, message.data)
            elif number == 450:
                other = message.data.replace(b"joint", b"wheel")
                mixed.write("/joint_states", JOINT_STATE, message.log_time_ns, other)
    result = json.loads(cli("assess", tmp_path / "mixed.mcap", "-o", tmp_path / "a.csv", "--json").stdout)
    assert (result["joint_states"], result["foreign"], result["cycles"]) == (701, 1, 700)
    assert result["gaps"] == 1
    assert result["longest_gap_s"] == pytest.approx(301 * 0.002)
    assert result["seconds_by_verdict"]["UNKNOWN"] >= 301 * 0.002 - 0.2


@pytest.mark.parametrize("silence_s", [0.1, 4.0])
def test_recording_that_goes_on_without_the_arm_says_so(
    swing_bag: Path, cli: Cli, tmp_path: Path, silence_s: float
) -> None:
    with open_bag(swing_bag) as bag, BagWriter(tmp_path / "on.mcap") as longer:
        for message in bag.messages(["/joint_states"]):
            longer.write("/joint_states", JOINT_STATE, message.log_time_ns, message.data)
        end_ns = message.log_time_ns + round(silence_s * 1e9)
        longer.write("/joint_states", JOINT_STATE, end_ns, message.data.replace(b"joint", b"wheel"))
    done = cli("assess", tmp_path / "on.mcap", "-o", tmp_path / "a.csv")
    line = "no joint state of the arm in the last 4.00 s of the recording: UNKNOWN live"
    assert (line in done.stdout) == (silence_s > 1.0)
    result = json.loads(cli("assess", tmp_path / "on.mcap", "-o", tmp_path / "b.csv", "--json").stdout)
    assert result["silence_at_end_s"] == pytest.approx(silence_s if silence_s > 1.0 else 0.0)


@pytest.mark.usefixtures("unrendered")
def test_report_shows_every_contact_point_and_episode(swing_bag: Path, cli: Cli, tmp_path: Path) -> None:
    words = ("assess", swing_bag, share("bags", "tour"), "-o", tmp_path / "a.csv", "--report", tmp_path / "report")
    done = cli(*words)
    assert (done.returncode, done.stderr) == (0, "")
    assert str(tmp_path / "report" / "report.html") in done.stdout
    runs = ("run", *(f"run_{number}" for number in range(2, 13)))  # of each contact and recording
    figures = [f"{name}{suffix}" for name in runs for suffix in (".png", ".svg")]
    files = {path.name for path in (tmp_path / "report").iterdir()}
    assert files == {"report.html", *figures, "summary.json"}
    summary = json.loads((tmp_path / "report" / "summary.json").read_text(encoding="utf-8"))
    assert summary["figures"] == [str(tmp_path / "report" / name) for name in figures]
    assert {episode["run"].rpartition(" ")[2] for episode in summary["episodes"]} == {"swing", "tour"}
    links = {"link1", "link2", "link3", "link4"}
    assert {episode["contact_point"] for episode in summary["episodes"]} == {"tool", "elbow"} | links
    violation = min((e for e in summary["episodes"] if e["min_margin_m_s"]), key=lambda e: e["min_margin_m_s"])
    assert violation["verdict"] == "VIOLATION"
    assert violation["min_margin_m_s"] == summary["tightest"]["margin_m_s"]
    assert set(violation["positions"]) == {"joint1", "joint2", "joint3", "joint4"}
    assert violation["body_region"] == summary["tightest"]["body_region"] == "lower_leg"
    assert "abdomen" in violation["reason"]  # which governs at the start of the interval
    assert violation["remedy"] == remedy(Reason.TOO_FAST) != ""
    assert all(episode["remedy"] for episode in summary["episodes"])
    assert abs(violation["stamp_ns"] - summary["tightest"]["stamp_ns"]) <= 1e9 * violation["duration_s"] + 1
    page = (tmp_path / "report" / "report.html").read_text(encoding="utf-8")
    assert violation["remedy"] in page
    assert page.count("data:image/png;base64,") == len(runs)
    assert "not a certified safety function" in page
    assert "no rotor inertia for joint1" in page

    again = cli(*words, "--force")
    assert again.returncode == 0
    (tmp_path / "a.csv").unlink()
    page_path = tmp_path / "report" / "report.html"
    page_path.write_text("existing", encoding="utf-8")
    assert cli(*words).stderr == f"{page_path}: already exists; use --force to replace it\n"
    assert page_path.read_text(encoding="utf-8") == "existing"
    assert not (tmp_path / "a.csv").exists()


def test_options_without_effect_are_refused(swing_bag: Path, refused: Refused, tmp_path: Path) -> None:
    words, table = ("assess", swing_bag, "-o"), tmp_path / "a.csv"
    assert refused(*words, table, "--cell", "A7") == f"--cell = A7: must be for a dataset, not for {table}"
    assert refused(*words, table, "--pdf") == "--pdf: must come with --report"


def test_several_topics_need_the_topic_option(swing_bag: Path, cli: Cli, refused: Refused, tmp_path: Path) -> None:
    with open_bag(swing_bag) as bag, BagWriter(tmp_path / "two.mcap") as two:
        for message in bag.messages(["/joint_states"]):
            two.write("/left/joint_states", JOINT_STATE, message.log_time_ns, message.data)
            two.write("/right/joint_states", JOINT_STATE, message.log_time_ns, message.data)
    words = ("assess", tmp_path / "two.mcap", "-o", tmp_path / "a.csv")
    choice = "--topic is empty: must be one of /left/joint_states (sensor_msgs/msg/JointState), /right/joint_states "
    assert choice in refused(*words)
    assert cli(*words, "--topic", "left/joint_states").returncode == 0


@pytest.mark.parametrize("suffix", [".parquet", ".csv", ".mcap"])
def test_existing_output_needs_force(suffix: str, swing_bag: Path, cli: Cli, refused: Refused, tmp_path: Path) -> None:
    out = tmp_path / f"a{suffix}"
    assert cli("assess", swing_bag, "-o", out).returncode == 0
    first = out.stat()
    assert refused("assess", swing_bag, "-o", out).startswith(f"{out}: already exists")
    assert cli("assess", swing_bag, "-o", out, "--force").returncode == 0
    assert (out.stat().st_ino, out.stat().st_mtime_ns) != (first.st_ino, first.st_mtime_ns)
    assert list(tmp_path.iterdir()) == [out]


# ru_maxrss would also count the memory of the parent process.
MEMORY = """
import pathlib, sys
from scara_effmass.analysis import assessment
from scara_effmass.cli import main
assessment.ROWS = 8_192
for bag in sys.argv[2:]:
    assert main(["assess", bag, "-o", sys.argv[1], "--force"]) == 0
    status = pathlib.Path("/proc/self/status").read_text().splitlines()
    (peak,) = (line for line in status if line.startswith("VmHWM"))
    print(int(peak.split()[1]) / 1024, file=sys.stderr)
"""


@pytest.mark.live
@pytest.mark.parametrize("suffix", [".csv", ".mcap"])
def test_memory_does_not_grow_with_the_recording(suffix: str, swing_bag: Path, long_bag: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-c", MEMORY, str(tmp_path / f"a{suffix}"), str(swing_bag), str(long_bag)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    short_mb, long_mb = map(float, done.stderr.split())
    assert long_mb < 400.0
    # 30 times as many rows: what grows is one row group, not the recording.
    assert long_mb - short_mb < 80.0


@pytest.mark.live
def test_memory_does_not_grow_with_the_recording_where_many_are_assessed_at_once(tmp_path: Path) -> None:
    paths = [tmp_path / "short.mcap", tmp_path / "long.mcap"]
    for path, count in zip(paths, (20_000, 100_000), strict=True):
        with BagWriter(path) as bag:
            bag.write_joint_states("/joint_states", swing(count))
    command = [sys.executable, "-c", MEMORY, str(tmp_path / "a.parquet"), *map(str, paths)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    short_mb, long_mb = map(float, done.stderr.split())
    assert long_mb < 400.0
    assert long_mb - short_mb < 80.0


@pytest.mark.parametrize("suffix", ["parquet", "csv", "mcap"])
def test_verdicts_of_the_shipped_bags_have_all_properties(suffix: str, tmp_path: Path, cli: Cli) -> None:
    table = tmp_path / f"tour.{suffix}"
    done = cli("assess", share("bags", "tour"), "-o", table, "--properties", "--json")
    checks = json.loads(done.stdout)["properties"]
    assert (done.returncode, [check["violations"] for check in checks]) == (0, [0] * (len(PROPERTIES) - 1))
    assert {check["evaluated"] for check in checks} == {6 * 7625}


def test_properties_of_a_csv_file_whose_verdicts_are_all_ok(tmp_path: Path, cli: Cli) -> None:
    state = next(swing(2))
    with BagWriter(tmp_path / "slow.mcap") as bag:
        bag.write_joint_states("/joint_states", [state._replace(velocity=np.full(4, 0.01))])
    done = cli("assess", "slow.mcap", "-o", "a.csv", "--properties", "--json", "--payload", "0", "--drives", "free")
    result = json.loads(done.stdout)
    assert result["cycles_by_verdict"]["OK"] == 1
    assert (done.returncode, {check["violations"] for check in result["properties"]}) == (0, {0})


def test_recorded_verdicts_that_violate_a_property_give_exit_code_1(swing_bag: Path, tmp_path: Path, cli: Cli) -> None:
    encoder = ContactStatesEncoder("base_link")
    with open_bag(swing_bag) as swing, BagWriter(tmp_path / "live") as live:
        for message in swing.messages():
            live.write(message.topic, message.type, message.log_time_ns, message.data)
            contact = unknown_contact("tool", "no reason")._replace(allowable_speed=0.1)
            state = assessments_of(decision_on(contact, stamp_ns=message.log_time_ns))
            live.write("/contact_states", CONTACT_STATES, message.log_time_ns, encoder.encode(state))
    done = cli("assess", tmp_path / "live", "-o", "live.parquet", "--properties")
    assert done.returncode == 1
    assert (
        f"{tmp_path / 'live'}: UNKNOWN implies speed 0: violated 1 times, first in /contact_states: tool, at 17672"
        in (" ".join(done.stdout.split()))
    )

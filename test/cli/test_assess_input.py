# SPDX-License-Identifier: Apache-2.0
"""`assess` of recordings with other names, without names, stamps or velocities, on other clocks, unreadable."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from shutil import copyfile
from typing import Any

import numpy as np
import pytest
from pyarrow import parquet

from scara_effmass.bags.files import open_bag
from scara_effmass.bags.writer import BagWriter
from scara_effmass.share import share
from scara_effmass.values import JointState
from scara_effmass.wire.joint_state import joint_state_message
from scara_effmass.wire.message_types import INERTIA, STRING
from test.cli.conftest import START_NS, Cli, Refused

Change = Callable[[JointState], JointState]
MakeBag = Callable[[str, Change], Path]
JOINT_STATE = "sensor_msgs/msg/JointState"
SKEW_NS = 203 * 10**9
NO_NUMBERS = np.empty(0)


@pytest.fixture
def changed_bag(swing_bag: Path, tmp_path: Path) -> MakeBag:
    """Return a function that writes the swing with changed joint states, at the same log times."""

    def write(name: str, change: Change) -> Path:
        with open_bag(swing_bag) as bag, BagWriter(tmp_path / name) as changed:
            for block in bag.joint_state_blocks():
                for log_time_ns, state in zip(block.log_time_ns.tolist(), block.states(), strict=True):
                    changed.write("/joint_states", JOINT_STATE, log_time_ns, joint_state_message(change(state)))
        return tmp_path / name

    return write


@pytest.fixture
def plain(swing_bag: Path, cli: Cli, tmp_path: Path) -> list[dict[str, Any]]:
    """Return the rows of the unchanged swing."""
    assert cli("assess", swing_bag, "-o", tmp_path / "plain.parquet").returncode == 0
    return rows_of(tmp_path / "plain.parquet")


def rows_of(path: Path) -> list[dict[str, Any]]:
    """Return the rows of a table without the recording; a mass that is not there is None, which equals itself."""
    rows = parquet.read_table(path).drop_columns("bag").to_pylist()

    def shown(value: object) -> object:
        return None if isinstance(value, float) and math.isnan(value) else value

    return [{name: shown(value) for name, value in row.items()} for row in rows]


@pytest.mark.parametrize(
    ("change", "options", "notes"),
    [
        (
            lambda state: state._replace(names=tuple(f"left/{name}" for name in state.names)),
            ["--joint-map", "left/*=*"],
            ["joint names     mapped by joint_map: left/*=*"],
        ),
        (
            lambda state: state._replace(names=()),
            ["--joint-names", "joint1,joint2,joint3,joint4"],
            ["joint names     of joint states without names, by joint_names: joint1, joint2, joint3, joint4"],
        ),
        (
            lambda state: state,
            ["--person-direction", "1", "0", "0"],
            ["no effect       person_direction = (1.0, 0.0, 0.0) has no effect without person_speed"],
        ),
        (
            lambda state: state._replace(stamp_ns=0),
            ["--time", "log"],
            ["time            log times in place of header stamps"],
        ),
        (
            lambda state: state._replace(stamp_ns=state.stamp_ns + SKEW_NS),
            ["--time", "header"],
            [
                "time            header stamps alone",
                "clock skew      header stamps lead the log times by 203.000 to 203.000 s",
            ],
        ),
    ],
    ids=["prefix", "no names", "no effect", "zero stamps", "clock skew"],
)
def test_odd_recording_is_assessed_as_the_plain_one_and_the_output_says_how(
    change: Change,
    options: list[str],
    notes: list[str],
    plain: list[dict[str, Any]],
    changed_bag: MakeBag,
    cli: Cli,
    tmp_path: Path,
) -> None:
    done = cli("assess", changed_bag("odd.mcap", change), "-o", tmp_path / "odd.parquet", *options)
    assert done.returncode == 0
    assert done.stdout.splitlines()[2 : 2 + len(notes)] == notes
    rows = rows_of(tmp_path / "odd.parquet")
    skew_ns = rows[0]["stamp_ns"] - plain[0]["stamp_ns"]
    assert [row | {"stamp_ns": row["stamp_ns"] - skew_ns} for row in rows] == plain
    ((subject, text), *_) = json.loads(parquet.read_schema(tmp_path / "odd.parquet").metadata[b"input"])
    assert f"{subject:<16}{text}" == notes[0]


def test_remedy_for_coarse_stamps_gives_the_verdicts_of_the_plain_recording(
    plain: list[dict[str, Any]], changed_bag: MakeBag, cli: Cli, tmp_path: Path
) -> None:
    coarse = changed_bag("coarse.mcap", lambda s: s._replace(stamp_ns=s.stamp_ns // 10_000_000 * 10_000_000))
    done = cli("assess", coarse, "-o", tmp_path / "a.csv", "--json")
    result = json.loads(done.stdout)
    assert next(iter(result["unknown_reasons"])) == "the header stamp is repeated"
    assert result["remedy"].endswith("; offline, `--time log` takes the recorder's time")
    assert cli("assess", coarse, "-o", tmp_path / "b.parquet", "--time", "log").returncode == 0
    assert rows_of(tmp_path / "b.parquet") == plain


def test_skew_of_the_clock_is_named_with_its_size(changed_bag: MakeBag, cli: Cli, tmp_path: Path) -> None:
    ahead = changed_bag("ahead.mcap", lambda state: state._replace(stamp_ns=state.stamp_ns + SKEW_NS))
    done = cli("assess", ahead, "-o", tmp_path / "a.csv")
    assert "clock skew      header stamps lead the log times by 203.000 to 203.000 s: --time header" in done.stdout
    behind = changed_bag("behind.mcap", lambda state: state._replace(stamp_ns=state.stamp_ns - SKEW_NS))
    done = cli("assess", behind, "-o", tmp_path / "b.csv", "--json")
    (skew,) = json.loads(done.stdout)["input"]
    assert skew[1].startswith("header stamps lead the log times by -203.000 to -203.000 s")


def test_stamp_that_goes_back_is_refused_on_the_clock_of_the_headers(
    changed_bag: MakeBag, cli: Cli, tmp_path: Path
) -> None:
    late = START_NS + 10**9
    back = changed_bag("back.mcap", lambda s: s._replace(stamp_ns=s.stamp_ns - 30_000_000 * (s.stamp_ns == late)))
    done = cli("assess", back, "-o", tmp_path / "a.csv", "--time", "header", "--json")
    counts = json.loads(done.stdout)["unknown_reasons"]
    assert [n for reason, n in counts.items() if reason.startswith("the header stamp goes back by 0.028")] == [1]


@pytest.mark.parametrize("window_s", [0.0, 0.02])
def test_velocity_from_positions_is_near_the_recorded_one(
    window_s: float, plain: list[dict[str, Any]], changed_bag: MakeBag, cli: Cli, tmp_path: Path
) -> None:
    still = changed_bag("still.mcap", lambda state: state._replace(velocity=NO_NUMBERS))
    words = ("--velocity", "from-positions", "--velocity-window", str(window_s))
    done = cli("assess", still, "-o", tmp_path / "a.parquet", *words)
    how = "slope of the least-squares line over 0.02 s, 0.01 s late" if window_s else "between two, half their distance"
    assert f"velocity        computed from positions: {how}" in done.stdout
    rows = rows_of(tmp_path / "a.parquet")
    contacts = 6
    late = contacts * 5 if window_s else 0  # joint states are 2 ms apart
    delays = [row["velocity_delay_s"] for row in rows[20 * contacts :]]
    assert delays == pytest.approx([0.01 if window_s else 0.001] * len(delays))
    for row, before in zip(rows[120 * contacts :], plain[120 * contacts - late :], strict=False):
        assert row["verdict"] != "UNKNOWN"
        if row["contact_point"] in {"tool", "elbow"}:  # a link can count at another vertex
            assert row["speed_m_s"] == pytest.approx(before["speed_m_s"], abs=0.002)


def test_velocities_of_another_recording_are_joined_by_log_time(
    swing_bag: Path, plain: list[dict[str, Any]], changed_bag: MakeBag, cli: Cli, refused: Refused, tmp_path: Path
) -> None:
    positions = changed_bag("positions.mcap", lambda state: state._replace(velocity=NO_NUMBERS))
    with open_bag(swing_bag) as bag, BagWriter(tmp_path / "velocities.mcap") as velocities:
        number = 0
        for block in bag.joint_state_blocks():
            for log_time_ns, state in zip(block.log_time_ns.tolist(), block.states(), strict=True):
                if number % 5 == 0 and not 400 < number < 700:
                    turned = JointState(0, state.names[::-1], NO_NUMBERS, state.velocity[::-1])
                    velocities.write("/velocities", JOINT_STATE, log_time_ns + 1_000_000, joint_state_message(turned))
                number += 1
        velocities.write("/velocities", JOINT_STATE, log_time_ns, b"damaged")
    words = ("assess", positions, "--velocity-bag", tmp_path / "velocities.mcap")
    done = cli(*words, "-o", tmp_path / "a.parquet")
    assert done.returncode == 0
    assert f"velocity        from {tmp_path / 'velocities.mcap'}, interpolated at the log times" in done.stdout
    assert f"not read        {tmp_path / 'velocities.mcap'}: /velocities: left out: " in done.stdout
    rows = rows_of(tmp_path / "a.parquet")
    empty = sum(row["reason"].startswith("the velocity is empty") for row in rows) // 6
    assert (
        f"velocity        {empty} joint states have none in {tmp_path / 'velocities.mcap'}: before or " in done.stdout
    )
    for number, (row, expected) in enumerate(zip(rows[::6], plain[::6], strict=True)):
        missing = number < 1 or 400 < number <= 700 or number > 995
        assert row["reason"].startswith("the velocity is empty") == missing, number
        if row["verdict"] != "UNKNOWN":
            assert row["speed_m_s"] == pytest.approx(expected["speed_m_s"], abs=0.004)
    assert "must be reported" in refused(*words, "-o", tmp_path / "b.csv", "--velocity", "from-positions")
    line = refused("assess", positions, swing_bag, *words[2:], "-o", tmp_path / "b.csv")
    assert line.endswith("must belong to one recording, not to 2")


def test_unreadable_bag_is_reported_and_the_others_are_assessed(
    swing_bag: Path, plain: list[dict[str, Any]], changed_bag: MakeBag, cli: Cli, refused: Refused, tmp_path: Path
) -> None:
    folder = tmp_path / "many"
    folder.mkdir()
    copyfile(swing_bag / "swing_0.mcap", folder / "good.mcap")
    (folder / "broken.mcap").write_bytes(b"no bag")
    changed_bag("many/other.mcap", lambda state: state._replace(names=tuple(f"a_{name}" for name in state.names)))
    done = cli("assess", folder, "-o", tmp_path / "a.parquet", "--json")
    assert done.returncode == 1
    broken, other = json.loads(done.stdout)["unreadable"]
    assert broken.startswith(f"{folder / 'broken.mcap'}: is not a bag")
    assert "try joint_map a_joint1=joint1,a_joint2=joint2,a_joint3=joint3,a_joint4=joint4; " in other
    assert rows_of(tmp_path / "a.parquet") == plain
    (folder / "good.mcap").unlink()
    assert "broken.mcap: is not a bag" in refused("assess", folder, "-o", tmp_path / "b.parquet")


def test_joint_limits_by_option(swing_bag: Path, cli: Cli, refused: Refused, tmp_path: Path) -> None:
    words = ("assess", swing_bag, "-o", tmp_path / "a.csv", "--joint-limits")
    done = cli(*words, "joint1=-0.1 0.1,joint2=-3 3")
    assert "joint limits    by joint_limits: joint1=-0.1 0.1, joint2=-3 3" in done.stdout
    assert "lies outside its limits -0.12 to 0.12" in done.stdout
    again = cli(*words, "joint1=-0.1 0.1", "--joint-limits", "joint2=-3 3", "--force")
    assert again.stdout == done.stdout
    assert "joint_limits = 'jiont1': must be joint1" in refused(*words, "jiont1=-1 1", "--force")


def widened(state: JointState, names: tuple[str, ...], position: float, velocity: float) -> JointState:
    """Return `state` with further joints."""
    return state._replace(
        names=(*state.names, *names),
        position=np.append(state.position, [position] * len(names)),
        velocity=np.append(state.velocity, [velocity] * len(names)),
    )


def test_summary_names_the_robot_and_its_file(swing_bag: Path, cli: Cli, tmp_path: Path) -> None:
    robot = share("config", "omron_i4_550l.yaml")
    default, stated = (
        cli("assess", swing_bag, "-o", tmp_path / "a.csv", "--force", *o) for o in ((), ("--robot", robot))
    )
    assert default.stdout.startswith(
        f"robot           omron_i4_550l ({robot}), the default: give --robot for another one\n"
    )
    assert stated.stdout.startswith(f"robot           omron_i4_550l ({robot})\n")
    result = json.loads(cli("assess", swing_bag, "-o", tmp_path / "b.csv", "--json").stdout)
    assert result["robot"] == {"name": "omron_i4_550l", "file": str(robot), "is_default": True}


def test_more_joints_of_the_same_names_are_another_arm(changed_bag: MakeBag, cli: Cli, tmp_path: Path) -> None:
    bag = changed_bag("six", lambda state: widened(state, ("joint5", "joint6"), 0.0, 0.0))
    done = cli("assess", bag, "-o", tmp_path / "a.csv")
    assert done.returncode == 1
    assert (
        "UNKNOWN because joint states of another arm than omron_i4_550l, which has no joint5, joint6 (1000"
        in done.stdout
    )
    assert "remedy          give the robot file of this arm by `--robot`" in done.stdout


def test_positions_beyond_the_limits_of_the_default_are_another_arm(
    changed_bag: MakeBag, cli: Cli, tmp_path: Path
) -> None:
    bag = changed_bag("other", lambda state: state._replace(position=state.position - [0.0, 0.0, 0.225, 0.0]))
    done = cli("assess", bag, "-o", tmp_path / "a.csv")
    assert done.returncode == 1
    (line,) = (line for line in done.stdout.splitlines() if line.startswith("another arm"))
    assert "lie outside the limits: joint states of another arm than omron_i4_550l?" in line
    stated = cli("assess", bag, "-o", tmp_path / "b.csv", "--robot", share("config", "omron_i4_550l.yaml"))
    assert "another arm" not in stated.stdout


@pytest.mark.usefixtures("unrendered")
def test_report_of_joint_states_without_finite_positions(changed_bag: MakeBag, cli: Cli, tmp_path: Path) -> None:
    def change(state: JointState) -> JointState:
        position = np.append(state.position, math.inf)
        position[1] = math.nan if state.stamp_ns > START_NS + 10**9 else position[1]
        return JointState(state.stamp_ns, (*state.names, "valve"), position, np.append(state.velocity, 0.0))

    words = ("-o", tmp_path / "a.csv", "--report", tmp_path / "report", "--ignored-joints", "valve", "--json")
    done = cli("assess", changed_bag("nan.mcap", change), *words)
    assert (done.returncode, done.stderr) == (0, "")
    assert set(json.loads(done.stdout)["tightest"]["positions"]) == {"joint1", "joint2", "joint3", "joint4"}
    summary = json.loads((tmp_path / "report" / "summary.json").read_text(encoding="utf-8"))
    nan = next(episode for episode in summary["episodes"] if episode["reason"] == "the position of joint2 is nan")
    assert set(nan["positions"]) == {"joint1", "joint3", "joint4"}


def test_topic_beside_the_assessed_one_is_named_with_what_it_states(swing_bag: Path, cli: Cli, tmp_path: Path) -> None:
    with open_bag(swing_bag) as bag, BagWriter(tmp_path / "two") as both:
        for message in bag.messages():
            both.write(message.topic, message.type, message.log_time_ns, message.data)
        for topic, name, speed in (("/rail/joint_states", "rail", 0.5), ("/door/joint_states", "door", 0.0)):
            moving = (
                JointState(START_NS + i * 10**8, (name,), np.array([i * 0.1 * speed]), np.array([speed]))
                for i in range(5)
            )
            both.write_joint_states(topic, moving)
        both.write("/payload", INERTIA, START_NS, b"")
    result = json.loads(cli("assess", tmp_path / "two", "-o", tmp_path / "a.csv", "--json").stdout)
    assert sorted(text for subject, text in result["input"] if subject == "other topic") == [
        "/door/joint_states is not assessed",
        "/payload states a payload, which is not applied: --payload-topic payload applies it",
        "/rail/joint_states is not assessed, but joints outside the model moved: rail",
    ]


@pytest.mark.parametrize(
    "command",
    [
        ("assess", "-o", "a.csv"),
        ("advise", "-o", "a"),
        ("coverage", "-o", "a"),
        ("identify", "-o", "a"),
        ("demo", "--bag"),
    ],
)
def test_recording_that_describes_its_robot_is_not_assessed_as_the_default_one(
    swing_bag: Path, cli: Cli, refused: Refused, tmp_path: Path, command: tuple[str, ...]
) -> None:
    with open_bag(swing_bag) as bag, BagWriter(tmp_path / "described") as described:
        for message in bag.messages():
            described.write(message.topic, message.type, message.log_time_ns, message.data)
        described.write("/arm/robot_description", STRING, START_NS, b"")
    name, *options = command
    rule = "/arm/robot_description describes its robot: give the file of that one (--robot)"
    assert refused(name, *options, tmp_path / "described").endswith(f"described: {rule}")
    robot = share("config", "omron_i4_550l.yaml")
    assert cli("assess", tmp_path / "described", "-o", tmp_path / "b.csv", "--robot", robot).returncode == 0


def test_joint_outside_the_model_is_named_or_ignored(changed_bag: MakeBag, cli: Cli, tmp_path: Path) -> None:
    bag = changed_bag("rail", lambda state: widened(state, ("rail", "lift"), 0.0, 0.4))
    done = cli("assess", bag, "-o", tmp_path / "a.csv")
    assert "UNKNOWN because joint rail moves, but is not in the model (1000 cycles)" in done.stdout
    assert "not modelled    rail, lift: these joints moved, but are not in the model" in done.stdout
    result = json.loads(cli("assess", bag, "-o", tmp_path / "b.csv", "--json", "--ignored-joints", "ra*,lift").stdout)
    assert (result["ignored_joints"], result["unmodelled_joints"]) == (["ra*", "lift"], [])
    assert result["scope"].endswith("; motion does not count of ra*, lift")
    assert result["cycles_by_verdict"]["UNKNOWN"] < 100
    stated = cli("assess", bag, "-o", tmp_path / "c.csv", "--ignored-joints", "rail,door")
    assert "ignored joints  no joint state names door" in stated.stdout
    dataset = [json.loads(cli("assess", bag, "-o", tmp_path / "data", "--json").stdout) for _ in range(2)]
    assert [result["unmodelled_joints"] for result in dataset] == [["rail", "lift"]] * 2

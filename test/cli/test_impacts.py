# SPDX-License-Identifier: Apache-2.0
"""`impacts`: the contacts of a recording without joint states, and what is left out."""

import json
import re
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from nptdms import ChannelObject, TdmsWriter

from scara_effmass.analysis.forces import recorded_contacts
from scara_effmass.bags.files import open_bag
from scara_effmass.bags.writer import BagWriter
from scara_effmass.settings import DetectionSettings, ImportSettings
from scara_effmass.values import ForceBlock
from scara_effmass.wire.force import force_block_message
from scara_effmass.wire.message_types import FORCE_BLOCK, WRENCH_STAMPED
from test.bags.messages import header, message, serialized
from test.cli.conftest import Cli, Refused
from test.daq.force_bag import force_block, write_blocks

CASES = Path(__file__).parents[1] / "recordings" / "contacts"
BAGS = Path(__file__).parents[2] / "bags"
CLAMPING = CASES / "impact_then_clamping_50N_2s.csv"


def written(path: Path, force: list[float] | np.ndarray) -> Path:
    rows = (f"{number / 1000.0:.3f},{value:.3f}" for number, value in enumerate(force))
    path.write_text("\n".join(["Time (s),Force (N)", *rows, ""]), encoding="utf-8")
    return path


def test_contacts_of_files_as_json(cli: Cli) -> None:
    done = cli("impacts", CLAMPING, CASES / "impact_then_clamping_50N_0.6s.csv", "--json")
    assert (done.returncode, done.stderr) == (0, "")
    result = json.loads(done.stdout)
    assert result["contacts"] == 2
    for recording, duration in zip(result["recordings"], (2.0, 0.6), strict=True):
        (contact,) = recording["contacts"]
        assert contact["time_s"] == pytest.approx(2.0, abs=0.002)
        assert contact["peak_force_n"] == pytest.approx(158.0, abs=1.0)
        assert contact["held_force_n"] == pytest.approx(50.0, abs=1.0)
        assert contact["duration_s"] == pytest.approx(duration, abs=0.01)
        assert contact["impulse_n_s"] == pytest.approx(50.0 * duration + 2.0, rel=0.05)
        assert (recording["samples"], recording["lost_samples"], recording["left_out"]) == (6000, 0, [])


def test_the_list_has_a_line_for_each_contact_and_for_what_is_left_out(cli: Cli, tmp_path: Path) -> None:
    force = np.random.default_rng(0).normal(0.0, 0.1, 20_000)
    force[3_000:3_020] += 120.0 * np.sin(np.pi * np.arange(20) / 20.0)
    force[6_000] += 90.0
    force[8_000:] += np.interp(np.arange(12_000), [0, 4_000, 5_000, 11_000], [0.0, 40.0, 40.0, 0.0])
    done = cli("impacts", written(tmp_path / "force.csv", force))
    assert done.returncode == 0
    lines = [" ".join(line.split()) for line in done.stdout.splitlines()]
    assert "contacts 1" in lines
    assert any(line.startswith("3.000 120.") and line.endswith(" -") for line in lines)
    left_out = [line for line in lines if line.startswith("left out ")]
    assert len(left_out) == 2
    assert re.match(r"left out 1: single samples \(up to (89.9|90.\d) N\) at 6.000 s", left_out[0])
    assert re.match(
        r"left out 1: slow change: drift, or a press that comes and goes slowly \(up to (39|40)", left_out[1]
    )


def test_a_line_of_a_contact_has_what_stayed_and_remarks(tmp_path: Path) -> None:
    """As `demo` prints it."""
    time = np.arange(8000) / 1000.0
    force = np.random.default_rng(0).normal(0.0, 0.05, time.size) + 60.0 * ((time >= 2.0) & (time < 4.0))
    file = written(tmp_path / "press.csv", force)
    (text,) = recorded_contacts(file, ImportSettings(), DetectionSettings()).texts()
    assert re.fullmatch(r"at 1\.999 s: 60\.\d N, 119\.9\d+ N s, 2001\.0 ms, held 60\.\d N, press", text)


def test_a_contact_that_was_measured_for_five_seconds_lasted_at_least_that_long(cli: Cli, tmp_path: Path) -> None:
    force = np.random.default_rng(0).normal(0.0, 0.1, 25_000)
    force[2_000:6_000] += 60.0
    force[8_000:23_000] += 60.0
    done = cli("impacts", written(tmp_path / "force.csv", force))
    rows = [line.split() for line in done.stdout.splitlines() if line.strip().endswith(("press", "at least"))]
    assert [" ".join(row[5:]) for row in rows] == ["press", "press, over 5 s: at least"]


@pytest.mark.parametrize("coupling", ["AC", "DC"])
def test_ac_coupling_makes_held_forces_too_small(cli: Cli, tmp_path: Path, coupling: str) -> None:
    force = np.random.default_rng(0).normal(0.0, 0.1, 10_000)
    force[3_000:5_000] += 60.0 * np.exp(-0.628 * np.arange(2_000) / 1_000.0 * (coupling == "AC"))
    block = ForceBlock(10**18, "cell", 0, 1_000.0, force, source=f"cDAQ1Mod1/ai0, IEPE, {coupling} coupling")
    with BagWriter(tmp_path / "held.mcap") as bag:
        bag.write("/force", FORCE_BLOCK, 10**18, force_block_message(block))
    (recording,) = json.loads(cli("impacts", tmp_path / "held.mcap", "--json").stdout)["recordings"]
    assert recording["contacts"][0]["held_force_n"] > 40.0
    is_said = any("held forces are larger than measured" in problem for problem in recording["problems"])
    assert is_said == (coupling == "AC")


def test_a_wrong_sign_is_said(cli: Cli, tmp_path: Path) -> None:
    force = np.random.default_rng(0).normal(0.0, 0.1, 8_000)
    force[3_000:3_020] -= 120.0 * np.sin(np.pi * np.arange(20) / 20.0)
    path = written(tmp_path / "force.csv", force)
    assert "read files and wrenches with --invert" in cli("impacts", path).stdout
    assert "read files and wrenches without --invert" in cli("impacts", written(path, -force), "--invert").stdout
    written(path, force)
    (contact,) = json.loads(cli("impacts", path, "--invert", "--json").stdout)["recordings"][0]["contacts"]
    assert contact["peak_force_n"] == pytest.approx(120.0, abs=1.0)


@pytest.mark.parametrize("name", ["force.tdms", "force.mcap", "wrench.mcap"])
def test_a_part_that_cannot_be_read_is_said(cli: Cli, tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    if name == "force.tdms":
        properties = {"wf_increment": 1e-3, "unit_string": "N"}
        with TdmsWriter(path) as writer:
            writer.write_segment([ChannelObject("g", "c", np.random.default_rng(0).normal(size=8_000), properties)])
    elif name == "force.mcap":
        (source,) = (BAGS / "campaign" / "300_-200_2390g_1").glob("*.mcap")
        path.write_bytes(source.read_bytes())
    else:
        vector = message("geometry_msgs/msg/Vector3", {"x": 0.0, "y": 0.0, "z": 0.0})
        wrench = message("geometry_msgs/msg/Wrench", {"force": vector, "torque": vector})
        with BagWriter(path) as bag:
            for number in range(8_000):
                stamp_ns = 10**18 + number * 10**6
                content = {"header": header(stamp_ns, "ft"), "wrench": wrench}
                bag.write("/wrench", WRENCH_STAMPED, stamp_ns, serialized(WRENCH_STAMPED, content))
    assert json.loads(cli("impacts", path, "--json").stdout)["recordings"][0]["complete"]
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 45 // 100])
    (recording,) = json.loads(cli("impacts", path, "--json").stdout)["recordings"]
    assert not recording["complete"]
    assert "cut off" in recording["problems"][0]
    assert re.search(rf"not read +{path}: (is )?cut off", cli("impacts", path).stdout)


def test_an_open_sensor_is_no_force_of_zero(cli: Cli, tmp_path: Path) -> None:
    noise = np.random.default_rng(0).normal(0.0, 0.1, 4000)
    marks = np.arange(1000, dtype=np.uint32)
    blocks = [force_block(n, 1000, force=noise[n : n + 1000]) for n in range(0, 4000, 1000)]
    blocks[2] = blocks[2]._replace(saturated_samples=marks)
    (recording,) = json.loads(cli("impacts", write_blocks(tmp_path / "a.mcap", blocks), "--json").stdout)["recordings"]
    (left_out,) = recording["left_out"]
    assert (left_out["count"], left_out["peak_force_n"], recording["complete"]) == (1, None, False)
    assert left_out["reason"] == "no valid sample: sensor open, shorted or overloaded"


def test_recordings_of_the_nodes_are_read(cli: Cli) -> None:
    bag = BAGS / "campaign" / "300_-200_2390g_1"
    (recording,) = json.loads(cli("impacts", bag, "--json").stdout)["recordings"]
    assert recording["simulated"]
    (force,) = (line for line in cli("impacts", bag).stdout.splitlines() if line.startswith("force "))
    assert force.count("simulated") == 1
    assert "not measured" in force
    assert [contact["rebound"] for contact in recording["contacts"]] == list(range(len(recording["contacts"])))
    assert recording["contacts"][0]["peak_force_n"] == pytest.approx(406.0, abs=1.0)


def test_samples_that_are_not_finite_are_lost(cli: Cli, tmp_path: Path) -> None:
    with open_bag(BAGS / "campaign" / "300_-200_2390g_1") as bag, BagWriter(tmp_path / "gap") as writer:
        for (log_time_ns, block), number in zip(bag.timed_force_blocks("/force"), count()):
            force = np.where(np.arange(block.force.size) < 5 * (number % 2), np.nan, block.force)
            writer.write("/force", FORCE_BLOCK, log_time_ns, force_block_message(block._replace(force=force)))
    (recording,) = json.loads(cli("impacts", tmp_path / "gap", "--json").stdout)["recordings"]
    assert (recording["lost_samples"], recording["complete"]) == (5 * ((number + 1) // 2), False)


def test_time_without_samples_is_lost_where_their_numbers_restart(cli: Cli, tmp_path: Path) -> None:
    with BagWriter(tmp_path / "restarted") as writer:
        for number, stamp_s in enumerate((0, 1, 5, 6)):
            block = ForceBlock(10**18 + stamp_s * 10**9, "cell", 1000 * (number % 2), 1000.0, np.zeros(1000))
            writer.write("/force", FORCE_BLOCK, block.stamp_ns + 10**9, force_block_message(block))
    (recording,) = json.loads(cli("impacts", tmp_path / "restarted", "--json").stdout)["recordings"]
    assert (recording["lost_samples"], recording["complete"]) == (3000, False)


@pytest.mark.parametrize(
    ("stamps_s", "rate", "problems"),
    [
        ((0.0, 0.98, 2.02, 3.02), 1000.0, 0),  # the fit of the clock moves the stamps
        ((0.0, 1.0, 2.1, 3.1), 1000.0, 1),  # 0.1 s is missing, or the clock was set
        ((5.0, 6.0, 2.0, 3.0), 1000.0, 1),
        ((0.0, 1.0, 2.0, 3.0), 500.0, 1),
    ],
)
def test_stamps_that_do_not_follow_the_samples_are_said(
    cli: Cli, tmp_path: Path, stamps_s: tuple[float, ...], rate: float, problems: int
) -> None:
    with BagWriter(tmp_path / "steps") as writer:
        for number, stamp_s in enumerate(stamps_s):
            block = ForceBlock(10**18 + round(stamp_s * 1e9), "cell", 1000 * number, rate, np.zeros(1000))
            writer.write("/force", FORCE_BLOCK, 10**18 + number * 10**9, force_block_message(block))
    (recording,) = json.loads(cli("impacts", tmp_path / "steps", "--json").stdout)["recordings"]
    assert [text.count("do not follow the sample numbers") for text in recording["problems"]] == [1] * problems
    assert recording["complete"] == (not problems)


def test_every_force_topic_is_listed(cli: Cli, tmp_path: Path) -> None:
    with open_bag(BAGS / "campaign" / "300_-200_2390g_1") as bag, BagWriter(tmp_path / "two") as writer:
        for message in bag.messages(["/force"]):
            for topic in ("/force", "/force/ai1"):
                writer.write(topic, *message[1:])
    recordings = json.loads(cli("impacts", tmp_path / "two", "--json").stdout)["recordings"]
    assert [recording["topic"] for recording in recordings] == ["/force", "/force/ai1"]
    assert recordings[0]["contacts"] == recordings[1]["contacts"]
    assert "force           /force/ai1: " in cli("impacts", tmp_path / "two").stdout
    (chosen,) = json.loads(cli("impacts", tmp_path / "two", "--json", "--force-topic", "force/ai1").stdout)[
        "recordings"
    ]
    assert chosen["contacts"] == recordings[1]["contacts"]


def test_force_blocks_need_no_import_settings(refused: Refused) -> None:
    line = refused("impacts", BAGS / "campaign" / "300_-200_2390g_1", "--invert")
    assert line.endswith(
        ": /force: sensor.invert = True: must not be stated, scara_effmass_msgs/msg/ForceBlock states it"
    )


def test_the_threshold_is_an_option(cli: Cli, refused: Refused, tmp_path: Path) -> None:
    force = np.random.default_rng(0).normal(0.0, 0.1, 8_000)
    force[3_000:3_100] += 3.0 * np.sin(np.pi * np.arange(100) / 100.0)
    path = written(tmp_path / "force.csv", force)
    found = [json.loads(cli("impacts", path, "--json", *more).stdout)["contacts"] for more in ((), ("--threshold", 1))]
    assert found == [0, 1]
    assert "--threshold: 0: must be a number > 0" in refused("impacts", path, "--threshold", 0)
    assert "has no topic of type scara_effmass_msgs/msg/ForceBlock" in refused("impacts", BAGS / "straight_300_200")

# SPDX-License-Identifier: Apache-2.0
"""`protocol`: init, fill, report and schema."""

import json
import os
import shlex
from pathlib import Path

import numpy as np
import pytest
import yaml

from scara_effmass.analysis.protocol import Protocol, protocol_yaml, read_protocol
from scara_effmass.bags.files import open_bag
from scara_effmass.bags.writer import BagWriter
from scara_effmass.studies.campaign import Campaign, run_campaign
from scara_effmass.wire.force import decode_force_block, force_block_message
from scara_effmass.wire.message_types import FORCE_BLOCK
from test.analysis.conftest import RAW, changed, content
from test.cli.conftest import Cli, Refused


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Three simulated contacts with a cart of 2.39 kg."""
    folder = tmp_path_factory.mktemp("campaign")
    return [step.path for step in run_campaign(folder, Campaign(obstacle_masses=(2.39,), repetitions=1))]


@pytest.fixture
def protocol(tmp_path: Path) -> Path:
    """A complete protocol of measured contacts."""
    (tmp_path / "raw.csv").write_bytes(RAW)
    path = tmp_path / "protocol.yaml"
    path.write_text(protocol_yaml(Protocol.model_validate(content())), encoding="utf-8")
    return path


def test_init_writes_an_empty_protocol_once(cli: Cli, refused: Refused, tmp_path: Path) -> None:
    done = cli("protocol", "init")
    assert (done.returncode, done.stderr) == (0, "")
    assert len(read_protocol(tmp_path / "protocol.yaml").tests[0].results.repetitions) == 3
    assert "already exists; use --force" in refused("protocol", "init")
    assert cli("protocol", "init", "--force").returncode == 0


def test_init_proposes_points_from_a_bag_or_from_the_workspace(
    cli: Cli, refused: Refused, swing_bag: Path, tmp_path: Path
) -> None:
    regions = ("--region", "hand_fingers", "--region", "chest", "--points", "2", "--force")
    done = cli("protocol", "init", "--from", swing_bag, *regions)
    assert done.returncode == 0
    assert done.stdout.count("predicted: ") == 4
    proposed = read_protocol(tmp_path / "protocol.yaml")
    assert {test.motion.pose is not None for test in proposed.tests} == {True}
    done = cli("protocol", "init", "--map", "--samples", "100", *regions)
    assert done.stdout.count("240 N of 240 N") == 2
    assert "--map: must be without --from" in refused("protocol", "init", "--map", "--from", swing_bag, "--force")


def test_the_hint_of_init_works_as_printed(cli: Cli, refused: Refused, swing_bag: Path) -> None:
    regions = ("--region", "hand_fingers", "--region", "chest")
    done = cli("protocol", "init", "--from", swing_bag, *regions, "-o", "my protocol.yaml")
    (hint,) = (line for line in done.stdout.splitlines() if line.startswith("next"))
    _, *words = shlex.split(hint.partition("then: ")[2])
    assert words == ["protocol", "fill", "my protocol.yaml", "BAG", "--test", "chest_1"]
    line = refused(*(swing_bag if word == "BAG" else word for word in words))
    assert "stiffness_n_m: must be stated before contacts are filled in" in line


def test_missing_values_of_a_test_point_are_one_line(cli: Cli, swing_bag: Path) -> None:
    assert cli("protocol", "init", "--from", swing_bag, "--region", "chest", "-o", "protocol.yaml").returncode == 0
    done = cli("protocol", "report", "protocol.yaml", "-o", "report")
    lines = [line for line in done.stdout.splitlines() if ": missing: " in line]
    names = "identity.robot_serial, identity.firmware, identity.safety_checksum"
    assert lines == [
        f"UNKNOWN         chest_{n + 1}: missing: {names} and 42 more (--json lists them)" for n in range(len(lines))
    ]
    assert len(lines) > 0


def test_fill_enters_simulated_contacts_which_stay_unknown(
    cli: Cli, refused: Refused, campaign: list[Path], tmp_path: Path
) -> None:
    device = {"stiffness_n_m": 2e6, "fixed": False, "moving_mass_kg": 2.39, "sample_rate_hz": 12.8e3}
    values = changed(content(), {"instruments": [device]})
    values["identity"]["test_date"] = "2026-01-01"
    values["tests"][0]["results"] = {"photos": [], "deviations": "none"}
    path = tmp_path / "protocol.yaml"
    path.write_text(protocol_yaml(Protocol.model_validate(values)), encoding="utf-8")
    done = cli("protocol", "fill", path, *campaign, "--json")
    filled = json.loads(done.stdout)
    assert (done.returncode, filled["verdict"]) == (1, "UNKNOWN")
    (test,) = read_protocol(path).tests
    assert test.results.evaluation
    _, simulated, *others = test.results.evaluation.reasons
    assert simulated == "simulated: nothing was measured on a robot"
    assert {reason.partition(":")[0] for reason in others} == {"another pose than stated"}
    assert filled["tests"][0]["results"]["left_out"] == test.model_dump(mode="json")["results"]["left_out"] != []
    assert {item.reason for item in test.results.left_out} == {"rebound of an earlier impact"}
    assert test.results.evaluation.residual == pytest.approx(0.0, abs=0.03)
    assert {item.raw_channel for item in test.results.repetitions} == {"/force"}
    assert "already filled in; use --force" in refused("protocol", "fill", path, *campaign)
    done = cli("protocol", "fill", path, *campaign, "--force")
    assert done.returncode == 1
    assert "left out        1: 4: rebound of an earlier impact (up to " in done.stdout


def test_fill_takes_a_clamped_contact_as_one(cli: Cli, campaign: list[Path], tmp_path: Path) -> None:
    with open_bag(campaign[0]) as bag:
        blocks = [decode_force_block(message.data) for message in bag.messages(["/force"])]
        first = max(blocks, key=lambda block: block.force.max())
        onset_ns = first.stamp_ns + round(1e9 * int(np.argmax(first.force > 20.0)) / first.sample_rate)
        with BagWriter(tmp_path / "clamped.mcap") as writer:
            for message in bag.messages():
                data = message.data
                if message.type == FORCE_BLOCK:
                    block = decode_force_block(data)
                    time = (block.stamp_ns - onset_ns) / 1e9 + np.arange(len(block.force)) / block.sample_rate
                    held = np.where((time > 0.0) & (time < 0.62), 60.0 + 5.0 * np.sin(30.0 * time), 0.0)
                    data = force_block_message(
                        block._replace(force=block.force * (time < 0.0) + held + 0.01 * time % 1)
                    )
                writer.write(message.topic, message.type, message.log_time_ns, data)
    change = {"instruments": [{"stiffness_n_m": 25e3}], "tests": [{"point": {"contact": "quasi_static"}}]}
    path = tmp_path / "protocol.yaml"
    path.write_text(protocol_yaml(Protocol.model_validate(changed(content(), change))), encoding="utf-8")
    done = cli("protocol", "fill", path, tmp_path / "clamped.mcap", "--force")
    assert (done.returncode, done.stderr) == (1, "")
    (item,) = read_protocol(path).tests[0].results.repetitions
    assert item.transient_peak_n == pytest.approx(65.0, abs=1.0)
    assert item.force_beyond_0_5_s_n == pytest.approx(64.0, abs=2.0)
    assert item.duration_s == pytest.approx(0.62, abs=0.01)
    with open_bag(tmp_path / "clamped.mcap") as bag, BagWriter(tmp_path / "damaged.mcap") as writer:
        for message in bag.messages():
            writer.write(*message)
        writer.write("/force", FORCE_BLOCK, message.log_time_ns, data[:20])
    done = cli("protocol", "fill", path, tmp_path / "damaged.mcap", "--force")
    assert "/force: left out: " in done.stdout.partition("not read")[2].partition("verdict")[0]
    assert read_protocol(path).tests[0].results.repetitions[0].force_beyond_0_5_s_n is None


def test_fill_evaluates_what_was_typed_in(cli: Cli, protocol: Path, tmp_path: Path) -> None:
    done = cli("protocol", "fill", protocol, "-o", "filled.yaml")
    assert done.returncode == 0
    assert done.stdout.splitlines()[0].split() == ["verdict", "OK"]
    (test,) = read_protocol(tmp_path / "filled.yaml").tests
    assert test.results.evaluation


def test_fill_into_another_folder_names_the_same_files(cli: Cli, protocol: Path, tmp_path: Path) -> None:
    (tmp_path / "report").mkdir()
    assert cli("protocol", "fill", protocol, "-o", "report/filled.yaml").returncode == 0
    (test,) = read_protocol(tmp_path / "report/filled.yaml").tests
    assert {item.raw_data for item in test.results.repetitions} == {"../raw.csv"}
    done = cli("protocol", "report", "report/filled.yaml", "-o", "page")
    assert (done.returncode, done.stdout.splitlines()[0].split()) == (0, ["verdict", "OK"])


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"instruments": [{"stiffness_n_m": None}]}, "instruments.device.stiffness_n_m: must be stated"),
        ({"tests": [{"instrument": "gauge"}]}, "tests.1.instrument = gauge: must be the id of an instrument"),
    ],
)
def test_fill_names_what_a_prediction_needs(
    refused: Refused, protocol: Path, campaign: list[Path], change: dict[str, object], problem: str
) -> None:
    protocol.write_text(protocol_yaml(Protocol.model_validate(changed(content(), change))), encoding="utf-8")
    assert problem in refused("protocol", "fill", protocol, campaign[0], "--force")
    assert "--test" in refused("protocol", "fill", protocol, campaign[0], "--test")


def test_report_renders_and_exits_with_the_verdict(cli: Cli, refused: Refused, protocol: Path, tmp_path: Path) -> None:
    done = cli("protocol", "report", protocol, "-o", "report", "--language", "de")
    assert (done.returncode, done.stderr) == (0, "")
    assert {path.name for path in (tmp_path / "report").iterdir()} == {"report.html", "report.json"}
    assert json.loads((tmp_path / "report" / "report.json").read_text(encoding="utf-8"))["verdict"] == "OK"
    assert "Messprotokoll der Kontaktkräfte" in (tmp_path / "report" / "report.html").read_text(encoding="utf-8")
    assert "already exists; use --force" in refused("protocol", "report", protocol, "-o", "report")
    (tmp_path / "raw.csv").write_bytes(b"other")
    done = cli("protocol", "report", protocol, "-o", "report", "--force")
    assert done.returncode == 1
    assert "UNKNOWN         1: raw data changed: raw.csv" in done.stdout


def test_pdf_without_a_browser_is_refused_before_any_work(
    refused: Refused, protocol: Path, swing_bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    for command in (
        ("protocol", "report", protocol, "-o", "report"),
        ("assess", swing_bag, "-o", "a.csv", "--report", "report"),
        ("validate", swing_bag, "-o", "report"),
    ):
        assert refused(*command, "--pdf").startswith("--pdf: needs Chromium or Chrome on the PATH")


def test_schema_is_json_schema(cli: Cli) -> None:
    done = cli("protocol", "schema")
    assert json.loads(done.stdout)["properties"].keys() == {"identity", "instruments", "tests"}


def test_the_group_needs_a_step(refused: Refused) -> None:
    assert "COMMAND" in refused("protocol")


def test_a_protocol_without_tests_takes_no_contacts(refused: Refused, swing_bag: Path, tmp_path: Path) -> None:
    path = tmp_path / "protocol.yaml"
    path.write_text(protocol_yaml(Protocol.model_validate({**content(), "tests": []})), encoding="utf-8")
    line = refused("protocol", "fill", path, swing_bag)
    assert line.strip() == f"{path}: tests: must state a test for the contacts"


@pytest.mark.parametrize(
    ("entered", "problem"),
    [
        ({"raw_data": "/dev/zero", "raw_sha256": None}, "/dev/zero: cannot be read: must be a regular file"),
        ({"raw_data": "pipe", "raw_sha256": None}, "pipe: cannot be read: must be a regular file"),
        ({"force_beyond_0_5_s_n": 1e308}, "force_beyond_0_5_s_n = 1e+308: must be less than or equal to 1000000"),
        ({"raw_import": {"rate": -1.0}}, "raw_import: rate = -1.0: must be greater than or equal to 0"),
    ],
)
def test_what_cannot_be_a_contact_is_refused(
    refused: Refused, protocol: Path, tmp_path: Path, entered: dict[str, object], problem: str
) -> None:
    os.mkfifo(tmp_path / "pipe")
    protocol.write_text(yaml.safe_dump(changed(content(), {"tests": [{"results": {"repetitions": [entered]}}]})))
    assert problem in refused("protocol", "fill", protocol)


def test_a_hint_takes_no_file_for_an_option(cli: Cli) -> None:
    assert "protocol fill ./-d.yaml BAG" in cli("protocol", "init", "-o", "./-d.yaml").stdout
    assert "doctor --params ./-c.yaml" in cli("init", "-o", "./-c.yaml").stdout

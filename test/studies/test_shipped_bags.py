# SPDX-License-Identifier: Apache-2.0
import hashlib
import shutil
import subprocess
import sys
from collections import Counter
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from mcap.records import Message
from mcap.stream_reader import StreamReader

from scara_effmass.bags.bag import run_infos
from scara_effmass.bags.files import open_bag
from scara_effmass.errors import OutputError
from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.settings import MonitorSettings
from scara_effmass.sim.measurement import FORCE_SENSOR, POSITION_STEP, VELOCITY_STEP
from scara_effmass.sim.recordings import EPOCH_NS, FORCE_TOPIC, SEED
from scara_effmass.studies.shipped_bags import (
    CAMPAIGN,
    CHECKSUMS,
    RECORDINGS,
    TOUR_PULSES,
    ReferenceRecording,
    generate,
)
from scara_effmass.values import Decision, FloatArray, ForceBlock, JointState, Verdict
from test.bags.messages import run_info_of

ROOT = Path(__file__).parents[2]
BAGS = ROOT / "bags"
NAMES = [recording.name for recording in RECORDINGS]
RUNS = [f"campaign/{run.name}" for run in CAMPAIGN.runs]
TRUTH = ("true_speed", "true_effective_mass", "true_peak_force", "true_duration", "true_impulse")
ULPS = 1e-12
"""Largest difference of sine and arc cosine between libraries and processors [rad]."""


def read_states(bag: Path) -> list[JointState]:
    with open_bag(bag) as opened:
        assert opened.losses == ()
        return [state for block in opened.joint_state_blocks() for state in block.states()]


def read_force(bag: Path) -> list[ForceBlock]:
    with open_bag(bag) as opened:
        if FORCE_TOPIC not in {topic.name for topic in opened.topics}:
            return []
        return list(opened.force_blocks(FORCE_TOPIC))


def scalars(block: ForceBlock) -> dict[str, object]:
    return {name: value for name, value in block._asdict().items() if not isinstance(value, np.ndarray)}


def assess(name: str) -> list[Decision]:
    settings = MonitorSettings()
    monitor = Monitor(RobotDynamics(load_robot(ROOT / "config" / "omron_i4_550l.yaml", settings)), settings)
    decisions = [monitor.assess(state, state.stamp_ns) for state in read_states(BAGS / name)]
    return [decision for decision in decisions if decision is not None]


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "scara_effmass.studies.shipped_bags", *arguments],
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.fixture(scope="module")
def generated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All recordings, written by the command."""
    folder = tmp_path_factory.mktemp("generated") / "bags"
    result = run("-o", str(folder))
    assert (result.returncode, result.stderr) == (0, "")
    assert result.stdout.splitlines() == [str(folder / name) for name in (*NAMES, *RUNS, CHECKSUMS)]
    return folder


@pytest.mark.live
@pytest.mark.parametrize("name", NAMES)
def test_committed_recordings_match_the_generator(generated: Path, name: str) -> None:
    with open_bag(BAGS / name) as committed, open_bag(generated / name) as remade:
        assert committed.topics == remade.topics
        assert list(run_infos(committed)) == list(run_infos(remade))
    for state, remade_state in zip(read_states(BAGS / name), read_states(generated / name), strict=True):
        assert (state.stamp_ns, state.names) == (remade_state.stamp_ns, remade_state.names)
        assert state.position == pytest.approx(remade_state.position, abs=ULPS)
        assert state.velocity == pytest.approx(remade_state.velocity, abs=ULPS)
    for block, remade_block in zip(read_force(BAGS / name), read_force(generated / name), strict=True):
        assert np.abs(block.force - remade_block.force).max() < ULPS
        assert len(block.saturated_samples) == len(remade_block.saturated_samples) == 0
        assert scalars(block) == scalars(remade_block)


def equal_to_a_count(values: FloatArray, expected: FloatArray, step: FloatArray | float) -> bool:
    """Return whether no value differs by more than a count of `step`, and at most 0.1 % of them by one.

    The last digits of the simulation depend on the processor, so a value between two counts may round either way.
    """
    counts = np.abs(values - expected) / step
    return bool(counts.max() < 1.5 and np.count_nonzero(counts > 1e-6) <= 1e-3 * counts.size)


@pytest.mark.live
@pytest.mark.parametrize("name", RUNS)
def test_committed_campaign_matches_the_generator(generated: Path, name: str) -> None:
    infos = [run_info_of(folder / name)._asdict() for folder in (BAGS, generated)]
    onset_ns, remade_onset_ns = (info.pop("true_onset_ns") for info in infos)
    assert abs(onset_ns - remade_onset_ns) <= 1
    truth, remade_truth = ([info.pop(field) for field in TRUTH] for info in infos)
    assert truth == pytest.approx(remade_truth, rel=1e-9)
    assert infos[0] == infos[1]
    with open_bag(BAGS / name) as committed, open_bag(generated / name) as remade:
        assert committed.topics == remade.topics
        for message, remade_message in zip(committed.messages(), remade.messages(), strict=True):
            assert message.topic == remade_message.topic
            assert abs(message.log_time_ns - remade_message.log_time_ns) <= 1
    old, new = read_states(BAGS / name), read_states(generated / name)
    assert [(state.stamp_ns, state.names) for state in old] == [(state.stamp_ns, state.names) for state in new]
    for field, step in (("position", POSITION_STEP), ("velocity", VELOCITY_STEP)):
        committed_values, values = (np.array([getattr(state, field) for state in group]) for group in (old, new))
        assert equal_to_a_count(values, committed_values, step)
    blocks, remade_blocks = read_force(BAGS / name), read_force(generated / name)
    for block, remade_block in zip(blocks, remade_blocks, strict=True):
        assert abs(block.stamp_ns - remade_block.stamp_ns) <= 1
        assert abs(block.tare_stamp_ns - remade_block.tare_stamp_ns) <= 1
        assert block.tare == pytest.approx(remade_block.tare, abs=1e-9)
        assert len(block.saturated_samples) == len(remade_block.saturated_samples) == 0
        stamps = {"stamp_ns": 0, "tare_stamp_ns": 0, "tare": 0.0}
        assert scalars(block) | stamps == scalars(remade_block) | stamps
    committed_force, force = (np.concatenate([block.force for block in group]) for group in (blocks, remade_blocks))
    assert equal_to_a_count(force, committed_force, FORCE_SENSOR.step)


def test_campaign_covers_every_case_and_is_marked_simulated() -> None:
    infos = [run_info_of(BAGS / name) for name in RUNS]
    assert all(info.simulated and "nothing was measured" in info.note for info in infos)
    cases = {(info.configuration, info.obstacle_mass) for info in infos}
    assert len(cases) == len(infos) == 12
    assert {configuration for configuration, _ in cases} == {"300_200", "300_0", "300_-200"}
    assert {mass for _, mass in cases} == {0.50, 2.39, 3.72, 7.35}
    assert all(block.simulated and "simulated" in block.source for name in RUNS for block in read_force(BAGS / name))


def test_committed_files_match_the_checksums() -> None:
    lines = (BAGS / CHECKSUMS).read_text(encoding="utf-8").splitlines()
    sums = {path: checksum for checksum, path in (line.split("  ") for line in lines)}
    files = {path.relative_to(BAGS).as_posix(): path for name in (*NAMES, *RUNS) for path in (BAGS / name).iterdir()}
    assert sums == {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in files.items()}
    assert sum(path.stat().st_size for path in files.values()) < 4_000_000
    assert {path for path in BAGS.rglob("*") if path.is_file()} == {
        *files.values(),
        BAGS / CHECKSUMS,
        BAGS / "README.md",
    }


@pytest.mark.parametrize("recording", RECORDINGS, ids=NAMES)
def test_recording_is_marked_generated(recording: ReferenceRecording) -> None:
    info = run_info_of(BAGS / recording.name)
    assert info.simulated
    assert f"seed = {SEED}" in info.note
    assert "python -m scara_effmass.sim" in info.note
    with open_bag(BAGS / recording.name) as bag:
        assert bag.start_ns == EPOCH_NS


@pytest.mark.parametrize("recording", RECORDINGS, ids=NAMES)
def test_stamps_are_regular_and_equal_the_log_times(recording: ReferenceRecording) -> None:
    with open_bag(BAGS / recording.name) as bag:
        for block in bag.joint_state_blocks():
            assert np.array_equal(block.stamp_ns, block.log_time_ns)
            assert set(np.diff(block.stamp_ns).tolist()) == {1_000_000_000 // recording.frequency}


def test_messages_are_in_time_order() -> None:
    with open_bag(BAGS / "tour") as bag:
        (mcap,) = bag.path.glob("*.mcap")
    with mcap.open("rb") as file:
        times = [record.log_time for record in StreamReader(file).records if isinstance(record, Message)]
    assert len(times) > 7000
    assert times == sorted(times)


def test_force_of_the_tour_has_no_gap_and_is_marked_simulated() -> None:
    blocks = read_force(BAGS / "tour")
    (recording,) = (recording for recording in RECORDINGS if recording.name == "tour")
    assert len(blocks) == 305
    assert blocks[0].stamp_ns == EPOCH_NS
    assert {after.stamp_ns - before.stamp_ns for before, after in pairwise(blocks)} == {100_000_000}
    assert [block.first_sample for block in blocks] == [number * 1280 for number in range(len(blocks))]
    assert all(block.simulated and "simulated" in block.source for block in blocks)
    assert all("not computed from the motion" in text for text in (blocks[0].source, recording.description))
    with open_bag(BAGS / "tour") as bag:
        logged = [message.log_time_ns for message in bag.messages([FORCE_TOPIC])]
    assert logged == [block.stamp_ns + 100_000_000 for block in blocks]


def test_force_of_the_tour_is_the_documented_pulses() -> None:
    samples = np.concatenate([block.force for block in read_force(BAGS / "tour")])
    quiet = np.ones(len(samples), dtype=bool)
    note = run_info_of(BAGS / "tour").note
    for pulse in TOUR_PULSES:
        assert f"contact at {pulse.onset_s} s: peak {pulse.peak_force} N, duration {pulse.duration} s" in note
        first, last = (round(t * 12_800) for t in (pulse.onset_s, pulse.onset_s + pulse.duration))
        contact = slice(first - 1, last + 2)
        quiet[contact] = False
        # The peak of the shortest pulse may lie half a sample off, where the cosine is 0.99.
        assert samples[contact].max() == pytest.approx(pulse.peak_force, rel=0.01)
        assert samples[contact].sum() / 12_800 == pytest.approx(pulse.impulse, rel=0.02)
    assert np.abs(samples[quiet]).max() < 0.5


def test_straight_recording_has_no_force() -> None:
    assert read_force(BAGS / "straight_300_200") == []


def test_tour_gets_every_verdict_and_passes_singular_poses() -> None:
    decisions = assess("tour")
    contacts = [decision.contacts[0] for decision in decisions]
    shares = {verdict: count / len(contacts) for verdict, count in Counter(c.verdict for c in contacts).items()}
    assert all(shares[verdict] > 0.05 for verdict in (Verdict.OK, Verdict.WARN, Verdict.VIOLATION))
    # UNKNOWN only at the start: a velocity of exactly zero is valid once the positions confirm it.
    known = [c.verdict is not Verdict.UNKNOWN for c in contacts]
    first = known.index(True)
    assert all(known[first:])
    assert decisions[first].stamp_ns - EPOCH_NS < 400_000_000
    usable = contacts[first:]
    assert min(c.smallest_singular_value for c in usable) < 1e-3
    assert any(c.mass_capped for c in usable)


@pytest.mark.parametrize(("recording", "name"), [("tour", "tour"), ("straight_300_200", "straight line")])
def test_shares_of_the_verdicts_are_those_of_the_page(recording: str, name: str) -> None:
    verdicts = [decision.verdict for decision in assess(recording)][:-1]  # each lasts until the next
    shares = [(verdict, verdicts.count(verdict) / len(verdicts)) for verdict in (*list(Verdict)[1:], Verdict.UNKNOWN)]
    *first, last = [f"{share:.1%} {verdict.name}".replace("%", " %") for verdict, share in shares if share]
    text = " ".join((BAGS / "README.md").read_text(encoding="utf-8").split())
    assert f"the {name} is {', '.join(first)} and {last}" in text


def test_straight_recording_is_ok_with_the_papers_mass() -> None:
    contacts = [decision.contacts[0] for decision in assess("straight_300_200")]
    known = [c for c in contacts if c.verdict is not Verdict.UNKNOWN]
    assert {c.verdict for c in known} == {Verdict.OK}
    assert len(contacts) - len(known) <= 300
    impact = contacts[len(contacts) // 2]
    assert impact.speed == pytest.approx(0.25, abs=1e-9)
    assert impact.direction == pytest.approx((1.0, 0.0, 0.0), abs=1e-9)
    # The effective mass of the paper's robot in this pose along x.
    assert impact.lumped_mass == pytest.approx(0.981, abs=0.0005)


@pytest.mark.live
def test_command_replaces_with_force_only_and_writes_the_same_bytes(generated: Path, tmp_path: Path) -> None:
    folder = tmp_path / "bags"
    shutil.copytree(generated, folder)
    refused = run("-o", str(folder))
    assert refused.returncode == 2
    assert refused.stderr.count("\n") == 1
    assert "already exists" in refused.stderr
    shutil.rmtree(folder / RUNS[0])
    assert run("-o", str(folder), "--force").returncode == 0
    assert (folder / CHECKSUMS).read_text() == (generated / CHECKSUMS).read_text()


def test_unwritable_folder_raises(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(OutputError, match="file"):
        generate(tmp_path / "file")

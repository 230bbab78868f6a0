# SPDX-License-Identifier: Apache-2.0
import hashlib
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from scara_effmass.bags.bag import run_infos
from scara_effmass.bags.files import open_bag
from scara_effmass.errors import OutputError
from scara_effmass.sim.experiment import CONFIGURATIONS, OBSTACLE_MASSES, ImpactRun, run_impact
from scara_effmass.sim.recordings import FORCE_TOPIC
from scara_effmass.studies.campaign import RUN_SPACING_NS, Campaign, run_campaign

SMALL = Campaign(configurations=CONFIGURATIONS[:1], obstacle_masses=(0.5, 7.35), repetitions=1)


def checksums(folder: Path) -> dict[str, str]:
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("campaign")
    steps = list(run_campaign(folder, SMALL))
    assert [(step.path.name, step.kept) for step in steps] == [("300_200_500g_1", False), ("300_200_7350g_1", False)]
    return folder


@pytest.fixture(scope="module")
def run() -> ImpactRun:
    return run_impact(SMALL.runs[1].setup)


def test_default_campaign_is_the_papers_experiment() -> None:
    runs = Campaign().runs
    assert len(runs) == len({run.name for run in runs}) == 36
    cases = {(run.setup.configuration.name, run.setup.obstacle_mass, run.repetition) for run in runs}
    assert cases == set(product((c.name for c in CONFIGURATIONS), OBSTACLE_MASSES, (1, 2, 3)))
    assert len({run.setup.seed for run in runs}) == 36
    assert np.all(np.diff([run.setup.start_ns for run in runs]) == RUN_SPACING_NS)


def test_runs_vary_within_the_stated_spreads() -> None:
    setups = [run.setup for run in Campaign().runs]
    speeds = [setup.speed for setup in setups]
    assert 0.245 < min(speeds) < 0.247
    assert 0.253 < max(speeds) < 0.255
    assert len({(setup.offset, setup.dwell, setup.sensor.clock_error) for setup in setups}) == 36
    assert max(abs(setup.offset) for setup in setups) < 1e-3
    assert max(abs(setup.sensor.clock_error) for setup in setups) < 50e-6


def test_bag_contains_the_states_and_force_of_the_run(recorded: Path, run: ImpactRun) -> None:
    with open_bag(recorded / "300_200_7350g_1") as bag:
        assert bag.losses == ()
        assert bag.joint_state_topics == ("/joint_states",)
        states = [state for block in bag.joint_state_blocks() for state in block.states()]
        blocks = list(bag.force_blocks(FORCE_TOPIC))
        order = [message.log_time_ns for message in bag.messages()]
    assert order == sorted(order)
    assert len(states) == len(run.joint_states)
    for state, expected in zip(states, run.joint_states, strict=True):
        assert (state.stamp_ns, state.names) == (expected.stamp_ns, expected.names)
        assert np.array_equal(state.position, expected.position)
        assert np.array_equal(state.velocity, expected.velocity)
    for block, expected_block in zip(blocks, run.force_blocks, strict=True):
        assert np.array_equal(block.force, expected_block.force)
        arrays = {"force": None, "saturated_samples": None}
        assert block._asdict() | arrays == expected_block._asdict() | arrays


def test_bag_contains_run_information_and_ground_truth(recorded: Path, run: ImpactRun) -> None:
    with open_bag(recorded / "300_200_7350g_1") as bag:
        ((_, info),) = run_infos(bag)
    assert info == SMALL.runs[1].info(run)
    assert info.simulated
    assert (info.configuration, info.obstacle_mass) == ("300_200", 7.35)
    assert (info.contact_stiffness, info.contact_exponent) == (2e6, 1.0)
    assert (info.impact_position, info.plate_normal) == ((0.3, 0.2, -0.236), (1.0, 0.0, 0.0))
    assert info.true_peak_force == run.impact.peak_force
    assert {"repetition = 1", "damping = 0.0"} <= set(info.note.splitlines())


def test_force_block_is_logged_after_its_last_sample(recorded: Path) -> None:
    with open_bag(recorded / "300_200_500g_1") as bag:
        logged = [message.log_time_ns for message in bag.messages([FORCE_TOPIC])]
        blocks = list(bag.force_blocks(FORCE_TOPIC))
    delays_ns = [log - block.stamp_ns for log, block in zip(logged, blocks, strict=True)]
    assert min(delays_ns) > 0.1e9
    assert max(delays_ns) < 0.106e9


def test_repeated_campaign_gives_the_same_bytes(recorded: Path, tmp_path: Path) -> None:
    list(run_campaign(tmp_path, SMALL))
    assert checksums(tmp_path) == checksums(recorded)


def test_interrupted_campaign_can_be_resumed(recorded: Path, tmp_path: Path) -> None:
    first = SMALL.runs[0]
    next(run_campaign(tmp_path, SMALL))
    before = (tmp_path / first.name / "metadata.yaml").stat().st_mtime_ns
    assert [step.kept for step in run_campaign(tmp_path, SMALL)] == [True, False]
    assert (tmp_path / first.name / "metadata.yaml").stat().st_mtime_ns == before
    assert checksums(tmp_path) == checksums(recorded)
    assert [step.kept for step in run_campaign(tmp_path, SMALL)] == [True, True]


def test_bag_of_another_campaign_is_replaced_only_with_overwrite(tmp_path: Path) -> None:
    light = replace(SMALL, obstacle_masses=(0.5,))
    list(run_campaign(tmp_path, light))
    before = checksums(tmp_path)
    with pytest.raises(OutputError, match="not of this run"):
        list(run_campaign(tmp_path, replace(light, seed=1)))
    assert checksums(tmp_path) == before
    assert [step.kept for step in run_campaign(tmp_path, replace(light, seed=1), overwrite=True)] == [False]
    assert checksums(tmp_path) != before


@pytest.mark.parametrize("content", [None, b"", b"no recording"])
def test_existing_path_that_is_no_recording_is_kept(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / SMALL.runs[0].name
    if content is None:
        path.mkdir()
    else:
        path.write_bytes(content)
    with pytest.raises(OutputError, match="not of this run"):
        list(run_campaign(tmp_path, SMALL))
    assert path.exists()

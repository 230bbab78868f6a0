# SPDX-License-Identifier: Apache-2.0
"""Validation of recordings: same result as the core classes, run information per recording, refusals."""

import math
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Protocol

import numpy as np
import pytest
import yaml

from scara_effmass.analysis.assessment import Time
from scara_effmass.analysis.validation import Validation, ValidationSettings, validate, with_motion
from scara_effmass.bags.bag import run_infos
from scara_effmass.bags.files import open_bag
from scara_effmass.bags.writer import BagWriter
from scara_effmass.errors import BagError
from scara_effmass.impacts.detector import Detector
from scara_effmass.impacts.validator import Result, Validator
from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.settings import ImportSettings, MassModel, MonitorSettings, SensorSettings, ValidatorSettings
from scara_effmass.share import share
from scara_effmass.sim.experiment import run_impact
from scara_effmass.sim.recordings import write_recording
from scara_effmass.studies.campaign import Campaign
from scara_effmass.values import ForceBlock, JointState, RunInfo
from scara_effmass.wire.force import force_block_message, impact_message
from scara_effmass.wire.joint_state import joint_state_message
from scara_effmass.wire.message_types import FORCE_BLOCK, IMPACT, JOINT_STATE, RUN_INFO, WRENCH, WRENCH_STAMPED
from scara_effmass.wire.run_info import decode_run_info, run_info_message
from test.bags.messages import header, message, serialized

NUMBERS = ("predicted_force", "measured_force", "effective_mass", "reduced_mass", "speed", "region_force", "gain")


class Altered(Protocol):
    def __call__(self, path: Path, **changes: object) -> Path: ...


SETTINGS = ValidationSettings()
ONE_MASS = replace(SETTINGS, validator=ValidatorSettings(obstacle_mass=0.5))
S = 1_000_000_000
TURN = math.radians(30.0)


def stated(path: Path) -> RunInfo:
    with open_bag(path) as bag:
        ((_, info),) = run_infos(bag)
    return info


def result_of_cores(paths: list[Path], dynamics: RobotDynamics) -> Result:
    """Feed the cores, all joint states of a recording before all of its force."""
    validator = Validator(SETTINGS.validator)
    for path in paths:
        validator.begin_recording()
        validator.runs.begin(stated(path), 0)
        monitor, detector = Monitor(dynamics, SETTINGS.monitor), Detector(SETTINGS.detection)
        with open_bag(path) as bag:
            for block in bag.joint_state_blocks():
                for log_time_ns, state in zip(block.log_time_ns.tolist(), block.states(), strict=True):
                    decision = monitor.assess(state, log_time_ns)
                    assert decision is not None
                    validator.add_decision(decision, log_time_ns)
            log_times_ns = [message.log_time_ns for message in bag.messages(["/force"])]
            for log_time_ns, force in zip(log_times_ns, bag.force_blocks("/force"), strict=True):
                validator.add_force(force, log_time_ns)
                for impact in detector.feed(force):
                    validator.add_impact(impact, log_time_ns)
            for impact in detector.finish():
                validator.add_impact(impact, log_times_ns[-1])
    validator.finish()
    return validator.result()


def test_result_equals_direct_use_of_the_validator(
    campaign: list[Path], dynamics: RobotDynamics, validation: Validation
) -> None:
    # As text, in which NaN equals itself.
    assert repr(validation.result) == repr(result_of_cores(campaign, dynamics))


def test_reference_gives_the_same_result(
    campaign: list[Path], dynamics: RobotDynamics, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The joint states of 0.2 s around the impact, because the reference takes 10 ms for each."""
    near, onset_ns = tmp_path / "near", stated(campaign[0]).true_onset_ns
    with open_bag(campaign[0]) as bag, BagWriter(near) as writer:
        for message in bag.messages():
            if message.type != JOINT_STATE or abs(message.log_time_ns - onset_ns) < S // 10:
                writer.write(*message)
    by_kernel = validate([near], dynamics, SETTINGS).result.impacts
    by_reference = partial(Monitor, use_reference=True)
    monkeypatch.setattr("scara_effmass.analysis.validation.Monitor", by_reference)
    impacts = validate([near], dynamics, SETTINGS).result.impacts
    assert impacts
    for impact, expected in zip(impacts, by_kernel, strict=True):
        fields = [{**asdict(one), **asdict(one.series)} for one in (impact, expected)]
        numbers = [of_impact[name] for of_impact in fields for name in NUMBERS]
        assert numbers[: len(NUMBERS)] == pytest.approx(numbers[len(NUMBERS) :], rel=1e-9)


def test_campaign_reproduces_the_trends_of_the_paper(validation: Validation) -> None:
    result = validation.result
    assert (result.accepted, result.reason, result.clock, result.force_sign) == (True, "", "", "")
    lumped, full, iso = (model.overall for model in result.models)
    assert [model.model for model in result.models] == ["lumped", "full", "iso"]
    assert lumped.count == full.count == iso.count == result.simulated == 6
    assert min(lumped.correlation, full.correlation) > 0.999
    assert iso.correlation < 0.9
    assert iso.relative_rmse > 10.0 * max(lumped.relative_rmse, full.relative_rmse)
    assert full.fitted_stiffness == pytest.approx(2e6, rel=0.02)
    fits = [model.fit for model in result.models[:2]]
    assert fits[0].exponent == fits[1].exponent == pytest.approx(0.5, abs=0.01)
    for fit in fits:
        assert fit.gain == pytest.approx(1.0, abs=0.02)
        assert 0.95 < fit.mass_scale < 1.01
        assert fit.detectable_mass_error < 0.07
    assert abs(result.clock_offset.offset) < 5e-4
    assert (result.clock_offset.impacts, result.exceedances) == (6, 0)
    forces = {(impact.configuration, impact.obstacle_mass): impact.measured_force for impact in result.impacts}
    for mass in (0.5, 7.35):
        assert forces["300_200", mass] < forces["300_0", mass] < forces["300_-200", mass]
    for configuration in ("300_200", "300_0", "300_-200"):
        assert forces[configuration, 0.5] < forces[configuration, 7.35]


def test_every_recording_has_its_own_impact(campaign: list[Path], validation: Validation) -> None:
    assert [recording.path for recording in validation.recordings] == campaign
    for recording in validation.recordings:
        (impact,) = recording.impacts
        info = stated(recording.path)
        assert (impact.configuration, impact.obstacle_mass) == (info.configuration, info.obstacle_mass)
        assert abs(impact.stamp_ns - info.true_onset_ns) < 1_000_000
        assert impact.measured_force == pytest.approx(info.true_peak_force, rel=0.005)
        true_reduced_mass = 1.0 / (1.0 / info.true_effective_mass + 1.0 / info.obstacle_mass)
        assert impact.measured_reduced_mass == pytest.approx(true_reduced_mass, rel=0.012)
        assert impact.measured_stiffness == pytest.approx(info.contact_stiffness, rel=0.012)
        full = next(each for each in impact.predictions if each.model == "full")
        assert full.effective_mass == pytest.approx(info.true_effective_mass, rel=0.01)
        assert recording.joint_states > 1000
        assert recording.force_blocks > 10
        assert (recording.lost_samples, recording.simulated, recording.losses) == (0, True, ())
    refused = sum(len(recording.refused) for recording in validation.recordings)
    assert refused == len(validation.result.refused) == sum(validation.result.excluded.values()) > 0


def test_progress_is_reported(campaign: list[Path], dynamics: RobotDynamics) -> None:
    shares: list[float] = []
    validate(campaign[:2], dynamics, SETTINGS, shares.append)
    assert sum(shares) == pytest.approx(2.0)


def test_obstacle_mass_setting_overrides_run_information(campaign: list[Path], dynamics: RobotDynamics) -> None:
    given = validate(campaign[:1], dynamics, replace(SETTINGS, obstacle_mass=3.0)).result
    assert [impact.obstacle_mass for impact in given.impacts] == [3.0]
    settings = replace(SETTINGS, validator=ValidatorSettings(obstacle_mass=3.0, configuration="mine"))
    recorded = validate(campaign[:1], dynamics, settings).result
    assert [(impact.obstacle_mass, impact.configuration) for impact in recorded.impacts] == [(0.5, "300_200")]


def test_recorded_impacts_replace_missing_force_blocks(
    campaign: list[Path], dynamics: RobotDynamics, tmp_path: Path, validation: Validation
) -> None:
    path = tmp_path / "impacts"
    detector = Detector(SETTINGS.detection)
    with open_bag(campaign[0]) as bag, BagWriter(path) as writer:
        for message in bag.messages():
            if message.type != FORCE_BLOCK:
                writer.write(*message)
        for block in bag.force_blocks("/force"):
            for each in detector.feed(block):
                writer.write("/impact", IMPACT, each.stamp_ns + S // 2, impact_message(each))
    found = validate([path], dynamics, SETTINGS)
    assert found.recordings[0].force_topic == "/impact"
    (impact,), expected = found.result.impacts, validation.result.impacts[0]
    for name in ("stamp_ns", "measured_force", "speed", "effective_mass", "reduced_mass", "obstacle_mass"):
        assert getattr(impact, name) == getattr(expected, name)


def test_wrenches_are_imported_where_there_is_neither_force_nor_impact(
    campaign: list[Path], dynamics: RobotDynamics, tmp_path: Path, validation: Validation
) -> None:
    path = tmp_path / "wrenches"
    zero = message("geometry_msgs/msg/Vector3", dict.fromkeys("xyz", 0.0))
    with open_bag(campaign[0]) as bag, BagWriter(path) as writer:
        for item in bag.messages():
            if item.type != FORCE_BLOCK:
                writer.write(*item)
        for block in bag.force_blocks("/force"):
            for number, force in enumerate(block.force.tolist()):
                stamp_ns = block.stamp_ns + round(number / block.sample_rate * S)
                along_z = message("geometry_msgs/msg/Vector3", {"x": 0.0, "y": 0.0, "z": force})
                wrench = message(WRENCH, {"force": along_z, "torque": zero})
                fields = {"header": header(stamp_ns, "ft"), "wrench": wrench}
                writer.write("/ft_sensor", WRENCH_STAMPED, stamp_ns + S // 1000, serialized(WRENCH_STAMPED, fields))
    result = validate([path], dynamics, SETTINGS)
    (recording,) = result.recordings
    assert (recording.force_topic, recording.lost_samples) == ("/ft_sensor", 0)
    assert recording.sources == ("wrenches, /ft_sensor force.z",)
    (impact,), expected = result.result.impacts, validation.result.impacts[0]
    assert impact.stamp_ns == pytest.approx(expected.stamp_ns, abs=S / 12_800)
    for name in ("measured_force", "speed", "effective_mass", "reduced_mass", "obstacle_mass"):
        assert getattr(impact, name) == pytest.approx(getattr(expected, name), rel=1e-3)


def without_force(source: Path, folder: Path) -> tuple[Path, Path]:
    """Return copies of a recording: without its force, and the force as CSV, negative, at times from its own start."""
    path, table = folder / f"{source.name}.mcap", folder / f"{source.name}.csv"
    with open_bag(source) as bag, BagWriter(path) as writer, table.open("w", encoding="utf-8") as file:
        for item in bag.messages():
            if item.type != FORCE_BLOCK:
                writer.write(*item)
        file.write("Time (s),Temperature,Force (N)\n")
        start_ns = next(bag.force_blocks("/force")).stamp_ns
        for block in bag.force_blocks("/force"):
            for number, force in enumerate(block.force.tolist()):
                seconds = (block.stamp_ns - start_ns) / S + number / block.sample_rate
                file.write(f"{seconds:.7f},20,{-force:.4f}\n")
    return path, table


def test_force_in_a_file_of_another_clock_gives_the_same_result(
    campaign: list[Path], dynamics: RobotDynamics, tmp_path: Path, validation: Validation
) -> None:
    paths, tables = zip(*(without_force(path, tmp_path) for path in campaign), strict=True)
    importing = ImportSettings(topic="Force (N)", sensor=SensorSettings(invert=True))
    settings = replace(SETTINGS, force=importing, force_from=tables)
    result, recordings, *_ = validate(paths, dynamics, settings)
    assert (result.accepted, len(result.impacts), result.simulated) == (True, 6, 6)
    for path, table, recording in zip(campaign, tables, recordings, strict=True):
        with open_bag(path) as bag:
            start_s = next(bag.force_blocks("/force")).stamp_ns / S
        assert recording.force_offset == pytest.approx(start_s, abs=1e-3)
        assert recording.force_topic == str(table)
        assert recording.force_clock.startswith(f"{table}: its stamps +")
        assert recording.force_clock.endswith("s, from the velocity (impacts: 1, resolution 0.5 ms)")
    for impact, expected in zip(result.impacts, validation.result.impacts, strict=True):
        assert impact.measured_force == pytest.approx(expected.measured_force, rel=1e-3)
        assert impact.effective_mass == pytest.approx(expected.effective_mass, rel=1e-3)


def test_a_given_offset_is_applied(campaign: list[Path], dynamics: RobotDynamics, tmp_path: Path) -> None:
    path, table = without_force(campaign[0], tmp_path)
    with open_bag(campaign[0]) as bag:
        start_s = next(bag.force_blocks("/force")).stamp_ns / S
    importing = ImportSettings(topic="Force (N)", sensor=SensorSettings(invert=True))
    settings = replace(SETTINGS, force=importing, force_from=(table,), force_offset=start_s + 0.02)
    result, (recording,), *_ = validate([path], dynamics, settings)
    assert recording.force_clock == f"{table}: its stamps {start_s + 0.02:+.6f} s, as given"
    assert result.clock_offset.offset == pytest.approx(-0.02, abs=1e-3)


@pytest.mark.parametrize("time", Time)
def test_offset_of_a_file_is_on_the_clock_of_the_joint_states(
    campaign: list[Path], dynamics: RobotDynamics, tmp_path: Path, time: Time
) -> None:
    """The joint states are stamped 0.1 s before they were recorded."""
    source, table = without_force(campaign[0], tmp_path)
    path = tmp_path / "early.mcap"
    with open_bag(source) as bag, BagWriter(path) as writer:
        for block in bag.joint_state_blocks():
            for log_time_ns, state in zip(block.log_time_ns.tolist(), block.states(), strict=True):
                early = state._replace(stamp_ns=state.stamp_ns - S // 10)
                writer.write("/joint_states", JOINT_STATE, log_time_ns, joint_state_message(early))
    with open_bag(campaign[0]) as bag:
        start_s = next(bag.force_blocks("/force")).stamp_ns / S
    importing = ImportSettings(topic="Force (N)", sensor=SensorSettings(invert=True))
    result, (recording,), *_ = validate(
        [path], dynamics, replace(ONE_MASS, time=time, force=importing, force_from=(table,))
    )
    assert len(result.impacts) == 1
    assert abs(result.clock_offset.offset) < 1e-3
    assert recording.force_offset == pytest.approx(start_s - (0.0 if time is Time.LOG else 0.1), abs=1e-3)


def test_force_of_a_simulated_run_is_simulated(campaign: list[Path], dynamics: RobotDynamics, altered: Altered) -> None:
    path = altered(campaign[0], block=lambda block: block._replace(simulated=False))
    assert validate([path], dynamics, SETTINGS).result.simulated == 1


def test_force_that_fits_the_velocity_nowhere_is_refused(
    campaign: list[Path], dynamics: RobotDynamics, tmp_path: Path
) -> None:
    path, table = without_force(campaign[0], tmp_path)
    settings = replace(SETTINGS, force=ImportSettings(topic="Force (N)"), force_from=(table,))  # of the wrong sign
    with pytest.raises(BagError, match=rf"{table}: not one offset fits its 0 impacts to .*{path}; give --force-offset"):
        validate([path], dynamics, settings)


def test_largest_model_can_be_selected(campaign: list[Path], dynamics: RobotDynamics) -> None:
    settings = replace(SETTINGS, validator=ValidatorSettings(effective_mass_model=MassModel.LARGEST))
    result = validate(campaign, dynamics, settings).result
    assert [model.model for model in result.models] == ["lumped", "full", "iso", "largest"]
    for impact in result.impacts:
        masses = {prediction.model: prediction.effective_mass for prediction in impact.predictions}
        assert impact.effective_mass == masses["largest"] == max(masses.values())
    assert result.reason.startswith("correlation"), "a bound that ISO sets in light poses does not follow the pose"


# Problems of a series are part of its result.


def test_no_impacts(campaign: list[Path], dynamics: RobotDynamics, altered: Altered) -> None:
    quiet = altered(campaign[0], block=lambda block: block._replace(force=1e-3 * block.force))
    result = validate([quiet], dynamics, SETTINGS).result
    assert (result.seen, result.accepted) == (0, False)
    assert "no impacts" in result.reason


def test_one_impact(campaign: list[Path], dynamics: RobotDynamics) -> None:
    result = validate(campaign[:1], dynamics, SETTINGS).result
    assert len(result.impacts) == 1
    assert result.reason == "1 impact, at least 6 are required"
    assert result.models[0].overall.correlation_reason == "fewer than two impacts"


def test_all_at_the_same_reduced_mass(campaign: list[Path], dynamics: RobotDynamics) -> None:
    result = validate(campaign[:1] * 6, dynamics, SETTINGS).result
    assert len(result.impacts) == 6
    assert result.models[0].overall.correlation_reason == "all impacts are at the same v sqrt(mu)"
    assert not result.decidable
    assert result.reason.startswith("one obstacle mass (0.5 kg) cannot separate the robot's mass from the gain; next: ")


def test_clocks_seconds_apart(campaign: list[Path], dynamics: RobotDynamics, altered: Altered) -> None:
    late = [altered(path, block=lambda block: block._replace(stamp_ns=block.stamp_ns + 5 * S)) for path in campaign[:3]]
    result = validate(late, dynamics, SETTINGS).result
    assert result.impacts == ()
    assert not result.accepted
    assert "their clocks differ" in result.clock
    assert "their clocks differ" in result.reason


def test_a_step_of_the_zero_before_an_impact_leaves_it_in_the_series(
    campaign: list[Path], dynamics: RobotDynamics, altered: Altered
) -> None:
    (impact,) = validate(campaign[:1], dynamics, SETTINGS).result.impacts

    def stepped(block: ForceBlock) -> ForceBlock:
        seconds = (block.stamp_ns - impact.stamp_ns) / 1e9 + np.arange(block.force.size) / block.sample_rate
        return block._replace(force=block.force + 5.2 * (seconds > -0.4))

    result = validate([altered(campaign[0], block=stepped)], dynamics, SETTINGS).result
    assert [item.measured_force for item in result.impacts] == pytest.approx([impact.measured_force], rel=1e-3)
    assert result.impacts[0].load_force == pytest.approx(5.2, abs=0.2)
    assert result.excluded["press: the force rose slowly, or stayed near its peak"] == 1


def test_saturated_peaks_are_counted(campaign: list[Path], dynamics: RobotDynamics, altered: Altered) -> None:
    def saturated(block: ForceBlock) -> ForceBlock:
        beyond = np.flatnonzero(block.force >= 150.0).astype(np.uint32)
        return block._replace(force=np.minimum(block.force, 150.0), saturated_samples=beyond)

    again = validate([altered(campaign[0], block=saturated), *campaign[1:], campaign[0]], dynamics, SETTINGS).result
    result = validate([altered(campaign[0], block=saturated), *campaign[1:]], dynamics, SETTINGS).result
    assert again.accepted
    assert (result.accepted, result.decidable, len(result.impacts)) == (False, False, 5)
    assert result.excluded["clipped: the force reached the end of the measuring range"] == 1


def test_the_wrong_sign_of_force(campaign: list[Path], dynamics: RobotDynamics, altered: Altered) -> None:
    result = validate([altered(campaign[0], block=lambda b: b._replace(force=-b.force))], dynamics, SETTINGS).result
    assert not result.accepted
    assert "compression is positive" in result.reason


def test_the_wrong_sign_in_one_of_several_recordings(
    campaign: list[Path], dynamics: RobotDynamics, altered: Altered
) -> None:
    wrong = altered(campaign[0], block=lambda b: b._replace(force=-b.force))
    for paths in ([wrong, *campaign[1:]], [*campaign[1:], wrong]):
        result = validate(paths, dynamics, SETTINGS).result
        assert len(result.impacts) == 5
        assert not result.accepted
        assert "compression is positive" in result.reason


def test_missing_obstacle_mass_is_not_taken_from_previous_recording(
    campaign: list[Path], dynamics: RobotDynamics, altered: Altered
) -> None:
    nameless = altered(campaign[1], info={"obstacle_mass": 0.0, "configuration": ""})
    result = validate([campaign[0], nameless], dynamics, SETTINGS).result
    assert len(result.impacts) == 1
    assert result.unpaired == {"obstacle_mass is not given": 1}
    settings = replace(SETTINGS, validator=ValidatorSettings(obstacle_mass=7.35))
    named = validate([campaign[0], nameless], dynamics, settings).result
    assert [(each.obstacle_mass, each.configuration) for each in named.impacts] == [(0.5, "300_200"), (7.35, "")]


@pytest.mark.parametrize("shift_ms", [-20, 20])
def test_force_20_ms_early_or_late_is_rejected(
    campaign: list[Path], dynamics: RobotDynamics, altered: Altered, shift_ms: int
) -> None:
    paths = [altered(path, block=lambda b: b._replace(stamp_ns=b.stamp_ns + shift_ms * S // 1000)) for path in campaign]
    result = validate(paths, dynamics, SETTINGS).result
    assert (result.accepted, result.decidable, len(result.impacts)) == (False, True, 6)
    assert result.clock_offset.offset == pytest.approx(-shift_ms / 1e3, abs=1e-3)
    assert result.reason.startswith(f"the joint states are {1e3 * result.clock_offset.offset:+.1f} ms behind the force")


def test_too_large_a_gain_is_rejected(campaign: list[Path], dynamics: RobotDynamics, altered: Altered) -> None:
    paths = [altered(path, block=lambda block: block._replace(force=1.2 * block.force)) for path in campaign]
    result = validate(paths, dynamics, SETTINGS).result
    assert (result.accepted, result.decidable) == (False, True)
    assert result.reason.startswith("gain of the force 1.2")
    uncertain = [altered(path, block=lambda b: b._replace(relative_uncertainty=0.15)) for path in campaign]
    assert validate(uncertain, dynamics, SETTINGS).result.gain_tolerance == 0.15


@pytest.mark.parametrize("factor", [0.8, 1.25])
def test_wrong_masses_are_rejected(campaign: list[Path], tmp_path: Path, factor: float) -> None:
    file = yaml.safe_load(share("config", "omron_i4_550l.yaml").read_text(encoding="utf-8"))
    for body in (*file["links"], file["payload"]):
        body["mass"] *= factor
        body["inertia"] *= factor
    path = tmp_path / "wrong.yaml"
    path.write_text(yaml.safe_dump(file, sort_keys=False), encoding="utf-8")
    wrong = RobotDynamics(load_robot(path, MonitorSettings()))
    result = validate(campaign, wrong, SETTINGS).result
    assert [(model.accepted, model.decidable) for model in result.models[:2]] == [(False, True)] * 2
    assert result.reason.startswith("the robot has ")
    assert result.models[1].fit.mass_scale == pytest.approx(1.0 / factor, rel=0.02)


def test_swapped_carts_are_not_accepted(campaign: list[Path], dynamics: RobotDynamics, altered: Altered) -> None:
    paths = [altered(path, info={"obstacle_mass": 7.85 - stated(path).obstacle_mass}) for path in campaign]
    assert not validate(paths, dynamics, SETTINGS).result.accepted


def test_plates_turned_by_30_degrees_are_accepted(dynamics: RobotDynamics, tmp_path: Path) -> None:
    """The cart's guide stays along the path, which the run information states."""
    paths = []
    for run in Campaign(obstacle_masses=(0.5, 7.35), repetitions=1).runs:
        turned = run._replace(setup=replace(run.setup, surface=(math.cos(TURN), math.sin(TURN), 0.0)))
        simulated = run_impact(turned.setup)
        blocks = [(block.stamp_ns + S // 5, block) for block in simulated.force_blocks]
        paths.append(tmp_path / run.name)
        write_recording(paths[-1], turned.info(simulated), simulated.joint_states, blocks, overwrite=False)
    result = validate(paths, dynamics, SETTINGS).result
    assert [(model.accepted, model.reason) for model in result.models[:2]] == [(True, "")] * 2
    assert result.models[1].overall.correlation > 0.999
    for impact, path in zip(result.impacts, paths, strict=True):
        assert impact.force_share == pytest.approx(math.cos(TURN))
        assert impact.predictions[1].effective_mass == pytest.approx(stated(path).true_effective_mass, rel=0.01)
        assert impact.speed == pytest.approx(stated(path).true_speed, rel=0.01)
    straight = [path.with_name(f"{path.name}_straight") for path in paths]
    for path, other in zip(paths, straight, strict=True):
        with open_bag(path) as bag, BagWriter(other) as writer:
            for message in bag.messages():
                data = message.data
                if message.type == RUN_INFO:
                    info = decode_run_info(data)._replace(plate_normal=(0.0,) * 3, guide_direction=(0.0,) * 3)
                    data = run_info_message(info)
                writer.write(message.topic, message.type, message.log_time_ns, data)
    assert not validate(straight, dynamics, SETTINGS).result.accepted


def test_a_given_normal_replaces_an_unstated_one(
    campaign: list[Path], dynamics: RobotDynamics, altered: Altered
) -> None:
    unstated = altered(campaign[0], info={"plate_normal": (0.0,) * 3, "guide_direction": (0.0,) * 3})
    settings = replace(SETTINGS, validator=ValidatorSettings(plate_normal="2 2 0"))
    (impact,), (straight,) = (
        validate([path], dynamics, s).result.impacts for path, s in ((unstated, settings), (campaign[0], SETTINGS))
    )
    assert impact.speed == pytest.approx(straight.speed / math.sqrt(2.0), rel=1e-3)
    along = replace(SETTINGS, validator=ValidatorSettings(plate_normal="0 1 0"))
    assert validate([unstated], dynamics, along).result.unpaired == {
        "the robot moves along the plate, not against it": 1
    }


def test_forces_above_the_limit_of_a_region_are_counted(campaign: list[Path], dynamics: RobotDynamics) -> None:
    """A device of the chest's stiffness that turns 0.25 m/s into the forces of the campaign's stiff tip."""
    settings = replace(SETTINGS, validator=ValidatorSettings(stiffness_n_m=25e3, body_regions=("chest",)))
    result = validate(campaign, dynamics, settings).result
    for impact in result.impacts:
        assert (impact.body_region, impact.limit_force) == ("chest", 240.0)  # pressure, 2 x 120 N/cm2 on 1 cm2
        assert impact.exceeds_limit == (impact.region_force > 240.0)
    assert result.exceedances == sum(impact.exceeds_limit for impact in result.impacts) > 0
    fitted = replace(SETTINGS, validator=ValidatorSettings(body_regions=("chest",)))
    assert validate(campaign, dynamics, fitted).result.exceedances == 0


def test_a_fixed_device_has_an_infinite_mass(campaign: list[Path], dynamics: RobotDynamics) -> None:
    settings = replace(SETTINGS, validator=ValidatorSettings(obstacle_fixed=True))
    result = validate(campaign, dynamics, settings).result
    for impact in result.impacts:
        assert impact.obstacle_mass == math.inf
        assert impact.reduced_mass == impact.effective_mass
    assert not result.accepted


# Unusable recordings are refused.


def test_a_recording_without_joint_states(campaign: list[Path], dynamics: RobotDynamics, altered: Altered) -> None:
    path = altered(campaign[0], without="/joint_states")
    with pytest.raises(BagError, match=f"{path}: has no topic of type sensor_msgs/msg/JointState"):
        validate([path], dynamics, SETTINGS)


def test_a_recording_without_force(campaign: list[Path], dynamics: RobotDynamics, altered: Altered) -> None:
    path = altered(campaign[0], without="/force")
    with pytest.raises(BagError, match=f"{path}: has no topic of type .*/ForceBlock, .*/Impact.*--force-from"):
        validate([path], dynamics, SETTINGS)


def test_joint_states_of_another_robot(
    campaign: list[Path], dynamics: RobotDynamics, altered: Altered, tmp_path: Path
) -> None:
    path = tmp_path / "other"
    foreign = JointState(0, ("wheel",), np.zeros(1), np.zeros(1))
    with open_bag(altered(campaign[0], without="/joint_states")) as bag, BagWriter(path) as writer:
        for message in bag.messages():
            writer.write(*message)
        writer.write("/joint_states", JOINT_STATE, bag.end_ns, joint_state_message(foreign))
    with pytest.raises(BagError, match="none of its joint states names a joint of the robot"):
        validate([path], dynamics, SETTINGS)


@pytest.mark.parametrize(
    ("info", "message"),
    [
        *(({"obstacle_mass": mass}, "obstacle_mass = .*: must be 0") for mass in (-1.0, 1e4, math.nan, math.inf)),
        ({"configuration": "a\nb"}, "configuration = .*: must be printable"),
    ],
)
def test_unusable_run_information_is_refused(
    campaign: list[Path], dynamics: RobotDynamics, altered: Altered, info: dict[str, object], message: str
) -> None:
    path = altered(campaign[0], info=info)
    with pytest.raises(BagError, match=f"{path}: run information: {message}"):
        validate([path], dynamics, SETTINGS)


def test_undecodable_run_information_is_refused(campaign: list[Path], dynamics: RobotDynamics, tmp_path: Path) -> None:
    path = tmp_path / "cut"
    with open_bag(campaign[0]) as bag, BagWriter(path) as writer:
        for message in bag.messages():
            writer.write(*(message._replace(data=message.data[:20]) if message.type == RUN_INFO else message))
    with pytest.raises(BagError, match=f"{path}: /run_info: RunInfo: "):
        validate([path], dynamics, SETTINGS)


def test_several_force_topics_require_a_choice(campaign: list[Path], dynamics: RobotDynamics, tmp_path: Path) -> None:
    path = tmp_path / "two_channels"
    with open_bag(campaign[0]) as bag, BagWriter(path) as writer:
        for message in bag.messages():
            topics = ["/left", "/right"] if message.type == FORCE_BLOCK else [message.topic]
            for topic in topics:
                writer.write(topic, *message[1:])
    with pytest.raises(BagError, match=r"--force-topic is empty: must be one of /left \(.*\), /right "):
        validate([path], dynamics, SETTINGS)
    found = validate([path], dynamics, replace(SETTINGS, force=ImportSettings(topic="right")))
    assert (found.recordings[0].force_topic, len(found.result.impacts)) == ("/right", 1)
    with pytest.raises(BagError, match="--force-topic = up: must be one of /left"):
        validate([path], dynamics, replace(SETTINGS, force=ImportSettings(topic="up")))


@pytest.mark.parametrize(("gain", "is_refused"), [(1.0, True), (0.0, False)])
def test_contacts_on_another_force_topic_require_a_choice(
    campaign: list[Path], dynamics: RobotDynamics, tmp_path: Path, gain: float, *, is_refused: bool
) -> None:
    """The channels of a converter are /force and /force/ai1."""
    path = tmp_path / "two_channels"
    with open_bag(campaign[0]) as bag, BagWriter(path) as writer:
        blocks = bag.force_blocks("/force")
        for message in bag.messages():
            writer.write(*message)
            if message.type == FORCE_BLOCK:
                block = next(blocks)
                second = force_block_message(block._replace(force=gain * block.force))
                writer.write("/force/ai1", FORCE_BLOCK, message.log_time_ns, second)
    if is_refused:
        beside = replace(SETTINGS, force_from=(path,), force_offset=0.0)
        for paths, settings in ((path, SETTINGS), (campaign[0], beside)):
            with pytest.raises(BagError, match=r"must be /force or /force/ai1, which has up to \d+.* N, too"):
                validate([paths], dynamics, settings)
    stated = SETTINGS if not is_refused else replace(SETTINGS, force=ImportSettings(topic="/force"))
    assert len(validate([path], dynamics, stated).result.impacts) == 1


def test_undecodable_force_blocks_are_reported_as_losses(
    campaign: list[Path], dynamics: RobotDynamics, tmp_path: Path
) -> None:
    path = tmp_path / "cut"
    with open_bag(campaign[0]) as bag, BagWriter(path) as writer:
        for message in bag.messages():
            cut = message.type == FORCE_BLOCK and message.log_time_ns < bag.start_ns + S // 2
            writer.write(*(message._replace(data=message.data[:20]) if cut else message))
    (recording,) = validate([path], dynamics, SETTINGS).recordings
    assert len(recording.losses) == 1
    assert "/force: left out: " in recording.losses[0]


@pytest.mark.parametrize("time", [Time.HEADER, Time.LOG])
def test_torques_in_motion_give_the_mass_at_the_impacts(
    campaign: list[Path], dynamics: RobotDynamics, time: Time
) -> None:
    settings = replace(SETTINGS, time=time)
    found = with_motion(validate(campaign, dynamics, settings), dynamics, settings)
    assert found.no_motion == ""
    for name, factor in (("full", 1.0), ("lumped", 0.964)):
        scale = found.by_motion[name]
        assert scale.impacts == len(found.result.impacts)
        assert abs(scale.scale - factor) < scale.half < 0.1


def test_without_torques_there_is_no_mass_by_motion(
    campaign: list[Path], dynamics: RobotDynamics, tmp_path: Path
) -> None:
    """And joint states with effort that begin after the impact do not give its pose."""
    validation = validate(campaign[:1], dynamics, SETTINGS)
    (onset_ns,) = [impact.stamp_ns for impact in validation.result.impacts]
    with open_bag(campaign[0]) as bag:
        states = [state for block in bag.joint_state_blocks() for state in block.states()]
    bare = [state._replace(effort=np.empty(0)) for state in states]
    late = [
        state if state.stamp_ns > onset_ns + 300_000_000 else without
        for state, without in zip(states, bare, strict=True)
    ]
    for name, written, reason in (
        ("bare", bare, "the joint states carry no effort"),
        ("late", late, "no impact has joint states with effort and a contact point of known place"),
    ):
        path = tmp_path / f"{name}.mcap"
        with BagWriter(path) as writer:
            writer.write_joint_states("/joint_states", iter(written))
        recording = replace(validation.recordings[0], path=path, joint_state_topic="/joint_states")
        found = with_motion(validation._replace(recordings=(recording,)), dynamics, SETTINGS)
        assert (dict(found.by_motion), found.no_motion) == ({}, reason)

"""Validation of recordings: same result as the core classes, run information per recording, refusals."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np
import pytest

from scara_effmass.analysis.validation import Validation, ValidationSettings, validate
from scara_effmass.bags.files import open_bag
from scara_effmass.bags.run_info import run_infos
from scara_effmass.bags.writer import BagWriter
from scara_effmass.errors import BagError
from scara_effmass.impacts.detector import Detector
from scara_effmass.impacts.validator import Result, Validator
from scara_effmass.model.dynamics import RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.settings import MassModel, ValidatorSettings
from scara_effmass.values import ForceBlock, JointState, RunInfo
from scara_effmass.wire.force import impact_message
from scara_effmass.wire.joint_state import joint_state_message
from scara_effmass.wire.message_types import FORCE_BLOCK, IMPACT, JOINT_STATE, RUN_INFO, STRING, WRENCH, WRENCH_STAMPED
from scara_effmass.wire.topics import RECORDING_INFO
from test.bags.messages import header, message, serialized


class Altered(Protocol):
    def __call__(self, path: Path, **changes: object) -> Path: ...


SETTINGS = ValidationSettings()
S = 1_000_000_000


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
                    for contact in decision.contacts:
                        validator.add_state(contact, log_time_ns)
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
    assert full.exponent == pytest.approx(0.5, abs=0.01)
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


def test_largest_model_can_be_selected(campaign: list[Path], dynamics: RobotDynamics) -> None:
    settings = replace(SETTINGS, validator=ValidatorSettings(effective_mass_model=MassModel.LARGEST))
    result = validate(campaign, dynamics, settings).result
    assert [model.model for model in result.models] == ["lumped", "full", "iso", "largest"]
    assert result.accepted


# Problems of a series are part of its result.


def test_no_impacts(campaign: list[Path], dynamics: RobotDynamics, altered: Altered) -> None:
    quiet = altered(campaign[0], block=lambda block: block._replace(force=1e-3 * block.force))
    result = validate([quiet], dynamics, SETTINGS).result
    assert (result.seen, result.accepted) == (0, False)
    assert "no impacts" in result.reason


def test_one_impact(campaign: list[Path], dynamics: RobotDynamics) -> None:
    result = validate(campaign[:1], dynamics, SETTINGS).result
    assert len(result.impacts) == 1
    assert result.reason == "1 impact, at least 3 are required"
    assert result.models[0].overall.correlation_reason == "fewer than two impacts"


def test_all_at_the_same_reduced_mass(campaign: list[Path], dynamics: RobotDynamics) -> None:
    result = validate(campaign[:1] * 3, dynamics, SETTINGS).result
    assert len(result.impacts) == 3
    assert result.reason == "correlation undefined: all impacts are at the same v sqrt(mu)"


def test_clocks_seconds_apart(campaign: list[Path], dynamics: RobotDynamics, altered: Altered) -> None:
    late = [altered(path, block=lambda block: block._replace(stamp_ns=block.stamp_ns + 5 * S)) for path in campaign[:3]]
    result = validate(late, dynamics, SETTINGS).result
    assert result.impacts == ()
    assert not result.accepted
    assert "their clocks differ" in result.clock
    assert "their clocks differ" in result.reason


def test_saturated_peaks_are_counted(campaign: list[Path], dynamics: RobotDynamics, altered: Altered) -> None:
    def saturated(block: ForceBlock) -> ForceBlock:
        beyond = np.flatnonzero(block.force >= 150.0).astype(np.uint32)
        return block._replace(force=np.minimum(block.force, 150.0), saturated_samples=beyond)

    result = validate([altered(campaign[0], block=saturated), *campaign[1:]], dynamics, SETTINGS).result
    assert result.accepted
    assert len(result.impacts) == 5
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


# Unusable recordings are refused.


def test_a_recording_without_joint_states(campaign: list[Path], dynamics: RobotDynamics, altered: Altered) -> None:
    path = altered(campaign[0], without="/joint_states")
    with pytest.raises(BagError, match=f"{path}: no topic holds joint states"):
        validate([path], dynamics, SETTINGS)


def test_a_recording_without_force(campaign: list[Path], dynamics: RobotDynamics, altered: Altered) -> None:
    path = altered(campaign[0], without="/force")
    with pytest.raises(BagError, match=f"{path}: must hold .* or .*, as daq publishes them"):
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


# Recordings made before RunInfo state the run in JSON.


def older(source: Path, path: Path, text: str) -> Path:
    """Copy `source` to `path` with `text` as its run information."""
    with open_bag(source) as bag, BagWriter(path) as writer:
        for message in bag.messages():
            if message.type == RUN_INFO:
                data = serialized(STRING, {"data": text})
                writer.write(RECORDING_INFO, STRING, message.log_time_ns, data)
            else:
                writer.write(*message)
    return path


def test_older_recording_gives_the_same_result(
    campaign: list[Path], dynamics: RobotDynamics, tmp_path: Path, validation: Validation
) -> None:
    info = stated(campaign[0])
    truth = {"speed": info.true_speed, "effective_mass": info.true_effective_mass, "peak_force": info.true_peak_force}
    fields = {"simulated": True, "configuration": "300_200", "obstacle_mass": 0.5, "truth": truth}
    path = older(campaign[0], tmp_path / "older", json.dumps(fields | {"stiffness": 2e6, "exponent": 1.0}))
    (recording,) = validate([path], dynamics, SETTINGS).recordings
    (impact,), (expected,) = recording.impacts, validation.recordings[0].impacts
    for name in ("stamp_ns", "measured_force", "speed", "effective_mass", "obstacle_mass", "configuration"):
        assert getattr(impact, name) == getattr(expected, name)
    assert recording.infos[0].true_peak_force == info.true_peak_force
    assert recording.infos[0].contact_stiffness == info.contact_stiffness


@pytest.mark.parametrize("text", ["no JSON", "[1]", "[" * 100_000])
def test_older_recording_without_json_states_nothing(
    campaign: list[Path], dynamics: RobotDynamics, tmp_path: Path, text: str
) -> None:
    result = validate([older(campaign[0], tmp_path / "older", text)], dynamics, SETTINGS).result
    assert result.unpaired == {"obstacle_mass is not given": 1}


@pytest.mark.parametrize(
    "text", ['{"obstacle_mass": "2.39"}', '{"since_ns": 1e300}', '{"configuration": "\\ud800"}'], ids=str
)
def test_older_recording_with_unusable_values_is_refused(
    campaign: list[Path], dynamics: RobotDynamics, tmp_path: Path, text: str
) -> None:
    with pytest.raises(BagError, match=r"run information: .* must be"):
        validate([older(campaign[0], tmp_path / "older", text)], dynamics, SETTINGS)


def test_several_force_topics_require_a_choice(campaign: list[Path], dynamics: RobotDynamics, tmp_path: Path) -> None:
    path = tmp_path / "two_channels"
    with open_bag(campaign[0]) as bag, BagWriter(path) as writer:
        for message in bag.messages():
            topics = ["/left", "/right"] if message.type == FORCE_BLOCK else [message.topic]
            for topic in topics:
                writer.write(topic, *message[1:])
    with pytest.raises(BagError, match="several topics hold the force; give --force-topic one of /left, /right"):
        validate([path], dynamics, SETTINGS)
    found = validate([path], dynamics, replace(SETTINGS, force_topic="right"))
    assert (found.recordings[0].force_topic, len(found.result.impacts)) == ("/right", 1)
    with pytest.raises(BagError, match="no force on up; give --force-topic one of"):
        validate([path], dynamics, replace(SETTINGS, force_topic="up"))


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

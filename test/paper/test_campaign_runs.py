"""Impacts and motions read from campaign recordings agree with the ground truth."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from scara_effmass.bags.files import find_bags, open_bag
from scara_effmass.bags.run_info import run_infos
from scara_effmass.bags.writer import BagWriter
from scara_effmass.errors import BagError
from scara_effmass.paper.campaign_runs import AFTER_ONSET_S, BEFORE_ONSET_S, campaign_runs
from scara_effmass.settings import DetectionSettings
from scara_effmass.share import share
from scara_effmass.wire.message_types import RUN_INFO
from scara_effmass.wire.run_info import decode_run_info, run_info_message

if TYPE_CHECKING:
    from pathlib import Path

    from scara_effmass.paper.campaign_runs import CampaignRun
    from scara_effmass.paper.scara import Scara
    from scara_effmass.values import RunInfo

JOINTS = ("joint1", "joint2")
RUN = "300_0_500g_1"


@pytest.fixture(scope="module")
def shipped(scara: Scara) -> list[CampaignRun]:
    return campaign_runs(share("bags", "campaign"), scara, JOINTS, DetectionSettings())


def run_info_of(path: Path) -> RunInfo:
    with open_bag(path) as bag:
        ((_, info),) = run_infos(bag)
    return info


def copy_run(path: Path, changes: dict[str, Any], blocks: int = 1000) -> Path:
    """Copy the shipped run to `path` with `changes` in its run information and its first `blocks` force blocks."""
    source = share("bags", "campaign", RUN)
    with open_bag(source) as bag, BagWriter(path) as copy:
        for message in bag.messages():
            data = message.data
            if message.type == RUN_INFO:
                data = run_info_message(decode_run_info(data)._replace(**changes))
            if message.topic == "/force":
                blocks -= 1
                if blocks < 0:
                    continue
            copy.write(message.topic, message.type, message.log_time_ns, data)
    return path


def test_impacts_agree_with_the_ground_truth(shipped: list[CampaignRun]) -> None:
    bags = find_bags(share("bags", "campaign"))
    assert len(shipped) == len(bags) == 12
    for bag, (impact, motion) in zip(bags, shipped, strict=True):
        info = run_info_of(bag)
        assert impact.point == info.impact_position[:2]
        assert impact.obstacle_mass_kg == info.obstacle_mass
        assert impact.simulated
        assert impact.peak_force_n == pytest.approx(info.true_peak_force, rel=5e-3)
        assert impact.speed_m_s == pytest.approx(info.true_speed, rel=2e-3)
        assert motion.contact_x_m == pytest.approx(impact.point[0], abs=1.2e-3)
        assert motion.source == f"simulated run {bag.name}"


def test_force_starts_before_the_onset(shipped: list[CampaignRun]) -> None:
    for impact, _ in shipped:
        assert -BEFORE_ONSET_S <= impact.time_s[0] < 0.0
        assert AFTER_ONSET_S - 1e-4 < impact.time_s[-1] <= AFTER_ONSET_S
        assert np.abs(impact.force_n[impact.time_s < -1e-4]).max() < 1.5
        assert impact.force_n.max() == pytest.approx(impact.peak_force_n, rel=0.02)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"plate_normal": (0.0, 0.0, 0.0)}, "must state obstacle_mass"),
        ({"obstacle_mass": 0.0}, "obstacle_mass"),
        ({"plate_normal": (0.0, 1.0, 0.0)}, "plate_normal"),
        ({"impact_position": (math.nan, 0.0, 0.0)}, "impact_position"),
    ],
)
def test_recording_without_point_or_mass_raises(
    scara: Scara, tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
    path = copy_run(tmp_path / "run", changes)
    with pytest.raises(BagError, match=message) as raised:
        campaign_runs(tmp_path, scara, JOINTS, DetectionSettings())
    assert str(path) in str(raised.value)


@pytest.mark.parametrize(("blocks", "message"), [(0, "ForceBlock"), (4, "0 impacts")])
def test_recording_without_an_impact_raises(scara: Scara, tmp_path: Path, blocks: int, message: str) -> None:
    copy_run(tmp_path / "run", {}, blocks)
    with pytest.raises(BagError, match=message):
        campaign_runs(tmp_path, scara, JOINTS, DetectionSettings())

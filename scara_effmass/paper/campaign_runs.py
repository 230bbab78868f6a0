"""Impacts and tool motions of a campaign, from its recordings: one bag per run."""

import math
from pathlib import Path
from typing import NamedTuple

from scara_effmass.analysis.recorded_run import read_force, run_infos
from scara_effmass.bags.bag import Bag
from scara_effmass.bags.files import find_bags, open_bag
from scara_effmass.errors import BagError
from scara_effmass.impacts.detector import Detector
from scara_effmass.paper.motion import ToolMotion, tool_motion
from scara_effmass.paper.recorded_impact import Point, RecordedImpact
from scara_effmass.paper.scara import Scara
from scara_effmass.settings import DetectionSettings
from scara_effmass.values import Impact
from scara_effmass.wire.message_types import FORCE_BLOCK

BEFORE_ONSET_S, AFTER_ONSET_S = 0.5e-3, 5e-3
"""Interval of the force around the onset."""
ALONG_X = (1.0, 0.0, 0.0)


class CampaignRun(NamedTuple):
    """The impact of one run, and the motion of the tool."""

    impact: RecordedImpact
    motion: ToolMotion


def campaign_runs(
    folder: Path, scara: Scara, joints: tuple[str, str], settings: DetectionSettings
) -> list[CampaignRun]:
    """Return the runs in `folder`, with impacts detected in the recorded force; the first two joints are `joints`.

    The speed is that of the last joint state certainly before the onset. Raises BagError for a recording without
    exactly one complete impact along x, or without obstacle mass and impact point.
    """
    return [_run(path, scara, joints, settings) for path in find_bags(folder)]


def _run(path: Path, scara: Scara, joints: tuple[str, str], settings: DetectionSettings) -> CampaignRun:
    with open_bag(path) as bag:
        point, obstacle_mass = _point_and_mass(bag)
        forces = read_force(bag)
        if forces is None:
            raise BagError(f"{path}: no {FORCE_BLOCK}: must contain the force of an impact")
        impact = _impact(bag, settings)
    motion = tool_motion(
        path,
        scara,
        joints,
        source=f"{'simulated' if forces.simulated else 'recorded'} run {path.name}",
        contact_ns=impact.stamp_ns,
        contact_uncertainty_s=impact.clock_residual,
    )
    time = (forces.stamp_ns - impact.stamp_ns) / 1e9
    shown = (time >= -BEFORE_ONSET_S) & (time <= AFTER_ONSET_S)
    recorded_impact = RecordedImpact(
        point=point,
        obstacle_mass_kg=obstacle_mass,
        speed_m_s=motion.contact_speed_m_s,
        peak_force_n=impact.peak_force,
        time_s=time[shown],
        force_n=forces.force[shown] - impact.baseline,
        simulated=forces.simulated,
    )
    return CampaignRun(recorded_impact, motion)


def _point_and_mass(bag: Bag) -> tuple[Point, float]:
    """Return impact point [m] and obstacle mass [kg]."""
    for info in run_infos(bag):
        if not info.obstacle_mass or not any(info.plate_normal):
            continue
        if info.plate_normal != ALONG_X:
            raise BagError(f"{bag.path}: plate_normal = {info.plate_normal}: must be {ALONG_X}")
        x, y, _ = info.impact_position
        if not math.isfinite(x + y):
            raise BagError(f"{bag.path}: impact_position = {info.impact_position}: must be finite [m]")
        return (x, y), info.obstacle_mass
    raise BagError(f"{bag.path}: must state obstacle_mass, impact_position and plate_normal, as a campaign does")


def _impact(bag: Bag, settings: DetectionSettings) -> Impact:
    detector = Detector(settings)
    topic = next(topic.name for topic in bag.topics if topic.type == FORCE_BLOCK)
    impacts = [impact for block in bag.force_blocks(topic) for impact in detector.feed(block)] + detector.finish()
    first = [impact for impact in impacts if not impact.rebound]
    if len(first) != 1:
        raise BagError(f"{bag.path}: {topic}: {len(first)} impacts without rebounds: must be 1")
    if first[0].clipped or first[0].incomplete:
        raise BagError(f"{bag.path}: {topic}: clipped or incomplete impact: must be complete")
    return first[0]

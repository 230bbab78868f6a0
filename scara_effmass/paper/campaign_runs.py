"""The impacts of a campaign, from its recordings: one bag per run, each of which says what was set."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from scara_effmass.analysis.forces import read_force
from scara_effmass.analysis.recorded_run import run_infos
from scara_effmass.bags.files import find_bags, open_bag
from scara_effmass.errors import BagError
from scara_effmass.impacts.detector import Detector
from scara_effmass.paper.motion import tool_motion
from scara_effmass.paper.recorded_impact import RecordedImpact
from scara_effmass.wire.message_types import FORCE_BLOCK

if TYPE_CHECKING:
    from pathlib import Path

    from scara_effmass.bags.bag import Bag
    from scara_effmass.paper.motion import ToolMotion
    from scara_effmass.paper.scara import Scara
    from scara_effmass.settings import DetectionSettings
    from scara_effmass.values import Impact

LEAD_S, SHOWN_S = 0.5e-3, 5e-3
"""From so long before the onset the force is kept, until so long after it."""
ALONG_X = (1.0, 0.0, 0.0)


class CampaignRun(NamedTuple):
    """One run: its impact, and how the tool moved."""

    impact: RecordedImpact
    motion: ToolMotion


def campaign_runs(
    folder: Path, scara: Scara, joints: tuple[str, str], settings: DetectionSettings
) -> list[CampaignRun]:
    """Return the runs in `folder`, the impacts found anew in the recorded force; first two joints are `joints`.

    The speed is that of the last joint state before the onset, less what the clock of the force may be off. Raises
    BagError for a recording without one whole impact along x, or that does not say at which point and with which mass.
    """
    return [_run(path, scara, joints, settings) for path in find_bags(folder)]


def _run(path: Path, scara: Scara, joints: tuple[str, str], settings: DetectionSettings) -> CampaignRun:
    with open_bag(path) as bag:
        point, obstacle_mass = _what_was_set(bag)
        forces = read_force(bag)
        if forces is None:
            raise BagError(f"{path}: has no {FORCE_BLOCK}; the force of an impact would be right")
        impact = _impact(bag, settings)
    about = f"{'simulated' if forces.simulated else 'recorded'} run {path.name}"
    motion = tool_motion(path, scara, joints, about, contact_ns=impact.stamp_ns, contact_doubt_s=impact.clock_residual)
    time = (forces.stamp_ns - impact.stamp_ns) / 1e9
    shown = (time >= -LEAD_S) & (time <= SHOWN_S)
    return CampaignRun(
        RecordedImpact(
            point=point,
            obstacle_mass_kg=obstacle_mass,
            speed_m_s=motion.contact_speed_m_s,
            peak_force_n=impact.peak_force,
            time_s=time[shown],
            force_n=forces.force[shown] - impact.baseline,
            simulated=forces.simulated,
        ),
        motion,
    )


def _what_was_set(bag: Bag) -> tuple[tuple[float, float], float]:
    """Return the point of the impact [m] and the mass of the cart [kg]."""
    for info in run_infos(bag):
        if not info.obstacle_mass or not any(info.plate_normal):
            continue
        if info.plate_normal != ALONG_X:
            raise BagError(f"{bag.path}: plate_normal = {info.plate_normal}: must be {ALONG_X}")
        x, y, _ = info.impact_position
        if not math.isfinite(x + y):
            raise BagError(f"{bag.path}: impact_position = {info.impact_position}: must be finite [m]")
        return (x, y), info.obstacle_mass
    raise BagError(
        f"{bag.path}: states no obstacle_mass, impact_position and plate_normal; a campaign's recording does"
    )


def _impact(bag: Bag, settings: DetectionSettings) -> Impact:
    detector = Detector(settings)
    topic = next(topic.name for topic in bag.topics if topic.type == FORCE_BLOCK)
    found = [impact for block in bag.force_blocks(topic) for impact in detector.feed(block)] + detector.finish()
    first = [impact for impact in found if not impact.rebound]
    if len(first) != 1:
        raise BagError(f"{bag.path}: {topic}: {len(first)} impacts, rebounds aside; a run has one")
    if first[0].clipped or first[0].incomplete:
        raise BagError(f"{bag.path}: {topic}: its impact is clipped or incomplete; a whole one would be right")
    return first[0]

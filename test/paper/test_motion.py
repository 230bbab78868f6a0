"""The tool's motion from joint states."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from scara_effmass.bags.writer import BagWriter
from scara_effmass.errors import BagError
from scara_effmass.paper.motion import tool_motion
from scara_effmass.values import JointState

if TYPE_CHECKING:
    from pathlib import Path

    from scara_effmass.paper.motion import ToolMotion
    from scara_effmass.paper.scara import Scara

START_NS = 1_767_225_600_000_000_000
JOINTS = ("joint1", "joint2")


def record(path: Path, names: tuple[str, ...], *, velocities: bool = True) -> Path:
    """Record a swing of 1 s at 1 kHz with the joints `names`."""
    with BagWriter(path) as bag:
        bag.write_joint_states("/joint_states", [state(number, names, velocities) for number in range(1001)])
    return path


def state(number: int, names: tuple[str, ...], velocities: bool) -> JointState:  # noqa: FBT001
    t = number / 1e3
    angles = {"joint1": 0.3 * np.sin(2.0 * t), "joint2": 1.0 + 0.5 * t, "gripper": 9.0}
    rates = {"joint1": 0.6 * np.cos(2.0 * t), "joint2": 0.5, "gripper": 9.0}
    qd = np.array([rates[name] for name in names]) if velocities else np.empty(0)
    return JointState(START_NS + number * 10**6, names, np.array([angles[name] for name in names]), qd)


def test_shipped_recording_passes_the_impact_point(motion: ToolMotion) -> None:
    assert motion.contact_x_m == pytest.approx(0.3, abs=1e-9)
    assert motion.contact_speed_m_s == pytest.approx(0.25, rel=1e-9)
    assert motion.path_share == pytest.approx(0.5, rel=1e-9)
    assert "nothing is hit" in motion.contact_label


def test_velocity_is_the_derivative_of_position_for_any_joint_order(scara: Scara, tmp_path: Path) -> None:
    path = record(tmp_path / "a", ("gripper", "joint2", "joint1"))
    motion = tool_motion(path, scara, JOINTS, "synthetic", contact_ns=START_NS + 400_000_000)
    np.testing.assert_allclose(motion.speed_m_s[1:-1], np.gradient(motion.x_m, motion.time_s)[1:-1], atol=1e-5)
    assert motion.contact_s == pytest.approx(0.4)
    assert motion.contact_label == "instant of impact"


@pytest.mark.parametrize(
    ("names", "velocities", "contact", "problem"),
    [
        (("joint1", "gripper"), True, {"contact_x": 0.3}, "joint2"),
        (JOINTS, False, {"contact_x": 0.3}, "velocity"),
        (JOINTS, True, {"contact_x": 0.6}, "must reach x = 0.6 m"),
        (JOINTS, True, {"contact_ns": START_NS - 1}, "must be within the recording"),
    ],
)
def test_unusable_recording_raises_in_one_line(
    scara: Scara,
    tmp_path: Path,
    names: tuple[str, ...],
    velocities: bool,  # noqa: FBT001
    contact: dict[str, float],
    problem: str,
) -> None:
    path = record(tmp_path / "a", names, velocities=velocities)
    with pytest.raises(BagError, match=problem) as raised:
        tool_motion(path, scara, JOINTS, "synthetic", **contact)  # type: ignore[arg-type]
    assert "\n" not in str(raised.value)

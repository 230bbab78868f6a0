# SPDX-License-Identifier: Apache-2.0
"""The texts of the kernel's codes are those of the assessment without it."""

from typing import Any

import numpy as np
import pytest
from scara_effmass.model.dynamics import LUMPED_NOT_DEFINITE, RobotDynamics

from scara_effmass.iso15066 import SpeedLimits, limits_for
from scara_effmass.kernel import codes
from scara_effmass.kernel.records import OFFSETS
from scara_effmass.safety.reasons import MASSLESS, NO_CLAMPING_FORCE, Reasons
from scara_effmass.settings import MonitorSettings

NUMBERS = {"speed": 1.5, "allowable_speed": 0.75, "effective_mass": 2.0, "clamping_force": 900.0}
MASSES = {"lumped_mass": 1e-5, "full_mass": 2e-5, "iso_mass": 3e-5}


def text(dynamics: RobotDynamics, settings: MonitorSettings, **numbers: float) -> str:
    row = np.zeros(max(OFFSETS.values()) + 1)
    for name, value in (NUMBERS | MASSES | numbers).items():
        row[OFFSETS[name]] = value
    reasons = Reasons(dynamics, settings, SpeedLimits(limits_for(settings), settings))
    return reasons.of_row(row.tolist())


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (codes.Error.NO_FORCE, NO_CLAMPING_FORCE),
        (
            codes.Error.TOO_LIGHT + codes.Model.LUMPED,
            "lumped mass = 1e-05 kg: must be at least 1e-06 kg: check the robot",
        ),
        (codes.Error.TOO_LIGHT + codes.Model.FULL, "full mass = 2e-05 kg: must be at least 1e-06 kg: check the robot"),
        (codes.Error.TOO_LIGHT + codes.Model.ISO, "iso mass = 3e-05 kg: must be at least 1e-06 kg: check the robot"),
        (codes.Error.NO_WORST + codes.Model.LUMPED, "no lumped mass for every contact normal, "),
        (codes.Error.NO_WORST + codes.Model.FULL, "no full mass for every contact normal, "),
        (codes.Error.NO_LUMPED + codes.NoLumped.NOT_DEFINITE, f"no lumped mass ({LUMPED_NOT_DEFINITE}): choose "),
        (codes.Error.NO_LUMPED + codes.NoLumped.MASSLESS, f"no lumped mass ({MASSLESS}): choose "),
        (codes.Error.NO_LUMPED + codes.NoLumped.MASSLESS_JOINT, "no lumped mass (joint1 moves the contact point"),
        (codes.Error.NO_LUMPED + codes.NoLumped.MASSLESS_JOINT + 3, "no lumped mass (joint4 moves the contact point"),
    ],
)
def test_each_error_has_its_text(scara: RobotDynamics, error: int, reason: str) -> None:
    found = text(scara, MonitorSettings(), error=error, remark=codes.Remark.FAST)
    assert found.startswith(reason)


def test_robot_without_inertias_or_a_lumped_model_says_why(
    bare_scara: RobotDynamics, skew_scara: RobotDynamics
) -> None:
    found = text(bare_scara, MonitorSettings(), error=codes.Error.NO_FULL)
    assert found == f"no full mass ({bare_scara.full_reason}): choose effective_mass_model auto, lumped or iso"
    assert bare_scara.full_reason
    found = text(skew_scara, MonitorSettings(), error=codes.Error.NO_LUMPED + codes.NoLumped.NOT_THERE)
    assert found == f"no lumped mass ({skew_scara.lumped_reason}): choose effective_mass_model auto, full or iso"
    assert skew_scara.lumped_reason


LIMIT = {"criterion": 1.0, "body_region": 1.0}


@pytest.mark.parametrize(
    ("remark", "numbers", "reason"),
    [
        (0, {}, ""),
        (codes.Remark.FAST, {}, "1.500 m/s is above the 0.750 m/s that the force limit of {} allows"),
        (codes.Remark.CLOSE, {}, "1.500 m/s is close to the 0.750 m/s that the force limit of {} allows"),
        (
            codes.Remark.FAST,
            {"criterion": 2.0, "allowable_speed": -1.0},
            "1.500 m/s is above the 0.000 m/s that the pressure",
        ),
        (codes.Remark.LIGHT, {}, "the lumped mass of 2 kg is below the full model's 2e-05 kg"),
        (
            codes.Remark.CLOSE | codes.Remark.LIGHT,
            {},
            "1.500 m/s is close to the 0.750 m/s that the force limit of {} allows; the ",
        ),
        (codes.Remark.CLAMPED, {}, "the drives can clamp with 900 N, above the {:.0f} N of {}, at any speed"),
    ],
)
def test_each_remark_has_its_text(scara: RobotDynamics, remark: int, numbers: dict[str, float], reason: str) -> None:
    settings = MonitorSettings.model_validate(
        {"effective_mass_model": "lumped", "body_regions": ("hand_fingers", "chest")}
    )
    limits = SpeedLimits(limits_for(settings), settings).limits
    weakest = min(limits, key=lambda limit: limit.permissible_force_n)
    words: tuple[Any, ...] = (limits[0].region,)
    if remark == codes.Remark.CLAMPED:
        words = weakest.permissible_force_n, weakest.region
    assert text(scara, settings, remark=remark, **(LIMIT | numbers)).startswith(reason.format(*words))


def test_why_a_model_decides_is_listed_in_the_order_of_the_codes(
    scara: RobotDynamics, bare_scara: RobotDynamics
) -> None:
    for dynamics in (scara, bare_scara):
        reasons = Reasons(dynamics, MonitorSettings(), SpeedLimits(limits_for(MonitorSettings()), MonitorSettings()))
        lumped = [dynamics.lumped_reason, LUMPED_NOT_DEFINITE, MASSLESS]
        assert reasons.whys[codes.Why.SETTING] == "effective_mass_model auto"
        assert reasons.whys[codes.Why.HEAVY].startswith("nowhere more than ")
        assert reasons.whys[codes.Why.LIGHTER].startswith("the lumped model is more than ")
        assert reasons.whys[codes.Why.LARGEST].startswith("largest of lumped, no full mass: ")
        for index, reason in enumerate(lumped):
            assert reasons.whys[codes.Why.FULL + index] == f"no lumped mass: {reason}"
            iso = codes.Why.FULL + len(lumped) + len(dynamics.robot.joint_names) + index
            assert reasons.whys[iso] == f"no full mass: {dynamics.full_reason}; no lumped mass: {reason}"

# SPDX-License-Identifier: Apache-2.0
"""Each code of a reason has its text."""

from typing import Any

import numpy as np
import pytest

from scara_effmass.codes import ModelReason, NoLumpedMass, Reason
from scara_effmass.iso15066 import limits_for
from scara_effmass.kernel.records import REASON_SIZE
from scara_effmass.kernel.state import CODE, DETAIL, HELD, JOINT, LATCHED, VALUES
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety.assumptions import assumptions_of
from scara_effmass.safety.reasons import MASSLESS, NO_TEXTS, NOT_DEFINITE, TEXTS, ReasonTexts
from scara_effmass.settings import MonitorSettings

SPEEDS = (1.5, 0.75, 1.0, 1.0)
"""Speed, allowable speed, criterion and body region."""
LUMPED, FULL, ISO = 1, 2, 3


def texts_of(dynamics: RobotDynamics, **settings: object) -> ReasonTexts:
    values = MonitorSettings.model_validate(settings)
    return ReasonTexts.of(dynamics, values, limits_for(values), assumptions_of(dynamics.robot, values))


def text(texts: ReasonTexts, code: Reason, *values: float, joint: int = 0, held: bool = False, latched: int = 0) -> str:
    """Return the text of a reason whose own text is "detail"; the contact that `latched` is "tool" or has no name."""
    reason = np.zeros(REASON_SIZE)
    reason[[CODE, JOINT, DETAIL, HELD, LATCHED]] = code, joint, 1, held, latched
    reason[VALUES : VALUES + len(values)] = values
    return texts.text(reason.tolist(), ("", "detail", "tool"))


@pytest.mark.parametrize("code", Reason)
def test_every_code_has_a_text(scara: RobotDynamics, code: Reason) -> None:
    # This robot has masses, and its file states all, so nothing says why it has none, or what is assumed.
    assert bool(text(texts_of(scara), code)) == (code not in {Reason.NONE, Reason.NO_MASSES, Reason.ASSUMED})
    assert set(TEXTS) == set(Reason)


@pytest.mark.parametrize(
    ("code", "values", "expected"),
    [
        (Reason.NO_CLAMPING_FORCE, (), "the clamping force is unknown: state effort limits in the robot file that "),
        (Reason.TOO_LIGHT, (LUMPED, 1e-5), "lumped mass = 1e-05 kg: must be at least 1e-06 kg: check the robot"),
        (Reason.TOO_LIGHT, (FULL, 2e-5), "full mass = 2e-05 kg: must be at least 1e-06 kg: check the robot"),
        (Reason.TOO_LIGHT, (ISO, 3e-5), "iso mass = 3e-05 kg: must be at least 1e-06 kg: check the robot"),
        (Reason.NO_WORST_MASS, (LUMPED,), "no lumped mass for every contact normal, "),
        (Reason.NO_WORST_MASS, (FULL,), "no full mass for every contact normal, "),
        (Reason.NO_LUMPED_MASS, (NoLumpedMass.NOT_DEFINITE,), f"no lumped mass ({NOT_DEFINITE}): choose "),
        (Reason.NO_LUMPED_MASS, (NoLumpedMass.MASSLESS,), f"no lumped mass ({MASSLESS}): choose "),
        (Reason.NO_LUMPED_MASS, (NoLumpedMass.MASSLESS_JOINT,), "no lumped mass (joint1 moves the contact point"),
        (Reason.NO_LUMPED_MASS, (NoLumpedMass.MASSLESS_JOINT + 3,), "no lumped mass (joint4 moves the contact point"),
        (Reason.UNDECODABLE, (), "detail"),
        (Reason.GAP, (0.2514,), "no valid joint state for 0.251 s"),
    ],
)
def test_code_that_gives_unknown_has_its_text(
    scara: RobotDynamics, code: Reason, values: tuple[float, ...], expected: str
) -> None:
    assert text(texts_of(scara), code, *values).startswith(expected)


def test_joint_has_its_name_and_unit(scara: RobotDynamics) -> None:
    texts = texts_of(scara)
    assert text(texts, Reason.SPEED_LIMIT, 4.0, 3.0, joint=2) == (
        "joint3 at 4.0000 m/s exceeds its maximum speed of 3.0000 m/s"
    )
    assert text(texts, Reason.SPEED_LIMIT, 4.0, 3.0, joint=3).startswith("joint4 at 4.0000 rad/s")


def test_robot_without_inertias_or_a_lumped_model_says_why(
    bare_scara: RobotDynamics, skew_scara: RobotDynamics
) -> None:
    found = text(texts_of(bare_scara), Reason.NO_FULL_MASS)
    assert found == f"no full mass ({bare_scara.full_reason}): choose effective_mass_model auto, lumped or iso"
    assert bare_scara.full_reason
    found = text(texts_of(skew_scara), Reason.NO_LUMPED_MASS, NoLumpedMass.NOT_THERE)
    assert found == f"no lumped mass ({skew_scara.lumped_reason}): choose effective_mass_model auto, full or iso"
    assert skew_scara.lumped_reason


@pytest.mark.parametrize(
    ("code", "values", "expected"),
    [
        (Reason.NONE, (), ""),
        (Reason.TOO_FAST, SPEEDS, "1.500 m/s is above the 0.750 m/s that the force limit of {} allows"),
        (Reason.NEAR_LIMIT, SPEEDS, "1.500 m/s is close to the 0.750 m/s that the force limit of {} allows"),
        (Reason.TOO_FAST, (0.2501, 0.0459, 1.0, 1.0), "0.251 m/s is above the 0.045 m/s that the force limit of {}"),
        (Reason.TOO_FAST, (1.5, 0.0, 2.0, 1.0), "1.500 m/s is above the 0.000 m/s that the pressure"),
        (
            Reason.LIGHT_MODEL,
            (*SPEEDS, 2.0, 3.0),
            "the lumped mass of 2 kg is below the full model's 3 kg",
        ),
        (
            Reason.NEAR_LIMIT,
            (*SPEEDS, 2.0, 3.0),
            "1.500 m/s is close to the 0.750 m/s that the force limit of {} allows; the lumped mass of 2 kg is below ",
        ),
        (Reason.CLAMPED, (110.3, 110.0, 1), "the drives can clamp with 111 N, above the 110 N of {}, at any speed"),
    ],
)
def test_code_of_an_assessment_has_its_text(
    scara: RobotDynamics, code: Reason, values: tuple[float, ...], expected: str
) -> None:
    settings: dict[str, Any] = {"effective_mass_model": "lumped", "body_regions": ("hand_fingers", "chest")}
    limits = limits_for(MonitorSettings.model_validate(settings))
    assert text(texts_of(scara, **settings), code, *values).startswith(expected.format(limits[0].region))


def test_held_and_latched_reasons_say_so() -> None:
    assert text(NO_TEXTS, Reason.ZERO_STAMP, held=True) == "held after: the header stamp is zero or negative"
    assert (
        text(NO_TEXTS, Reason.ZERO_STAMP, latched=3)
        == "latched until reset: tool: the header stamp is zero or negative"
    )
    assert text(NO_TEXTS, Reason.ZERO_STAMP, latched=1) == "latched until reset: the header stamp is zero or negative"


def test_why_a_model_decides_is_listed_in_the_order_of_the_codes(
    scara: RobotDynamics, bare_scara: RobotDynamics
) -> None:
    for dynamics in (scara, bare_scara):
        whys, joints = texts_of(dynamics).whys, len(dynamics.robot.joint_names)
        assert whys[ModelReason.SETTING] == "effective_mass_model auto"
        assert whys[ModelReason.HEAVY_ENOUGH].startswith("nowhere more than ")
        assert whys[ModelReason.LIGHTER].startswith("the lumped model is more than ")
        assert whys[ModelReason.LARGEST].startswith("largest of lumped, no full mass: ")
        for index, reason in enumerate((dynamics.lumped_reason, NOT_DEFINITE, MASSLESS)):
            assert whys[ModelReason.NO_LUMPED + index] == f"no lumped mass: {reason}"
            iso = ModelReason.only_iso(index, joints)
            assert whys[iso] == f"no full mass: {dynamics.full_reason}; no lumped mass: {reason}"

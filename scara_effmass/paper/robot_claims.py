"""Claims about the robot and the experiment's equipment: masses, ranges, settings."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from scara_effmass.iso15066 import reduced_mass
from scara_effmass.paper.claim import Basis, holds, near, not_checked
from scara_effmass.paper.protocol import OBSTACLES_KG, SAMPLE_RATE, SAMPLES
from scara_effmass.settings import DaqSettings

if TYPE_CHECKING:
    from collections.abc import Iterator

    from scara_effmass.paper.claim import Claim
    from scara_effmass.paper.scara import Scara

ROUNDING_KG = 0.005
PRINTED_MU_ISO = (0.42, 1.28, 1.59, 2.01)
PRINTED_SENSITIVITY = 2.224


def robot_claims(scara: Scara) -> Iterator[Claim]:
    """Yield them."""
    yield near("m2", "§4.1", "M₂ = 2.38 kg", 2.38, scara.m2, ROUNDING_KG, "kg", Basis.FITTED)
    yield near("m3", "§4.1", "M₃ = 0.97 kg", 0.97, scara.m3, ROUNDING_KG, "kg", Basis.FITTED)
    yield near("iso_mass", "§4.1", "m_R = 2.77 kg", 2.77, scara.iso_mass, ROUNDING_KG, "kg", Basis.FITTED)
    for obstacle, printed in zip(OBSTACLES_KG, PRINTED_MU_ISO, strict=True):
        yield near(
            f"mu_iso_{obstacle:g}",
            "§4.2",
            f"µ_ISO = {printed:g} kg for m_H = {obstacle:g} kg",
            printed,
            reduced_mass(scara.iso_mass, obstacle),
            ROUNDING_KG,
            "kg",
            Basis.RESULT,
            "follows from m_R and m_H",
        )
    count = len(scara.aggregated)
    yield holds(
        "lumped_masses",
        "§3.1",
        "five aggregated masses, the first one at rest, four moving",
        f"{count} masses, of which {count - 1} move: " + ", ".join(f"{mass:.3f}" for mass in scara.aggregated) + " kg",
        "5 masses, none negative",
        Basis.RESULT,
        "the count follows from the construction; Table II itself did not survive in our copy of the text",
        met=count == 5 and min(scara.aggregated) >= 0.0,
    )
    yield not_checked(
        "lumped_masses_tm5",
        "Fig. 1",
        "seven aggregated masses for a six-axis TM5-700",
        "the construction here covers parallel axes only, so this robot is not lumped",
    )
    yield near("q1_range", "§4.1", "q₁ within ±136°", 136.0, float(np.degrees(scara.q1_max)), 0.01, "deg", Basis.GIVEN)
    yield near("q2_range", "§4.1", "q₂ within ±148°", 148.0, float(np.degrees(scara.q2_max)), 0.01, "deg", Basis.GIVEN)
    settings = DaqSettings()
    yield near(
        "sensitivity",
        "§5",
        "sensitivity of the force sensor 208C03: 2.224 mV/kN",
        PRINTED_SENSITIVITY,
        1e3 * settings.sensor.sensitivity,
        PRINTED_SENSITIVITY * settings.sensor.sensitivity_uncertainty,
        "mV/kN",
        Basis.GIVEN,
        "nominal is 10 mV/lbf = 2.248 mV/N; 2.224 is the sensor's range in kN, and tolerance is the maker's 15 %",
    )
    rate = settings.ni9230.sample_rate
    yield near("sample_rate", "§5", "12 800 samples per second", SAMPLE_RATE, rate, 0.5, "Hz", Basis.GIVEN)
    yield near(
        "record_length",
        "§5",
        "10 000 samples per record (0.78125 s at 12 800 Hz)",
        SAMPLES / SAMPLE_RATE,
        SAMPLES / rate,
        1e-5,
        "s",
        Basis.GIVEN,
    )

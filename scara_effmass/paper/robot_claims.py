"""Claims about robot and equipment: masses, joint ranges, sensor settings."""

from collections.abc import Iterator

import numpy as np

from scara_effmass.iso15066 import reduced_mass
from scara_effmass.paper.claim import Basis, Claim
from scara_effmass.paper.protocol import OBSTACLES_KG, SAMPLE_RATE, SAMPLES
from scara_effmass.paper.scara import Scara
from scara_effmass.settings import DaqSettings

ROUNDING_KG = 0.005
PRINTED_MU_ISO = (0.42, 1.28, 1.59, 2.01)
PRINTED_SENSITIVITY = 2.224


def robot_claims(scara: Scara) -> Iterator[Claim]:
    """Yield the claims of sections 3.1, 4.1, 4.2 and 5 about the robot and the force measurement."""
    for key, symbol, printed, value in (
        ("m2", "M₂", 2.38, scara.m2),
        ("m3", "M₃", 0.97, scara.m3),
        ("iso_mass", "m_R", 2.77, scara.iso_mass),
    ):
        claim = Claim(key, "§4.1", f"{symbol} = {printed} kg", Basis.FITTED)
        yield claim.near(value, printed, ROUNDING_KG, "kg")
    for obstacle, printed in zip(OBSTACLES_KG, PRINTED_MU_ISO, strict=True):
        text = f"µ_ISO = {printed:g} kg for m_H = {obstacle:g} kg"
        value = reduced_mass(scara.iso_mass, obstacle)
        yield Claim(f"mu_iso_{obstacle:g}", "§4.2", text).near(
            value, printed, ROUNDING_KG, "kg", "follows from m_R and m_H"
        )
    masses = ", ".join(f"{mass:.3f}" for mass in scara.aggregated)
    count = len(scara.aggregated)
    yield Claim("lumped_masses", "§3.1", "five aggregated masses, the first one at rest, four moving").holds(
        f"{count} masses, of which {count - 1} move: {masses} kg",
        "5 masses, none negative",
        "the count follows from the construction; the values of Table II are not in our copy of the paper",
        met=count == 5 and min(scara.aggregated) >= 0.0,
    )
    yield Claim("lumped_masses_tm5", "Fig. 1", "seven aggregated masses for a six-axis TM5-700").not_checked(
        "the construction here covers parallel axes only, so this robot is not lumped"
    )
    for key, symbol, printed, limit in (
        ("q1_range", "q₁", 136.0, scara.q1_max),
        ("q2_range", "q₂", 148.0, scara.q2_max),
    ):
        claim = Claim(key, "§4.1", f"{symbol} within ±{printed:g}°", Basis.GIVEN)
        yield claim.near(float(np.degrees(limit)), printed, 0.01, "deg")
    settings = DaqSettings()
    text = "sensitivity of the force sensor 208C03: 2.224 mV/kN"
    yield Claim("sensitivity", "§5", text, Basis.GIVEN).near(
        1e3 * settings.sensor.sensitivity,
        PRINTED_SENSITIVITY,
        PRINTED_SENSITIVITY * settings.sensor.sensitivity_uncertainty,
        "mV/kN",
        "nominal is 10 mV/lbf = 2.248 mV/N; 2.224 is the sensor's range in kN, and tolerance is the maker's 15 %",
    )
    rate = settings.ni9230.sample_rate
    yield Claim("sample_rate", "§5", "12 800 samples per second", Basis.GIVEN).near(rate, SAMPLE_RATE, 0.5, "Hz")
    text = "10 000 samples per record (0.78125 s at 12 800 Hz)"
    yield Claim("record_length", "§5", text, Basis.GIVEN).near(SAMPLES / rate, SAMPLES / SAMPLE_RATE, 1e-5, "s")

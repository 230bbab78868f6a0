# SPDX-License-Identifier: Apache-2.0
"""The limits table agrees with a second transcription and with physical invariants."""

import math

import pytest

from scara_effmass.iso15066 import BODY_POINTS, BODY_REGIONS, EDITION, TABLE_HASH, BodyPoint, BodyRegion

ROWS_OF_REGION = {
    "skull_forehead": [1, 2],
    "face": [3],
    "neck": [4, 5],
    "back_shoulders": [6, 7],
    "chest": [8, 9],
    "abdomen": [10],
    "pelvis": [11],
    "upper_arm_elbow": [12, 13],
    "lower_arm_wrist": [14, 15, 16],
    "hand_fingers": [17, 18, 19, 20, 21, 22, 23, 24, 25],
    "thigh_knee": [26, 27],
    "lower_leg": [28, 29],
}

# Quasi-static pressure [N/cm2] / force [N] of rows 1 to 29, typed a second time and in another form than in the table.
PRESSURE_OVER_FORCE = """
    130/130 110/130 110/65 140/150 210/150 160/210 210/210 120/140 170/140 140/110
    210/180 190/150 220/150 190/160 180/160 180/160 300/140 270/140 280/140 220/140
    200/140 260/140 260/140 200/140 190/140 250/220 220/220 220/130 210/130
"""

by_number = pytest.mark.parametrize("point", BODY_POINTS, ids=lambda point: str(point.number))
by_region = pytest.mark.parametrize("region", BODY_REGIONS.values(), ids=lambda region: region.name)


def test_rows_are_numbered_as_in_the_standard() -> None:
    assert [point.number for point in BODY_POINTS] == list(range(1, 30))
    assert [point.clause for point in BODY_POINTS] == [f"Table A.2 row {number}" for number in range(1, 30)]
    assert len({point.name for point in BODY_POINTS}) == 29


def test_every_row_belongs_to_its_region() -> None:
    rows = {name: [point.number for point in BODY_POINTS if point.region == name] for name in BODY_REGIONS}
    assert rows == ROWS_OF_REGION


def test_rows_agree_with_a_second_transcription() -> None:
    rows = [f"{p.quasi_static_pressure_n_cm2:g}/{p.quasi_static_force_n:g}" for p in BODY_POINTS]
    assert rows == PRESSURE_OVER_FORCE.split()


@by_number
def test_transient_limits_are_twice_the_quasi_static_ones_except_for_the_head(point: BodyPoint) -> None:
    if point.number <= 3:
        assert point.transient_factor is None
        assert point.transient_force_n is None
        assert point.transient_pressure_n_cm2 is None
    else:
        assert point.transient_factor == 2.0
        assert point.transient_force_n == 2.0 * point.quasi_static_force_n
        assert point.transient_pressure_n_cm2 == 2.0 * point.quasi_static_pressure_n_cm2


@by_region
def test_one_force_limit_per_region(region: BodyRegion) -> None:
    assert len({point.quasi_static_force_n for point in BODY_POINTS if point.region == region.name}) == 1


@by_region
def test_energy_column_agrees_with_force_and_stiffness(region: BodyRegion) -> None:
    """E = F^2/(2k) with the doubled force ties three columns together; the force limits are rounded to 10 N.

    For neck, hand and lower leg the energy belongs to a force just 5 N below the limit (quasi-static), for the
    others to the limit itself. A factor 2 lost in one column would be off by 32 N at least.
    """
    (force,) = {point.quasi_static_force_n for point in BODY_POINTS if point.region == region.name}
    force_behind_energy = math.sqrt(2.0 * region.stiffness_n_m * region.energy_j) / 2.0
    assert force_behind_energy == pytest.approx(force, abs=5.5)


@pytest.mark.parametrize(("name", "below"), [("neck", 5.0), ("hand_fingers", 5.0), ("lower_leg", 5.0), ("chest", 0.0)])
def test_energy_to_two_digits(name: str, below: float) -> None:
    region = BODY_REGIONS[name]
    (force,) = {point.quasi_static_force_n for point in BODY_POINTS if point.region == name}
    energy = (2.0 * (force - below)) ** 2 / (2.0 * region.stiffness_n_m)
    assert float(f"{energy:.2g}") == region.energy_j


def test_masses_and_stiffness_are_si() -> None:
    assert [region.stiffness_n_m for region in BODY_REGIONS.values()] == [
        1e3 * k for k in (150, 75, 50, 35, 25, 10, 25, 30, 40, 75, 50, 60)
    ]
    assert [region.mass_kg for region in BODY_REGIONS.values()] == [4.4, 4.4, 1.2, 40, 40, 40, 40, 3, 2, 0.6, 75, 75]


def test_table_cannot_be_changed() -> None:
    with pytest.raises(TypeError):
        BODY_REGIONS["chest"] = BODY_REGIONS["face"]  # type: ignore[index]
    with pytest.raises(AttributeError):
        BODY_POINTS[0].quasi_static_force_n = 1000.0  # type: ignore[misc]


def test_hash_is_that_of_the_published_table() -> None:
    assert TABLE_HASH == "e6747026b65ce9db"
    assert "15066:2016" in EDITION
    assert "unconfirmed" in EDITION

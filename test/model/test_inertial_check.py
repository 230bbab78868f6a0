# SPDX-License-Identifier: Apache-2.0
"""Placeholders in a robot file are told from data by their pattern over all links with mass."""

import numpy as np
import pytest

from scara_effmass.model.description import StatedLink
from scara_effmass.model.plausibility import check_inertials


def link(name: str, mass: float = 1.0, inertia: float = 1.0, com: float = 0.1) -> StatedLink:
    return StatedLink(name, mass, np.array([com, 0.0, 0.0]), inertia * np.eye(3))


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_pattern_needs_two_links_with_mass(count: int) -> None:
    links = [link("base", mass=0.0, inertia=0.0), *(link(f"link{i}") for i in range(count))]
    check = check_inertials(links)
    assert ("placeholders" in check.masses) == (count > 1)
    assert ("placeholders" in check.inertias) == (count > 1)
    assert bool(check.notes) == (count == 1)


def test_one_plausible_link_makes_the_others_a_note() -> None:
    check = check_inertials([link("a"), link("b"), link("c", inertia=0.01)])
    assert (check.masses, check.inertias) == ("", "")
    assert check.notes == ("placeholder inertia, used as stated, which makes the robot heavier: a, b",)


@pytest.mark.parametrize(
    ("masses", "inertias", "text"),
    [
        ((4, 3, 2), (0.01, 0.01, 0.01), "a0, a1, a2"),
        ((4, 3, 2, 1), (0.01, 0.02, 0.01, 0.01), "a0, a2, a3"),
        ((3, 3, 3), (0.01, 0.01, 0.01), ""),  # modules
        ((4, 3), (0.01, 0.01), ""),
        ((5, 4, 3, 2, 1), (0.01, 0.02, 0.03, 0.01, 0.01), ""),
    ],
)
def test_one_tensor_for_links_of_unequal_masses_is_doubted(
    masses: tuple[float, ...], inertias: tuple[float, ...], text: str
) -> None:
    pairs = zip(masses, inertias, strict=True)
    check = check_inertials([link(f"a{number}", *pair) for number, pair in enumerate(pairs)])
    note = f"check the inertias: links of unequal masses have the same one: {text}"
    assert check.notes == ((note,) if text else ())
    assert check.inertias == ""


@pytest.mark.parametrize(
    ("masses", "com", "found"),
    [((3, 3, 3), 0.0, True), ((3, 3, 3, 2), 0.0, True), ((3, 3, 2, 2), 0.0, False), ((3, 3, 3), 0.1, False)],
)
def test_the_same_mass_at_the_origin_of_each_link_is_a_placeholder(
    masses: tuple[float, ...], com: float, *, found: bool
) -> None:
    check = check_inertials([link("a", mass, inertia=0.01, com=com) for mass in masses])
    assert ("the same mass at the origin of each link: placeholders" in check.masses) == found


@pytest.mark.parametrize(("deviation", "found"), [(0.9e-6, True), (1.1e-6, False)])
def test_identity_within_a_millionth_is_a_placeholder(deviation: float, *, found: bool) -> None:
    check = check_inertials([link(name, inertia=1.0 + deviation) for name in "ab"])
    assert ("placeholders" in check.inertias) == found


@pytest.mark.parametrize(("inertia", "found"), [(1.0, True), (3.0, True), (2.0, False)])
def test_identity_and_mass_times_identity_are_placeholders(inertia: float, *, found: bool) -> None:
    check = check_inertials([link(name, mass=3.0, inertia=inertia) for name in "ab"])
    assert ("placeholders" in check.inertias) == found

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest

from scara_effmass.sim.collision_sim import FINE_STEP_NS, ContactSample
from scara_effmass.sim.ground_truth import find_contacts
from scara_effmass.sim.spring_contact import SpringContact

if TYPE_CHECKING:
    from test.sim.conftest import FreeImpact


def samples(forces: list[float]) -> list[ContactSample]:
    return [ContactSample(i * FINE_STEP_NS, 1e-6 if force else -1e-6, force, force) for i, force in enumerate(forces)]


@pytest.mark.parametrize("gap", [0.3e-6, 1.1e-6, 2.4e-6])
def test_contact_begins_where_the_gap_closes(free_impact: type[FreeImpact], gap: float) -> None:
    impact = free_impact((0.3, 0.2), 2.39, SpringContact(), gap=gap).run()
    (contact,) = find_contacts(impact.samples)
    assert contact.onset_ns == pytest.approx(gap / 0.25 * 1e9, abs=50.0)
    assert contact.speed == pytest.approx(0.25, rel=1e-3)
    assert contact.peak_force == impact.peak
    assert contact.duration == pytest.approx(math.pi * math.sqrt(impact.reduced_mass / 2e6), abs=FINE_STEP_NS / 1e9)
    assert contact.impulse == pytest.approx(2.39 * impact.sim.cart_speed, rel=1e-9)


def test_separate_contacts_are_returned_without_incomplete_ones() -> None:
    contacts = find_contacts(samples([5.0, 0.0, 1.0, 3.0, 0.0, 0.0, 2.0, 0.0, 7.0]))
    assert [contact.peak_force for contact in contacts] == [3.0, 2.0]
    assert [contact.impulse for contact in contacts] == pytest.approx(
        [4.0 * FINE_STEP_NS / 1e9, 2.0 * FINE_STEP_NS / 1e9]
    )
    assert [contact.onset_ns for contact in contacts] == [15_000, 55_000]


def test_no_contact_gives_an_empty_result() -> None:
    assert find_contacts([]) == ()
    assert find_contacts(samples([0.0, 0.0])) == ()

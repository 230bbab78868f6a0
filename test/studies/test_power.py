# SPDX-License-Identifier: Apache-2.0
"""The study of the power of the validation assesses the tool of the shipped robot."""

import pytest

from scara_effmass.sim.experiment import run_impact
from scara_effmass.studies.campaign import Campaign
from scara_effmass.studies.power import assess, scaled


def test_errors_of_the_masses_are_in_the_decisions() -> None:
    run = run_impact(Campaign(repetitions=1).runs[0].setup)
    right, forgotten = (assess(run, tool=tool)[-1] for tool in (True, False))
    (state,), (without,), (light,) = right.contacts, forgotten.contacts, scaled(right, 0.8).contacts
    assert state.contact_point == "tool"
    assert light.lumped_mass == pytest.approx(0.8 * state.lumped_mass)
    assert light.full_mobility[0] == pytest.approx(state.full_mobility[0] / 0.8)
    assert without.lumped_mass < state.lumped_mass

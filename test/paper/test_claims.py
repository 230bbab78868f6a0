"""The claims say match where the numbers do, and stop saying it when they no longer do."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from scara_effmass.paper.claim import Basis, Outcome, Statement
from scara_effmass.paper.experiment_claims import motion_claims, run_claims
from scara_effmass.paper.mass_claims import mass_claims
from scara_effmass.paper.reduced_mass_claims import reduced_mass_claims
from scara_effmass.paper.robot_claims import robot_claims

if TYPE_CHECKING:
    from collections.abc import Iterable

    from scara_effmass.model.dynamics import RobotDynamics
    from scara_effmass.paper.claim import Claim
    from scara_effmass.paper.motion import ToolMotion
    from scara_effmass.paper.recorded_impact import RecordedImpact
    from scara_effmass.paper.scara import Scara

CONTRADICTED = {"sensitivity", "turned_plots"}


def by_key(claims: Iterable[Claim]) -> dict[str, Claim]:
    found = list(claims)
    keys = [claim.key for claim in found]
    assert len(set(keys)) == len(keys)
    return {claim.key: claim for claim in found}


def values(claims: dict[str, Claim]) -> dict[str, float]:
    return {key: claim.value for key, claim in claims.items() if claim.value is not None}


@pytest.fixture(scope="module")
def claims(dynamics: RobotDynamics, scara: Scara, motion: ToolMotion) -> dict[str, Claim]:
    return by_key(
        [
            *robot_claims(scara),
            *mass_claims(dynamics, scara),
            *reduced_mass_claims(scara),
            *motion_claims(motion),
            *run_claims(scara, ()),
        ]
    )


def test_outcomes(claims: dict[str, Claim]) -> None:
    assert {key for key, claim in claims.items() if claim.outcome is Outcome.NO_MATCH} == CONTRADICTED
    unchecked = {key for key, claim in claims.items() if claim.outcome is Outcome.NOT_CHECKED}
    assert unchecked == {"lumped_masses_tm5", "repetitions", "force_grows", "force_order", "force_proportional"}
    assert sum(claim.outcome is Outcome.MATCH for claim in claims.values()) >= 30


def test_numbers(claims: dict[str, Claim]) -> None:
    found = values(claims)
    assert found["share_below_iso"] == pytest.approx(70.9, abs=0.5)
    assert found["worst_error"] == pytest.approx(10.0, abs=0.1)
    assert found["error_in_75_percent"] == pytest.approx(4.88, abs=0.05)
    assert found["worst_reduced_error"] == pytest.approx(4.59, abs=0.01)
    assert found["turned_plots"] == pytest.approx(77.3, abs=0.1)
    assert [found[f"mu_iso_{mass}"] for mass in ("0.5", "2.39", "3.72", "7.35")] == pytest.approx(
        [0.42, 1.28, 1.59, 2.01], abs=0.005
    )


def test_what_was_fitted_is_called_so(claims: dict[str, Claim]) -> None:
    fitted = {key for key, claim in claims.items() if claim.basis is Basis.FITTED}
    assert fitted == {"m2", "m3", "iso_mass", "worst_error", "error_in_75_percent", "worst_reduced_error"}


def test_every_checked_claim_says_when_it_would_hold(claims: dict[str, Claim]) -> None:
    for claim in claims.values():
        assert claim.where
        assert claim.paper
        if claim.outcome is Outcome.NOT_CHECKED:
            assert claim.note
            assert claim.value is None
        else:
            assert claim.rule
            assert claim.ours


def test_another_robot_no_longer_matches(dynamics: RobotDynamics, scara: Scara) -> None:
    other = replace(
        scara,
        m2=1.5 * scara.m2,
        iso_mass=2.2,
        q1_max=2.0,
        inertia=replace(scara.inertia, i2=0.5 * scara.inertia.i2, m2=0.8 * scara.inertia.m2),
    )
    found = by_key([*robot_claims(other), *mass_claims(dynamics, other), *reduced_mass_claims(other)])
    wrong = {key for key, claim in found.items() if claim.outcome is Outcome.NO_MATCH}
    assert wrong >= {"m2", "iso_mass", "q1_range", "mu_iso_2.39", "share_below_iso", "mean_below_iso", "worst_error"}
    assert wrong >= {"error_in_75_percent", "worst_reduced_error"}
    assert {"m3", "minimum_at", "maximum_is_eq_30", "left_arm"}.isdisjoint(wrong)


def test_impacts_that_follow_the_law_match(scara: Scara, runs: tuple[RecordedImpact, ...]) -> None:
    found = by_key(run_claims(scara, runs))
    assert {claim.outcome for claim in found.values()} == {Outcome.MATCH}
    assert values(found)["force_proportional"] == pytest.approx(1.0, abs=1e-9)
    assert all("simulated" in claim.note for claim in found.values())


def test_impacts_that_do_not_follow_it_do_not(scara: Scara, runs: tuple[RecordedImpact, ...]) -> None:
    rng = np.random.default_rng(19)
    shuffled = [replace(run, peak_force_n=float(force)) for run, force in zip(runs, rng.permutation(36), strict=True)]
    found = by_key(run_claims(scara, shuffled[:-1]))
    assert {claim.outcome for claim in found.values()} == {Outcome.NO_MATCH}


def test_one_impact_is_too_few_to_judge_by(scara: Scara, runs: tuple[RecordedImpact, ...]) -> None:
    found = by_key(run_claims(scara, runs[:1]))
    assert found["force_proportional"].outcome is Outcome.NOT_CHECKED
    assert Outcome.MATCH not in {claim.outcome for claim in found.values()}


def test_nan_never_matches() -> None:
    statement, nan = Statement("a", "", ""), float("nan")
    for claim in (statement.near(nan, 1.0, 0.1), statement.at_most(nan, 1.0), statement.more_than(nan, 1.0)):
        assert claim.outcome is Outcome.NO_MATCH

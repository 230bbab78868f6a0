# SPDX-License-Identifier: Apache-2.0
"""Claims match where the numbers agree, and only there."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from scara_effmass.studies.claims import STATEMENTS, Claim, Outcome, all_claims, compared, run_claims
from scara_effmass.studies.runs import FigureInputs, RecordedRun

CONTRADICTED = {"sensitivity", "turned_plots", "repetitions"}
"""The shipped campaign has one run per case."""


def index_claims(claims: Iterable[Claim]) -> dict[str, Claim]:
    claims = list(claims)
    by_key = {claim.key: claim for claim in claims}
    assert len(by_key) == len(claims)
    return by_key


def values(claims: dict[str, Claim]) -> dict[str, float]:
    return {key: claim.value for key, claim in claims.items() if claim.value is not None}


def claims_of(inputs: FigureInputs) -> dict[str, Claim]:
    return index_claims(all_claims(inputs))


def claims_of_runs(inputs: FigureInputs, runs: Sequence[RecordedRun]) -> dict[str, Claim]:
    claims = index_claims(run_claims(replace(inputs, runs=tuple(runs))))
    return {key: claim for key, claim in claims.items() if key not in {"speed", "midpoint"}}


@pytest.fixture(scope="module")
def claims(shipped: FigureInputs) -> dict[str, Claim]:
    return claims_of(shipped)


def test_shipped_robot_contradicts_only_the_known_claims(claims: dict[str, Claim]) -> None:
    assert {key for key, claim in claims.items() if claim.outcome is Outcome.NO_MATCH} == CONTRADICTED
    unchecked = {key for key, claim in claims.items() if claim.outcome is Outcome.NOT_CHECKED}
    assert unchecked == {"lumped_masses_tm5"}
    assert sum(claim.outcome is Outcome.MATCH for claim in claims.values()) == 34


def test_every_statement_is_compared(claims: dict[str, Claim]) -> None:
    assert [*claims] == [*STATEMENTS]


def test_claims_have_the_known_values(claims: dict[str, Claim]) -> None:
    numbers = values(claims)
    assert numbers["speed"] == pytest.approx(250.2, abs=0.1)
    assert numbers["midpoint"] == pytest.approx(0.495, abs=1e-3)
    assert numbers["share_below_iso"] == pytest.approx(70.9, abs=0.5)
    assert numbers["worst_error"] == pytest.approx(10.0, abs=0.1)
    assert numbers["error_in_75_percent"] == pytest.approx(4.88, abs=0.05)
    assert numbers["worst_reduced_error"] == pytest.approx(4.59, abs=0.01)
    assert numbers["turned_plots"] == pytest.approx(77.3, abs=0.1)
    assert [numbers[f"mu_iso_{mass}"] for mass in ("0.5", "2.39", "3.72", "7.35")] == pytest.approx(
        [0.42, 1.28, 1.59, 2.01], abs=0.005
    )


def test_fitted_claims_are_marked_fitted(claims: dict[str, Claim]) -> None:
    fitted = {key for key, claim in claims.items() if claim.basis == "fitted"}
    assert fitted == {"m2", "m3", "iso_mass", "worst_error", "error_in_75_percent", "worst_reduced_error"}


def test_every_checked_claim_states_its_rule(claims: dict[str, Claim]) -> None:
    for claim in claims.values():
        assert claim.where
        assert claim.paper
        if claim.outcome is Outcome.NOT_CHECKED:
            assert claim.note
            assert claim.value is None
        else:
            assert claim.rule
            assert claim.ours


def test_other_robot_does_not_match(shipped: FigureInputs) -> None:
    scara = shipped.scara
    other = replace(
        scara,
        m2=1.5 * scara.m2,
        iso_mass=2.2,
        q1_max=2.0,
        inertia=replace(scara.inertia, i2=0.5 * scara.inertia.i2, m2=0.8 * scara.inertia.m2),
    )
    claims = claims_of(replace(shipped, scara=other))
    wrong = {key for key, claim in claims.items() if claim.outcome is Outcome.NO_MATCH}
    assert wrong >= {"m2", "iso_mass", "q1_range", "mu_iso_2.39", "share_below_iso", "mean_below_iso", "worst_error"}
    assert wrong >= {"error_in_75_percent", "worst_reduced_error"}
    assert {"m3", "minimum_at", "maximum_is_eq_30", "left_arm"}.isdisjoint(wrong)


def test_impacts_proportional_to_root_mu_match(inputs: FigureInputs) -> None:
    claims = claims_of_runs(inputs, inputs.runs)
    assert {claim.outcome for claim in claims.values()} == {Outcome.MATCH}
    assert values(claims)["force_proportional"] == pytest.approx(1.0, abs=1e-9)
    assert all("simulated" in claim.note for claim in claims.values())


def test_shuffled_impacts_do_not_match(inputs: FigureInputs) -> None:
    forces = np.random.default_rng(19).permutation([run.peak_force for run in inputs.runs]).tolist()
    shuffled = [replace(run, peak_force=force) for run, force in zip(inputs.runs, forces, strict=True)]
    assert {claim.outcome for claim in claims_of_runs(inputs, shuffled[:-1]).values()} == {Outcome.NO_MATCH}


def test_one_impact_is_not_checked(inputs: FigureInputs) -> None:
    claims = claims_of_runs(inputs, inputs.runs[:1])
    for key in ("force_proportional", "force_grows", "force_order"):
        assert claims[key].outcome is Outcome.NOT_CHECKED
    assert Outcome.MATCH not in {claim.outcome for claim in claims.values()}


def test_nan_never_matches() -> None:
    for key in ("sample_rate", "minimum_is_m3", "share_below_iso"):
        claim = compared(key, float("nan"), below=0.0, above=0.0)
        assert (claim.ours.split()[0], claim.value) == ("nan", None)  # JSON has no NaN
        assert claim.outcome is Outcome.NO_MATCH

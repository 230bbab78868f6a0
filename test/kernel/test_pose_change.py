# SPDX-License-Identifier: Apache-2.0
"""Change of pose during a contact: the bound that skips cases."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scara_effmass.kernel.pose_change import growth, mass_matrix, mass_polynomials, max_growth
from scara_effmass.kernel.records import ByteArray, Mobility, dtype_of
from scara_effmass.values import FloatArray

MOBILITY = dtype_of(Mobility)
UPPER = np.triu_indices(3)


def growths(record: ByteArray, least: float, ratios: FloatArray, out: FloatArray) -> None:
    """Write the bound for every alpha / beta of at least `least` in `out`, then the growth at each of `ratios`."""
    change = record.view(MOBILITY)[0]
    out[0] = max_growth(change, mass_polynomials(change, least))
    for i in range(len(ratios)):
        out[i + 1] = growth(change, mass_matrix(change, ratios[i], 1.0), 1.0)
    out[len(ratios) + 1] = growth(change, mass_matrix(change, 1.0, 0.0), 0.0)


@settings(max_examples=300, deadline=None)
@given(
    rank=st.sampled_from([1, 2, 3]),
    seed=st.integers(0, 2**32 - 1),
    spread=st.sampled_from([0.0, 1.0, 4.0]),
    least=st.sampled_from([0.0, 1e-3, 0.1, 2.0]),
    accelerations=st.sampled_from(["none", "one way", "either way"]),
)
def test_growth_is_bounded_for_every_line_of_the_drives(
    rank: int,
    seed: int,
    spread: float,
    least: float,
    accelerations: str,
) -> None:
    random = np.random.default_rng(seed)
    axes = np.linalg.qr(random.standard_normal((3, 3)))[0][:, :rank]
    matrix = axes @ np.diag(10.0 ** random.uniform(-spread, spread, rank)) @ axes.T
    direction = axes @ random.standard_normal(rank)
    record = np.zeros(1, MOBILITY)
    record["direction"], record["matrix"] = direction / np.linalg.norm(direction), matrix[UPPER]
    if accelerations != "none":
        record["free"], record["held"] = random.standard_normal((2, 3)) @ axes @ axes.T
    record["powers"] = axes @ random.standard_normal((rank, rank)) @ axes.T
    record["speed"], record["change_rank"] = random.uniform(0.01, 1.0), rank
    record["either_way"] = accelerations == "either way"
    out = np.empty(42)
    growths(record.view(np.uint8), least, least + np.concatenate(([0.0], np.geomspace(1e-6, 1e6, 39))), out)
    assert out[0] >= out[1:].max() * (1.0 - 1e-9)
    if rank == 1:  # one direction has one growth
        np.testing.assert_allclose(out[0], out[1:-1].max(), rtol=1e-9)


@pytest.mark.parametrize("field", ["free", "held", "powers", "matrix"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_growth_of_what_is_not_finite_has_no_bound(field: str, value: float) -> None:
    record = np.zeros(1, MOBILITY)
    record["direction"], record["matrix"], record["powers"] = (0.6, 0.8, 0.0), np.eye(3)[UPPER], -np.eye(3)
    record["speed"], record["change_rank"] = 0.1, 3
    record[field][0].flat[0] = value if field != "powers" else -value
    out = np.empty(3)
    with np.errstate(all="ignore"):  # as compiled
        growths(record.view(np.uint8), 0.1, np.array([0.1]), out)
    assert out[0] == np.inf

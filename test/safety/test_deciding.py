# SPDX-License-Identifier: Apache-2.0
"""The contact that decides at many joint states is the worst one of each decision."""

from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.safety import unknown_contact
from scara_effmass.values import Verdict
from test.decisions import assessments_of, decision_on

SPEEDS = st.sampled_from([0.0, 0.1, 0.2, 0.4])
ROWS = st.lists(st.lists(st.tuples(st.booleans(), SPEEDS, SPEEDS), min_size=3, max_size=3), min_size=1, max_size=8)


@given(ROWS)
def test_deciding_contact_is_the_worst_of_ok_and_unknown_ones(rows: list[list[tuple[bool, float, float]]]) -> None:
    decisions = [
        decision_on(
            *(
                unknown_contact(f"point {number}", "")._replace(
                    verdict=Verdict.OK if is_known else Verdict.UNKNOWN,
                    speed=speed,
                    allowable_speed=allowed,
                    margin=allowed - speed,
                )
                for number, (is_known, speed, allowed) in enumerate(row)
            )
        )
        for row in rows
    ]
    expected = [decision.contacts.index(decision.worst) for decision in decisions]
    assert assessments_of(*decisions).deciding().tolist() == expected

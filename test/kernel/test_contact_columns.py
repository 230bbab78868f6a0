# SPDX-License-Identifier: Apache-2.0
"""Columns of many joint states hold what the assessments of single ones do."""

import numpy as np
import pytest
from scara_effmass.kernel.contact_columns import LABELS, NUMBERS
from scara_effmass.safety.contact_assessor import ContactAssessor

from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import FloatArray, Verdict

STATES = 60


def motions(assessor: ContactAssessor) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return STATES positions, velocities and tolerances, each sixth state at rest."""
    q = assessor.dynamics.robot.sample_configurations(STATES)
    rng = np.random.default_rng(5)
    qd = rng.uniform(0.0, 3.0, (STATES, 1)) * rng.uniform(-1.0, 1.0, q.shape)
    qd[::6] = 0.0
    return q, qd, rng.uniform(0.0, 0.01, q.shape)


def test_columns_are_those_of_single_states() -> None:
    settings = MonitorSettings(contact_points=("tool", "elbow"), test_direction=(0.0, 0.0, 1.0))
    assessor = ContactAssessor(RobotDynamics(load_robot(settings=settings)), settings)
    q, qd, tolerance = motions(assessor)
    columns = assessor.compute(q, qd, tolerance)
    assert [points.contact_point for points in columns] == ["tool", "elbow"]
    verdicts = set()
    for i in range(STATES):
        for points, contact in zip(columns, assessor.assess(q[i], qd[i], tolerance[i].tolist()), strict=True):
            verdicts.add(contact.verdict)
            assert points.contact_normal == contact.contact_normal
            assert points.reasons([i]) == [contact.reason]
            for name in NUMBERS:
                np.testing.assert_allclose(getattr(points, name)[i], getattr(contact, name), rtol=1e-10, atol=1e-10)
            for label, texts in LABELS.items():
                assert getattr(points, texts)[getattr(points, label)[i]] == getattr(contact, label)
    assert verdicts == {Verdict.OK, Verdict.WARN, Verdict.VIOLATION}


@pytest.mark.parametrize("count", [0, 1])
def test_few_states_have_the_same_shapes_and_types(count: int) -> None:
    settings = MonitorSettings(contact_points=("tool",))
    assessor = ContactAssessor(RobotDynamics(load_robot(settings=settings)), settings)
    (columns,) = assessor.compute(*(values[:count] for values in motions(assessor)))
    assert columns.lumped_mobility.shape == (count, 6)
    assert columns.direction.shape == (count, 3)
    assert columns.speed.shape == columns.mass_model.shape == columns.verdict.shape == (count,)
    assert [str(values.dtype) for values in (columns.verdict, columns.mass_capped, columns.body_region)] == [
        "int8",
        "bool",
        "int16",
    ]

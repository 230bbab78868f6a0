# SPDX-License-Identifier: Apache-2.0
"""A monitor with the compiled kernel decides as one without, and stops using a kernel that disagrees."""

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scara_effmass.kernel import jit
from scara_effmass.kernel.contact_kernel import ContactKernel, SingleState
from scara_effmass.kernel.records import OFFSETS
from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor, contact_assessor
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import Decision, FloatArray, JointState, Payload, Verdict

ROBOTS = Path(__file__).resolve().parents[2] / "config" / "robots"
TOLERANCE = 1e-10
STEP_NS = 10_000_000
INTERVAL = 150
POINTS = ("tool", "elbow", "rim=link4: 0.05 0 0")


def new_monitor(robot: Path | None = None, *, kernel: bool, **values: object) -> Monitor:
    settings = MonitorSettings.model_validate(values)
    monitor = Monitor(RobotDynamics(load_robot(robot, settings)), settings)
    if kernel:
        assert monitor.assessor.load_kernel() == ""
    return monitor


def lacks_kernel(monitor: Monitor) -> bool:
    return monitor.lacks_kernel


def motion(monitor: Monitor, count: int) -> Iterator[JointState]:
    """Yield joint states of a motion from rest to above the limits; every 97th repeats its stamp, one of 89 is late."""
    robot = monitor.dynamics.robot
    centre = robot.sample_configurations(1)[0]
    phases = np.linspace(0.3, 1.0, len(centre))
    stamp_ns = 1_000_000_000
    for i in range(count):
        stamp_ns += STEP_NS * (i % 97 != 96) * (30 if i % 89 == 88 else 1)
        amplitude, rate = 0.1, 2.0 * math.pi * (i // 200)
        angle = rate * phases * stamp_ns / 1e9
        yield JointState(
            stamp_ns, robot.joint_names, centre + amplitude * np.sin(angle), amplitude * rate * phases * np.cos(angle)
        )


def is_close(value: Any, expected: Any) -> bool:  # noqa: ANN401 - any field
    if isinstance(value, tuple):
        return all(map(is_close, value, expected))
    if isinstance(value, str | bool | Verdict):
        return False
    return repr(value) == repr(expected) or math.isclose(value, expected, rel_tol=TOLERANCE, abs_tol=TOLERANCE)


def assert_equal(decision: Decision, expected: Decision) -> None:
    assert len(decision.contacts) == len(expected.contacts)
    for contact, wanted in zip(decision.contacts, expected.contacts, strict=True):
        for name, value in contact._asdict().items():
            of_reference = getattr(wanted, name)
            assert type(value) is type(of_reference), name
            assert value == of_reference or is_close(value, of_reference), name
    assert is_close(decision.speed_scaling, expected.speed_scaling)


@pytest.mark.parametrize(
    ("robot", "values"),
    [
        (None, {"contact_points": POINTS, "test_direction": (0.0, 1.0, 1.0)}),
        (None, {"contact_points": POINTS, "effective_mass_model": "lumped", "contact_normal": "0 1 1"}),
        (None, {"velocity_source": "from_positions", "velocity_window": 0.05}),
        (ROBOTS / "ur5_robot.urdf", {"contact_points": ("forearm_link", "wrist_3_link")}),
        (ROBOTS / "panda.urdf", {"effective_mass_model": "full", "body_regions": ("hand_fingers", "chest")}),
    ],
)
def test_monitor_with_kernel_decides_as_one_without(robot: Path | None, values: dict[str, Any]) -> None:
    with_kernel, without = (new_monitor(robot, kernel=kernel, **values) for kernel in (True, False))
    verdicts = set()
    for state in motion(with_kernel, 900):
        decision, expected = (monitor.assess(state, state.stamp_ns) for monitor in (with_kernel, without))
        assert decision is not None
        assert expected is not None
        assert_equal(decision, expected)
        verdicts |= {contact.verdict for contact in decision.contacts}
    assert {Verdict.UNKNOWN, Verdict.VIOLATION} <= verdicts
    assert with_kernel.verdicts == without.verdicts
    assert with_kernel.first_cause == without.first_cause
    assert with_kernel.core == "compiled kernel"
    assert without.core == "Pinocchio: the kernel is not loaded"


def test_changed_settings_and_payloads_need_a_kernel_of_their_own() -> None:
    monitor = new_monitor(kernel=True, payload_topic="payload")
    assert not lacks_kernel(monitor)
    monitor.take_payload(Payload(1.0, (0.0, 0.0, 0.0), (0.0,) * 6))
    assert lacks_kernel(monitor)
    monitor.assessor = monitor.assessor.copy()
    assert lacks_kernel(monitor)
    assert monitor.assessor.load_kernel() == ""
    monitor.apply(monitor.settings.model_copy(update={"warn_ratio": 0.5}))
    assert lacks_kernel(monitor)


def test_monitor_without_numba_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jit, "WHY_NOT", "numba is not installed")
    monitor = new_monitor(kernel=False)
    assert lacks_kernel(monitor)
    monitor.assessor.load_kernel()
    assert not lacks_kernel(monitor)
    assert monitor.core == "Pinocchio: numba is not installed"


def test_kernel_that_cannot_be_compiled_leaves_the_reference(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_: ContactKernel) -> SingleState:
        raise OSError("the cache is damaged")

    monkeypatch.setattr(ContactKernel, "single_state", fail)
    monitor = new_monitor(kernel=False)
    assert monitor.assessor.load_kernel() == "the kernel cannot be loaded: OSError('the cache is damaged')"
    assert monitor.core.startswith("Pinocchio: the kernel cannot be loaded")


@pytest.mark.parametrize("field", ["remark", "criterion"])
def test_kernel_with_a_wrong_text_is_not_used(monkeypatch: pytest.MonkeyPatch, field: str) -> None:
    correct = ContactKernel.columns

    def wrong(kernel: ContactKernel, *states: FloatArray) -> FloatArray:
        columns = correct(kernel, *states)
        of_field = columns[OFFSETS[field]]
        of_field[of_field > 0.0] = 3.0 - of_field[of_field > 0.0]
        return columns

    monkeypatch.setattr(ContactKernel, "columns", wrong)
    monitor = new_monitor(kernel=False, body_regions=("chest",))
    assert monitor.assessor.load_kernel() == "the compiled kernel disagrees with Pinocchio in what limits the speed"


@pytest.mark.parametrize(
    ("field", "change"),
    [
        ("allowable_speed", lambda value: value * (1.0 + 1e-6)),
        ("full_mass", lambda _: math.nan),
        ("verdict", lambda value: 3.0 if value == 1.0 else 1.0),
        ("body_region", lambda value: value - 1.0),
    ],
)
@pytest.mark.parametrize("correct", [0, 7])
def test_wrong_record_of_the_kernel_gives_unknown_and_is_the_last(
    monkeypatch: pytest.MonkeyPatch, field: str, change: Callable[[float], float], correct: int
) -> None:
    """A kernel that goes wrong, at once or later, is found out within CHECK_INTERVAL joint states."""
    single_state, runs = ContactKernel.single_state, 0

    def wrong(kernel: ContactKernel) -> SingleState:
        memory = single_state(kernel)
        numbers = memory.rows.cast("d")

        def run() -> None:
            nonlocal runs
            memory.run()
            runs += 1
            if runs > correct:
                numbers[OFFSETS[field]] = change(numbers[OFFSETS[field]])

        return memory._replace(run=run)

    monkeypatch.setattr(ContactKernel, "single_state", wrong)
    monkeypatch.setattr(contact_assessor, "CHECK_INTERVAL", INTERVAL)
    monitor, reference = new_monitor(kernel=True), new_monitor(kernel=False)
    faults: list[int] = []
    for count, state in enumerate(motion(monitor, 2 * INTERVAL)):
        decision, expected = monitor.assess(state, state.stamp_ns), reference.assess(state, state.stamp_ns)
        assert decision is not None
        assert expected is not None
        if monitor.kernel_fault and not faults:
            faults.append(count)
            runs_at_fault = runs
            reason = f"the compiled kernel disagrees with Pinocchio in {field}"
            assert monitor.kernel_fault == reason
            assert {(c.verdict, c.reason, c.allowable_speed) for c in decision.contacts} == {
                (Verdict.UNKNOWN, reason, 0.0)
            }
            assert not lacks_kernel(monitor)
            assert monitor.core == f"Pinocchio: {reason}"
        elif faults and count > faults[0] + 60:  # the UNKNOWN is released
            assert_equal(decision, expected)
    assert faults
    assert runs == runs_at_fault <= INTERVAL + 1
    monitor.apply(monitor.settings)
    assert not lacks_kernel(monitor)

# SPDX-License-Identifier: Apache-2.0
"""A monitor with the compiled kernel decides as one with the reference, and stops using a kernel that disagrees."""

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scara_effmass.codes import Reason
from scara_effmass.errors import KernelError
from scara_effmass.kernel import compiled
from scara_effmass.kernel.admission import admit
from scara_effmass.kernel.contact_kernel import ContactKernel
from scara_effmass.kernel.records import CONTACT, ByteArray
from scara_effmass.kernel.settle import settle
from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.safety import monitor as monitor_module
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import Decision, FloatArray, JointState, Verdict

ROBOTS = Path(__file__).resolve().parents[2] / "config" / "robots"
TOLERANCE = 1e-10
STEP_NS = 10_000_000
INTERVAL = 50
POINTS = ("tool", "elbow", "rim=link4: 0.05 0 0")


def new_monitor(robot: Path | None = None, *, use_reference: bool = False, **values: object) -> Monitor:
    settings = MonitorSettings.model_validate(values)
    return Monitor(RobotDynamics(load_robot(robot, settings)), settings, use_reference=use_reference)


def motion(monitor: Monitor, count: int, steps: int = 200) -> Iterator[JointState]:
    """Yield joint states of a motion from rest to above the limits; every 97th repeats its stamp, one of 89 is late.

    It gets faster every `steps` joint states.
    """
    robot = monitor.dynamics.robot
    centre = robot.sample_configurations(1)[0]
    phases = np.linspace(0.3, 1.0, len(centre))
    stamp_ns = 1_000_000_000
    for i in range(count):
        stamp_ns += STEP_NS * (i % 97 != 96) * (30 if i % 89 == 88 else 1)
        amplitude, rate = 0.1, 2.0 * math.pi * (i // steps)
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
        (None, {"contact_points": POINTS, "velocity_source": "from_positions", "velocity_window": 0.05}),
        (ROBOTS / "ur5_robot.urdf", {"contact_points": ("forearm_link", "wrist_3_link")}),
        (ROBOTS / "panda.urdf", {"effective_mass_model": "full", "body_regions": ("hand_fingers", "chest")}),
    ],
)
def test_monitor_with_kernel_decides_as_one_with_the_reference(robot: Path | None, values: dict[str, Any]) -> None:
    with_kernel, without = (new_monitor(robot, use_reference=reference, **values) for reference in (False, True))
    verdicts = set()
    for state in motion(with_kernel, 300, steps=60):
        decision, expected = (monitor.assess(state, state.stamp_ns) for monitor in (with_kernel, without))
        assert decision is not None
        assert expected is not None
        assert_equal(decision, expected)
        verdicts |= {contact.verdict for contact in decision.contacts}
    assert {Verdict.UNKNOWN, Verdict.VIOLATION} <= verdicts
    assert with_kernel.verdicts == without.verdicts
    assert with_kernel.first_cause == without.first_cause
    assert with_kernel.kernel_fault == without.kernel_fault == ""
    assert with_kernel.core == "compiled kernel"
    assert without.core == "reference: use_reference"


def test_monitor_without_numba_says_so_unless_told_to_use_the_reference(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled, "why_not", lambda: "the kernel cannot be compiled: no module")
    with pytest.raises(KernelError, match=r"cannot be compiled: no module: .* set use_reference"):
        new_monitor()
    monitor = new_monitor(use_reference=True, contact_points=POINTS)
    monitor.compile()
    assert monitor.core == "reference: use_reference"


def test_compiling_leaves_no_trace() -> None:
    compiled, fresh = new_monitor(latch=True), new_monitor(latch=True)
    compiled.compile()
    assert (compiled.core, compiled.kernel_fault) == ("compiled kernel", "")
    for state in motion(compiled, 250):
        decision, expected = (monitor.assess(state, state.stamp_ns) for monitor in (compiled, fresh))
        assert repr(decision) == repr(expected)
    assert compiled.verdicts == fresh.verdicts
    assert compiled.rejected == fresh.rejected


@pytest.mark.parametrize("step", [admit, ContactKernel, settle])
def test_kernel_that_cannot_be_compiled_says_why(monkeypatch: pytest.MonkeyPatch, step: object) -> None:
    def fail(*_: object) -> None:
        raise OSError("the cache is damaged")

    monitor = new_monitor()
    monkeypatch.setattr(step, "bind", fail)
    with pytest.raises(KernelError, match=r"does not run: OSError\('the cache is damaged'\): set use_reference"):
        monitor.compile()


def spoil(
    monkeypatch: pytest.MonkeyPatch,
    field: str,
    change: Callable[[float], float],
    correct: int = 0,
    contacts: slice = slice(None),
) -> list[int]:
    """Let the kernel compute `field` of `contacts` wrongly after `correct` runs; return the list of its runs."""
    bind = ContactKernel.bind
    runs: list[int] = []

    def bind_wrong(
        kernel: ContactKernel, states: ByteArray, motions: FloatArray, numbers: FloatArray
    ) -> Callable[[], None]:
        compute = bind(kernel, states, motions, numbers)

        def wrong() -> None:
            compute()
            runs.append(len(runs))
            if len(runs) > correct:
                for contact in numbers.view(CONTACT)[:, contacts].ravel():
                    contact[field] = change(contact[field])

        return wrong

    monkeypatch.setattr(ContactKernel, "bind", bind_wrong)
    return runs


@pytest.mark.parametrize("wrong", range(len(POINTS)))
def test_contacts_are_compared_by_turns(monkeypatch: pytest.MonkeyPatch, wrong: int) -> None:
    """So that no callback waits for the reference of them all."""
    monkeypatch.setattr(monitor_module, "CHECK_INTERVAL", INTERVAL)
    runs = spoil(monkeypatch, "allowable_speed", lambda value: value + 1e-6, contacts=slice(wrong, wrong + 1))
    monitor = new_monitor(drives="free", contact_points=POINTS)
    for state in motion(monitor, (wrong + 1) * INTERVAL, steps=1000):
        monitor.assess(state, state.stamp_ns)
        if monitor.kernel_fault:
            break
    assert "allowable_speed" in monitor.kernel_fault
    assert len(runs) <= (wrong + 1) * INTERVAL


@pytest.mark.parametrize(
    ("field", "change"),
    [
        ("allowable_speed", lambda value: value * 1.001),
        ("criterion", lambda value: 3.0 - value),
        ("speed", lambda value: value * 1.001),  # correct at rest
    ],
)
def test_kernel_that_disagrees_when_compiled_is_not_used(
    monkeypatch: pytest.MonkeyPatch, field: str, change: Callable[[float], float]
) -> None:
    runs = spoil(monkeypatch, field, change)
    monitor, reference = new_monitor(body_regions=("chest",)), new_monitor(body_regions=("chest",), use_reference=True)
    monitor.compile()
    assert monitor.kernel_fault == f"the compiled kernel disagrees with the reference in {field}"
    assert monitor.core == f"reference: {monitor.kernel_fault}"
    for state in motion(monitor, 5):
        decision, expected = (one.assess(state, state.stamp_ns) for one in (monitor, reference))
        assert repr(decision) == repr(expected)
    assert len(runs) == 1


@pytest.mark.parametrize(
    ("field", "change"),
    [
        ("allowable_speed", lambda value: value * (1.0 + 1e-6)),
        ("full_mass", lambda _: math.nan),
        ("force_bound", lambda value: 0.5 * value),
        ("verdict", lambda value: 3.0 if value == 1.0 else 1.0),
        ("body_region", lambda value: value - 1.0),
    ],
)
@pytest.mark.parametrize("correct", [0, 7])
def test_wrong_record_of_the_kernel_gives_unknown_and_is_the_last(
    monkeypatch: pytest.MonkeyPatch, field: str, change: Callable[[float], float], correct: int
) -> None:
    """A kernel that goes wrong, at once or later, is found out within CHECK_INTERVAL joint states."""
    monkeypatch.setattr(monitor_module, "CHECK_INTERVAL", INTERVAL)
    # With a servo the two are compared less closely.
    values: dict[str, Any] = {"drives": "free", "contact_points": POINTS}
    runs = spoil(monkeypatch, field, change, correct)
    monitor, reference = new_monitor(**values), new_monitor(use_reference=True, **values)
    faults: list[int] = []
    for count, state in enumerate(motion(monitor, 3 * INTERVAL, steps=2 * INTERVAL)):
        decision, expected = monitor.assess(state, state.stamp_ns), reference.assess(state, state.stamp_ns)
        assert decision is not None
        assert expected is not None
        if monitor.kernel_fault and not faults:
            faults.append(count)
            reason = f"the compiled kernel disagrees with the reference in {field}"
            assert monitor.kernel_fault == reason
            assert decision.reason_code is Reason.KERNEL_DISAGREES
            assert {(c.verdict, c.reason, c.allowable_speed) for c in decision.contacts} == {
                (Verdict.UNKNOWN, reason, 0.0)
            }
            assert monitor.core == f"reference: {reason}"
        elif faults and count > faults[0] + 60:  # the UNKNOWN is released
            assert_equal(decision, expected)
    assert len(faults) == 1
    assert len(runs) == faults[0] + 1 <= INTERVAL + 1
    monitor.apply(monitor.settings)
    assert monitor.core.startswith("reference: the compiled kernel disagrees")

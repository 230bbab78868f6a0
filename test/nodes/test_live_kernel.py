# SPDX-License-Identifier: Apache-2.0
"""The live monitor loads the compiled kernel while it works, changes over, and says what computes."""

import signal
from collections.abc import Callable

import pytest
from scara_effmass_msgs.msg import ContactState

from test.nodes.conftest import TIMEOUT_S, NodeHarness, joint_state

KERNEL = "compiled kernel"


def test_monitor_changes_over_to_the_kernel_and_to_that_of_changed_settings(
    new_harness: Callable[[], NodeHarness],
) -> None:
    harness = new_harness()
    harness.start("--ros-args", "-p", "release_time:=0.0", "-p", "timeout:=60.0", kernel=True)
    harness.subscribe_until_ok()
    before = harness.response_to(joint_state())
    assert before.verdict == ContactState.OK
    harness.diagnostic("model", "core", KERNEL.__eq__)
    after = harness.response_to(joint_state())
    assert (after.verdict, after.reason) == (ContactState.OK, "")
    assert after.effective_mass == pytest.approx(before.effective_mass, rel=1e-10)
    assert harness.set_parameters(max_force=100.0) == ""
    harness.diagnostic("model", "core", KERNEL.__eq__)
    assert harness.response_to(joint_state()).allowable_speed < after.allowable_speed
    assert "Pinocchio" not in harness.diagnostic("model", "core", bool)


def test_monitor_without_numba_says_why(harness: NodeHarness) -> None:
    assert "| Pinocchio: NUMBA_DISABLE_JIT is set" in harness.diagnostic("model", "core", bool)


def test_monitor_ends_while_it_loads_the_kernel(new_harness: Callable[[], NodeHarness]) -> None:
    harness = new_harness()
    process = harness.start(kernel=True)
    harness.subscribe()
    harness.spin_until(lambda: harness.contact_states)
    harness.process_may_end = True
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=TIMEOUT_S)
    assert (process.returncode, "Traceback" in errors) == (0, False)
    assert harness.spin_until(lambda: harness.contact_states[-1].reason == "the node shuts down")

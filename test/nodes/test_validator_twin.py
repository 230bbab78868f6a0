# SPDX-License-Identifier: Apache-2.0
"""Compare a recorded impact replayed to the three live nodes with `validate` offline, bit for bit."""

import subprocess
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from scara_effmass_msgs.msg import ForceBlock, ImpactValidation

from scara_effmass.analysis.validation import ValidationSettings, validate
from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.settings import MonitorSettings
from scara_effmass.share import share
from test.forked import Forked
from test.nodes.conftest import NodeHarness, node_environment, stamp_ns

BIN = Path(sys.executable).parent
BAG = share("bags", "campaign", "300_0_2390g_1")
SIM_TIME = ["--ros-args", "-p", "use_sim_time:=true"]
# The machine may be busy.
TIMEOUT = ["-p", "timeout:=10.0"]
CLOCK_TOLERANCE = ["-p", "clock_tolerance:=60.0"]
# The recorded force is already tared; a second tare would shift it by a fraction of the noise.
FORCE = ["-p", "source:=bag", "-p", f"bag.path:={BAG}", "-p", "tare.at_start:=false"]


def test_live_validation_equals_offline_validation(new_harness: Callable[..., NodeHarness], tmp_path: Path) -> None:
    harness = new_harness(name="validator")
    validations: list[ImpactValidation] = []
    node = harness.node
    node.create_subscription(ImpactValidation, "impact_validation", validations.append, 100)
    node.create_subscription(ForceBlock, "force", lambda _: None, 100)
    harness.subscribe()
    # Pinocchio on both sides: the kernel differs in the last digits.
    environment = node_environment(harness.domain, tmp_path)
    commands = (
        [str(BIN / "monitor_node"), *SIM_TIME, *TIMEOUT],
        [str(BIN / "daq_node"), *SIM_TIME, *FORCE],
        [str(BIN / "validator_node"), *SIM_TIME, *CLOCK_TOLERANCE],
    )
    with ExitStack() as running:
        for command in commands:
            process = running.enter_context(Forked(command, env=environment, stderr=subprocess.DEVNULL))
            running.callback(process.terminate)
        for status, key in (
            ("monitor: input", "received"),
            ("daq: source", "state"),
            ("validator: series", "accepted"),
        ):
            harness.diagnostic(status, key, bool)  # the node is active
        topics = ["/joint_states", "/run_info"]
        command = [str(BIN / "scara-effmass"), "replay", str(BAG), "--topics", *topics]
        replay = running.enter_context(Forked(command, env=environment, stdout=subprocess.DEVNULL))
        harness.spin_until(lambda: validations)
        assert replay.wait() == 0
    dynamics = RobotDynamics(load_robot(share("config", "omron_i4_550l.yaml"), MonitorSettings()))
    (expected,) = validate([BAG], dynamics, ValidationSettings()).result.impacts
    (message,) = validations
    assert stamp_ns(message) == expected.stamp_ns
    names = (
        "measured_force",
        "predicted_force",
        "speed",
        "effective_mass",
        "reduced_mass",
        "stiffness",
        "conservative",
    )
    assert {name: getattr(message, name) for name in names} == {name: getattr(expected, name) for name in names}

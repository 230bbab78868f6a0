"""The live nodes load no library for bag files."""

import subprocess
import sys

import pytest

SCRIPT = "import sys, {module}; print(*sorted({{'mcap', 'rosbags'}} & set(sys.modules)))"


@pytest.mark.live
@pytest.mark.parametrize("node", ["monitor_node", "validator_node"])
def test_node_does_not_load_bag_libraries(node: str) -> None:
    script = SCRIPT.format(module=f"scara_effmass.nodes.{node}")
    result = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True)
    assert result.stdout.split() == []

# SPDX-License-Identifier: Apache-2.0
"""The public names of the package, and the example in the README."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import scara_effmass

README = Path(__file__).parents[1] / "README.md"


def test_readme_example_prints_verdict_mass_and_allowable_speed(capsys: pytest.CaptureFixture[str]) -> None:
    example = re.search(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    assert example is not None
    exec(compile(example[1], str(README), "exec"), {})  # noqa: S102 - written by the project
    assert capsys.readouterr().out == (
        "OK 1.12 kg 0.536 m/s\nWARN 3.22 kg 0.159 m/s\n"  # tool, elbow
        "WARN 1.90 kg 0.190 m/s\nVIOLATION 0.62 kg 0.370 m/s\nOK 0.95 kg 0.464 m/s\nOK 0.86 kg 0.607 m/s\n"
    )


def test_a_robot_is_loaded_by_the_name_of_its_file() -> None:
    assert scara_effmass.load_robot(str(README.parent / "config/robots/ur5_robot.urdf")).name == "ur5"


@pytest.mark.live
def test_public_names_are_documented() -> None:
    code = "import scara_effmass as s; print([name for name in s.__all__ if not getattr(s, name).__doc__])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True).stdout == "[]\n"


def test_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="nonsense"):
        _ = scara_effmass.nonsense


@pytest.mark.live
def test_import_alone_loads_no_room() -> None:
    code = "import sys, scara_effmass; print([name for name in sys.modules if name.startswith('scara_effmass.')])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True).stdout == "[]\n"

# SPDX-License-Identifier: Apache-2.0
"""Set-up for colcon in ROS workspaces: version, description and executables, from package.xml and pyproject.toml.

Both files are found beside the real path of this one, because colcon may run it from a build folder of symlinks.
Everything else stands in setup.cfg.
"""
# colcon reads setup.cfg only if the text of this file contains the call `setup()` without arguments; keep it here.

import sys
from pathlib import Path
from xml.etree import ElementTree as ET

from setuptools import setup

try:
    import tomllib
except ModuleNotFoundError:  # Python 3.10
    import tomli as tomllib

try:
    from mypyc.build import mypycify
except ModuleNotFoundError:
    mypycify = None

HOT_PATH = (
    "scara_effmass/iso15066/mobility.py",
    "scara_effmass/iso15066/mobility_matrix.py",
    "scara_effmass/iso15066/pose_change.py",
    "scara_effmass/iso15066/speed_limit.py",
    "scara_effmass/model/dynamics.py",
    "scara_effmass/safety/contact_assessor.py",
    "scara_effmass/safety/debounce.py",
    "scara_effmass/safety/joint_state_validator.py",
    "scara_effmass/safety/monitor.py",
)
"""Modules that mypyc compiles where it is installed; uncompiled they do the same, more slowly."""
MYPY = ("--config-file=", "--ignore-missing-imports", "--follow-imports=silent")

root = Path(__file__).resolve().parent
manifest = ET.parse(root / "package.xml").getroot()
scripts = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]["scripts"]

# For cmake/compile.cmake alone, not for colcon, whose builds stay plain Python.
extensions = []
if mypycify and "build_ext" in sys.argv:
    extensions = mypycify([*MYPY, *HOT_PATH], group_name="scara_effmass", debug_level="0")

setup(
    version=manifest.findtext("version"),
    description=manifest.findtext("description"),
    ext_modules=extensions,
    entry_points={"console_scripts": [f"{name} = {target}" for name, target in scripts.items()]},
)

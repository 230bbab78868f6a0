# SPDX-License-Identifier: Apache-2.0
"""Set-up for colcon in ROS workspaces: version, description and executables, from package.xml and pyproject.toml.

Both files are found beside the real path of this one, because colcon may run it from a build folder of symlinks.
Everything else stands in setup.cfg.
"""
# colcon reads setup.cfg only if the text of this file contains the call `setup()` without arguments; keep it here.

from pathlib import Path
from xml.etree import ElementTree as ET

from setuptools import setup

try:
    import tomllib
except ModuleNotFoundError:  # Python 3.10
    import tomli as tomllib

root = Path(__file__).resolve().parent
manifest = ET.parse(root / "package.xml").getroot()
scripts = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]["scripts"]

setup(
    version=manifest.findtext("version"),
    description=manifest.findtext("description"),
    entry_points={"console_scripts": [f"{name} = {target}" for name, target in scripts.items()]},
)

"""For ROS workspaces: what setup.cfg does not hold because package.xml and pyproject.toml state it.

colcon runs this file in the build folder, where with symlinks neither of the two is; what is installed where it
reads from setup.cfg by itself, as for every setup.py that says `setup()`.
"""

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

"""Builds the package in a ROS workspace (colcon). What pip builds is described in pyproject.toml alone."""

from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

SHARE = "share/scara_effmass"

manifest = ElementTree.parse("package.xml").getroot()

setup(
    version=manifest.findtext("version"),
    description=manifest.findtext("description"),
    packages=find_packages(include=["scara_effmass", "scara_effmass.*"]),
    package_data={"scara_effmass": ["py.typed"]},
    zip_safe=False,
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/scara_effmass"]),
        (SHARE, ["package.xml"]),
        *(
            (f"{SHARE}/{folder}", sorted(str(path) for path in Path(folder).iterdir() if path.is_file()))
            for folder in ("bags", "config", "launch")
        ),
    ],
)

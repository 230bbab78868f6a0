# SPDX-License-Identifier: Apache-2.0
"""Names of message types, and their installed classes and definitions."""

import re
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

JOINT_STATE = "sensor_msgs/msg/JointState"
OWN_PACKAGE = "scara_effmass_msgs"
CONTACT_STATES = f"{OWN_PACKAGE}/msg/ContactStates"
FORMER_CONTACT_STATE = f"{OWN_PACKAGE}/msg/ContactState"
"""Type of a topic in recordings made before ContactStates, which now holds it."""
FORCE_BLOCK = f"{OWN_PACKAGE}/msg/ForceBlock"
IMPACT = f"{OWN_PACKAGE}/msg/Impact"
RUN_INFO = f"{OWN_PACKAGE}/msg/RunInfo"
FLOAT64 = "std_msgs/msg/Float64"
STRING = "std_msgs/msg/String"
HEADER = "std_msgs/msg/Header"
WRENCH = "geometry_msgs/msg/Wrench"
WRENCH_STAMPED = "geometry_msgs/msg/WrenchStamped"
INERTIA = "geometry_msgs/msg/Inertia"

_TYPE = re.compile(r"(?P<package>[a-z][a-z0-9_]*)/msg/(?P<name>[A-Z][A-Za-z0-9]*)")


def message_class(message_type: str) -> type | None:
    """Return the class of a type such as "std_msgs/msg/String"; None if it is not installed."""
    match = _TYPE.fullmatch(message_type)
    # A type name in a recording must never cause the import of a module that is not a message package.
    if match is None or not any((folder / "msg").is_dir() for folder in _package_folders(match["package"])):
        return None
    installed_class: type | None = getattr(import_module(f"{match['package']}.msg"), match["name"], None)
    return installed_class


def message_definition(message_type: str) -> str:
    """Return the text of the installed .msg file of a type; empty if there is none."""
    match = _TYPE.fullmatch(message_type)
    files = definition_files(match["package"]) if match else []
    return next((file.read_text(encoding="utf-8") for file in files if match and file.stem == match["name"]), "")


def former_contact_state() -> str:
    """Return the definition of FORMER_CONTACT_STATE."""
    return Path(__file__).with_name("former_contact_state.msg").read_text(encoding="utf-8")


def definition_files(package: str) -> list[Path]:
    """Return the installed .msg files of a package."""
    # <prefix>/lib/python3.x/site-packages/<package> and <prefix>/share/<package>, in ROS and in a virtual environment
    prefixes = (parent for folder in _package_folders(package) for parent in folder.parents)
    return next(filter(None, (sorted((prefix / "share" / package / "msg").glob("*.msg")) for prefix in prefixes)), [])


def _package_folders(package: str) -> list[Path]:
    spec = find_spec(package)
    return [Path(folder) for folder in (spec.submodule_search_locations or ())] if spec else []

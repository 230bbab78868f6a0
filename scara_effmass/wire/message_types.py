"""Message types as they are installed."""

from __future__ import annotations

import re
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

_TYPE = re.compile(r"(?P<package>[a-z][a-z0-9_]*)/msg/(?P<name>[A-Z][A-Za-z0-9]*)")


def message_class(kind: str) -> type | None:
    """Return the class of type `kind` such as "std_msgs/msg/String", None where it is not installed."""
    match = _TYPE.fullmatch(kind)
    # A recording must not make any module run that is no message package.
    if match is None or not any((folder / "msg").is_dir() for folder in _folders(match["package"])):
        return None
    found: type | None = getattr(import_module(f"{match['package']}.msg"), match["name"], None)
    return found


def message_text(kind: str) -> str:
    """Return the installed .msg file of type `kind`, empty where there is none."""
    match = _TYPE.fullmatch(kind)
    if match is None:
        return ""
    # <prefix>/lib/python3.x/site-packages/<package> and <prefix>/share/<package>, in ROS as in a virtual environment
    prefixes = (parent for folder in _folders(match["package"]) for parent in folder.parents)
    texts = (prefix / "share" / match["package"] / "msg" / f"{match['name']}.msg" for prefix in prefixes)
    found = next((text for text in texts if text.is_file()), None)
    return found.read_text(encoding="utf-8") if found else ""


def _folders(package: str) -> list[Path]:
    spec = find_spec(package)
    return [Path(folder) for folder in (spec.submodule_search_locations or ())] if spec else []

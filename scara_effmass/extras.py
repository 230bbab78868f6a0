# SPDX-License-Identifier: Apache-2.0
"""Libraries that only some commands need: the extra that contains each, and the line that installs it."""

EXTRAS = {
    "distributed": "cluster",
    "foxglove": "foxglove",
    "fsspec": "cluster",
    "jinja2": "reports",
    "lvm_read": "daq",
    "matplotlib": "reports",
    "mujoco": "sim",
    "nicegui": "dashboard",
    "nidaqmx": "daq",
    "nptdms": "daq",
}
"""Extra of pyproject.toml by importable name."""


def pip_line(library: str) -> str:
    """Return the command that installs the optional `library`."""
    return f"pip install 'scara_effmass[{EXTRAS[library]}]'"


def missing_extra(error: ImportError) -> str:
    """Return one line that names the library and its extra; empty if `error` is about no optional library."""
    library = (error.name or "").partition(".")[0]
    return f"{library}: must be installed: {pip_line(library)}" if library in EXTRAS else ""

# SPDX-License-Identifier: Apache-2.0
"""The modules that mypyc compiles: the same decisions as their sources, and never older than these."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from scara_effmass.share import share

FINDER = """
import sys
class Finder:
    dir = sys.argv[1]
    known_wheel_files = {"scara_effmass.a": "a.so", "scara_effmass.b": "b.so", "other.a": "a.so"}
    known_source_files = {name: sys.argv[1] + "/" + name[-1] + ".py" for name in known_wheel_files}
    find_spec = staticmethod(lambda *_: None)
sys.meta_path.append(Finder)
import scara_effmass
print(*Finder.known_wheel_files)
"""


def run(*command: str | Path, **variables: str) -> str:
    return subprocess.run(
        [sys.executable, *command], capture_output=True, check=True, text=True, env={**os.environ, **variables}
    ).stdout


@pytest.mark.live
def test_compiled_modules_decide_as_their_sources(tmp_path: Path) -> None:
    # After a change of a source both are the sources; `make setup` compiles them again.
    tables = []
    for sources in "01":
        for model, drives, contact in (("auto", "free", "transient"), ("largest", "servo", "quasi_static")):
            table, params = tmp_path / f"{model}{sources}.csv", tmp_path / "params.yaml"
            settings = (
                f"{{effective_mass_model: {model}, drives: {drives}, contact: {contact}, external_force_limit: 60.0}}"
            )
            params.write_text(f"monitor:\n  ros__parameters: {settings}\n", encoding="utf-8")
            command = (
                "-m",
                "scara_effmass",
                "assess",
                share("bags", "straight_300_200"),
                "-o",
                table,
                "--params",
                params,
            )
            run(*command, SCARA_EFFMASS_SOURCES=sources)
            tables.append(table.read_text(encoding="utf-8"))
    assert tables[:2] == tables[2:]
    assert len(tables[0].splitlines()) > 1000
    assert tables[0] != tables[1]


@pytest.mark.live
@pytest.mark.parametrize(
    ("newer", "asked", "used"),
    [("a.so", "0", ["scara_effmass.a", "scara_effmass.b"]), ("b.py", "0", []), ("a.so", "1", [])],
)
def test_a_newer_source_is_imported_in_place_of_all_compiled_modules(
    tmp_path: Path, newer: str, asked: str, used: list[str]
) -> None:
    for name in ("a.py", "a.so", "b.py", "b.so"):
        (tmp_path / name).touch()
        os.utime(tmp_path / name, ns=(0, 1000))
    os.utime(tmp_path / newer, ns=(0, 2000))
    modules = run("-c", FINDER, tmp_path, SCARA_EFFMASS_SOURCES=asked).split()
    assert modules == [*used, "other.a"]

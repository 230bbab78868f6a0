# SPDX-License-Identifier: Apache-2.0
"""Where compiled code is kept: folders that cannot be written, several processes at once, changed sources."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from scara_effmass.kernel import jit, records, state

CALL = (
    "import numpy as np\n"
    "from scara_effmass.kernel import jit, state\n"
    "from scara_effmass.kernel.admission import forget_all\n"
    "joints, memory = np.zeros(2, state.JOINT_MEMORY), np.ones(1, state.MEMORY)\n"
    "forget_all(memory.view(np.uint8), joints.view(np.uint8))\n"
    "assert memory['last_stamp_ns'][0] == 0 and joints['is_unconfirmed'].all()\n"
    "print(jit.CACHE, jit.WHY_NOT)\n"
)
"""Compile one small function, or load it, and print where it is kept."""


def start(code: str = CALL, **environment: str) -> subprocess.Popen[str]:
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("NUMBA_", "XDG_"))}
    return subprocess.Popen(
        [sys.executable, "-c", code],
        env=kept | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def output(process: subprocess.Popen[str]) -> str:
    out, error = process.communicate(timeout=120)
    assert process.returncode == 0, error
    return out.strip()


def folder(monkeypatch: pytest.MonkeyPatch, **environment: str) -> Path | None:
    for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    return jit.cache_folder()


def test_stated_folder_comes_first_then_the_cache_of_the_user(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    stated, user, home = (str(tmp_path / name) for name in ("stated", "user", "home"))
    found = [
        folder(monkeypatch, NUMBA_CACHE_DIR=stated, XDG_CACHE_HOME=user, HOME=home),
        folder(monkeypatch, XDG_CACHE_HOME=user, HOME=home),
        folder(monkeypatch, HOME=home),
    ]
    expected = [tmp_path / "stated", tmp_path / "user/scara_effmass", tmp_path / "home/.cache/scara_effmass"]
    assert [path and path.parent for path in found] == expected


def test_home_that_cannot_be_written_leaves_the_folder_of_the_sources(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "home").touch()  # root may write into any folder, but not below a file
    found = folder(monkeypatch, HOME=str(tmp_path / "home"))
    assert found is not None
    assert found.parent == Path(jit.__file__).parent / "__pycache__"
    monkeypatch.setattr(os, "access", lambda *_: False)
    assert jit.cache_folder() is None


def test_stated_folder_that_cannot_be_written_is_replaced_by_none(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Who states a folder does not want another one filled."""
    (tmp_path / "file").touch()
    assert folder(monkeypatch, NUMBA_CACHE_DIR=str(tmp_path / "file")) is None


def test_each_version_of_the_sources_has_a_folder_of_its_own(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Also of the other rooms and modules whose constants are compiled in."""
    package = Path(jit.__file__).parents[1]
    for room in ("kernel", "iso15066", "reference"):
        shutil.copytree(package / room, tmp_path / room)
    for module in ("codes.py", "values.py"):
        shutil.copy(package / module, tmp_path)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    original = jit.cache_folder()
    monkeypatch.setattr(jit, "__file__", str(tmp_path / "kernel" / "jit.py"))
    folders = [original, jit.cache_folder()]
    for changed in ("kernel/spatial.py", "iso15066/__init__.py", "reference/__init__.py", "codes.py", "values.py"):
        with (tmp_path / changed).open("a", encoding="utf-8") as source:
            source.write("\n")
        folders.append(jit.cache_folder())
    assert folders[0] == folders[1]
    for library in (np, jit.numba):
        monkeypatch.setattr(library, "__version__", "other", raising=False)
        folders.append(jit.cache_folder())
    assert len(set(folders)) == len(folders) - 1


def fields(dtype: np.dtype[Any]) -> Iterator[str]:
    """Yield the names of all fields, also of records within."""
    for name, (of_field, *_) in (dtype.fields or {}).items():
        yield name
        yield from fields(of_field.base)


@pytest.mark.parametrize("module", [records, state])
def test_no_field_of_a_record_has_the_name_of_a_method_of_numpy(module: ModuleType) -> None:
    """Plain functions would get the method: without numba the kernel runs as plain Python."""
    names = {name for value in vars(module).values() if isinstance(value, np.dtype) for name in fields(value)}
    assert names
    assert not names & set(dir(np.record))


@pytest.mark.live
def test_several_processes_fill_one_folder_at_once_and_later_ones_load_it(tmp_path: Path) -> None:
    processes = [start(NUMBA_CACHE_DIR=str(tmp_path)) for _ in range(2)]
    outputs = {output(process) for process in processes}
    (cache,) = tmp_path.glob("kernel-*")
    assert outputs == {str(cache)}
    kept = {path: path.stat().st_mtime_ns for path in cache.rglob("*.nb?")}
    assert kept
    assert output(start(NUMBA_CACHE_DIR=str(tmp_path))) == str(cache)
    assert {path: path.stat().st_mtime_ns for path in cache.rglob("*.nb?")} == kept


@pytest.mark.live
def test_installations_of_the_same_sources_share_what_was_compiled(tmp_path: Path) -> None:
    cache = Path(output(start(NUMBA_CACHE_DIR=str(tmp_path))))
    assert cache.parent == tmp_path
    kept = sorted(cache.rglob("*.nb?"))
    other = tmp_path / "other"
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(Path(jit.__file__).parents[1], other / "scara_effmass", ignore=ignored)
    # Without the finder of an editable installation, which comes before sys.path.
    finders = "[finder for finder in sys.meta_path if getattr(finder, '__module__', '').startswith('_frozen')]"
    path = f"import sys; sys.meta_path[:] = {finders}; sys.path.insert(0, {str(other)!r})\n"
    code = f"{path}{CALL}print(jit.__file__)"
    assert output(start(code, NUMBA_CACHE_DIR=str(tmp_path))).endswith(f"{other}/scara_effmass/kernel/jit.py")
    assert sorted(cache.rglob("*.nb?")) == kept


@pytest.mark.live
def test_without_a_folder_the_kernel_is_compiled_each_time(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    assert output(start(NUMBA_CACHE_DIR=str(tmp_path / "file"))) == "None"


@pytest.mark.live
def test_missing_or_damaged_numba_leaves_plain_functions_and_says_why(tmp_path: Path) -> None:
    (tmp_path / "numba.py").write_text("raise RuntimeError('damaged')\n", encoding="utf-8")
    paths = os.pathsep.join(filter(None, (str(tmp_path), os.environ.get("PYTHONPATH", ""))))
    assert output(start(PYTHONPATH=paths)) == "None numba cannot be imported: damaged"

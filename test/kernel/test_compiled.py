# SPDX-License-Identifier: Apache-2.0
"""Where compiled code is kept: folders that cannot be written, several processes at once, changed sources."""

from __future__ import annotations

import hashlib
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
from numpy.typing import NDArray

from scara_effmass.errors import KernelError
from scara_effmass.kernel import compiled, records, state
from scara_effmass.kernel.admission import forget_all

# Without the finder of an editable installation, which comes before sys.path.
FINDERS = "[finder for finder in sys.meta_path if getattr(finder, '__module__', '').startswith('_frozen')]"
CALL = (
    "import sys\n"
    f"sys.meta_path[:] = {FINDERS}\n"
    "import numpy as np\n"
    "from scara_effmass.kernel import compiled, state\n"
    "from scara_effmass.kernel.admission import forget_all\n"
    "joints, memory = np.zeros(2, state.JOINT_MEMORY), np.ones(1, state.MEMORY)\n"
    "forget_all(memory.view(np.uint8), joints.view(np.uint8))\n"
    "assert memory['last_stamp_ns'][0] == 0 and joints['is_unconfirmed'].all()\n"
    "print(compiled.why_not(), [name for name in ('numba', 'llvmlite') if name in sys.modules])\n"
)
"""Call one function of the kernel; print why it is not compiled, and what was loaded for that."""
PART = {"__init__", "compiled", "compiler", "admission", "records", "state"}
"""Modules of a kernel that is compiled in seconds."""
LOADED = "[]"
"""Output of CALL."""
IS_PLAIN = os.environ.get("NUMBA_DISABLE_JIT", "0") != "0"
"""Whether the coverage of the kernel is measured."""


def first(*paths: Path) -> str:
    """Return a PYTHONPATH that begins with `paths`."""
    return os.pathsep.join([*map(str, paths), os.environ.get("PYTHONPATH", "")])


def copy(folder: Path) -> Path:
    """Return `folder` with a copy of the package, of whose kernel it has a part."""
    ignored = shutil.ignore_patterns("__pycache__")
    package = shutil.copytree(Path(compiled.__file__).parents[1], folder / "scara_effmass", ignore=ignored)
    for module in (package / "kernel").glob("*.py"):
        if module.stem not in PART:
            module.unlink()
    return folder


def start(*paths: Path, before: str = "", **environment: str) -> subprocess.Popen[str]:
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("NUMBA_", "XDG_"))}
    return subprocess.Popen(
        [sys.executable, "-c", before + CALL],
        cwd=paths[-1],
        env=kept | environment | {"PYTHONPATH": first(*paths)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def output(process: subprocess.Popen[str]) -> str:
    out, error = process.communicate(timeout=120)
    assert process.returncode == 0, error
    return out.strip()


def folders(monkeypatch: pytest.MonkeyPatch, **environment: str) -> list[Path]:
    for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    return [folder.parent for folder in compiled.cache_folders()]


def test_stated_folder_is_the_only_one_else_the_cache_of_the_user_and_the_sources(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Who states a folder does not want another one filled."""
    stated, user, home = (str(tmp_path / name) for name in ("stated", "user", "home"))
    sources = Path(compiled.__file__).parent / "__pycache__"
    assert folders(monkeypatch, NUMBA_CACHE_DIR=stated, XDG_CACHE_HOME=user, HOME=home) == [tmp_path / "stated"]
    assert folders(monkeypatch, XDG_CACHE_HOME=user, HOME=home) == [tmp_path / "user/scara_effmass", sources]
    assert folders(monkeypatch, HOME=home) == [tmp_path / "home/.cache/scara_effmass", sources]
    assert folders(monkeypatch, XDG_CACHE_HOME="relative") == [sources]


def test_each_version_of_the_sources_has_a_folder_of_its_own(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Also of the other rooms and modules whose constants are compiled in."""
    package = Path(compiled.__file__).parents[1]
    for room in ("kernel", "iso15066", "reference"):
        shutil.copytree(package / room, tmp_path / room)
    for module in ("codes.py", "values.py"):
        shutil.copy(package / module, tmp_path)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    original = compiled.cache_folders()
    monkeypatch.setattr(compiled, "__file__", str(tmp_path / "kernel" / "compiled.py"))
    folders = [original, compiled.cache_folders()]
    for changed in ("kernel/spatial.py", "iso15066/__init__.py", "reference/__init__.py", "codes.py", "values.py"):
        with (tmp_path / changed).open("a", encoding="utf-8") as source:
            source.write("\n")
        folders.append(compiled.cache_folders())
    assert folders[0] == folders[1]
    monkeypatch.setattr(compiled, "_processor", lambda: ["other"])
    folders.append(compiled.cache_folders())
    monkeypatch.setattr(np, "__version__", "other")
    folders.append(compiled.cache_folders())
    assert len({str(found) for found in folders}) == len(folders) - 1


def fields(dtype: np.dtype[Any]) -> Iterator[str]:
    """Yield the names of all fields, also of records within."""
    for name, (of_field, *_) in (dtype.fields or {}).items():
        yield name
        yield from fields(of_field.base)


@pytest.mark.parametrize("module", [records, state])
def test_no_field_of_a_record_has_the_name_of_a_method_of_numpy(module: ModuleType) -> None:
    """Plain functions would get the method: without a library the kernel runs as plain Python."""
    names = {name for value in vars(module).values() if isinstance(value, np.dtype) for name in fields(value)}
    assert names
    assert not names & set(dir(np.record))


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return copy(tmp_path_factory.mktemp("package"))


@pytest.fixture(scope="module")
def cache(package: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a cache that two processes filled at once."""
    cache = tmp_path_factory.mktemp("cache")
    processes = [start(package, NUMBA_CACHE_DIR=str(cache)) for _ in range(2)]
    assert [output(process) for process in processes] == [LOADED, LOADED]
    return cache


@pytest.fixture
def damaged(tmp_path: Path) -> Path:
    """Return a folder with a numba that cannot be imported."""
    (tmp_path / "numba.py").write_text("raise RuntimeError('damaged')\n", encoding="utf-8")
    return tmp_path


def library_in(cache: Path) -> Path:
    (library,) = cache.rglob(compiled.FILE)
    return library


@pytest.mark.live
def test_library_is_compiled_once_for_all_installations_of_the_same_sources(
    cache: Path, package: Path, tmp_path: Path, damaged: Path
) -> None:
    kept = library_in(cache).stat().st_mtime_ns
    for installation in (package, copy(tmp_path / "other")):
        assert output(start(damaged, installation, NUMBA_CACHE_DIR=str(cache))) == LOADED
    assert library_in(cache).stat().st_mtime_ns == kept


@pytest.mark.live
@pytest.mark.parametrize("before", ["import os; del os.memfd_create\n", "import os; os.memfd_create = os.listdir\n"])
def test_library_is_loaded_where_no_file_can_be_made_in_memory(cache: Path, package: Path, before: str) -> None:
    """As in the Pythons of conda, or forbidden by the system: then it is an OSError."""
    assert output(start(package, before=before, NUMBA_CACHE_DIR=str(cache))) == LOADED


def with_hash(content: bytes) -> bytes:
    return hashlib.sha256(content).digest() + content


OTHER_SYSTEM = with_hash(b"\x7fELF".ljust(16) + b"\x03".ljust(64))


@pytest.mark.live
@pytest.mark.parametrize("content", [b"", b"x" * 40, OTHER_SYSTEM], ids=["empty", "damaged", "of another system"])
def test_library_that_cannot_be_loaded_is_compiled_again(
    cache: Path, package: Path, damaged: Path, content: bytes
) -> None:
    """As after a loss of power, or in a home of several systems. numba is damaged, which shows that it was asked."""
    copied = shutil.copytree(cache, damaged / "cache")
    library_in(copied).write_bytes(content)
    found = output(start(damaged, package, NUMBA_CACHE_DIR=str(copied)))
    assert found == "the kernel cannot be compiled: damaged []"


@pytest.mark.live
def test_object_code_is_loaded_where_there_is_no_linker_and_linked_where_there_is_one(
    package: Path, tmp_path: Path, damaged: Path
) -> None:
    """What numba prints is no part of it."""
    cache = tmp_path / "linkless"
    no_linker = {"CC": str(tmp_path / "missing"), "NUMBA_CACHE_DIR": str(cache), "NUMBA_DUMP_OPTIMIZED": "1"}
    for libraries in ("['llvmlite']", "['llvmlite']"):
        assert output(start(package, **no_linker)) == libraries
    for _ in range(2):
        assert output(start(damaged, package, NUMBA_CACHE_DIR=str(cache))) == LOADED


@pytest.mark.live
def test_without_a_folder_the_kernel_is_compiled_each_time(package: Path, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    assert output(start(package, NUMBA_CACHE_DIR=str(tmp_path / "file"))) == LOADED


def test_call_with_arrays_that_do_not_fit_each_other_is_an_error_as_in_python() -> None:
    with pytest.raises(ValueError if IS_PLAIN else KernelError):
        forget_all(np.zeros(3, np.uint8), np.zeros(3, np.uint8))


@pytest.mark.parametrize(
    "wrong", [np.zeros((1, 8), np.uint8), np.zeros(8), np.zeros(16, np.uint8)[::2], np.frombuffer(bytes(8), np.uint8)]
)
def test_array_of_another_type_is_refused(wrong: NDArray[Any]) -> None:
    with pytest.raises(ValueError if IS_PLAIN else TypeError, match=r"must be|dtype"):
        forget_all(wrong, np.zeros(8, np.uint8))

# SPDX-License-Identifier: Apache-2.0
"""Functions of this room that numba compiles into one library, in a process of its own: this one only loads it.

The library is kept in a folder that is named by a hash of all sources of the kernel, of the versions of what compiles
them, and of the machine. With NUMBA_DISABLE_JIT=1 the functions stay plain Python, which takes far longer.
"""

import ctypes
import fcntl
import hashlib
import os
import platform
import shlex
import struct
import subprocess
import sys
from array import array
from collections.abc import Callable
from contextlib import suppress
from functools import cache, cached_property, partial, update_wrapper
from importlib import import_module
from itertools import takewhile
from pathlib import Path
from tempfile import NamedTemporaryFile, TemporaryDirectory
from typing import IO, Any, Generic, ParamSpec, TypeVar, cast

import numpy as np

from scara_effmass.errors import KernelError

Function = TypeVar("Function", bound=Callable[..., Any])
Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")
numba: Any = None
"""numba in the process that compiles, and only there."""
# IEEE arithmetic, because fast-math breaks checks of NaN; only a product that is added need not be rounded before. No
# function makes an array, so none has to count references.
OPTIONS = {"error_model": "numpy", "fastmath": {"contract"}, "_nrt": False}
OPTIONS |= {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
BYTES, INTEGERS, FLAGS, VECTOR = "uint8[::1]", "int64[::1]", "boolean[::1]", "float64[::1]"
MATRIX, MATRICES = "float64[:, ::1]", "float64[:, :, ::1]"
INTEGER, FLAG, NUMBER = "int64", "boolean", "float64"
"""Types of arguments, as numba writes them."""
FILE = "library"
_SHARED = 3
"""Type of an ELF file that is a shared library, byte 16; other ones are object code."""


def _name() -> str:
    """Return the name of the folder of the library: a hash of what the library depends on."""
    from importlib.metadata import PackageNotFoundError, version  # noqa: PLC0415 - takes 30 ms

    package = Path(__file__).parents[1]
    # Constants of these rooms are compiled in.
    rooms = ("kernel", "iso15066", "reference")
    sources = [*(path for room in rooms for path in sorted((package / room).glob("*.py")))]
    sources += [package / "codes.py", package / "values.py"]
    content = [source.read_bytes() for source in sources]
    machine = [platform.machine(), *platform.libc_ver(), platform.python_version(), np.__version__, *_processor()]
    for library in ("numba", "llvmlite"):
        with suppress(PackageNotFoundError):
            machine.append(version(library))
    return f"kernel-{hashlib.sha256(bytes(1).join([*content, *map(str.encode, machine)])).hexdigest()[:16]}"


def _processor() -> list[str]:
    """Return what distinguishes a processor from one that lacks some of its instructions."""
    with suppress(OSError), Path("/proc/cpuinfo").open(encoding="utf-8", errors="replace") as file:
        lines = takewhile(str.strip, file)  # those of the first core
        return [line for line in lines if line.lower().startswith(("model name", "flags", "features", "cpu part"))]
    return []


def cache_folders() -> list[Path]:
    """Return where the library may be kept: in NUMBA_CACHE_DIR, else in the user's cache or beside the sources."""
    if stated := os.environ.get("NUMBA_CACHE_DIR"):
        return [Path(stated, _name())]
    user = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"), "scara_effmass")  # noqa: PTH111 - no home is no error
    return [base / _name() for base in (user, Path(__file__).parent / "__pycache__") if base.is_absolute()]


def why_not() -> str:
    """Return why the kernel cannot be compiled; empty if it is, or is to stay plain Python. Later it is tried again."""
    reason = _library()[1]
    if reason:
        _library.cache_clear()
    return reason


@cache
def _library() -> tuple[Callable[[str], Any] | None, str]:
    """Return what finds a function of the library by its name, or why there is none."""
    if os.environ.get("NUMBA_DISABLE_JIT", "0") != "0":
        return None, ""
    try:
        return _load(), ""
    except (OSError, AttributeError, KernelError) as error:
        return None, f"the kernel cannot be compiled: {error}"


def _load() -> Callable[[str], Any]:
    """Load the library that is kept, or else compile it. Raises KernelError, OSError."""
    folders = cache_folders()
    for folder in folders:
        if find := _load_kept(folder):
            return find
    for folder in folders:
        if lock := _locked(folder):
            with lock:
                return _load_kept(folder) or _compile(folder)
    return _compile(None)


def _locked(folder: Path) -> IO[str] | None:
    """Let one process compile in `folder`, and the others wait for it; None if nothing can be written there."""
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        lock = (folder / "lock").open("w", encoding="utf-8")
        fcntl.flock(lock, fcntl.LOCK_EX)
        return lock
    return None


def _load_kept(folder: Path) -> Callable[[str], Any] | None:
    """Load the library in `folder`; None if there is none, or it is damaged or for another system."""
    with suppress(OSError):
        content = (folder / FILE).read_bytes()
        kept = content[32:]
        if content[:32] == hashlib.sha256(kept).digest():
            library = _linked(kept)
            find = _open(library)
            if library is not kept:
                _keep(folder, library)
            return find
    return None


def _compile(folder: Path | None) -> Callable[[str], Any]:
    """Compile in a process that finds libraries where this one does, and keep what can be loaded in `folder`."""
    entries: list[Any] = sys.path
    package, paths = str(Path(__file__).parents[2]), [path for path in entries if isinstance(path, str)]
    # An editable installation is not on the path.
    code = (
        f"import sys; sys.path.append({package!r}); import scara_effmass.kernel; sys.path[:] = {paths}; "
        "from scara_effmass.kernel.compiler import main; main()"
    )
    environment = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_")}
    command = [sys.executable or "python3", "-I", "-S", "-c", code]
    done = subprocess.run(command, env=environment, stdin=subprocess.DEVNULL, capture_output=True, check=False)  # noqa: S603 - ours
    if done.returncode != 0 or done.stdout[:4] != b"\x7fELF":
        lines = done.stderr.decode(errors="replace").strip().splitlines() or ["it said nothing"]
        by_signal = f"its process was ended by signal {-done.returncode}: " if done.returncode < 0 else ""
        raise KernelError(f"{by_signal}{lines[-1][:300]}")
    library = _linked(done.stdout)
    find = _open(library)
    if folder:
        _keep(folder, library)
    return find


def _keep(folder: Path, library: bytes) -> None:
    """Write the library; where that fails, each start takes the time to compile."""
    new = folder / f"new-{os.getpid()}"
    with suppress(OSError):
        try:
            new.write_bytes(hashlib.sha256(library).digest() + library)
            new.replace(folder / FILE)
        finally:
            new.unlink(missing_ok=True)


def _linked(library: bytes) -> bytes:
    """Return the shared library of object code; without a linker, the object code."""
    if library[16] == _SHARED:
        return library
    with suppress(OSError, ValueError, subprocess.CalledProcessError), TemporaryDirectory() as temporary:
        source, linked = Path(temporary, "kernel.o"), Path(temporary, "kernel.so")
        source.write_bytes(library)
        command = [*shlex.split(os.environ.get("CC") or "cc"), "-shared", "-Wl,-z,noexecstack"]
        subprocess.run([*command, "-o", linked, source, "-lm"], capture_output=True, check=True)  # noqa: S603
        return linked.read_bytes()
    return library


def _open(library: bytes) -> Callable[[str], Any]:
    """Load the library, not from where it is kept: that folder may not be for programs. Raises OSError."""
    if library[16] == _SHARED:
        with suppress(OSError, AttributeError):  # some systems forbid files in memory, some Pythons lack them
            descriptor = os.memfd_create("scara_effmass_kernel")
            with os.fdopen(descriptor, "wb") as file:
                # The loader knows libraries by name, and others load theirs from /proc/self.
                return _written(library, file, f"/proc/{os.getpid()}/fd/{descriptor}")
        with NamedTemporaryFile(suffix=".so") as file:
            return _written(library, file, file.name)
    binding: Any = import_module("llvmlite.binding")
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    machine = binding.Target.from_default_triple().create_target_machine()
    engine = binding.create_mcjit_compiler(binding.parse_assembly(""), machine)
    engine.add_object_file(binding.ObjectFileRef.from_data(library))
    engine.finalize_object()
    return lambda name: ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p)(engine.get_function_address(name))


def _written(library: bytes, file: IO[bytes], path: str) -> Callable[[str], Any]:
    file.write(library)
    file.flush()
    return ctypes.CDLL(path).__getitem__


class Call:
    """A function of the library with its arguments."""

    __slots__ = ("_at", "_native", "_owned", "_result")

    def __init__(self, native: Any, arguments: list[int], owners: tuple[object, ...]) -> None:  # noqa: ANN401 - of ctypes
        self._result, error = ctypes.c_int64(), ctypes.c_int64()
        packed = array("q", [ctypes.addressof(self._result), ctypes.addressof(error), *arguments])
        self._native, self._at = native, ctypes.c_void_p(packed.buffer_info()[0])
        self._owned = packed, error, owners

    def __call__(self) -> int:
        """Call the function. Raises KernelError where plain Python raises an exception."""
        if self._native(self._at):
            raise KernelError("the kernel raised an exception")
        return self._result.value


class Compiled(Generic[Parameters, Result]):
    """A function of the library, for arguments of the `types` of numba; plain Python where there is no library."""

    def __init__(self, function: Callable[Parameters, Result], types: tuple[str, ...]) -> None:
        self._function, self._types = function, types
        self._dtypes = [np.dtype(kind.split("[")[0].replace("boolean", "bool")) for kind in types]
        update_wrapper(self, function)

    @cached_property
    def _native(self) -> Any:  # noqa: ANN401 - of ctypes
        find = _library()[0]
        return find and find(self._function.__name__)

    def bind(self, *arguments: Parameters.args, **_: Parameters.kwargs) -> Callable[[], Result]:
        """Return the call with `arguments`, whose arrays must stay where they are. Raises TypeError for other types."""
        if self._native is None:
            return partial(self._function, *arguments)
        values: list[int] = []
        value: Any
        for kind, dtype, value in zip(self._types, self._dtypes, arguments, strict=True):
            if "[" in kind:
                self._check(kind, dtype, value)
                values += (0, 0, value.size, value.itemsize, value.ctypes.data, *value.shape, *value.strides)
            elif kind == NUMBER:
                values += struct.unpack("q", struct.pack("d", value))
            else:
                values.append(int(value))
        call: Any = Call(self._native, values, arguments)
        return call  # type: ignore[no-any-return]

    def _check(self, kind: str, dtype: np.dtype[Any], value: Any) -> None:  # noqa: ANN401 - any argument
        if not isinstance(value, np.ndarray):
            raise TypeError(f"{self._function.__name__}: must be {kind}, is {type(value).__name__}")
        is_written = kind in {BYTES, MATRICES}
        fits = value.flags.c_contiguous and (value.flags.writeable or not is_written)
        if not fits or value.dtype != dtype or value.ndim != kind.count(",") + 1:
            found = f"{value.dtype} {value.shape} with strides {value.strides}"
            raise TypeError(f"{self._function.__name__}: must be {kind}, is {found}")

    def __call__(self, *arguments: Parameters.args, **_: Parameters.kwargs) -> Result:
        """Call the function with `arguments`."""
        return self.bind(*arguments, **_)()


FUNCTIONS: dict[str, tuple[Any, str]] = {}
"""Functions of the library by name, with their signatures, in the process that compiles."""


def compiled(*types: str) -> Callable[[Callable[Parameters, Result]], Compiled[Parameters, Result]]:
    """Return a decorator of a function of the library, for arguments of `types`."""

    def decorate(function: Callable[Parameters, Result]) -> Compiled[Parameters, Result]:
        if numba is not None:
            FUNCTIONS[function.__name__] = numba.njit(**OPTIONS)(function), f"({', '.join(types)})"
        return Compiled(function, types)

    return decorate


def inlined(function: Function) -> Function:
    """Return `function` compiled into the functions that call it."""
    return function if numba is None else cast(Function, numba.njit(**OPTIONS)(function))

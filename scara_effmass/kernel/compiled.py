# SPDX-License-Identifier: Apache-2.0
"""Functions of this room that numba compiles into one library, in a process of its own: this one only loads it.

The library is kept in a folder that is named by a hash of all sources of the kernel, of the versions of what compiles
them, and of the processor. With NUMBA_DISABLE_JIT=1 the functions stay plain Python, which takes far longer.
"""

import ctypes
import hashlib
import os
import platform
import struct
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache, cached_property, partial, update_wrapper
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Generic, ParamSpec, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

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
_SHARED = 3
"""Type of an ELF file that is a shared library, byte 16; other ones are object code."""


def _source_hash() -> str:
    """Return a hash of what the library depends on, the processor apart."""
    package = Path(__file__).parents[1]
    # Constants of these rooms are compiled in.
    rooms = ("kernel", "iso15066", "reference")
    sources = [*(path for room in rooms for path in sorted((package / room).glob("*.py")))]
    sources += [package / "codes.py", package / "values.py"]
    content = [source.read_bytes() for source in sources]
    return hashlib.sha256(b"\0".join([*content, *map(str.encode, _versions())])).hexdigest()[:16]


def _versions() -> list[str]:
    versions = [platform.python_version(), np.__version__]
    for library in ("numba", "llvmlite"):
        with suppress(PackageNotFoundError):
            versions.append(version(library))
    return versions


def _processor() -> str:
    """Return what distinguishes a processor from one that lacks some of its instructions."""
    found = [platform.machine()]
    with suppress(OSError), Path("/proc/cpuinfo").open(encoding="utf-8", errors="replace") as file:
        for line in file:
            if not line.strip():
                break
            if line.lower().startswith(("model name", "flags", "features", "cpu part")):
                found.append(line)
    return hashlib.sha256("".join(found).encode()).hexdigest()[:8]


def cache_folder() -> Path | None:
    """Return the folder of the library that was compiled from these sources; None if no folder can be written.

    It lies in NUMBA_CACHE_DIR, else in the user's cache folder, else beside the sources.
    """
    stated = os.environ.get("NUMBA_CACHE_DIR")
    user = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"), "scara_effmass")  # noqa: PTH111 - no home is no error
    for base in [Path(stated)] if stated else [user, Path(__file__).parent / "__pycache__"]:
        folder = base / f"kernel-{_source_hash()}-{_processor()}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            return folder
    return None


def why_not() -> str:
    """Return why the kernel cannot be compiled; empty if it is, or is to stay plain Python."""
    return _library()[1]


@cache
def _library() -> tuple[Callable[[str], Any] | None, str]:
    """Return what finds a function of the library by its name, or why there is none."""
    if os.environ.get("NUMBA_DISABLE_JIT", "0") != "0":
        return None, ""
    folder = cache_folder()
    library = folder and _kept(folder / "library")
    try:
        if not library:
            library = _compile()
            if folder:
                with suppress(OSError):  # a full disk costs the time to compile again
                    _keep(folder / "library", library)
        return _open(library), ""
    except (OSError, KernelError) as error:
        return None, f"the kernel cannot be compiled: {error}"


def _kept(file: Path) -> bytes:
    """Return the library in `file`, empty if there is none or it is damaged."""
    with suppress(OSError):
        content = file.read_bytes()
        if content[:32] == hashlib.sha256(content[32:]).digest():
            return content[32:]
    return b""


def _keep(file: Path, library: bytes) -> None:
    new = file.with_name(f"new-{os.getpid()}")
    new.write_bytes(hashlib.sha256(library).digest() + library)
    new.replace(file)


def _compile() -> bytes:
    """Return the library, compiled by a process that finds modules where this one does. Raises KernelError, OSError."""
    paths = [str(Path(__file__).parents[2]), *(path or os.getcwd() for path in sys.path)]  # noqa: PTH109 - as Python
    code = f"import sys; sys.path[:] = {paths}; from scara_effmass.kernel.compiler import main; main()"
    done = subprocess.run([sys.executable, "-I", "-S", "-c", code], capture_output=True, check=False)  # noqa: S603 - ours
    if done.returncode != 0:
        raise KernelError(done.stderr.decode(errors="replace").strip() or f"its process ended with {done.returncode}")
    return done.stdout


def _open(library: bytes) -> Callable[[str], Any]:
    """Load the library, not from its file: its folder may not be for programs."""
    if library[16] == _SHARED:
        descriptor = os.memfd_create("scara_effmass_kernel")
        with os.fdopen(descriptor, "wb", buffering=0) as file:
            file.write(library)
            return ctypes.CDLL(f"/proc/self/fd/{descriptor}").__getitem__
    binding: Any = import_module("llvmlite.binding")
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    machine = binding.Target.from_default_triple().create_target_machine()
    engine = binding.create_mcjit_compiler(binding.parse_assembly(""), machine)
    engine.add_object_file(binding.ObjectFileRef.from_data(library))
    engine.finalize_object()
    return lambda name: ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p)(engine.get_function_address(name))


class Call:
    """A function of the library with its arguments."""

    __slots__ = ("_at", "_kept", "_native", "_result")

    def __init__(self, native: Any, arguments: list[int], kept: tuple[object, ...]) -> None:  # noqa: ANN401 - of ctypes
        self._result, error = ctypes.c_int64(), ctypes.c_int64()
        packed = (ctypes.c_int64 * (2 + len(arguments)))(
            ctypes.addressof(self._result), ctypes.addressof(error), *arguments
        )
        self._native, self._at = native, ctypes.c_void_p(ctypes.addressof(packed))
        self._kept = packed, error, kept

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
        for kind, dtype, argument in zip(self._types, self._dtypes, arguments, strict=True):
            if "[" in kind:
                array = cast(NDArray[Any], argument)
                if (array.dtype, array.ndim) != (dtype, kind.count(",") + 1) or not array.flags.c_contiguous:
                    found = f"{array.dtype} {array.shape} with strides {array.strides}"
                    raise TypeError(f"{self._function.__name__}: must be {kind}, is {found}")
                values += (0, 0, array.size, array.itemsize, array.ctypes.data, *array.shape, *array.strides)
            elif kind == NUMBER:
                values += struct.unpack("q", struct.pack("d", argument))
            else:
                values.append(int(cast(int, argument)))
        return cast(Callable[[], Result], Call(self._native, values, arguments))

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

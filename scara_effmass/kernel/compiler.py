# SPDX-License-Identifier: Apache-2.0
"""Compile the kernel to object code, in a process of its own: numba and LLVM take 20 s and 500 MB.

numba calls a function with the addresses of its result and of an exception, then with the members of each
array (none that owns it, size, size of an item, data, shape, strides), and gets a status, 0 for success; see
numba.core.callconv. The library has these in one array of 8 bytes each.
"""

import gc
import os
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

from scara_effmass.kernel import compiled


def main() -> None:
    """Write object code to the standard output, or one line to the standard error."""
    output = os.dup(1)
    os.dup2(2, 1)  # numba and LLVM print what NUMBA_* variables or their authors ask for
    try:
        code = _object_code()
    except Exception as error:  # noqa: BLE001 - a damaged installation may raise anything
        sys.exit(" ".join(str(error).split()) or type(error).__name__)
    with os.fdopen(output, "wb") as file:
        file.write(code)


def _object_code() -> bytes:
    compiled.numba = import_module("numba")
    llvm: Any = import_module("llvmlite.binding")
    codegen: Any = import_module("numba.core.codegen")
    parts: list[Any] = []

    class Part(codegen.CPUCodeLibrary):  # type: ignore[misc]
        """A function alone: numba would link, optimize and emit each one with all that it calls, twice the time."""

        def finalize(self) -> None:
            self._finalized = True
            parts.append(self._final_module)

        def get_pointer_to_function(self, _: str) -> int:
            self._ensure_finalized()
            return 0

    codegen.JITCPUCodegen._library_class = Part  # noqa: SLF001 - what makes libraries
    codegen.JITCPUCodegen.set_env = lambda *_: None  # would write to the memory of the function
    gc.disable()  # an eighth of the time, and nothing that lives long
    for path in sorted(Path(__file__).parent.glob("*.py")):
        if path.stem not in {"__init__", "compiler"}:
            import_module(f"scara_effmass.kernel.{path.stem}")
    for function, signature in compiled.FUNCTIONS.values():
        function.compile(signature)
    library = parts.pop()
    for part in parts:
        library.link_in(part)
    for name, (function, _) in compiled.FUNCTIONS.items():
        (overload,) = function.overloads.values()
        native = library.get_function(overload.fndesc.llvm_func_name)
        library.link_in(llvm.parse_assembly(_entry(name, native)))
    machine = llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(),
        features=llvm.get_host_cpu_features().flatten(),
        opt=3,
        reloc="pic",
        codemodel="default",
    )
    # All functions together, of which only those are called from outside.
    for found in library.functions:
        if not found.is_declaration and found.name not in compiled.FUNCTIONS:
            found.linkage = llvm.Linkage.internal
    tuning = llvm.create_pipeline_tuning_options(speed_level=3)
    tuning.loop_vectorization = False
    passes = llvm.create_pass_builder(machine, tuning)
    passes.getModulePassManager().run(library, passes)
    code: bytes = machine.emit_object(library)
    return code


def _entry(name: str, native: Any) -> str:  # noqa: ANN401 - a function of llvmlite
    """Return a function in the language of LLVM that takes the arguments of `native` from an array."""
    types = [str(argument.type) for argument in native.arguments]
    lines = [f"define i32 @{name}(ptr %array) {{"]
    for i, kind in enumerate(types):
        lines += [f"  %at{i} = getelementptr i64, ptr %array, i64 {i}", f"  %of{i} = load {kind}, ptr %at{i}"]
    arguments = ", ".join(f"{kind} %of{i}" for i, kind in enumerate(types))
    lines += [f"  %status = call i32 @{native.name}({arguments})", "  ret i32 %status", "}"]
    return "\n".join([f"declare i32 @{native.name}({', '.join(types)})", *lines])

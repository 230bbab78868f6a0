# SPDX-License-Identifier: Apache-2.0
"""Mutation testing: change one operator, number or statement of a room and see whether the room's tests fail.

A random sample of all mutants is run, each in a copy of the tree, stopping at the first failing test. Prints the diff
of each survivor, then the killed and total mutants of the room. Usage: `make mutants ROOM=safety N=60 SEED=1`.
"""

from __future__ import annotations

import argparse
import ast
import copy
import difflib
import os
import queue
import random
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT = Path(__file__).resolve().parents[1]
PURE_ROOMS = ("model", "iso15066", "safety", "impacts")

SWAPPED = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
    ast.And: (ast.Or,),
    ast.Or: (ast.And,),
    ast.Add: (ast.Sub,),
    ast.Sub: (ast.Add,),
    ast.Mult: (ast.Div,),
    ast.Div: (ast.Mult,),
    ast.FloorDiv: (ast.Mult,),
    ast.Mod: (ast.Mult,),
    ast.Pow: (ast.Mult,),
    ast.BitAnd: (ast.BitOr,),
    ast.BitOr: (ast.BitAnd,),
}
SWAPPED_CALLS = {"min": "max", "max": "min", "any": "all", "all": "any"}

COPY_FIRST = """
import sys
sys.meta_path[:] = [finder for finder in sys.meta_path if "Scikit" not in type(finder).__name__]
sys.path.insert(0, {root!r})
"""
"""A `sitecustomize` module: import the package from the copy, not through the editable installation."""


class Mutant(NamedTuple):
    """A changed source file: its path below the root, the line of the change, and the new text."""

    path: str
    line: int
    source: str


def mutants_of(path: Path) -> Iterator[Mutant]:
    """Yield all mutants of a source file."""
    source = path.read_bytes()
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    for node, text in mutations(ast.parse(source)):
        start = starts[node.lineno - 1] + node.col_offset
        end = starts[node.end_lineno - 1] + node.end_col_offset
        mutated = source[:start] + text.encode() + source[end:]
        yield Mutant(str(path.relative_to(ROOT)), node.lineno, mutated.decode())


def mutations(node: ast.AST) -> Iterator[tuple[ast.AST, str]]:
    """Yield nodes in `node` and the source text that replaces each.

    Left out: annotations, decorators, messages of exceptions, f-strings, and code for type checkers.
    """
    yield from _mutations_here(node)
    if isinstance(node, ast.Raise | ast.JoinedStr | ast.Import | ast.ImportFrom):
        return
    for field, value in ast.iter_fields(node):
        if field in {"annotation", "returns", "decorator_list"}:
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.keyword) and child.arg == "strict":
                continue
            if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
                continue
            if isinstance(child, ast.AST):
                yield from mutations(child)


def _mutations_here(node: ast.AST) -> Iterator[tuple[ast.AST, str]]:  # noqa: C901, PLR0912 - one case per kind of node
    match node:
        case ast.Compare(ops=operators):
            for index, operator in enumerate(operators):
                for other in SWAPPED[type(operator)]:
                    changed = copy.deepcopy(node)
                    changed.ops[index] = other()
                    yield node, f"({ast.unparse(changed)})"
        case ast.BoolOp(op=operator, values=values):
            yield node, f"({ast.unparse(ast.BoolOp(SWAPPED[type(operator)][0](), values))})"
            for index in range(len(values)):
                kept = values[:index] + values[index + 1 :]
                yield node, f"({ast.unparse(kept[0] if len(kept) == 1 else ast.BoolOp(operator, kept))})"
        case ast.BinOp(op=operator) if type(operator) in SWAPPED and not _is_text(node):
            yield node, f"({ast.unparse(ast.BinOp(node.left, SWAPPED[type(operator)][0](), node.right))})"
        case ast.AugAssign(op=operator) if type(operator) in SWAPPED:
            yield node, ast.unparse(ast.AugAssign(node.target, SWAPPED[type(operator)][0](), node.value))
        case ast.UnaryOp(op=ast.Not() | ast.USub(), operand=operand):
            yield node, f"({ast.unparse(operand)})"
        case ast.Constant(value=bool() as value):
            yield node, str(not value)
        case ast.Constant(value=int() | float() as value):
            yield node, repr(value + 1)
            if value:
                yield node, "0" if isinstance(value, int) else repr(value / 2.0)
        case ast.If(test=test) | ast.While(test=test) | ast.IfExp(test=test) if not isinstance(test, ast.Compare):
            yield test, f"(not ({ast.unparse(test)}))"
        case ast.Call(func=ast.Name(id=name)) if name in SWAPPED_CALLS:
            yield node.func, SWAPPED_CALLS[name]
        case ast.Raise() | ast.Expr(value=ast.Call()) | ast.Assign(targets=[ast.Attribute() | ast.Subscript()]):
            yield node, "pass"
        case ast.Continue():
            yield node, "break"
        case ast.Break():
            yield node, "continue"
        case ast.Return(value=None):
            yield node, "pass"


def _is_text(node: ast.BinOp) -> bool:
    sides = (node.left, node.right)
    return any(isinstance(side, ast.JoinedStr) or isinstance(getattr(side, "value", None), str) for side in sides)


class Workspace:
    """A copy of the tree in which one room's tests run."""

    def __init__(self, root: Path) -> None:
        """Copy all files that git tracks or would track."""
        self.root = root
        words = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"]
        listed = subprocess.run(words, cwd=ROOT, capture_output=True, check=True).stdout.decode()  # noqa: S603
        for name in filter(None, listed.split("\0")):
            if (ROOT / name).is_file():
                (root / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(ROOT / name, root / name)
        (root / ".first").mkdir()
        (root / ".first/sitecustomize.py").write_text(COPY_FIRST.format(root=str(root)))

    def run_tests(self, room: str, cpu_limit_s: int, module: str = "", *, write_bytecode: bool = False) -> int:
        """Return the exit code of the room's tests, those of `module` first; negative beyond `cpu_limit_s`."""
        environment = {**os.environ, "PYTHONPATH": str(self.root / ".first"), "OMP_NUM_THREADS": "1"}
        if not write_bytecode:
            environment["PYTHONDONTWRITEBYTECODE"] = "1"
        words = ["-m", "pytest", "-x", "-m", "not live", "-p", "no:cacheprovider", "--hypothesis-profile", "mutants"]
        files = sorted(
            (self.root / "test" / room).rglob("test_*.py"), key=lambda path: (path.stem != f"test_{module}", path)
        )
        done = subprocess.run(  # noqa: S603 - our own tests
            [sys.executable, *words, *files],
            cwd=self.root,
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            check=False,
            preexec_fn=partial(resource.setrlimit, resource.RLIMIT_CPU, (cpu_limit_s, cpu_limit_s + 5)),
        )
        return done.returncode

    def kills(self, mutant: Mutant, room: str, cpu_limit_s: int) -> bool:
        """Return whether the room's tests fail, or do not end, with the mutant in place."""
        path = self.root / mutant.path
        original = path.read_bytes()
        # A stale .pyc would hide the mutant when size and second of writing are the same.
        for compiled in path.parent.glob(f"__pycache__/{path.stem}.*.pyc"):
            compiled.unlink()
        path.write_text(mutant.source, encoding="utf-8")
        try:
            code = self.run_tests(room, cpu_limit_s, path.stem)
        finally:
            path.write_bytes(original)
        if code in {3, 5}:  # 4 is a conftest that the mutant keeps from being imported
            raise SystemExit(f"{room}: pytest ended with {code} on {mutant.path}:{mutant.line}")
        return code != 0


def children_cpu_s() -> float:
    """Return the CPU time of all ended child processes [s]."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def test_room(room: str, number: int, seed: int, workspaces: list[Workspace]) -> bool:
    """Run a sample of the room's mutants and print the result. Returns whether any survived."""
    files = sorted((ROOT / "scara_effmass" / room).rglob("*.py"))
    population = [mutant for path in files for mutant in mutants_of(path)]
    sample = random.Random(seed).sample(population, min(number, len(population)))  # noqa: S311
    began, cpu_s = time.monotonic(), children_cpu_s()
    for workspace in workspaces:
        if workspace.run_tests(room, 3600, write_bytecode=True) != 0:
            raise SystemExit(f"{room}: the tests fail without a mutant; run pytest test/{room}")
    limit_s = round(20 + 3 * (children_cpu_s() - cpu_s) / len(workspaces))
    idle: queue.SimpleQueue[Workspace] = queue.SimpleQueue()
    for workspace in workspaces:
        idle.put(workspace)

    def kills(mutant: Mutant) -> bool:
        workspace = idle.get()
        try:
            is_killed = workspace.kills(mutant, room, limit_s)
        finally:
            idle.put(workspace)
        if not is_killed:  # a run takes long, and may be interrupted
            before = (ROOT / mutant.path).read_text(encoding="utf-8").splitlines()
            lines = list(difflib.unified_diff(before, mutant.source.splitlines(), n=0, lineterm=""))[3:]
            print("\n    ".join([f"  {mutant.path}:{mutant.line}", *lines]), flush=True)
        return is_killed

    with ThreadPoolExecutor(len(workspaces)) as pool:
        killed = list(pool.map(kills, sample))
    print(
        f"{room}: {sum(killed)} of {len(sample)} mutants killed ({sum(killed) / len(sample):.0%}), "
        f"sampled from {len(population)} with seed {seed}, {time.monotonic() - began:.0f} s",
        flush=True,
    )
    return not all(killed)


def main() -> int:
    """Run the command line. Returns 1 when a mutant survived."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rooms", nargs="*", default=PURE_ROOMS, help="folders of scara_effmass (default: %(default)s)")
    parser.add_argument("--number", type=int, default=60, help="mutants per room (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the sample (default: %(default)s)")
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)), help="default: one per core")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="mutants_") as folder:
        workspaces = [Workspace(Path(folder) / str(index)) for index in range(arguments.workers)]
        results = [test_room(room, arguments.number, arguments.seed, workspaces) for room in arguments.rooms]
    return int(any(results))


if __name__ == "__main__":
    raise SystemExit(main())

# SPDX-License-Identifier: Apache-2.0
"""Read text and YAML files of limited size, with one-line errors that name the place; read tables of this package."""

import hashlib
import re
import reprlib
import stat
from contextvars import ContextVar
from pathlib import Path
from typing import Any

import yaml

from scara_effmass.errors import EffmassError
from scara_effmass.url import Url

try:  # ten times as fast, where PyYAML was built with libyaml
    from yaml import CSafeLoader as SafeLoader
except ImportError:
    from yaml import SafeLoader  # type: ignore[assignment]

MAX_TEXT_BYTES = 5_000_000
MAX_YAML_BYTES = 500_000
_MAX_YAML_DEPTH, _MAX_YAML_VALUES = 20, 20_000
_MAX_INTEGER = 2**63
YAML_ERRORS = (yaml.YAMLError, AttributeError, LookupError, RecursionError, TypeError, ValueError)
"""Errors that `yaml.safe_load`, and reading its result, raise on an arbitrary or damaged file."""


_INPUTS: ContextVar[tuple[Path, ...]] = ContextVar("inputs", default=())


def protect_inputs(*paths: Path) -> None:
    """Let `check_not_input` refuse `paths`, the input of the running command, in this context."""
    _INPUTS.set((*_INPUTS.get(), *paths))


def check_not_input(path: Path, error: type[EffmassError]) -> None:
    """Raise `error` if the output `path` is an input of the running command, also by another name, or holds one."""
    for item in _INPUTS.get():
        if isinstance(path, Url) or isinstance(item, Url):
            is_input = path in {item, *item.parents}
        else:
            resolved = item.resolve()
            is_input = path.resolve() in {resolved, *resolved.parents}
            is_input |= path.exists() and item.exists() and path.samefile(item)
        if is_input:
            raise error(f"{path}: must not be the input {item}")


def check_regular_file(path: Path, error: type[EffmassError]) -> None:
    """Raise `error` unless `path` is a regular file: a pipe without a writer would block for ever."""
    try:
        is_regular = stat.S_ISREG(path.stat().st_mode)
    except (OSError, ValueError) as problem:
        raise error(f"{path}: cannot be read: {getattr(problem, 'strerror', problem)}") from None
    if not is_regular:
        raise error(f"{path}: cannot be read: must be a regular file")


def read_text(path: Path, error: type[EffmassError], max_bytes: int = MAX_TEXT_BYTES) -> str:
    """Return the UTF-8 text of the regular file at `path`. Raises `error`, also if it is larger than `max_bytes`."""
    check_regular_file(path, error)
    try:
        with path.open("rb") as file:
            content = file.read(max_bytes + 1)
    except OSError as problem:
        raise error(f"{path}: cannot be read: {problem.strerror}") from None
    if len(content) > max_bytes:
        raise error(f"{path}: must not be larger than {max_bytes / 1e6:g} MB")
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as problem:
        line = content.count(b"\n", 0, problem.start) + 1
        raise error(f"{path}: line {line}: must be UTF-8 text") from None


def read_yaml(path: Path, error: type[EffmassError]) -> Any:  # noqa: ANN401 - what the file holds
    """Return the content of the YAML file at `path`, with the scalars as ROS reads them. Raises `error`."""
    text = read_text(path, error, MAX_YAML_BYTES)
    try:
        _check_size(text)
        return yaml.load(text, _Loader)  # noqa: S506 - derived from SafeLoader
    except yaml.MarkedYAMLError as problem:
        mark = problem.problem_mark or problem.context_mark
        place = f"line {mark.line + 1}, column {mark.column + 1}: " if mark else ""
        raise error(f"{path}: not YAML: {place}{problem.problem or problem.context}") from None
    except yaml.YAMLError as problem:
        raise error(f"{path}: not YAML: {' '.join(str(problem).split())}") from None


def _check_size(text: str) -> None:
    """Raise MarkedYAMLError if the content, with aliases expanded, is too deep or too large."""
    values = 0
    sizes: dict[str | None, int] = {}
    open_nodes: list[tuple[str | None, int]] = []  # anchor, number of values before it
    for event in yaml.parse(text, SafeLoader):
        if isinstance(event, yaml.CollectionEndEvent):
            anchor, before = open_nodes.pop()
            if anchor is not None:
                sizes[anchor] = values - before
        if not isinstance(event, yaml.NodeEvent):
            continue
        is_alias = isinstance(event, yaml.AliasEvent)
        if isinstance(event, yaml.CollectionStartEvent):
            open_nodes.append((event.anchor, values))
        values += sizes.get(event.anchor, 1) if is_alias else 1
        depth = len(open_nodes) + (not isinstance(event, yaml.CollectionStartEvent))
        for is_wrong, rule in (
            (depth > _MAX_YAML_DEPTH, f"must nest at most {_MAX_YAML_DEPTH} levels"),
            (values > _MAX_YAML_VALUES, f"must hold at most {_MAX_YAML_VALUES} values, aliases written out"),
            (is_alias and any(anchor for anchor, _ in open_nodes), "must not use an alias inside of an anchored value"),
        ):
            if is_wrong:
                raise yaml.MarkedYAMLError(problem=rule, problem_mark=event.start_mark)  # type: ignore[arg-type]


class _Loader(SafeLoader):
    """Refuses duplicate keys and values that do not fit their tag."""

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:  # noqa: ANN401, FBT001, FBT002
        keys: set[str] = set()
        for key, _ in node.value if isinstance(node, yaml.MappingNode) else ():
            if isinstance(key, yaml.ScalarNode) and key.value in keys:
                raise yaml.MarkedYAMLError(problem=f"must state {key.value} once", problem_mark=key.start_mark)
            keys.add(key.value if isinstance(key, yaml.ScalarNode) else "")
        return super().construct_mapping(node, deep)

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:  # noqa: ANN401, FBT001, FBT002
        try:
            value = super().construct_object(node, deep)
            is_valid = not isinstance(value, int) or abs(value) < _MAX_INTEGER
        except yaml.YAMLError:
            raise
        except Exception:  # noqa: BLE001 - with an explicit tag, PyYAML raises whatever the conversion raises
            is_valid = False
        if not is_valid:
            problem = f"{reprlib.repr(node.value)}: must be a valid {node.tag.rpartition(':')[2]}"
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=node.start_mark)
        return value


_Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if not tag.endswith(":timestamp")]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
"""As in ROS, a date is text and 1e-3 is a number."""
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"), list("-+.0123456789")
)


def read_table(module: str, name: str) -> Any:  # noqa: ANN401 - what the file holds
    """Return the content of the YAML file `name` in the folder of the file `module`."""
    with Path(module).with_name(name).open(encoding="utf-8") as stream:
        return yaml.load(stream, SafeLoader)


def digest(path: Path, error: type[EffmassError]) -> str:
    """Return the SHA-256 of a file or, for a folder, of what `sha256sum` prints for its files. Raises `error`."""
    try:
        if path.is_dir():
            files = sorted(file for file in path.rglob("*") if file.is_file())
            lines = (f"{digest(file, error)}  {file.relative_to(path).as_posix()}\n" for file in files)
            return hashlib.sha256("".join(lines).encode()).hexdigest()
        check_regular_file(path, error)
        total = hashlib.sha256()
        with path.open("rb") as file:
            while part := file.read(2**20):
                total.update(part)
    except OSError as problem:
        raise error(f"{path}: cannot be read: {problem.strerror}") from None
    return total.hexdigest()

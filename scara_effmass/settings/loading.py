# SPDX-License-Identifier: Apache-2.0
"""Load settings from files and parameters, and check them; an error is one line."""

import math
import re
import reprlib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from difflib import get_close_matches
from enum import Enum
from operator import attrgetter
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.fields import FieldInfo

from scara_effmass.errors import SettingsError
from scara_effmass.input_files import read_yaml

Settings = TypeVar("Settings", bound=BaseModel)

READ_ONLY: dict[str, Any] = {"read_only": True}
"""Marks a setting that cannot change while the node runs, such as hardware and robot."""

DESCRIPTIONS = frozenset({"robot_description", "robot_description_semantic"})
"""Parameters of other nodes with names like those here; the monitor takes a description by topic."""
NODE_ONLY = frozenset(
    {"robot", "autostart", "status_period", "command_tolerance", "use_sim_time", "stop_at_end", "find_impacts"}
    | {"report_folder", "thread_priority"}
)
"""Parameters of nodes only: a shared file may contain them, and offline commands ignore them."""

MAX_LONGER = 3
"""Largest number of names to suggest because they begin with an unknown one, such as one without its unit."""
_GROUP = "must hold keys with their values"
_RULES = {
    "missing": "must be present",
    "string_type": "must be text",
    "tuple_type": "must be a list",
    "model_type": _GROUP,
    "dict_type": _GROUP,
    "string_too_short": "must not be empty",
    "too_short": "must not be empty",
}
"""Rules by pydantic's type of error, for which pydantic's own text is about Python."""


def fixed(default: object, description: str, **limits: Any) -> Any:  # noqa: ANN401 - as pydantic's Field
    """Return the field of a setting that cannot change while the node runs."""
    return Field(default, description=description, json_schema_extra=READ_ONLY, **limits)


def tunable(default: object, description: str, **limits: Any) -> Any:  # noqa: ANN401 - as pydantic's Field
    """Return the field of a setting that can change while the node runs."""
    return Field(default, description=description, **limits)


class FrozenSettings(BaseModel):
    """Settings that refuse unknown names and numbers that are not finite. Raises ValidationError; see `checked`."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    def without_effect(self) -> list[str]:
        """Return a line for each setting that differs from its default but has no effect, with what it needs."""
        lines, fields = [], flat_fields(type(self))
        for name, (has_effect, need) in self._needs().items():
            value = attrgetter(name)(self)
            if value != fields[name].default and not has_effect:
                lines.append(f"{name} = {value} has no effect without {need}")
        return lines

    def _needs(self) -> dict[str, tuple[bool, str]]:
        """Return for each setting that depends on others whether it has an effect, and what it needs."""
        return {}


def checked(kind: type[Settings], values: Mapping[str, Any], origin: str) -> Settings:
    """Return the settings in `values`; groups are dotted keys ("filter.cutoff") or mappings.

    Raises SettingsError with `origin`, the name of the file or node.
    """
    try:
        return kind.model_validate(_grouped(values))
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"]) or "settings"
        if first["type"] == "extra_forbidden":
            text = f"{key}: unknown: {nearest(key, flat_fields(kind))}"
            raise SettingsError(f"{origin}: {text}") from None
        raise SettingsError(f"{origin}: {key}{broken_rule(first)}") from None


def broken_rule(problem: Mapping[str, Any]) -> str:
    """Return value and rule of a pydantic error, such as " = -1: must be greater than 0"."""
    value, kind = problem["input"], problem["type"]
    text = "" if isinstance(value, dict) or kind in {"missing", "key"} else f" = {reprlib.repr(value)}"
    rule = number_rule(value) if kind == "float_type" else _RULES.get(kind, problem["msg"])
    return f"{text}: {rule.removeprefix('Value error, ').replace('Input should', 'must')}"


def number_rule(value: object) -> str:
    """Return the rule for a `value` that is not a number; it explains how to write 5,1 and pi."""
    try:
        number = float(str(value).replace(",", "."))
    except ValueError:
        return f"must be a number{': write 3.14159265 for pi' * bool(re.search(r'(?i)pi', str(value)))}"
    return f"must be a number{f': write {number!r}' * math.isfinite(number)}"


def check_types(kind: type[BaseModel], values: Mapping[str, Any], origin: str) -> None:
    """Require in `values`, by flat name, the types that ROS requires of parameters, for files and nodes alike.

    Raises SettingsError.
    """
    for name, field in flat_fields(kind).items():
        value = values.get(name, field.default)
        expected, stated = _ros_type(field.default), _ros_type(value)
        if expected == stated or (expected.endswith("ARRAY") and isinstance(value, Sequence) and len(value) == 0):
            continue
        hint = ""
        if expected == "STRING":  # YAML reads y, N, yes, no, on and off as booleans
            word = ("y" if value else "N") if stated == "BOOL" else value
            hint = f""": YAML needs quotes, as in {name}:="'{word}'\""""
        elif expected == "DOUBLE" and stated in {"INTEGER", "STRING"}:
            hint = number_rule(value).removeprefix("must be a number")
        elif expected == f"{stated}_ARRAY":
            hint = f": write [{value}]"
        elif expected == "DOUBLE_ARRAY" and isinstance(value, Sequence) and {*map(type, value)} <= {int, float}:
            hint = f": write {list(map(float, value))}"
        raise SettingsError(f"{origin}: {name} = {reprlib.repr(value)}: must be {expected}, is {stated}{hint}")


def _ros_type(value: object) -> str:
    """Return the name of the type of a ROS parameter."""
    if isinstance(value, (list, tuple)):
        kinds = {_ros_type(item) for item in value} or {"STRING"}
        return f"{kinds.pop()}_ARRAY" if len(kinds) == 1 else "a mixed list"
    names = {bool: "BOOL", int: "INTEGER", float: "DOUBLE", str: "STRING", dict: "a group"}
    return "STRING" if isinstance(value, Enum) else names.get(type(value), "nothing")


def flat_fields(settings: type[BaseModel], prefix: str = "") -> dict[str, FieldInfo]:
    """Return the fields of `settings` by ROS name; the fields of a group are dotted ("filter.cutoff")."""
    fields: dict[str, FieldInfo] = {}
    for name, field in settings.model_fields.items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            fields |= flat_fields(field.annotation, f"{prefix}{name}.")
        else:
            fields[f"{prefix}{name}"] = field
    return fields


def choices(field: FieldInfo) -> list[str]:
    """Return the texts that a setting may have; none if it is not one of several."""
    kind = field.annotation
    if isinstance(kind, type) and issubclass(kind, Enum):
        return [member.value for member in kind]
    return [text for text in get_args(kind) if text] if get_origin(kind) is Literal else []


def nearest(name: str, names: Iterable[str]) -> str:
    """Return the rule for an unknown `name`: those of `names` that begin with it, the most similar one, or all."""
    names = list(names)
    longer = [other for other in names if name and other.startswith(name)]
    similar = longer if 0 < len(longer) <= MAX_LONGER else get_close_matches(name, names, n=1)
    return f"must be {' or '.join(similar) or ', '.join(names) or 'absent'}"


def load_settings(
    kind: type[Settings], path: Path | None, node: str, other_nodes: Collection[str] = (), *, of_one_cell: bool = True
) -> Settings:
    """Return the settings of `node` ("monitor") in the ROS parameter file at `path`, the defaults without one.

    The file contains `/**`, `node`, or `node` in a namespace, over `ros__parameters`, as written by `ros2 param dump`.
    Parameters of other nodes are ignored; a file that is only for `other_nodes` gives the defaults. Raises
    SettingsError, also `of_one_cell` for a file with the node in several namespaces, or with a section that ROS would
    not give to it.
    """
    if path is None:
        return kind()
    parameters: dict[str, Any] = {}
    sections = parameter_sections(path, node, other_nodes)
    cells = [name for name, _ in sections if "*" not in name]
    if of_one_cell and len(cells) > 1:
        raise SettingsError(f"{path}: holds {', '.join(cells)}: must hold {node} once, or in /**")
    own = f"/{cells[0].strip('/')}" if cells else f"/{node}"
    for name, stated in sections:
        if of_one_cell and not applies(name, own):
            raise SettingsError(f"{path}: {name}: must be {own} or /**/{node}")
        foreign = {key for key in stated if key in NODE_ONLY - kind.model_fields.keys()}
        foreign |= {key for key in stated if owner_of(name) == "**" and is_foreign(key, kind)}
        parameters |= {key: value for key, value in stated.items() if key not in foreign}
    check_types(kind, parameters, str(path))
    return checked(kind, parameters, str(path))


def parameter_sections(
    path: Path, node: str, other_nodes: Collection[str] | None = None
) -> list[tuple[str, dict[str, Any]]]:
    """Return name, such as /cell/monitor, and parameters, by flat name, of the sections for `node`, wherever it is.

    Raises SettingsError, also if there is none, unless the file is for one of `other_nodes` (None: any node).
    """
    document = read_yaml(path, SettingsError)
    if not isinstance(document, dict) or not document:
        raise SettingsError(f"{path}: must hold {node} (or /**) over ros__parameters")
    found = _stated_once(_sections(document), f"{path}")
    sections = [name for name in found if owner_of(name) in {"**", node}]
    if not sections and other_nodes is not None and not set(other_nodes).intersection(map(owner_of, found)):
        raise SettingsError(f"{path}: holds {', '.join(map(str, document))}: must hold {node} (or /**)")
    for name in sections:
        if not isinstance(found[name], dict) or not isinstance(found[name].get("ros__parameters"), dict):
            raise SettingsError(f"{path}: {name}: must hold ros__parameters")
        if "ros__parameters" in found[name]["ros__parameters"]:
            raise SettingsError(f"{path}: {name}: ros__parameters: must be stated once")
    for name, content in found.items():
        beside = (
            [f"{name}: {key}" for key in content if key != "ros__parameters"] if isinstance(content, dict) else [name]
        )
        if beside:
            raise SettingsError(f"{path}: {beside[0]}: must be below ros__parameters, or a section with it")
    return [(name, _stated_once(_flat(found[name]["ros__parameters"]), f"{path}: {name}")) for name in sections]


def _stated_once(items: Iterable[tuple[str, Any]], origin: str) -> dict[str, Any]:
    """Return `items` by name. Raises SettingsError for a name written in two ways, of which ROS takes the last."""
    values: dict[str, Any] = {}
    for name, value in items:
        if name in values:
            raise SettingsError(f"{origin}: {name}: must be stated once")
        values[name] = value
    return values


def _sections(document: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the sections of a parameter file by name; namespaces may be levels of the file or parts of a name."""
    for name, content in document.items():
        if isinstance(content, dict) and "ros__parameters" not in content and _holds_sections(content):
            yield from _sections(content, f"{prefix}{name}/")
        else:
            yield f"{prefix}{name}", content


def _holds_sections(content: Mapping[str, Any]) -> bool:
    groups = [value for value in content.values() if isinstance(value, dict)]
    return any("ros__parameters" in group or _holds_sections(group) for group in groups)


def owner_of(section: str) -> str:
    """Return the node of a `section` such as /cell/monitor, or ** for any one."""
    owner = str(section).rpartition("/")[2]
    return "**" if owner == "*" else owner


def applies(section: str, node: str) -> bool:
    """Return whether ROS gives a `section` to the `node` with this name and namespace, such as /cell/monitor."""
    parts = {"**": "(?:/[^/]+)*", "*": "/[^/]+"}
    pattern = "".join(parts.get(part, f"/{re.escape(part)}") for part in str(section).strip("/").split("/"))
    return re.fullmatch(pattern, node) is not None


def is_foreign(name: str, kind: type[BaseModel]) -> bool:
    """Return whether `name` is no field of `kind`: neither a present, misspelt or shortened one, nor one in a group."""
    if name in DESCRIPTIONS:
        return name not in kind.model_fields
    fields = flat_fields(kind)
    own = name.partition(".")[0] in kind.model_fields or any(field.startswith(name) for field in fields)
    return not (own or get_close_matches(name, fields, n=1, cutoff=0.8))


def _flat(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the `values` by name; nested mappings turn into dotted names."""
    for key, value in values.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield (f"{prefix}{key}" if prefix else key), value


def _grouped(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return `values` with dotted keys turned into nested mappings."""
    grouped: dict[str, Any] = {}
    for key, value in values.items():
        group, _, rest = str(key).partition(".")
        if rest and isinstance(grouped.setdefault(group, {}), dict):
            grouped[group][rest] = value
        elif isinstance(value, dict) and isinstance(grouped.get(group, {}), dict):
            grouped[group] = {**grouped.get(group, {}), **value}
        else:
            grouped[group] = value
    return grouped

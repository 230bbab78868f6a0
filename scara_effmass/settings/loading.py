"""Load and check settings from files and parameters; an error is one line."""

from collections.abc import Collection, Iterable, Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.fields import FieldInfo

from scara_effmass.errors import SettingsError

Settings = TypeVar("Settings", bound=BaseModel)

READ_ONLY: dict[str, Any] = {"read_only": True}
"""Marks a setting that cannot change on a running node, such as hardware and robot."""

NODE_ONLY = frozenset(
    {"robot", "autostart", "command_tolerance", "use_sim_time", "stop_at_end", "find_impacts", "report_folder"}
)
"""Parameters of nodes alone: a shared file may hold them, offline commands ignore them."""


def fixed(default: object, description: str, **limits: Any) -> Any:  # noqa: ANN401 - as pydantic's Field
    """Return the field of a setting that cannot change on a running node."""
    return Field(default, description=description, json_schema_extra=READ_ONLY, **limits)


def tunable(default: object, description: str, **limits: Any) -> Any:  # noqa: ANN401 - as pydantic's Field
    """Return the field of a setting that can change on a running node."""
    return Field(default, description=description, **limits)


class FrozenSettings(BaseModel):
    """Settings that refuse unknown names and numbers that are not finite. Raises ValidationError; see `checked`."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def checked(kind: type[Settings], values: Mapping[str, Any], origin: str) -> Settings:
    """Return the settings in `values`, whose groups are dotted keys ("filter.cutoff") or mappings.

    Raises SettingsError, in which `origin` names the file or node.
    """
    try:
        return kind.model_validate(_grouped(values))
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"]) or "settings"
        if first["type"] == "extra_forbidden":
            raise SettingsError(f"{origin}: {key}: unknown: {nearest(key, flat_fields(kind))}") from None
        value = "" if first["type"] == "missing" else f" = {first['input']!r}"
        raise SettingsError(f"{origin}: {key}{value}: {first['msg']}") from None


def flat_fields(settings: type[BaseModel], prefix: str = "") -> dict[str, FieldInfo]:
    """Return the fields of `settings` by ROS name; the fields of a group are dotted ("filter.cutoff")."""
    fields: dict[str, FieldInfo] = {}
    for name, field in settings.model_fields.items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            fields |= flat_fields(field.annotation, f"{prefix}{name}.")
        else:
            fields[f"{prefix}{name}"] = field
    return fields


def nearest(name: str, names: Iterable[str]) -> str:
    """Return the rule for an unknown `name`: the most similar of `names`, or all of them."""
    names = list(names)
    return f"must be {' or '.join(get_close_matches(name, names, n=1)) or ', '.join(names) or 'absent'}"


def load_settings(kind: type[Settings], path: Path, node: str, other_nodes: Collection[str] = ()) -> Settings:
    """Return the settings of `node` ("monitor") in the ROS parameter file at `path`.

    The file holds `/**`, `node` or `/**/node` over `ros__parameters`, as written by `ros2 param dump`. Parameters of
    other nodes are ignored; a file for `other_nodes` alone gives the defaults. Raises SettingsError.
    """
    try:
        document = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SettingsError(f"{path}: cannot be read: {error.strerror}") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise SettingsError(f"{path}: not YAML: {' '.join(str(error).split())}") from None
    if not isinstance(document, dict) or not document:
        raise SettingsError(f"{path}: must hold {node} (or /**) over ros__parameters")
    owners = {name: str(name).rpartition("/")[2] for name in document}
    sections = [name for name, owner in owners.items() if owner in {"**", node}]
    if not sections and not set(other_nodes).intersection(owners.values()):
        raise SettingsError(f"{path}: holds {', '.join(map(str, document))}: must hold {node} (or /**)")
    parameters: dict[str, Any] = {}
    for name in sections:
        section = document[name]
        if not isinstance(section, dict) or not isinstance(section.get("ros__parameters"), dict):
            raise SettingsError(f"{path}: {name}: must hold ros__parameters")
        items = section["ros__parameters"].items()
        parameters |= {key: value for key, value in items if key in kind.model_fields or key not in NODE_ONLY}
    return checked(kind, parameters, str(path))


def _grouped(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return `values` with dotted keys turned into nested mappings."""
    grouped: dict[str, Any] = {}
    for key, value in values.items():
        group, _, rest = str(key).partition(".")
        if rest and isinstance(grouped.setdefault(group, {}), dict):
            grouped[group][rest] = value
        elif isinstance(value, dict):
            grouped[group] = {**grouped.get(group, {}), **value}
        else:
            grouped[group] = value
    return grouped

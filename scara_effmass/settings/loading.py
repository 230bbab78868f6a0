"""Settings out of files and parameters: checked, and refused in one line."""

from __future__ import annotations

from difflib import get_close_matches
from typing import TYPE_CHECKING, Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from scara_effmass.errors import SettingsError

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping
    from pathlib import Path

    from pydantic.fields import FieldInfo

Settings = TypeVar("Settings", bound=BaseModel)

READ_ONLY: dict[str, Any] = {"read_only": True}
"""Marks a setting that a running node does not take over: hardware, the robot, and what is built from it."""

NODE_ONLY = frozenset({"autostart", "use_sim_time", "stop_at_end", "find_impacts", "report_folder"})
"""Parameters of the node itself, which a shared file may hold and offline commands have no use for."""


def checked(kind: type[Settings], values: Mapping[str, Any], origin: str) -> Settings:
    """Return the settings in `values`, whose groups are dotted keys ("filter.cutoff") or mappings.

    `origin` names the file or node in the SettingsError of a bad one.
    """
    try:
        return kind.model_validate(_grouped(values))
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"]) or "settings"
        if first["type"] == "extra_forbidden":
            raise SettingsError(f"{origin}: {key}: is not known; {nearest(key, flat_fields(kind))}") from None
        value = "" if first["type"] == "missing" else f" = {first['input']!r}"
        raise SettingsError(f"{origin}: {key}{value}: {first['msg']}") from None


def flat_fields(settings: type[BaseModel], prefix: str = "") -> dict[str, FieldInfo]:
    """Return the fields of `settings` under their ROS names; those of a group are dotted ("filter.cutoff")."""
    fields: dict[str, FieldInfo] = {}
    for name, field in settings.model_fields.items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            fields |= flat_fields(field.annotation, f"{prefix}{name}.")
        else:
            fields[f"{prefix}{name}"] = field
    return fields


def nearest(name: str, names: Iterable[str]) -> str:
    """Return what would be right instead of `name`: the most similar of `names`, or all of them."""
    names = list(names)
    similar = get_close_matches(name, names, n=1)
    return f"{similar[0]} would be right" if similar else f"there are {', '.join(names) or 'none'}"


def load_settings(kind: type[Settings], path: Path, node: str, others: Collection[str] = ()) -> Settings:
    """Return the settings of `node` ("monitor") in the YAML file at `path`, written as ROS writes parameters.

    The file holds `/**`, `node` or `/**/node` over `ros__parameters`, as `ros2 param dump` and launch files have it;
    what is there for other nodes is theirs. A file that is for `others` alone leaves the defaults. Raises
    SettingsError.
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
    if not sections and not set(others).intersection(owners.values()):
        raise SettingsError(f"{path}: holds {', '.join(map(str, document))}; {node} (or /**) would be right")
    parameters: dict[str, Any] = {}
    for name in sections:
        section = document[name]
        if not isinstance(section, dict) or not isinstance(section.get("ros__parameters"), dict):
            raise SettingsError(f"{path}: ros__parameters is missing under {name}")
        offline = {k: v for k, v in section["ros__parameters"].items() if k in kind.model_fields or k not in NODE_ONLY}
        parameters |= offline
    return checked(kind, parameters, str(path))


def _grouped(values: Mapping[str, Any]) -> dict[str, Any]:
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

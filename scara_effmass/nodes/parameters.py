# SPDX-License-Identifier: Apache-2.0
"""ROS parameters declared from a settings model, which states names, types, ranges and descriptions."""

from collections.abc import Mapping, Sequence
from contextvars import ContextVar
from dataclasses import asdict
from enum import Enum
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin

from pydantic.fields import FieldInfo
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter

from scara_effmass.errors import SettingsError
from scara_effmass.settings.loading import (
    FrozenSettings,
    applies,
    check_types,
    checked,
    choices,
    fixed,
    flat_fields,
    is_foreign,
    nearest,
    owner_of,
    parameter_sections,
)

ARGUMENTS: ContextVar[Sequence[str]] = ContextVar("arguments", default=())
"""ROS arguments of the process, which show where a parameter comes from."""
_ROS_PARAMETERS = ("use_sim_time", "start_type_description_service", "qos_overrides.")


class NodeParameters(FrozenSettings):
    """Parameters of every node."""

    autostart: bool = fixed(default=True, description="configure and activate at start")
    status_period: float = fixed(10.0, "period of the status line in the log [s]; 0: none", ge=0.0, le=86400.0)
    thread_priority: int = fixed(
        0, "priority of all threads under SCHED_FIFO, with memory locked; 0: neither, as other processes", ge=0, le=99
    )


Settings = TypeVar("Settings", bound=FrozenSettings)
Parameters = TypeVar("Parameters", bound=NodeParameters)


def declare(node: Node, settings: type[Settings]) -> Settings:
    """Declare every field of `settings` on `node` and return the settings: overrides or defaults.

    Raises SettingsError for an unknown parameter and for a value of the wrong type or range. Those that are stated for
    all nodes and resemble none of this one are ignored with a warning; settings without effect give one, too.
    """
    _require_own_sections(node)
    # A private attribute, because automatically_declare_parameters_from_overrides raises on an empty list.
    overrides: dict[str, Parameter] = node._parameter_overrides  # noqa: SLF001
    fields = flat_fields(settings)
    values = {name: from_ros(parameter) for name, parameter in overrides.items() if name in fields}
    others = [name for name in sorted(overrides) if name not in fields and not name.startswith(_ROS_PARAMETERS)]
    shared = _shared_names(node.get_name()) if others else ()
    for name in others:
        if name in shared and is_foreign(name, settings):
            node.get_logger().warning(f"parameter {name!r} of /** is not of this node: ignored")
        else:
            raise SettingsError(f"{node.get_name()}: no parameter {name!r}: {nearest(name, fields)}")
    check_types(settings, values, node.get_name())
    checked_settings = checked(settings, values, node.get_name())
    for line in checked_settings.without_effect():
        node.get_logger().warning(line)
    for name, field in fields.items():
        parameter = _parameter(name, values.get(name, field.default))
        # Declare the type, then set the value: rclpy cannot infer the type of an empty list.
        node.declare_parameter(name, parameter.type_, ignore_override=True)
        node.set_parameters([parameter])
        node.set_descriptor(name, _descriptor(name, field))
    return checked_settings


def changed_settings(current: Settings, changes: Sequence[Parameter], node: str) -> Settings:
    """Return `current` with the `changes` of `node`. Raises SettingsError."""
    model = type(current)
    fields = flat_fields(model)
    values = {change.name: from_ros(change) for change in changes if change.name in fields}
    return checked(model, {**current.model_dump(exclude_unset=True), **values}, node)


def _shared_names(node: str) -> set[str]:
    """Return the names that are stated for all nodes, and not for `node` itself.

    A parameter file states them under `/**`, and SetParameter of a launch file by `-p` without the name of a node.
    """
    shared, own = set[str](), set[str]()
    for option, value in pairwise(ARGUMENTS.get()):
        if option in {"-p", "--param"}:
            owner, _, name = value.partition(":=")[0].rpartition(":")
            (own if owner else shared).add(name)
        elif option == "--params-file":
            for name, parameters in parameter_sections(Path(value), node):
                (shared if owner_of(name) == "**" else own).update(parameters)
    return shared - own


def _require_own_sections(node: Node) -> None:
    """Raise SettingsError for a parameter file that is for `node` in another namespace: ROS would not apply it."""
    own = node.get_fully_qualified_name()
    for option, path in pairwise(ARGUMENTS.get()):
        if option != "--params-file":
            continue
        sections = [name for name, _ in parameter_sections(Path(path), node.get_name()) if owner_of(name) != "**"]
        if sections and not any(applies(name, own) for name in sections):
            hint = f"must be {own} or /**/{node.get_name()}, or start the node with -r __ns:=NAMESPACE"
            raise SettingsError(f"{path}: {', '.join(sections)}: {hint}")


def from_ros(parameter: Parameter) -> Any:  # noqa: ANN401 - the settings model checks the type
    """Return the value of `parameter` for a settings model."""
    if parameter.type_ is Parameter.Type.NOT_SET:
        return ()  # as ROS passes an empty list from a file or command line
    return tuple(parameter.value) if parameter.type_.name.endswith("_ARRAY") else parameter.value


def _parameter(name: str, value: Any) -> Parameter:  # noqa: ANN401
    """Return a setting as a ROS parameter."""
    if isinstance(value, tuple):
        numbers = value and isinstance(value[0], float)
        return Parameter(name, Parameter.Type.DOUBLE_ARRAY if numbers else Parameter.Type.STRING_ARRAY, list(value))
    return Parameter(name, value=value.value if isinstance(value, Enum) else value)


def _descriptor(name: str, field: FieldInfo) -> ParameterDescriptor:
    extra, annotation = field.json_schema_extra, field.annotation
    descriptor = ParameterDescriptor(
        name=name,
        type=_parameter(name, field.default).type_.value,
        description=field.description or "",
        read_only=isinstance(extra, dict) and bool(extra.get("read_only")),
    )
    if names := choices(field):
        descriptor.additional_constraints = f"one of {', '.join(names)}"
    elif annotation is float:
        # ROS cannot express an open end; the settings model refuses it.
        bounds = _bounds(field.metadata)
        low, high = bounds.get("ge", bounds.get("gt", 0.0)), bounds.get("le", 1e6)
        descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
        descriptor.additional_constraints = f"above {low:g}" if "gt" in bounds else ""
    elif annotation is int:
        descriptor.additional_constraints = _from_to(_bounds(field.metadata))
    elif descriptor.type == Parameter.Type.DOUBLE_ARRAY.value:
        bounds = _bounds(get_args(annotation)[0].__metadata__[0].metadata)
        descriptor.additional_constraints = f"list of {len(field.default)} numbers {_from_to(bounds)}"
    elif get_origin(annotation) is tuple:
        descriptor.additional_constraints = "list of names"
    return descriptor


def _bounds(limits: Sequence[Any]) -> dict[str, float]:
    """Return the limits of a number by kind: ge, gt, le."""
    return {key: float(value) for limit in limits for key, value in asdict(limit).items()}


def _from_to(bounds: Mapping[str, float]) -> str:
    return f"from {bounds['ge']:g}" + (f" to {bounds['le']:g}" if "le" in bounds else "")

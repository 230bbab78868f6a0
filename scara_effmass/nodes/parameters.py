"""ROS parameters made from a settings model: names, types, ranges and descriptions are stated there, once."""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING, Any, get_origin

import annotated_types
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.parameter import Parameter

from scara_effmass.errors import SettingsError

if TYPE_CHECKING:
    from pydantic import BaseModel
    from pydantic.fields import FieldInfo
    from rclpy.node import Node

_OF_EVERY_NODE = ("use_sim_time", "start_type_description_service", "qos_overrides.")


def declare(node: Node, settings: type[BaseModel]) -> dict[str, Any]:
    """Declare every field of `settings` on `node` and return the values given to it, defaults included.

    `node` must have been made with automatically_declare_parameters_from_overrides, so that a parameter that was
    given but does not exist is noticed. Raises SettingsError for that, and for a value of the wrong type or range.
    """
    given = set(node.get_parameters_by_prefix(""))
    unknown = [name for name in sorted(given) if name not in settings.model_fields and not name.startswith(_OF_EVERY_NODE)]
    if unknown:
        raise SettingsError(f"{node.get_name()}: no parameter {unknown[0]!r}: it has {', '.join(settings.model_fields)}")
    values = {}
    for name, field in settings.model_fields.items():
        if name in given:
            node.undeclare_parameter(name)
        default = field.default
        descriptor = _descriptor(name, field)
        try:
            if default == ():
                # rclpy cannot tell the type of an empty list: the parameter starts out as not set.
                node.declare_parameter(name, Parameter.Type.STRING_ARRAY, descriptor)
                parameter = node.get_parameter_or(name, Parameter(name, Parameter.Type.STRING_ARRAY, []))
            else:
                parameter = node.declare_parameter(name, to_ros(default), descriptor)
        except (InvalidParameterTypeException, InvalidParameterValueException) as error:
            raise SettingsError(f"{node.get_name()}: parameter {name}: {' '.join(str(error).split())}") from None
        values[name] = from_ros(parameter)
    return values


def from_ros(parameter: Parameter) -> Any:  # noqa: ANN401  what ROS holds, before the settings model checks it
    """Return the value of `parameter` as a settings model takes it."""
    value = parameter.value
    return tuple(value) if parameter.type_ is Parameter.Type.STRING_ARRAY else value


def to_ros(value: Any) -> Any:  # noqa: ANN401
    """Return a setting's value as a ROS parameter holds it."""
    if isinstance(value, Enum):
        return value.value
    return list(value) if isinstance(value, tuple) else value


def _descriptor(name: str, field: FieldInfo) -> ParameterDescriptor:
    extra = field.json_schema_extra
    descriptor = ParameterDescriptor(
        name=name,
        description=field.description or "",
        read_only=isinstance(extra, dict) and bool(extra.get("read_only")),
    )
    annotation = field.annotation
    if isinstance(annotation, type) and issubclass(annotation, Enum):
        descriptor.additional_constraints = "one of " + ", ".join(member.value for member in annotation)
    elif annotation is float:
        descriptor.floating_point_range = [_range(field)]
    elif get_origin(annotation) is tuple:
        descriptor.additional_constraints = "list of names"
    return descriptor


def _range(field: FieldInfo) -> FloatingPointRange:
    """Return the closed range; the settings model refuses an open end that ROS cannot express."""
    bounds = FloatingPointRange(from_value=0.0, to_value=1e6)
    for constraint in field.metadata:
        if isinstance(constraint, annotated_types.Ge):
            bounds.from_value = float(constraint.ge)  # type: ignore[arg-type]
        elif isinstance(constraint, annotated_types.Le):
            bounds.to_value = float(constraint.le)  # type: ignore[arg-type]
    return bounds

"""ROS parameters made from a settings model: names, types, ranges and descriptions are stated there, once."""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING, Any, get_origin

import annotated_types
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor, SetParametersResult
from rclpy.exceptions import InvalidParameterValueException
from rclpy.parameter import Parameter

from scara_effmass.errors import EffmassError, SettingsError
from scara_effmass.settings.loading import checked, flat_fields, nearest

if TYPE_CHECKING:
    from collections.abc import Callable
    from collections.abc import Set as AbstractSet

    from pydantic import BaseModel
    from pydantic.fields import FieldInfo
    from rclpy.node import Node

    from scara_effmass.settings.loading import Settings

_OF_EVERY_NODE = ("use_sim_time", "start_type_description_service", "qos_overrides.")


def declare(node: Node, settings: type[BaseModel]) -> dict[str, Any]:
    """Declare every field of `settings` on `node` and return the values given to it by name, defaults included.

    Raises SettingsError for a parameter that was given but does not exist, and for a value of the wrong type or range.
    """
    # Private, but the public way, automatically_declare_parameters_from_overrides, raises on an empty list.
    given: dict[str, Parameter] = node._parameter_overrides  # noqa: SLF001
    fields = flat_fields(settings)
    unknown = [name for name in sorted(given) if name not in fields and not name.startswith(_OF_EVERY_NODE)]
    if unknown:
        raise SettingsError(f"{node.get_name()}: no parameter {unknown[0]!r}: {nearest(unknown[0], fields)}")
    return {name: from_ros(_declared(node, name, field, given.get(name))) for name, field in fields.items()}


def on_parameters_changed(
    node: Node,
    current: Callable[[], Settings],
    take: Callable[[Settings, AbstractSet[str]], None],
    judge: Callable[[Settings], object] = lambda _: None,
) -> None:
    """Have `take` called with the `current` settings, and the names of those that were set, whenever any are set.

    A change at which the settings model or `judge` raises an EffmassError is refused, with that as its reason.
    """

    def changed(changes: list[Parameter]) -> Settings:
        settings = current()
        kind = type(settings)
        values = {p.name: from_ros(p) for p in changes if p.name in kind.model_fields}
        return checked(kind, {**settings.model_dump(), **values}, node.get_name())

    def judged(changes: list[Parameter]) -> SetParametersResult:
        try:
            judge(changed(changes))
        except EffmassError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(judged)
    node.add_post_set_parameters_callback(lambda changes: take(changed(changes), {p.name for p in changes}))


def from_ros(parameter: Parameter) -> Any:  # noqa: ANN401  what ROS holds, before the settings model checks it
    """Return the value of `parameter` as a settings model takes it."""
    value = parameter.value
    return tuple(value) if parameter.type_ is Parameter.Type.STRING_ARRAY else value


def _declared(node: Node, name: str, field: FieldInfo, given: Parameter | None) -> Parameter:
    """Declare one field with its default, or with what was `given` for it."""
    default = _parameter(name, field.default)
    if given is None:
        given = default
    elif given.type_ is Parameter.Type.NOT_SET and isinstance(field.default, tuple):
        # What ROS makes of an empty list in a file or on a command line.
        given = _parameter(name, ())
    if given.type_ is not default.type_:
        integer = given.type_ is Parameter.Type.INTEGER and default.type_ is Parameter.Type.DOUBLE
        point = f": write {given.value}.0" if integer else ""
        raise SettingsError(
            f"{node.get_name()}: {name} = {given.value!r}: must be {default.type_.name}, is {given.type_.name}{point}"
        )
    descriptor = _descriptor(name, field)
    try:
        # Declared by its type, then set: of an empty list as a default, rclpy could not tell the type.
        node.declare_parameter(name, default.type_, ignore_override=True)
        node.set_parameters([given])
        node.set_descriptor(name, descriptor)
    except InvalidParameterValueException:
        (bounds,) = descriptor.floating_point_range
        raise SettingsError(
            f"{node.get_name()}: {name} = {given.value!r}: must be {bounds.from_value:g} to {bounds.to_value:g}"
        ) from None
    return given


def _parameter(name: str, value: Any) -> Parameter:  # noqa: ANN401
    """Return a setting as a ROS parameter holds it."""
    if isinstance(value, tuple):
        return Parameter(name, Parameter.Type.STRING_ARRAY, list(value))
    return Parameter(name, value=value.value if isinstance(value, Enum) else value)


def _descriptor(name: str, field: FieldInfo) -> ParameterDescriptor:
    extra = field.json_schema_extra
    descriptor = ParameterDescriptor(
        name=name,
        type=_parameter(name, field.default).type_.value,
        description=field.description or "",
        read_only=isinstance(extra, dict) and bool(extra.get("read_only")),
    )
    annotation = field.annotation
    if isinstance(annotation, type) and issubclass(annotation, Enum):
        descriptor.additional_constraints = "one of " + ", ".join(member.value for member in annotation)
    elif annotation is float:
        _set_range(descriptor, field)
    elif get_origin(annotation) is tuple:
        descriptor.additional_constraints = "list of names"
    return descriptor


def _set_range(descriptor: ParameterDescriptor, field: FieldInfo) -> None:
    """State the closed range; the settings model refuses the end of an open one, which ROS cannot express."""
    bounds = FloatingPointRange(from_value=0.0, to_value=1e6)
    for constraint in field.metadata:
        if isinstance(constraint, annotated_types.Ge):
            bounds.from_value = float(constraint.ge)  # type: ignore[arg-type]
        elif isinstance(constraint, annotated_types.Gt):
            bounds.from_value = float(constraint.gt)  # type: ignore[arg-type]
            descriptor.additional_constraints = f"above {bounds.from_value:g}"
        elif isinstance(constraint, annotated_types.Le):
            bounds.to_value = float(constraint.le)  # type: ignore[arg-type]
    descriptor.floating_point_range = [bounds]

"""ROS parameters declared from a settings model, which states names, types, ranges and descriptions."""

from collections.abc import Callable
from collections.abc import Set as AbstractSet
from enum import Enum
from typing import Any, get_origin

import annotated_types
from pydantic.fields import FieldInfo
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor, SetParametersResult
from rclpy.exceptions import InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter

from scara_effmass.errors import EffmassError, SettingsError
from scara_effmass.settings.loading import Settings, checked, flat_fields, nearest

_ROS_PARAMETERS = ("use_sim_time", "start_type_description_service", "qos_overrides.")


def declare(node: Node, settings: type[Settings]) -> Settings:
    """Declare every field of `settings` on `node` and return the settings: overrides or defaults.

    Raises SettingsError for an unknown parameter and for a value of the wrong type or range.
    """
    # A private attribute, because automatically_declare_parameters_from_overrides raises on an empty list.
    overrides: dict[str, Parameter] = node._parameter_overrides  # noqa: SLF001
    fields = flat_fields(settings)
    unknown = [name for name in sorted(overrides) if name not in fields and not name.startswith(_ROS_PARAMETERS)]
    if unknown:
        raise SettingsError(f"{node.get_name()}: no parameter {unknown[0]!r}: {nearest(unknown[0], fields)}")
    values = {name: from_ros(_declared(node, name, field, overrides.get(name))) for name, field in fields.items()}
    return checked(settings, values, node.get_name())


def on_parameters_changed(
    node: Node,
    current: Callable[[], Settings],
    apply: Callable[[Settings, AbstractSet[str]], None],
    validate: Callable[[Settings], object] = lambda _: None,
) -> None:
    """Call `apply` with the new settings and the names of the changed parameters after every change.

    Refuse a change if the settings model or `validate` raises EffmassError, whose text becomes the reason.
    """

    def changed(changes: list[Parameter]) -> Settings:
        settings = current()
        model = type(settings)
        values = {p.name: from_ros(p) for p in changes if p.name in model.model_fields}
        return checked(model, {**settings.model_dump(), **values}, node.get_name())

    def on_set(changes: list[Parameter]) -> SetParametersResult:
        try:
            validate(changed(changes))
        except EffmassError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(on_set)
    node.add_post_set_parameters_callback(lambda changes: apply(changed(changes), {p.name for p in changes}))


def from_ros(parameter: Parameter) -> Any:  # noqa: ANN401 - the settings model checks the type
    """Return the value of `parameter` for a settings model."""
    value = parameter.value
    return tuple(value) if parameter.type_ is Parameter.Type.STRING_ARRAY else value


def _declared(node: Node, name: str, field: FieldInfo, override: Parameter | None) -> Parameter:
    """Declare one field and return its parameter: `override` or the default."""
    default = _parameter(name, field.default)
    parameter = default if override is None else override
    if parameter.type_ is Parameter.Type.NOT_SET and isinstance(field.default, tuple):
        # ROS passes an empty list from a file or command line as NOT_SET.
        parameter = _parameter(name, ())
    if parameter.type_ is not default.type_:
        is_integer = parameter.type_ is Parameter.Type.INTEGER and default.type_ is Parameter.Type.DOUBLE
        hint = f": write {parameter.value}.0" if is_integer else ""
        rule = f"must be {default.type_.name}, is {parameter.type_.name}{hint}"
        raise SettingsError(f"{node.get_name()}: {name} = {parameter.value!r}: {rule}")
    descriptor = _descriptor(name, field)
    try:
        # Declare the type, then set the value: rclpy cannot infer the type of an empty list.
        node.declare_parameter(name, default.type_, ignore_override=True)
        node.set_parameters([parameter])
        node.set_descriptor(name, descriptor)
    except InvalidParameterValueException:
        (bounds,) = descriptor.floating_point_range
        raise SettingsError(
            f"{node.get_name()}: {name} = {parameter.value!r}: must be {bounds.from_value:g} to {bounds.to_value:g}"
        ) from None
    return parameter


def _parameter(name: str, value: Any) -> Parameter:  # noqa: ANN401
    """Return a setting as a ROS parameter."""
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
    """Set the closed range. ROS cannot express an open end; the settings model refuses it."""
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

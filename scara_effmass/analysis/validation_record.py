"""Validation as JSON: all results in SI units; numbers are finite or null."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import fields, is_dataclass
from typing import TYPE_CHECKING, Any

from scara_effmass import __version__
from scara_effmass.impacts.result import ModelResult

if TYPE_CHECKING:
    from scara_effmass.analysis.validation import Validation, ValidationSettings
    from scara_effmass.model.robot import Robot

UNITS = {
    "force": "N",
    "mass": "kg",
    "speed": "m/s",
    "stiffness": "N/m",
    "bias": "N",
    "rmse": "N",
    "limits": "N",
    "spread": "unit of the quantity",
    "stamp_ns": "ns, ROS time",
}
FIRST = ("count", "correlation", "fitted_stiffness", "exponent", "bias", "rmse", "non_conservative")


def record(validation: Validation, settings: ValidationSettings, robot: Robot) -> dict[str, Any]:
    """Return all results of `validation`, the models first, with settings and robot."""
    result = validation.result
    whole = _plain({name: getattr(result, name) for name in result._fields if name not in {"models", "impacts"}})
    names = validation.names()
    impacts = [{"recording": name, **_plain(impact)} for name, impact in zip(names, result.impacts, strict=True)]
    return {
        "models": [_model(model) for model in result.models],
        "accepted": result.accepted,
        "reason": result.reason,
        "judged_model": result.model,
        **{key: value for key, value in whole.items() if key not in {"model", "accepted", "reason"}},
        "impacts": impacts,
        "recordings": [_plain(recording._asdict(), without=("impacts",)) for recording in validation.recordings],
        "criterion": settings.validator.criterion.model_dump(mode="json"),
        "settings": {
            "monitor": settings.monitor.model_dump(mode="json"),
            "validator": settings.validator.model_dump(mode="json"),
            "detection": settings.detection.model_dump(mode="json"),
            "obstacle_mass": settings.obstacle_mass,
        },
        "robot": {"name": robot.name, "origin": robot.origin, "notes": list(robot.notes)},
        "units": UNITS,
        "scara_effmass": __version__,
    }


def _model(model: ModelResult) -> dict[str, Any]:
    overall = _plain(model.overall)
    return {
        "model": model.model,
        **{name: overall.pop(name) for name in FIRST},
        "accepted": model.accepted,
        "reason": model.reason,
        **overall,
        "by_configuration": _plain(model.by_configuration),
        "by_obstacle_mass": _plain(model.by_obstacle_mass),
    }


def _plain(value: Any, without: Iterable[str] = ()) -> Any:  # noqa: ANN401 - any part of a result
    """Return `value` as JSON types; fields of tuples and dataclasses become keys."""
    if is_dataclass(value):
        value = {field.name: getattr(value, field.name) for field in fields(value)}
    elif hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, dict):
        named = ((f"{key:g}" if isinstance(key, float) else str(key), item) for key, item in value.items())
        return {key: _plain(item) for key, item in named if key not in without}
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, bool | int | str) else str(value)

# SPDX-License-Identifier: Apache-2.0
"""Convert ImpactValidation messages from `ValidatedImpact`, and their statistics to `SeriesStatistics`."""

from dataclasses import fields
from typing import Any

from scara_effmass_msgs import msg

from scara_effmass.values import SeriesStatistics, ValidatedImpact
from scara_effmass.wire.cdr import sec_and_nanosec

_SERIES = [field.name for field in fields(SeriesStatistics)]
_IMPACT = [name for name in msg.ImpactValidation.get_fields_and_field_types() if name not in {"header", "series"}]


def impact_validation_message(impact: ValidatedImpact) -> msg.ImpactValidation:
    """Return the message of a validated impact."""
    message = msg.ImpactValidation(**{name: getattr(impact, name) for name in _IMPACT})
    message.header.stamp.sec, message.header.stamp.nanosec = sec_and_nanosec(impact.stamp_ns)
    message.header.frame_id = impact.frame_id
    message.series = msg.SeriesStatistics(**{name: getattr(impact.series, name) for name in _SERIES})
    return message


def series_from(message: msg.SeriesStatistics) -> SeriesStatistics:
    """Return the statistics in `message`."""
    return SeriesStatistics(*(_plain(getattr(message, name)) for name in _SERIES))


def _plain(value: Any) -> Any:  # noqa: ANN401 - of any field
    return tuple(map(float, value)) if hasattr(value, "__len__") and not isinstance(value, str) else value

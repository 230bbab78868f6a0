"""The report of a validation as one page."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

from scara_effmass import __version__
from scara_effmass.analysis.page import bullets, document, figure, table
from scara_effmass.analysis.validation_scope import demands, limits, origin
from scara_effmass.analysis.validation_tables import groups, impacts, left_out, models, recordings, truth

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from pydantic import BaseModel

    from scara_effmass.analysis.page import Picture
    from scara_effmass.analysis.validation import Validation, ValidationSettings
    from scara_effmass.impacts.result import Result
    from scara_effmass.model.robot import Robot

TITLE = "Prediction against measurement"
STYLE = """
.verdict { padding: .8rem 1rem; border-left: 6px solid; font-size: 18px }
.dense th, .dense td { font-size: 11px; padding: .2rem .3rem }
@media print { .dense th, .dense td { font-size: 7px; padding: .1rem .15rem } }
.accepted { color: #00664a; background: #eef8f4 } .refused { color: #b03a00; background: #fdf3ee }
"""


def page(validation: Validation, pictures: Sequence[Picture], settings: ValidationSettings, robot: Robot) -> str:
    """Return the page as HTML."""
    result = validation.result
    parts = [
        _verdict(result),
        table(("this report", ""), _facts(validation, settings, robot)),
        "<h2>Limits of validity</h2>",
        bullets(limits(validation, settings, robot)),
        "<h2>Models</h2>",
        models(result),
        f"<p>On the same {result.comparison.count} impacts: {escape(result.comparison.text)}.</p>",
        *map(figure, pictures[:1]),
        *groups(result),
        *map(figure, pictures[1:]),
        *truth(validation),
        "<h2>Left out</h2>",
        left_out(result),
        "<h2>Impacts</h2>",
        *impacts(validation),
        "<h2>Recordings</h2>",
        recordings(validation),
        "<h2>Settings</h2><p>Monitor settings at their defaults are not shown; report.json has them all.</p>",
        table(("setting", "value"), _settings_rows(settings)),
    ]
    return document(TITLE, "\n".join(parts), STYLE)


def _verdict(result: Result) -> str:
    kind, text = ("accepted", "Accepted") if result.accepted else ("refused", f"Not accepted: {result.reason}")
    about = f"{result.model} model, {origin(result)}."
    return f'<p class="verdict {kind}"><b>{escape(text)}.</b><br>{escape(about)}</p>'


def _facts(validation: Validation, settings: ValidationSettings, robot: Robot) -> Iterator[tuple[str, str]]:
    result = validation.result
    yield "validated", f"{result.model} model of {robot.name}, contact point {result.contact_point or 'none seen'}"
    yield "against", origin(result)
    yield "impacts", f"{result.seen} found, {len(result.impacts)} in the series, {len(result.refused)} left out"
    yield "criterion", f"{'; '.join(demands(settings.validator.criterion))} (hash {result.criterion_hash})"
    if result.clock:
        yield "clocks", result.clock
    if result.force_sign:
        yield "sign of the force", result.force_sign
    if result.other_contact_points:
        yield "not validated", f"other contact points: {', '.join(result.other_contact_points)}"
    if result.late_states:
        yield "contact states", f"{result.late_states} came out of order and were left out"
    yield "robot file", robot.origin
    count = len(validation.recordings)
    yield "recordings", f"{count}, listed below" if count else "none: the series was live"
    yield "software", f"scara_effmass {__version__}"


def _settings_rows(settings: ValidationSettings) -> Iterator[tuple[str, str]]:
    if settings.obstacle_mass is not None:
        yield "obstacle mass for all recordings", f"{settings.obstacle_mass:g} kg"
    yield from _rows("validator", settings.validator, only_changed=False)
    yield from _rows("daq: detection", settings.detection, only_changed=False)
    yield from _rows("monitor", settings.monitor, only_changed=True)


def _rows(section: str, settings: BaseModel, *, only_changed: bool) -> Iterator[tuple[str, str]]:
    defaults = type(settings)().model_dump(mode="json")
    for name, value in settings.model_dump(mode="json").items():
        if isinstance(value, dict):
            yield from ((f"{section}: {name}.{key}", f"{each}") for key, each in value.items())
        elif not only_changed or value != defaults[name]:
            yield f"{section}: {name}", "(empty)" if value == "" else f"{value}"

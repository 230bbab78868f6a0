# SPDX-License-Identifier: Apache-2.0
"""Measurement protocol of contact forces for tests by ISO/PAS 5672 and RIA TR R15.806: schema, YAML, test points.

Any field may be empty while a protocol is being filled in; `missing` names the empty ones. `Plan` proposes test points:
for each region the contacts with the largest force / limit.
"""

import math
import os
from collections.abc import Iterable, Iterator, Mapping
from datetime import date
from functools import cache, partial
from pathlib import Path
from textwrap import wrap
from typing import Annotated, Any, NamedTuple

import yaml
from pydantic import AfterValidator, AwareDatetime, BaseModel, Field, model_validator

from scara_effmass.errors import SettingsError
from scara_effmass.input_files import read_yaml
from scara_effmass.iso15066 import (
    BODY_REGIONS,
    EDITION,
    TABLE_HASH,
    Limit,
    contact_area,
    limits_for,
    peak_force,
    reduced_mass,
    speed_limit_of_mass,
)
from scara_effmass.settings import ContactType, ImportSettings, MonitorSettings, checked
from scara_effmass.settings.loading import FrozenSettings
from scara_effmass.values import ContactAssessment, Vector3, Verdict
from scara_effmass.wire.cdr import MAX_SEC

MIN_REPETITIONS = 3
"""Fewest contacts of a test point."""
MIN_POSE_DISTANCE = 0.1
"""Smallest difference in a joint position [rad, m] between two proposals at one contact point for one region."""
HEADER = """\
Measurement protocol of contact forces (ISO/PAS 5672, RIA TR R15.806). Replace each null; `scara-effmass protocol fill`
enters recorded contacts and evaluates, `protocol report` renders. A missing value makes the verdict UNKNOWN.
For completion in an editor: scara-effmass protocol schema > protocol.schema.json, and as the first line of this file
yaml-language-server: $schema=protocol.schema.json"""

Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]
MAX_FORCE_N = 1e6
Force = Annotated[float, Field(ge=0.0, le=MAX_FORCE_N)]
MAX_SPEED_M_S = 100.0
"""A larger speed was entered in mm/s."""
Speed = Annotated[float, Field(gt=0.0, le=MAX_SPEED_M_S)]
Stiffness = Annotated[float, Field(ge=1e3, le=1e7)]
"""Stiffness of a spring [N/m]; one of 75 was entered in N/mm, one of 75e6 was converted twice."""
Area = Annotated[float, Field(ge=1e-8, le=0.1)]
"""Contact area [m2]."""
Text = Annotated[str, Field(min_length=1)]


def stated(description: str) -> Any:  # noqa: ANN401 - as pydantic's Field
    """Return a field that a complete protocol states."""
    return Field(None, description=description)


def optional(description: str) -> Any:  # noqa: ANN401 - as pydantic's Field
    """Return a field that a complete protocol may leave out."""
    return Field(None, description=description, json_schema_extra={"optional": True})


def _known_region(name: str) -> str:
    limits_for(MonitorSettings(body_regions=(name,)))  # raises LimitError, a ValueError
    return name


def _import_settings(values: dict[str, Any]) -> dict[str, Any]:
    try:
        checked(ImportSettings, values, "")
    except SettingsError as error:
        raise ValueError(str(error).removeprefix(": ")) from None
    return values


def _not_zero(vector: Vector3) -> Vector3:
    if not any(vector):
        raise ValueError("must not be all 0")
    return vector


class Identity(FrozenSettings):
    """What was tested, by whom, when, and by which standard."""

    robot_model: Text | None = stated("maker and model of the robot")
    robot_serial: Text | None = stated("serial number of the robot")
    firmware: Text | None = stated("version of the controller's software")
    safety_checksum: Text | None = stated("checksum of the safety configuration, as the controller shows it")
    operator: Text | None = stated("who measured")
    test_date: date | None = stated("date of the measurement, YYYY-MM-DD")
    report_number: Text | None = optional("number of the report")
    report_date: date | None = optional("date of the report, YYYY-MM-DD")
    site: Text | None = optional("where the cell is: company, address, hall")
    cell: Text | None = optional("cell or application, as the risk assessment names it")
    temperature_c: Annotated[float, Field(gt=-50.0, lt=100.0)] | None = optional("temperature at the measurement [°C]")
    standard: Text | None = stated("edition of the standard that states the limits")
    limits_hash: Text | None = stated("hash of the table of limits; `scara-effmass limits` prints it")


class Instrument(FrozenSettings):
    """Measuring device in one configuration of spring and damping."""

    id: Text = Field(description="name that the test points refer to")
    model: Text | None = stated("maker and model")
    serial: Text | None = stated("serial number")
    certificate: Text | None = optional("number of the calibration certificate")
    calibration_date: date | None = stated("date of the calibration, YYYY-MM-DD")
    calibration_due: date | None = stated("last day on which the calibration is valid, YYYY-MM-DD")
    stiffness_n_m: Stiffness | None = stated("stiffness of its spring [N/m]; 75 N/mm is 75000")
    damping: Text | None = stated('its damping, as "70 Shore A, 21 mm", "12 N s/m" or "none"')
    fixed: bool | None = stated("true: fixed to the ground; false: free to move")
    moving_mass_kg: Positive | None = optional("mass of a free device [kg]; null if it is fixed")
    sample_rate_hz: Positive | None = stated("sampling rate [Hz]")
    filter: Text | None = stated('filter of the force, as "CFC1000", "1 kHz low pass" or "none"')
    force_uncertainty: NotNegative | None = stated("expanded uncertainty (k = 2) of the force; 0.03 is 3 %")
    speed_uncertainty: NotNegative | None = stated("expanded uncertainty (k = 2) of the speed; 0.02 is 2 %")


class TestPoint(FrozenSettings):
    """Where the robot touches a person."""

    __test__ = False  # not a test of pytest

    contact_point: Text | None = stated("point of the robot that makes contact, as the robot model names it")
    body_region: Annotated[Text, AfterValidator(_known_region)] | None = stated(
        f"one of {', '.join(BODY_REGIONS)}; the standard permits no contact with skull_forehead and face"
    )
    contact: ContactType | None = stated("transient (free impact) or quasi_static (clamped)")
    hazard_id: Text | None = optional("id of the hazard in the risk assessment")
    tool: Text | None = optional("tool or workpiece that makes contact, as its name and number")
    geometry: Text | None = stated('shape of the surface, as "flat, edges r = 5 mm"')
    contact_area_m2: Area | None = stated("area of the contact [m2], for the limit of the pressure; 1 cm2 is 1e-4")
    radius_mm: NotNegative | None = stated("smallest radius of edges and corners [mm]")


class Motion(FrozenSettings):
    """How the robot moves in the test."""

    pose: dict[str, float] | None = stated("joint positions at the contact [rad, m], by joint")
    direction: Annotated[Vector3, AfterValidator(_not_zero)] | None = stated(
        "of the motion, in the base frame [x, y, z]"
    )
    commanded_speed_m_s: Speed | None = stated("commanded speed of the contact point [m/s]")
    payload_kg: NotNegative | None = stated("payload [kg]")
    safety_setting: Text | None = stated("safety function and its setting, as the stop by force at 80 N")


class Repetition(FrozenSettings):
    """One contact."""

    time: AwareDatetime | None = stated("time of the onset, ISO 8601 with zone, as 2026-11-22T14:03:12.5+01:00")
    raw_data: Text | None = stated("file or folder with the force, relative to this file")
    raw_sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")] | None = stated("SHA-256 of it; fill computes it")
    raw_channel: Text | None = optional("CSV column, TDMS channel or topic of the force in it; null: the only one")
    raw_unit: Annotated[str, Field(pattern="^(N|kN|daN|lbf|kgf|V|mV)$")] | None = optional(
        "unit of the force in it: N, kN, daN, lbf, kgf, V or mV; null: as the file states"
    )
    raw_offset_s: Annotated[float, Field(ge=-MAX_SEC, le=MAX_SEC)] | None = optional(
        "time to add to the stamps in it [s], if it has another clock"
    )
    raw_import: Annotated[dict[str, Any], AfterValidator(_import_settings)] | None = optional(
        "other settings of `scara-effmass import` that it needs, as {rate: 1000.0} or {sensor: {sensitivity: 2.31}}"
    )
    reached_speed_m_s: Speed | None = stated("speed of the contact point at the onset [m/s]")
    transient_peak_n: Force | None = stated("largest force in the first 0.5 s [N]")
    force_beyond_0_5_s_n: Force | None = stated("largest force after the first 0.5 s [N]; 0: it had ended")
    load_n: Force | None = optional("load from before the contact, which both forces include [N]; null: none")
    duration_s: Positive | None = stated("time above 10 % of the peak [s]")
    peak_pressure_n_cm2: NotNegative | None = optional(
        "largest pressure, if it was measured [N/cm2]; otherwise force over area is judged"
    )
    effective_mass_kg: Positive | None = optional(
        "predicted effective mass of the robot along the motion [kg]; needed if the device moves or is softer"
    )
    reduced_mass_kg: Positive | None = optional("predicted reduced mass mu of robot and device [kg]")
    predicted_force_n: Positive | None = optional("predicted peak force [N]")
    pose: dict[str, float] | None = optional("joint positions at the onset [rad, m], by joint")
    direction: Vector3 | None = optional("of the motion at the onset, in the base frame [x, y, z]")
    simulated: bool | None = stated("true: simulated, not measured")

    @property
    def residual(self) -> float | None:
        """Predicted / measured peak force of the impact - 1, without the load; None while one is missing."""
        measured = (self.transient_peak_n or 0.0) - (self.load_n or 0.0)
        return self.predicted_force_n / measured - 1.0 if self.predicted_force_n and measured > 0.0 else None


class LeftOutForce(FrozenSettings):
    """Force in the recordings, or a part of them, that is no contact of the test; fill enters it."""

    reason: Text = Field(description="why it is no contact of the test")
    count: int = Field(description="how often; peak and time are those of the largest force")
    raw_data: Text | None = optional("recording or file that holds it, relative to this file; null: all")
    raw_sha256: str | None = optional("SHA-256 of it")
    time: AwareDatetime | None = optional("time of the onset, or of the largest force")
    peak_n: Force | None = optional("largest force in the first 0.5 s [N]; null: not known")
    held_n: Force | None = optional("largest force after the first 0.5 s [N]; null: not known, or no contact")
    complete: bool = Field(description="false: the force may have been larger")


class Evaluation(FrozenSettings):
    """Result of a test point, which fill computes; do not edit."""

    verdict: str = Field(description="OK, WARN: above the limit within the uncertainty, VIOLATION or UNKNOWN")
    reasons: tuple[str, ...] = Field(description="why")
    converted: bool | None = stated("the device differs from the body region, to which the force was converted")
    judged_force_n: float | None = stated("largest transient force on the body region [N]")
    transient_limit_n: float | None = stated("its limit [N]")
    held_force_n: float | None = stated("largest force after 0.5 s [N]")
    quasi_static_limit_n: float | None = stated("its limit [N]")
    pressure_n_cm2: float | None = stated("largest measured pressure [N/cm2]")
    pressure_limit_n_cm2: float | None = stated("its limit [N/cm2]")
    ratio: float | None = stated("largest of the ratios of force or pressure to its limit")
    uncertainty: float | None = stated("relative expanded uncertainty (k = 2) of the force")
    budget: dict[str, float] | None = stated("its sources")
    residual: float | None = stated("mean of predicted / measured peak force - 1")


class Results(FrozenSettings):
    """What was measured."""

    repetitions: tuple[Repetition, ...] = Field((), description=f"at least {MIN_REPETITIONS} contacts")
    left_out: tuple[LeftOutForce, ...] = Field((), description="all other force in the recordings; do not edit")
    photos: tuple[Text, ...] | None = stated("files with photos of robot and device; []: none")
    deviations: Text | None = stated('deviations from the procedure; "none" if there are none')
    evaluation: Evaluation | None = optional("computed by fill; do not edit")


EMPTY = Results(repetitions=(Repetition(),) * MIN_REPETITIONS)


class ContactTest(FrozenSettings):
    """One test point with its results."""

    id: Text = Field(description="name of the test, unique")
    instrument: Text | None = stated("id of the instrument of the force")
    pressure_instrument: Text | None = optional("id of the instrument of the pressure; null: the same")
    speed_instrument: Text | None = optional("id of the instrument of the speed; null: the same")
    note: Text | None = optional("why this point was chosen")
    point: TestPoint = TestPoint()
    motion: Motion = Motion()
    results: Results = Results()

    def with_results(self, **changes: object) -> "ContactTest":
        """Return the test with `changes` of its results."""
        return self.model_copy(update={"results": self.results.model_copy(update=changes)})


class Protocol(FrozenSettings):
    """Measurement protocol of contact forces (ISO/PAS 5672, RIA TR R15.806)."""

    identity: Identity = Identity(standard=EDITION, limits_hash=TABLE_HASH)
    instruments: tuple[Instrument, ...] = Field((Instrument(id="device"),), description="measuring devices")
    tests: tuple[ContactTest, ...] = Field((ContactTest(id="1", instrument="device"),), description="test points")

    @model_validator(mode="after")
    def _check_ids(self) -> "Protocol":
        for items in (self.instruments, self.tests):
            ids = [item.id for item in items]
            if len(set(ids)) < len(ids):
                raise ValueError(f"id must be unique, but there are {', '.join(ids)}")
        return self

    def test(self, name: str) -> ContactTest:
        """Return the test `name`. Raises SettingsError."""
        for test in self.tests:
            if test.id == name:
                return test
        raise SettingsError(f"test = {name}: must be one of {', '.join(test.id for test in self.tests)}")

    def devices(self, test: ContactTest) -> dict[str, Instrument | None]:
        """Return the instruments of force, pressure and speed of `test` by id; None for an unknown one."""
        by_id = {item.id: item for item in self.instruments}
        names = test.instrument, test.pressure_instrument, test.speed_instrument
        return {name: by_id.get(name) for name in names if name}

    def device(self, test: ContactTest) -> Instrument | None:
        """Return the instrument of the force, None if the test names none or an unknown one."""
        return self.devices(test).get(test.instrument or "")

    def replaced(self, test: ContactTest) -> "Protocol":
        """Return the protocol with `test` in place of the test with the same id."""
        return self.model_copy(update={"tests": tuple(test if old.id == test.id else old for old in self.tests)})

    def moved(self, folder: Path, target: Path) -> "Protocol":
        """Return the protocol of `folder` for the folder `target`: its relative paths name the same files."""

        def path(name: str) -> str:
            is_absolute = Path(name).is_absolute()
            return name if is_absolute else os.path.relpath((folder / name).resolve(), target.resolve())

        def raw(items: Iterable[Repetition | LeftOutForce]) -> tuple[Repetition | LeftOutForce, ...]:
            return tuple(
                item.model_copy(update={"raw_data": path(item.raw_data)}) if item.raw_data else item for item in items
            )

        if folder.resolve() == target.resolve():
            return self
        tests = []
        for test in self.tests:
            results = test.results
            photos = results.photos and tuple(map(path, results.photos))
            changes = {"repetitions": raw(results.repetitions), "left_out": raw(results.left_out), "photos": photos}
            tests.append(test.with_results(**changes))
        return self.model_copy(update={"tests": tuple(tests)})


def read_protocol(path: Path) -> Protocol:
    """Return the protocol in the YAML file at `path`. Raises SettingsError."""
    content = read_yaml(path, SettingsError)
    if not isinstance(content, dict):
        raise SettingsError(f"{path}: must hold {', '.join(Protocol.model_fields)}")
    return checked(Protocol, content, str(path))


def missing(item: BaseModel, path: str = "") -> Iterator[str]:
    """Yield the dotted path of each empty field of `item` that a complete protocol states."""
    for name, field in type(item).model_fields.items():
        value, extra = getattr(item, name), field.json_schema_extra
        if value is None and not (isinstance(extra, dict) and extra.get("optional")):
            yield f"{path}{name}"
        elif isinstance(value, BaseModel) and not isinstance(value, Evaluation):
            yield from missing(value, f"{path}{name}.")
        elif isinstance(value, tuple):
            for number, part in enumerate(value, start=1):
                if isinstance(part, BaseModel):
                    yield from missing(part, f"{path}{name}.{getattr(part, 'id', number)}.")


def protocol_yaml(protocol: Protocol) -> str:
    """Return `protocol` as YAML, with meaning and unit of each field in a comment where it occurs first."""
    return "\n".join([f"# {line}" for line in HEADER.splitlines()] + ["", *_lines(protocol, "", set())]) + "\n"


def _lines(item: BaseModel, indent: str, explained: set[str]) -> Iterator[str]:
    for name, field in type(item).model_fields.items():
        key, value = f"{type(item).__name__}.{name}", getattr(item, name)
        if field.description and key not in explained:
            yield from wrap(field.description, 118, initial_indent=f"{indent}# ", subsequent_indent=f"{indent}# ")
            explained.add(key)
        if isinstance(value, BaseModel):
            yield f"{indent}{name}:"
            yield from _lines(value, f"{indent}  ", explained)
        elif isinstance(value, tuple) and any(isinstance(part, BaseModel) for part in value):
            yield f"{indent}{name}:"
            for part in value:
                lines = list(_lines(part, f"{indent}    ", explained))
                first = next(number for number, line in enumerate(lines) if not line.lstrip().startswith("#"))
                lines[first] = f"{indent}  - {lines[first].lstrip()}"
                yield from lines
        else:
            plain = item.model_dump(mode="json", include={name})[name]
            text = yaml.safe_dump([plain], default_flow_style=True, width=math.inf, allow_unicode=True)
            yield f"{indent}{name}: {text.strip()[1:-1]}"


class Candidate(NamedTuple):
    """Contact with a body region, and the `ratio` of its predicted force to the limit.

    `at_limit`: the test is to be run at the speed at which the ratio is 1.
    """

    ratio: float
    limit: Limit
    contact: ContactAssessment
    pose: Mapping[str, float]
    at_limit: bool

    def is_near(self, other: "Candidate") -> bool:
        """Return whether a test of one contact also covers the other."""
        distances = [abs(position - other.pose.get(joint, position)) for joint, position in self.pose.items()]
        return self.contact.contact_point == other.contact.contact_point and max(distances) < MIN_POSE_DISTANCE


def nearest_turn(
    pose: Mapping[str, float], turns: Mapping[str, float], stated: Mapping[str, float] | None = None
) -> dict[str, float]:
    """Return a `pose` by joint [rad, m], those of the joints in `turns` by whole turns next to `stated`, else to 0."""
    near = {joint: (stated or {}).get(joint, 0.0) for joint in pose}
    return {
        joint: near[joint] + math.remainder(position - near[joint], turns[joint])
        if joint in turns and math.isfinite(position)
        else position
        for joint, position in pose.items()
    }


class Plan:
    """Keeps the worst `count` contacts of each body region of `settings`, in different poses."""

    def __init__(self, settings: MonitorSettings, count: int) -> None:
        """Start empty. Raises LimitError."""
        self._settings, self._count = settings, count
        self.unknown = self.at_rest = 0
        self._worst: dict[str, list[Candidate]] = {limit.region: [] for limit in limits_for(settings)}
        self._limits = cache(partial(limits_for, settings))

    def add(self, contact: ContactAssessment, pose: Mapping[str, float], *, at_limit: bool = False) -> None:
        """Consider a contact in a `pose`, by joint [rad, m].

        A contact without a verdict only counts in `unknown`, one without a direction in `at_rest`.
        """
        if contact.verdict is Verdict.UNKNOWN or not any(contact.direction):
            self.unknown += contact.verdict is Verdict.UNKNOWN
            self.at_rest += contact.verdict is not Verdict.UNKNOWN
            return
        for limit in self._limits(contact.contact_point):
            worst = self._worst[limit.region]
            mu = reduced_mass(contact.effective_mass, limit.body_mass_kg)
            ratio = peak_force(contact.speed, mu, limit.stiffness_n_m) / limit.permissible_force_n
            if len(worst) == self._count and ratio <= worst[-1].ratio:
                continue
            candidate = Candidate(ratio, limit, contact, pose, at_limit)
            near = [other for other in worst if candidate.is_near(other)]
            if all(ratio > other.ratio for other in near):
                others = [other for other in worst if other not in near]
                worst[:] = sorted([*others, candidate], key=lambda item: -item.ratio)[: self._count]

    def protocol(self, robot_model: str) -> Protocol:
        """Return a protocol with an empty test for each contact, and a device for each stiffness of the regions."""
        tests, devices = [], {}
        for region, worst in self._worst.items():
            for number, candidate in enumerate(worst, start=1):
                device = f"{candidate.limit.stiffness_n_m / 1e3:g}_N_mm"
                devices[device] = Instrument(id=device)
                tests.append(self._test(f"{region}_{number}", device, candidate))
        identity = Identity(robot_model=robot_model, standard=EDITION, limits_hash=TABLE_HASH)
        if not tests:
            return Protocol(identity=identity, tests=(ContactTest(id="1", instrument="device", results=EMPTY),))
        return Protocol(identity=identity, instruments=tuple(devices.values()), tests=tuple(tests))

    def _test(self, name: str, device: str, candidate: Candidate) -> ContactTest:
        limit, contact, speed = candidate.limit, candidate.contact, candidate.contact.speed
        if candidate.at_limit:
            speed = speed_limit_of_mass((limit,), contact.effective_mass).allowable_speed
        mu = reduced_mass(contact.effective_mass, limit.body_mass_kg)
        force = peak_force(speed, mu, limit.stiffness_n_m)
        note = f"predicted: {force:.0f} N of {limit.permissible_force_n:.0f} N, mu {mu:.2f} kg"
        return ContactTest(
            id=name,
            instrument=device,
            note=note,
            point=TestPoint(
                contact_point=contact.contact_point,
                body_region=limit.region,
                contact=limit.contact,
                contact_area_m2=contact_area(self._settings, contact.contact_point),
            ),
            motion=Motion(
                pose={joint: round(position, 4) for joint, position in candidate.pose.items()} or None,
                direction=tuple(round(component, 4) + 0.0 for component in contact.direction),
                commanded_speed_m_s=round(speed, 4),
                payload_kg=self._settings.payload_mass,
            ),
            results=EMPTY,
        )

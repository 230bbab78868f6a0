# SPDX-License-Identifier: Apache-2.0
"""Validation of predicted peak forces against measured impacts, live and offline."""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, fields
from typing import NamedTuple, TypeVar

import numpy as np

from scara_effmass.impacts.agreement import (
    MIN_RELATIVE_RANGE,
    NO_REGION,
    Agreement,
    Comparison,
    MassFit,
    RegionForce,
    compare_models,
    model_agreement,
    model_fit,
    predict,
    region_force,
    static_force,
)
from scara_effmass.impacts.criterion import Series, criterion_hash, decide
from scara_effmass.impacts.impact_matcher import (
    CLIPPED,
    DUPLICATE,
    INCOMPLETE,
    PRESS,
    REBOUND,
    ImpactMatcher,
    MatchedImpact,
)
from scara_effmass.impacts.load import LOADS, NO_SIGNAL, reads_low
from scara_effmass.impacts.segment import STUCK
from scara_effmass.impacts.state_history import MODELS, ClockOffset, Rejection, clock_offset
from scara_effmass.iso15066 import limits_for
from scara_effmass.settings import ContactType, MassModel, ValidatorSettings
from scara_effmass.values import (
    ContactAssessment,
    Decision,
    ForceBlock,
    Impact,
    LeftOut,
    RefusedImpact,
    RunInfo,
    SeriesStatistics,
    ValidatedImpact,
)

Key = TypeVar("Key", str, float)

WRONG_SIGN_FORCE = 10.0
"""Minimum tensile force [N] that shows a wrong sign; it must also exceed WRONG_SIGN_RATIO times the maximum force."""
WRONG_SIGN_RATIO = 3.0


class ModelResult(NamedTuple):
    """Agreement of one effective-mass model with the series, overall and by group.

    Predictions of a group use the stiffness of the whole series. `reason` states why the model is not accepted;
    `decidable` is false if the series could not have shown an error.
    """

    model: str
    overall: Agreement
    fit: MassFit
    by_configuration: Mapping[str, Agreement]
    by_obstacle_mass: Mapping[float, Agreement]
    accepted: bool
    decidable: bool
    reason: str


class ComparedForces(NamedTuple):
    """Contacts whose forces were compared with limits: how many, how many exceed a limit, and the worst force."""

    contacts: int
    exceedances: int
    worst: RegionForce


class _Summary(NamedTuple):
    """Each model without its groups, the statistics of the selected one, the offset of the clocks, other forces."""

    models: Mapping[str, ModelResult]
    statistics: SeriesStatistics
    clock: ClockOffset
    left_out: ComparedForces


class Result(NamedTuple):
    """Result of the whole series; `seen` = number of `impacts` + sums of `excluded` and `unpaired` + `waiting`.

    `model` is the selected effective-mass model, to which `accepted` and `reason` refer. `models` are lumped, full and
    iso, and the selected one. Predictions in `impacts` use the stiffness of the whole series. `excluded` and `unpaired`
    count the impacts in `refused` by reason. `clock` and `force_sign` describe a problem with the clocks or the sign of
    the force; empty: none. `clock_offset` is that of the impacts in the series. `gain_tolerance` is that of the sensor.
    `held` are the contacts whose force stayed, in the series or left out. What stayed is compared with the quasi-static
    limits, as measured, and the first 0.5 s of a press, which is no impact, with the limits for impacts, as measured.
    `ac_coupled`: the converter removed a part of some contacts.
    `left_out` are the contacts left out of the series and the force in no impact; their peaks are converted with the
    most unfavourable impact of the series, without a series as measured. Rebounds no larger than their impact count
    with it. `exceedances` counts the impacts with a force above a limit, and those of `left_out`. `unmeasured` counts
    the contacts whose peak is not known, because they were clipped, incomplete or stuck, and once stretches without
    signal, as of an open sensor.
    """

    model: str
    contact_point: str
    models: tuple[ModelResult, ...]
    comparison: Comparison
    impacts: tuple[ValidatedImpact, ...]
    refused: tuple[RefusedImpact, ...]
    seen: int
    waiting: int
    simulated: int
    excluded: Mapping[str, int]
    unpaired: Mapping[str, int]
    other_contact_points: tuple[str, ...]
    late_states: int
    clock: str
    clock_offset: ClockOffset
    force_sign: str
    gain_tolerance: float
    held: ComparedForces
    ac_coupled: bool
    left_out: ComparedForces
    exceedances: int
    unmeasured: int
    accepted: bool
    decidable: bool
    reason: str
    criterion_hash: str

    @property
    def verdict(self) -> str:
        """One line: accepted, or the reason why not."""
        if self.accepted:
            return "accepted"
        return f"{'not accepted' if self.decidable else 'not decidable'}: {self.reason}"

    @property
    def held_alone(self) -> int:
        """Number of impacts above a limit only by the force that stayed."""
        return sum(impact.exceeds_limit and impact.region_force <= impact.limit_force for impact in self.impacts)

    @property
    def within_limits(self) -> bool:
        """Whether every force is known, and none is above a limit."""
        return not (self.exceedances or self.unmeasured)


class Validator:
    """Validate the effective-mass models against measured impacts; the same live and offline.

    Decisions and impacts must each arrive in order. Their interleaving does not change the result if an impact
    arrives within `settings.history` of the states around its onset. `runs` holds the conditions of the impacts.
    """

    def __init__(self, settings: ValidatorSettings) -> None:
        """Begin a series. Raises LimitError for body regions without a limit."""
        self.settings = settings
        self._limits = limits_for(settings.limit_settings)
        clamping = settings.limit_settings.model_copy(update={"contact": ContactType.QUASI_STATIC})
        self._held_limits = limits_for(clamping)
        self.criterion_hash = criterion_hash(settings.criterion)
        self._model = settings.effective_mass_model.value
        self._models = (*MODELS, self._model) if self._model not in MODELS else MODELS
        self._stiffness = settings.stiffness_n_m
        self._matcher = ImpactMatcher(settings)
        self.runs = self._matcher.runs
        self._contact_point = settings.contact_point
        self._contact_points: set[str] = set()
        self.left_out: tuple[LeftOut, ...] = ()
        """Force in no impact, along the normals of the plates."""
        self._matches: list[MatchedImpact] = []
        self._earlier = 0  # of them, those of earlier recordings
        self._min_force = self._max_force = self._stated_uncertainty = 0.0
        self._past_problems = "", ""
        self._ac_coupled = False

    def know(self, contact_points: Iterable[str]) -> None:
        """Name contact points whose states may not be added."""
        self._contact_points.update(contact_points)

    def leave_out(self, items: Iterable[LeftOut]) -> None:
        """Take the force that the detector of the caller found in no impact, in place of that taken before."""
        shares = ((item, self.runs.at(item.stamp_ns).usable_share) for item in items)
        self.left_out = tuple(
            item._replace(peak_force=item.peak_force / share, load_force=item.load_force / share)
            for item, share in shares
        )

    def add_decision(self, decision: Decision, received_ns: int) -> list[ValidatedImpact]:
        """Add a decision of the monitor that arrived at `received_ns` (0: unknown); return newly validated impacts."""
        contact = self._selected(decision)
        if contact is None:
            return []
        stamp_ns = decision.stamp_ns
        validated = self.begin_recording() if self._matcher.states.is_clock_reset(stamp_ns) else []
        self._matcher.states.add(stamp_ns, contact, received_ns)
        return validated + self._validate() if self._matcher.waiting else validated

    def _selected(self, decision: Decision) -> ContactAssessment | None:
        """Return the contact of the series, by default the first one of the first decision with a robot."""
        names = [contact.contact_point for contact in decision.contacts]
        if not self._contact_point and names[0]:
            self._contact_point = names[0]
            self._matcher.states.clear()
        self._contact_points.update(names)
        selected = self._contact_point
        return next((contact for contact in decision.contacts if contact.contact_point == selected), None)

    def add_impact(self, impact: Impact, received_ns: int) -> list[ValidatedImpact]:
        """Add an impact that arrived at `received_ns` (0: unknown); return newly validated impacts."""
        self._matcher.add_impact(impact, received_ns)
        self._ac_coupled |= reads_low(impact)
        return self._validate()

    def pass_time(self, now_ns: int) -> list[ValidatedImpact]:
        """Let impacts wait for contact states only up to `now_ns`, also if none arrive; return as `add_impact`."""
        self._matcher.states.last_arrival_ns = max(now_ns, self._matcher.states.last_arrival_ns)
        return self._validate()

    def add_force(self, block: ForceBlock, received_ns: int) -> None:
        """Check the clocks and the sign of the force with a force block."""
        self._matcher.clock.add_block(block, received_ns)
        self._stated_uncertainty = max(self._stated_uncertainty, block.relative_uncertainty)
        finite = block.force[np.isfinite(block.force)]
        if finite.size >= 2:  # the force must last for two samples; a single one can be a glitch
            self._min_force = min(self._min_force, float(np.maximum(finite[1:], finite[:-1]).min()))
            self._max_force = max(self._max_force, float(np.minimum(finite[1:], finite[:-1]).max()))

    def begin_run(self, info: RunInfo, received_ns: int) -> int:
        """Begin the run that `info` describes; return how many of its impacts were validated in the run before.

        They leave the series, because another obstacle was assumed. Raises SettingsError for an invalid value.
        """
        since_ns = self.runs.begin(info, received_ns)
        late = [
            match for match in self._matches[self._earlier :] if match.impact.stamp_ns >= since_ns > match.run.since_ns
        ]
        for match in late:
            self._matches.remove(match)
            self._matcher.refuse(match.impact, Rejection("its RunInfo arrived after it"))
        return len(late)

    def finish(self) -> list[ValidatedImpact]:
        """Match all waiting impacts without waiting for further states; return newly validated impacts."""
        return self._validate(flush=True)

    def begin_recording(self) -> list[ValidatedImpact]:
        """Finish, and continue the series with a new recording or after a reset of the clock.

        Returns newly validated impacts. The latest run stays valid until another one begins.
        """
        validated = self.finish()
        problems = self._problems()
        self._clear_problems(*problems)
        self._matcher.begin_recording()
        self._earlier = len(self._matches)
        return validated

    def extend(self, other: "Validator") -> tuple[int, int]:
        """Add the finished recordings of a validator with the same settings.

        The result is as if this validator had seen them itself. Returns the numbers of matched and refused impacts.
        """
        mine, its = self._matcher, other._matcher  # noqa: SLF001 - of the same class
        self._matches += other._matches  # noqa: SLF001
        self._earlier = len(self._matches)
        mine.seen += its.seen
        mine.refused += its.refused
        self.left_out += other.left_out
        mine.states.late += its.states.late
        self._ac_coupled |= other._ac_coupled  # noqa: SLF001
        self._contact_point = self._contact_point or other._contact_point  # noqa: SLF001
        self._contact_points |= other._contact_points  # noqa: SLF001
        self._stated_uncertainty = max(self._stated_uncertainty, other._stated_uncertainty)  # noqa: SLF001
        (clock, sign), (its_clock, its_sign) = self._problems(), other._problems()  # noqa: SLF001
        self._clear_problems(clock or its_clock, sign or its_sign)
        return len(self._matches), len(mine.refused)

    def reset(self) -> None:
        """Begin a new series with the same settings, in the current run."""
        self._matcher.reset()
        self._matches.clear()
        self.left_out = ()
        self._earlier = 0
        self._ac_coupled = False
        self._contact_points.clear()
        self._stated_uncertainty = 0.0
        self._clear_problems()

    def result(self) -> Result:
        """Return the current result of the series."""
        clock, force_sign = self._problems()
        summary = self._summary()
        refused, statistics = self._matcher.refused, summary.statistics
        reasons = [impact.reason for impact in refused] + [item.reason for item in self.left_out]
        return Result(
            model=self._model,
            contact_point=self._contact_point,
            models=tuple(map(self._with_groups, summary.models.values())),
            comparison=compare_models(self._models, self._matches),
            impacts=tuple(self._validated_impact(match, summary) for match in self._matches),
            refused=tuple(refused),
            seen=self._matcher.seen,
            waiting=len(self._matcher.waiting),
            simulated=sum(match.impact.simulated for match in self._matches),
            excluded=Counter(impact.reason for impact in refused if impact.excluded),
            unpaired=Counter(impact.reason for impact in refused if not impact.excluded),
            other_contact_points=tuple(sorted(self._contact_points - {"", self._contact_point})),
            late_states=self._matcher.states.late,
            clock=clock,
            clock_offset=summary.clock,
            force_sign=force_sign,
            gain_tolerance=self._gain_tolerance,
            held=self._held_forces(),
            ac_coupled=self._ac_coupled,
            left_out=summary.left_out,
            exceedances=statistics.exceedances,
            unmeasured=sum(reason in {CLIPPED, INCOMPLETE, STUCK, NO_SIGNAL} for reason in reasons),
            accepted=statistics.accepted,
            decidable=statistics.decidable,
            reason=statistics.reason,
            criterion_hash=self.criterion_hash,
        )

    def _validate(self, *, flush: bool = False) -> list[ValidatedImpact]:
        validated = []
        for match in self._matcher.matches(flush=flush):
            if not match.has_mass(self._model):
                detail = "choose an effective_mass_model that the robot description allows"
                self._matcher.refuse(match.impact, Rejection(f"no {self._model} mass", detail))
                continue
            self._matches.append(match)
            validated.append(self._validated_impact(match, self._summary()))
        return validated

    def _summary(self) -> _Summary:
        """Return agreement, fit and decision of each model.

        Apart from a problem with the clocks or the sign of the force, it does not depend on the order of arrival.
        """
        clock_problem, sign_problem = self._problems()
        unpaired = Counter(impact.reason for impact in self._matcher.refused if not impact.excluded)
        kinks = (match.kink for match in self._matches if match.kink is not None)
        clock = clock_offset(kinks, self.settings.criterion.largest_clock_offset)
        one_pose = self._one_pose()
        models = {}
        for model in self._models:
            usable = [match for match in self._matches if match.has_mass(model)]
            series = Series(
                agreement=self._agreement(model, usable, self._stiffness),
                fit=model_fit(model, usable),
                clock=clock,
                masses=np.array([match.state.masses[model] for match in usable]),
                obstacle_masses=np.array([match.obstacle_mass for match in usable]),
                one_pose=one_pose,
                gain_tolerance=self._gain_tolerance,
                left_out=unpaired.total(),
                left_out_reason=min(unpaired, key=lambda reason: (-unpaired[reason], reason), default=""),
            )
            acceptance = decide(self.settings.criterion, series, sign_problem or clock_problem)
            models[model] = ModelResult(model, series.agreement, series.fit, {}, {}, *acceptance)
        selected = models[self._model]
        above = [
            self._region_force(match, selected.overall.stiffness).exceeds or self._held_force(match).exceeds
            for match in self._matches
        ]
        statistics = asdict(selected.overall) | selected.fit._asdict() | selected._asdict()
        left_out = self._left_out_forces(selected.overall.stiffness)
        statistics |= {"clock_offset": clock.offset, "exceedances": sum(above) + left_out.exceedances}
        names = [field.name for field in fields(SeriesStatistics)]
        return _Summary(models, SeriesStatistics(**{name: statistics[name] for name in names}), clock, left_out)

    def _region_force(self, match: MatchedImpact, stiffness: float) -> RegionForce:
        """Return the force on the most endangered body region, for the worse of modelled and measured mass."""
        return self._converted(match, stiffness, match.impact.peak_force, match.impact.load_force)

    def _converted(self, match: MatchedImpact, stiffness: float, peak: float, load: float = 0.0) -> RegionForce:
        """Return the force on the most endangered body region of a measured `peak` [N] in the conditions of `match`."""
        peak, load = peak / match.force_share, load / match.force_share
        masses = (match.state.masses[self._model], match.measured_mass)
        return region_force(self._limits, peak, masses, match.obstacle_mass, stiffness, load)

    def _held_force(self, match: MatchedImpact) -> RegionForce:
        """Return the force that stayed after an impact, which acts on any body region as on the sensor."""
        held, load = match.impact.held_force, match.impact.load_force
        return static_force(self._held_limits, (held and held + load) / match.force_share)

    def _held_forces(self) -> ComparedForces:
        """Return the contacts whose force stayed."""
        matched = [self._held_force(match) for match in self._matches if match.impact.held_force]
        refused = [max(self._as_measured(item), key=_share) for item in self._matcher.refused if item.held_force]
        return _compared(matched + refused)

    def _as_measured(self, impact: RefusedImpact) -> list[RegionForce]:
        """Return what stayed of a refused impact, and the first 0.5 s if it is a press."""
        first = impact.total_peak if impact.reason == PRESS else 0.0
        return [static_force(self._held_limits, impact.total_held), static_force(self._limits, first)]

    def _left_out_forces(self, stiffness: float) -> ComparedForces:
        """Return the contacts that are not in the series, and the force in no impact."""
        along_normal = (self._converted(match, stiffness, match.force_share) for match in self._matches)
        per_newton = max(along_normal, key=_share, default=None)

        def converted(peak: float, load: float = 0.0) -> RegionForce:
            if per_newton is None or not per_newton.limit:
                return static_force(self._limits, peak + load)
            return per_newton._replace(force=per_newton.force * peak + load)

        forces = []
        for impact in self._matcher.refused:
            forces.append(max(self._as_measured(impact), key=_share))
            if impact.reason not in {PRESS, REBOUND, DUPLICATE}:
                load = impact.load_force / impact.force_share
                forces[-1] = max(forces[-1], converted(impact.total_peak - load, load), key=_share)
        for item in self.left_out:
            strike = converted(item.peak_force - item.load_force, item.load_force)
            forces.append(static_force(self._held_limits, item.peak_force) if item.reason in LOADS else strike)
        return _compared([force for force in forces if force.force > 0.0])

    @property
    def _gain_tolerance(self) -> float:
        return self._stated_uncertainty or self.settings.criterion.gain_tolerance

    def _one_pose(self) -> bool:
        """Return whether neither lumped nor full mass varies over the series."""
        for model in (MassModel.LUMPED.value, MassModel.FULL.value):
            masses = [match.state.masses[model] for match in self._matches if match.has_mass(model)]
            if masses and max(masses) - min(masses) > MIN_RELATIVE_RANGE * max(masses):
                return False
        return True

    def _agreement(self, model: str, matches: Iterable[MatchedImpact], stiffness: float) -> Agreement:
        return model_agreement(model, matches, stiffness, self.settings.criterion.shortfall_tolerance)

    def _validated_impact(self, match: MatchedImpact, summary: _Summary) -> ValidatedImpact:
        """Return predictions and limit for `match`, with the `summary` of the series."""
        impact, state, run, kink = match
        predictions = {
            model: predict(model, match, result.overall.stiffness)
            for model, result in summary.models.items()
            if match.has_mass(model)
        }
        selected = predictions[self._model]
        peak, impulse = impact.peak_force / match.force_share, match.impulse
        region, held = self._region_force(match, selected.stiffness), self._held_force(match)
        return ValidatedImpact(
            stamp_ns=impact.stamp_ns,
            frame_id=impact.frame_id,
            measured_force=impact.peak_force,
            speed=state.speed,
            **{name: value for name, value in selected._asdict().items() if name != "model"},
            compression_impulse=impact.compression_impulse,
            measured_reduced_mass=impulse / state.speed,
            measured_effective_mass=match.measured_mass,
            measured_stiffness=peak**2 / (impulse * state.speed) if impulse > 0.0 else 0.0,
            clock_offset=math.nan if kink is None else kink.delay,
            body_region=region.region,
            region_force=region.force,
            limit_force=region.limit,
            exceeds_limit=region.exceeds or held.exceeds,
            held_force=held.force,
            held_limit=held.limit,
            held_region=held.region,
            load_force=impact.load_force,
            series=summary.statistics,
            predictions=tuple(predictions.values()),
            contact_point=self._contact_point,
            direction=state.direction,
            obstacle_mass=run.obstacle_mass,
            configuration=run.configuration,
            from_trend=state.from_trend,
            force_share=match.force_share,
            simulated=impact.simulated,
        )

    def _with_groups(self, result: ModelResult) -> ModelResult:
        """Return `result` with its agreement by group."""
        return result._replace(
            by_configuration=self._grouped(result, lambda match: match.run.configuration),
            by_obstacle_mass=self._grouped(result, lambda match: match.run.obstacle_mass),
        )

    def _grouped(self, result: ModelResult, key: Callable[[MatchedImpact], Key]) -> dict[Key, Agreement]:
        groups: dict[Key, list[MatchedImpact]] = {}
        for match in self._matches:
            groups.setdefault(key(match), []).append(match)
        stiffness = result.overall.stiffness
        return {name: self._agreement(result.model, groups[name], stiffness) for name in sorted(groups)}

    def _clear_problems(self, clock: str = "", force_sign: str = "") -> None:
        """Forget the force extremes, and keep the problems of earlier recordings."""
        self._min_force = self._max_force = 0.0
        self._past_problems = clock, force_sign

    def _problems(self) -> tuple[str, str]:
        """Return the problem with the clocks, and that with the sign of the force; empty: none."""
        clock, force_sign = self._past_problems
        if self._min_force < -max(WRONG_SIGN_FORCE, WRONG_SIGN_RATIO * self._max_force):
            low, high = f"{self._min_force:.0f} N", f"{self._max_force:.0f} N"
            force_sign = force_sign or (
                f"force goes to {low} and never above {high}: compression is positive; set sensor.invert"
            )
        return clock or self._matcher.clock.problem(self._matcher.states), force_sign


def _share(force: RegionForce) -> float:
    """Return the force as a share of its limit."""
    return force.force / force.limit if force.limit else 0.0


def _compared(forces: Sequence[RegionForce]) -> ComparedForces:
    return ComparedForces(
        len(forces), sum(force.exceeds for force in forces), max(forces, key=_share, default=NO_REGION)
    )

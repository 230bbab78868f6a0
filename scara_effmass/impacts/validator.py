"""Validation of predicted peak forces against measured impacts, live and offline."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple, TypeVar

import numpy as np

from scara_effmass.impacts.agreement import (
    Agreement,
    Comparison,
    compare_models,
    criterion_hash,
    model_agreement,
    predict,
    unmet_criterion,
)
from scara_effmass.impacts.impact_matcher import ImpactMatcher, MatchedImpact
from scara_effmass.impacts.state_history import MODELS, Rejection
from scara_effmass.settings import ValidatorSettings
from scara_effmass.values import ContactAssessment, ForceBlock, Impact, RefusedImpact, ValidatedImpact

Key = TypeVar("Key", str, float)

N_M = 1000.0
"""N/m in one N/mm."""
WRONG_SIGN_FORCE = 10.0
"""Minimum tensile force [N] that counts as inverted compression; it must also exceed WRONG_SIGN_RATIO x the maximum."""
WRONG_SIGN_RATIO = 3.0


class ModelResult(NamedTuple):
    """Agreement of one effective-mass model with the series, overall and by group.

    Group predictions use the stiffness of the whole series. `reason` states why the model is not accepted.
    """

    model: str
    overall: Agreement
    by_configuration: Mapping[str, Agreement]
    by_obstacle_mass: Mapping[float, Agreement]
    accepted: bool
    reason: str


class Result(NamedTuple):
    """Whole series; `seen` = number of `impacts` + sums of `excluded` and `unpaired` + `waiting`.

    `model` is the selected effective-mass model; `accepted` and `reason` refer to it. `models` are lumped, full, iso,
    and largest if selected. Predictions in `impacts` use the stiffness of the whole series. `excluded` and `unpaired`
    count by reason, `refused` lists each impact. `clock` and `force_sign` describe a problem with the clocks or the
    sign of the force; empty: none detected.
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
    force_sign: str
    accepted: bool
    reason: str
    criterion_hash: str


class Validator:
    """Validate the effective-mass models against measured impacts; the same live and offline.

    Contact states and impacts must each arrive in order. Their interleaving does not change the result if an impact
    arrives within `settings.history` of the states around its onset. `runs` holds the conditions of the impacts.
    """

    def __init__(self, settings: ValidatorSettings) -> None:
        self.settings = settings
        self.criterion_hash = criterion_hash(settings.criterion)
        self._model = settings.effective_mass_model.value
        self._models = (*MODELS, self._model) if self._model not in MODELS else MODELS
        self._stiffness = settings.stiffness * N_M
        self._matcher = ImpactMatcher(settings)
        self.runs = self._matcher.runs
        self._contact_point = settings.contact_point
        self._is_settled = bool(settings.contact_point)
        self._stamp_ns = self._joint_states = 0
        self._other_contact_points: set[str] = set()
        self._matches: list[MatchedImpact] = []
        self._min_force = self._max_force = 0.0
        self._past_problems = "", ""

    def add_state(self, contact: ContactAssessment, received_ns: int) -> list[ValidatedImpact]:
        """Add a contact state that arrived at `received_ns` (0: unknown); return newly validated impacts."""
        if not self._is_selected(contact):
            return []
        validated = self.begin_recording() if self._matcher.states.is_clock_reset(contact.stamp_ns) else []
        self._matcher.states.add(contact, received_ns)
        return validated + self._validate() if self._matcher.waiting else validated

    def _is_selected(self, contact: ContactAssessment) -> bool:
        """Return whether `contact` is of the contact point of the series: without a setting the first of a joint state.

        A subscriber can miss the first one while it joins; another one is then selected until the first one comes.
        """
        name, selected = contact.contact_point, self._contact_point
        begins = not contact.watchdog and contact.stamp_ns != self._stamp_ns
        if begins:
            self._joint_states += 1
            self._stamp_ns = contact.stamp_ns
        if name == selected:
            return True
        if name and (not selected or (begins and not self._is_settled)):
            self._other_contact_points.add(selected)
            self._matcher.states.clear()
            self._contact_point = name
            return True
        self._other_contact_points.add(name)
        self._is_settled |= not begins and not contact.watchdog and self._joint_states > 1
        return False

    def add_impact(self, impact: Impact, received_ns: int) -> list[ValidatedImpact]:
        """Add an impact that arrived at `received_ns` (0: unknown); return newly validated impacts."""
        self._matcher.add_impact(impact, received_ns)
        return self._validate()

    def add_force(self, block: ForceBlock, received_ns: int) -> None:
        """Add a force block to the checks of the clocks and of the sign of the force."""
        self._matcher.clock.add_block(block, received_ns)
        finite = block.force[np.isfinite(block.force)]
        if finite.size:
            self._min_force = min(self._min_force, float(finite.min()))
            self._max_force = max(self._max_force, float(finite.max()))

    def finish(self) -> list[ValidatedImpact]:
        """Match all waiting impacts without further states; return newly validated impacts."""
        return self._validate(flush=True)

    def begin_recording(self) -> list[ValidatedImpact]:
        """Finish, then continue the series with a new recording or a reset clock; return newly validated impacts.

        The latest run stays valid until another one begins.
        """
        validated = self.finish()
        problems = self._problems()
        self._clear_problems(*problems)
        self._matcher.begin_recording()
        return validated

    def reset(self) -> None:
        """Begin a new series with the same settings, in the current run."""
        self._matcher.reset()
        self._matches.clear()
        self._other_contact_points.clear()
        self._clear_problems()

    def result(self) -> Result:
        """Return the current result of the series."""
        agreements = self._agreements()
        clock, force_sign = self._problems()
        reasons = {model: force_sign or clock or self._unmet_criterion(a) for model, a in agreements.items()}
        refused = self._matcher.refused
        reason = reasons[self._model]
        return Result(
            model=self._model,
            contact_point=self._contact_point,
            models=tuple(
                ModelResult(
                    model=model,
                    overall=overall,
                    by_configuration=self._grouped(model, overall.stiffness, lambda match: match.run.configuration),
                    by_obstacle_mass=self._grouped(model, overall.stiffness, lambda match: match.run.obstacle_mass),
                    accepted=not reasons[model],
                    reason=reasons[model],
                )
                for model, overall in agreements.items()
            ),
            comparison=compare_models(self._models, self._matches),
            impacts=tuple(self._validated_impact(match, agreements, reason) for match in self._matches),
            refused=tuple(refused),
            seen=self._matcher.seen,
            waiting=len(self._matcher.waiting),
            simulated=sum(match.impact.simulated for match in self._matches),
            excluded=Counter(impact.reason for impact in refused if impact.excluded),
            unpaired=Counter(impact.reason for impact in refused if not impact.excluded),
            other_contact_points=tuple(sorted(self._other_contact_points - {"", self._contact_point})),
            late_states=self._matcher.states.late,
            clock=clock,
            force_sign=force_sign,
            accepted=not reason,
            reason=reason,
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
            agreements = self._agreements()
            validated.append(self._validated_impact(match, agreements, self._unmet_criterion(agreements[self._model])))
        return validated

    def _agreements(self) -> dict[str, Agreement]:
        return {model: self._agreement(model, self._matches, self._stiffness) for model in self._models}

    def _unmet_criterion(self, agreement: Agreement) -> str:
        unmatched = sum(not impact.excluded for impact in self._matcher.refused)
        return unmet_criterion(self.settings.criterion, agreement, unmatched)

    def _agreement(self, model: str, matches: Iterable[MatchedImpact], stiffness: float) -> Agreement:
        return model_agreement(model, matches, stiffness, self.settings.criterion.shortfall_tolerance)

    def _validated_impact(
        self, match: MatchedImpact, agreements: Mapping[str, Agreement], reason: str
    ) -> ValidatedImpact:
        """Return predictions for `match` and the statistics of the series; `reason`: why it is not accepted."""
        impact, state, run = match
        predictions = {
            model: predict(model, match, agreement.stiffness)
            for model, agreement in agreements.items()
            if match.has_mass(model)
        }
        selected, agreement = predictions[self._model], agreements[self._model]
        return ValidatedImpact(
            stamp_ns=impact.stamp_ns,
            frame_id=impact.frame_id,
            predicted_force=selected.predicted_force,
            measured_force=impact.peak_force,
            relative_error=selected.relative_error,
            effective_mass=selected.effective_mass,
            reduced_mass=selected.reduced_mass,
            speed=state.speed,
            stiffness=selected.stiffness,
            conservative=selected.conservative,
            count=agreement.count,
            correlation=agreement.correlation,
            fitted_stiffness=agreement.fitted_stiffness,
            bias=agreement.bias,
            rmse=agreement.rmse,
            non_conservative=agreement.non_conservative,
            accepted=not reason,
            reason=reason,
            predictions=tuple(predictions.values()),
            contact_point=self._contact_point,
            direction=state.direction,
            obstacle_mass=run.obstacle_mass,
            configuration=run.configuration,
            from_trend=state.from_trend,
            simulated=impact.simulated,
        )

    def _grouped(self, model: str, stiffness: float, key: Callable[[MatchedImpact], Key]) -> dict[Key, Agreement]:
        groups: dict[Key, list[MatchedImpact]] = {}
        for match in self._matches:
            groups.setdefault(key(match), []).append(match)
        return {name: self._agreement(model, groups[name], stiffness) for name in sorted(groups)}

    def _clear_problems(self, clock: str = "", force_sign: str = "") -> None:
        """Forget the force; keep the problems of earlier recordings."""
        self._min_force = self._max_force = 0.0
        self._past_problems = clock, force_sign

    def _problems(self) -> tuple[str, str]:
        """Return the problem with the clocks and that with the sign of the force; empty: none."""
        clock, force_sign = self._past_problems
        if self._min_force < -max(WRONG_SIGN_FORCE, WRONG_SIGN_RATIO * self._max_force):
            low, high = f"{self._min_force:.0f} N", f"{self._max_force:.0f} N"
            force_sign = force_sign or (
                f"force goes to {low} and never above {high}: compression is positive; set sensor.invert"
            )
        return clock or self._matcher.clock.problem(self._matcher.states), force_sign

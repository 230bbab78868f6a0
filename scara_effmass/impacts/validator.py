"""Predictions against measurements: what the validator node publishes, and what the report is made of."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from scara_effmass.impacts.criterion import criterion_hash, shortcoming
from scara_effmass.impacts.pairing import Pairing
from scara_effmass.impacts.prediction import agreement_of, comparison_of, has_mass, predicted
from scara_effmass.impacts.result import ModelResult, Result
from scara_effmass.impacts.robot_track import MODELS, Unusable
from scara_effmass.values import ValidatedImpact

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from scara_effmass.impacts.agreement import Agreement
    from scara_effmass.impacts.pairing import Paired
    from scara_effmass.settings import ValidatorSettings
    from scara_effmass.values import ContactAssessment, ForceBlock, Impact, RunInfo

Key = TypeVar("Key", str, float)

N_M = 1000.0
"""N/m in one N/mm."""
WRONG_SIGN_FORCE = 10.0
"""A force this far below zero [N], and WRONG_SIGN_RATIO times as far as above it, is compression read as negative."""
WRONG_SIGN_RATIO = 3.0


class Validator:
    """Judges the models of the effective mass by measured impacts; the same live and offline.

    Contact states and impacts each come in their own order; how the two are interleaved makes no difference, as long as
    an impact comes within `settings.history` of the states of its onset.
    """

    def __init__(self, settings: ValidatorSettings) -> None:
        self.settings = settings
        self.criterion_hash = criterion_hash(settings.criterion)
        self._model = settings.effective_mass_model.value
        self._models = (*MODELS, self._model) if self._model not in MODELS else MODELS
        self._stiffness = settings.stiffness * N_M
        self._pairing = Pairing(settings)
        self._contact_point = settings.contact_point
        self._others: set[str] = set()
        self._pairs: list[Paired] = []
        self._least = self._largest = 0.0
        self._clock = self._sign = ""

    @property
    def obstacle_mass(self) -> float:
        """Mass of what is hit in the latest run [kg]; 0: not given."""
        return self._pairing.runs.latest.obstacle_mass

    def set_run(self, since_ns: int, *, obstacle_mass: float | None = None, configuration: str | None = None) -> None:
        """Let an obstacle mass [kg] or a configuration hold for impacts from `since_ns` on; None: as before.

        They also hold for what later run information does not state. Raises SettingsError.
        """
        self._pairing.runs.set(since_ns, obstacle_mass, configuration)

    def set_run_info(self, info: RunInfo, received_ns: int) -> None:
        """Let `info` hold from its stamp on, or from `received_ns` without one, in place of the run before it.

        Raises SettingsError for a value that cannot be used: then the obstacle mass is not known from then on.
        """
        self._pairing.runs.begin(info, received_ns)

    def forget_obstacle(self, received_ns: int) -> None:
        """Treat the obstacle mass as not known from `received_ns` on: unreadable run information arrived."""
        self._pairing.runs.forget_obstacle(received_ns)

    def add_state(self, contact: ContactAssessment, received_ns: int) -> list[ValidatedImpact]:
        """Take a contact state that arrived at `received_ns` (0: not known), and return what is now validated."""
        name = contact.contact_point
        if name != self._contact_point:
            if self._contact_point or not name:
                self._others |= {name} - {""}
                return []
            self._contact_point = name
        done = self.begin_recording() if self._pairing.track.went_back(contact.stamp_ns) else []
        self._pairing.track.add(contact, received_ns)
        return done + self._validated() if self._pairing.waiting else done

    def add_impact(self, impact: Impact, received_ns: int) -> list[ValidatedImpact]:
        """Take an impact that arrived at `received_ns` (0: not known), and return what is now validated."""
        self._pairing.add_impact(impact, received_ns)
        return self._validated()

    def add_force(self, block: ForceBlock, received_ns: int) -> None:
        """Take note of a force block, by which the clocks and the sign of the force are checked."""
        self._pairing.clock.add_block(block, received_ns)
        finite = block.force[np.isfinite(block.force)]
        if finite.size:
            self._least = min(self._least, float(finite.min()))
            self._largest = max(self._largest, float(finite.max()))

    def finish(self) -> list[ValidatedImpact]:
        """Decide all that waits, because no more states will come, and return what is validated thereby."""
        return self._validated(all_of_them=True)

    def begin_recording(self) -> list[ValidatedImpact]:
        """Go on with the series in another recording, or after the clock has gone back; otherwise as `finish`.

        The latest run holds until another one is set.
        """
        done = self.finish()
        self._clock, self._sign = self._clock_text(), self._force_sign()
        self._least = self._largest = 0.0
        self._pairing.forget()
        return done

    def reset(self) -> None:
        """Begin a new series under the same settings, in the current run."""
        self._pairing.reset()
        self._pairs.clear()
        self._others.clear()
        self._least = self._largest = 0.0
        self._clock = self._sign = ""

    def result(self) -> Result:
        """Return how the series stands."""
        series = self._series()
        clock, force_sign = self._clock_text(), self._force_sign()
        reasons = {model: force_sign or clock or self._shortcoming(found) for model, found in series.items()}
        refused = self._pairing.refused
        reason = reasons[self._model]
        return Result(
            model=self._model,
            contact_point=self._contact_point,
            models=tuple(
                ModelResult(
                    model=model,
                    overall=found,
                    by_configuration=self._grouped(model, found.stiffness, lambda pair: pair.run.configuration),
                    by_obstacle_mass=self._grouped(model, found.stiffness, lambda pair: pair.run.obstacle_mass),
                    accepted=not reasons[model],
                    reason=reasons[model],
                )
                for model, found in series.items()
            ),
            comparison=comparison_of(self._models, self._pairs),
            impacts=tuple(self._judged(pair, series, reason) for pair in self._pairs),
            refused=tuple(refused),
            seen=self._pairing.seen,
            waiting=self._pairing.waiting,
            simulated=sum(pair.impact.simulated for pair in self._pairs),
            excluded=Counter(one.reason for one in refused if one.excluded),
            unpaired=Counter(one.reason for one in refused if not one.excluded),
            other_contact_points=tuple(sorted(self._others)),
            late_states=self._pairing.track.late,
            clock=clock,
            force_sign=force_sign,
            accepted=not reason,
            reason=reason,
            criterion_hash=self.criterion_hash,
        )

    def _validated(self, *, all_of_them: bool = False) -> list[ValidatedImpact]:
        done = []
        for pair in self._pairing.decided(all_of_them=all_of_them):
            if not has_mass(self._model, pair):
                detail = "choose an effective_mass_model that the robot description allows"
                self._pairing.refuse(pair.impact, Unusable(f"no {self._model} mass", detail))
                continue
            self._pairs.append(pair)
            series = self._series()
            done.append(self._judged(pair, series, self._shortcoming(series[self._model])))
        return done

    def _series(self) -> dict[str, Agreement]:
        return {model: self._agreement(model, self._pairs, self._stiffness) for model in self._models}

    def _shortcoming(self, found: Agreement) -> str:
        unpaired = sum(not one.excluded for one in self._pairing.refused)
        return shortcoming(self.settings.criterion, found, unpaired)

    def _agreement(self, model: str, pairs: Iterable[Paired], stiffness: float = 0.0) -> Agreement:
        return agreement_of(model, pairs, stiffness, self.settings.criterion.shortfall_tolerance)

    def _judged(self, pair: Paired, series: Mapping[str, Agreement], reason: str) -> ValidatedImpact:
        """Return what is said of `pair` as the `series` stands, which is not accepted for `reason`."""
        impact, state, run = pair
        predictions = {
            model: predicted(model, pair, found.stiffness) for model, found in series.items() if has_mass(model, pair)
        }
        judged, found = predictions[self._model], series[self._model]
        return ValidatedImpact(
            stamp_ns=impact.stamp_ns,
            frame_id=impact.frame_id,
            predicted_force=judged.predicted_force,
            measured_force=impact.peak_force,
            relative_error=judged.relative_error,
            effective_mass=judged.effective_mass,
            reduced_mass=judged.reduced_mass,
            speed=state.speed,
            stiffness=judged.stiffness,
            conservative=judged.conservative,
            count=found.count,
            correlation=found.correlation,
            fitted_stiffness=found.fitted_stiffness,
            bias=found.bias,
            rmse=found.rmse,
            non_conservative=found.non_conservative,
            accepted=not reason,
            reason=reason,
            predictions=tuple(predictions.values()),
            contact_point=self._contact_point,
            direction=state.direction,
            obstacle_mass=run.obstacle_mass,
            configuration=run.configuration,
            speed_spread=state.speed_spread,
            from_trend=state.from_trend,
            simulated=impact.simulated,
        )

    def _grouped(self, model: str, stiffness: float, key: Callable[[Paired], Key]) -> dict[Key, Agreement]:
        groups: dict[Key, list[Paired]] = {}
        for pair in self._pairs:
            groups.setdefault(key(pair), []).append(pair)
        return {name: self._agreement(model, groups[name], stiffness) for name in sorted(groups)}

    def _clock_text(self) -> str:
        return self._clock or self._pairing.clock.text(self._pairing.track)

    def _force_sign(self) -> str:
        if not self._sign and self._least < -max(WRONG_SIGN_FORCE, WRONG_SIGN_RATIO * self._largest):
            least, largest = f"{self._least:.0f} N", f"{self._largest:.0f} N"
            return f"force goes to {least} and never above {largest}: compression is positive; set sensor.invert"
        return self._sign

# SPDX-License-Identifier: Apache-2.0
"""Texts of verdicts: which model decides and why, and the reason if the verdict is not OK."""

from __future__ import annotations

from collections.abc import Sequence

from scara_effmass.iso15066 import MIN_EFFECTIVE_MASS
from scara_effmass.iso15066.speed_limit import SpeedLimits
from scara_effmass.kernel import records as codes
from scara_effmass.kernel.records import OFFSETS
from scara_effmass.model.lumping import lumped_suffices
from scara_effmass.reference import RobotDynamics
from scara_effmass.settings import MonitorSettings

NO_CLAMPING_FORCE = (
    "the clamping force is unknown: state effort limits in the robot file that carry the arm, or external_force_limit"
)
LUMPED_NOT_DEFINITE = "the lumped mass matrix is singular or not positive definite at this pose"
MASSLESS = "a joint moves the contact point, but no lumped mass"
MODELS = ("", "lumped", "full", "iso")
CRITERIA = ("", "force", "pressure")


class Reasons:
    """Texts for one robot and its settings; `whys` are those of the kernel's codes, `regions` those of its limits."""

    def __init__(self, dynamics: RobotDynamics, settings: MonitorSettings, limits: SpeedLimits) -> None:
        self.masses_reason = dynamics.robot.masses_reason
        self._full_reason = dynamics.full_reason
        self._model = settings.effective_mass_model.value
        self._margin = settings.model_margin
        self._weakest = limits.weakest
        margin = f"more than {100.0 * settings.model_margin:.3g} % lighter than the full model"
        self.heavy_enough, self.lighter = f"nowhere {margin}", f"the lumped model is {margin} along some direction"
        self.setting = f"effective_mass_model {self._model}"
        largest = "lumped" if lumped_suffices(dynamics.robot) else "lumped and iso"
        self.largest = f"largest of {largest}, no full mass: {dynamics.full_reason}"
        massless = [
            f"{joint} moves the contact point along n, but no lumped mass" for joint in dynamics.robot.joint_names
        ]
        self._lumped_reasons = (dynamics.lumped_reason, LUMPED_NOT_DEFINITE, MASSLESS, *massless)
        self.whys = (
            *("", self.setting, self.heavy_enough, self.lighter, self.largest),
            *map(self.full_alone, self._lumped_reasons),
            *map(self.iso_alone, self._lumped_reasons),
        )
        self.regions = ("", *(limit.region for limit in limits.limits))

    def full_alone(self, lumped_reason: str) -> str:
        """Return why the full model decides alone."""
        return f"no lumped mass: {lumped_reason}"

    def iso_alone(self, lumped_reason: str) -> str:
        """Return why ISO's mass decides alone."""
        return f"no full mass: {self._full_reason}; no lumped mass: {lumped_reason}"

    def no_lumped(self, lumped_reason: str) -> str:
        """Return the reason without the lumped mass that the settings ask for."""
        return f"no lumped mass ({lumped_reason}): choose effective_mass_model auto, full or iso"

    @property
    def no_full(self) -> str:
        """The reason without the full mass that the settings ask for."""
        return f"no full mass ({self._full_reason}): choose effective_mass_model auto, lumped or iso"

    def too_light(self, model: str, mass: float) -> str:
        """Return the reason for a mass [kg] that no robot has."""
        return f"{model} mass = {mass:.3g} kg: must be at least {MIN_EFFECTIVE_MASS:g} kg: check the robot"

    def no_worst(self, model: str) -> str:
        """Return the reason for a model without a mass along some contact normal."""
        return (
            f"no {model} mass for every contact normal, because a joint moves no lumped mass: choose "
            "effective_mass_model auto or full, or contact_normal velocity"
        )

    def speed(self, speed: float, allowable_speed: float, criterion: str, region: str, *, is_above: bool) -> str:
        """Return the reason for a speed [m/s] above or close to the allowable one."""
        text = f"{max(allowable_speed, 0.0):.3f} m/s that the {criterion} limit of {region} allows"
        return f"{speed:.3f} m/s is above the {text}" if is_above else f"{speed:.3f} m/s is close to the {text}"

    def light(self, reason: str, mass: float, best_mass: float, best_model: str) -> str:
        """Return `reason` and a warning of a mass [kg] below that of the best model."""
        warning = f"the {self._model} mass of {mass:.3g} kg is below the {best_model} model's {best_mass:.3g} kg"
        return f"{reason}; {warning}" if reason else warning

    def clamping(self, force: float) -> str:
        """Return the reason for a clamping force [N] above the limit."""
        permissible = f"the {self._weakest.permissible_force_n:.0f} N of {self._weakest.region}"
        return f"the drives can clamp with {force:.0f} N, above {permissible}, at any speed"

    def of_row(self, row: Sequence[float]) -> str:
        """Return the reason of a row of the kernel."""
        remark, error = int(row[OFFSETS["remark"]]), int(row[OFFSETS["error"]])
        if error:
            return self._of_error(error, row)
        if remark == codes.CLAMPED:
            return self.clamping(row[OFFSETS["clamping_force"]])
        reason = ""
        if remark & (codes.FAST | codes.CLOSE):
            criterion, region = CRITERIA[int(row[OFFSETS["criterion"]])], self.regions[int(row[OFFSETS["body_region"]])]
            speed, allowable_speed = row[OFFSETS["speed"]], row[OFFSETS["allowable_speed"]]
            reason = self.speed(speed, allowable_speed, criterion, region, is_above=bool(remark & codes.FAST))
        if remark & codes.LIGHT:
            best_model = "lumped" if self._full_reason else "full"
            best_mass = row[OFFSETS[f"{best_model}_mass"]]
            reason = self.light(reason, row[OFFSETS["effective_mass"]], best_mass, best_model)
        return reason

    def _of_error(self, error: int, row: Sequence[float]) -> str:
        if error >= codes.NO_LUMPED:
            return self.no_lumped(self._lumped_reasons[error - codes.NO_LUMPED])
        if error >= codes.NO_WORST:
            return self.no_worst(MODELS[1 + error - codes.NO_WORST])
        if error >= codes.TOO_LIGHT:
            model = MODELS[1 + error - codes.TOO_LIGHT]
            return self.too_light(model, row[OFFSETS[f"{model}_mass"]])
        return {codes.NO_MASSES: self.masses_reason, codes.NO_FULL: self.no_full}.get(error, NO_CLAMPING_FORCE)

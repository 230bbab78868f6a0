# SPDX-License-Identifier: Apache-2.0
"""Propose test points for a measurement protocol: for each region the contacts with the largest force / limit."""

from collections.abc import Mapping
from typing import NamedTuple

from scara_effmass.analysis.protocol import (
    MIN_REPETITIONS,
    ContactTest,
    Identity,
    Instrument,
    Motion,
    Protocol,
    Repetition,
    Results,
    TestPoint,
)
from scara_effmass.iso15066 import EDITION, TABLE_HASH, Limit, limits_for, peak_force, reduced_mass, speed_limit_of_mass
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import ContactAssessment, Verdict

MIN_POSE_DISTANCE = 0.1
"""Smallest difference in a joint position [rad, m] between two proposals at one contact point for one region."""
EMPTY = Results(repetitions=(Repetition(),) * MIN_REPETITIONS)


class Candidate(NamedTuple):
    """Contact with a body region, and the `ratio` of its predicted force to the limit.

    `at_limit`: the test is to be run at the speed at which the ratio is 1.
    """

    ratio: float
    contact: ContactAssessment
    pose: Mapping[str, float]
    at_limit: bool

    def is_near(self, other: "Candidate") -> bool:
        """Return whether a test of one contact also covers the other."""
        distances = [abs(position - other.pose.get(joint, position)) for joint, position in self.pose.items()]
        return self.contact.contact_point == other.contact.contact_point and max(distances) < MIN_POSE_DISTANCE


class Plan:
    """Keeps the worst `count` contacts of each body region of `settings`, in different poses."""

    def __init__(self, settings: MonitorSettings, count: int) -> None:
        """Start empty. Raises LimitError."""
        self._settings, self._count = settings, count
        self.unknown = self.at_rest = 0
        self._worst: dict[Limit, list[Candidate]] = {limit: [] for limit in limits_for(settings)}

    def add(self, contact: ContactAssessment, pose: Mapping[str, float], *, at_limit: bool = False) -> None:
        """Consider a contact in a `pose`, by joint [rad, m].

        A contact without a verdict only counts in `unknown`, one without a direction in `at_rest`.
        """
        if contact.verdict is Verdict.UNKNOWN or not any(contact.direction):
            self.unknown += contact.verdict is Verdict.UNKNOWN
            self.at_rest += contact.verdict is not Verdict.UNKNOWN
            return
        for limit, worst in self._worst.items():
            mu = reduced_mass(contact.effective_mass, limit.body_mass_kg)
            ratio = peak_force(contact.speed, mu, limit.stiffness_n_m) / limit.permissible_force_n
            if len(worst) == self._count and ratio <= worst[-1].ratio:
                continue
            candidate = Candidate(ratio, contact, pose, at_limit)
            near = [other for other in worst if candidate.is_near(other)]
            if all(ratio > other.ratio for other in near):
                others = [other for other in worst if other not in near]
                worst[:] = sorted([*others, candidate], key=lambda item: -item.ratio)[: self._count]

    def protocol(self, robot_model: str) -> Protocol:
        """Return a protocol with an empty test for each contact, and a device for each stiffness of the regions."""
        tests, devices = [], {}
        for limit, worst in self._worst.items():
            device = f"{limit.stiffness_n_m / 1e3:g}_N_mm"
            for number, candidate in enumerate(worst, start=1):
                devices[device] = Instrument(id=device)
                tests.append(self._test(f"{limit.region}_{number}", device, limit, candidate))
        identity = Identity(robot_model=robot_model, standard=EDITION, limits_hash=TABLE_HASH)
        empty = ContactTest(id="1", instrument="device", results=EMPTY)
        return Protocol(
            identity=identity,
            instruments=tuple(devices.values()) or (Instrument(id="device"),),
            tests=tuple(tests) or (empty,),
        )

    def _test(self, name: str, device: str, limit: Limit, candidate: Candidate) -> ContactTest:
        contact, speed = candidate.contact, candidate.contact.speed
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
                contact_area_m2=self._settings.contact_area_m2,
            ),
            motion=Motion(
                pose={joint: round(position, 4) for joint, position in candidate.pose.items()} or None,
                direction=tuple(round(component, 4) + 0.0 for component in contact.direction),
                commanded_speed_m_s=round(speed, 4),
                payload_kg=self._settings.payload_mass,
            ),
            results=EMPTY,
        )

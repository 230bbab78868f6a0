# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.errors import SettingsError
from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.settings import MonitorSettings
from scara_effmass.share import share
from scara_effmass.sim.collision_sim import (
    FINE_STEP_NS,
    GUIDE,
    HERTZ,
    LINEAR,
    TRAVEL_M,
    Cart,
    CollisionSim,
    ContactSample,
    SpringContact,
    find_contacts,
)
from scara_effmass.sim.motion import ElbowConfig, joint_positions_at, joint_rates
from scara_effmass.values import FloatArray, Vector3

POINTS = [(0.3, 0.2), (0.3, 0.0), (0.3, -0.2)]
MASSES = [0.50, 2.39, 3.72, 7.35]
NO_TORQUE = np.zeros(4)
SETTINGS = MonitorSettings(contact_points=("tool",))
ROBOT = share("config", "omron_i4_550l.yaml")
Q3 = 0.236


class FreeImpact:
    """The robot without torque, moving at `speed` along x into a cart at (x, y), until they separate."""

    def __init__(
        self,
        point: tuple[float, float],
        mass: float,
        contact: SpringContact,
        *,
        speed: float = 0.25,
        step_ns: int = FINE_STEP_NS,
        gap: float = 1e-6,
        surface: Vector3 = GUIDE,
        guide_friction: float = 0.0,
    ) -> None:
        x, y = point
        cart = Cart((x + gap, y, -Q3), mass, surface, guide_friction)
        self.sim = CollisionSim(ROBOT, cart, contact)
        q = np.array(joint_positions_at(point, ElbowConfig.RIGHT, Q3))
        rates = joint_rates(q[:2], np.array([speed, 0.0]))
        self.sim.set_state(q, np.array([*rates, 0.0, rates.sum()]))
        self.normal = np.array(surface)
        self.effective_mass = self.sim.effective_mass(self.normal)
        self.reduced_mass = 1.0 / (1.0 / self.effective_mass + float(self.normal[0]) ** 2 / mass)
        self.speed = speed * float(self.normal[0])
        self.sim.place_cart()
        self.energy = self.kinetic_energy(self.sim)
        self.samples: list[ContactSample] = []
        self._step_ns = step_ns

    def run(self, each_step: Callable[[CollisionSim], object] | None = None) -> FreeImpact:
        """Step until the contact ends."""
        in_contact = False
        for _ in range(20_000_000 // self._step_ns):
            if each_step is not None:
                each_step(self.sim)
            sample = self.sim.step(np.zeros(4), self._step_ns)
            self.samples.append(sample)
            if in_contact and sample.force == 0.0:
                return self
            in_contact = in_contact or sample.force > 0.0
        raise AssertionError("no complete contact")

    @staticmethod
    def kinetic_energy(sim: CollisionSim) -> float:
        """Return the kinetic energy of robot and cart [J]."""
        mujoco.mj_fwdPosition(sim.model, sim.data)
        momentum = np.empty(sim.model.nv)
        mujoco.mj_mulM(sim.model, sim.data, momentum, sim.data.qvel)
        return float(sim.data.qvel @ momentum / 2.0)

    @property
    def peak(self) -> float:
        """Peak force along the normal [N]."""
        return max(sample.force for sample in self.samples)


def sim_of(robot: Path = ROBOT) -> CollisionSim:
    return CollisionSim(robot, Cart((9.0, 0.0, 0.0), 1.0), SpringContact())


@given(
    st.floats(-2.3, 2.3),
    st.floats(-2.5, 2.5),
    st.floats(0.0, 0.4),
    st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=4),
)
def test_mujocos_effective_mass_is_that_of_the_full_model(q1: float, q2: float, q3: float, qd: list[float]) -> None:
    q, rates = np.array([q1, q2, q3, 0.3]), np.array(qd)
    (ours,) = RobotDynamics(load_robot(ROBOT, SETTINGS)).at(q, rates).contacts
    if ours.direction is None or ours.speed < 1e-2 or ours.full > 1e4:
        return
    sim = sim_of()
    sim.set_state(q, rates)
    direction = np.array(ours.direction)
    assert sim.tool_velocity() == pytest.approx(direction * ours.speed, abs=1e-12)
    assert sim.effective_mass(direction) == pytest.approx(ours.full, rel=1e-9)


def test_armature_has_the_effect_that_it_has_in_the_model(tmp_path: Path) -> None:
    document = yaml.safe_load(ROBOT.read_text())
    for joint, armature in zip(document["joints"], (0.4, 0.2, 1.5, 0.01), strict=True):
        joint["armature"] = armature
    heavy = tmp_path / "heavy.yaml"
    heavy.write_text(yaml.safe_dump(document))
    q, qd = np.array([0.3, 1.2, 0.1, 0.0]), np.array([0.2, -0.1, 0.05, 0.0])
    (ours,) = RobotDynamics(load_robot(heavy, SETTINGS)).at(q, qd).contacts
    sim = sim_of(heavy)
    sim.set_state(q, qd)
    assert sim.effective_mass(np.array(ours.direction)) == pytest.approx(ours.full, rel=1e-9)


def test_general_dh_rows_and_inertia_tensors_match_the_model(tmp_path: Path) -> None:
    document = yaml.safe_load(ROBOT.read_text())
    document["joints"][0] |= {"theta": 0.4, "d": 0.1, "alpha": 0.7}
    document["joints"][2] |= {"theta": -1.1, "a": 0.05}
    for link in (*document["links"], document["payload"]):
        link |= {"com": [0.05, -0.02, 0.03], "inertia": [0.02, 0.03, 0.04, 0.001, -0.002, 0.003]}
    odd = tmp_path / "odd.yaml"
    odd.write_text(yaml.safe_dump(document))
    q, qd = np.array([0.3, 1.2, 0.1, -0.4]), np.array([0.2, -0.1, 0.05, 0.3])
    (ours,) = RobotDynamics(load_robot(odd, SETTINGS)).at(q, qd).contacts
    sim = sim_of(odd)
    sim.set_state(q, qd)
    assert sim.tool_velocity() == pytest.approx(np.array(ours.direction) * ours.speed, abs=1e-12)
    assert sim.effective_mass(np.array(ours.direction)) == pytest.approx(ours.full, rel=1e-9)


@pytest.mark.parametrize("mass", MASSES)
@pytest.mark.parametrize("point", POINTS)
def test_free_impact_has_the_theoretical_peak_and_duration(point: tuple[float, float], mass: float) -> None:
    impact = FreeImpact(point, mass, SpringContact()).run()
    assert impact.peak == pytest.approx(SpringContact().free_impact(0.25, impact.reduced_mass)[0], rel=2e-4)
    seconds = math.pi * math.sqrt(impact.reduced_mass / SpringContact().stiffness)
    pressed = [sample for sample in impact.samples if sample.force > 0.0]
    assert len(pressed) * FINE_STEP_NS / 1e9 == pytest.approx(seconds, abs=2 * FINE_STEP_NS / 1e9, rel=2e-3)


@pytest.mark.parametrize(
    "contact", [SpringContact(), SpringContact(1.1e8, HERTZ), SpringContact(damping=150.0, friction=0.3)]
)
def test_finer_step_leaves_the_peak_unchanged(contact: SpringContact) -> None:
    usual, half, tenth = (
        FreeImpact((0.3, 0.2), 0.5, contact, step_ns=step).run().peak
        for step in (FINE_STEP_NS, FINE_STEP_NS // 2, FINE_STEP_NS // 10)
    )
    assert usual == pytest.approx(tenth, rel=2e-3)
    assert half == pytest.approx(tenth, rel=1e-3)


@pytest.mark.parametrize(("contact", "exponent"), [(SpringContact(), 0.5), (SpringContact(1.1e8, HERTZ), 0.6)])
def test_peak_grows_with_the_theoretical_power_of_mu(contact: SpringContact, exponent: float) -> None:
    impacts = [FreeImpact(point, mass, contact).run() for point in POINTS for mass in MASSES]
    mu = np.log([impact.reduced_mass for impact in impacts])
    peaks = np.log([impact.peak for impact in impacts])
    slope, _ = np.polyfit(mu, peaks, 1)
    assert slope == pytest.approx(exponent, abs=1e-3)


def damped_peak(zeta: float) -> float:
    """Peak of the force of Kelvin and Voigt over v sqrt(mu k): where the derivative of k x + c x' is zero."""
    root = math.sqrt(1.0 - zeta**2)
    phase = math.atan2(root * (1.0 - 4.0 * zeta**2), zeta * (3.0 - 4.0 * zeta**2))
    return math.exp(-zeta / root * phase)


@pytest.mark.parametrize("zeta", [0.01, 0.05, 0.1, 0.2])
def test_damping_lowers_the_peak_by_the_theoretical_factor(zeta: float) -> None:
    free = FreeImpact((0.3, 0.0), 2.39, SpringContact())
    c = zeta * 2.0 * math.sqrt(free.reduced_mass * SpringContact().stiffness)
    impact = FreeImpact((0.3, 0.0), 2.39, SpringContact(damping=c)).run()
    assert impact.peak / SpringContact().free_impact(0.25, free.reduced_mass)[0] == pytest.approx(
        damped_peak(zeta), rel=0.015 * zeta
    )


@pytest.mark.parametrize(("restitution", "change"), [(0.95, -0.03), (0.5, -0.19)])
def test_theoretical_factor_matches_known_values(restitution: float, change: float) -> None:
    zeta = -math.log(restitution) / math.hypot(math.pi, math.log(restitution))
    assert damped_peak(zeta) - 1.0 == pytest.approx(change, abs=0.01)


def stored_energy(contact: SpringContact, depth: float) -> float:
    power = contact.exponent + 1.0
    return float(contact.stiffness * max(depth, 0.0) ** power / power)


@pytest.mark.parametrize("contact", [SpringContact(), SpringContact(1.1e8, HERTZ)])
def test_energy_is_conserved_in_every_step(contact: SpringContact) -> None:
    before: list[tuple[FloatArray, FloatArray]] = []
    impact = FreeImpact((0.3, -0.2), 3.72, contact)
    impact.run(lambda sim: before.append((sim.data.qpos.copy(), sim.data.qvel.copy())))
    scratch = CollisionSim(ROBOT, impact.sim.cart, contact)
    for (q, v), (_, later), sample in zip(before, before[1:], impact.samples, strict=False):
        # The velocity at q is the mean of the half steps before and after it.
        scratch.data.qpos[:], scratch.data.qvel[:] = q, (v + later) / 2.0
        energy = impact.kinetic_energy(scratch) + stored_energy(contact, sample.depth)
        assert energy == pytest.approx(impact.energy, rel=3e-4)
    assert min(sample.depth for sample in impact.samples) < 0.0


def test_energy_changes_by_the_work_of_motors_damping_and_friction() -> None:
    damping, torque = 200.0, np.array([3.0, -2.0, 5.0, 0.1])
    contact = SpringContact(damping=damping)
    impact = FreeImpact((0.3, 0.2), 2.39, contact, guide_friction=4.0)
    sim, work = impact.sim, 0.0
    for _ in range(2000):
        q, cart = sim.q, sim.cart_position
        sample = sim.step(torque, 2_000)
        work += float(torque @ (sim.q - q)) - 4.0 * (sim.cart_position - cart)
        if sample.depth > 0.0:
            mujoco.mj_kinematics(sim.model, sim.data)
            depth = float(sim.data.site("tool").xpos[0]) - sim.cart.tip[0] - sim.cart_position
            work -= (sample.force - contact.stiffness * sample.depth) * (depth - sample.depth)
    assert sample.force == 0.0
    assert abs(work) > 0.1 * impact.energy
    assert impact.kinetic_energy(sim) - impact.energy == pytest.approx(work, abs=2e-3 * impact.energy)


@pytest.mark.parametrize("mass", MASSES)
def test_impulse_is_the_momentum_of_the_cart(mass: float) -> None:
    impact = FreeImpact((0.3, 0.2), mass, SpringContact(damping=100.0)).run()
    impulse = sum(sample.force for sample in impact.samples) * FINE_STEP_NS / 1e9
    assert impulse == pytest.approx(mass * impact.sim.cart_speed, rel=1e-9)


@pytest.mark.parametrize("surface", [(math.cos(0.5), math.sin(0.5), 0.0), (0.8, 0.0, 0.6), (0.8, -0.36, 0.48)])
def test_inclined_plate_is_hit_along_its_normal(surface: tuple[float, float, float]) -> None:
    impact = FreeImpact((0.3, 0.0), 2.39, SpringContact(), surface=surface).run()
    assert impact.peak == pytest.approx(SpringContact().free_impact(impact.speed, impact.reduced_mass)[0], rel=1e-3)
    sample = max(impact.samples, key=lambda sample: sample.force)
    assert sample.measured == pytest.approx(sample.force * surface[0])


def test_tip_friction_dissipates_energy_and_keeps_the_peak() -> None:
    smooth, rough = (FreeImpact((0.3, 0.0), 2.39, SpringContact(friction=mu)).run() for mu in (0.0, 0.3))
    assert smooth.kinetic_energy(smooth.sim) == pytest.approx(smooth.energy, rel=1e-4)
    lost = 1.0 - rough.kinetic_energy(rough.sim) / rough.energy
    assert 0.001 < lost < 0.2
    assert rough.peak == pytest.approx(smooth.peak, rel=0.1)


def test_guide_friction_and_brake_stop_the_cart() -> None:
    sim = CollisionSim(ROBOT, Cart((0.9, 0.0, 0.0), 2.0, guide_friction=0.1), SpringContact())
    sim.place_cart()
    sim.data.qvel[4] = 0.3
    places = []
    for _ in range(1200):
        sim.advance(NO_TORQUE)
        places.append(sim.cart_position)
    # m v^2 / 2 = 0.09 J, of which friction takes 0.015 J up to the brake; v = 0.274 m/s there, tau v = 14 mm at most.
    assert TRAVEL_M < places[-1] < TRAVEL_M + 0.0138
    assert abs(sim.cart_speed) < 1e-4


def test_inverse_dynamics_torques_reproduce_the_motion() -> None:
    sim = sim_of()
    t = np.arange(500) * 1e-3
    shape = np.outer(1.0 - np.cos(2.0 * t), [0.4, -0.3, 0.05, 0.2])
    q = np.array(joint_positions_at((0.3, 0.2), ElbowConfig.RIGHT, 0.2)) + shape
    qd = np.outer(2.0 * np.sin(2.0 * t), [0.4, -0.3, 0.05, 0.2])
    qdd = np.outer(4.0 * np.cos(2.0 * t), [0.4, -0.3, 0.05, 0.2])
    sim.set_state(q[0], qd[0])
    for torque in sim.inverse_dynamics(q, qd, qdd)[:-1]:
        sim.advance(torque)
    assert sim.q == pytest.approx(q[-1], abs=2e-3)
    assert np.abs(q[-1] - q[0]).max() > 0.1


def test_cart_in_the_robots_place_is_refused() -> None:
    sim = CollisionSim(ROBOT, Cart((0.25, 0.2, -0.236), 1.0), SpringContact())
    sim.set_state(np.array(joint_positions_at((0.3, 0.2), ElbowConfig.RIGHT, 0.236)), NO_TORQUE)
    with pytest.raises(ValueError, match=r"tool: 50\.0 mm behind the tip of the cart: must be in front of it"):
        sim.place_cart()
    assert not sim.cart_placed
    assert not any(sample.force for sample in sim.advance(NO_TORQUE))


def samples(forces: list[float]) -> list[ContactSample]:
    return [ContactSample(i * FINE_STEP_NS, 1e-6 if force else -1e-6, force, force) for i, force in enumerate(forces)]


@pytest.mark.parametrize("gap", [0.3e-6, 1.1e-6, 2.4e-6])
def test_contact_begins_where_the_gap_closes(gap: float) -> None:
    impact = FreeImpact((0.3, 0.2), 2.39, SpringContact(), gap=gap).run()
    (contact,) = find_contacts(impact.samples)
    assert contact.onset_ns == pytest.approx(gap / 0.25 * 1e9, abs=50.0)
    assert contact.speed == pytest.approx(0.25, rel=1e-3)
    assert contact.peak_force == impact.peak
    assert contact.duration == pytest.approx(math.pi * math.sqrt(impact.reduced_mass / 2e6), abs=FINE_STEP_NS / 1e9)
    assert contact.impulse == pytest.approx(2.39 * impact.sim.cart_speed, rel=1e-9)


def test_separate_contacts_are_returned_without_incomplete_ones() -> None:
    contacts = find_contacts(samples([5.0, 0.0, 1.0, 3.0, 0.0, 0.0, 2.0, 0.0, 7.0]))
    assert [contact.peak_force for contact in contacts] == [3.0, 2.0]
    assert [contact.impulse for contact in contacts] == pytest.approx(
        [4.0 * FINE_STEP_NS / 1e9, 2.0 * FINE_STEP_NS / 1e9]
    )
    assert [contact.onset_ns for contact in contacts] == [15_000, 55_000]


def test_no_contact_gives_an_empty_result() -> None:
    assert find_contacts([]) == ()
    assert find_contacts(samples([0.0, 0.0])) == ()


stiffnesses = st.floats(1e4, 1e8)
exponents = st.sampled_from([LINEAR, HERTZ, 2.0])
masses = st.floats(0.01, 100.0)
speeds = st.floats(0.01, 2.0)


@given(stiffnesses, exponents, st.floats(0.0, 1e4), st.floats(-1e-2, 1e-3), st.floats(-1.0, 1.0))
def test_force_is_never_tensile_and_zero_without_contact(
    k: float, n: float, c: float, depth: float, rate: float
) -> None:
    force = SpringContact(k, n, c).force(depth, rate)
    assert force >= 0.0
    assert depth > 0.0 or force == 0.0


@given(stiffnesses, exponents, st.floats(1e-6, 1e-3))
def test_force_follows_the_power_law(k: float, n: float, depth: float) -> None:
    assert SpringContact(k, n).force(depth, 0.0) == pytest.approx(k * depth**n)


@given(stiffnesses, speeds, masses)
def test_free_impact_has_the_textbook_peak_and_duration(k: float, v: float, mu: float) -> None:
    linear = (v * math.sqrt(mu * k), math.pi * math.sqrt(mu / k))
    assert SpringContact(k).free_impact(v, mu) == pytest.approx(linear)
    # Johnson, Contact Mechanics, 11.2: F = k^(2/5) (5/4 mu v^2)^(3/5), t = 2.94 depth / v
    hertz = (k**0.4 * (1.25 * mu * v * v) ** 0.6, 2.94 * (1.25 * mu * v * v / k) ** 0.4 / v)
    assert SpringContact(k, HERTZ).free_impact(v, mu) == pytest.approx(hertz, rel=2e-3)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("stiffness", 0.0),
        ("friction", 1.1),
        *((name, v) for name in SpringContact.__slots__ for v in (-1.0, math.nan, math.inf)),
    ],
)
def test_invalid_contact_raises(name: str, value: float) -> None:
    with pytest.raises(SettingsError, match=f"{name} = "):
        SpringContact(**{name: value})

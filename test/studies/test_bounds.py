# SPDX-License-Identifier: Apache-2.0
"""The force bounds of the verdict against MuJoCo, a free plate and an explicit spring; see docs/validity.md."""

from typing import Any

import numpy as np
import pytest

from scara_effmass.iso15066 import limits_for
from scara_effmass.iso15066.contact import amplification
from scara_effmass.safety import Monitor
from scara_effmass.settings import MonitorSettings, ServoSettings
from scara_effmass.share import share
from scara_effmass.sim.recordings import EPOCH_NS
from scara_effmass.studies import bounds
from scara_effmass.studies.bounds import RANDOM_ARM, ROBOTS, TINY, MonitoredArm, arm_of
from scara_effmass.values import FloatArray, JointState, Verdict

TOLERANCE = 1.005
REGIONS = ["lower_leg", "chest", "hand_fingers"]


def nominal(robot: str) -> MonitoredArm:
    """Return the arm without the mass errors of the random impact that came last."""
    arm = arm_of(robot)
    arm.sim.scale_masses(np.ones(arm.sim.n))
    return arm


@pytest.fixture(params=["i4-550L", "UR5", "UR10"])
def arm(request: pytest.FixtureRequest) -> MonitoredArm:
    return nominal(request.param)


@pytest.fixture
def scara() -> MonitoredArm:
    return nominal("i4-550L")


@pytest.fixture
def ur5() -> MonitoredArm:
    return nominal("UR5")


@pytest.mark.parametrize("region", REGIONS)
def test_worst_normal_reaches_the_limit_and_does_not_exceed_it(arm: MonitoredArm, region: str) -> None:
    rng = np.random.default_rng(1)
    held = bounds.contacts(arm, region, 30, rng, pace=bounds.HELD)[:, 0]
    assert held.max() > 0.99
    assert held.max() < TOLERANCE


@pytest.mark.parametrize("region", REGIONS)
def test_no_random_plate_exceeds_the_limit(arm: MonitoredArm, region: str) -> None:
    rng = np.random.default_rng(2)
    assert bounds.contacts(arm, region, 30, rng, plate="random", pace=bounds.HELD)[:, 0].max() < TOLERANCE


@pytest.mark.parametrize("region", [*REGIONS, "abdomen"])
def test_allowed_speed_keeps_the_limit_while_the_joints_turn(arm: MonitoredArm, region: str) -> None:
    ratio, turn = bounds.contacts(arm, region, 60, np.random.default_rng(3)).T
    assert ratio.max() < TOLERANCE
    assert np.median(ratio) > 0.85
    assert turn.max() > bounds.SMALL_TURN or region == "hand_fingers"


def test_random_arms_with_random_joint_velocities_keep_the_limit() -> None:
    ratio = bounds.random_contacts(40, np.random.default_rng(5))
    assert 0.9 < np.median(ratio) < ratio.max() < TOLERANCE


@pytest.mark.parametrize(("region", "median"), [("lower_leg", 1.1), ("chest", 1.1), ("hand_fingers", 1.005)])
def test_normal_along_the_velocity_allows_too_much(scara: MonitoredArm, region: str, median: float) -> None:
    rng = np.random.default_rng(4)
    ratio = bounds.contacts(scara, region, 30, rng, contact_normal="velocity", pace=bounds.HELD)[:, 0]
    assert np.median(ratio) > median
    along = bounds.contacts(scara, region, 10, rng, contact_normal="velocity", plate="velocity", pace=bounds.HELD)[:, 0]
    assert np.allclose(along, 1.0, atol=0.002)


@pytest.mark.parametrize("bandwidth", [1.0, 5.0, 20.0])
@pytest.mark.parametrize("region", ["abdomen", "chest", "lower_leg"])
def test_servo_that_pushes_on_stays_within_its_bound(arm: MonitoredArm, region: str, bandwidth: float) -> None:
    pushing, rng = ServoSettings(bandwidth=bandwidth, computed_torque=True), np.random.default_rng(5)
    servo = {"bandwidth": bandwidth, "computed_torque": True}
    bounded = bounds.contacts(arm, region, 4, rng, pushing=pushing, drives="servo", servo=servo)[:, 0]
    assert bounded.max() < 1.0
    assert np.median(bounded) > 0.65
    free = bounds.contacts(arm, region, 4, rng, pushing=pushing, contact_normal="velocity", pace=bounds.HELD)[:, 0]
    assert free.min() > 1.0


@pytest.mark.parametrize("bandwidth", [2.0, 10.0])
def test_a_controller_per_joint_stays_within_its_bound(arm: MonitoredArm, bandwidth: float) -> None:
    """Joints that are held one by one make the arm heavier than computed torque does."""
    ratios = {}
    for computed_torque in (False, True):
        servo = {"bandwidth": bandwidth, "computed_torque": computed_torque}
        options: dict[str, Any] = {"pushing": ServoSettings(bandwidth=bandwidth), "drives": "servo", "servo": servo}
        ratios[computed_torque] = bounds.contacts(arm, "chest", 12, np.random.default_rng(9), **options)[:, 0]
    assert ratios[False].max() < 1.0
    assert np.median(ratios[False]) > 0.5
    assert ratios[True].max() > ratios[False].max()


@pytest.mark.parametrize("pushing", [None, ServoSettings(bandwidth=10.0), ServoSettings(computed_torque=True)], ids=str)
def test_acceleration_that_the_joint_states_show_is_in_the_bound(
    arm: MonitoredArm, pushing: ServoSettings | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    options: dict[str, Any] = {"pushing": pushing, "acceleration": 4.0}
    options |= {"drives": "servo", "servo": pushing.model_dump()} if pushing else {}
    ratio = bounds.contacts(arm, "chest", 12, np.random.default_rng(5), **options)[:, 0]
    assert 0.5 < ratio.max() < TOLERANCE
    allowed = MonitoredArm.allowed

    def without(arm: MonitoredArm, q: FloatArray, qd: FloatArray, settings: MonitorSettings, **_: object) -> Any:  # noqa: ANN401
        return allowed(arm, q, qd, settings)

    monkeypatch.setattr(MonitoredArm, "allowed", without)
    assert bounds.contacts(arm, "chest", 12, np.random.default_rng(5), **options)[:, 0].max() > 1.01


@pytest.mark.parametrize("surface", [{"contact_damping": 0.8}, {"contact_friction": 0.8}], ids=str)
@pytest.mark.parametrize("pushing", [None, ServoSettings(computed_torque=True)], ids=str)
def test_damping_and_friction_that_are_stated_are_in_the_bound(
    arm: MonitoredArm, pushing: ServoSettings | None, surface: dict[str, float]
) -> None:
    options: dict[str, Any] = {"pushing": pushing, **surface}
    options |= {"drives": "servo", "servo": pushing.model_dump()} if pushing else {}
    ratio = bounds.contacts(arm, "chest", 12, np.random.default_rng(5), **options)[:, 0]
    assert 0.5 < ratio.max() < TOLERANCE
    unstated = ratio.max() * amplification(surface.get("contact_damping", 0.0), surface.get("contact_friction", 0.0))
    assert unstated > 1.01


def test_joints_that_accelerate_up_to_the_warning_keep_the_limit() -> None:
    ratio = bounds.turning_contacts(12, np.random.default_rng(3))
    assert 0.3 < ratio.max() < 1.0


@pytest.mark.parametrize("bandwidth", [1.0, 5.0, 20.0])
@pytest.mark.parametrize("computed_torque", [False, True])
def test_clamping_by_a_servo_that_stops_stays_within_its_bound(
    arm: MonitoredArm,
    bandwidth: float,
    computed_torque: bool,  # noqa: FBT001
) -> None:
    servo = ServoSettings(bandwidth=bandwidth, computed_torque=computed_torque, stopping_time=0.3)
    for region in ("abdomen", "hand_fingers"):
        rng = np.random.default_rng(11)
        options: dict[str, Any] = {"contact": "quasi_static", "drives": "servo", "servo": servo.model_dump()}
        ratio, _ = bounds.contacts(arm, region, 3, rng, pushing=servo, plate="random", **options).T
        assert ratio.max() < 1.0
        ratio, _ = bounds.contacts(arm, region, 3, rng, pushing=servo, plate="velocity", **options).T
        assert 0.1 < ratio.max() < 1.0


def test_parts_of_the_bound_add_up_to_the_limit(scara: MonitoredArm) -> None:
    servo = ServoSettings(computed_torque=True)
    parts = bounds.force_parts(scara, 4, np.random.default_rng(2), servo)
    (limit,) = limits_for(MonitorSettings(body_regions=("chest",)))
    np.testing.assert_allclose(parts.sum(axis=1), limit.permissible_force_n, rtol=1e-6)
    assert (parts > 0.0).all()
    exact = bounds.force_parts(scara, 4, np.random.default_rng(2), servo, **{**bounds.NO_MARGINS, "drives": "servo"})
    np.testing.assert_allclose(exact[:, 2:], 0.0, atol=1e-6)


def test_immovable_bounds_every_servo(scara: MonitoredArm) -> None:
    pushing = ServoSettings(bandwidth=60.0, computed_torque=True)
    rng = np.random.default_rng(6)
    ratio = bounds.contacts(scara, "abdomen", 6, rng, pushing=pushing, drives="immovable", pace=bounds.HELD)[:, 0]
    assert ratio.max() < TOLERANCE
    assert ratio.max() > 0.5


@pytest.mark.parametrize("computed_torque", [True, False])
def test_effort_limits_bound_the_push_of_stiff_drives(computed_torque: bool) -> None:  # noqa: FBT001
    effort = (4.0, 2.0, 15.0, 0.5)
    arm = MonitoredArm(share("config", "omron_i4_550l.yaml"))
    arm.dynamics.robot.model.effortLimit = np.array(effort)
    pushing = ServoSettings(bandwidth=20.0, computed_torque=computed_torque)
    options: dict[str, Any] = {"pushing": pushing, "drives": "servo", "servo": {"bandwidth": 1000.0}}
    held = bounds.contacts(arm, "chest", 30, np.random.default_rng(7), pace=bounds.HELD, **options)[:, 0]
    assert held.max() < TOLERANCE


def test_clamping_force_is_that_of_a_linear_programme(ur5: MonitoredArm) -> None:
    rng = np.random.default_rng(8)
    forces = []
    for _ in range(200):
        q, qd, _ = bounds.draw(ur5, rng, bounds.settings_for())
        velocity = ur5.sim.kinematics(q)[0] @ qd
        direction = velocity / np.linalg.norm(velocity)
        force = ur5.dynamics.at(q).contacts[0].clamping_force([direction])
        assert force == pytest.approx(bounds.clamping_force(ur5, q, direction), rel=1e-9, abs=1e-9)
        forces.append(force)
    assert 200.0 < np.median(forces) < 500.0


def assess(arm: MonitoredArm, q: Any, qd: Any, **settings: Any) -> Any:  # noqa: ANN401
    monitor = Monitor(arm.dynamics, bounds.settings_for(**settings))
    decision = monitor.assess(JointState(EPOCH_NS, arm.dynamics.robot.joint_names, q, qd), EPOCH_NS)
    assert decision is not None
    return decision


@pytest.mark.parametrize("speed", [0.0, 1e-3, 0.05, 0.2])
def test_clamping_by_a_ur5_is_a_violation_at_any_speed(ur5: MonitoredArm, speed: float) -> None:
    rng = np.random.default_rng(9)
    clamped = {"contact": "quasi_static", "body_regions": ["hand_fingers"]}
    for _ in range(10):
        q, qd, _ = bounds.draw(ur5, rng, bounds.settings_for())
        velocity = ur5.sim.kinematics(q)[0] @ qd
        length = np.linalg.norm(velocity)
        if bounds.clamping_force(ur5, q, velocity / length) <= 140.0:
            continue
        qd = qd * speed / length + TINY
        decision = assess(ur5, q, qd, **clamped)
        contact = decision.contacts[0]
        assert contact.verdict is Verdict.VIOLATION
        assert "the drives can clamp with" in contact.reason
        assert (decision.allowable_speed, decision.speed_scaling) == (0.0, 0.0)
        monitored = assess(ur5, q, qd, external_force_limit=139.0, **clamped).contacts[0]
        assert monitored.allowable_speed > 0.0
        assert monitored.clamping_force == 139.0


def test_clamping_without_effort_limits_is_unknown(scara: MonitoredArm) -> None:
    q, qd, _ = bounds.draw(scara, np.random.default_rng(10), bounds.settings_for())
    decision = assess(scara, q, qd, contact="quasi_static")
    assert decision.contacts[0].verdict is Verdict.UNKNOWN
    assert decision.contacts[0].reason.startswith("the clamping force is unknown")
    assert decision.allowable_speed == 0.0


def test_tool_at_its_limit_does_not_allow_too_fast_an_elbow(scara: MonitoredArm) -> None:
    """Where the elbow is above its own limit, speed and scaling are those that bring it back to it."""
    rng = np.random.default_rng(11)
    options: dict[str, Any] = {"body_regions": ["hand_fingers"], "contact_normal": "velocity"}
    too_fast = 0
    for _ in range(100):
        q, creep = scara.draw_motion(rng)
        creep[2] = TINY  # horizontal
        qd = scara.allowed(q, creep, bounds.settings_for(**options))
        if qd is None:
            continue
        decision = assess(scara, q, qd, **options)
        if decision.contacts[0].verdict is Verdict.UNKNOWN:  # a joint is above its speed limit
            continue
        tool, elbow = decision.contacts
        assert (tool.contact_point, elbow.contact_point) == ("tool", "elbow")
        assert tool.margin == pytest.approx(0.0, abs=1e-8)
        assert decision.allowable_speed == min(tool.allowable_speed, elbow.allowable_speed)
        if elbow.margin > -1e-9:
            continue
        too_fast += 1
        assert elbow.verdict is Verdict.VIOLATION
        assert decision.speed_scaling == pytest.approx(elbow.allowable_speed / elbow.speed)
        slower = assess(scara, q, qd * decision.speed_scaling * (1.0 - 1e-6), **options)
        assert {contact.verdict for contact in slower.contacts} <= {Verdict.OK, Verdict.WARN}
    assert too_fast >= 15


@pytest.mark.parametrize("pushing", [None, ServoSettings(bandwidth=1.0)])
def test_person_who_meets_a_slow_link_at_a_heavier_place_is_within_the_bound(pushing: ServoSettings | None) -> None:
    """Where it is fastest the link yields; of a servo, too, the energy of the person counts everywhere on the link."""
    arm, link = arm_of("random arm 2", is_whole=True), 4
    arm.sim.scale_masses(np.ones(arm.sim.n))
    q, qd = np.array([-2.2896, 2.4170, 2.2589, 0.2577]), np.array([-0.0059, 0.0187, -0.0236, 0.0246])
    person = np.array([-0.0414, 0.1428, -0.1338])
    settings = MonitorSettings(
        body_regions=("lower_leg",), person_speed=0.2, servo=ServoSettings(bandwidth=1.0), effective_mass_model="full"
    )
    (limit,) = limits_for(settings)
    arm.sim.move_contact(link, np.array([0.1543, 0.0226, 0.0816]))
    normal = arm.sim.worst_normal(q, qd, limit, pushing, link, person)
    peak = arm.sim.touch(q, qd, normal, limit, pushing, link, person=person).force
    assert peak > 1.1 * limit.permissible_force_n
    contact = arm.monitor(settings).assess_configurations(q[None], qd[None]).contacts[0, link]
    assert peak < contact["force_bound"]
    assert contact["allowable_speed"] == 0.0


@pytest.mark.parametrize("is_coupled", [False, True])
def test_bound_of_a_moving_person_holds_everywhere_on_a_slow_link(is_coupled: bool) -> None:  # noqa: FBT001
    """At the first touch with free joints, which hit no harder than those of a servo."""
    rng, ratios = np.random.default_rng(1), []
    servo = ServoSettings(bandwidth=2.0, computed_torque=is_coupled)
    for _ in range(80):
        arm = arm_of([*ROBOTS, f"{RANDOM_ARM}2"][rng.integers(5)], is_whole=True)
        arm.sim.scale_masses(np.ones(arm.sim.n))
        link, region, person_speed = int(rng.choice(arm.links())), ("chest", "lower_leg")[rng.integers(2)], 0.2
        settings = MonitorSettings(
            body_regions=(region,), person_speed=person_speed, servo=servo, effective_mass_model="full"
        )
        (limit,) = limits_for(settings)
        arm.sim.move_contact(link, arm.random_place(rng, link))
        q, qd = arm.draw_motion(rng, link, straight=False)
        contact = arm.monitor(settings).assess_configurations(q[None], qd[None]).contacts[0, link]
        energy = 0.0
        for place in (arm.random_place(rng, link) for _ in range(12)):
            arm.sim.move_contact(link, place)
            person = arm.sim.worst_person(q, qd, limit, person_speed, link)
            jacobian, inertia = arm.sim.kinematics(q, link)
            mobility = jacobian @ np.linalg.solve(inertia, jacobian.T) + np.eye(3) / limit.body_mass_kg
            closing = jacobian @ qd - person
            energy = max(energy, float(closing @ np.linalg.solve(mobility, closing)))
        ratios.append(np.sqrt(energy * limit.stiffness_n_m) / contact["force_bound"])
    assert max(ratios) <= 1.0
    assert np.median(ratios) > 0.7

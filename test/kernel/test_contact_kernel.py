# SPDX-License-Identifier: Apache-2.0
"""The compiled kernel gives the verdict, reason and numbers of the reference, for every robot and setting."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from scara_effmass.codes import ModelCode, Reason
from scara_effmass.iso15066 import MIN_EFFECTIVE_MASS, limits_for
from scara_effmass.iso15066.drives import MAX_MOBILITY
from scara_effmass.kernel.contact_kernel import ContactKernel
from scara_effmass.kernel.records import CONTACT, MAX_JOINTS
from scara_effmass.kernel.state import CODE, STATE
from scara_effmass.model.load import load_robot
from scara_effmass.model.robot import Robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.reference.dynamics import ContactState
from scara_effmass.safety import Monitor
from scara_effmass.safety.second_channel import AGREEMENT, CANCELLED, SINGULAR, ReferenceChannel, is_unbounded
from scara_effmass.settings import ContactType, Drives, MonitorSettings
from scara_effmass.share import share
from scara_effmass.values import FloatArray, Verdict

REPOSITORY = Path(__file__).resolve().parents[2]
LUMPING = {"policy": "project_com", "free_parameters": "fit_inertia"}
ROBOTS = [REPOSITORY / "config" / "omron_i4_550l.yaml", *sorted(REPOSITORY.glob("*/robots/*.urdf"))]
STATES = 48
ROUNDED = {"kinova": 1e-6, "ur10_robot": 1e-8}
"""Tolerance of lumped models of tiny inertia (2.5e-7 kg m2), which Pinocchio's inverse rounds; see the test of CRBA."""

COMPUTED_TORQUE = {"drives": "servo", "servo": {"computed_torque": True}}
CLAMPED = {"contact": "quasi_static", "person_speed": 0.2}
WEAKEST = ("abdomen", "thigh_knee", "lower_leg")
"""The regions that govern with a servo, where only the drives vary: the others take time and decide nothing."""

LINKS = 1e-6
"""Tolerance for whole links, whose energy is a minimum over the lengths of steps."""

MODELS = st.sampled_from(["auto", "lumped", "full", "iso", "largest"])
CONTACTS = st.fixed_dictionaries(
    {
        "contact": st.sampled_from(["transient", "quasi_static"]),
        "contact_normal": st.sampled_from(["worst", "velocity", "0 0 1", "1 -2 0.5"]),
        "drives": st.sampled_from(["free", "servo", "immovable"]),
        "external_force_limit": st.sampled_from([0.0, 100.0]),
        "effective_mass_model": MODELS,
    }
)
OTHERS = st.fixed_dictionaries(
    {
        "servo": st.fixed_dictionaries(
            {"computed_torque": st.booleans(), "stopping_time": st.sampled_from([0.1, 0.5])}
        ),
        "mass_uncertainty": st.sampled_from([0.0, 0.1, 1.0]),
        "model_margin": st.sampled_from([0.0, 0.1, 0.6, 1.0]),
        "person_speed": st.sampled_from([0.0, 0.2, 1.6]),
        "person_direction": st.sampled_from([(0.0, 0.0, 0.0), (1.0, -1.0, 0.5)]),
        "stiffness_uncertainty": st.sampled_from([0.0, 0.2]),
        "body_regions": st.sampled_from([(), ("chest",), ("hand_fingers", "back_shoulders")]),
        "test_direction": st.sampled_from([(0.0, 0.0, 0.0), (1.0, 0.0, 2.0)]),
        "mass_cap": st.sampled_from([100.0, 1000.0]),
        "max_acceleration": st.sampled_from([0.0, 2.0]),
        "reaction_time": st.sampled_from([0.0, 0.1]),
        "contact_damping": st.sampled_from([0.0, 0.8]),
        "speed_uncertainty": st.sampled_from([0.0, 0.05]),
        "speed_threshold": st.sampled_from([0.001, 0.02]),
        "warn_ratio": st.sampled_from([0.3, 0.8]),
    }
)
FRAMES = "contact_normal_frame", "person_direction_frame", "test_direction_frame"


def settings_of(**values: object) -> MonitorSettings:
    return MonitorSettings.model_validate({"lumping": LUMPING, **values})


def motions_of(dynamics: RobotDynamics, seed: int) -> FloatArray:
    """Return q, qd, tolerances, qdd, its errors and replaced qdd (STATES, 6, n).

    At rest, slow, fast, and at poses where axes align; every third does not accelerate.
    """
    robot = dynamics.robot
    rng = np.random.default_rng(seed)
    lower = np.maximum(robot.model.lowerPositionLimit, -math.pi)
    upper = np.minimum(robot.model.upperPositionLimit, math.pi)
    motions = np.zeros((STATES, 6, robot.model.nv))
    q, qd = motions[:, 0], motions[:, 1]
    q[:] = rng.uniform(lower, upper, q.shape)
    aligned = rng.choice([0.0, math.pi / 2.0, -math.pi / 2.0], q.shape)
    q[::4] = np.clip(aligned, lower, upper)[::4]
    qd[:] = rng.uniform(-1.0, 1.0, q.shape) * 10.0 ** rng.uniform(-4.0, 1.0, (STATES, 1))
    qd[::6] = 0.0
    motions[:, 2] = rng.uniform(0.0, 0.01, q.shape)
    motions[:, 3] = rng.uniform(-1.0, 1.0, q.shape) * 10.0 ** rng.uniform(-2.0, 1.0, (STATES, 1))
    motions[:, 4] = rng.uniform(0.0, 0.2, q.shape)
    motions[::3, 3:] = 0.0
    motions[::2, 5, -1] = 40.0  # beyond what the linear change of pose bears
    return motions


def computed(
    channel: ContactKernel | ReferenceChannel, dynamics: RobotDynamics, motions: FloatArray, max_age: float = 0.04
) -> Any:  # noqa: ANN401
    """Return the contacts (N, P) of admitted joint states, of dtype CONTACT."""
    states = np.zeros(len(motions), STATE)
    states["is_admitted"], states["age"] = 1, np.arange(len(motions)) % 5 * (max_age / 4.0)
    numbers = np.zeros((len(motions), len(dynamics.contacts), CONTACT.itemsize // 8))
    channel.bind(states.view(np.uint8), np.ascontiguousarray(motions), numbers)()
    return numbers.view(CONTACT)[..., 0]


def compare(
    dynamics: RobotDynamics,
    chosen: MonitorSettings,
    motions: FloatArray,
    tolerance: float = AGREEMENT,
    *,
    singular: float = SINGULAR,
) -> Any:  # noqa: ANN401
    """Require that kernel and reference agree, at singular poses within `singular`; return the contacts."""
    channels = ContactKernel(dynamics, chosen), ReferenceChannel(dynamics, chosen)
    contacts, expected = (computed(channel, dynamics, motions) for channel in channels)
    if chosen.drives is Drives.SERVO or chosen.contact is ContactType.QUASI_STATIC:
        tolerance = max(tolerance, CANCELLED)
    is_singular = expected["smallest_singular_value"] < SINGULAR
    unbounded = is_unbounded(expected)
    expected["force_bound"][unbounded] = contacts["force_bound"][unbounded]
    for name in CONTACT.names or ():
        for rows, bound in ((is_singular, max(singular, tolerance)), (~is_singular, tolerance)):
            if bound < math.inf:
                np.testing.assert_allclose(contacts[name][rows], expected[name][rows], bound, bound, err_msg=name)
    return contacts


def with_links(path: Path, settings: MonitorSettings, seed: int) -> Robot:
    """Return a robot with every moving link as a contact besides its points: a box and a random hull by turns."""
    robot = load_robot(path, settings.model_copy(update={"contact_links": ()}))
    rng, model, frames, hulls = np.random.default_rng(seed), robot.model.copy(), dict(robot.contact_frames), {}
    for joint in range(1, model.njoints):
        centre, size = rng.normal(0.0, 0.1, 3), rng.uniform(0.02, 0.2, 3)
        box = np.array([*product((-1.0, 1.0), repeat=3)]) * size
        name, place = f"link {joint}", pin.SE3(pin.exp3(rng.normal(size=3)), centre)
        hulls[name] = centre + (box if joint % 2 else np.vstack([box, rng.normal(0.0, 0.15, (8, 3))]))
        frames[name] = model.addFrame(pin.Frame(name, joint, 0, place, pin.FrameType.OP_FRAME))
    return replace(robot, model=model, contact_frames=frames, hulls=hulls)


def compare_robot(robot: Path, values: dict[str, Any], seed: int) -> Any:  # noqa: ANN401
    chosen = settings_of(**values)
    dynamics = RobotDynamics(load_robot(robot, chosen))
    return compare(dynamics, chosen, motions_of(dynamics, seed), ROUNDED.get(robot.stem, AGREEMENT))


@pytest.mark.parametrize("robot", ROBOTS, ids=lambda path: path.stem)
def test_mobilities_are_those_of_the_mass_matrix_in_local_frames(robot: Path) -> None:
    """CRBA in local frames rounds less than the inverse that the reference takes."""
    chosen = settings_of().model_copy(update={"contact_links": ()})
    dynamics = RobotDynamics(load_robot(robot, chosen))
    motions = motions_of(dynamics, 0)
    contacts = computed(ContactKernel(dynamics, chosen), dynamics, motions)
    names = {"lumped_mobility": ModelCode.LUMPED, "full_mobility": ModelCode.FULL}
    for row, (q, *_) in enumerate(motions):
        for contact, point in zip(contacts[row], dynamics.at(q).contacts, strict=True):
            for name, code in names.items():
                if not contact[name].any():
                    continue
                model = dynamics.models[code]
                matrix = pin.crba(model, model.createData(), q, pin.Convention.LOCAL)
                coupled = matrix + dynamics.robot.rotors.coupling
                mobility = point.jacobian @ np.linalg.solve(coupled, point.jacobian.T)
                found = mobility[np.triu_indices(3)] - contact[name]
                assert np.abs(found).max() < AGREEMENT * np.trace(mobility)


@pytest.mark.parametrize("robot", ROBOTS, ids=lambda path: path.stem)
def test_kernel_equals_the_reference_for_every_robot(robot: Path) -> None:
    for seed, contact in enumerate(({}, {"contact": "quasi_static", "drives": "servo"}, {"contact_normal": "0 0 1"})):
        compare_robot(robot, contact, seed)


@settings(max_examples=4, phases=[Phase.explicit, Phase.reuse, Phase.generate])  # a smaller example takes minutes
@given(robot=st.sampled_from(ROBOTS[:4]), contact=CONTACTS, other=OTHERS, seed=st.integers(0, 2**32 - 1))
def test_kernel_equals_the_reference_for_whole_links(
    robot: Path, contact: dict[str, Any], other: dict[str, Any], seed: int
) -> None:
    """At singular poses the force on a clamped body part has no bound, so rounding decides how large it is.

    Without mobility, the mass models allow a moving person the same speed: rounding decides which one counts.
    """
    other |= {"person_speed": 0.0} if contact["drives"] == "immovable" else {}
    chosen = settings_of(**contact | other | {"contact_normal": "worst"})
    dynamics = RobotDynamics(with_links(robot, chosen, seed))
    singular = math.inf if chosen.contact == "quasi_static" else SINGULAR
    compare(dynamics, chosen, motions_of(dynamics, seed), LINKS, singular=singular)


@pytest.mark.parametrize(
    ("robot", "values", "seed", "rows"),
    [
        ("panda", COMPUTED_TORQUE | {"body_regions": ("neck", "pelvis")}, 0, [1, 5, 7]),
        ("panda", {"drives": "servo"}, 8241, [4]),
        ("ur5_robot", {"drives": "servo", "effective_mass_model": "iso"}, 7005, [32]),
        ("omron_i4_550l", CLAMPED | {"drives": "servo", "external_force_limit": 20.0}, 0, [1, 2, 3]),
        ("ur5_robot", CLAMPED | {"drives": "free", "person_direction": (1.0, -1.0, 0.5)}, 9238, [15]),
    ],
    ids=["saturates_along_worst_normal", "least_mobility", "push_allows_more", "weak_push", "person_too_fast"],
)
def test_kernel_equals_the_reference_for_single_joint_states_of_links(
    robot: str, values: dict[str, Any], seed: int, rows: list[int]
) -> None:
    """One step of the kernel decides in each of them, on which hardly any random joint state depends."""
    (path,) = (path for path in ROBOTS if path.stem == robot)
    chosen = settings_of(**values)
    dynamics = RobotDynamics(with_links(path, chosen, seed))
    compare(dynamics, chosen, motions_of(dynamics, seed)[rows], LINKS)


@pytest.mark.parametrize("robot", ROBOTS[:4], ids=lambda path: path.stem)
@pytest.mark.parametrize("values", [{"drives": "free"}, {"drives": "servo"}, {"drives": "immovable"}], ids=str)
def test_no_point_of_a_link_allows_less_speed(robot: Path, values: dict[str, Any]) -> None:
    """At the first touch, without what the pose and the acceleration change during the contact."""
    chosen = settings_of(effective_mass_model="full", **values)
    whole = with_links(robot, chosen, 1)
    motions = motions_of(RobotDynamics(whole), 1)
    motions[:, 2:] = 0.0
    dynamics = RobotDynamics(whole)
    links = computed(ContactKernel(dynamics, chosen), dynamics, motions)
    rng = np.random.default_rng(2)
    for name, vertices in whole.hulls.items():
        joint = whole.model.frames[whole.contact_frames[name]].parentJoint
        model, frames = whole.model.copy(), {}
        for number, r in enumerate([*vertices, *(rng.dirichlet(np.ones(len(vertices)), 6) @ vertices)]):
            place = pin.SE3(np.eye(3), r)
            frames[str(number)] = model.addFrame(pin.Frame(f"at {number}", joint, 0, place, pin.FrameType.OP_FRAME))
        points = RobotDynamics(replace(whole, model=model, contact_frames=frames, hulls={}))
        found = computed(ContactKernel(points, chosen), points, motions)
        link = links[:, [*whole.contact_frames].index(name)]
        moves = (link["speed"] > 10.0 * chosen.speed_threshold) & (link["mass_capped"] == 0.0)
        shares = found["worst_normal_reduced_mass"] * found["speed"] ** 2
        whole_share = link["worst_normal_reduced_mass"] * link["speed"] ** 2
        fits = found["body_mass"] == link["body_mass"][:, None]  # of the same body part
        assert fits[moves].any()
        assert (np.where(fits, shares, 0.0).max(axis=1) <= whole_share * (1.0 + 1e-6))[moves].all()


def forces_on(link: ContactState, chosen: MonitorSettings, reported: float, iso_mass: float) -> float:
    """Return the largest force [N] at many points of a link and by many velocities of a person, drives left out."""
    (limit,) = limits_for(chosen)
    rng = np.random.default_rng(0)
    people = rng.normal(size=(100, 3))
    if chosen.person_direction != (0.0, 0.0, 0.0):
        people = np.array([chosen.person_direction])
    people *= chosen.person_speed / np.linalg.norm(people, axis=1, keepdims=True)
    maps = np.concatenate([link.maps, np.tensordot(rng.dirichlet(np.ones(len(link.maps)), 20), link.maps, 1)])
    jacobians = maps @ link.link_jacobian
    mobilities = jacobians @ link.state.inverse_mass_matrix[ModelCode.FULL] @ jacobians.transpose(0, 2, 1)
    if chosen.effective_mass_model == "iso":
        mobilities = np.broadcast_to(np.eye(3) / iso_mass, mobilities.shape)
    if chosen.drives is Drives.IMMOVABLE:
        mobilities = np.zeros_like(mobilities)
    matrices = np.linalg.inv(np.eye(3) / limit.body_mass_kg + mobilities)
    faster = 1.0 + chosen.speed_uncertainty / reported if reported else 1.0
    w = (faster * (maps @ link.twist))[:, None] + people
    return math.sqrt(limit.stiffness_n_m * float(np.einsum("pui,pij,puj->pu", w, matrices, w).max()))


@pytest.mark.parametrize("robot", ROBOTS[:4], ids=lambda path: path.stem)
@pytest.mark.parametrize(
    "values",
    [
        {"person_speed": 0.1},
        {"person_speed": 0.25, "speed_uncertainty": 0.2},
        {"person_speed": 0.2, "drives": "servo"},
        {"person_speed": 0.2, "drives": "immovable", "person_direction": (1.0, 0.0, 0.0)},
        {"person_speed": 0.2, "effective_mass_model": "iso", "person_direction": (1.0, 0.0, 0.0)},
        {"person_speed": 0.2, "person_direction": (1.0, 0.0, 0.0)},
    ],
    ids=str,
)
def test_allowable_speed_of_a_link_keeps_the_limit_at_that_speed(robot: Path, values: dict[str, Any]) -> None:
    """At rest, slow, fast, and again at the allowed speed of each link, at many points of the link."""
    defaults = {"drives": "free", "effective_mass_model": "full", "mass_uncertainty": 0.0, "warn_ratio": 1.0}
    chosen = settings_of(body_regions=("pelvis",), **defaults | values)
    whole = with_links(robot, chosen, 4)
    dynamics = RobotDynamics(whole)
    motions, names = motions_of(dynamics, 4), [*whole.contact_frames]
    motions[:, 2:] = 0.0
    contacts, (limit,) = computed(ContactKernel(dynamics, chosen), dynamics, motions, 0.0), limits_for(chosen)
    for number, name in enumerate(names):
        if name not in whole.hulls:
            continue
        first, repeated = contacts[:, number], motions.copy()
        scales = (first["worst_direction_used"] == 0.0) & (first["allowable_speed"] > 2.0 * chosen.speed_threshold)
        repeated[scales, 1] *= 0.999 * first["allowable_speed"][scales, None] / first["speed"][scales, None]
        again = computed(ContactKernel(dynamics, chosen), dynamics, repeated, 0.0)[:, number]
        # A vertex slower than the threshold does not count: the link counts elsewhere from another speed on.
        same = scales & (again["position_in_link"] == first["position_in_link"]).all(axis=1)
        assert same.any()
        np.testing.assert_allclose(again["allowable_speed"][same], first["allowable_speed"][same], LINKS)
        assert (again["verdict"][same] != Verdict.VIOLATION).all()
        for motion, contact, scaled in zip(repeated, again, scales, strict=True):
            link = dynamics.at(motion[0], motion[1]).contacts[number]
            force = forces_on(link, chosen, float(contact["speed"]), whole.iso_mass)
            assert force <= contact["force_bound"] * (1.0 + 1e-6) or contact["mass_capped"]
            if scaled or contact["verdict"] != Verdict.VIOLATION:
                assert force <= limit.permissible_force_n * (1.0 + 1e-6)


@pytest.mark.parametrize(
    ("drives", "slowest"), [("free", 0.0), ("servo", 1e-4)]
)  # lines of a servo: one for nobody, the best for a person
def test_allowable_speed_of_a_link_never_rises_with_the_speed_of_the_person(drives: str, slowest: float) -> None:
    (path,) = (path for path in ROBOTS if path.stem == "panda")
    dynamics = RobotDynamics(with_links(path, settings_of(), 4))
    motions, allowed = motions_of(dynamics, 4), []
    motions[:, 2:] = 0.0
    for speed in (slowest, 0.001, 0.02, 0.1, 0.4):
        chosen = settings_of(drives=drives, person_speed=speed)
        allowed.append(computed(ContactKernel(dynamics, chosen), dynamics, motions)["allowable_speed"])
    assert (np.diff(allowed, axis=0) <= 1e-6).all()


@pytest.mark.parametrize("robot", ROBOTS[:4], ids=lambda path: path.stem)
@pytest.mark.parametrize("values", [{"drives": "free", "contact": "quasi_static"}, {"person_speed": 0.2}, {}], ids=str)
def test_each_contact_has_the_limits_of_its_area(robot: Path, values: dict[str, Any]) -> None:
    whole = with_links(robot, settings_of(), 3)
    names, dynamics = [*whole.contact_frames], RobotDynamics(whole)
    sizes = (1e-5, 1e-3, 5e-5)
    chosen = settings_of(**values, contact_areas=[f"{names[0]}={sizes[0]}", f"{names[1]}={sizes[1]}", f"*={sizes[2]}"])
    singular = math.inf if chosen.contact == "quasi_static" else SINGULAR
    motions = motions_of(dynamics, 5)[::6]
    contacts = compare(dynamics, chosen, motions, LINKS, singular=singular)
    for number, area in enumerate((*sizes[:2], *[sizes[2]] * (len(names) - 2))):
        alone = computed(ContactKernel(dynamics, settings_of(**values, contact_area_m2=area)), dynamics, motions)
        assert contacts[:, number].tobytes() == alone[:, number].tobytes()


@pytest.mark.parametrize("robot", ROBOTS[:4], ids=lambda path: path.stem)
def test_motion_across_a_fixed_normal_counts_both_ways(robot: Path) -> None:
    """The speed along the normal is rounding: its sign must decide nothing."""
    dynamics = RobotDynamics(load_robot(robot, settings_of()))
    motions = motions_of(dynamics, 3)
    contacts = computed(ContactKernel(dynamics, settings_of()), dynamics, motions)[:, 0]
    is_moving = contacts["worst_direction_used"] == 0.0
    for motion, direction in zip(motions[is_moving][:6], contacts["direction"][is_moving][:6], strict=True):
        across = np.cross(direction, np.roll(np.eye(3), 1, axis=0)[np.argmax(np.abs(direction))])
        speeds = []
        for normal in (across, -across):
            chosen = settings_of(contact_normal=" ".join(map(repr, normal.tolist())))
            channels = (channel(dynamics, chosen) for channel in (ContactKernel, ReferenceChannel))
            speeds += [computed(channel, dynamics, motion[None])["allowable_speed"][0, 0] for channel in channels]
        assert speeds == pytest.approx([speeds[0]] * len(speeds), rel=1e-9)


@settings(max_examples=25)
@given(robot=st.sampled_from(ROBOTS[:4]), contact=CONTACTS, other=OTHERS, seed=st.integers(0, 2**32 - 1))
def test_kernel_equals_the_reference_for_every_setting(
    robot: Path, contact: dict[str, Any], other: dict[str, Any], seed: int
) -> None:
    """The directions are in random frames of the robot."""
    names = [*load_robot(robot, settings_of(**contact | other)).frame_indices()]
    frames = np.random.default_rng(seed).choice(names, len(FRAMES)).tolist()
    compare_robot(robot, contact | other | dict(zip(FRAMES, frames, strict=True)), seed)


@pytest.mark.parametrize("robot", ROBOTS[:4], ids=lambda path: path.stem)
@pytest.mark.parametrize(
    ("values", "effort"),
    [
        ({name: value}, effort)
        for name, value in (*product(["contact_normal"], ("worst", "velocity", "1 -2 0.5")), ("person_speed", 0.2))
        for effort in (1.0, 0.2)
    ],
    ids=str,
)
def test_kernel_equals_the_reference_where_joints_saturate(robot: Path, values: dict[str, Any], effort: float) -> None:
    """With a fifth of their effort, some joints cannot even hold the weight of the arm."""
    chosen = settings_of(**COMPUTED_TORQUE, **values, effective_mass_model="full", body_regions=WEAKEST)
    loaded = load_robot(robot, chosen)
    model = loaded.model.copy()
    model.effortLimit = effort * model.effortLimit
    dynamics = RobotDynamics(replace(loaded, model=model))
    compare(dynamics, chosen, motions_of(dynamics, 7))


def test_kernel_equals_the_reference_where_the_force_falls_with_the_energy() -> None:
    """Where the pose changes faster than the contact lasts, a bound of the energy is none of the force."""
    (robot,) = (path for path in ROBOTS if path.stem == "kinova")
    compare_robot(robot, {"person_speed": 0.2}, 4)


def test_force_that_rounding_decides_is_no_disagreement() -> None:
    """A push on a clamped body part by an arm that stands in a singular pose, which allows no speed."""
    normal = {"contact_normal": "1 -2 0.5", "contact_normal_frame": "ee_link"}
    chosen = settings_of(contact="quasi_static", **normal)
    dynamics = RobotDynamics(load_robot(share("config", "robots", "ur10_robot.urdf"), chosen))
    motions = motions_of(dynamics, 4250)[4:5]
    contacts = computed(ContactKernel(dynamics, chosen), dynamics, motions)
    assert is_unbounded(contacts).all()
    numbers, reference = contacts.view(np.float64).reshape(1, -1), ReferenceChannel(dynamics, chosen)
    assert reference.difference(motions[0], numbers, 0.0) == ""
    contacts["force_bound"] = math.nan
    assert reference.difference(motions[0], numbers, 0.0) == "force_bound"


def light_arm(path: Path, scale: float) -> Path:
    """Write the shipped SCARA with all masses and inertias times `scale`."""
    file = yaml.safe_load(share("config", "omron_i4_550l.yaml").read_text(encoding="utf-8"))
    for body in (*file["links"], file["payload"]):
        body["mass"] *= scale
        body["inertia"] *= scale
    path.write_text(yaml.safe_dump(file, sort_keys=False), encoding="utf-8")
    return path


@pytest.mark.parametrize("scale", [1e-1, 1e-2, 1e-3, 1e-4])
@pytest.mark.parametrize("normal", ["worst", "velocity", "0 0 1"])
def test_kernel_equals_the_reference_for_very_light_servo_arms(tmp_path: Path, scale: float, normal: str) -> None:
    """Joints that are held one by one count as immovable from another mass on than free ones."""
    path = light_arm(tmp_path / "light.yaml", scale)
    for model in ("lumped", "full", "largest"):
        chosen = settings_of(drives="servo", contact_normal=normal, effective_mass_model=model, body_regions=WEAKEST)
        dynamics = RobotDynamics(load_robot(path, chosen))
        compare(dynamics, chosen, motions_of(dynamics, 11)[::2])


@pytest.mark.parametrize(("ratio", "reason"), [(0.9, Reason.TOO_LIGHT), (1.1, Reason.NONE)])
def test_kernel_refuses_masses_below_the_least_effective_mass(tmp_path: Path, ratio: float, reason: Reason) -> None:
    chosen = settings_of(effective_mass_model="full", contact_points=("tool",))
    q, qd = np.array([[0.3, 1.2, 0.1, 0.2]]), np.array([[1e-3, 1e-2, 0.0, 0.0]])
    scale = 1.0
    for _ in range(2):  # the mass is that of the arm times its scale
        dynamics = RobotDynamics(load_robot(light_arm(tmp_path / "light.yaml", scale), chosen))
        motions = np.stack([q, qd, *np.zeros((4, 1, 4))], axis=1)
        (contact,) = compare(dynamics, chosen, motions)[0]
        scale *= ratio * MIN_EFFECTIVE_MASS / float(contact["full_mass"])
    assert contact["reason"][CODE] == reason
    assert (contact["verdict"] == Verdict.UNKNOWN) == (reason is Reason.TOO_LIGHT)


@pytest.mark.parametrize("model", ["auto", "lumped", "largest"])
@pytest.mark.parametrize(("normal", "lumped"), [("velocity", Verdict.OK), ("worst", Verdict.UNKNOWN)])
def test_kernel_has_a_lumped_mass_across_the_motion_of_a_massless_joint(
    model: str, normal: str, lumped: Verdict
) -> None:
    """Joint 4 moves no lumped mass and no point along its own axis, along which the arm slides."""
    chosen = settings_of(effective_mass_model=model, contact_normal=normal)
    robot = with_links(ROBOTS[0], chosen, 0)
    dynamics = RobotDynamics(replace(robot, hulls={}))
    motions = motions_of(dynamics, 0)[1:9]
    motions[:, 1:] = 0.0
    motions[:, 1, 2] = 0.05
    contacts = compare(dynamics, chosen, motions)[:, -1]
    assert np.isfinite(contacts["lumped_mass"]).all()
    assert model != "lumped" or (contacts["verdict"] == lumped).all()


@pytest.mark.parametrize("computed_torque", [True, False])
@pytest.mark.parametrize("person_speed", [0.0, 0.3])
@pytest.mark.parametrize("mass_uncertainty", [0.1, 1.0])
def test_kernel_takes_a_light_arm_as_immovable_from_the_same_mobility_as_the_reference(
    tmp_path: Path, *, computed_torque: bool, person_speed: float, mass_uncertainty: float
) -> None:
    """Just below and above MAX_MOBILITY with the margin of the mass; taken too late, the speed would be too high."""
    servo = {"drives": "servo", "servo": {"computed_torque": computed_torque}, "effective_mass_model": "full"}
    chosen = settings_of(**servo, person_speed=person_speed, mass_uncertainty=mass_uncertainty)
    motions = motions_of(RobotDynamics(load_robot(light_arm(tmp_path / "whole.yaml", 1.0), chosen)), 11)[1:2]
    motions[:, 3:] = 0.0
    traces: list[float] = []
    for ratio in (0.9, 0.98, 1.02, 1.1):
        scale = 1.0
        for _ in range(2):  # the mobility is that of the arm over its scale
            path = light_arm(tmp_path / "light.yaml", scale)
            dynamics = RobotDynamics(load_robot(path, chosen))
            expected = computed(ReferenceChannel(dynamics, chosen), dynamics, motions)
            trace = float(expected["full_mobility"][0, 0][[0, 3, 5]].sum())
            scale *= trace / (ratio * MAX_MOBILITY * (1.0 + mass_uncertainty))
        contacts = computed(ContactKernel(dynamics, chosen), dynamics, motions)
        for name in ("allowable_speed", "force_bound", "verdict"):
            np.testing.assert_allclose(contacts[name], expected[name], CANCELLED, CANCELLED, err_msg=f"{name}, {ratio}")
        traces.append(trace / (MAX_MOBILITY * (1.0 + mass_uncertainty)))
    assert traces == pytest.approx([0.9, 0.98, 1.02, 1.1], rel=1e-6)


@pytest.mark.parametrize("count", [0, 1])
def test_few_states_have_the_same_columns(scara: RobotDynamics, count: int) -> None:
    columns = Monitor(scara, MonitorSettings()).assess_configurations(*np.zeros((2, count, 4))).columns()
    assert columns["lumped_mobility"].shape == (6, count)
    assert columns["direction"].shape == (3, count)
    assert columns["speed"].shape == columns["mass_model"].shape == (count,)


def test_columns_are_the_fields_of_decisions(scara: RobotDynamics) -> None:
    monitor, motions = Monitor(scara, MonitorSettings(test_direction=(0.0, 0.0, 1.0))), motions_of(scara, 5)
    assessments = monitor.assess_configurations(motions[:, 0], motions[:, 1])
    columns, (indices, texts) = assessments.columns(), assessments.reasons(0)
    verdicts = set()
    for row, decision in enumerate(assessments.decisions()):
        (contact,) = decision.contacts
        verdicts.add(contact.verdict)
        assert (contact.reason, contact.reason_code) == (texts[indices[row]], Reason(int(columns["reason"][CODE, row])))
        for name, column in columns.items():
            if name in assessments.labels:
                assert getattr(contact, name) == assessments.labels[name][int(column[row])]
            elif name != "reason":
                np.testing.assert_array_equal(getattr(contact, name), column[..., row])
    assert verdicts == {Verdict.OK, Verdict.WARN, Verdict.VIOLATION}


def test_robot_with_too_many_joints_uses_the_reference(tmp_path: Path) -> None:
    rows = "".join(
        f"  - {{name: joint{i}, type: revolute, a: 0.1, alpha: 0.0, d: 0.0, theta: 0.0, lower: -1, upper: 1, "
        "max_speed: 1}\n"
        for i in range(MAX_JOINTS + 1)
    )
    links = "".join(
        f"  - {{name: link{i}, mass: 1.0, com: [0.1, 0.0, 0.02], inertia: [0.01, 0.01, 0.01, 0, 0, 0]}}\n"
        for i in range(MAX_JOINTS + 1)
    )
    path = tmp_path / "chain.yaml"
    head = "robot: chain\nbase_frame: base\ncontact_points: {tip: [0, 0, 0]}\n"
    path.write_text(f"{head}joints:\n{rows}links:\n{links}", encoding="utf-8")
    monitor = Monitor(RobotDynamics(load_robot(path, MonitorSettings())), MonitorSettings())
    reason = f"the compiled kernel is for at most {MAX_JOINTS} joints, the robot has {MAX_JOINTS + 1}"
    assert monitor.core == f"reference: {reason}"
    (decision,) = monitor.assess_configurations(np.full((1, 17), 0.1), np.full((1, 17), 0.01)).decisions()
    assert decision.verdict is not Verdict.UNKNOWN

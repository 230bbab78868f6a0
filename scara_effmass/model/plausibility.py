# SPDX-License-Identifier: Apache-2.0
"""Judge the data of a robot file: inertias of bodies that can exist, and numbers in SI units.

The bounds lie a factor of five or more beyond those of 50 published arms, legs and humanoids with reaches of 0.1 to
1.3 m: 4 to 117 kg moving mass per reach cubed [kg/m3], links of at most 0.65 m and at least 0.63 kg per length and
reach squared [kg/m3], joint ranges of at most 20 rad, radii of gyration of 0.08 to 0.6 reaches.
"""

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from scara_effmass.model.description import MAX_VIRTUAL_M, StatedLink, link_length, principal_moments
from scara_effmass.model.robot import Robot
from scara_effmass.values import FloatArray

MAX_LINK_M, LONG_LINK_M = 10.0, 3.0
"""Length of a link that is certainly not in metres, and one that is worth a note; the other pairs likewise."""
MIN_REACH_M = 0.05
MAX_DENSITY, HIGH_DENSITY, LOW_DENSITY, LIGHT_DENSITY, MIN_DENSITY = 3000.0, 600.0, 4.0, 2.0, 0.1
"""Moving mass over the cube of the reach [kg/m3]; below LIGHT_DENSITY the masses do not count."""
LIGHT_LINK_DENSITY = 0.1
"""Mass of a link over its length and the square of the reach [kg/m3] below which it does not count."""
MAX_DISTANCE_M = 5.0
"""Distance of a centre of mass from its joint, or radius of gyration, if it also exceeds three reaches."""
MIN_GYRATION = 0.015
"""Largest radius of gyration over the reach below which the inertia tensors do not count."""
FAR_GEOMETRY = 0.7
"""Distance of geometry from the frame of its link over the reach; it is at most 0.5 in 55 arms, legs and humanoids."""
MIN_DEGREES, MAX_DEGREES = 50.0, 1500.0
"""Between these, the range [rad] of a revolute joint is one in degrees if all are; a wider one means no limit."""
WIDE_RANGE_RAD, WIDE_RANGE_M, NO_RANGE = 6.0 * math.pi + 0.01, 10.0, 1e5
MIN_SHARE = 0.01
"""Share of the mass of its rigid body from which on data of a link count: a frame may have a gram, and no tensor."""
_TRIANGLE = 1e-3
"""Relative tolerance of the triangle inequality, for values rounded in the file."""
MASS_REMEDY = "correct the masses, or state moving_mass"


class InertialCheck(NamedTuple):
    """Why masses, centres of mass and inertias are implausible (empty if they are plausible), and notes."""

    masses: str
    coms: str
    inertias: str
    notes: tuple[str, ...]


def _heavy(links: Sequence[StatedLink]) -> list[StatedLink]:
    """Return the links whose data count."""
    return [link for link in links if link.mass > 0.0 and link.share >= MIN_SHARE]


def check_inertials(links: Sequence[StatedLink]) -> InertialCheck:
    """Find placeholders and impossible tensors in `links`. A pattern needs at least two links with mass."""
    heavy = _heavy(links)
    placeholders = [link.name for link in links if link.mass > 0.0 and link.placeholder]
    all_placeholders = len(heavy) > 1 and all(link.placeholder for link in heavy)
    masses = coms = inertias = ""
    notes: tuple[str, ...] = ()
    if all_placeholders and all(link.mass == 1.0 for link in heavy):
        masses = "every link has mass 1 and identity inertia: placeholders, not data"
    if len(heavy) > 1 and all(np.allclose(link.com, 0.0) for link in heavy):
        coms = "every centre of mass lies at its link's origin: placeholders, not data"
        if max(Counter(link.mass for link in heavy).values()) >= max(3, len(heavy) - 1):
            masses = masses or f"the same mass at the origin of each link: placeholders, not data: {MASS_REMEDY}"
    without_inertia = [link.name for link in heavy if np.allclose(link.inertia, 0.0, atol=1e-12)]
    if len(without_inertia) == len(heavy):
        inertias = "the file gives no inertia tensors"
    elif without_inertia:
        inertias = f"no inertia tensor for {', '.join(without_inertia)}, while other links have one"
    elif all_placeholders:
        inertias = "every inertia tensor is the identity, or the mass times it: placeholders, not data"
    else:
        inertias = next(filter(None, map(triangle_error, heavy)), "")
        if placeholders:
            notes = (f"placeholder inertia, used as stated, which makes the robot heavier: {', '.join(placeholders)}",)
        elif equal := _equal_tensors(heavy):
            notes = (f"check the inertias: links of unequal masses have the same one: {', '.join(equal)}",)
    return InertialCheck(masses, coms, inertias, notes)


def _equal_tensors(heavy: Sequence[StatedLink]) -> list[str]:
    """Return the links that share one inertia tensor though their masses differ, if it is that of all but one."""
    tensors = [link.inertia.tobytes() for link in heavy]
    tensor, count = Counter(tensors).most_common(1)[0]
    equal = [link for link, own in zip(heavy, tensors, strict=True) if own == tensor]
    is_pattern = count >= max(3, len(heavy) - 1) and len({link.mass for link in equal}) > 1
    return [link.name for link in equal] if is_pattern else []


def triangle_error(link: StatedLink) -> str:
    """Return why the inertia of `link` is impossible, or an empty string. Raises ValueError for a negative moment."""
    low, middle, high = principal_moments(link.inertia)
    if high <= (low + middle) * (1.0 + _TRIANGLE):
        return ""
    return (
        f"the inertia of {link.name} is impossible: its principal moments ({low:.6g}, {middle:.6g}, {high:.6g}) kg m2 "
        "violate the triangle inequality"
    )


class Plausibility(NamedTuple):
    """Reach [m] from the first joint, why the units are certainly not SI (empty if they may be), and doubts.

    `masses` states why masses are too small for an arm of that reach, or placeholders; empty if they are not.
    `inertias` states why the inertia tensors do not count.
    """

    reach: float
    units: str
    notes: tuple[str, ...]
    masses: str = ""
    inertias: str = ""


def judge(robot: Robot, links: Sequence[StatedLink]) -> Plausibility:
    """Judge `robot` and its `links` over its joint ranges; only the notes depend on the payload of the settings."""
    model, data = robot.model, robot.model.createData()
    reach, arm_reach, gravity, matrices, jacobians = 0.0, 0.0, np.zeros(model.nv), [], []
    slides = ~np.array(robot.revolute)
    for q in robot.sample_configurations():
        reach = max(reach, _reach(robot, data, q))
        # The travel of a slide, such as that of a base, is no size of an arm.
        at_rest = np.where(slides, np.clip(0.0, *_limits(robot)), q)
        arm_reach = max(arm_reach, _reach(robot, data, at_rest)) if slides.any() else reach
        gravity = np.maximum(gravity, np.abs(pin.computeGeneralizedGravity(model, data, q)))
        if not robot.inertias_reason:
            frame = next(iter(robot.contact_frames.values()))
            jacobian = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)[:3].reshape(3, -1)
            jacobians.append(jacobian)
            matrices.append(robot.mass_matrix(model, data, q))
    wrong = list(_wrong(robot, reach))
    if wrong:
        return Plausibility(reach, "; ".join(wrong), ())
    mass = math.nan
    if matrices:
        mobility = np.array(jacobians) @ np.linalg.pinv(np.array(matrices)) @ np.array(jacobians).swapaxes(1, 2)
        mass = float(np.median(3.0 / np.trace(mobility, axis1=1, axis2=2).clip(1e-12)))
    notes = (*_doubts(robot, reach, arm_reach, mass), *_hull_doubts(robot, reach), *_joint_doubts(robot, gravity))
    masses = _too_light(robot, arm_reach) or _equal_links(robot)
    inertias = "" if robot.inertias_reason else _too_compact(links, arm_reach)
    return Plausibility(reach, "", notes, masses, inertias)


def _limits(robot: Robot) -> tuple[FloatArray, FloatArray]:
    return robot.model.lowerPositionLimit, robot.model.upperPositionLimit


def _reach(robot: Robot, data: pin.Data, q: FloatArray) -> float:
    """Return the largest distance [m] of tip and contact points from the first joint at `q`."""
    model = robot.model
    pin.framesForwardKinematics(model, data, q)
    base = data.oMi[1].translation
    ends = [data.oMi[model.njoints - 1] * robot.tip, *(data.oMf[frame] for frame in robot.contact_frames.values())]
    return max(float(np.linalg.norm(end.translation - base)) for end in ends)


def _too_light(robot: Robot, reach: float) -> str:
    """Return why the moving mass is too small for an arm with this `reach` [m], empty if it is not."""
    mass, reach_m = robot.moving_mass + robot.payload_mass, max(reach, MIN_REACH_M)
    if mass < LIGHT_DENSITY * reach_m**3:
        share = "less than half as much as in the lightest arms"
        return f"{mass:.3g} kg move at a reach of {reach:.3g} m, {share}: {MASS_REMEDY}"
    for name, length, body in _links(robot):
        if length > MAX_VIRTUAL_M and 0.0 < body.mass < LIGHT_LINK_DENSITY * length * reach_m**2:
            return (
                f"{body.mass:.3g} kg in the {length:.3g} m long link behind {name}, less than a fifth of that in the "
                f"lightest arms: {MASS_REMEDY}"
            )
    return ""


def _too_compact(links: Sequence[StatedLink], reach: float) -> str:
    """Return why the inertias of `links` are too small for an arm with this `reach` [m], empty if they are not."""
    radii = [math.sqrt(max(principal_moments(link.inertia)) / link.mass) for link in _heavy(links)]
    if max(radii, default=math.inf) >= MIN_GYRATION * max(reach, MIN_REACH_M):
        return ""
    return (
        f"the largest radius of gyration of a link is {max(radii):.3g} m at a reach of {reach:.3g} m, less than a "
        "fifth of that in published arms: correct the inertias, in kg m2"
    )


def _equal_links(robot: Robot) -> str:
    """Return which links have the same mass and inertia, but other lengths, empty if not three of them.

    Without a frame at its end, the length of the last link is unknown.
    """
    links = [(name, length, body) for name, length, body in _links(robot) if body.mass > 0.0 and body.inertia.any()]
    if links and links[-1][0] == robot.joint_names[-1] and not links[-1][1]:
        del links[-1]
    for _, _, first in links:
        equal = [
            link for link in links if link[2].mass == first.mass and np.array_equal(link[2].inertia, first.inertia)
        ]
        lengths = [length for _, length, _ in equal]
        if len(equal) > 2 and min(lengths) < 0.9 * max(lengths):
            names = ", ".join(name for name, *_ in equal)
            problem = f"equal masses and inertias of unequal links, behind {names}"
            return f"{problem}: placeholders, not data: {MASS_REMEDY}"
    return ""


def _links(robot: Robot) -> Iterator[tuple[str, float, pin.Inertia]]:
    """Yield joint, length [m] to the farthest next joint or to the tip, and inertia of each body."""
    model = robot.model
    for joint in range(1, model.njoints):
        ends = [robot.tip] if joint == model.njoints - 1 else []
        yield model.names[joint], link_length(model, joint, ends), model.inertias[joint]


def _wrong(robot: Robot, reach: float) -> Iterator[str]:
    """Yield what is certainly not in SI units."""
    link, length = _longest_link(robot)
    name, extent = _longest_hull(robot)
    if extent > MAX_LINK_M:
        yield f"the geometry of {name} is {extent:.4g} m long: must be in metres, not in millimetres"
    if length > MAX_LINK_M:
        unit, factor = ("millimetres", 1e3) if length > 50.0 else ("centimetres", 1e2)
        yield f"{link} is {length:.4g} m long: must be in metres, not in {unit}"
        reach /= factor
    masses, volume = f"{robot.moving_mass:.4g} kg move at a reach of {reach:.3g} m", max(reach, MIN_REACH_M) ** 3
    if reach and robot.moving_mass > MAX_DENSITY * volume:  # a file may have no frame beyond the first joint
        yield f"{masses}: must be in kilograms, not in grams"
    elif robot.moving_mass + robot.payload_mass < MIN_DENSITY * volume:
        yield f"{masses}: must be in kilograms, not in tonnes, and lengths in metres"
    elif length <= MAX_LINK_M:
        farthest = max(MAX_DISTANCE_M, 3.0 * reach)
        name, _, distance, _ = max(_bodies(robot), key=lambda body: body[2])
        if distance > farthest:
            yield f"the centre of mass of {name} is {distance:.4g} m away: must be in metres, not in millimetres"
        name, mass, _, radius = max(_bodies(robot), key=lambda body: body[3])
        if radius > 2.0 * farthest and not robot.inertias_reason:
            yield f"the inertia of {name} is that of {mass:.3g} kg at {radius:.4g} m: must be in kg m2, not kg mm2"
    ranges = dict(_bounded_ranges(robot))
    if ranges and all(MIN_DEGREES < width <= MAX_DEGREES for width in ranges.values()):
        name, width = max(ranges.items(), key=lambda item: item[1])
        yield f"{name} has a range of {width:.4g} rad: must be in radians, not in degrees"


def _doubts(robot: Robot, reach: float, arm_reach: float, mass: float) -> Iterator[str]:
    """Yield lengths, masses and inertias that may be correct, and are worth a look.

    `mass` [kg] is the typical effective mass, NaN if the inertias are unknown; `arm_reach` [m] is the
    reach with all slides at rest.
    """
    link, length = _longest_link(robot)
    if length > LONG_LINK_M or reach < MIN_REACH_M:
        yield f"check the lengths: reach {reach:.3g} m, {link} is {length:.3g} m long"
    densities = [robot.moving_mass / max(length, MIN_REACH_M) ** 3 for length in (reach, arm_reach)]
    if not robot.masses_reason and (densities[0] > HIGH_DENSITY or densities[1] < LOW_DENSITY):
        yield f"check the masses: {robot.moving_mass:.3g} kg move at a reach of {reach:.3g} m"
    for name, _, distance, _ in _bodies(robot):
        if distance > reach:
            yield f"check the centre of mass of {name}: {distance:.3g} m from its joint, reach {reach:.3g} m"
    radius = max((radius for _, _, _, radius in _bodies(robot)), default=0.0)
    if not robot.inertias_reason and not 0.03 * reach <= radius <= 3.0 * reach:
        yield f"check the inertias: the largest radius of gyration is {radius:.3g} m at a reach of {reach:.3g} m"
    ratio = mass / (robot.moving_mass + robot.payload_mass)
    if ratio <= 1e-3 or ratio >= 3.0:
        yield f"check masses and inertias: the effective mass is typically {ratio:.2g} of the moving mass"
    if robot.payload_mass > 3.0 * robot.moving_mass:
        yield f"check the payload: {robot.payload_mass:.4g} kg on {robot.moving_mass:.3g} kg moving mass"


def _hull_doubts(robot: Robot, reach: float) -> Iterator[str]:
    """Yield geometry that is longer than the robot, or far from the frame of its link."""
    name, extent = _longest_hull(robot)
    if extent > max(3.0 * reach, LONG_LINK_M):
        yield f"check the geometry of {name}: {extent:.3g} m long, reach {reach:.3g} m"
    for name, hull in robot.hulls.items():
        place = robot.model.frames[robot.contact_frames[name]].placement
        points = (hull - place.translation) @ place.rotation
        distance = float(np.linalg.norm(np.clip(0.0, points.min(axis=0), points.max(axis=0))))
        if distance > FAR_GEOMETRY * reach:
            yield f"check the geometry of {name}: {distance:.3g} m from the frame of the link, reach {reach:.3g} m"


def _joint_doubts(robot: Robot, gravity: FloatArray) -> Iterator[str]:
    """Yield ranges and effort limits that are worth a look; `gravity` (n,) is the largest over the poses [N m, N]."""
    for name, width in _bounded_ranges(robot):
        if width > WIDE_RANGE_RAD:
            yield f"check the limits of {name}: {width:.4g} rad are more than three turns"
    spans = zip(robot.joint_names, robot.revolute, _widths(robot), strict=True)
    for name in (name for name, revolute, width in spans if not revolute and WIDE_RANGE_M < width < NO_RANGE):
        yield f"check the limits of {name}: it travels more than {WIDE_RANGE_M:g} m"
    loads = [row for row in zip(robot.joint_names, robot.effort_limits, gravity, strict=True) if row[2] > 1e-3]
    for name, effort, load in loads:
        if effort < 0.5 * load or all(1e3 * other < limit < np.inf for _, limit, other in loads):
            yield f"check the effort limit of {name}: {effort:.3g} N m or N, where gravity takes up to {load:.3g}"


def _longest_link(robot: Robot) -> tuple[str, float]:
    """Return the longest link [m]: from a joint to the next, or to the tip or a contact point."""
    model = robot.model
    joints = range(2, model.njoints)
    spans = [(model.names[model.parents[i]], model.names[i], model.jointPlacements[i]) for i in joints]
    spans.append((model.names[model.njoints - 1], "the tip", robot.tip))
    frames = [(name, model.frames[frame]) for name, frame in robot.contact_frames.items()]
    spans += [(model.names[frame.parentJoint], name, frame.placement) for name, frame in frames]
    start, end, placement = max(spans, key=lambda span: float(np.linalg.norm(span[2].translation)))
    return f"the link from {start} to {end}", float(np.linalg.norm(placement.translation))


def _longest_hull(robot: Robot) -> tuple[str, float]:
    """Return the contact with the longest geometry, and its length [m], 0 without any."""
    extents = [(name, float(np.ptp(hull, axis=0).max())) for name, hull in robot.hulls.items()]
    return max(extents, key=lambda hull: hull[1], default=("", 0.0))


def _bodies(robot: Robot) -> Iterator[tuple[str, float, float, float]]:
    """Yield joint, mass [kg], distance of the centre of mass [m] and radius of gyration [m] of each body with mass."""
    for name, body in zip(robot.joint_names, list(robot.model.inertias)[1:], strict=True):
        if body.mass > 0.0:
            moment = max(float(np.linalg.eigvalsh(body.inertia)[-1]), 0.0)
            yield name, body.mass, float(np.linalg.norm(body.lever)), math.sqrt(moment / body.mass)


def _widths(robot: Robot) -> list[float]:
    return list((robot.model.upperPositionLimit - robot.model.lowerPositionLimit).tolist())


def _bounded_ranges(robot: Robot) -> Iterator[tuple[str, float]]:
    """Yield name and range [rad] of the revolute joints that have limits."""
    for name, revolute, width in zip(robot.joint_names, robot.revolute, _widths(robot), strict=True):
        if revolute and width < NO_RANGE:
            yield name, width

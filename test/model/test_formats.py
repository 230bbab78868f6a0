# SPDX-License-Identifier: Apache-2.0
"""The same robot as DH rows and as URDF: same masses, rotors, payload and contact points; and points on any link."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from scara_effmass.codes import ModelCode
from scara_effmass.errors import RobotError
from scara_effmass.model.load import build_robot, load_robot
from scara_effmass.model.robot import Robot
from scara_effmass.model.urdf import parse_urdf
from scara_effmass.reference import RobotDynamics
from scara_effmass.settings import MonitorSettings


def random_rows(seed: int, joints: int) -> dict[str, Any]:
    """Return DH rows with skew axes, full tensors, armatures and a payload."""
    rng = np.random.default_rng(seed)

    def body(name: str) -> dict[str, Any]:
        masses, points = rng.uniform(0.1, 1.0, 6), rng.uniform(-0.1, 0.1, (6, 3))
        spread = sum(m * (p @ p * np.eye(3) - np.outer(p, p)) for m, p in zip(masses, points, strict=True))
        inertia = [float(spread[i, j]) for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
        return {
            "name": name,
            "mass": float(masses.sum()),
            "com": rng.uniform(-0.2, 0.2, 3).tolist(),
            "inertia": inertia,
        }

    rows = [
        {"name": f"j{i}", "type": "prismatic" if rng.random() < 0.2 else "revolute", "lower": -2.0, "upper": 2.0}
        | dict(zip(("a", "alpha", "d", "theta"), rng.uniform(-0.5, 0.5, 4).tolist(), strict=True))
        | {"max_speed": 3.0, "armature": float(rng.uniform(0.0, 0.3))}
        for i in range(1, joints + 1)
    ]
    rows[0]["type"] = "revolute"
    links = [body(f"link{i}") for i in range(1, joints + 1)]
    points = {"tool": rng.uniform(-0.2, 0.2, 3).tolist()}
    points["elbow"] = {"link": (joints + 1) // 2, "at": rng.uniform(0.1, 0.3, 3).tolist()}
    return {
        "robot": "arm", "base_frame": "base", "joints": rows, "links": links, "payload": body("load"),
        "contact_points": points,
    }  # fmt: skip


def as_urdf(rows: dict[str, Any]) -> str:
    """Return the same robot as URDF: a moving link per joint, with the DH frames and the payload fixed to them."""

    def link(name: str, row: dict[str, Any] | None = None) -> str:
        if row is None:
            return f'<link name="{name}"/>'
        xx, yy, zz, xy, xz, yz = row["inertia"]
        com = " ".join(map(repr, row["com"]))
        return (
            f'<link name="{name}"><inertial><origin xyz="{com}"/><mass value="{row["mass"]!r}"/><inertia '
            f'ixx="{xx!r}" iyy="{yy!r}" izz="{zz!r}" ixy="{xy!r}" ixz="{xz!r}" iyz="{yz!r}"/></inertial></link>'
        )

    def joint(name: str, kind: str, parent: str, child: str, pose: str, more: str = "") -> str:
        return (
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{pose}{more}</joint>'
        )

    parts, parent = [link("base")], "base"
    for i, (row, body) in enumerate(zip(rows["joints"], rows["links"], strict=True), start=1):
        limit = '<axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="1" velocity="3"/>'
        limit += f'<dynamics armature="{row["armature"]!r}"/>'
        parts += [link(f"turn{i}"), joint(row["name"], row["type"], parent, f"turn{i}", "", limit)]
        pose = f'<origin xyz="0 0 {row["d"]!r}" rpy="0 0 {row["theta"]!r}"/>'
        parts += [link(body["name"], body), joint(f"fix{i}", "fixed", f"turn{i}", body["name"], pose)]
        pose = f'<origin xyz="{row["a"]!r} 0 0" rpy="{row["alpha"]!r} 0 0"/>'
        parts += [link(f"dh{i}"), joint(f"next{i}", "fixed", body["name"], f"dh{i}", pose)]
        parent = f"dh{i}"
    parts += [link("gripper", rows["payload"]), joint("mount", "fixed", parent, "gripper", "")]
    return f'<robot name="arm">{"".join(parts)}</robot>'


def both(rows: dict[str, Any], directory: Path, **options: object) -> tuple[Robot, Robot]:
    """Return the robot from its DH file and from its URDF, with the same load."""
    path = directory / "robot.yaml"
    path.write_text(yaml.safe_dump(rows, sort_keys=False), encoding="utf-8")
    tool, elbow = rows["contact_points"]["tool"], rows["contact_points"]["elbow"]
    points = (
        f"tool=dh{len(rows['joints'])}: {' '.join(map(repr, tool))}",
        f"elbow=link{elbow['link']}: {' '.join(map(repr, elbow['at']))}",
    )
    urdf_settings = MonitorSettings.model_validate({"contact_points": points, "tool_links": ("grip*",), **options})
    return (
        load_robot(path, MonitorSettings.model_validate(options)),
        build_robot(parse_urdf(as_urdf(rows), "arm.urdf", urdf_settings), urdf_settings),
    )


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    seed=st.integers(0, 10**6),
    joints=st.integers(2, 6),
    load=st.floats(0.0, 5.0),
    com=st.tuples(*[st.floats(-0.3, 0.3)] * 3),
)
def test_dh_file_and_urdf_give_the_same_robot(
    tmp_path: Path, seed: int, joints: int, load: float, com: tuple[float, float, float]
) -> None:
    """M, m_L, M(q) and the motion of each point agree to 1e-12, and their masses as the condition of M(q) allows."""
    rows = random_rows(seed, joints)
    dh, urdf = both(rows, tmp_path, payload_mass=load, payload_com=com)
    links = sum(link["mass"] for link in rows["links"])
    for robot in (dh, urdf):
        assert robot.moving_mass == pytest.approx(links, rel=1e-12)
        assert robot.payload_mass == pytest.approx(rows["payload"]["mass"] + load, rel=1e-12)
        assert robot.iso_mass == pytest.approx(links / 2.0 + rows["payload"]["mass"] + load, rel=1e-12)
    np.testing.assert_array_equal(dh.rotors.matrix, urdf.rotors.matrix)
    first, second = RobotDynamics(dh), RobotDynamics(urdf)
    assert first.contact_points == second.contact_points == ("tool", "elbow")
    rng = np.random.default_rng(seed)
    for q in dh.sample_configurations()[:4]:
        qd = rng.normal(size=joints)
        mine, theirs = (robot.mass_matrix(robot.model, robot.model.createData(), q) for robot in (dh, urdf))
        np.testing.assert_allclose(mine, theirs, rtol=1e-12, atol=1e-12 * np.abs(mine).max())
        for one, other in zip(first.at(q, qd).contacts, second.at(q, qd).contacts, strict=True):
            assert one.speed == pytest.approx(other.speed, rel=1e-12)
            assert one.full == pytest.approx(other.full, rel=1e-10)


def test_tool_counts_the_same_in_both_formats(tmp_path: Path) -> None:
    """Without tool_links, half of the tool's mass is missing from M/2 + m_L of the URDF."""
    rows = random_rows(1, 4)
    dh, urdf = both(rows, tmp_path)
    _, plain = both(rows, tmp_path, tool_links=())
    assert urdf.iso_mass == pytest.approx(dh.iso_mass, rel=1e-12)
    assert plain.iso_mass == pytest.approx(dh.iso_mass - rows["payload"]["mass"] / 2.0, rel=1e-12)


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 10**6), joints=st.integers(2, 6))
def test_payload_of_the_settings_equals_that_of_the_file(tmp_path: Path, seed: int, joints: int) -> None:
    """Mass, centre of mass and inertia reach M(q), whichever way they are stated."""
    rows = random_rows(seed, joints)
    rows["contact_points"]["tool"] = [0.0, 0.0, 0.0]
    load = rows["payload"]
    stated, _ = both(rows, tmp_path)
    rows["payload"] = {"mass": 0.0}
    path = tmp_path / "bare.yaml"
    path.write_text(yaml.safe_dump(rows, sort_keys=False), encoding="utf-8")
    options = {"payload_mass": load["mass"], "payload_com": load["com"], "payload_inertia": load["inertia"]}
    robot = load_robot(path, MonitorSettings.model_validate(options))
    assert robot.payload_mass == pytest.approx(load["mass"])
    assert robot.iso_mass == pytest.approx(stated.iso_mass)
    q = stated.sample_configurations()[0]
    expected, matrix = (r.mass_matrix(r.model, r.model.createData(), q) for r in (stated, robot))
    np.testing.assert_allclose(matrix, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())
    assert not any("point mass" in note for note in robot.notes)
    point = load_robot(path, MonitorSettings(payload_mass=load["mass"]))
    assert any("point mass" in note for note in point.notes)


@pytest.mark.parametrize(
    ("mass", "inertia", "problem"),
    [
        (2.0, (0.1, 0.1, -0.1, 0.0, 0.0, 0.0), "must not be negative"),
        (2.0, (0.1, 0.1, 0.3, 0.0, 0.0, 0.0), "violate the triangle inequality"),
        (2.0, (0.1, 0.1, 0.1, 0.3, 0.0, 0.0), "must not be negative"),
        (0.0, (0.1, 0.1, 0.1, 0.0, 0.0, 0.0), "must be 0 without payload_mass"),
        (1e-9, (1.0, 1.0, 1.0, 0.0, 0.0, 0.0), "must be of a radius of gyration of at most 2 m"),
    ],
)
def test_impossible_payload_is_refused(mass: float, inertia: tuple[float, ...], problem: str, omron_file: Path) -> None:
    options = MonitorSettings.model_validate({"payload_mass": mass, "payload_inertia": inertia})
    with pytest.raises(RobotError, match=rf"^payload_inertia = \[.*\]: .*{problem}"):
        load_robot(omron_file, options)


@pytest.mark.parametrize("load", [0.0, 2.5])
def test_rebuilt_payload_is_the_loaded_one(omron_file: Path, load: float) -> None:
    before = load_robot(omron_file, MonitorSettings(payload_mass=1.0))
    options = MonitorSettings(payload_mass=load, payload_com=(0.05, 0.0, 0.1))
    changed, loaded = before.rebuild(options), load_robot(omron_file, options)
    assert changed.payload == loaded.payload
    for one, other in zip(changed.model.inertias, loaded.model.inertias, strict=True):
        np.testing.assert_allclose(one.matrix(), other.matrix(), rtol=1e-12, atol=1e-15)
    assert changed.payload_text == "0.25 kg (robot file)" + (f" + {load} kg (parameter payload_mass)" if load else "")


def test_tool_links_of_a_dh_file(omron_file: Path) -> None:
    robot = load_robot(omron_file, MonitorSettings(tool_links=("link4",)))
    assert robot.payload == pytest.approx({"robot file": 0.25, "tool_links link4": 0.1})
    assert robot.iso_mass == pytest.approx(4.94 / 2.0 + 0.35)


def test_tool_links_that_match_nothing_raise(omron_file: Path) -> None:
    with pytest.raises(RobotError, match=r"omron.*: tool_links = 'gripper': must match one of the links link1, link2"):
        load_robot(omron_file, MonitorSettings(tool_links=("gripper",)))


class TestElbow:
    def test_shipped_robot_watches_tool_elbow_and_links(self, omron_file: Path) -> None:
        links = "link1", "link2", "link3", "link4"
        assert RobotDynamics(load_robot(omron_file)).contact_points == ("tool", "elbow", *links)

    @given(q1=st.floats(-2.3, 2.3), q2=st.floats(-2.5, 2.5), rate=st.floats(0.1, 3.0))
    def test_mass_is_the_closed_form_of_the_planar_mechanism(
        self, omron_file: Path, q1: float, q2: float, rate: float
    ) -> None:
        """The elbow moves M2, and M3 only along link 2: M2 + M3 sin²(q2), at the speed l1 q1'."""
        robot = load_robot(omron_file)
        dynamics = RobotDynamics(robot)
        assert dynamics.lumped is not None
        m2, m3 = dynamics.lumped.planar_masses(robot)
        elbow = dynamics.at(np.array([q1, q2, 0.1, 0.0]), np.array([rate, -0.7, 0.1, 0.2])).contacts[1]
        assert elbow.speed == pytest.approx(0.275 * rate, rel=1e-12)
        assert elbow.lumped == pytest.approx(m2 + m3 * np.sin(q2) ** 2, rel=1e-9)
        assert elbow.effective_mass(ModelCode.LUMPED, None) == pytest.approx(elbow.lumped, rel=1e-6)
        assert elbow.no_lumped_mass(elbow.direction) is None

    @pytest.mark.parametrize("entry", ["elbow", "elbow=link1: 0.275 0 0"])
    def test_entry_of_the_setting_gives_the_same_point(self, omron_file: Path, entry: str) -> None:
        one = load_robot(omron_file, MonitorSettings(contact_points=(entry,)))
        (frame,) = one.contact_frames.values()
        shipped = load_robot(omron_file)
        expected = shipped.model.frames[shipped.contact_frames["elbow"]]
        assert one.model.frames[frame].placement.isApprox(expected.placement)
        assert one.model.frames[frame].parentJoint == expected.parentJoint

    def test_number_and_name_of_a_link_are_the_same(
        self, omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]
    ) -> None:
        omron_rows["contact_points"] = {
            "one": {"link": 2, "at": [0.1, 0.0, 0.05]},
            "other": {"link": "link2", "at": [0.1, 0.0, 0.05]},
        }
        robot = load_rows(omron_rows)
        one, other = (robot.model.frames[frame] for frame in robot.contact_frames.values())
        assert one.parentJoint == other.parentJoint == 2
        assert one.placement.isApprox(other.placement)

    def test_upper_arm_of_a_urdf(self, load_urdf_file: Callable[..., Robot]) -> None:
        points = ["tool0", "elbow=upper_arm_link: 0 0 0.425"]
        robot = load_urdf_file("ur5_robot.urdf", contact_points=points, payload_mass=2.0)
        assert list(robot.contact_frames) == ["tool0", "elbow"]
        frame = robot.model.frames[robot.contact_frames["elbow"]]
        assert robot.model.names[frame.parentJoint] == "shoulder_lift_joint"
        np.testing.assert_allclose(frame.placement.translation, [0.0, 0.0, 0.425], atol=1e-12)
        assert len(RobotDynamics(robot).at(np.zeros(6), np.ones(6)).contacts) == 2

    @pytest.mark.parametrize(
        "entry",
        ["=link1: 0 0 0", "elbow=", "elbow=link1: 0 0", "elbow=link1: a b c", "elbow=link1: nan 0 0", "e=9: 0 0 0"],
    )
    def test_wrong_entry_raises(self, omron_file: Path, entry: str) -> None:
        with pytest.raises(RobotError, match=r"contact_points = .*must be"):
            load_robot(omron_file, MonitorSettings(contact_points=(entry,)))

    def test_name_stated_twice_raises(self, omron_file: Path) -> None:
        with pytest.raises(RobotError, match="contact_points = 'tool': must name each point once"):
            load_robot(omron_file, MonitorSettings(contact_points=("tool", "tool=link1: 0 0 0")))

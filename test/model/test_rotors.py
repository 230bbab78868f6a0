# SPDX-License-Identifier: Apache-2.0
"""Rotor inertia: where it comes from, that it is added exactly, and that a joint without it is named."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from scara_effmass.errors import RobotError
from scara_effmass.model.load import build_robot, load_robot
from scara_effmass.model.robot import Robot
from scara_effmass.model.urdf import parse_urdf
from scara_effmass.reference import RobotDynamics
from scara_effmass.settings import MonitorSettings
from scara_effmass.share import share
from scara_effmass.values import FloatArray

LENGTHS, MASSES, CENTRES, INERTIAS = (0.4, 0.3, 0.2), (3.0, 2.0, 1.0), (0.2, 0.12, 0.1), (0.05, 0.02, 0.01)


def planar_rows(joints: int, **top: object) -> dict[str, Any]:
    """Return DH rows of a planar chain of 2 or 3 revolute joints."""
    return {
        "robot": f"{joints}r",
        "base_frame": "base",
        "joints": [
            {"name": f"j{i + 1}", "type": "revolute", "a": LENGTHS[i], "alpha": 0.0, "lower": -3, "upper": 3}
            | {"max_speed": 3.0}
            for i in range(joints)
        ],
        "links": [
            {"name": f"link{i + 1}", "mass": MASSES[i], "com": [CENTRES[i], 0.0, 0.0], "inertia": INERTIAS[i]}
            for i in range(joints)
        ],
        "contact_points": {"tool": [0.0, 0.0, 0.0]},
        **top,
    }


def planar_mass(q: FloatArray, rotors: FloatArray, direction: float) -> float:
    """Closed form of the effective mass at the end of the planar chain along `direction` [rad], by Lagrange."""
    n = len(q)
    angles = np.cumsum(q)
    matrix = rotors.copy()
    for i in range(n):
        # Column j: z x (point - origin of joint j), for the centre of mass of link i.
        reach = [*LENGTHS[:i], CENTRES[i]]
        jacobian = np.zeros((2, n))
        for j in range(i + 1):
            steps = [(reach[k] * np.cos(angles[k]), reach[k] * np.sin(angles[k])) for k in range(j, i + 1)]
            x, y = np.sum(steps, axis=0)
            jacobian[:, j] = -y, x
        turning = np.array([float(j <= i) for j in range(n)])
        matrix = matrix + MASSES[i] * jacobian.T @ jacobian + INERTIAS[i] * np.outer(turning, turning)
    end = np.zeros((2, n))
    for j in range(n):
        x, y = np.sum([(LENGTHS[k] * np.cos(angles[k]), LENGTHS[k] * np.sin(angles[k])) for k in range(j, n)], axis=0)
        end[:, j] = -y, x
    normal = np.array([np.cos(direction), np.sin(direction)])
    return float(1.0 / (normal @ end @ np.linalg.solve(matrix, end.T) @ normal))


def coupled(joints: int, seed: int = 0) -> FloatArray:
    """Return B = T^T J T of motors that turn with neighbouring joints, as in a belt-driven or geared chain."""
    rng = np.random.default_rng(seed)
    ratios = np.eye(joints) * rng.uniform(50.0, 120.0, joints) + np.eye(joints, k=1) * rng.uniform(-80.0, 80.0)
    return np.asarray(ratios.T @ np.diag(rng.uniform(2e-5, 2e-4, joints)) @ ratios)


def mass_along(robot: Robot, q: FloatArray, direction: float) -> float:
    dynamics = RobotDynamics(robot)
    qd = np.linalg.pinv(dynamics.at(q).contacts[0].jacobian) @ [np.cos(direction), np.sin(direction), 0.0]
    return dynamics.at(q, qd).contacts[0].full


@pytest.mark.parametrize("joints", [2, 3])
@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(seed=st.integers(0, 10**6), direction=st.floats(-3.0, 3.0), bend=st.floats(0.3, 2.5))
def test_coupled_rotors_agree_with_the_closed_form(
    joints: int, load_rows: Callable[[object], Robot], seed: int, direction: float, bend: float
) -> None:
    """The matrix is exact to 1e-12, where its diagonal alone is not the same robot."""
    rotors = coupled(joints, seed)
    rotors = (rotors + rotors.T) / 2.0
    q = np.array([0.3, bend, -0.7])[:joints]
    exact = planar_mass(q, rotors, direction)
    robot = load_rows(planar_rows(joints, rotor_inertia=rotors.tolist()))
    assert mass_along(robot, q, direction) == pytest.approx(exact, rel=1e-12)
    diagonal = planar_rows(joints)
    for row, value in zip(diagonal["joints"], np.diag(rotors).tolist(), strict=True):
        row["armature"] = value
    assert mass_along(load_rows(diagonal), q, direction) == pytest.approx(
        planar_mass(q, np.diag(np.diag(rotors)), direction), rel=1e-12
    )


def test_diagonal_alone_misses_the_coupling_of_a_three_joint_arm(load_rows: Callable[[object], Robot]) -> None:
    """60 poses: without rotors, with the diagonal, and with the exact matrix."""
    rotors = coupled(3)
    exact_robot = load_rows(planar_rows(3, rotor_inertia=((rotors + rotors.T) / 2.0).tolist()))
    diagonal = load_rows(planar_rows(3, rotor_inertia=np.diag(np.diag(rotors)).tolist()))
    bare = load_rows(planar_rows(3))
    errors = {"bare": [], "diagonal": [], "exact": []}  # type: dict[str, list[float]]
    for q in exact_robot.sample_configurations()[:60]:
        truth = planar_mass(q, rotors, 0.4)
        for name, robot in (("bare", bare), ("diagonal", diagonal), ("exact", exact_robot)):
            errors[name].append(mass_along(robot, q, 0.4) / truth - 1.0)
    assert np.max(np.abs(errors["exact"])) < 1e-12
    assert np.median(np.abs(errors["diagonal"])) > 0.01
    assert np.median(errors["bare"]) < -0.3


def test_coupled_rotors_are_in_the_lumped_model(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]
) -> None:
    """B of joints 1 and 2 alone leaves the massless joint 4 as it is, and adds to the lumped matrix exactly."""
    bare = RobotDynamics(load_rows(omron_rows))
    matrix = np.zeros((4, 4))
    matrix[:2, :2] = [[0.4, 0.15], [0.15, 0.2]]
    omron_rows["rotor_inertia"] = matrix.tolist()
    geared = RobotDynamics(load_rows(omron_rows))
    assert geared.lumped is not None
    assert bare.lumped is not None
    assert geared.lumped.massless_joints == (3,)
    q, qd = np.array([0.2, 1.1, 0.1, 0.3]), np.array([0.4, 0.3, 0.0, 0.0])
    jacobian = geared.at(q).contacts[0].jacobian
    data = bare.lumped.model.createData()
    mobility = jacobian @ np.linalg.inv(bare.robot.mass_matrix(bare.lumped.model, data, q) + matrix) @ jacobian.T
    masses = geared.at(q, qd).contacts[0]
    n = np.array(masses.direction)
    assert masses.lumped == pytest.approx(1.0 / (n @ mobility @ n), rel=1e-12)
    assert masses.lumped > bare.at(q, qd).contacts[0].lumped


def test_entries_state_the_same_matrix_as_the_file(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(yaml.safe_dump(planar_rows(2)), encoding="utf-8")
    robot = load_robot(path, MonitorSettings(armature=("j1=0.3", "j2=0.2", "j1,j2=0.1")))
    np.testing.assert_array_equal(robot.rotors.matrix, [[0.3, 0.1], [0.1, 0.2]])
    assert robot.rotors.unstated == ()
    assert "rotor inertia from the setting armature: j1 0.3, j2 0.2" in robot.notes
    assert "coupled rotors: j1,j2 0.1" in robot.notes


def test_entry_wins_over_the_file(tmp_path: Path) -> None:
    rows = planar_rows(2)
    rows["joints"][0]["armature"] = 0.3
    path = tmp_path / "robot.yaml"
    path.write_text(yaml.safe_dump(rows), encoding="utf-8")
    robot = load_robot(path, MonitorSettings(armature=("j1=0.5",)))
    assert np.diag(robot.rotors.matrix).tolist() == [0.5, 0.0]
    assert robot.rotors.unstated == ("j2",)


@pytest.mark.parametrize(
    ("matrix", "rule"),
    [
        ([[0.1, 0.2], [0.3, 0.1]], "must be a symmetric 2 x 2 matrix"),
        ([[0.1, 0.0]], "must be a symmetric 2 x 2 matrix"),
        ([], "must be a symmetric 2 x 2 matrix"),
        ([[0.1], [0.0, 0.1]], "must be a symmetric 2 x 2 matrix"),
        ([[0.1, 0.2], [0.2, 0.1]], "must be a positive semi-definite matrix: its smallest eigenvalue is -0.1"),
    ],
)
def test_wrong_matrix_raises(load_rows: Callable[[object], Robot], matrix: object, rule: str) -> None:
    with pytest.raises(RobotError, match=rf"robot\.yaml: .*{rule}"):
        load_rows(planar_rows(2, rotor_inertia=matrix))


def test_matrix_beside_an_armature_raises(load_rows: Callable[[object], Robot]) -> None:
    rows = planar_rows(2, rotor_inertia=[[0.1, 0.0], [0.0, 0.1]])
    rows["joints"][1]["armature"] = 0.1
    with pytest.raises(RobotError, match="rotor_inertia: must be absent where a joint states its armature"):
        load_rows(rows)


@pytest.mark.parametrize("entry", ["j1,j2,j1=1", "j1,j1=1", "j1,j9=1", "j1,=1", "j1,j2=nan", "acme/robot"])
def test_wrong_entry_raises(tmp_path: Path, entry: str) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(yaml.safe_dump(planar_rows(2)), encoding="utf-8")
    with pytest.raises(RobotError, match=r"armature = .*: .*must be"):
        load_robot(path, MonitorSettings(armature=(entry,)))


class TestUnstated:
    def test_shipped_robot_states_none(self, omron: Robot) -> None:
        assert omron.rotors.unstated == omron.joint_names
        assert omron.rotors.warning in omron.notes
        assert omron.rotors.warning == (
            "no rotor inertia for joint1, joint2, joint3, joint4: the masses are a lower bound if the drives are "
            "back-driven"
        )

    def test_zero_in_the_file_is_a_statement(self, load_rows: Callable[[object], Robot]) -> None:
        rows = planar_rows(2)
        rows["joints"][0]["armature"] = 0.0
        assert load_rows(rows).rotors.unstated == ("j2",)
        rows["joints"][1]["armature"] = 0.0
        robot = load_rows(rows)
        assert robot.rotors.warning == ""
        assert robot.notes == ("rotor inertia from the DH file: j1 0, j2 0",)


def arm(transmissions: str, dynamics: str = "") -> str:
    links = "".join(
        f'<link name="l{i}"><inertial><origin xyz="0.1 0 0"/><mass value="1"/>'
        '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        for i in (1, 2)
    )
    joints = "".join(
        f'<joint name="j{i}" type="revolute"><parent link="l{i - 1}"/><child link="l{i}"/><origin xyz="0.2 0 0"/>'
        f'<axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="1" velocity="3"/>{dynamics}</joint>'
        for i in (1, 2)
    )
    return (
        f'<robot name="arm" xmlns:drake="http://drake.mit.edu"><link name="l0"/>{links}{joints}{transmissions}</robot>'
    )


def transmission(joint: str, actuator: str, outside: str = "") -> str:
    return (
        f'<transmission name="t_{joint}"><type>transmission_interface/SimpleTransmission</type>'
        f'<joint name="{joint}"/><actuator name="m_{joint}">{actuator}</actuator>{outside}</transmission>'
    )


def urdf_robot(text: str, **options: object) -> Robot:
    settings = MonitorSettings.model_validate(options)
    return build_robot(parse_urdf(text, "arm.urdf", settings), settings)


class TestTransmission:
    @pytest.mark.parametrize(
        ("inside", "outside", "expected"),
        [
            ("<motorInertia>1e-4</motorInertia><mechanicalReduction>-50</mechanicalReduction>", "", 0.25),
            ("<motorInertia>1e-4</motorInertia>", "<mechanicalReduction>50</mechanicalReduction>", 0.25),
            ("<motorInertia>0.2</motorInertia>", "", 0.2),
            ("<motorInertia>0</motorInertia>", "", 0.0),
            ('<drake:rotor_inertia value="1e-4"/><drake:gear_ratio value="100"/>', "", 1.0),
            # As Drake's own file of the Panda: its reduction of 1 is not the gear.
            (
                (
                    '<drake:gear_ratio value="100"/><drake:rotor_inertia value="1e-4"/>'
                    "<mechanicalReduction>1</mechanicalReduction>"
                ),
                "",
                1.0,
            ),
        ],
    )
    def test_armature_is_the_rotor_inertia_times_the_squared_reduction(
        self, inside: str, outside: str, expected: float
    ) -> None:
        robot = urdf_robot(arm(transmission("j1", inside, outside)))
        assert robot.model.armature.tolist() == pytest.approx([expected, 0.0], rel=1e-12)
        assert f"rotor inertia from the URDF: j1 {expected:.4g}" in robot.notes
        assert robot.rotors.unstated == ("j2",)

    def test_option_wins(self) -> None:
        text = arm(transmission("j1", "<motorInertia>0.2</motorInertia>"))
        robot = urdf_robot(text, armature=("j1=0.7",))
        assert robot.model.armature.tolist() == [0.7, 0.0]
        assert "rotor inertia from the setting armature: j1 0.7" in robot.notes

    def test_dynamics_state_the_reflected_inertia(self) -> None:
        robot = urdf_robot(arm("", '<dynamics armature="0.3"/>'))
        assert robot.model.armature.tolist() == [0.3, 0.3]

    def test_transmission_without_rotor_inertia_is_named(self, load_urdf_file: Callable[..., Robot]) -> None:
        robot = load_urdf_file("tm12-nominal.urdf")
        assert "<transmission> of joint_1, joint_2, joint_3, joint_4, joint_5, joint_6 states no rotor inertia" in (
            robot.notes
        )
        assert robot.rotors.warning in robot.notes

    def test_differential_is_named(self) -> None:
        text = arm('<transmission name="t"><joint name="j1"/><joint name="j2"/><actuator name="a"/></transmission>')
        notes = urdf_robot(text).notes
        assert "<transmission> of j1, j2 couples several joints or motors" in notes

    @pytest.mark.parametrize("number", ["heavy", "nan", "inf", "", "-1"])
    def test_wrong_number_raises(self, number: str) -> None:
        text = arm(transmission("j1", f"<motorInertia>{number}</motorInertia>"))
        with pytest.raises(RobotError, match=r"arm\.urdf: "):
            urdf_robot(text)

    def test_reduction_whose_square_overflows_raises(self) -> None:
        text = arm(
            transmission("j1", "<motorInertia>1e-4</motorInertia><mechanicalReduction>1e200</mechanicalReduction>")
        )
        with pytest.raises(RobotError, match=r"arm\.urdf: rotor inertia: must be at most 1e\+06"):
            urdf_robot(text)


class TestPublishedArms:
    def test_entry_fills_every_joint_and_names_its_source(self, load_urdf_file: Callable[..., Robot]) -> None:
        robot = load_urdf_file("panda.urdf", armature=["franka/fr3", "panda_joint7=0.1"])
        assert robot.model.armature.tolist() == [
            *[0.605721456, 0.605721456, 0.462474144, 0.462474144, 0.205544064, 0.205544064],
            0.1,
        ]
        assert robot.rotors.unstated == ()
        assert any("RobotLocomotion/drake" in note for note in robot.notes)

    def test_other_number_of_joints_raises(self, load_urdf_file: Callable[..., Robot]) -> None:
        with pytest.raises(
            RobotError, match=r"ur5_robot\.urdf: armature = 'menagerie/panda': must be for 6 joints, not 7"
        ):
            load_urdf_file("ur5_robot.urdf", armature=["menagerie/panda"])

    def test_every_entry_has_a_source_and_positive_values(self) -> None:
        table = yaml.safe_load(share("config", "armatures.yaml").read_text(encoding="utf-8"))
        assert 5 <= len(table) <= 10
        for arm_entry in table.values():
            assert set(arm_entry) == {"source", "note", "armature"}
            assert all(value > 0.0 for value in arm_entry["armature"])
            assert arm_entry["source"].count("/") >= 2

    def test_puma_values_are_those_of_the_stated_motors_and_gears(self) -> None:
        table = yaml.safe_load(share("config", "armatures.yaml").read_text(encoding="utf-8"))
        rotors = np.array([200e-6] * 3 + [33e-6] * 3)
        gears = np.array([-62.6111, 107.815, -53.7063, 76.0364, 71.923, 76.686])
        np.testing.assert_allclose(table["corke/puma560"]["armature"], rotors * gears**2, rtol=1e-8)

    def test_ur10_is_several_times_heavier_with_it(self, load_urdf_file: Callable[..., Robot]) -> None:
        medians = []
        for entries in ([], ["menagerie/ur10e"]):
            dynamics = RobotDynamics(load_urdf_file("ur10_robot.urdf", armature=entries))
            rng = np.random.default_rng(7)
            masses = [
                dynamics.at(q, rng.normal(size=6)).contacts[0].full for q in dynamics.robot.sample_configurations()
            ]
            medians.append(float(np.median(masses)))
        assert medians[1] > 2.5 * medians[0]

# SPDX-License-Identifier: Apache-2.0
"""Polytopes around the links: they contain the geometry of the URDF, closely, at the joint that moves it."""

import math
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from scara_effmass.errors import RobotError
from scara_effmass.model.hulls import (
    MIN_THICKNESS_M,
    LinkHull,
    outer_vertices,
    package_folders,
    stated_hull,
    urdf_hulls,
)
from scara_effmass.model.urdf import parse_urdf, read_urdf
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import MAX_VERTICES, FloatArray

CUBE = np.array([(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
TURN = pin.rpy.rpyToMatrix(0.4, -0.9, 2.0)
ANGLES = np.linspace(0.0, 2.0 * math.pi, 60)
RING = np.column_stack([np.cos(ANGLES), np.sin(ANGLES), np.zeros_like(ANGLES)])
UP = np.array([0.0, 0.0, 1.0])
LATITUDES = np.linspace(-math.pi / 2.0, math.pi / 2.0, 61)
BALL = np.concatenate([math.cos(latitude) * RING + math.sin(latitude) * UP for latitude in LATITUDES])
CYLINDER = np.concatenate([RING - 2.0 * UP, RING + 2.0 * UP])
L_SHAPE = np.concatenate([CUBE * (1.0, 1.0, 5.0) + (1.0, 1.0, 5.0), CUBE * (3.0, 1.0, 1.0) + (3.0, 1.0, 1.0)])
ENTRY = st.floats(-1.0, 1.0)
POINTS = st.lists(st.tuples(ENTRY, ENTRY, ENTRY), min_size=1, max_size=40).map(np.array)
TETRAHEDRON = np.array([(0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.0, 0.2, 0.0), (0.0, 0.0, 0.3)])
FACES = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))


def excess(vertices: FloatArray, points: FloatArray) -> float:
    """Return how far a point is outside of the convex hull of `vertices` [m]."""
    planes = ConvexHull(vertices).equations
    return float((points @ planes[:, :3].T + planes[:, 3]).max())


def assert_contains(vertices: FloatArray, points: FloatArray) -> None:
    assert len(vertices) <= MAX_VERTICES
    assert excess(vertices, points) <= 1e-9


class TestOuterVertices:
    @settings(deadline=None)
    @given(points=POINTS, scale=st.sampled_from([(1.0, 1.0, 1.0), (1.0, 1.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 1e-3)]))
    def test_contains_any_points(self, points: FloatArray, scale: tuple[float, float, float]) -> None:
        turned = (points * scale) @ TURN.T + 0.3
        assert_contains(outer_vertices(turned), turned)

    @pytest.mark.parametrize(
        ("points", "looseness"),
        [
            (CUBE * (0.1, 0.2, 0.3), 1.001),
            (0.1 * L_SHAPE, 1.01),
            (0.1 * CYLINDER, 1.06),
            (0.1 * BALL, 1.5),
            (0.1 * CYLINDER * (1.0, 1.0, 1e-3), 1.06),
        ],
        ids=["box", "L", "cylinder", "ball", "disc"],
    )
    def test_is_tight(self, points: FloatArray, looseness: float) -> None:
        hull = stated_hull("cover", 2, points @ TURN.T + 0.5)
        assert (hull.link, hull.joint, hull.source) == ("cover", 2, "stated")
        assert_contains(hull.vertices, points @ TURN.T + 0.5)
        assert 1.0 <= hull.looseness < looseness

    def test_cube_keeps_its_corners(self) -> None:
        assert len(outer_vertices(0.1 * CUBE)) == len(outer_vertices(0.1 * CUBE @ TURN.T)) == 8

    def test_few_points_are_thickened_by_little(self) -> None:
        for points in (np.zeros((1, 3)), CUBE[:2], CUBE[:3], CUBE[:4]):
            vertices = outer_vertices(0.1 * points)
            assert_contains(vertices, 0.1 * points)
            thick = (0.1 * points[:, None] + 2.0 * MIN_THICKNESS_M * CUBE).reshape(-1, 3)
            assert ConvexHull(vertices).volume < ConvexHull(thick).volume

    def test_is_deterministic(self) -> None:
        points = np.random.default_rng(1).normal(size=(500, 3))
        assert np.array_equal(outer_vertices(points), outer_vertices(points.copy()))


def link(name: str, *shapes: str, kind: str = "collision") -> str:
    """Return a link; a shape is an <origin>, or none, and the content of <geometry>."""
    parts = []
    for shape in shapes:
        origin, content = re.fullmatch(r"(<origin[^>]*>)?(.*)", shape, re.DOTALL).groups("")  # type: ignore[union-attr]
        parts.append(f"<{kind}>{origin}<geometry>{content}</geometry></{kind}>")
    return f'<link name="{name}">{"".join(parts)}</link>'


def joint(name: str, parent: str, child: str, kind: str = "revolute", origin: str = 'xyz="0 0 0"') -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><origin {origin}/>'
        '<axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="1" velocity="3"/></joint>'
    )


def arm(*links: str) -> str:
    """Return a robot of base, link and what else `links` contain."""
    return f'<robot name="arm"><link name="base"/>{joint("j1", "base", "upper")}{"".join(links)}</robot>'


def hulls(text: str, package_dirs: Sequence[Path] = (), locked: Sequence[str] = ()) -> list[LinkHull]:
    model = parse_urdf(text, "arm.urdf", MonitorSettings(locked_joints=tuple(locked))).model
    tree = read_urdf(text, "arm.urdf", locked)
    frames = {name: model.frames[model.getBodyId(name)] for name in tree.links}
    return urdf_hulls(tree.links, tree.origin, frames, package_dirs)


def upper_hull(*shapes: str, package_dirs: Sequence[Path] = ()) -> LinkHull:
    (hull,) = hulls(arm(link("upper", *shapes)), package_dirs)
    return hull


def write_stl(path: Path, points: FloatArray = TETRAHEDRON) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    facets = [
        f"facet normal 0 0 0\nouter loop\n{''.join('vertex {} {} {}'.format(*points[i]) + chr(10) for i in face)}"
        "endloop\nendfacet\n"
        for face in FACES
    ]
    path.write_text(f"solid x\n{''.join(facets)}endsolid x\n")


def write_obj(path: Path) -> None:
    lines = ["v {} {} {}".format(*point) for point in TETRAHEDRON]
    lines += ["f {} {} {}".format(*(i + 1 for i in face)) for face in FACES]
    path.write_text("\n".join(lines) + "\n")


def write_collada(path: Path, unit: str, encoding: str = "utf-8") -> None:
    numbers = " ".join(f"{x:g}" for x in 1000.0 * TETRAHEDRON.ravel())
    parameters = "".join(f'<param name="{axis}" type="float"/>' for axis in "XYZ")
    faces = " ".join(str(i) for face in FACES for i in face)
    path.write_text(
        f'<?xml version="1.0" encoding="{encoding}"?>'
        '<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">'
        f"<asset>{unit}<up_axis>Z_UP</up_axis></asset><library_geometries>"
        f'<geometry id="g"><mesh><source id="p"><float_array id="a" count="12">{numbers}</float_array>'
        f'<technique_common><accessor source="#a" count="4" stride="3">{parameters}</accessor></technique_common>'
        '</source><vertices id="v"><input semantic="POSITION" source="#p"/></vertices><triangles count="4">'
        f'<input semantic="VERTEX" source="#v" offset="0"/><p>{faces}</p></triangles></mesh></geometry>'
        '</library_geometries><library_visual_scenes><visual_scene id="s"><node id="n"><instance_geometry url="#g"/>'
        '</node></visual_scene></library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>',
        encoding,
    )


class TestShapes:
    def test_box_is_itself(self) -> None:
        hull = upper_hull('<origin xyz="0.5 0 0" rpy="0 0 1.5707963267948966"/><box size="0.2 0.4 0.6"/>')
        assert_contains(hull.vertices, CUBE * (0.2, 0.1, 0.3) + (0.5, 0.0, 0.0))
        assert_contains(CUBE * (0.2, 0.1, 0.3) * (1.0 + 1e-5) + (0.5, 0.0, 0.0), hull.vertices)
        assert len(hull.vertices) == 8
        assert hull.looseness == pytest.approx(1.0, abs=1e-5)

    @pytest.mark.parametrize(
        ("shape", "points"),
        [
            ('<cylinder radius="0.1" length="0.4"/>', 0.1 * CYLINDER),
            ('<cylinder radius="0.1" length="0"/>', 0.1 * RING),
            ('<sphere radius="0.1"/>', 0.1 * BALL),
        ],
        ids=["cylinder", "disc", "sphere"],
    )
    def test_round_shapes_are_inside(self, shape: str, points: FloatArray) -> None:
        hull = upper_hull(f'<origin xyz="0 0 0.7"/>{shape}')
        assert_contains(hull.vertices, points + 0.7 * UP)
        assert np.abs(hull.vertices - 0.7 * UP).max() < 1.3 * max(np.abs(points).max(), 0.1)

    def test_capsule_is_inside(self, capfd: pytest.CaptureFixture[str]) -> None:
        hull = upper_hull('<capsule radius="0.1" length="0.4"/>')
        assert capfd.readouterr().err == ""  # of Pinocchio's parser, which drops a capsule
        assert_contains(hull.vertices, np.concatenate([0.1 * BALL - 0.2 * UP, 0.1 * BALL + 0.2 * UP]))

    def test_all_shapes_of_a_link_share_one_polytope(self) -> None:
        hull = upper_hull('<sphere radius="0.1"/>', '<origin xyz="0 0 1"/><box size="0.2 0.2 0.2"/>')
        assert_contains(hull.vertices, np.concatenate([0.1 * BALL, 0.1 * CUBE + UP]))
        assert hull.looseness < 1.3


class TestLinks:
    BOX = '<box size="0.1 0.2 0.3"/>'

    def test_fixed_link_has_its_own_polytope_at_the_moving_joint(self) -> None:
        text = arm(
            link("upper", self.BOX),
            link("fore", self.BOX),
            link("flange", f'<origin xyz="0 0.1 0"/>{self.BOX}'),
            joint("j2", "upper", "fore", "continuous", 'xyz="0.5 0 0"'),
            joint("weld", "fore", "flange", "fixed", 'xyz="0 0 0.4" rpy="1.5707963267948966 0 0"'),
        )
        upper, fore, flange = hulls(text)
        assert [(hull.link, hull.joint) for hull in (upper, fore, flange)] == [("upper", 1), ("fore", 2), ("flange", 2)]
        assert flange.vertices.mean(axis=0) == pytest.approx([0.0, 0.0, 0.5], abs=1e-6)
        assert np.ptp(flange.vertices, axis=0) == pytest.approx([0.1, 0.3, 0.2], abs=1e-6)
        # A held joint carries its link with the joint before it.
        assert [(hull.link, hull.joint) for hull in hulls(text, locked=["j2"])] == [
            ("upper", 1),
            ("fore", 1),
            ("flange", 1),
        ]

    def test_joints_and_placements_are_those_of_pinocchio(self) -> None:
        text = arm(
            link("upper", f'<origin xyz="0.1 0.2 0.3" rpy="0.3 0.2 0.1"/>{self.BOX}', self.BOX),
            link("fore", f'<origin xyz="0 0.2 0.3" rpy="1 2 3"/>{self.BOX}'),
            link("flange", f'<origin xyz="0 0.1 0" rpy="0.3 0 0.1"/>{self.BOX}'),
            joint("j2", "upper", "fore", origin='xyz="0.5 0 0" rpy="0.1 0.7 0"'),
            joint("weld", "fore", "flange", "fixed", 'xyz="0 0 0.4" rpy="1 0 0.6"'),
        )
        model = pin.buildModelFromXML(text)
        geometry = pin.buildGeomFromUrdfString(model, text, pin.GeometryType.COLLISION)
        _, (reduced,) = pin.buildReducedModel(model, [geometry], [model.getJointId("j2")], pin.neutral(model))
        by_link = {hull.link: hull for hull in hulls(text, locked=["j2"])}
        for shape in reduced.geometryObjects:
            hull = by_link[shape.name.rpartition("_")[0]]
            assert hull.joint == shape.parentJoint
            placed = CUBE * (0.05, 0.1, 0.15) @ shape.placement.rotation.T + shape.placement.translation
            assert_contains(hull.vertices, placed)

    def test_base_and_links_without_geometry_have_none(self) -> None:
        text = arm(link("upper"), link("fore", self.BOX), link("stand", self.BOX), joint("j2", "upper", "fore"))
        text = text.replace("</robot>", joint("weld", "base", "stand", "fixed") + "</robot>")
        assert [hull.link for hull in hulls(text)] == ["fore"]

    def test_visual_counts_only_without_collision(self) -> None:
        small, large = link("upper", self.BOX), link("upper", '<box size="9 9 9"/>', kind="visual")
        both = small.replace("</link>", large.partition(">")[2])
        (hull,) = hulls(arm(both))
        assert (hull.source, np.ptp(hull.vertices, axis=0).max()) == ("collision", pytest.approx(0.3))
        (hull,) = hulls(arm(large))
        assert (hull.source, np.ptp(hull.vertices, axis=0).max()) == ("visual", pytest.approx(9.0))

    @pytest.mark.parametrize(
        ("shape", "message"),
        [
            ('<box size="1 2"/>', "<box size> = '1 2': must be 3 finite numbers"),
            ('<sphere radius="x"/>', "<sphere radius> = 'x': must be 1 finite number"),
            ('<box size="0 0 0"/>', "<box size='0 0 0'>: must have sizes > 0 m, but for one thickness"),
            ('<box size="1 -1 1"/>', "<box size='1 -1 1'>: must have sizes > 0 m, but for one thickness"),
            ('<sphere radius="-1"/>', "<sphere radius='-1'>: must have sizes > 0 m, but for one thickness"),
            ("<cylinder radius='1'/>", "<cylinder length> = '': must be 1 finite number"),
            ('<origin xyz="nan 0 0"/><box size="1 1 1"/>', "<origin xyz> = 'nan 0 0': must be 3 finite numbers"),
            ("<plane/>", "<geometry>: must be one of box, cylinder, sphere, capsule, mesh"),
            ("", "<geometry>: must be one of box, cylinder, sphere, capsule, mesh"),
        ],
    )
    def test_wrong_shape_is_named(self, shape: str, message: str) -> None:
        with pytest.raises(RobotError) as caught:
            upper_hull(shape)
        assert str(caught.value) == f"arm.urdf: link upper: collision: {message}"


class TestMeshes:
    def test_stl_and_obj_with_scale(self, tmp_path: Path) -> None:
        write_stl(tmp_path / "a.stl", 1000.0 * TETRAHEDRON)
        write_obj(tmp_path / "b.obj")
        for shape in ('<mesh filename="a.stl" scale="0.001 0.001 -0.001"/>', '<mesh filename="b.obj" scale="1 1 -1"/>'):
            hull = upper_hull(f'<origin xyz="0.5 0 0"/>{shape}', package_dirs=[tmp_path])
            points = TETRAHEDRON * (1.0, 1.0, -1.0) + (0.5, 0.0, 0.0)
            assert excess(hull.vertices, points) < 1e-7  # the loader has single precision
            assert hull.looseness < 1.001

    @pytest.mark.parametrize(
        ("unit", "size"),
        [
            ('<unit name="mm" meter="0.001"/>', 0.3),
            ("", 300.0),
            ('<unit name="metre"/>', 300.0),
            ('<!-- <unit meter="0.001"/> --><unit meter="0.01"/>', 3.0),
            ('<contributor><comments><![CDATA[<unit meter="0.001"/>]]></comments></contributor>', 300.0),
        ],
    )
    @pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
    def test_unit_of_collada(self, tmp_path: Path, unit: str, size: float, encoding: str) -> None:
        write_collada(tmp_path / "a.dae", unit, encoding)
        hull = upper_hull('<mesh filename="a.dae"/>', package_dirs=[tmp_path])
        assert np.ptp(hull.vertices, axis=0).max() == pytest.approx(size)

    @pytest.mark.parametrize("meter", ["-0.001", "0", "nan", "inf", "1 mm", ""])
    def test_wrong_unit_of_collada(self, tmp_path: Path, meter: str) -> None:
        write_collada(tmp_path / "a.dae", f'<unit meter="{meter}"/>')
        with pytest.raises(RobotError, match=r"link upper: collision: mesh = 'a\.dae': must be a mesh"):
            upper_hull('<mesh filename="a.dae"/>', package_dirs=[tmp_path])

    def test_folders_of_packages(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        stated, prefix, urdf = tmp_path / "stated", tmp_path / "prefix", tmp_path / "own_package" / "urdf" / "arm.urdf"
        monkeypatch.setenv("AMENT_PREFIX_PATH", f"/opt/none:{prefix}")
        write_stl(stated / "x_description" / "a.stl")
        write_stl(prefix / "share" / "y_description" / "a.stl")
        write_stl(urdf.parent / "near.stl")
        write_stl(urdf.parent / "by hand" / "50%25.stl")
        write_stl(tmp_path / "own_package" / "meshes" / "a.stl")
        folders = package_folders(urdf, [stated])
        for name in (
            "package://x_description/a.stl",
            "package://y_description/a.stl",
            "package://own_package/meshes/a.stl",
            "near.stl",
            "../meshes/a.stl",
            f"file://{urdf.parent}/near.stl",
            f"{urdf.parent}/near.stl",
            "by hand/50%25.stl",
            "package://own_package/urdf/by%20hand/50%2525.stl",
            f"file://{urdf.parent}/by%20hand/50%2525.stl",
        ):
            assert_contains(
                upper_hull(f'<mesh filename="{name}"/>', package_dirs=folders).vertices, TETRAHEDRON * 0.999
            )
        assert package_folders(None, []) == [Path("/opt/none/share"), prefix / "share"]
        monkeypatch.delenv("AMENT_PREFIX_PATH")
        assert package_folders(None, [stated]) == [stated]

    @pytest.mark.parametrize(
        ("stated", "place", "named"),
        [
            ("x", "x", ""),
            ("checkout", "checkout", "x"),
            ("src", "src/repository/robots/x", "x"),
            ("src", "src/repository/arm", "x"),
            ("x", "x", "another"),
            ("src", "src/repository/robots/too/deep", "x"),
        ],
    )
    def test_stated_folder_is_a_package_or_above_one(self, tmp_path: Path, stated: str, place: str, named: str) -> None:
        write_stl(tmp_path / place / "meshes" / "a.stl")
        if named:
            (tmp_path / place / "package.xml").write_text(f"<package>\n<name> {named} </name></package>")
        folders, mesh = package_folders(None, [tmp_path / stated]), '<mesh filename="package://x/meshes/a.stl"/>'
        if named == "another" or "deep" in place:
            with pytest.raises(RobotError, match="name the folder of its package, or one above, by package_dirs"):
                upper_hull(mesh, package_dirs=folders)
        else:
            assert_contains(upper_hull(mesh, package_dirs=folders).vertices, TETRAHEDRON * 0.999)

    @pytest.mark.parametrize("name", ["package://x/a.stl", "a.stl", "file:///none/a.stl", "", "x" * 300])
    def test_missing_mesh(self, tmp_path: Path, name: str) -> None:
        with pytest.raises(RobotError) as caught:
            upper_hull(f'<mesh filename="{name}"/>', package_dirs=[tmp_path])
        assert str(caught.value).startswith(f"arm.urdf: link upper: collision: mesh = {name!r}: must be a file")
        assert "by package_dirs (--package-dir)" in str(caught.value)

    @pytest.mark.parametrize(
        ("file", "content"),
        [
            ("a.stl", "version https://git-lfs.github.com/spec/v1\n"),
            ("a.obj", "v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
            ("a.dae", '<COLLADA><asset><unit meter="x"/></asset></COLLADA>'),
            ("a.dae", "<COLLADA><asset>"),
            ("a.xyz", ""),
        ],
    )
    def test_file_that_is_no_mesh(self, tmp_path: Path, file: str, content: str) -> None:
        (tmp_path / file).write_text(content)
        with pytest.raises(RobotError, match=f"link upper: collision: mesh = '{file}': must be a mesh"):
            upper_hull(f'<mesh filename="{file}"/>', package_dirs=[tmp_path])

    def test_mesh_of_the_base_is_not_read(self, tmp_path: Path) -> None:
        text = arm(link("upper", '<box size="1 1 1"/>')).replace(
            '<link name="base"/>', link("base", '<mesh filename="none.stl"/>')
        )
        assert [hull.link for hull in hulls(text, [tmp_path])] == ["upper"]

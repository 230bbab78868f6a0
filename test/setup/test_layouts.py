# SPDX-License-Identifier: Apache-2.0
"""The layouts of RViz, Foxglove and PlotJuggler name topics and fields that exist."""

import json
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest
import yaml
from rosbags.interfaces import Nodetype

from scara_effmass.bags.definitions import known_types
from scara_effmass.bags.files import open_bag
from scara_effmass.model.load import load_robot
from scara_effmass.wire.topics import RECORDED

CONFIG = Path(__file__).parents[2] / "config"
TOUR = Path(__file__).parents[2] / "bags" / "tour"
OWN = "scara_effmass_msgs/msg/"
TYPES = {
    "/joint_states": "sensor_msgs/msg/JointState",
    "/contact_states": f"{OWN}ContactStates",
    "/allowable_speed": "std_msgs/msg/Float64",
    "/speed_scaling": "std_msgs/msg/Float64",
    "/wrench": "geometry_msgs/msg/WrenchStamped",
    "/impact_validation": f"{OWN}ImpactValidation",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    "/effective_mass_markers": "visualization_msgs/msg/MarkerArray",
}
NUMBERS = {"float64", "uint8"}
_PART = re.compile(r'(?P<name>\w+)(\[(?P<index>\d|:)\])?(\{(?P<filter>\w+)=="(?P<value>\w+)"\})?')


def field_type(message_type: str, path: str) -> str:
    """Return the base type of the field at a dotted `path`, which has an index where the message has an array."""
    part, _, rest = path.partition(".")
    match = _PART.fullmatch(part)
    assert match, path
    node: Nodetype
    content: Any
    node, content = dict(known_types().fielddefs[message_type][1])[match["name"]]
    assert (node in {Nodetype.ARRAY, Nodetype.SEQUENCE}) == bool(match["index"])
    if match["index"]:
        node, content = content[0]
    if match["filter"]:
        assert field_type(str(content), match["filter"]) == "string"
        assert match["value"] in load_robot().contact_frames
    if node == Nodetype.NAME:
        return field_type(str(content), rest)
    assert not rest
    return str(content[0])


@cache
def foxglove() -> dict[str, Any]:
    layout: dict[str, Any] = json.loads((CONFIG / "foxglove_layout.json").read_text(encoding="utf-8"))
    return layout


def panels(node: Any) -> Iterator[str]:  # noqa: ANN401 - a tree of strings
    """Yield the panels in the mosaic of a Foxglove layout."""
    if isinstance(node, str):
        yield node
        return
    assert node["direction"] in {"row", "column"}
    for side in ("first", "second"):
        yield from panels(node[side])


def foxglove_paths() -> list[str]:
    return [path["value"] for panel in foxglove()["configById"].values() for path in panel.get("paths", [])]


def curves() -> list[str]:
    root = ET.parse(CONFIG / "plotjuggler_layout.xml").getroot()
    return [curve.attrib["name"] for curve in root.iter("curve")]


def test_topics_of_the_layouts_are_recorded() -> None:
    assert {topic.lstrip("/") for topic in TYPES} <= {topic.lstrip("/") for topic in RECORDED}


def test_every_panel_of_the_foxglove_layout_is_placed_once() -> None:
    assert sorted(panels(foxglove()["layout"])) == sorted(foxglove()["configById"])
    kinds = {panel.partition("!")[0] for panel in foxglove()["configById"]}
    assert kinds == {"3D", "Plot", "StateTransitions", "DiagnosticSummary"}
    cell = foxglove()["configById"]["3D!cell"]
    assert [TYPES[topic] for topic in cell["topics"]] == [TYPES["/effective_mass_markers"]]
    assert cell["followTf"] == cell["layers"]["grid"]["frameId"] == load_robot().base_frame
    assert foxglove()["configById"]["DiagnosticSummary!nodes"]["topicToRender"] in TYPES


@pytest.mark.parametrize("path", foxglove_paths())
def test_message_path_of_foxglove_exists(path: str) -> None:
    topic, _, field = path.partition(".")
    assert field_type(TYPES[topic], field) in NUMBERS


@pytest.mark.parametrize("curve", curves())
def test_curve_of_plotjuggler_exists(curve: str) -> None:
    topic, path = re.fullmatch(r"(/\w+)/(.+)", curve).groups()  # type: ignore[union-attr]
    if topic == "/joint_states":  # PlotJuggler names these after their joints
        joint, field = path.split("/")
        assert joint in load_robot().joint_names
        assert field_type(TYPES[topic], f"{field}[0]") == "float64"
    else:
        assert field_type(TYPES[topic], path.replace("/", ".")) in NUMBERS
        assert all(int(i) < len(load_robot().contact_frames) for i in re.findall(r"contacts\[(\d)\]", path))


def test_joints_of_the_layouts_are_in_the_shipped_tour() -> None:
    with open_bag(TOUR) as bag:
        assert "/joint_states" in bag.joint_state_topics
        block = next(iter(bag.joint_state_blocks("/joint_states")))
    named = {curve.split("/")[2] for curve in curves() if curve.startswith("/joint_states/")}
    assert named == set(block.names)
    indices = {int(path[-2]) for path in foxglove_paths() if path.startswith("/joint_states.position[")}
    assert indices == set(range(block.position.shape[1]))


def test_rviz_shows_the_markers_in_the_base_frame() -> None:
    manager = yaml.safe_load((CONFIG / "scara_effmass.rviz").read_text(encoding="utf-8"))["Visualization Manager"]
    assert manager["Global Options"]["Fixed Frame"] == load_robot().base_frame
    (display,) = (shown for shown in manager["Displays"] if "Topic" in shown)
    assert display["Class"] == "rviz_default_plugins/MarkerArray"
    assert TYPES[display["Topic"]["Value"]] == "visualization_msgs/msg/MarkerArray"
    source = (CONFIG.parent / "scara_effmass" / "nodes" / "visualization_node.py").read_text(encoding="utf-8")
    drawn = set(re.findall(r'(?:_arrow\(|_marker\(Marker\.\w+, )"(\w+)"', source))
    assert set(display["Namespaces"]) == drawn

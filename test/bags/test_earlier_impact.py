# SPDX-License-Identifier: Apache-2.0
"""Impacts in recordings made before `held_force` and `load_force` were added are read; other definitions are not."""

import re
from pathlib import Path

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from scara_effmass.analysis.forces import NO_BLOCKS, recorded_contacts
from scara_effmass.bags.definitions import own_types
from scara_effmass.bags.files import open_bag
from scara_effmass.bags.writer import BagWriter
from scara_effmass.errors import BagError
from scara_effmass.settings import DetectionSettings, ImportSettings
from scara_effmass.values import Impact
from scara_effmass.wire.force import ADDED_FIELDS, impact_message
from scara_effmass.wire.message_types import IMPACT, message_definition

EARLIER = Impact(10**9, "force_sensor", 158.0, 0.02, 1.9, 4.0, *(False, False, 0, 0.0, 0.1, 0.0, "cell", True), 0.9)
ADDED = ("held_force", "load_force")


def recorded(path: Path, without: tuple[str, ...], impact: Impact) -> Path:
    """Write a bag whose definition of Impact lacks the last fields `without`."""
    definition = message_definition(IMPACT)
    for name in without:
        definition = re.sub(rf"^float64 {name}$", "", definition, flags=re.MULTILINE)
    types = get_typestore(Stores.ROS2_JAZZY)
    types.register({name: fields for name, fields in own_types().items() if name != IMPACT})
    types.register(get_types_from_msg(definition, IMPACT))
    with BagWriter(path, types=types) as writer:
        data = impact_message(impact)
        writer.write("/impact", IMPACT, 10**9, data[: len(data) - 8 * len(without)])
    return path


def test_the_added_fields_are_known() -> None:
    assert {IMPACT: len(ADDED)} == ADDED_FIELDS


def test_an_impact_of_an_earlier_version_is_read(tmp_path: Path) -> None:
    path = recorded(tmp_path / "earlier.mcap", ADDED, EARLIER)
    with open_bag(path) as bag:
        assert [impact for _, impact in bag.timed_impacts("/impact")] == [EARLIER]
        assert bag.losses == ()
    found = recorded_contacts(path, ImportSettings(), DetectionSettings())
    assert (found.contacts, found.losses, found.doubts) == ((EARLIER,), (), (NO_BLOCKS,))


def test_an_impact_of_this_version_is_read(tmp_path: Path) -> None:
    impact = EARLIER._replace(held_force=50.0, load_force=10.0)
    with open_bag(recorded(tmp_path / "present.mcap", (), impact)) as bag:
        assert [impact for _, impact in bag.timed_impacts("/impact")] == [impact]


def test_another_definition_is_refused(tmp_path: Path) -> None:
    path = recorded(tmp_path / "other.mcap", ("compression_impulse", *ADDED), EARLIER)
    with open_bag(path) as bag, pytest.raises(BagError, match="definition of scara_effmass_msgs/msg/Impact: must be"):
        list(bag.timed_impacts("/impact"))

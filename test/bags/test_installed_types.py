# SPDX-License-Identifier: Apache-2.0
"""The definition of a live topic is the published one; no other is recorded."""

import pytest
from rosbags.typesys import get_types_from_msg
from rosbags.typesys.store import Typestore

from scara_effmass.bags.definitions import UNSET_HASH, known_types, published_types
from scara_effmass.errors import BagError

STRING = "std_msgs/msg/String"
TEXTS = {
    "lab_msgs/msg/Box": "Lid lid\nSide[4] sides\nbuiltin_interfaces/Time[] opened\nint32 SIZE=3\n",
    "lab_msgs/msg/Lid": "bool open\n",
    "lab_msgs/msg/Side": "float64 length\nLid[] lids\n",
    "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec\n",
    STRING: "string other\n",
    "lab_msgs/msg/Odd": "( is no definition\n",
}


def text_of(name: str) -> str:
    return TEXTS.get(name, "")


def hash_of(*names: str) -> str:
    store = Typestore()
    for name in names:
        store.register(get_types_from_msg(TEXTS[name], name))
    return store.hash_rihs01(names[0])


@pytest.mark.parametrize("type_hash", ["", UNSET_HASH, "INVALID", known_types().hash_rihs01(STRING)])
def test_known_type_needs_no_installed_file(type_hash: str) -> None:
    assert published_types(STRING, type_hash, lambda _: "") is known_types()


def test_unknown_type_includes_the_types_it_refers_to() -> None:
    names = ("lab_msgs/msg/Box", "lab_msgs/msg/Lid", "lab_msgs/msg/Side", "builtin_interfaces/msg/Time")
    types = published_types(names[0], hash_of(*names), text_of)
    definition, _ = types.generate_msgdef(names[0], ros_version=2)
    assert "float64 length" in definition
    assert "SIZE=3" in definition.replace(" ", "")


def test_definition_must_be_the_published_one() -> None:
    types = published_types(STRING, hash_of(STRING), text_of)
    assert [name for name, _ in types.fielddefs[STRING][1]] == ["other"]
    with pytest.raises(BagError, match=f"the published definition of {STRING} differs from the installed one"):
        published_types(STRING, "RIHS01_" + 64 * "1", text_of)


def test_type_without_a_definition_is_refused() -> None:
    with pytest.raises(BagError, match=r"type lab_msgs/msg/Nope: its package installs no \.msg file"):
        published_types("lab_msgs/msg/Nope", "", text_of)
    with pytest.raises(BagError, match=r"type lab_msgs/msg/Odd: invalid \.msg file"):
        published_types("lab_msgs/msg/Odd", "", text_of)

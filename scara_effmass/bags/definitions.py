"""Message definitions: those a recording brings along win, the project's own and those of ROS 2 Jazzy fill in."""

from __future__ import annotations

import os
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from rosbags.interfaces import MessageDefinitionFormat
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from scara_effmass.errors import BagError
from scara_effmass.share import share
from scara_effmass.wire.message_types import HEADER, JOINT_STATE, OWN_PACKAGE, TIME

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rosbags.interfaces import MessageDefinition
    from rosbags.interfaces.typing import Typesdict

IDL_MARK = "=" * 80 + "\n"


@cache
def own_types() -> Typesdict:
    """Return the definitions of `scara_effmass_msgs`, from the installed .msg files."""
    folder = _message_folder()
    types: Typesdict = {}
    for path in sorted(folder.glob("*.msg")):
        types |= get_types_from_msg(path.read_text(encoding="utf-8"), f"{OWN_PACKAGE}/msg/{path.stem}")
    return types


@cache
def known_types() -> Typestore:
    """Return the types of ROS 2 Jazzy and the project's own."""
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(own_types())
    return store


def types_of(definitions: Mapping[str, MessageDefinition], *, ros1: bool = False) -> Typestore:
    """Return a store of the types in `definitions` and, where they leave any open, of the known ones.

    A definition that cannot be understood is left out: it must not keep anyone from reading the other topics.
    With `ros1`, the header is that of ROS 2, into which ROS 1 messages are converted.
    """
    store = Typestore()
    # the first definition of a type stays: let that be the one the joint states came with
    for name in sorted(definitions, key=lambda name: name != JOINT_STATE):
        with suppress(Exception):
            embedded = _parsed(name, definitions[name])
            if ros1:
                embedded.pop(HEADER, None)
            store.register(embedded)
    known = known_types()
    for name in known.fielddefs.keys() - store.fielddefs.keys():
        store.fielddefs[name] = known.fielddefs[name]
        store.types[name] = known.types[name]
    return store


def check_definition(types: Typestore, kind: str, origin: str) -> None:
    """Refuse a recording whose own definition of `kind`, which has a Header, is not the known one; raises BagError."""
    known = known_types()
    for name in (kind, HEADER, TIME):
        fields, right = ([(field, kind) for field, kind in store.fielddefs[name][1]] for store in (types, known))
        if fields != right:
            whose = "this version's" if name.startswith(OWN_PACKAGE) else "that of ROS"
            raise BagError(f"{origin}: its own definition of {name} is not {whose}; {kind} cannot be read")


def _message_folder() -> Path:
    """Return where the .msg files are: in a checkout, beside the package's own files, or in another ROS prefix."""
    mine = share("package.xml").parent
    prefixes = [Path(prefix) for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
    installed = [mine.parent / OWN_PACKAGE, *(prefix / "share" / OWN_PACKAGE for prefix in prefixes)]
    for folder in (mine / "msg_schemas", *installed):
        if any((folder / "msg").glob("*.msg")):
            return folder / "msg"
    raise BagError(f"{mine}: no {OWN_PACKAGE}/msg/*.msg beside it or in AMENT_PREFIX_PATH; install {OWN_PACKAGE}")


def _parsed(name: str, definition: MessageDefinition) -> Typesdict:
    if definition.format == MessageDefinitionFormat.MSG:
        return get_types_from_msg(definition.data, name)
    types: Typesdict = {}
    parts = definition.data.split(IDL_MARK) if definition.data.startswith(f"{IDL_MARK}IDL: ") else [definition.data]
    for part in parts:
        text = part.partition("\n")[2] if part.startswith("IDL: ") else part
        if text.strip():
            types |= get_types_from_idl(text)
    return types

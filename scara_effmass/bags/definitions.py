# SPDX-License-Identifier: Apache-2.0
"""Message definitions of bags, live publishers, this package and ROS 2 Jazzy."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache, lru_cache
from typing import Any

from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat, Nodetype
from rosbags.interfaces.typing import Typesdict
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from scara_effmass.errors import BagError
from scara_effmass.wire.force import ADDED_FIELDS
from scara_effmass.wire.message_types import HEADER, JOINT_STATE, OWN_PACKAGE, definition_files

IDL_SEPARATOR = "=" * 80 + "\n"
UNSET_HASH = "RIHS01_" + 64 * "0"
"""Hash sent by publishers that do not state their definition."""


@cache
def own_types() -> Typesdict:
    """Return the definitions of `scara_effmass_msgs`, from the installed .msg files. Raises BagError without them."""
    types: Typesdict = {}
    for path in definition_files(OWN_PACKAGE):
        types |= get_types_from_msg(path.read_text(encoding="utf-8"), f"{OWN_PACKAGE}/msg/{path.stem}")
    if not types:
        raise BagError(f"{OWN_PACKAGE}: no .msg files are installed; install {OWN_PACKAGE}")
    return types


@cache
def known_types() -> Typestore:
    """Return the types of ROS 2 Jazzy and of this package."""
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(own_types())
    return store


@lru_cache
def types_of(definitions: frozenset[tuple[str, MessageDefinition]], *, ros1: bool = False) -> Typestore:
    """Return the types in `definitions`, pairs of type and definition, and the known types.

    Invalid definitions are skipped, so that the other topics can be read. With `ros1`, the header is that of ROS 2,
    because ROS 1 messages are converted.
    """
    store = Typestore()
    # Typestore keeps the first definition of a type, so those that come with the joint states are registered first.
    for name, definition in sorted(definitions, key=lambda item: (item[0] != JOINT_STATE, item[0])):
        with suppress(Exception):
            embedded = _parse(name, definition)
            if ros1:
                embedded.pop(HEADER, None)
            store.register(embedded)
    known = known_types()
    for name in known.fielddefs.keys() - store.fielddefs.keys():
        store.fielddefs[name] = known.fielddefs[name]
        store.types[name] = known.types[name]
    return store


def check_definition(types: Typestore, message_type: str, origin: str) -> bool:
    """Raise BagError if a bag defines `message_type`, or a type in it, differently from the known definition.

    Returns whether the definition is that of an earlier version, without the fields in `ADDED_FIELDS`.
    """
    known = known_types()
    added = ADDED_FIELDS.get(message_type, 0)
    is_earlier = added > 0 and types.fielddefs[message_type][1] == known.fielddefs[message_type][1][:-added]
    for name in () if is_earlier else _with_nested(known, message_type):
        fields, known_fields = (
            [(field, field_type) for field, field_type in store.fielddefs[name][1]] for store in (types, known)
        )
        if fields != known_fields:
            expected = "this version" if name.startswith(OWN_PACKAGE) else "ROS"
            raise BagError(f"{origin}: definition of {name}: must be that of {expected}; cannot read {message_type}")
    return is_earlier


def _with_nested(types: Typestore, message_type: str) -> Iterator[str]:
    """Yield `message_type` and the types of its fields, which may repeat."""
    yield message_type
    for _, field_type in types.fielddefs[message_type][1]:
        for name in _referenced(field_type):
            yield from _with_nested(types, name)


def definition_of(types: Typestore, message_type: str, origin: str) -> tuple[str, str]:
    """Return the definition of a type, including the types in it, and its hash. Raises BagError if unknown."""
    try:
        definition, _ = types.generate_msgdef(message_type, ros_version=2)
        return definition, types.hash_rihs01(message_type)
    except (TypesysError, LookupError):
        raise BagError(f"{origin}: type {message_type} is not defined") from None


def published_types(message_type: str, type_hash: str, definition_text: Callable[[str], str]) -> Typestore:
    """Return types in which `message_type` has the definition with the hash `type_hash` (RIHS01_...).

    `definition_text` returns the .msg text of an installed type, empty if there is none. Raises BagError if neither the
    known nor the installed definition has that hash.
    """
    stated_hash = type_hash if type_hash.startswith("RIHS01_") and type_hash != UNSET_HASH else ""
    known = known_types()
    if message_type in known.fielddefs and stated_hash in {"", known.hash_rihs01(message_type)}:
        return known
    installed = Typestore()
    _register_installed(installed, message_type, definition_text)
    if stated_hash not in {"", installed.hash_rihs01(message_type)}:
        raise BagError(f"the published definition of {message_type} differs from the installed one")
    return installed


def _register_installed(store: Typestore, message_type: str, definition_text: Callable[[str], str]) -> None:
    """Register a type and the types in it. Raises BagError."""
    pending = {message_type}
    while pending:
        name = pending.pop()
        text = definition_text(name)
        if not text:
            raise BagError(f"type {name}: its package installs no .msg file")
        try:
            types = get_types_from_msg(text, name)
            store.register(types)
        except (TypesysError, ValueError) as error:
            raise BagError(f"type {name}: invalid .msg file: {' '.join(str(error).split())}") from None
        field_types = (field_type for _, fields in types.values() for _, field_type in fields)
        pending |= {other for field_type in field_types for other in _referenced(field_type)} - store.fielddefs.keys()


def _referenced(field_type: Any) -> Iterator[str]:  # noqa: ANN401 - nested tuples of rosbags
    """Yield the message types in the type of a field."""
    node, content = field_type
    if node == Nodetype.NAME:
        yield content
    elif node in {Nodetype.ARRAY, Nodetype.SEQUENCE}:
        yield from _referenced(content[0])


def _parse(name: str, definition: MessageDefinition) -> Typesdict:
    if definition.format == MessageDefinitionFormat.MSG:
        return get_types_from_msg(definition.data, name)
    types: Typesdict = {}
    text = definition.data
    for part in text.split(IDL_SEPARATOR) if text.startswith(f"{IDL_SEPARATOR}IDL: ") else [text]:
        idl = part.partition("\n")[2] if part.startswith("IDL: ") else part
        if idl.strip():
            types |= get_types_from_idl(idl)
    return types

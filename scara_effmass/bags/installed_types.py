"""Types of live topics: the known ones, else as their packages define them where they are installed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import TypesysError, get_types_from_msg
from rosbags.typesys.store import Typestore

from scara_effmass.bags.definitions import known_types
from scara_effmass.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

UNSET = "RIHS01_" + 64 * "0"
"""Hash of publishers that do not say which definition they use, as older ones do not."""


def types_for(kind: str, type_hash: str, text_of: Callable[[str], str]) -> Typestore:
    """Return types in which `kind` has the definition that `type_hash` (RIHS01_...) stands for.

    `text_of` returns the .msg text of an installed type, empty where there is none. Raises BagError when neither
    the known nor the installed definition is that one: what is published would be misread.
    """
    stated = type_hash if type_hash.startswith("RIHS01_") and type_hash != UNSET else ""
    known = known_types()
    if kind in known.fielddefs and stated in {"", known.hash_rihs01(kind)}:
        return known
    installed = Typestore()
    _register(installed, kind, text_of)
    if stated not in {"", installed.hash_rihs01(kind)}:
        raise BagError(f"it is published with a definition of {kind} that is not the one installed here")
    return installed


def _register(store: Typestore, kind: str, text_of: Callable[[str], str]) -> None:
    """Add a type and those it refers to. Raises BagError."""
    waiting = {kind}
    while waiting:
        name = waiting.pop()
        text = text_of(name)
        if not text:
            raise BagError(f"type {name} has no .msg file where its package is installed")
        try:
            types = get_types_from_msg(text, name)
            store.register(types)
        except (TypesysError, ValueError) as error:
            raise BagError(f"type {name}: its .msg file is not understood: {' '.join(str(error).split())}") from None
        fields = (field for _, fields in types.values() for _, field in fields)
        waiting |= {found for field in fields for found in _names_in(field)} - store.fielddefs.keys()


def _names_in(field: Any) -> Iterator[str]:  # noqa: ANN401 - nested tuples of rosbags
    """Yield the message types that a field is made of."""
    node, content = field
    if node == Nodetype.NAME:
        yield content
    elif node in {Nodetype.ARRAY, Nodetype.SEQUENCE}:
        yield from _names_in(content[0])

# SPDX-License-Identifier: Apache-2.0
"""Decompress chunks, messages and files of bags to at most what they state and what is plausible.

Few bytes can decompress to terabytes, so all functions here stop at a limit.
"""

import bz2
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import lz4.frame  # type: ignore[import-untyped]
import zstandard

from scara_effmass.errors import BagError, DecodeError

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
ZSTD_SUFFIXES = (".zstd", ".zst")
MAX_CHUNK_BYTES = 1 << 30
"""Largest chunk or message, uncompressed."""
MAX_UNSTATED_BYTES = 1 << 34
"""Largest file, uncompressed, whose compressed form does not state its size."""
RESERVE_BYTES = 1 << 27
"""Space that a decompressed file leaves on the disk."""
_PIECE_BYTES = 1 << 20
_MAX_HEAD_BYTES = 18
"""Size of the longest head of a zstd frame."""


def _zstd(data: bytes) -> Iterator[bytes]:
    with zstandard.ZstdDecompressor().stream_reader(data) as stream:
        while piece := stream.read(_PIECE_BYTES):
            yield piece


def _pieces(decompressor: lz4.frame.LZ4FrameDecompressor | bz2.BZ2Decompressor, data: bytes) -> Iterator[bytes]:
    while not decompressor.eof:
        piece = decompressor.decompress(data, _PIECE_BYTES)
        data = b""
        if not piece and decompressor.needs_input:  # truncated
            return
        yield piece


DECOMPRESSORS: dict[str, Callable[[bytes], Iterator[bytes]]] = {
    "": lambda data: iter((data,)),
    "none": lambda data: iter((data,)),
    "zstd": _zstd,
    "lz4": lambda data: _pieces(lz4.frame.LZ4FrameDecompressor(), data),
    "bz2": lambda data: _pieces(bz2.BZ2Decompressor(), data),
}
"""Functions that yield the uncompressed data in pieces; of a truncated stream, its intact part."""
MCAP_COMPRESSIONS = ("zstd", "lz4")


def inflate(data: bytes, compression: str, size: int) -> bytes:
    """Return the uncompressed data, of which `size` bytes are expected; of a truncated stream, its intact part.

    Raises DecodeError if the data is damaged, or longer than `size` or MAX_CHUNK_BYTES.
    """
    if size > MAX_CHUNK_BYTES:
        raise DecodeError(f"uncompressed size {size}: must be <= {MAX_CHUNK_BYTES}")
    pieces: list[bytes] = []
    length = 0
    try:
        for piece in DECOMPRESSORS[compression](data):
            length += len(piece)
            if length > size:
                raise DecodeError(f"it decompresses to more than {size} bytes, its stated size")
            pieces.append(piece)
    except (zstandard.ZstdError, OSError, RuntimeError, MemoryError, EOFError) as error:
        raise DecodeError(f"its {compression} data is damaged: {error}") from None
    return b"".join(pieces)


def inflate_message(data: bytes) -> bytes:
    """Return a message that rosbag2 compressed with zstd. Raises DecodeError."""
    try:
        size = zstandard.frame_content_size(data)
    except zstandard.ZstdError as error:
        raise DecodeError(f"its zstd data is damaged: {error}") from None
    message = inflate(data, "zstd", size if size >= 0 else MAX_CHUNK_BYTES)
    if not message or 0 <= size != len(message):
        raise DecodeError("its zstd data is cut off")
    return message


def inflate_file(path: Path, folder: Path) -> Path:
    """Decompress a zstd file into `folder`, and return the new file, without the suffix of the compression.

    A truncated file gives its intact part. Raises BagError if it is damaged from the start, longer than it states, or
    has no room, and OSError.
    """
    name = path.stem if path.suffix.lower() in ZSTD_SUFFIXES else path.name
    room = shutil.disk_usage(folder).free - RESERVE_BYTES
    with path.open("rb") as file, (folder / name).open("xb") as output:
        try:
            stated = zstandard.frame_content_size(file.read(_MAX_HEAD_BYTES))
            if stated > room:
                problem = (
                    f"{stated / 1e9:.1f} GB uncompressed: must fit into {folder.parent}, which has too little room"
                )
                raise BagError(f"{path}: {problem}; set TMPDIR to another folder")
            limit = min(stated if stated >= 0 else MAX_UNSTATED_BYTES, room)
            file.seek(0)
            with zstandard.ZstdDecompressor().stream_reader(file) as stream:
                while piece := stream.read(_PIECE_BYTES):
                    output.write(piece)
                    if output.tell() > limit:
                        raise BagError(f"{path}: uncompressed content: must not be longer than {limit} bytes")
        except zstandard.ZstdError as error:
            if not output.tell():
                raise BagError(f"{path}: its zstd data is damaged: {error}") from None
        if stated and not output.tell():
            raise BagError(f"{path}: its zstd data is cut off before anything that can be decompressed")
    return folder / name

"""A file on a disk that may fail: what it has not taken stays in memory, and what it holds ends in whole pieces."""

from __future__ import annotations

import fcntl
import os
from contextlib import suppress
from typing import IO, TYPE_CHECKING, final

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    OpenRaw = Callable[[Path], IO[bytes]]


def open_raw(path: Path) -> IO[bytes]:
    """Open a new file without a buffer, whose errors would come later and elsewhere."""
    return path.open("xb", buffering=0)


@final
class DiskFile:
    """What an MCAP writer writes to, so that its state never depends on the disk. It is locked while open."""

    def __init__(self, path: Path, opener: OpenRaw = open_raw) -> None:
        """Make the file. Raises OSError."""
        self.saved = 0
        """Bytes that the file has."""
        self.waiting = 0
        """Bytes that it does not have yet."""
        self._pieces: list[bytes] = []
        self._file = opener(path)
        with suppress(OSError):  # some network disks know no locks
            fcntl.flock(self._file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)

    def write(self, data: bytes) -> int:
        """Take `data` for the next `save`."""
        self._pieces.append(bytes(data))
        self.waiting += len(data)
        return len(data)

    def tell(self) -> int:
        """Return where the next byte is going to stand."""
        return self.saved + self.waiting

    def flush(self) -> None:
        """Nothing: `save` is what writes."""

    def save(self) -> None:
        """Hand everything that waits to the file, or nothing of it. Raises OSError."""
        data = memoryview(b"".join(self._pieces))
        done = 0
        try:
            while done < len(data):
                done += self._file.write(data[done:])
        except OSError:
            with suppress(OSError):  # then it ends in a torn record, which every reader here steps over
                self._file.truncate(self.saved)
            self._file.seek(self.saved)
            raise
        self.saved += done
        self.waiting = 0
        self._pieces.clear()

    def sync(self) -> None:
        """Bring what was saved to the disk, so that it outlives a power cut. Raises OSError."""
        os.fdatasync(self._file.fileno())

    def close(self) -> None:
        """Close the file; what was not saved is lost."""
        self._file.close()


def is_being_written(path: Path) -> bool:
    """Whether a recorder has the file open. Raises OSError."""
    with path.open("rb") as file:
        try:
            fcntl.flock(file.fileno(), fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:  # no locks here
            return False
    return False

# SPDX-License-Identifier: Apache-2.0
"""Remote files: URLs that fsspec supports, used like paths of local files."""

from __future__ import annotations

import errno
import io
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from pathlib import Path, PosixPath
from typing import IO, Any

from scara_effmass.errors import BagError
from scara_effmass.extras import pip_line


def location(text: str) -> Path:
    """Return the path or URL in `text`; file:// becomes a path."""
    text = text.removeprefix("file://")
    return Url(text) if "://" in text else Path(text)


def local_file(path: Path) -> Path:
    """Return `path` itself, or a local copy of a URL, which is deleted when this process ends. Raises OSError."""
    if not isinstance(path, Url):
        return path
    import fsspec  # type: ignore[import-untyped]  # noqa: PLC0415

    with _errors_of(path):
        return Path(fsspec.open_local(f"simplecache::{path}"))


class Url(PosixPath):
    """URL such as s3://bucket/run.mcap, with the methods of Path that reading and writing need.

    Every method raises OSError if the URL cannot be reached.
    """

    def __str__(self) -> str:
        return super().__str__().replace(":/", "://", 1)

    def exists(self, **_: Any) -> bool:  # noqa: ANN401 - Path has other parameters in each Python
        """Return whether this is a file or folder."""
        return self.is_file() or self.is_dir()

    def is_file(self, **_: Any) -> bool:  # noqa: ANN401
        """Return whether this is a file."""
        return self._found() == "file"

    def is_dir(self, **_: Any) -> bool:  # noqa: ANN401
        """Return whether this is a folder."""
        return self._found() == "directory"

    def iterdir(self) -> Generator[Url, None, None]:
        """Yield the content of the folder."""
        with _errors_of(self):
            fs, path = self._filesystem()
            names = fs.ls(path, detail=False)
        yield from (self / str(name).rstrip("/").rpartition("/")[2] for name in names)

    def rglob(self, pattern: str, **_: Any) -> Generator[Url, None, None]:  # noqa: ANN401, ARG002
        """Yield all files below the folder, whatever the pattern."""
        with _errors_of(self):
            fs, path = self._filesystem()
            names = fs.find(path)
        yield from (self / str(name).removeprefix(path).lstrip("/") for name in names)

    def open(self, mode: str = "rb", **_: Any) -> IO[Any]:  # type: ignore[override]  # noqa: ANN401
        """Open the file for reading."""
        with _errors_of(self):
            fs, path = self._filesystem()
            file = io.BufferedReader(_File(self, fs.open(path, "rb")), 1 << 20)
        return file if "b" in mode else io.TextIOWrapper(file, "utf-8")

    def size(self) -> int:
        """Return the size [B]."""
        with _errors_of(self):
            fs, path = self._filesystem()
            return int(fs.size(path) or 0)

    def checksum(self) -> str:
        """Return a value that changes with the content, without reading it: on S3 a hash of the ETag."""
        with _errors_of(self):
            fs, path = self._filesystem()
            return str(fs.checksum(path))

    def upload(self, path: Path) -> None:
        """Replace the file atomically by the local file `path`."""
        with _errors_of(self):
            fs, target = self._filesystem()
            fs.makedirs(target.rpartition("/")[0], exist_ok=True)
            fs.put_file(str(path), target)

    def _filesystem(self) -> tuple[Any, str]:
        import fsspec  # noqa: PLC0415 - takes 0.2 s

        fs, path = fsspec.url_to_fs(str(self))
        fs.invalidate_cache()  # other processes also write
        return fs, path

    def _found(self) -> str:
        with _errors_of(self):
            fs, path = self._filesystem()
            try:
                return str(fs.info(path)["type"])
            except FileNotFoundError:
                return ""


class _File(io.RawIOBase):
    """An open file. A failed read raises BagError: an OSError would count as damage, and the part would be left out."""

    def __init__(self, url: Url, file: Any) -> None:  # noqa: ANN401
        self._url, self._file = url, file

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = 0) -> int:
        return int(self._file.seek(offset, whence))

    def readinto(self, buffer: Any) -> int:  # noqa: ANN401
        try:
            with _errors_of(self._url):
                data = self._file.read(len(buffer))
        except OSError as error:
            raise BagError(f"{self._url}: cannot be read: {error.strerror}") from None
        buffer[: len(data)] = data
        return len(data)

    def close(self) -> None:
        self._file.close()
        super().close()


@contextmanager
def _errors_of(url: Url) -> Iterator[None]:
    """Turn any error of a file system into an OSError with URL and cause."""
    try:
        yield
    except FileNotFoundError as error:
        raise FileNotFoundError(errno.ENOENT, "does not exist", str(url)) from error
    except ImportError:
        cause = f"needs fsspec and the file system of its protocol, for S3: {pip_line('fsspec')}"
        raise OSError(errno.EIO, cause, str(url)) from None
    except Exception as error:  # noqa: BLE001 - each file system raises its own
        cause = " ".join(str(getattr(error, "strerror", None) or error).split()) or type(error).__name__
        raise OSError(getattr(error, "errno", None) or errno.EIO, cause, str(url)) from None

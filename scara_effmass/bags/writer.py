"""New recordings, whole or not at all: MCAP, either a rosbag2 folder with its metadata or a single file."""

from __future__ import annotations

import tempfile
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, final

from scara_effmass.bags.batches import Topic
from scara_effmass.bags.definitions import known_types
from scara_effmass.bags.messages import joint_state_message
from scara_effmass.bags.part_writer import PartWriter, definition_of
from scara_effmass.bags.rosbag2 import refuse_existing, write_metadata
from scara_effmass.errors import OutputError
from scara_effmass.wire.message_types import JOINT_STATE

if TYPE_CHECKING:
    from collections.abc import Iterable
    from types import TracebackType

    from rosbags.typesys.store import Typestore

    from scara_effmass.values import JointState


@final
class BagWriter:
    """Writes a recording as rosbag2 does: zstd chunks with checksums, an index, and the message definitions in it.

    `path` ends in .mcap: one file; else a folder of that file and metadata.yaml. It appears under its name once
    it is complete: at the end of a `with`, and not at all when that is left by an error.
    """

    def __init__(self, path: Path, *, overwrite: bool = False, types: Typestore | None = None) -> None:
        """Begin a recording; `types` (default: the known ones) must define what is going to be written.

        Raises OutputError when `path` exists, unless `overwrite` allows to replace a recording, or cannot be made.
        """
        self.path = path
        self._overwrite = overwrite
        self._types = types or known_types()
        self._numbers: dict[tuple[str, str], int] = {}
        self._is_file = path.suffix == ".mcap"
        refuse_existing(path, overwrite=overwrite)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            # It goes with this object, where a signal breaks in before the `with` has begun.
            self._unfinished = tempfile.TemporaryDirectory(
                prefix=f".{path.name}-", dir=path.parent, ignore_cleanup_errors=True
            )
            with ExitStack() as undoing:
                undoing.callback(self._unfinished.cleanup)
                self._content = Path(self._unfinished.name, path.name)
                if not self._is_file:
                    self._content.mkdir()
                mcap = self._content if self._is_file else self._content / f"{path.name}_0.mcap"
                self._file = mcap.open("xb")
                undoing.callback(self._file.close)
                self._part = PartWriter(mcap.name, self._file)
                undoing.pop_all()
        except OSError as error:
            raise OutputError(f"{path}: cannot be written: {error.strerror}") from None

    def write(self, topic: str, kind: str, log_time_ns: int, data: bytes) -> None:
        """Add one message, CDR bytes of type `kind` such as "sensor_msgs/msg/JointState".

        Raises BagError when the type is not known, OutputError when the disk does not take it.
        """
        number = self._numbers.get((topic, kind))
        if number is None:
            definition, type_hash = definition_of(self._types, kind, f"{self.path}: {topic}")
            number = self._part.add_topic(Topic(topic, kind, 0, type_hash), definition)
            self._numbers[topic, kind] = number
        try:
            self._part.write(number, log_time_ns, data)
        except OSError as error:
            raise OutputError(f"{self.path}: cannot be written: {error.strerror}") from None

    def write_joint_states(self, topic: str, states: Iterable[JointState], frame_id: str = "") -> None:
        """Add joint states, logged at their own stamps; raises OutputError."""
        for state in states:
            self.write(topic, JOINT_STATE, state.stamp_ns, joint_state_message(state, frame_id))

    def close(self) -> None:
        """Complete the recording and put it in its place; raises OutputError."""
        try:
            part = self._part.finish()
            self._file.close()
            if not self._is_file:
                write_metadata(self._content, [part])
            refuse_existing(self.path, overwrite=self._overwrite)
            if self.path.exists():
                self.path.rename(Path(self._unfinished.name, "replaced"))
            self._content.rename(self.path)
        except OSError as error:
            raise OutputError(f"{self.path}: cannot be written: {error.strerror or error}") from None
        finally:
            self.abort()

    def abort(self) -> None:
        """Leave nothing of an unfinished recording."""
        self._file.close()
        try:
            self._unfinished.cleanup()
        finally:
            # A signal may have broken into that; it comes once.
            self._unfinished.cleanup()

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.abort()

"""The writer of complete bags: an MCAP file, or a rosbag2 folder of one."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path
from typing import final

from rosbags.typesys.store import Typestore

from scara_effmass.bags.batches import Topic
from scara_effmass.bags.definitions import definition_of, known_types
from scara_effmass.bags.mcap_writer import CHUNK_BYTES, McapFileWriter
from scara_effmass.bags.rosbag2 import check_output, write_metadata
from scara_effmass.errors import OutputError
from scara_effmass.values import JointState
from scara_effmass.wire.joint_state import joint_state_message
from scara_effmass.wire.message_types import JOINT_STATE


@final
class BagWriter:
    """Writes a bag that appears at `path` only when it is complete: at the end of a `with` that raises no error.

    `path` is a file if it ends in .mcap, otherwise a rosbag2 folder.
    """

    def __init__(self, path: Path, *, overwrite: bool = False, types: Typestore | None = None) -> None:
        """Start a bag; `types` (default: the known ones) must define the types of the messages.

        Raises OutputError if `path` exists and `overwrite` is false, or if it cannot be created.
        """
        self.path = path
        self._overwrite = overwrite
        self._types = types or known_types()
        self._topics: dict[tuple[str, str], int] = {}
        self._is_file = path.suffix == ".mcap"
        check_output(path, overwrite=overwrite)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            # The folder is removed with this object if a signal arrives before the `with` begins.
            self._temporary = tempfile.TemporaryDirectory(
                prefix=f".{path.name}-", dir=path.parent, ignore_cleanup_errors=True
            )
            with ExitStack() as undo:
                undo.callback(self._temporary.cleanup)
                self._unfinished = Path(self._temporary.name, path.name)
                if not self._is_file:
                    self._unfinished.mkdir()
                mcap_path = self._unfinished if self._is_file else self._unfinished / f"{path.name}_0.mcap"
                self._file = McapFileWriter(mcap_path)
                undo.pop_all()
        except OSError as error:
            raise OutputError(f"{path}: cannot be written: {error.strerror}") from None

    def write(self, topic: str, message_type: str, log_time_ns: int, data: bytes) -> None:
        """Add a message (CDR bytes). Raises BagError if the type is unknown, OutputError if the disk fails."""
        index = self._topics.get((topic, message_type))
        if index is None:
            definition, type_hash = definition_of(self._types, message_type, f"{self.path}: {topic}")
            index = self._topics[topic, message_type] = len(self._topics)
            self._file.add_topic(Topic(topic, message_type, 0, type_hash), definition)
        self._file.add_message(index, log_time_ns, data)
        if self._file.pending_bytes >= CHUNK_BYTES:
            try:
                self._file.save()
            except OSError as error:
                raise OutputError(f"{self.path}: cannot be written: {error.strerror}") from None

    def write_joint_states(self, topic: str, states: Iterable[JointState], frame_id: str = "") -> None:
        """Add joint states with their stamps as log times. Raises OutputError."""
        for state in states:
            self.write(topic, JOINT_STATE, state.stamp_ns, joint_state_message(state, frame_id))

    def close(self) -> None:
        """Complete the bag and move it to its path. Raises OutputError."""
        try:
            self._file.finish()
            self._file.save()
            self._file.close()
            if not self._is_file:
                write_metadata(self._unfinished, [self._file.saved])
            check_output(self.path, overwrite=self._overwrite)
            if self.path.exists():
                self.path.rename(Path(self._temporary.name, "replaced"))
            self._unfinished.rename(self.path)
        except OutputError:
            raise
        except OSError as error:
            raise OutputError(f"{self.path}: cannot be written: {error.strerror or error}") from None
        finally:
            self.abort()

    def abort(self) -> None:
        """Delete the unfinished bag."""
        self._file.close()
        try:
            self._temporary.cleanup()
        finally:
            # Repeated in case a signal interrupted it.
            self._temporary.cleanup()

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.close()
        else:
            self.abort()

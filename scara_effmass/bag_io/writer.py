"""New recordings: MCAP, either a rosbag2 folder with its metadata or a single file."""

from __future__ import annotations

import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import yaml
from mcap.writer import Writer
from rosbags.typesys import TypesysError

from scara_effmass.bag_io.batches import LATEST_NS
from scara_effmass.bag_io.definitions import JOINT_STATE, known_types
from scara_effmass.bag_io.files import METADATA
from scara_effmass.bag_io.messages import joint_state_message
from scara_effmass.errors import BagError, OutputError

if TYPE_CHECKING:
    from collections.abc import Iterable
    from types import TracebackType

    from rosbags.typesys.store import Typestore

    from scara_effmass.values import JointState

ROSBAG2_VERSION = 9
"""Of the metadata, as ROS 2 Jazzy writes them."""


@dataclass(slots=True)
class _Channel:
    number: int
    type_hash: str
    count: int = 0


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
        self._channels: dict[tuple[str, str], _Channel] = {}
        self._schemas: dict[str, int] = {}
        self._start_ns, self._end_ns = LATEST_NS, 0
        self._is_file = path.suffix == ".mcap"
        self._check_free()
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._unfinished = Path(tempfile.mkdtemp(prefix=f".{path.name}-", dir=path.parent))
            self._content = self._unfinished / path.name
            if not self._is_file:
                self._content.mkdir()
            self._mcap = self._content if self._is_file else self._content / f"{path.name}_0.mcap"
            self._file = self._mcap.open("xb")
        except OSError as error:
            raise OutputError(f"{path}: cannot be written: {error.strerror}") from None
        self._writer = Writer(self._file)
        self._writer.start(profile="ros2", library="scara_effmass")

    def write(self, topic: str, kind: str, log_time_ns: int, data: bytes) -> None:
        """Add one message, CDR bytes of type `kind` such as "sensor_msgs/msg/JointState".

        Raises BagError when the type is not known, OutputError when the disk does not take it.
        """
        channel = self._channels.get((topic, kind)) or self._new_channel(topic, kind)
        try:
            self._writer.add_message(channel.number, log_time_ns, data, log_time_ns, channel.count)
        except OSError as error:
            raise OutputError(f"{self.path}: cannot be written: {error.strerror}") from None
        channel.count += 1
        self._start_ns = min(self._start_ns, log_time_ns)
        self._end_ns = max(self._end_ns, log_time_ns)

    def write_joint_states(self, topic: str, states: Iterable[JointState], frame_id: str = "") -> None:
        """Add joint states, logged at their own stamps; raises OutputError."""
        for state in states:
            self.write(topic, JOINT_STATE, state.stamp_ns, joint_state_message(state, frame_id))

    def close(self) -> None:
        """Complete the recording and put it in its place; raises OutputError."""
        try:
            if not self._is_file:
                text = yaml.safe_dump(self._metadata(), sort_keys=False)
                self._writer.add_metadata("rosbag2", {"serialized_metadata": text})
                full = yaml.safe_dump({"rosbag2_bagfile_information": self._metadata()}, sort_keys=False)
                (self._content / METADATA).write_text(full, encoding="utf-8")
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._file.close()
            self._check_free()
            if self.path.exists():
                self.path.rename(self._unfinished / "replaced")
            self._content.rename(self.path)
        except OSError as error:
            raise OutputError(f"{self.path}: cannot be written: {error.strerror or error}") from None
        finally:
            self.abort()

    def abort(self) -> None:
        """Leave nothing of an unfinished recording."""
        self._file.close()
        shutil.rmtree(self._unfinished, ignore_errors=True)

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.abort()

    def _check_free(self) -> None:
        if not self.path.exists():
            return
        if not self._overwrite:
            raise OutputError(f"{self.path}: exists already; it is replaced only when that is asked for")
        if self.path.is_dir() is self._is_file or (self.path.is_dir() and not (self.path / METADATA).is_file()):
            raise OutputError(f"{self.path}: exists and is no such recording; it is not replaced")

    def _new_channel(self, topic: str, kind: str) -> _Channel:
        try:
            definition, _ = self._types.generate_msgdef(kind, ros_version=2)
            type_hash = self._types.hash_rihs01(kind)
        except TypesysError:
            raise BagError(f"{self.path}: {topic}: type {kind} has no definition here") from None
        if kind not in self._schemas:
            self._schemas[kind] = self._writer.register_schema(kind, "ros2msg", definition.encode())
        about = {"offered_qos_profiles": "", "topic_type_hash": type_hash}
        channel = _Channel(self._writer.register_channel(topic, "cdr", self._schemas[kind], about), type_hash)
        self._channels[topic, kind] = channel
        return channel

    def _metadata(self) -> dict[str, Any]:
        count = sum(channel.count for channel in self._channels.values())
        start = {"nanoseconds_since_epoch": self._start_ns if count else 0}
        duration = {"nanoseconds": self._end_ns - self._start_ns if count else 0}
        topics = [
            {
                "topic_metadata": {
                    "name": topic,
                    "type": kind,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": [],
                    "type_description_hash": channel.type_hash,
                },
                "message_count": channel.count,
            }
            for (topic, kind), channel in self._channels.items()
        ]
        part = {"path": self._mcap.name, "starting_time": start, "duration": duration, "message_count": count}
        return {
            "version": ROSBAG2_VERSION,
            "storage_identifier": "mcap",
            "duration": dict(duration),
            "starting_time": dict(start),
            "message_count": count,
            "topics_with_message_count": topics,
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [self._mcap.name],
            "files": [part],
            "custom_data": None,
            "ros_distro": "jazzy",
        }

"""How a recording is written."""

from __future__ import annotations

from dataclasses import dataclass

from scara_effmass.errors import SettingsError


@dataclass(frozen=True, slots=True)
class RecordingOptions:
    """How a recording is written. Raises SettingsError for a value that cannot be used."""

    compress: bool = True
    """Chunks in zstd, or as they are."""
    part_bytes: int = 0
    """A file that has reached this size is completed, and another one begun; 0: never."""
    part_ns: int = 0
    """The same for the time between the log times of its first and its next message; 0: never."""
    flush_period_s: float = 0.5
    """At most so long a message stays off the disk, with up to 0.1 s for the thread that writes."""
    queue_bytes: int = 64 << 20
    """What may wait for the disk; messages beyond it are lost, and counted."""
    queue_messages: int = 100_000
    reserve_bytes: int = 64 << 20
    """Free space at which a recording stops, so that it can be completed and others can live on."""
    warn_bytes: int = 1 << 30
    """Free space below which it warns."""
    warn_before_s: float = 600.0
    """It also warns when the disk is going to be full in less than this at the present rate."""

    def __post_init__(self) -> None:
        for key, value, least in (
            ("part_bytes", self.part_bytes, 0),
            ("part_ns", self.part_ns, 0),
            ("flush_period_s", self.flush_period_s, 0.001),
            ("queue_bytes", self.queue_bytes, 1),
            ("queue_messages", self.queue_messages, 1),
            ("reserve_bytes", self.reserve_bytes, 0),
            ("warn_bytes", self.warn_bytes, 0),
            ("warn_before_s", self.warn_before_s, 0.0),
        ):
            if not value >= least:
                raise SettingsError(f"recording: {key} = {value}: {least} or more would be right")

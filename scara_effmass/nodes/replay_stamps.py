"""Whether header stamps agree with the times at which a recording says its messages came."""

from __future__ import annotations

import struct

_STAMP = {0: struct.Struct(">iI"), 1: struct.Struct("<iI")}
STALE_NS = 200_000_000
FUTURE_NS = 20_000_000
"""Beyond these a monitor with default settings takes a joint state as stale, or as one from the future."""


def header_stamp_ns(data: bytes) -> int:
    """Return the stamp of a message that begins with a std_msgs/Header, given as CDR bytes; 0 where it is cut off."""
    try:
        sec, nanosec = _STAMP[data[1] & 1].unpack_from(data, 4)
    except (IndexError, struct.error):
        return 0
    return int(sec) * 1_000_000_000 + int(nanosec)


class StampCheck:
    """Compares header stamps with log times, message by message."""

    def __init__(self) -> None:
        """Start with nothing seen."""
        self.seen = 0
        self.off = 0
        self.worst_ns = 0

    def see(self, data: bytes, log_time_ns: int) -> None:
        """Take account of one message."""
        ahead_ns = header_stamp_ns(data) - log_time_ns
        self.seen += 1
        if not -STALE_NS <= ahead_ns <= FUTURE_NS:
            self.off += 1
            self.worst_ns = max(self.worst_ns, ahead_ns, key=abs)

    def warnings(self) -> tuple[str, ...]:
        """Return what a person should know of it, if anything."""
        if not self.off:
            return ()
        side = "ahead of" if self.worst_ns > 0 else "behind"
        count = f"{self.off} of {self.seen} joint states"
        worst = f"up to {abs(self.worst_ns) / 1e9:.3f} s {side} the time they were recorded at"
        return (f"{count} bear header stamps {worst}: a monitor on this clock says UNKNOWN to them",)

# SPDX-License-Identifier: Apache-2.0
"""Debounce verdicts: a worse one shows at once, a better one after the release time."""

from typing import Final

from scara_effmass.values import Verdict

OK: Final = Verdict.OK
"""A constant, as are those below, because mypyc looks up attributes of other modules in dictionaries: hot path."""
UNKNOWN: Final = Verdict.UNKNOWN
VIOLATION: Final = Verdict.VIOLATION
HELD = "held after: "
"""Prefix of the reason of a verdict that is held from an earlier joint state."""
_WORST_FIRST = (Verdict.UNKNOWN, Verdict.VIOLATION, Verdict.WARN)


class VerdictDebouncer:
    """Debounces the verdicts of one contact point over the header time of its joint states.

    A verdict other than OK is held for `release_ns` after the last joint state that caused it.
    """

    def __init__(self) -> None:
        """Start without history, and with a release time of 0."""
        self.release_ns = 0
        self._last_seen: dict[Verdict, tuple[int, str]] = {}
        self._stale_reason = ""

    def clear(self) -> None:
        """Discard the verdicts that are held."""
        self._last_seen.clear()
        self._stale_reason = ""

    def mark_stale(self, reason: str) -> None:
        """Hold UNKNOWN with `reason` from the next valid joint state on."""
        self._stale_reason = reason

    def update(self, verdict: Verdict, reason: str, stamp_ns: int) -> tuple[Verdict, str]:
        """Return the debounced verdict and its reason, given those of the joint state at `stamp_ns`."""
        last_seen = self._last_seen
        if self._stale_reason:
            last_seen[Verdict.UNKNOWN] = (stamp_ns, self._stale_reason)
            self._stale_reason = ""
        if verdict is not OK:
            last_seen[verdict] = (stamp_ns, reason)
        elif not last_seen:
            return verdict, reason
        for worse in _WORST_FIRST:
            if worse is verdict:
                break
            entry = last_seen.get(worse)
            if entry is None:
                continue
            if stamp_ns - entry[0] < self.release_ns:
                return worse, f"{HELD}{entry[1]}"
            del last_seen[worse]
        return verdict, reason

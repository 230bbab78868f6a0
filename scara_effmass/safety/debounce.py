"""A verdict gets worse at once, and better only after the worse one has been gone for a while."""

from __future__ import annotations

from scara_effmass.values import Verdict

WORST_FIRST = (Verdict.UNKNOWN, Verdict.VIOLATION, Verdict.WARN)
"""UNKNOWN is the worst: nothing is allowed under it."""
_SEVERITY = {Verdict.OK: 0, Verdict.WARN: 1, Verdict.VIOLATION: 2, Verdict.UNKNOWN: 3}


def severity(verdict: Verdict) -> int:
    """Return 0 for OK up to 3 for UNKNOWN."""
    return _SEVERITY[verdict]


class VerdictDebouncer:
    """Debounces the verdicts of one contact point, on the header time of its joint states."""

    def __init__(self) -> None:
        """Start with nothing held; `release_ns` is how long a verdict is held after its cause was last seen."""
        self.release_ns = 0
        self._seen: dict[Verdict, tuple[int, str]] = {}
        self._lapse = ""

    def clear(self) -> None:
        """Forget what was shown."""
        self._seen.clear()
        self._lapse = ""

    def mark_stale(self, reason: str) -> None:
        """Note that nothing was known for `reason`, up to the next joint state that can be used."""
        self._lapse = reason

    def update(self, verdict: Verdict, reason: str, stamp_ns: int) -> tuple[Verdict, str]:
        """Return what to show at `stamp_ns` when `verdict` is what holds by itself."""
        seen = self._seen
        if self._lapse:
            seen[Verdict.UNKNOWN] = (stamp_ns, self._lapse)
            self._lapse = ""
        if verdict is not Verdict.OK:
            seen[verdict] = (stamp_ns, reason)
        elif not seen:
            return verdict, reason
        for worse in WORST_FIRST:
            if worse is verdict:
                break
            last = seen.get(worse)
            if last is None:
                continue
            if stamp_ns - last[0] < self.release_ns:
                return worse, f"held after: {last[1]}"
            del seen[worse]
        return verdict, reason

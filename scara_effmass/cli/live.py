"""Status of a live run: updating lines on a terminal, one line every 2 s in a pipe."""

from __future__ import annotations

import time
from itertools import chain
from types import TracebackType
from typing import final

from rich.console import Console, Group
from rich.live import Live
from rich.text import Text

from scara_effmass.values import ContactAssessment, Verdict

PIPE_PERIOD_S = 2.0
TERMINAL_PERIOD_S = 0.125
_STYLES = {
    Verdict.OK: "bold green",
    Verdict.WARN: "bold yellow",
    Verdict.VIOLATION: "bold white on red",
    Verdict.UNKNOWN: "bold black on white",
}


@final
class StatusLine:
    """Shows the latest assessments; to be used in a `with`."""

    def __init__(self, console: Console, *, visible: bool) -> None:
        """Prepare to print on `console`; an invisible status prints nothing."""
        self._console = console
        self._visible = visible
        self._last_update_s = 0.0
        self._live = Live(console=console, auto_refresh=False, transient=True) if console.is_terminal else None

    def show(self, contacts: tuple[ContactAssessment, ...], time_s: float, speed_scaling: float) -> None:
        """Show the assessments at `time_s` of the run, unless the last update is too recent."""
        now_s = time.monotonic()
        period_s = TERMINAL_PERIOD_S if self._live else PIPE_PERIOD_S
        if not self._visible or now_s - self._last_update_s < period_s:
            return
        self._last_update_s = now_s
        lines = [_line(contact, time_s, speed_scaling) for contact in contacts]
        if self._live is None:
            self._console.print(*lines, sep="\n")
        else:
            reasons = [Text(f"  {contact.reason}", no_wrap=True, overflow="ellipsis") for contact in contacts]
            self._live.update(Group(*chain.from_iterable(zip(lines, reasons, strict=True))), refresh=True)

    def __enter__(self) -> StatusLine:
        if self._live and self._visible:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._live:
            self._live.stop()


def _line(contact: ContactAssessment, time_s: float, speed_scaling: float) -> Text:
    text = Text(f"{time_s:6.1f} s  {contact.contact_point}: ", no_wrap=True)
    text.append(f"{contact.speed:5.3f} of {contact.allowable_speed:5.3f} m/s, {contact.effective_mass:6.3g} kg  ")
    text.append(f"{contact.verdict.name:<9}", _STYLES[contact.verdict])
    return text.append(f"  scaling {speed_scaling:.2f}")

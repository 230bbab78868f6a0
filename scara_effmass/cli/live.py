"""The status of a live run: two lines that update on a terminal, one line every two seconds in a pipe."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, final

from rich.console import Group
from rich.live import Live
from rich.text import Text

from scara_effmass.values import Verdict

if TYPE_CHECKING:
    from types import TracebackType

    from rich.console import Console

    from scara_effmass.values import ContactAssessment

PIPE_PERIOD_S = 2.0
TERMINAL_PERIOD_S = 0.125
BAR_WIDTH = 12
_STYLES = {
    Verdict.OK: "bold green",
    Verdict.WARN: "bold yellow",
    Verdict.VIOLATION: "bold white on red",
    Verdict.UNKNOWN: "bold black on white",
}


@final
class StatusLine:
    """Shows the latest assessments; to be used in a `with`."""

    def __init__(self, console: Console, duration_s: float, *, visible: bool) -> None:
        """Show a run of `duration_s` seconds on `console`; an invisible status prints nothing."""
        self._console = console
        self._duration_s = duration_s
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
        if self._live is None:
            for contact in contacts:
                self._console.print(f"{time_s:6.1f} s  {_line(contact)}  scaling {speed_scaling:.2f}")
        else:
            self._live.update(self._render(contacts, time_s, speed_scaling), refresh=True)

    def __enter__(self) -> StatusLine:
        if self._live and self._visible:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._live:
            self._live.stop()

    def _render(self, contacts: tuple[ContactAssessment, ...], time_s: float, speed_scaling: float) -> Group:
        lines = []
        for contact in contacts:
            style = _STYLES[contact.verdict]
            text = Text(no_wrap=True, overflow="ellipsis")
            text.append(f"{contact.contact_point}  {time_s:5.1f} of {self._duration_s:.1f} s  ")
            text.append(f" {contact.verdict.name:<9} ", style)
            text.append(f"  {contact.speed:.3f} of {contact.allowable_speed:.3f} m/s ")
            text.append(_bar(contact), style.split(" on ")[0])
            text.append(f"  {contact.effective_mass:.3g} kg  scaling {speed_scaling:.2f}")
            lines.append(text)
            lines.append(Text(f"  {contact.reason}", no_wrap=True, overflow="ellipsis"))
        return Group(*lines)


def _line(contact: ContactAssessment) -> str:
    return (
        f"{contact.contact_point}: {contact.speed:5.3f} of {contact.allowable_speed:5.3f} m/s, "
        f"{contact.effective_mass:6.3g} kg  {contact.verdict.name:<9}"
    )


def _bar(contact: ContactAssessment) -> str:
    ratio = min(1.0, contact.speed / contact.allowable_speed) if contact.allowable_speed > 0.0 else 0.0
    filled = round(BAR_WIDTH * ratio)
    return "█" * filled + "░" * (BAR_WIDTH - filled)

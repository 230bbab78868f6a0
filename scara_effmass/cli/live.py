"""What a person sees while a run goes on: two lines that change on a terminal, a line now and then in a pipe."""

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

LINE_EVERY_S = 2.0
DRAWN_PER_S = 8.0
BAR_CELLS = 12
_STYLES = {
    Verdict.OK: "bold green",
    Verdict.WARN: "bold yellow",
    Verdict.VIOLATION: "bold white on red",
    Verdict.UNKNOWN: "bold black on white",
}


@final
class StatusLine:
    """Shows the latest cycle; to be used in a `with`."""

    def __init__(self, console: Console, span_s: float) -> None:
        """Show on `console` a run of `span_s` seconds."""
        self._console = console
        self._span_s = span_s
        self._shown_at = 0.0
        self._live = Live(console=console, auto_refresh=False, transient=True) if console.is_terminal else None

    def show(self, contacts: tuple[ContactAssessment, ...], time_s: float, speed_scaling: float) -> None:
        """Show a cycle at `time_s` of the run, unless the last one was shown just now."""
        now = time.monotonic()
        pause = 1.0 / DRAWN_PER_S if self._live else LINE_EVERY_S
        if now - self._shown_at < pause:
            return
        self._shown_at = now
        if self._live is None:
            for contact in contacts:
                self._console.print(f"{time_s:6.1f} s  {_line(contact)}  scaling {speed_scaling:.2f}")
        else:
            self._live.update(self._drawn(contacts, time_s, speed_scaling), refresh=True)

    def __enter__(self) -> StatusLine:
        if self._live:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._live:
            self._live.stop()

    def _drawn(self, contacts: tuple[ContactAssessment, ...], time_s: float, speed_scaling: float) -> Group:
        lines = []
        for contact in contacts:
            style = _STYLES[contact.verdict]
            text = Text(no_wrap=True, overflow="ellipsis")
            text.append(f"{contact.contact_point}  {time_s:5.1f} of {self._span_s:.1f} s  ")
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
    share = min(1.0, contact.speed / contact.allowable_speed) if contact.allowable_speed > 0.0 else 0.0
    filled = round(BAR_CELLS * share)
    return "█" * filled + "░" * (BAR_CELLS - filled)

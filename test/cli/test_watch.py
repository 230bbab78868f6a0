# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass watch`: the screen of each verdict, and a monitor that is killed, in a pseudo-terminal."""

import fcntl
import os
import pty
import re
import select
import signal
import struct
import sys
import termios
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing, suppress
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from scara_effmass.cell.status import CellStatus, Validation
from scara_effmass.cli.console import live_status
from scara_effmass.cli.displays import screen
from scara_effmass.codes import Reason
from scara_effmass.safety import unknown_contact
from scara_effmass.values import Impact, SeriesStatistics, Verdict
from test.decisions import decision_on
from test.forked import Forked
from test.nodes.conftest import NodeHarness, joint_state

S = 1_000_000_000
PAIR = (0.0, 0.0)
SERIES = SeriesStatistics(
    1, *(0.9, 1e5, 0.0, 1.0), 0, 1.0, PAIR, 1.0, PAIR, 0.1, 0.5, PAIR, 0.0, 0, accepted=True, decidable=True, reason=""
)
SIZES = [(80, 24), (120, 40), (200, 50), (50, 24)]
BLOCKS = 5
"""Rows of a large letter, at least."""


def status(verdict: Verdict, reason: str = "", speed: float = 0.325, code: Reason = Reason.STATED) -> CellStatus:
    status = CellStatus(0)
    status.timeout_ns = S
    contacts = [
        unknown_contact(name, reason, code)._replace(
            verdict=own, speed=state_speed, allowable_speed=1.204, margin=1.204 - state_speed, effective_mass=2.77
        )
        for name, own, state_speed in (("elbow", Verdict.OK, 0.1), ("tool", verdict, speed))
    ]
    status.take_decision(decision_on(*contacts), 3 * S)
    return status


def lines(status: CellStatus, now_ns: int, width: int = 80, height: int = 24, block: str = "█") -> list[str]:
    with Path(os.devnull).open("w", encoding="utf-8") as sink:
        console = Console(record=True, file=sink, width=width, height=height, color_system=None)
        console.print(screen(status, now_ns, "/cell", width, height, block))
        return console.export_text().splitlines()


@pytest.mark.parametrize(("width", "height"), SIZES)
@pytest.mark.parametrize("verdict", list(Verdict))
def test_screen_fits_and_has_word_and_figures_in_blocks(verdict: Verdict, width: int, height: int) -> None:
    shown = lines(status(verdict, "because"), 4 * S, width, height)
    assert max(map(len, shown)) <= width
    assert len(shown) <= height
    seconds = 4 if verdict is Verdict.UNKNOWN else 1  # UNKNOWN since the start
    text = "OK for 1 s" if verdict is Verdict.OK else f"{verdict.name} at tool for {seconds} s"
    word = [line.strip() for line in shown].index(text)
    assert sum("█" in line for line in shown[:word]) >= BLOCKS
    assert sum("█" in line for line in shown[word:]) >= (2 if verdict is Verdict.UNKNOWN else BLOCKS)


@pytest.mark.parametrize("verdict", list(Verdict))
def test_small_terminal_shows_the_verdict_first(verdict: Verdict) -> None:
    shown = lines(status(verdict, "because"), 4 * S, 10, 3)
    assert shown[0].split()[0] == verdict.name
    assert "█" not in " ".join(shown)


def test_letters_of_an_ascii_terminal_are_ascii() -> None:
    shown = "\n".join(lines(status(Verdict.OK), 4 * S, block="#"))
    assert shown.isascii()
    assert shown.count("#") > 100


def test_unknown_shares_no_line_with_ok_and_shows_no_number() -> None:
    """Without colours: the words, the hatching and the dashes."""
    unknown = lines(status(Verdict.UNKNOWN, "the joint state is 3.1 s old", code=Reason.OLD_STAMP), 4 * S)
    ok = lines(status(Verdict.OK), 4 * S)
    assert not {line for line in unknown[1:] if line.strip()} & {line for line in ok if "OK" in line or "█" in line}
    assert not any(re.search(r"\bOK\b", line) for line in unknown)
    assert any(line.startswith("? ? ? ?") for line in unknown)
    assert "remedy: synchronize the clocks" in " ".join(unknown)
    assert not any("0.325" in line or "1.204" in line for line in unknown)


def test_worst_contact_point_is_named_and_comes_first() -> None:
    cell = CellStatus(0)
    cell.timeout_ns = S
    verdicts = {"tool": Verdict.OK, "elbow": Verdict.WARN, "rim": Verdict.VIOLATION, "flange": Verdict.VIOLATION}
    contacts = []
    for place, (name, verdict) in enumerate(verdicts.items()):
        speed, allowed = 1.0 + 0.1 * place, 0.9 + 0.1 * (verdict is Verdict.OK)
        contact = unknown_contact(name, f"of {name}")._replace(verdict=verdict, speed=speed)
        contacts.append(contact._replace(allowable_speed=allowed, margin=allowed - speed))
    cell.take_decision(decision_on(*contacts), 3 * S)
    shown = lines(cell, 4 * S, 120, 40)
    assert "VIOLATION at flange for 1 s" in [line.strip() for line in shown]
    assert "of flange" in shown
    rows = [line.split()[:2] for line in shown if line.split()[:1] and line.split()[0] in verdicts]
    assert rows == [["flange", "VIOLATION"], ["rim", "VIOLATION"], ["elbow", "WARN"], ["tool", "OK"]]
    cell.take_decision(decision_on(unknown_contact("tool", "no joint state"), *contacts[1:]), 3 * S)
    shown = lines(cell, 4 * S, 120, 40)
    assert "UNKNOWN at tool for 1 s" in [line.strip() for line in shown]
    assert not any(re.search(r"OK|WARN|VIOLATION", line) for line in shown if "before:" not in line)


def test_contacts_for_which_a_terminal_has_no_row_are_counted() -> None:
    cell = CellStatus(0)
    cell.timeout_ns = S
    contact = unknown_contact("", "")._replace(
        verdict=Verdict.OK, speed=0.1, allowable_speed=1.2, margin=1.1, effective_mass=1000.0, mass_capped=True
    )
    cell.take_decision(decision_on(*(contact._replace(contact_point=f"link {i}") for i in range(12))), 3 * S)
    for height in (24, 40):
        shown = lines(cell, 4 * S, 80, height)
        rows = [line for line in shown if line.startswith("link ")]
        assert len(shown) <= height
        assert all(">=1000" in row for row in rows)
        assert ([line.strip() for line in shown if "more" in line] or ["and 0 more"]) == [f"and {12 - len(rows)} more"]


def test_silence_and_a_missing_monitor_turn_an_ok_screen_to_unknown() -> None:
    cell = status(Verdict.OK)
    cell.update(3 * S + S + 1)
    assert "the monitor is silent: no contact states for 1.0 s" in lines(cell, 4 * S + 1)
    cell.take_publisher(S, exists=False)
    cell.update(5 * S)
    text = " ".join(lines(cell, 5 * S))
    assert "no monitor: contact_states has no publisher" in text
    assert "remedy: check that a monitor runs in this namespace and ROS domain" in text


def test_screen_shows_impact_past_episode_and_simulation() -> None:
    cell = status(Verdict.VIOLATION, "0.4 m/s is above", 1.4)
    assert cell.decision is not None
    cell.take_decision(
        decision_on(*(contact._replace(verdict=Verdict.OK) for contact in cell.decision.contacts)), 4 * S
    )
    cell.take_impact(Impact(S, "cell", 123.4, *(2e-3, 0.3, 0.0, False, False, 0, 0.0, 0.1, 1e-4, "t", True)), 4 * S)
    cell.impacts[-1].left_out = "no contact state"
    assert "123.4 N, 2 s ago, not predicted: no contact state" in " ".join(lines(cell, 6 * S, 120, 40))
    text = " ".join(lines(cell, 6 * S, 120, 40))
    assert "before: VIOLATION until 2 s ago, for 1.00 s: tool: 0.4 m/s is above" in text
    assert "last impact: peak 123.4 N, 2 s ago" in text
    numbers = (80.0, 123.4, 0.0, 0.5, 0.25, True, "lower_leg", 212.0, 260.0, True, SERIES)
    cell.take_validation(Validation(S, *numbers, held_force=150.0, held_limit=130.0, held_region="lower_leg"))
    text = " ".join(lines(cell, 6 * S, 120, 40))
    assert "predicted 80.0 N; converted 212.0 N on lower_leg, below its limit of 260.0 N;" in text
    assert "held 150.0 N on lower_leg, ABOVE its limit of 130.0 N" in " ".join(text.split())
    assert "SIMULATED: force" in text
    loaded = cell.impacts[-1].impact._replace(load_force=60.0, held_force=30.0, clipped=True)
    cell.take_impact(loaded, 6 * S)
    text = " ".join(lines(cell, 6 * S, 120, 40))
    assert "last impact: peak 123.4 N at least on a load of 60.0 N, held 30.0 N, 0 s ago" in text
    cell.take_impact(loaded._replace(source="NI 9230, AC coupling"), 6 * S)
    assert "held 30.0 N at least, 0 s ago" in " ".join(lines(cell, 6 * S, 120, 40))


def test_impact_is_shown_with_the_force_on_the_region_that_its_limit_is_for() -> None:
    cell, none = status(Verdict.OK), (0.0, 0.0)
    series = SeriesStatistics(
        1, *(0.9, 1e5, 0.0, 1.0), 0, 1.0, none, 1.0, none, 0.1, 0.5, none, 0.0, *(1, False, False, "")
    )
    numbers = 250.0, 291.0, -0.1, 2.0, 0.25, False
    for number, (force, limit, is_above, words) in enumerate(
        [
            (225.32, 260.0, False, "converted 225.4 N on chest, below its limit of 260.0 N"),
            (301.2, 260.0, True, "converted 301.2 N on chest, ABOVE its limit of 260.0 N"),
        ]
    ):
        cell.take_impact(
            Impact(number, "cell", 291.0, *(2e-3, 0.3, 0.0, False, False, 0, 0.0, 0.1, 1e-4, "t", True)), S
        )
        cell.take_validation(Validation(number, *numbers, "chest", force, limit, is_above, series))
        text = " ".join(lines(cell, 6 * S, 160, 40))
        assert f"last impact: peak 291.0 N, 5 s ago, predicted 250.0 N; {words}" in text


def test_watch_refuses_a_pipe(refused: Callable[..., str]) -> None:
    assert "watch: stdout must be a terminal" in refused("watch")


class Screen:
    """`scara-effmass watch` in a pseudo-terminal of 100 x 30."""

    def __init__(self, domain: int, terminal_type: str = "xterm-256color") -> None:
        self._reader, terminal = pty.openpty()
        fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 30, 100, 0, 0))
        environment = {**os.environ, "ROS_DOMAIN_ID": str(domain), "TERM": terminal_type, "COLUMNS": "", "LINES": ""}
        command = [sys.executable, "-m", "scara_effmass", "watch"]
        self.process = Forked(
            command, stdin=terminal, stdout=terminal, stderr=terminal, env=environment, start_new_session=True
        )
        self._terminal = terminal
        self.output = b""

    def read(self) -> str:
        """Return the latest complete picture, without its control sequences."""
        with suppress(OSError):  # the process has ended
            while select.select([self._reader], [], [], 0.0)[0]:
                self.output += os.read(self._reader, 65536)
        pictures = self.output.split(b"\x1b[H")
        text = pictures[-2 if len(pictures) > 1 else -1].decode(errors="replace")
        return re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", text)

    def is_full(self) -> bool:
        """Return whether a write would wait until something is read."""
        return not select.select([], [self._terminal], [], 0.0)[1]

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        os.close(self._reader)
        os.close(self._terminal)


@pytest.fixture
def harness(
    monkeypatch: pytest.MonkeyPatch, reserve_domain: Callable[[], AbstractContextManager[int]], tmp_path: Path
) -> Iterator[NodeHarness]:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with reserve_domain() as domain, closing(NodeHarness(domain, tmp_path)) as harness:
        yield harness


@pytest.mark.live
def test_watch_refuses_a_terminal_that_cannot_move_its_cursor() -> None:
    with closing(Screen(0, "dumb")) as terminal:
        assert terminal.process.wait(60) == 2
        assert terminal.read().startswith("watch: TERM = dumb: must move the cursor; the log of the monitor has")


@pytest.mark.live
def test_watch_turns_unknown_when_the_monitor_is_killed_and_recovers(harness: NodeHarness) -> None:
    words = ("--ros-args", "-p", "timeout:=1.0", "-p", "contact_points:=[tool]")
    with closing(Screen(harness.domain)) as terminal:
        harness.spin_until(lambda: "UNKNOWN for" in terminal.read())
        for _ in range(2):
            process = harness.start(*words)
            send = lambda: harness.send(joint_state())  # noqa: E731
            harness.spin_until(lambda: " OK for " in terminal.read(), repeat=send)
            process.kill()
            process.communicate()
            harness.process = None
            harness.spin_until(lambda: "UNKNOWN at tool" in terminal.read() or "UNKNOWN for" in terminal.read())
            assert "OK" not in terminal.read().replace("UNKNOWN", "")
        os.kill(terminal.process.pid, 2)
        assert terminal.process.wait(20) == 130


@pytest.mark.live
def test_watch_ends_by_a_signal_while_its_terminal_stands_still(harness: NodeHarness) -> None:
    with closing(Screen(harness.domain)) as terminal:
        harness.spin_until(terminal.is_full)  # as after Ctrl-S: nobody reads
        os.kill(terminal.process.pid, signal.SIGTERM)
        assert terminal.process.wait(20) == 128 + signal.SIGTERM


def test_live_line_shows_no_speed_and_no_mass_while_they_are_unknown() -> None:
    text = StringIO()
    console = Console(file=text, width=80)
    with live_status(console, visible=True) as show:
        show(decision_on(unknown_contact("tool", "stale")), 1.5)
    assert " ".join(text.getvalue().split()) == "1.5 s tool: -.--- of 0.000 m/s, - kg UNKNOWN scaling 0.00"

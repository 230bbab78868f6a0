"""The command line. The module of a command is imported when the command is called."""

from __future__ import annotations

import argparse
import os
import signal
import sys
from importlib import import_module
from typing import TYPE_CHECKING, NoReturn

from scara_effmass import __version__
from scara_effmass.errors import EffmassError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from types import FrameType

COMMANDS = {
    "demo": "run all nodes on the simulated cell, or on a recording, and show what comes of it",
    "monitor": "run the live monitor node",
    "daq": "run the force node: an NI-9230, a recording, or simulated force",
    "validator": "run the node that holds impacts against their predictions",
    "sim": "run the simulated cell's robot",
    "import": "convert force from CSV and TDMS files and from wrench topics to a bag",
    "replay": "play a bag into the live nodes, with /clock",
    "record": "record live topics into a bag that survives a crash; complete one that was killed",
    "assess": "assess every joint state of bags, offline, into a table or a bag",
    "validate": "hold measured impacts against their predictions, offline, and write a report",
    "figures": "draw the paper's figures anew, and compare its numbers",
    "campaign": "simulate the paper's impact experiment, and record it as bags",
    "limits": "print the body-region table, and the speeds it allows",
    "doctor": "tell what is installed and whether a robot model is sound",
}
ALIASES = {"bench": "sim"}
"""Former names of commands, still accepted."""

MODULES = {"import": "import_force"}
"""Modules of commands whose name is a Python keyword."""

BROKEN_PIPE, INPUT_ERROR, INTERRUPTED, TERMINATED = 1, 2, 130, 143
"""Exit codes: the first as rich has it, the last two as a shell gives them to a process that a signal ended."""


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        """Print one line and exit, as for all other invalid input."""
        self.exit(INPUT_ERROR, f"{self.prog}: {message} (see --help)\n")


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: 0, 1 (the answer is no), 2 (bad input), 130 (interrupted)."""
    arguments, ros_arguments = _split(sys.argv[1:] if argv is None else argv)
    arguments[:1] = [ALIASES.get(name, name) for name in arguments[:1]]
    parser = _parser(arguments)
    parsed = parser.parse_args(arguments)
    if "run" not in parsed:
        parser.print_help()
        return INPUT_ERROR
    if "ros_arguments" in parsed:
        parsed.ros_arguments = ros_arguments
    elif ros_arguments:
        parser.error(f"{ros_arguments[0]}: this command takes no ROS arguments")
    before = signal.signal(signal.SIGTERM, _terminate)
    try:
        code: int = parsed.run(parsed)
        sys.stdout.flush()
    except EffmassError as error:
        print(error, file=sys.stderr)  # noqa: T201 - the one line for every refusal
        return INPUT_ERROR
    except KeyboardInterrupt:
        return INTERRUPTED
    except BrokenPipeError:
        # The buffer has no reader: without this the interpreter reports a broken pipe at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    finally:
        signal.signal(signal.SIGTERM, before)
    return code


def _terminate(_signal: int, _frame: FrameType | None) -> NoReturn:
    """Raise SystemExit, so that unfinished files are removed and child processes end."""
    sys.exit(TERMINATED)


def _split(argv: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the arguments of the command and those of ROS, which follow `--` or start at `--ros-args`."""
    words = list(argv)
    at = next((index for index, word in enumerate(words) if word in {"--", "--ros-args"}), len(words))
    rest = words[at + 1 :] if words[at : at + 1] == ["--"] else words[at:]
    return words[:at], rest if not rest or "--ros-args" in rest else ["--ros-args", *rest]


def _parser(arguments: list[str]) -> argparse.ArgumentParser:
    parser = _Parser(
        prog="scara-effmass",
        description="Assess a robot's effective mass by ISO/TS 15066, measure impacts, and validate the predictions.",
        epilog="'scara-effmass COMMAND --help' gives a command's options and examples. Bad input exits with 2.",
    )
    parser.add_argument("--version", action="version", version=f"scara-effmass {__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", parser_class=_Parser)
    for name, summary in COMMANDS.items():
        command = commands.add_parser(
            name, help=summary, description=summary, formatter_class=argparse.RawDescriptionHelpFormatter
        )
        if name in arguments:
            import_module(f"scara_effmass.cli.{MODULES.get(name, name)}").add_to(command)
    return parser

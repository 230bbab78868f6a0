"""Command line. The module of a command is imported only when the command runs."""

import argparse
import os
import signal
import sys
from collections.abc import Sequence
from importlib import import_module
from types import FrameType
from typing import NoReturn

from scara_effmass import __version__
from scara_effmass.errors import EffmassError

COMMANDS = {
    "demo": "run all nodes on the simulated cell or on a recording, and write a report",
    "monitor": "run the live monitor node",
    "daq": "run the force node: an NI-9230, a recording, or simulated force",
    "validator": "run the node that compares impacts with their predictions",
    "sim": "run the robot of the simulated cell",
    "import": "convert force from CSV and TDMS files and from wrench topics to a bag",
    "replay": "replay a bag to the live nodes, with /clock",
    "record": "record live topics to a bag that survives a crash; repair a bag",
    "assess": "assess every joint state of bags offline; write a table or a bag",
    "validate": "compare measured impacts with their predictions offline; write a report",
    "figures": "draw the figures of the paper again and compare its numbers",
    "campaign": "simulate the impact experiment of the paper and record it to bags",
    "limits": "print the body-region limits and the allowable speeds",
    "doctor": "check the installation, the DAQ device and a robot model",
}
ALIASES = {"bench": "sim"}
"""Former names of commands, still accepted."""

MODULES = {"import": "import_force"}
"""Modules of commands whose name is a Python keyword."""

BROKEN_PIPE, INPUT_ERROR, INTERRUPTED, TERMINATED = 1, 2, 130, 143
"""Exit codes; 130 and 143 are what a shell reports after SIGINT and SIGTERM."""


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        """Print one line and exit, as for all other invalid input."""
        self.exit(INPUT_ERROR, f"{self.prog}: {message} (see --help)\n")


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: 0, 1 (negative result), 2 (invalid input), 130 (interrupted)."""
    arguments, ros_arguments = _split(sys.argv[1:] if argv is None else list(argv))
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
    previous_handler = signal.signal(signal.SIGTERM, _terminate)
    try:
        code: int = parsed.run(parsed)
        sys.stdout.flush()
    except EffmassError as error:
        print(error, file=sys.stderr)  # noqa: T201 - the only error output
        return INPUT_ERROR
    except KeyboardInterrupt:
        return INTERRUPTED
    except BrokenPipeError:
        # Otherwise the interpreter reports the broken pipe again at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    finally:
        signal.signal(signal.SIGTERM, previous_handler)
    return code


def _terminate(_signal: int, _frame: FrameType | None) -> NoReturn:
    """Raise SystemExit, so that unfinished files are removed and child processes end."""
    sys.exit(TERMINATED)


def _split(argv: list[str]) -> tuple[list[str], list[str]]:
    """Return the arguments of the command and those of ROS, which follow `--` or start at `--ros-args`."""
    start = next((index for index, argument in enumerate(argv) if argument in {"--", "--ros-args"}), len(argv))
    ros_arguments = list(argv[start + 1 :] if argv[start : start + 1] == ["--"] else argv[start:])
    if ros_arguments and "--ros-args" not in ros_arguments:
        ros_arguments.insert(0, "--ros-args")
    return list(argv[:start]), ros_arguments


def _parser(arguments: list[str]) -> argparse.ArgumentParser:
    parser = _Parser(
        prog="scara-effmass",
        description="Assess a robot's effective mass by ISO/TS 15066, measure impacts, and validate the predictions.",
        epilog="'scara-effmass COMMAND --help' gives a command's options and examples. Invalid input exits with 2.",
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

# SPDX-License-Identifier: Apache-2.0
"""Command line. The module of a command is imported only when the command runs."""

import argparse
import contextvars
import os
import signal
import sys
from collections.abc import Sequence
from functools import cache
from importlib import import_module
from io import BufferedWriter, FileIO, TextIOWrapper
from pkgutil import resolve_name
from textwrap import fill
from types import FrameType
from typing import Any, NoReturn

from scara_effmass import __version__
from scara_effmass.cli.commands import COMMANDS, GROUPS, HELP, check_options
from scara_effmass.cli.options import inputs_of
from scara_effmass.errors import EffmassError
from scara_effmass.extras import missing_extra
from scara_effmass.input_files import protect_inputs

PURPOSE = "Assess a robot's effective mass by ISO/TS 15066, measure impacts, and validate the predictions."
BROKEN_PIPE, INPUT_ERROR, INTERRUPTED, TERMINATED = 1, 2, 130, 143
"""Exit codes; 130 and 143 are what a shell reports after SIGINT and SIGTERM."""
STDOUT = "stdout"
NAME_WIDTH = 14
LIST_INDENT = NAME_WIDTH + 3
"""Columns of the list of commands."""


class _HelpFormatter(argparse.RawDescriptionHelpFormatter):
    def _fill_text(self, text: str, width: int, indent: str) -> str:  # noqa: ARG002 - as the base class
        """Wrap paragraphs to the terminal, and lists of commands below their texts; keep examples."""
        filled = []
        for paragraph in text.strip().split("\n\n"):
            lines = paragraph.splitlines()
            if any(line.startswith(" ") for line in lines):
                lines = [line if "scara-effmass " in line else _wrapped(line, width, LIST_INDENT) for line in lines]
            else:
                lines = [_wrapped(" ".join(lines), width)]
            filled.append("\n".join(lines))
        return "\n\n".join(filled)


def _wrapped(text: str, width: int, indent: int = 0) -> str:
    return fill(text, width, subsequent_indent=" " * indent, break_long_words=False, break_on_hyphens=False)


class _Parser(argparse.ArgumentParser):
    def __init__(self, **keywords: Any) -> None:  # noqa: ANN401 - as ArgumentParser
        """Refuse abbreviated options, which would change their meaning when an option is added."""
        super().__init__(allow_abbrev=False, **keywords)

    def error(self, message: str) -> NoReturn:
        """Print one line and exit, as for all other invalid input."""
        self.exit(INPUT_ERROR, f"{self.prog}: {message} (see --help)\n")


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: 0, 1 (negative result), 2 (invalid input), 130 (interrupted)."""
    try:
        code = _parse_and_run(argv)
        sys.stdout.flush()
    except (EffmassError, KeyboardInterrupt, OSError, MemoryError) as error:
        line, code = _explained(error)
        if line:
            print(line, file=sys.stderr)  # noqa: T201 - the only error output
    return code


def _parse_and_run(argv: Sequence[str] | None) -> int:
    _keep_stdout()
    arguments, ros_arguments = _split(sys.argv[1:] if argv is None else list(argv))
    parser = make_parser()
    if "_ARGCOMPLETE" in os.environ:
        import_module("argcomplete").autocomplete(parser)  # ends the process
    try:
        parsed, unknown = parser.parse_known_args(arguments, argparse.Namespace(ros_arguments=ros_arguments))
    except SystemExit:
        sys.stdout.flush()  # the help
        raise
    name = parsed.command
    if unknown:
        parser.error(f"unrecognized arguments: {' '.join(unknown)}{_similar_option(name, unknown[0])}")
    if name is None:
        parser.print_help()
        return INPUT_ERROR
    if ros_arguments and not COMMANDS[name].takes_ros_arguments:
        parser.error(f"{ros_arguments[0]}: this command takes no ROS arguments")
    previous_handler = signal.signal(signal.SIGTERM, _terminate)
    try:
        return contextvars.copy_context().run(_run, parsed)
    finally:
        signal.signal(signal.SIGTERM, previous_handler)


def _similar_option(command: str | None, argument: str) -> str:
    """Return which option of the command ends like an unknown one, as --force-topic does for --topic; else nothing."""
    names = COMMANDS[command].options if command else ()
    end = argument.partition("=")[0].removeprefix("-")
    return next((f"; use {name}" for name in names if end.startswith("-") and name.endswith(end)), "")


def _is_interrupted(error: BaseException | None) -> bool:
    """Return whether `error` is Ctrl-C, or followed from it: shutil.rmtree then closes a descriptor twice."""
    return isinstance(error, KeyboardInterrupt) or (error is not None and _is_interrupted(error.__context__))


def _explained(error: BaseException) -> tuple[str, int]:
    """Return one line and the exit code for an error that is no defect of this program; raises any other one."""
    if isinstance(error, OSError) and error.filename == STDOUT:
        # Otherwise the interpreter reports the failure again at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    if isinstance(error, BrokenPipeError):
        return "", BROKEN_PIPE
    if _is_interrupted(error):
        return "interrupted", INTERRUPTED
    if isinstance(error, MemoryError):
        return "too little memory: state less work, such as fewer --samples", INPUT_ERROR
    if isinstance(error, EffmassError):
        return str(error), INPUT_ERROR
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}", INPUT_ERROR
    raise error


def _run(parsed: argparse.Namespace) -> int:
    """Run a command and return its exit code. Raises EffmassError, also for a missing extra."""
    check_options(parsed)
    protect_inputs(*inputs_of(parsed))
    try:
        code: int = resolve_name(f"scara_effmass.cli.{COMMANDS[parsed.command].function}")(parsed)
    except ModuleNotFoundError as error:
        if line := missing_extra(error):
            raise EffmassError(line) from error
        raise
    return code


def _keep_stdout() -> None:
    """Send what libraries print on stdout to stderr: errors of Fast DDS would mix with the output of `--json`."""
    python = sys.__stdout__
    if python is None or sys.stderr is None or sys.stdout is not python:  # closed, or taken by a caller
        return
    stdout = os.dup(python.fileno())
    os.dup2(2, python.fileno())
    # A name that the encoding of the terminal does not have is escaped, as on stderr.
    raw = _Stdout(stdout, "w")
    sys.stdout = TextIOWrapper(
        BufferedWriter(raw), python.encoding, "backslashreplace", line_buffering=os.isatty(stdout)
    )


class _Stdout(FileIO):
    """Stdout whose errors name it, such as that of a full disk."""

    def write(self, data: Any, /) -> int | None:  # type: ignore[override]  # noqa: ANN401 - as FileIO at run time
        try:
            return super().write(data)
        except OSError as error:
            raise OSError(error.errno, error.strerror, STDOUT) from None


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


@cache
def make_parser() -> argparse.ArgumentParser:
    """Return the parser of all commands."""
    summaries = GROUPS | {name: command.summary for name, command in COMMANDS.items()}
    lists = (
        f"{group}:\n" + "".join(f"  {name:<{NAME_WIDTH}} {summaries[name]}\n" for name in HELP[group]) for group in HELP
    )
    parser = _Parser(
        prog="scara-effmass",
        usage="%(prog)s [-h] [--version] COMMAND ...",
        description="\n".join((PURPOSE, "", *lists)),
        epilog="'scara-effmass COMMAND --help' gives a command's options and examples. Invalid input exits with 2.",
        formatter_class=_HelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"scara-effmass {__version__}")
    # The description lists the commands.
    commands = parser.add_subparsers(prog="scara-effmass", metavar="COMMAND", dest="command", help=argparse.SUPPRESS)
    parsers = {"": commands}
    for name, command in COMMANDS.items():
        first, _, own_name = name.rpartition(" ")
        if first not in parsers:
            parser_of_steps = commands.add_parser(first, description=GROUPS[first])
            parsers[first] = parser_of_steps.add_subparsers(metavar="COMMAND", required=True)
        subparser = parsers[first].add_parser(
            own_name,
            help=command.summary,
            description=command.summary,
            epilog=command.epilog,
            formatter_class=_HelpFormatter,
        )
        subparser.set_defaults(command=name)
        for group in command.groups:
            holder = subparser if len(group) == 1 else subparser.add_mutually_exclusive_group(required=True)
            for option in group:
                holder.add_argument(*option.names, **option.keywords)
    return parser

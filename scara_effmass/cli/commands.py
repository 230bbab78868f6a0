# SPDX-License-Identifier: Apache-2.0
"""The commands: commands.yaml holds their help and options, and the module of a command runs it."""

import argparse
from importlib import import_module
from typing import NamedTuple

from scara_effmass.cli.options import Option, options_of
from scara_effmass.errors import SettingsError
from scara_effmass.input_files import read_table
from scara_effmass.wire.topics import RECORDED


class Command(NamedTuple):
    """Help of one command, its options in groups and by name. Of several options in a group, exactly one is required.

    `needs` has options that have an effect only with one of others; `function` runs the command.
    """

    summary: str
    epilog: str
    groups: tuple[tuple[Option, ...], ...]
    options: dict[str, Option]
    needs: tuple[tuple[Option, tuple[Option, ...]], ...]
    function: str
    takes_ros_arguments: bool


NODES = ("monitor", "daq", "validator", "speed_scaling", "sim", "visualization")
GROUPS = {"protocol": "write, fill in and render a measurement protocol of contact forces"}
"""Help of commands of two words, by the first word."""
HELP = {
    "live": ("demo", *NODES, "replay", "record", "watch", "dashboard", "foxglove"),
    "offline": ("assess", "validate", "impacts", "protocol", "advise", "coverage", "import"),
    "prepare": ("init", "doctor", "limits", "map", "lump", "identify", "completion"),
    "research": ("figures", "campaign", "evidence"),
}
"""Commands by the group under which --help lists them."""


def _commands() -> dict[str, Command]:
    commands = {}
    for name, stated in read_table(__file__, "commands.yaml").items():
        groups: list[tuple[Option, ...]] = []
        for item in stated["options"]:
            groups += [tuple(options_of(*item))] if isinstance(item, list) else zip(options_of(item))
        by_name = {text: option for group in groups for option in group for text in option.names}
        needs = [
            (option, tuple(by_name[text] for text in needed.split()))
            for needed, items in stated.get("needs", {}).items()
            for item in items
            for option in ([by_name[item]] if item in by_name else options_of(item))
        ]
        epilog = stated["epilog"].replace("{recorded}", ", ".join(RECORDED))
        run = stated.get("function", f"{name}:run"), stated.get("ros", False)
        commands[name] = Command(stated["summary"], epilog, tuple(groups), by_name, tuple(needs), *run)
    return commands


COMMANDS = _commands()
"""Commands by name."""


def check_options(args: argparse.Namespace) -> None:
    """Raise SettingsError for a stated option that would have no effect, because the one that it needs is missing."""
    for option, needed in COMMANDS[args.command].needs:
        if option.is_stated(args) and not any(other.is_stated(args) for other in needed):
            value = getattr(args, option.dest)
            values = ", ".join(map(str, value if isinstance(value, list) else [value]))
            stated = option.shown if isinstance(value, bool) else f"{option.shown} = {values}"
            raise SettingsError(f"{stated}: must come with {' or '.join(other.shown for other in needed)}")


def run(args: argparse.Namespace) -> int:
    """Print the script that completes commands and options in a shell: `scara-effmass completion`."""
    print(import_module("argcomplete").shellcode(["scara-effmass"], shell=args.shell))  # noqa: T201
    return 0

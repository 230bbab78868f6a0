# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass completion`."""

import argparse
from importlib import import_module

from scara_effmass.cli.console import printer


def run(args: argparse.Namespace) -> int:
    """Print the script that completes commands and options in a shell."""
    printer().print(import_module("argcomplete").shellcode(["scara-effmass"], shell=args.shell))
    return 0

# SPDX-License-Identifier: Apache-2.0
"""Completion in a shell, and Ctrl-C before a command runs."""

import subprocess
import sys
from pathlib import Path

import pytest

from scara_effmass.cli import main

COMPLETE = """
set -eu
eval "$(python -m scara_effmass completion bash)"
scara-effmass() { python -m scara_effmass "$@"; }
complete -p scara-effmass > /dev/null
COMP_WORDS=({words}) COMP_CWORD=$((${#COMP_WORDS[@]} - 1)) COMP_LINE="{words}" COMP_TYPE=9
COMP_POINT=${#COMP_LINE}
_python_argcomplete scara-effmass
printf "%s\\n" "${COMPREPLY[@]}"
"""
INTERRUPT = """
import os, signal, sys
class Finder:
    def find_spec(self, name, path, target=None):
        if name == "scara_effmass.cli.commands":
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Finder())
sys.argv = ["scara-effmass", "limits"]
from scara_effmass.__main__ import main
sys.exit(main())
"""


@pytest.mark.live
@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("scara-effmass coverag", ["coverage "]),
        ("scara-effmass limits --regi", ["--region "]),
        ("scara-effmass doctor --model is", ["iso "]),
    ],
)
def test_bash_completes_commands_options_and_choices(words: str, expected: list[str]) -> None:
    path = f"{Path(sys.executable).parent}:/usr/bin:/bin"
    done = subprocess.run(
        ["/bin/bash", "-c", COMPLETE.replace("{words}", words)],
        env={"PATH": path, "HOME": "/"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.stderr, done.returncode) == ("", 0)
    assert [line for line in done.stdout.split("\n") if line] == expected


@pytest.mark.parametrize(("shell", "text"), [("zsh", "#compdef scara-effmass"), ("fish", "complete ")])
def test_scripts_of_other_shells(shell: str, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert text in script
    assert "scara-effmass" in script


@pytest.mark.live
def test_interrupt_during_the_imports_gives_one_line() -> None:
    done = subprocess.run([sys.executable, "-c", INTERRUPT], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "interrupted\n")

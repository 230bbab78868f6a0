# SPDX-License-Identifier: Apache-2.0
"""Every command and every Python example in README and docs runs, offline, in one scratch folder per page.

A block of `sh` or `python` runs in the order of the page, unless a comment `<!-- not run: WHY -->` is above. Every
command of the suite, run or not, must fit the parser. A block of `text` is part of what the block before it printed.
"""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.measured_page import PAGE, write_section
from scara_effmass.cli import main, make_parser
from scara_effmass.cli.commands import COMMANDS

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
FENCE = re.compile(
    r"^(?P<mark><!-- not run: [^\n]+ -->\n)?```(?P<language>\w+)\n(?P<code>.*?)^```$", re.MULTILINE | re.DOTALL
)
SUITE = "scara-effmass "


def blocks(page: Path) -> list[re.Match[str]]:
    return list(FENCE.finditer(page.read_text(encoding="utf-8")))


def lines(code: str) -> list[str]:
    """Return the commands of a block, without line continuations."""
    return code.replace("\\\n", " ").splitlines()


def pages_with(*languages: str) -> list[Path]:
    return [page for page in PAGES if any(b["language"] in languages and not b["mark"] for b in blocks(page))]


@pytest.mark.live  # MuJoCo, and pages with other programs, start processes
@pytest.mark.usefixtures("unrendered")
@pytest.mark.parametrize("page", pages_with("sh", "python"), ids=lambda page: page.stem)
def test_page_runs(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", str(Path(sys.executable).parent), prepend=":")
    monkeypatch.setattr("faulthandler.enable", lambda: None)  # by rclpy; captured stderr has no descriptor
    for name in ("bags", "benchmarks", "config", "examples", "test"):
        (tmp_path / name).symlink_to(ROOT / name)
    output = ""
    for block in blocks(page):
        if block["language"] == "text":
            printed = {" ".join(line.split()) for line in output.splitlines()}
            assert {" ".join(line.split()) for line in block["code"].splitlines()} <= printed
        elif block["language"] in {"sh", "python"} and not block["mark"]:
            run(block["language"], block["code"])
            output = capfd.readouterr().out
    for image in re.findall(rf"\(images/{page.stem}/(.*?)\)", page.read_text(encoding="utf-8")):
        assert (tmp_path / image).is_file()


def run(language: str, code: str) -> None:
    """Run a block; commands of the suite in this process, where their imports cost nothing the second time."""
    if language == "python":
        exec(compile(code, "page", "exec"), {"__name__": "page"})  # noqa: S102 - written by the project
    elif all(line.startswith(SUITE) and ">" not in line for line in lines(code)):
        for line in lines(code):
            arguments = shlex.split(line, comments=True)[1:]
            assert main(arguments) == int("# exits with 1" in line), line
    else:
        subprocess.run(["sh", "-e", "-c", code], check=True)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_command_fits_the_parser_and_runs_or_says_why_not(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for block in blocks(page):
        for line in lines(block["code"]):
            if line.startswith(SUITE):
                parse(line)
    assert re.findall(rf"^ +{SUITE}.*", FENCE.sub("", text), re.MULTILINE) == [], "must be in a block of sh"


@pytest.mark.parametrize("command", ["make faults", "make soak", "make scale"])
def test_a_command_replaces_its_section_of_the_measured_figures_alone(command: str, tmp_path: Path) -> None:
    copy = tmp_path / PAGE.name
    begin, end = f"<!-- written by {command} -->", f"<!-- end of {command} -->"
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(begin)
    text, _, after = rest.partition(end)
    copy.write_text(PAGE.read_text(encoding="utf-8"), encoding="utf-8")
    write_section(command, "new", copy)
    assert copy.read_text(encoding="utf-8") == f"{before}{begin}\n\nnew\n\n{end}{after}"
    write_section(command, text, copy)
    assert copy.read_text(encoding="utf-8") == PAGE.read_text(encoding="utf-8")


def test_a_page_without_the_markers_is_refused(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("<!-- written by make soak -->\n", encoding="utf-8")
    with pytest.raises(ValueError, match="must contain"):
        write_section("make soak", "new", page)


@pytest.mark.parametrize("name", COMMANDS)
def test_examples_of_the_help_fit_the_parser(name: str) -> None:
    for line in COMMANDS[name].epilog.partition("examples:\n")[2].splitlines():
        parse(line.strip().removeprefix('eval "$(').removesuffix(')"'))


def parse(line: str) -> None:
    """Require that the options of a command exist and that their values have the right form."""
    command = re.split(r" (?:--|--ros-args|>|\|)(?: |$)", line.partition("  #")[0])[0]
    try:
        make_parser().parse_args(shlex.split(command, comments=True)[1:])
    except SystemExit as end:
        assert end.code == 0, line  # noqa: PT017

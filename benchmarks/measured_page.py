# SPDX-License-Identifier: Apache-2.0
"""Write the sections of docs/measured.md. Each command owns the text between its two markers."""

from pathlib import Path

PAGE = Path(__file__).parents[1] / "docs" / "measured.md"


def write_section(command: str, text: str, page: Path = PAGE) -> None:
    """Replace the section of `command` by `text`. Raises ValueError unless the page has both markers."""
    begin, end = f"<!-- written by {command} -->\n", f"\n<!-- end of {command} -->"
    before, found, rest = page.read_text(encoding="utf-8").partition(begin)
    _, found_end, after = rest.partition(end)
    if not (found and found_end):
        raise ValueError(f"{page}: must contain {begin.strip()} and {end.strip()}")
    page.write_text(f"{before}{begin}\n{text.strip()}\n{end}{after}", encoding="utf-8")

# SPDX-License-Identifier: Apache-2.0
"""Figures, page and claims are written together and reproducibly; the page is self-contained."""

import json
from html.parser import HTMLParser
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from scara_effmass.errors import OutputError
from scara_effmass.studies.figures import FIGURES, DrawFigure, figure_18, figure_19, make_figure_set
from scara_effmass.studies.runs import FigureInputs

FEW: dict[DrawFigure, str] = {draw: FIGURES[draw] for draw in (figure_18, figure_19)}
FILES = {"figure_18.png", "figure_18.svg", "figure_19.png", "figure_19.svg", "index.html", "claims.json"}


def write_set(
    inputs: FigureInputs, folder: Path, *, overwrite: bool = False, captions: dict[DrawFigure, str] = FEW
) -> dict[str, bytes]:
    make_figure_set(inputs, folder, overwrite=overwrite, advance=lambda: None, captions=captions)
    return {path.name: path.read_bytes() for path in folder.iterdir()}


class Page(HTMLParser):
    """Open tags, addresses, pictures and table rows of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.addresses: list[str] = []
        self.pictures: list[dict[str, str | None]] = []
        self.rows = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        attributes = dict(attrs)
        self.addresses += [value or "" for name, value in attrs if name in {"src", "href", "srcset", "data", "action"}]
        self.rows += tag == "tr"
        if tag == "img":
            self.pictures.append(attributes)
        if tag not in {"meta", "img"}:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_repeated_figure_set_gives_the_same_files(inputs: FigureInputs, tmp_path: Path) -> None:
    first, second = (write_set(inputs, tmp_path / folder) for folder in ("one", "two"))
    assert set(first) == FILES
    assert first == second


def test_page_is_complete_and_self_contained(inputs: FigureInputs, tmp_path: Path) -> None:
    files = write_set(inputs, tmp_path)
    text = files["index.html"].decode()
    page = Page()
    page.feed(text)
    page.close()
    assert page.open == []
    assert [address[:22] for address in page.addresses] == 2 * ["data:image/png;base64,"]
    assert all(picture["alt"] for picture in page.pictures)
    assert "url(" not in text
    assert "@import" not in text
    result = json.loads(files["claims.json"])
    assert page.rows == len(result["claims"]) + 1
    assert result["figures"] == ["figure_18", "figure_19"]
    assert sum(result["counts"].values()) == len(result["claims"])
    assert max(result["closed_form_check"][f"{model}_relative_difference"] for model in ("lumped", "full")) < 1e-9


def test_existing_file_is_replaced_only_with_overwrite(inputs: FigureInputs, tmp_path: Path) -> None:
    (tmp_path / "claims.json").write_text("mine")
    with pytest.raises(OutputError, match=r"claims\.json: already exists"):
        write_set(inputs, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["claims.json"]
    assert (tmp_path / "claims.json").read_text() == "mine"
    assert write_set(inputs, tmp_path, overwrite=True)["claims.json"] != b"mine"


def test_failed_drawing_leaves_no_files(inputs: FigureInputs, tmp_path: Path) -> None:
    def fail(_: FigureInputs) -> Figure:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_set(inputs, tmp_path, captions={**FEW, fail: "Never drawn."})
    assert list(tmp_path.iterdir()) == []

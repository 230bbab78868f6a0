# SPDX-License-Identifier: Apache-2.0
"""Files of a report: self-contained page, figures as PNG and SVG, PDF."""

import json
from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.text import Text

from scara_effmass.analysis.output import write_files
from scara_effmass.analysis.pages import PDF, phrases, print_pdf

DPI = 140


class ReportFigure(NamedTuple):
    """A figure of a report as PNG, which the page embeds, and as SVG."""

    name: str
    title: str
    caption: str
    png: bytes
    svg: bytes

    @property
    def data_uri(self) -> str:
        """PNG as a `data:` URI."""
        return f"data:image/png;base64,{b64encode(self.png).decode('ascii')}"


def report_figure(name: str, title: str, caption: str, figure: Figure, language: str = "en") -> ReportFigure:
    """Return `figure` as PNG and SVG, with its texts in `language`; equal figures give equal bytes.

    The layout is computed once, where `savefig` would compute it twice per format.
    """

    def local(text: str) -> str:
        return "".join(part for part, _ in phrases(text, language))

    title, caption = local(title), local(caption)
    for text in figure.findobj(Text):
        text.set_text("\n".join(local(line) for line in text.get_text().split("\n")))
    png, svg = BytesIO(), BytesIO()
    figure.set_dpi(DPI)
    FigureCanvasAgg(figure).print_png(png)  # type: ignore[no-untyped-call]
    figure.set_layout_engine("none")
    with mpl.rc_context({"svg.hashsalt": "scara_effmass"}):
        FigureCanvasSVG(figure).print_svg(svg, metadata={"Date": None})  # type: ignore[no-untyped-call]
    return ReportFigure(name, title, caption, png.getvalue(), svg.getvalue())


def figure_files(names: Iterable[str]) -> list[str]:
    """Return the file names of the figures `names`."""
    return [f"{name}.{suffix}" for name in names for suffix in ("png", "svg")]


def write_report_files(
    folder: Path,
    texts: Mapping[str, str | bytes | dict[str, Any]],
    figures: Sequence[ReportFigure],
    *,
    overwrite: bool,
    pdf_of: str | None = None,
) -> None:
    """Write `texts` by file name, `figures`, and the page `pdf_of` as PDF into `folder`, all or none.

    A dictionary is written as JSON. Raises OutputError, and ValueError for NaN and infinity, which JSON does not have.
    """
    files: dict[str, bytes] = {}
    for name, text in texts.items():
        if isinstance(text, dict):
            text = json.dumps(text, indent=2, ensure_ascii=False, allow_nan=False) + "\n"  # noqa: PLW2901
        files[name] = text if isinstance(text, bytes) else text.encode()
    if pdf_of:
        files[PDF] = print_pdf(files[pdf_of].decode())
    for figure in figures:
        files |= {f"{figure.name}.png": figure.png, f"{figure.name}.svg": figure.svg}
    write_files(folder, files, overwrite=overwrite)

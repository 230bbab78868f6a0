"""Self-contained HTML reports: pages from the Jinja2 templates in `templates/`, and figures as PNG and SVG."""

from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from scara_effmass.analysis.output import write_files

DPI = 140
_TEMPLATES = Environment(
    loader=FileSystemLoader(Path(__file__).parent / "templates"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    keep_trailing_newline=True,
)


class ReportFigure(NamedTuple):
    """A figure of a report: PNG, which is also part of the page, and SVG."""

    name: str
    title: str
    caption: str
    png: bytes
    svg: bytes

    @property
    def data_uri(self) -> str:
        """PNG as a `data:` address."""
        return f"data:image/png;base64,{b64encode(self.png).decode('ascii')}"


def report_figure(name: str, title: str, caption: str, figure: Figure) -> ReportFigure:
    """Return `figure` as PNG and SVG, byte for byte the same every time.

    The layout is computed once; `savefig` would compute it twice per format.
    """
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
    folder: Path, texts: Mapping[str, str | bytes], figures: Sequence[ReportFigure], *, overwrite: bool
) -> None:
    """Write `texts` by file name and `figures` into `folder`, all or none. Raises OutputError."""
    files = {name: text if isinstance(text, bytes) else text.encode() for name, text in texts.items()}
    for figure in figures:
        files |= {f"{figure.name}.png": figure.png, f"{figure.name}.svg": figure.svg}
    write_files(folder, files, overwrite=overwrite)


def render(template: str, **context: object) -> str:
    """Return the page that `template`, a file in `templates/`, makes of `context`; texts are escaped."""
    return _TEMPLATES.get_template(template).render(context)

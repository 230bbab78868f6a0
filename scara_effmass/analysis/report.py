# SPDX-License-Identifier: Apache-2.0
"""Reports: pages from the Jinja2 templates in `templates/`, figures as PNG and SVG, PDF.

The pages are in the languages of the catalogues beside the templates.
"""

import json
import os
import re
import shutil
import subprocess
from base64 import b64encode
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack
from functools import lru_cache
from io import BytesIO
from itertools import cycle, islice
from operator import attrgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from textwrap import shorten
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
import yaml
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.text import Text
from pydantic import BaseModel

from scara_effmass import __version__
from scara_effmass.analysis.output import atomic_file
from scara_effmass.analysis.summary import iso_time, signed
from scara_effmass.errors import OutputError, writing
from scara_effmass.input_files import digest
from scara_effmass.iso15066 import EDITION, TABLE_HASH
from scara_effmass.settings.loading import flat_fields
from scara_effmass.values import at_least, at_most, speed_texts

TEMPLATES = Path(__file__).parent / "templates"
ENGLISH = "en"
_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(\.\d+)?(e[-+]?\d+)?%?(?!\w)")
PAGE, PDF = "report.html", "report.pdf"
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "msedge")
PRINT_TIMEOUT_S = 120.0
DPI = 140
STYLE: dict[Any, Any] = {
    "font.size": 11.0,
    "axes.titlesize": 11.0,
    "axes.titlelocation": "left",
    "figure.titlesize": 12.0,
    "legend.frameon": False,
    "image.cmap": "cividis",  # readable with colour blindness, and red is visible on all of it
}
styled = mpl.rc_context(STYLE)
"""Decorator of a function that draws."""
ISO_RED = "#D00000"
INK = "#222222"
CYCLE = ("#0072B2", "#E69F00", "#009E73", "#CC79A7")
"""Colour-blind-safe palette of Okabe and Ito."""
MARKERS = "os^D"
MAX_LINE = 180
"""Length of a line in a figure."""
MANY_COLORS = (*CYCLE, "#56B4E9", "#D55E00", "#F0E442", "#999999")


class PageOptions(NamedTuple):
    """How a report is rendered."""

    language: str = ENGLISH
    pdf: bool = False

    def files(self) -> list[str]:
        """Return the names of the files beside the page. Raises OutputError if no browser can print them."""
        return [PDF] if self.pdf and find_browser() else []


ENGLISH_PAGE = PageOptions()


@lru_cache
def catalogue(language: str) -> Mapping[str, str]:
    """Return the texts of `language` by the English ones, with "…" for each number; empty for English."""
    if language == ENGLISH:
        return {}
    texts: dict[str, str] = yaml.safe_load((TEMPLATES / f"{language}.yaml").read_text(encoding="utf-8"))
    return texts


@lru_cache
def patterns(language: str) -> list[tuple[re.Pattern[str], str]]:
    """Return the texts with "{}" for any text without ": ", as patterns, and those of `language` as formats."""
    found = []
    for english, text in catalogue(language).items():
        if "{}" in english:
            parts = "((?:(?!: ).)*?)".join(map(re.escape, english.split("{}")))
            found.append((re.compile(parts), text))
    return found


def translated(text: str, language: str) -> str | None:
    """Return `text` in `language`, its numbers in the same order, or None if the catalogue lacks it.

    What stands in brackets behind a text that the catalogue has is translated if it has that, too.
    """
    if language == ENGLISH:
        return text
    known = None if "…" in text else catalogue(language).get(_NUMBER.sub("…", text))
    if known is not None:
        numbers = (match.group() for match in _NUMBER.finditer(text))
        return re.sub("…", lambda _: next(numbers), known)
    for pattern, known in patterns(language):
        if match := pattern.fullmatch(text):
            return known.format(*(translated(part, language) or part for part in match.groups()))
    head, _, bracket = text.removesuffix(")").rpartition(" (")
    before = translated(head, language) if bracket and text.endswith(")") else None
    return None if before is None else f"{before} ({translated(bracket, language) or bracket})"


def phrases(text: str, language: str) -> Iterator[tuple[str, bool]]:
    """Yield the parts of `text` in `language`, and whether the catalogue has each of them.

    A text that the catalogue lacks as a whole is split at " · ", else at ": " or "; " behind a part that it has.
    """
    whole = translated(text, language)
    if whole is not None or not text:
        yield whole or "", True
        return
    for separator in (" · ", ": ", "; "):
        head, is_split, tail = text.partition(separator)
        if is_split and (separator == " · " or translated(head, language) is not None):
            yield from phrases(head, language)
            yield separator, True
            yield from phrases(tail, language)
            return
    yield text, False


@lru_cache
def environment(language: str) -> Environment:
    """Return the Jinja2 environment of a language."""

    def t(text: str) -> str:
        """Return a text from the code; parts that the catalogue lacks are marked as English."""
        english = Markup('<span lang="en">{}</span>')
        return Markup().join(part if is_known else english.format(part) for part, is_known in phrases(text, language))

    made = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        extensions=["jinja2.ext.i18n"],
    )
    made.install_gettext_callables(  # type: ignore[attr-defined]  # by the extension
        lambda text: catalogue(language).get(text, text), lambda *texts: texts[0], newstyle=True
    )
    made.globals |= {"language": language, "version": __version__, "edition": EDITION, "limits_hash": TABLE_HASH}
    made.filters |= {
        "t": t,
        "iso_time": time,
        "css": css_string,
        "capital": lambda text: text[:1].upper() + text[1:],
        "percent": lambda share: f"{share:.1%}",
        "at_least": at_least,
        "at_most": at_most,
        "speed_texts": speed_texts,
        "signed": signed,
    }
    return made


def render(template: str, language: str = ENGLISH, **context: object) -> str:
    """Return the page that `template`, a file in `templates/`, makes of `context`; texts are escaped."""
    return environment(language).get_template(template).render(context)


def time(stamp_ns: int) -> Markup:
    """Return a ROS time [ns] as an element of a page."""
    return Markup("<time>{}</time>").format(iso_time(stamp_ns))


def css_string(text: str) -> Markup:
    """Return `text` as a CSS string for a style element."""
    escaped = re.sub(r'["\\\\<>&\n]', lambda match: f"\\{ord(match.group()):x} ", text)
    return Markup(f'"{escaped}"')  # noqa: S704 - escaped for CSS


def setting_rows(
    section: str, settings: BaseModel, chosen: Iterable[str] | None = None, *, changed_only: bool = False
) -> Iterator[tuple[str, object, str]]:
    """Yield name, value and description of the settings whose names contain one of `chosen`, or of all."""
    for name, field in flat_fields(type(settings)).items():
        value = attrgetter(name)(settings)
        is_chosen = chosen is None or any(part in name for part in chosen)
        if is_chosen and not (changed_only and value == field.default):
            text = getattr(value, "value", value)
            if isinstance(text, tuple):
                text = ", ".join(map(str, text))
            yield f"{section}: {name}", str(text).lower() if isinstance(text, bool) else text, field.description or ""


def file_hashes(paths: Iterable[Path]) -> list[tuple[str, str]]:
    """Return path and SHA-256 of each of `paths` that is a file or folder. Raises OutputError."""
    return [(str(path), digest(path, OutputError)) for path in dict.fromkeys(paths) if path.is_file() or path.is_dir()]


def find_browser() -> str:
    """Return the browser that prints PDF. Raises OutputError if there is none."""
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        raise OutputError("--pdf: needs Chromium or Chrome on the PATH; without one, print report.html from a browser")
    return browser


def print_pdf(page: str) -> bytes:
    """Return a page as PDF. Raises OutputError."""
    browser = find_browser()
    with TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "page.html").write_text(page, encoding="utf-8")
        command = [browser, "--headless", "--disable-gpu", "--no-first-run", f"--user-data-dir={folder / 'profile'}"]
        if os.geteuid() == 0:  # Chromium has no sandbox for root
            command.append("--no-sandbox")
        command += ["--no-pdf-header-footer", f"--print-to-pdf={folder / PDF}", (folder / "page.html").as_uri()]
        try:
            subprocess.run(command, capture_output=True, timeout=PRINT_TIMEOUT_S, check=False)  # noqa: S603
            return (folder / PDF).read_bytes()
        except (OSError, subprocess.TimeoutExpired):
            raise OutputError(f"--pdf: {browser} printed no page") from None


def distinct_colors(count: int) -> list[str]:
    """Return `count` colours: colour-blind-safe ones for up to 8; beyond 20 they repeat."""
    colors = MANY_COLORS if count <= len(MANY_COLORS) else mpl.color_sequences["tab20"]
    return [to_hex(color) for color in islice(cycle(colors), count)]


def figure_text(text: str) -> str:
    """Return the name of a file, robot or configuration for Matplotlib: in UTF-8, with `$` escaped."""
    return text.encode(errors="replace").decode().replace("$", r"\$")


def new_figure(width: float, height: float, title: str) -> Figure:
    """Return an empty figure of `width` by `height` [inch], for a function that is `styled`."""
    figure = Figure(figsize=(width, height), layout="compressed")
    FigureCanvasAgg(figure)
    figure.suptitle(title, x=0.01, ha="left", fontweight="bold")
    return figure


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

    Lines of texts are cut at `MAX_LINE`.
    The layout is computed once, where `savefig` would compute it twice per format.
    """

    def local(text: str) -> str:
        return "".join(part for part, _ in phrases(text, language))

    title, caption = local(title), local(caption)
    for text in figure.findobj(Text):
        lines = (local(line) for line in text.get_text().split("\n"))
        text.set_text("\n".join(line if len(line) <= MAX_LINE else shorten(line, MAX_LINE) for line in lines))
    png, svg = BytesIO(), BytesIO()
    figure.set_dpi(DPI)
    FigureCanvasAgg(figure).print_png(png)  # type: ignore[no-untyped-call]
    figure.set_layout_engine("none")
    for axes in figure.axes:  # the last digits of the layout vary, and the SVG names its clip paths after them
        axes.set_position(np.round(axes.get_position(original=True).bounds, 6).tolist())
    with mpl.rc_context({"svg.hashsalt": "scara_effmass"}):
        FigureCanvasSVG(figure).print_svg(svg, metadata={"Date": None})  # type: ignore[no-untyped-call]
    return ReportFigure(name, title, caption, png.getvalue(), svg.getvalue())


def figure_files(names: Iterable[str]) -> list[str]:
    """Return the file names of the figures `names`."""
    return [f"{name}.{suffix}" for name in names for suffix in ("png", "svg")]


def write_report_files(
    folder: Path,
    texts: Mapping[str, str | bytes | dict[str, Any]],
    figures: Iterable[ReportFigure] = (),
    options: PageOptions = ENGLISH_PAGE,
    *,
    overwrite: bool,
    former: Iterable[str] = (),
) -> None:
    """Write `texts` by file name, `figures`, and the page as PDF if `options` say so into `folder`, all or none.

    A dictionary is written as JSON. With `overwrite`, those of `former`, and the PDF of a page, that are not
    written are of an earlier run and are removed. Raises OutputError, and ValueError for NaN and infinity, which JSON
    does not have.
    """
    files: dict[str, bytes] = {}
    for name, text in texts.items():
        if isinstance(text, dict):
            text = json.dumps(text, indent=2, ensure_ascii=False, allow_nan=False) + "\n"  # noqa: PLW2901
        files[name] = text if isinstance(text, bytes) else text.encode(errors="replace")  # names of files may be bytes
    if options.pdf:
        files[PDF] = print_pdf(files[PAGE].decode())
    for figure in figures:
        files |= {f"{figure.name}.png": figure.png, f"{figure.name}.svg": figure.svg}
    with ExitStack() as stack:
        for name, content in files.items():
            stack.enter_context(atomic_file(folder / name, overwrite=overwrite)).write_bytes(content)
    earlier = [*former, *([PDF] if PAGE in files else [])]
    for path in (folder / name for name in earlier if overwrite and name not in files):
        with writing(path):
            path.unlink(missing_ok=True)

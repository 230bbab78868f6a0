"""HTML pages of one file that load nothing else, for the screen and for paper."""

from __future__ import annotations

from base64 import b64encode
from html import escape
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #222; background: #fff }
body { max-width: 1150px; margin: 2rem auto; padding: 0 1rem }
h1 { line-height: 1.2 } h2 { margin-top: 2.5rem }
.wide { overflow-x: auto }
table { border-collapse: collapse; font-size: 14px; width: 100% }
th, td { text-align: left; vertical-align: top; padding: .45rem .6rem; border-bottom: 1px solid #ddd }
th { background: #f3f5f8 } td small { display: block; color: #555 }
figure { margin: 2rem 0 } img { max-width: 100%; height: auto } figcaption { color: #444; font-size: 15px }
@media print {
  body { font-size: 12px; max-width: none; margin: 0 } table { font-size: 10px } .wide { overflow: visible }
  figure, tr { break-inside: avoid } h2 { break-after: avoid }
}
"""


class Picture(NamedTuple):
    """A figure's name, what it is called on the page, its caption, and its PNG file."""

    name: str
    title: str
    caption: str
    png: bytes


def document(title: str, body: str, style: str = "") -> str:
    """Return the page around `body`, which is HTML; `title` is text. `style` adds to `STYLE`."""
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(title)}</title>
<style>{STYLE}{style}</style>
</head>
<body>
<h1>{escape(title)}</h1>
{body}
</body>
</html>
"""


def table(heads: Iterable[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table of texts."""
    head = "".join(f"<th>{escape(text)}</th>" for text in heads)
    lines = "\n".join("<tr>" + "".join(f"<td>{escape(text)}</td>" for text in row) + "</tr>" for row in rows)
    return f'<div class="wide"><table>\n<thead><tr>{head}</tr></thead>\n<tbody>\n{lines}\n</tbody></table></div>'


def bullets(lines: Iterable[str]) -> str:
    """Return texts as a list."""
    return "<ul>" + "".join(f"<li>{escape(line)}</li>" for line in lines) + "</ul>"


def figure(picture: Picture) -> str:
    """Return a picture with its caption; its bytes are in the page."""
    data = b64encode(picture.png).decode("ascii")
    title, caption = escape(picture.title), escape(picture.caption)
    return (
        f'<figure id="{picture.name}"><img src="data:image/png;base64,{data}" alt="{title}: {caption}">'
        f"<figcaption><b>{title}</b> {caption}</figcaption></figure>"
    )

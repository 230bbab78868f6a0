"""Self-contained HTML reports from the Jinja2 templates in `templates/`."""

from base64 import b64encode
from pathlib import Path
from typing import NamedTuple

from jinja2 import Environment, FileSystemLoader, StrictUndefined

_TEMPLATES = Environment(
    loader=FileSystemLoader(Path(__file__).parent / "templates"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    keep_trailing_newline=True,
)


class EmbeddedFigure(NamedTuple):
    """A figure whose PNG bytes are part of the page."""

    name: str
    title: str
    caption: str
    png: bytes

    @property
    def data_uri(self) -> str:
        """PNG as a `data:` address."""
        return f"data:image/png;base64,{b64encode(self.png).decode('ascii')}"


def render(template: str, **context: object) -> str:
    """Return the page that `template`, a file in `templates/`, makes of `context`; texts are escaped."""
    return _TEMPLATES.get_template(template).render(context)

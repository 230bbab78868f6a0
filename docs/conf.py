# SPDX-License-Identifier: Apache-2.0
"""Sphinx configuration of `make docs`. The sources are the Markdown files of the tree, so that links work in both."""

import re
from pathlib import Path

import latex2mathml.converter
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError
from sphinx.writers.html5 import HTML5Translator

project = html_title = "scara_effmass"
copyright = "scara_effmass maintainers, Apache-2.0. Advisory software, not a safety function"  # noqa: A001 - of Sphinx
extensions = ["myst_parser"]
root_doc = "docs/index"
include_patterns = ["*.md", "docs/**.md", "bags/README.md", "config/robots/README.md"]
html_theme = "furo"
html_show_sphinx = False
smartquotes = False
html_copy_source = False
html_math_renderer = "mathml"
myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4
suppress_warnings = ["misc.highlighting_failure"]

_LOADED = re.compile(r"<(?:script|link|img|iframe)\b[^>]*\b(?:src|href)=\"?(?:https?:)?//[^\" >]+|@import|url\(\"?http")


def setup(app: Sphinx) -> None:
    """Render formulas as MathML, and refuse pages that load anything from other machines."""
    app.add_html_math_renderer("mathml", (_formula, None), (_formula, None))
    app.connect("build-finished", _finish)


def _formula(translator: HTML5Translator, node: nodes.math | nodes.math_block) -> None:
    display = "inline" if isinstance(node, nodes.math) else "block"
    formula = latex2mathml.converter.convert(node.astext(), display=display)
    translator.body.append(formula if display == "inline" else f'<div style="overflow-x: auto">{formula}</div>')
    raise nodes.SkipNode


def _finish(app: Sphinx, error: Exception | None) -> None:
    site = Path(app.outdir)
    pages = [] if error else [*site.rglob("*.html"), *site.rglob("*.css")]
    for page in pages:
        if found := _LOADED.search(page.read_text(encoding="utf-8")):
            raise ExtensionError(f"{page.relative_to(site)}: {found[0]}: must be a file of the site")
    (site / "index.html").write_text('<meta http-equiv="refresh" content="0; url=docs/index.html">', encoding="utf-8")

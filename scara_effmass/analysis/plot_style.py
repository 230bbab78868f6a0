# SPDX-License-Identifier: Apache-2.0
"""Style of the figures: colours, markers and matplotlib settings."""

from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

STYLE: dict[Any, Any] = {
    "font.size": 11.0,
    "axes.titlesize": 11.0,
    "axes.titlelocation": "left",
    "figure.titlesize": 12.0,
    "legend.frameon": False,
    "image.cmap": "cividis",  # readable with colour blindness, and red is visible on all of it
}
ISO_RED = "#D00000"
INK = "#222222"
CYCLE = ("#0072B2", "#E69F00", "#009E73", "#CC79A7")
"""Colour-blind-safe palette of Okabe and Ito."""
MARKERS = "os^D"


def new_figure(width: float, height: float, title: str) -> Figure:
    """Return an empty figure of `width` by `height` [inch]; create and save it in the rc context `STYLE`."""
    figure = Figure(figsize=(width, height), layout="compressed")
    FigureCanvasAgg(figure)
    figure.suptitle(title, x=0.01, ha="left", fontweight="bold")
    return figure

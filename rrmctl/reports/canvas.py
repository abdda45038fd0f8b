"""How figures look, and how they become files."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Fonts are embedded as outlines a printer and a search understand (Type 42), sizes are those of a paper's captions.
LOOK: Any = {
    "font.size": 8,
    "axes.titlesize": 8.5,
    "axes.labelsize": 8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#DDDDDD",
    "grid.linewidth": 0.5,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "pdf.fonttype": 42,
    "svg.fonttype": "none",
}


def encode(figure: Figure, form: str) -> bytes:
    """The figure as a file's content; `form` is a suffix matplotlib knows. Equal figures give equal bytes."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    FigureCanvasAgg(figure)
    buffer = io.BytesIO()
    undated = {"CreationDate": None} if form == "pdf" else None
    with mpl.rc_context(LOOK):
        figure.savefig(buffer, format=form, dpi=200, metadata=undated)
    return buffer.getvalue()

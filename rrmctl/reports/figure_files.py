"""How figures look, and how they become files."""

from __future__ import annotations

import contextlib
import io
import re
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rrmctl.reports.statistics import Width

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Forms of a file.
FORMS = ("png", "pdf", "svg")

#: Fonts are embedded: in PDF as outlines that a printer and a search understand (Type 42), in SVG as paths.
_LOOK: Any = {
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.7,
    "axes.grid": True,
    "grid.color": "#DDDDDD",
    "grid.linewidth": 0.5,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "pdf.fonttype": 42,
    "svg.fonttype": "path",
    "svg.hashsalt": "rrmctl",  # ids within the file are drawn at random otherwise
}
#: Points: those of captions, so that a figure is legible where it is put in at its own size.
TEXT: dict[Width, float] = {"column": 7.0, "page": 8.0}
#: Inches.
WIDEST: dict[Width, float] = {"column": 3.3, "page": 7.0}


def look(width: Width | None = None) -> AbstractContextManager[None]:
    """Inside of it matplotlib has our settings, for a figure of this width, whatever the user's are."""
    with contextlib.chdir(Path(__file__).parent):  # a matplotlibrc in the working directory need not even be one
        from matplotlib.style import context

    size = TEXT[width] if width else None
    names = ("font.size", "axes.labelsize", "legend.fontsize")
    sizes = dict.fromkeys(names, size) | {"axes.titlesize": size + 0.5} if size else {}
    return context(["default", _LOOK | sizes])


def encode(figure: Figure, form: str, dpi: int = 200) -> bytes:
    """The figure as a file's content; `form` is one of `FORMS`. Equal figures give equal bytes."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    FigureCanvasAgg(figure)
    buffer = io.BytesIO()
    undated = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}.get(form)
    with look():
        figure.savefig(buffer, format=form, dpi=dpi, metadata=undated)
    data = buffer.getvalue()
    return _numbered(data) if form == "svg" else data


def _numbered(svg: bytes) -> bytes:
    """The file with ids by order of appearance: matplotlib digests positions, of which layout varies the last bits."""
    ids: dict[bytes, bytes] = {}
    return re.sub(rb'(?<=["#])[hmp][0-9a-f]{10}(?=[")])', lambda id_: ids.setdefault(id_[0], b"i%d" % len(ids)), svg)

"""The outer form that all figures share: heading, a grid of panels, and below them the legend and the notes."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from rrmctl.reports.figure_files import TEXT, WIDEST, look
from rrmctl.reports.statistics import Width
from rrmctl.reports.styles import LINE, Style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: In font sizes. Long handles, or the marker would hide the gap of a dashed line.
_LEGEND: dict[str, Any] = {"borderaxespad": 0.2, "columnspacing": 1.4, "handlelength": 3.2}
#: Of the width that text may take: on a screen's pixels letters are somewhat wider than on paper.
_FULL = 0.94
_NOTE_SIZE: dict[Width, float] = {"column": 5.5, "page": 6.5}


@dataclass(frozen=True)
class Slot:
    """One panel among equals."""

    title: str
    unit: str  #: of the vertical axis
    fill: Callable[[Axes], None]
    across: str = "Environment steps"  #: the horizontal axis


class Shape(NamedTuple):
    """Panels of a figure."""

    down: int
    across: int
    width: float  #: inches, of the whole figure
    height: float  #: inches, of one panel


def shape(panels: int, width: Width, most: int = 3) -> Shape:
    """Panels in reading order: at most three (or `most`) side by side on a page, two in a column (up to three: one)."""
    if width == "column":
        across = 1 if panels <= 3 else 2
        return Shape(math.ceil(panels / across), across, WIDEST[width], 2.0 if across == 1 else 1.55)
    if panels == 1:
        return Shape(1, 1, 4.6, 3.0)
    across = min(panels, most)
    each = min(WIDEST[width] / 3, WIDEST[width] / across)
    return Shape(math.ceil(panels / across), across, each * across, 1.95)


def cells_sheet(
    heading: str,
    cells: Sequence[Slot],
    *,
    size: Width,
    handles: Mapping[str, Style],
    notes: Iterable[str],
    most: int = 3,
) -> Figure:
    """A figure of equal panels; axes are named where the neighbour's name does not hold."""
    form = shape(len(cells), size, most)
    with sheet(
        heading, [form.height] * form.down, form.across, size=size, width=form.width, handles=handles, notes=notes
    ) as (figure, grid):
        for position, axes in enumerate(itertools.chain(*grid)):
            axes.set_visible(position < len(cells))
            if position >= len(cells):
                continue
            cell, below = cells[position], cells[position + form.across :][:1]
            cell.fill(axes)
            panel_title(axes, cell.title, form.width / form.across, size)
            if not below or below[0].across != cell.across:
                axes.set_xlabel(cell.across)
            if position % form.across == 0 or cells[position - 1].unit != cell.unit:
                axes.set_ylabel(cell.unit)
    return figure


@contextmanager
def sheet(
    heading: str,
    heights: Sequence[float],
    across: int,
    *,
    size: Width,
    width: float,
    handles: Mapping[str, Style],
    notes: Iterable[str],
) -> Iterator[tuple[Figure, list[list[Axes]]]]:
    """An empty figure and its axes [len(heights)][across], to be filled inside the `with`.

    Args:
        heading: above all panels.
        heights: of each row of panels, inches.
        across: panels in a row.
        size: of the letters.
        width: of the figure, inches.
        handles: of the legend, by label.
        notes: sentences for the foot.
    """
    with look(size):
        from matplotlib.figure import Figure
        from matplotlib.lines import Line2D

        point = 1 / 72
        letters = TEXT[size]
        columns = _legend_columns(list(handles), width, letters)
        head = wrapped(heading, letters + 1, width)
        foot = wrapped(" ".join(notes), _NOTE_SIZE[size], width)
        above = sum(heights) + len(head) * 1.3 * (letters + 1) * point
        below = (
            0.12
            + 1.55 * letters * point * math.ceil(len(handles) / columns)
            + 1.38 * _NOTE_SIZE[size] * point * len(foot)
        )
        figure = Figure(figsize=(width, above + below), layout="constrained")
        strips: Any = figure.subfigures(2, 1, height_ratios=(above, below))
        upper, lower = strips
        upper.suptitle("\n".join(head), fontsize=letters + 1)
        grid = upper.subplots(len(heights), across, squeeze=False, gridspec_kw={"height_ratios": heights})
        lines = [Line2D([], [], label=label, **LINE | each._asdict()) for label, each in handles.items()]
        lower.legend(handles=lines, loc="upper center", ncols=columns, **_LEGEND)
        lower.text(0.5, 0.03, "\n".join(foot), ha="center", va="bottom", fontsize=_NOTE_SIZE[size], color="#444444")
        yield figure, grid.tolist()


def panel_title(axes: Axes, text: str, width: float, size: Width) -> None:
    """A title whose lines are broken where they are wider than a panel that has `width` inches with all about it."""
    lines = (part for line in text.splitlines() for part in wrapped(line, TEXT[size] + 0.5, width - 0.3))
    axes.set_title("\n".join(lines))


def wrapped(text: str, letters: float, width: float) -> list[str]:
    """Lines of letters of this many points that fit into `width` inches, save for longer words."""
    lines: list[str] = []
    for word in text.split():
        longer = f"{lines[-1]} {word}" if lines else word
        if lines and _length(longer, letters) <= _FULL * width:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines


def _length(text: str, letters: float) -> float:
    """Inches."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import text_to_path

    wide, _, _ = text_to_path.get_text_width_height_descent(text, FontProperties(size=letters), ismath=False)
    return float(wide) / 72


def _legend_columns(labels: Sequence[str], width: float, letters: float) -> int:
    """As many columns as fit into `width` inches, at a legend of letters of this many points."""
    lengths = [_length(label, letters) for label in labels]
    handle, gap = ((_LEGEND["handlelength"] + 0.8) * letters / 72, _LEGEND["columnspacing"] * letters / 72)
    for columns in range(len(labels), 1, -1):
        rows, longer = divmod(len(labels), columns)  # matplotlib gives its first columns one more
        starts = [column * rows + min(column, longer) for column in range(columns + 1)]
        longest = [max(lengths[start:end]) for start, end in itertools.pairwise(starts)]
        if sum(handle + length + gap for length in longest) <= width:
            return columns
    return 1

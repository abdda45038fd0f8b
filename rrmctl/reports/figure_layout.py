"""The sheet that all figures share: heading, panels, legend, notes; its look, its file, and how notebooks draw it."""

from __future__ import annotations

import contextlib
import io
import itertools
import math
import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from rrmctl.errors import UserError
from rrmctl.reports.report import absent_notes, title
from rrmctl.reports.select import sections
from rrmctl.reports.series import Section
from rrmctl.reports.statistics import Statistics, Width
from rrmctl.reports.styles import Style
from rrmctl.stats import REPLICATES, IqmKind

with contextlib.chdir(Path(__file__).parent):  # a matplotlibrc in the working directory need not even be one
    from matplotlib import rcParams, style
    from matplotlib.axes import Axes
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.font_manager import FontProperties
    from matplotlib.lines import Line2D
    from matplotlib.textpath import text_to_path

__all__ = ["WIDEST", "Axes", "Figure", "Slot", "encode", "from_frames", "one_section", "sheet"]

#: Points: those of captions, so that a figure is legible where it is put in at its own size; and those of notes.
TEXT: dict[Width, tuple[float, float]] = {"column": (7.0, 5.5), "page": (8.0, 6.5)}
#: Inches.
WIDEST: dict[Width, float] = {"column": 3.3, "page": 7.0}
#: Of the width that text may take: on a screen's pixels letters are somewhat wider than on paper.
_FULL = 0.94
#: Our settings of matplotlib, whatever the user's are.
_LOOK: Any = ["default", Path(__file__).with_suffix(".mplstyle")]
#: Inches, of a panel above another.
_ABOVE = 1.4


@dataclass(frozen=True)
class Slot:
    """One panel among equals."""

    title: str
    unit: str  #: of the vertical axis, the upper one's where there are two
    fill: Callable[[Axes], None]
    across: str = "Environment steps"  #: the horizontal axis
    runs: Iterable[tuple[str, int]] = ()  #: method, and number of runs, of each of its lines
    above: Callable[[Axes], None] | None = None  #: fills a small panel on top of it


def sheet(
    section: Section,
    settings: Statistics,
    slots: Sequence[Slot],
    *,
    notes: Iterable[str],
    lacking: str,
    legend: Mapping[str, Style] | None = None,
    most: int = 3,
    height: float | None = None,
) -> Figure:
    """A figure of equal panels in reading order; axes are named where the neighbour's name does not hold.

    Args:
        notes: sentences for the foot; how many of the planned runs the section contains follows them.
        lacking: what there is not ("no ...") where there are no panels.
        legend: entries; default the methods.
        most: panels side by side on a page; a column has one, or two of more than three.
        height: of a panel, inches.
    """
    if not slots:
        raise UserError(
            f"{section.experiment}, profile {section.profile}: {lacking} to draw",
            f"`rrmctl run {section.experiment}` makes runs, `rrmctl plot {section.experiment}` draws what suits them",
        )
    size, (letters, small) = settings.width, TEXT[settings.width]
    if size == "column":
        across = 1 if len(slots) <= 3 else 2
        wide, usual = WIDEST[size] / across, 2.0 if across == 1 else 1.55
    else:
        across = min(len(slots), most)
        wide, usual = (4.6, 3.0) if across == 1 else (WIDEST[size] / max(across, 3), 1.95)
    rows = [slots[start : start + across] for start in range(0, len(slots), across)]
    storeyed = [any(slot.above for slot in row) for row in rows]
    heights = [tall for two in storeyed for tall in (*([_ABOVE] if two else []), height or usual)]
    width, contents = wide * across, [f"{section.contained} of {section.planned} planned runs."]
    contents += [*absent_notes(section, short=True), *section.problems]
    if legend is None:  # methods with the number of runs behind their lines, the fewest and the most
        counts, looks = defaultdict[str, list[int]](list), section.looks()
        for method, runs in itertools.chain(*(slot.runs for slot in slots)):
            counts[method].append(runs)
        ends = {method: dict.fromkeys((min(runs), max(runs))) for method, runs in counts.items()}
        legend = {f"{method} (n = {'–'.join(map(str, n))})": looks[method] for method, n in ends.items()}
    with style.context([*_LOOK, {"font.size": letters, "axes.titlesize": letters + 0.5}]):
        beside = (rcParams["legend.handlelength"] + 0.8 + rcParams["legend.columnspacing"]) * letters / 72
        lengths = [_length(label, letters) + beside for label in legend]
        fit = (n for n in range(len(lengths), 1, -1) if sum(map(max, np.array_split(lengths, n))) <= width)
        columns = next(fit, 1)  # matplotlib splits entries as numpy does
        head, foot = wrapped(title(section), letters + 1, width), wrapped(" ".join([*notes, *contents]), small, width)
        above = sum(heights) + len(head) * 1.3 * (letters + 1) / 72
        below = 0.12 + (1.55 * letters * math.ceil(len(legend) / columns) + 1.38 * small * len(foot)) / 72
        figure = Figure(figsize=(width, above + below), layout="constrained")
        strips: Any = figure.subfigures(2, 1, height_ratios=(above, below))
        upper, lower = strips
        upper.suptitle("\n".join(head), fontsize=letters + 1)
        lines = [Line2D([], [], label=label, **entry._asdict()) for label, entry in legend.items()]
        lower.legend(handles=lines, loc="upper center", ncols=columns)
        lower.text(0.5, 0.03, "\n".join(foot), ha="center", va="bottom", fontsize=small, color="#444444")
        grid = iter(upper.subplots(len(heights), across, squeeze=False, gridspec_kw={"height_ratios": heights}))
        for row, following, two in zip(rows, [*rows[1:], ()], storeyed, strict=True):
            tops, lower_axes = next(grid) if two else (), next(grid)
            for axes in (*tops, *lower_axes[len(row) :]):
                axes.set_visible(False)
            for place, slot in enumerate(row):
                axes = top = lower_axes[place]
                slot.fill(axes)
                if slot.above or place >= len(following) or following[place].across != slot.across:
                    axes.set_xlabel(slot.across)
                if slot.above:
                    top = tops[place]
                    top.set_visible(True)
                    slot.above(top)
                if place == 0 or row[place - 1].unit != slot.unit:
                    top.set_ylabel(slot.unit)
                named = (wrapped(line, letters + 0.5, wide - 0.3) for line in slot.title.splitlines())
                top.set_title("\n".join(itertools.chain(*named)))
    return figure


def from_frames(draw: Callable[[Section, Statistics], Figure]) -> Callable[..., Figure]:
    """The notebook's side of a figure's `draw`."""

    def drawn(
        rows: pd.DataFrame,
        jobs: pd.DataFrame | None = None,
        *,
        kind: IqmKind = "rliable",
        width: Width = "page",
        replicates: int = REPLICATES,
        last: int = 1,
    ) -> Figure:
        return draw(one_section(rows, jobs), Statistics(kind=kind, width=width, replicates=replicates, last=last))

    drawn.__doc__ = f"""{draw.__doc__}
    Args:
        rows: one variant of one experiment, as `rrmctl.store.load` returns it; several are refused.
        jobs: as `rrmctl.store.planned`, to say which runs are missing.
        kind: of interquartile mean.
        width: of the figure: `column` (3.3 inches) or `page` (at most 7).
        replicates: resampled data sets behind intervals, where it has any.
        last: evaluations up to a step, of which a run's score there is the mean.
    """
    return drawn


def one_section(
    rows: pd.DataFrame, jobs: pd.DataFrame | None, deployments: tuple[pd.DataFrame, pd.DataFrame] | None = None
) -> Section:
    """The section of these frames; several are refused."""
    read = sections(rows, jobs, deployments=deployments)
    if len(read) != 1:
        which = ", ".join(f"{section.experiment}/{section.variant}" for section in read) or "none"
        raise UserError(f"a figure shows one variant of one experiment, not {which}", "filter the rows beforehand")
    return read[0]


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
    wide, _, _ = text_to_path.get_text_width_height_descent(text, FontProperties(size=letters), ismath=False)
    return float(wide) / 72


def encode(figure: Figure, form: str, dpi: int = 200) -> bytes:
    """The content of a file of this form: png, pdf or svg. Equal figures give equal bytes."""
    FigureCanvasAgg(figure)
    buffer = io.BytesIO()
    undated = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}.get(form)
    with style.context(_LOOK):
        figure.savefig(buffer, format=form, dpi=dpi, metadata=undated)
    if form != "svg":
        return buffer.getvalue()
    # Ids are counted as they appear: matplotlib digests positions, of which layout varies the last bits.
    ids: dict[bytes, bytes] = {}
    named = rb'(?<=["#])[hmp][0-9a-f]{10}(?=[")])'
    return re.sub(named, lambda id_: ids.setdefault(id_[0], b"i%d" % len(ids)), buffer.getvalue())

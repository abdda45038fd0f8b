"""People and the true return: how often the clip of the higher return is preferred, against how far returns differ.

With returns shown to people and without; what they prefer against the returns is what returns do not tell.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from rrmctl.reports.answers import Answers, answers
from rrmctl.reports.figure_layout import Axes, Figure, Slot, one_section, sheet
from rrmctl.reports.plot_elements import preference_axis
from rrmctl.reports.series import Section
from rrmctl.reports.statistics import DEFAULTS, SURE, Statistics, Width
from rrmctl.reports.styles import Style
from rrmctl.stats.agreement import Bin, binned

if TYPE_CHECKING:
    import pandas as pd

    from rrm.teachers.labels import Label

#: Of answers, at most, and answers in each at least.
_BINS, _FEWEST = 8, 20
_LOOKS = {
    "returns shown": Style("#0072B2", "o", "-", "#0072B2"),
    "returns not shown": Style("#D55E00", "s", (0, (5, 2)), "white"),
}


def suits(section: Section) -> bool:
    """People answered queries of its runs."""
    return bool(section.answered)


def draw(section: Section, settings: Statistics = DEFAULTS, labels: Mapping[str, list[Label]] | None = None) -> Figure:
    """A panel for each task, a line with returns shown and one without."""
    lines = {task: _lines(own) for task, own in answers(section, labels).items()}
    slots = [
        Slot(task, "Prefers higher return (%)", partial(_fill, lines=own), "Difference of the true returns")
        for task, own in lines.items()
        if own
    ]
    count = sum(each.share.n for own in lines.values() for line in own.values() for each in line)
    notes = [
        f"{count} answers. Points: equally many of each line, at the median difference, with {SURE} Wilson intervals. "
        "Ties and skips are left out. Dotted: chance.",
    ]
    legend = {name: look for name, look in _LOOKS.items() if any(name in own for own in lines.values())}
    return sheet(section, settings, slots, notes=notes, lacking="no preferences of people", legend=legend)


def _lines(given: Answers) -> dict[str, list[Bin]]:
    """Of those lines that there are answers for."""
    right, shown = given.right(), given.shown() == 1
    lines = {}
    for name, which in zip(_LOOKS, (shown, ~shown), strict=True):
        known = which & ~np.isnan(right)
        if known.any():
            bins = min(_BINS, max(1, int(known.sum()) // _FEWEST))
            lines[name] = binned(given.differences()[known], right[known], bins)
    return lines


def _fill(axes: Axes, *, lines: Mapping[str, list[Bin]]) -> None:
    for name, bins in lines.items():
        middles = [each.middle for each in bins]
        points, low, high = (
            [100 * float(getattr(each.share, end)) for each in bins] for end in ("estimate", "low", "high")
        )
        axes.plot(middles, points, **_LOOKS[name]._asdict())
        axes.vlines(middles, low, high, color=_LOOKS[name].color, linewidth=0.9)
    axes.set_xlim(left=0)
    preference_axis(axes, min(100 * float(each.share.low) for bins in lines.values() for each in bins))


def preferred_returns(
    rows: pd.DataFrame, labels: Mapping[str, list[Label]], jobs: pd.DataFrame | None = None, *, width: Width = "page"
) -> Figure:
    """The same in a notebook; `labels` as `rrm.teachers.labels.read_labels` returns them, by task."""
    return draw(one_section(rows, jobs), Statistics(width=width), labels)

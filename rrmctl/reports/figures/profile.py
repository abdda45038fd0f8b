"""Performance profiles: the share of the runs that end above a score, for every score, with a bootstrap band.

A method whose line lies above another's everywhere is better whatever score one asks for (Agarwal et al. 2021). The
success tasks are pooled.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from rrmctl.reports.captions import title
from rrmctl.reports.figure_layout import Slot, cells_sheet
from rrmctl.reports.final_scores import FinalScores, last_step, readings
from rrmctl.reports.notebook import FromFrames, nothing
from rrmctl.reports.plot_elements import UNITS, contents, line, score_axis
from rrmctl.reports.series import Section
from rrmctl.reports.statistics import BOOTSTRAP_SEED, DEFAULTS, LEVEL, SURE, Statistics
from rrmctl.reports.styles import Looks
from rrmctl.stats import MIN_RUNS, performance_profile

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Scores at which the shares are taken.
_POINTS = 201


def suits(section: Section) -> bool:
    """At least two methods can be compared that have runs enough for a band."""
    return bool(_cells(section))


def draw(section: Section, settings: Statistics = DEFAULTS) -> Figure:
    """A panel for the success tasks together, and one for each task that is scored by return.

    Raises:
        UserError: no two methods have runs enough.
    """
    cells = _cells(section)
    if not cells:
        raise nothing(section, f"no two methods with {MIN_RUNS} runs each")
    looks = section.looks()
    names = dict.fromkeys(method for cell in cells for method in cell.strata)
    return cells_sheet(
        title(section),
        [Slot(_name(cell), "Runs above it (%)", _filler(cell, looks, settings), UNITS[cell.score]) for cell in cells],
        size=settings.width,
        handles={f"{method} ({_counts(method, cells)})": looks[method] for method in names},
        notes=[
            "Line: share of the runs whose score at the last step is higher. "
            f"Band: {SURE} at each score by itself, bootstrap over seeds, stratified by task.",
            *contents(section),
        ],
    )


def _cells(section: Section) -> list[FinalScores]:
    """Readings with two methods that have runs enough; tasks stand for themselves where pooling would lose a method."""
    found = readings(section, last_step)
    pools = [cell for cell in found if len(cell.panels) > 1 and _complete(cell)]
    pooled = [panel for cell in pools for panel in cell.panels]
    chosen = [cell for cell in found if cell in pools or (len(cell.panels) == 1 and cell.panels[0] not in pooled)]
    return [cell for cell in chosen if sum(_enough(cell, method) for method in cell.strata) > 1]


def _complete(cell: FinalScores) -> bool:
    return all(series.label.method in cell.strata for panel in cell.panels for series in panel.present())


def _enough(cell: FinalScores, method: str) -> bool:
    return min(scores.size for scores in cell.strata[method]) >= MIN_RUNS


def _name(cell: FinalScores) -> str:
    return f"{cell.name}, last step" if cell.read is None else f"{cell.name}, step {cell.read.step:,}"


def _counts(method: str, cells: Sequence[FinalScores]) -> str:
    """Runs behind the method's lines: `n = 30`, or the fewest and the most."""
    runs = [cell.runs(method).size for cell in cells if method in cell.strata]
    return f"n = {'–'.join(map(str, dict.fromkeys((min(runs), max(runs)))))}"


def _filler(cell: FinalScores, looks: Looks, settings: Statistics) -> Callable[[Axes], None]:
    scores = np.concatenate([cell.runs(method) for method in cell.strata])
    low, high = (0.0, 100.0) if cell.score == "success" else (float(scores.min()), float(scores.max()))

    def fill(axes: Axes) -> None:
        thresholds = np.linspace(low, high, _POINTS)
        for position, (method, strata) in enumerate(cell.strata.items()):
            rng = np.random.default_rng(BOOTSTRAP_SEED)
            made = performance_profile(strata, thresholds, rng=rng, replicates=settings.replicates, level=LEVEL)
            look = looks[method]
            line(axes, thresholds, 100 * made.estimate, look, 8 * position, drawstyle="steps-post")
            axes.fill_between(
                thresholds, 100 * made.low, 100 * made.high, step="post", color=look.color, alpha=0.14, linewidth=0
            )
        score_axis(axes, "success")

    return fill


profile = FromFrames(draw)

"""Performance profiles: the share of the runs that end above a score, for every score, with a bootstrap band.

A method whose line lies above another's everywhere is better whatever score one asks for (Agarwal et al. 2021). The
success tasks are pooled.
"""

from __future__ import annotations

import numpy as np

from rrmctl.reports.figure_layout import Axes, Figure, Slot, from_frames, sheet
from rrmctl.reports.plot_elements import UNITS, FinalScores, line, read_at, readings, score_axis
from rrmctl.reports.report import final_notes
from rrmctl.reports.series import Section
from rrmctl.reports.statistics import BOOTSTRAP_SEED, DEFAULTS, LEVEL, SURE, Statistics
from rrmctl.reports.styles import Looks
from rrmctl.stats import MIN_RUNS, common_step, performance_profile

#: Scores at which the shares are taken.
_POINTS = 201


def suits(section: Section) -> bool:
    """At least two methods can be compared that have runs enough for a band."""
    return bool(_readings(section, DEFAULTS))


def draw(section: Section, settings: Statistics = DEFAULTS) -> Figure:
    """A panel for the success tasks together, and one for each task that is scored by return."""
    cells, looks = _readings(section, settings), section.looks()
    slots = [_slot(cell, looks, settings) for cell in cells]
    line_note = "Line: share of the runs whose score at the last step is higher."
    band_note = f"Band: {SURE} at each score by itself, bootstrap over seeds, stratified by task."
    lacking = f"no two methods with {MIN_RUNS} runs each"
    notes = [line_note, band_note, *final_notes(section, settings, read_at(cells))]
    return sheet(section, settings, slots, notes=notes, lacking=lacking)


def _readings(section: Section, settings: Statistics) -> list[FinalScores]:
    """Readings with two methods that have runs enough; tasks stand for themselves where pooling would lose a method."""
    cells = readings(section, lambda panel: common_step(panel.steps(), {}), settings.last)  # the last step
    pools = [
        cell
        for cell in cells
        if len(cell.panels) > 1
        and all(series.label.method in cell.strata for panel in cell.panels for series in panel.present())
    ]
    pooled = [panel for cell in pools for panel in cell.panels]
    return [
        cell
        for cell in cells
        if cell in pools or (len(cell.panels) == 1 and cell.panels[0] not in pooled)
        if sum(min(map(len, tasks)) >= MIN_RUNS for tasks in cell.strata.values()) > 1
    ]


def _slot(cell: FinalScores, looks: Looks, settings: Statistics) -> Slot:
    scores = np.concatenate([cell.runs(method) for method in cell.strata])
    span = (0.0, 100.0) if cell.score == "success" else (float(scores.min()), float(scores.max()))

    def fill(axes: Axes) -> None:
        thresholds = np.linspace(*span, _POINTS)
        for position, (method, strata) in enumerate(cell.strata.items()):
            rng = np.random.default_rng(BOOTSTRAP_SEED)
            share = performance_profile(strata, thresholds, rng=rng, replicates=settings.replicates, level=LEVEL)
            line(axes, thresholds, 100 * share.estimate, looks[method], 8 * position, drawstyle="steps-post")
            ends, colour = (100 * share.low, 100 * share.high), looks[method].color
            axes.fill_between(thresholds, *ends, step="post", color=colour, alpha=0.14, linewidth=0)
        score_axis(axes, "success")

    step = "last step" if cell.read is None else f"step {cell.read.step:,}"
    runs = [(method, cell.runs(method).size) for method in cell.strata]
    return Slot(f"{cell.name}, {step}", "Runs above it (%)", fill, UNITS[cell.score], runs)


profile = from_frames(draw)

"""Interquartile mean of each method, with 95 % bootstrap intervals over seeds.

Success is read at the first step at which 80 % of the seeds of any
method but the oracle are at 100 %, else at the last step; returns at
the last step. Profiles and overrides never share a table. `run` and
`resume` leave the whole curves in aggregates/NAME.parquet.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rrmctl.reports.iqm_curves import ALL_TASKS, COLUMNS, LAST_MARK, iqm_rows
from rrmctl.reports.report import Report, section_report
from rrmctl.reports.series import Panel, Section
from rrmctl.reports.statistics import Statistics
from rrmctl.stats.curves import SHARE

__all__ = ["COLUMNS", "EXPERIMENTS", "EXPLAINED", "make"]

EXPERIMENTS: tuple[str, ...] = ()
EXPLAINED = (
    f"Step: where the methods of a task are compared. Success: the first evaluation at which {100 * SHARE:g} % of the "
    "seeds of a method but the oracle are at 100 %, which flatters all methods alike. Where there is none (marked *), "
    "and for returns: the last one that all have.",
    "AUC: area under the IQM curve over the steps common to a task's methods, divided by their span.",
    f'"{ALL_TASKS}": the seeds of all tasks that are read by success, pooled, each task at its own step; those on '
    "states and those on images apart. A method stands there that has runs on all of them.",
)


def make(sections: Sequence[Section], settings: Statistics) -> list[Report]:
    """A table for each section."""
    return [
        section_report(section, settings, COLUMNS, iqm_rows(section, settings), notes=_step_notes(section.panels()))
        for section in sections
    ]


def _step_notes(panels: Sequence[Panel]) -> Iterator[str]:
    """Who chose the step of each panel, and what the mark beside the others means."""
    share = f"{100 * SHARE:g} %"
    merely_last = False
    for panel in panels:
        alone = sum(other.task == panel.task for other in panels) == 1
        name = panel.task if alone else f"{panel.task} ({panel.teacher}, {panel.feedback})"
        read = panel.read_at()
        if read.reached:
            yield f"{name} is read where {share} of the seeds of {' and '.join(read.by)} are at 100 % first."
        merely_last |= not read.reached and panel.score == "success"
    if merely_last:
        yield f"{LAST_MARK} the last common step: no method but the oracle ever has {share} of its seeds at 100 %."

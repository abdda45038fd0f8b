"""Scores at the last step: interquartile mean of each method with its 95 % interval.

Success, or true return where the task is read by that, at the last step
that all methods of a comparison have in common. The best method but the
oracle is in bold.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from rrmctl.reports.columns import METHOD, PLACE, QUARTILES, RUNS, SCORE, STEP, estimated
from rrmctl.reports.report import Report, section_report
from rrmctl.reports.scores import score
from rrmctl.reports.series import Panel, Section, at_steps
from rrmctl.reports.statistics import Statistics
from rrmctl.stats import quartiles

EXPERIMENTS: tuple[str, ...] = ()
EXPLAINED = ("Step: the last evaluation that all methods of a task have.",)
COLUMNS = (*PLACE, METHOD, SCORE, STEP, *estimated("iqm", "Final", best=True), *QUARTILES, *RUNS)


def make(sections: Sequence[Section], settings: Statistics) -> list[Report]:
    """A table for each section."""
    return [
        section_report(
            section, settings, COLUMNS, [row for panel in section.panels() for row in final_rows(panel, settings)]
        )
        for section in sections
    ]


def final_rows(panel: Panel, settings: Statistics) -> Iterator[dict[str, Any]]:
    """The rows of one comparison, success as a fraction."""
    step = int(panel.steps()[-1])
    for series in panel.series:
        row = panel.row(series) | {"step": step}
        if series.n:
            values = at_steps(series, [step], settings.last)
            row |= score([values], settings).estimate().row("iqm")
            row |= dict(zip(("q25", "q75"), map(float, quartiles(values)), strict=True))
        yield row

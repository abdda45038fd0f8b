"""Scores read at one step of each task: what figures of distributions are made of."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from rrm.envs.tasks import ScoreKind
from rrmctl.reports.iqm_curves import ALL_TASKS, across_tasks
from rrmctl.reports.plot_elements import panel_name, scaled
from rrmctl.reports.series import Floats, Panel, Section
from rrmctl.stats import CommonStep


@dataclass(frozen=True, eq=False)
class FinalScores:
    """The scores of one panel at its step, or of several tasks at theirs."""

    name: str
    score: ScoreKind
    strata: dict[str, list[Floats]]  #: method -> for each task one score a run, [S]; success in percent
    panels: tuple[Panel, ...]  #: several where tasks are pooled
    read: CommonStep | None  #: None where tasks are pooled

    def runs(self, method: str) -> Floats:
        """The scores of all runs of a method."""
        return np.concatenate(self.strata[method])


def readings(section: Section, rule: Callable[[Panel], CommonStep]) -> list[FinalScores]:
    """One for each panel whose methods have a step in common, then those of pooled success tasks.

    A method is pooled where it has runs on all of the tasks.
    """
    panels = [panel for panel in section.panels() if panel.comparable()]
    single = {}
    for panel in panels:
        read = rule(panel)
        strata = {
            series.label.method: [scaled(series)[:, int(np.searchsorted(series.steps, read.step))]]
            for series in panel.present()
        }
        single[panel] = FinalScores(panel_name(panel, panels), panel.score, strata, (panel,), read)
    return [*single.values(), *_pooled(panels, single)]


def _pooled(panels: list[Panel], single: dict[Panel, FinalScores]) -> Iterator[FinalScores]:
    """The tasks together; several groups of them are told apart by teacher and schedule."""
    groups = across_tasks(panels)
    for group in groups:
        name = f"{ALL_TASKS}, {group[0].teacher}, {group[0].feedback}" if len(groups) > 1 else ALL_TASKS
        tasks = [single[panel].strata for panel in group]
        strata = {method: [task[method][0] for task in tasks] for method in tasks[0] if all(method in t for t in tasks)}
        yield FinalScores(name, "success", strata, tuple(group), None)


def last_step(panel: Panel) -> CommonStep:
    """The last step that is common to the methods of a panel."""
    steps = panel.steps()
    return CommonStep(index=steps.size - 1, step=int(steps[-1]), reached=False, by=())

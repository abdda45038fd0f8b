"""Scores read at one step of each task: what figures of distributions are made of."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from rrm.envs.tasks import ScoreKind
from rrmctl.reports.iqm_curves import ALL_TASKS, across_tasks
from rrmctl.reports.plot_elements import panel_name, scaled
from rrmctl.reports.series import Panel, Section
from rrmctl.stats import CommonStep, Floats


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
    single = {id(panel): _of_panel(panel, panels, rule(panel)) for panel in panels}
    groups = across_tasks(panels)
    pooled = [_pooled([single[id(panel)] for panel in group], several=len(groups) > 1) for group in groups]
    return [*single.values(), *pooled]


def last_step(panel: Panel) -> CommonStep:
    """The last step that is common to the methods of a panel."""
    steps = panel.steps()
    return CommonStep(index=steps.size - 1, step=int(steps[-1]), reached=False, by=())


def _of_panel(panel: Panel, panels: Sequence[Panel], read: CommonStep) -> FinalScores:
    strata = {
        each.label.method: [scaled(each)[:, int(np.searchsorted(each.steps, read.step))]] for each in panel.present()
    }
    return FinalScores(panel_name(panel, panels), panel.score, strata, (panel,), read)


def _pooled(group: Sequence[FinalScores], *, several: bool) -> FinalScores:
    """The tasks together; `several` groups are told apart by teacher and schedule."""
    first = group[0].panels[0]
    name = f"{ALL_TASKS}, {first.teacher}, {first.feedback}" if several else ALL_TASKS
    common = [method for method in group[0].strata if all(method in each.strata for each in group)]
    strata = {method: [each.strata[method][0] for each in group] for method in common}
    panels = tuple(panel for each in group for panel in each.panels)
    return FinalScores(name, "success", strata, panels, None)

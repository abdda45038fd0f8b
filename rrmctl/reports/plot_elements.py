"""What several figures show and are drawn with: lines with bands, axes, names of panels, scores read at one step."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rrm.envs.tasks import ScoreKind
from rrmctl.labels import ORACLE
from rrmctl.reports.figure_layout import Axes, Slot
from rrmctl.reports.iqm_curves import across_tasks
from rrmctl.reports.series import Panel, Section, Series, at_steps
from rrmctl.reports.statistics import Statistics
from rrmctl.reports.styles import Looks, Style
from rrmctl.stats import CommonStep, Floats, IqmKind, Steps, iqm, quartiles

UNITS = {"success": "Success rate (%)", "return": "Return (true reward)"}


def line(axes: Axes, steps: Steps | Floats, values: Floats, look: Style, position: int = 0, **other: Any) -> None:
    """A line with some eight markers; those of lines at different positions do not lie on one another."""
    every = math.ceil(steps.size / 8)
    # A line without markers has nothing to show at a single step.
    marker = look.marker or ("." if steps.size == 1 else "")
    arguments: dict[str, Any] = look._asdict() | {"marker": marker, "markevery": (position % every, every)}
    axes.plot(steps, values, **arguments | other)


def curve(axes: Axes, steps: Steps, values: Floats, look: Style, kind: IqmKind, *, position: int, **other: Any) -> None:
    """The interquartile mean of the seeds, values [S, T], and a band of their quartiles; none for a single seed."""
    line(axes, steps, iqm(values, kind, axis=0), look, position, **other)
    if len(values) > 1:
        axes.fill_between(steps, *quartiles(values, axis=0), color=look.color, alpha=0.14, linewidth=0)


def curves_slot(name: str, shown: Sequence[Series], looks: Looks, settings: Statistics) -> Slot:
    """A panel of learning curves of one score, at each step what is read there."""

    def fill(axes: Axes) -> None:
        for position, series in enumerate(shown):
            method = series.label.method
            on_top = 3 if method == ORACLE else 2  # dots on a line can be seen, a line on dots hides them
            scores = scaled(series, settings.last)
            curve(axes, series.steps, scores, looks[method], settings.kind, position=position, zorder=on_top)
        score_axis(axes, shown[0].score)
        step_axis(axes, max(int(series.steps[-1]) for series in shown))

    return Slot(name, UNITS[shown[0].score], fill, runs=[(series.label.method, series.n) for series in shown])


def scaled(series: Series, last: int = 1) -> Floats:
    """The series' scores as axes show them, [S, T]: success in percent, returns as they are."""
    scores = at_steps(series, series.steps, last)
    return 100 * scores if series.score == "success" else scores


def step_axis(axes: Axes, last: int) -> None:
    """From zero to the last step, with ticks like 500k."""
    axes.set_xlim(0, 1.03 * last)
    axes.locator_params("x", min_n_ticks=3)
    axes.xaxis.set_major_formatter(lambda steps, _: short_steps(steps))


def score_axis(axes: Axes, score: str) -> None:
    """Success has the same axis everywhere."""
    if score == "success":
        axes.set_ylim(-4, 104)
        axes.set_yticks(range(0, 101, 20))


def preference_axis(axes: Axes, lowest: float) -> None:
    """Shares of preferences in percent, with chance dotted; the lower half only where there is something in it."""
    axes.axhline(50, color="#555555", linewidth=0.8, linestyle=(0, (1, 2)), zorder=1)
    axes.set_ylim(min(45.0, lowest - 5.0), 101)


def short_steps(steps: float) -> str:
    """A number of steps in short: 0, 500, 50k, 1.5M."""
    if abs(steps) >= 1e6:
        return f"{steps / 1e6:g}M"
    return f"{steps / 1e3:g}k" if abs(steps) >= 1e3 else f"{steps:g}"


def panel_name(panel: Panel, panels: Sequence[Panel]) -> str:
    """The task, and what else tells the panel from the others of its task."""
    others = [other for other in panels if other.task == panel.task]
    parts = [panel.task]
    if len({other.teacher for other in others}) > 1:
        parts.append(f"teacher {panel.teacher}")
    if len({other.feedback for other in others}) > 1:
        parts.append(panel.feedback)
    return ", ".join(parts)


def iqm_notes(section: Section, kind: IqmKind) -> Iterator[str]:
    """What lines and bands are."""
    yield f"Line: interquartile mean over seeds ({kind})."
    if any(series.n > 1 for series in section.series):
        yield "Band: 25 to 75 % of the seeds."


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


def read_at(cells: Iterable[FinalScores]) -> Iterator[tuple[str, int]]:
    """The task and step of those that are of a single panel."""
    return ((cell.panels[0].task, cell.read.step) for cell in cells if cell.read is not None)


def readings(section: Section, rule: Callable[[Panel], CommonStep], last: int = 1) -> list[FinalScores]:
    """One for each panel whose methods have a step in common, then those of pooled success tasks.

    A method is pooled where it has runs on all of the tasks.
    """
    panels = [panel for panel in section.panels() if panel.comparable()]
    single, pooled, groups = {}, [], across_tasks(panels)
    for panel in panels:
        read = rule(panel)
        strata = {
            series.label.method: [scaled(series, last)[:, int(np.searchsorted(series.steps, read.step))]]
            for series in panel.present()
        }
        single[panel] = FinalScores(panel_name(panel, panels), panel.score, strata, (panel,), read)
    names = Counter(name for name, _ in groups)
    for name, group in groups:  # those of one name are told apart by teacher and schedule
        whose = f", {group[0].teacher}, {group[0].feedback}" if names[name] > 1 else ""
        tasks = [single[panel].strata for panel in group]
        strata = {method: [task[method][0] for task in tasks] for method in tasks[0] if all(method in t for t in tasks)}
        pooled.append(FinalScores(name + whose, "success", strata, tuple(group), None))
    return [*single.values(), *pooled]

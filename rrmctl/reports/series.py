"""What a report is made of: series of runs, the panels in which they are compared, and the section they stand in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rrm.envs.tasks import ScoreKind
from rrmctl.errors import UserError
from rrmctl.labels import Label, deployed, knows, panels
from rrmctl.reports.styles import Looks, styles
from rrmctl.stats import CommonStep, Floats, Steps, common_step
from rrmctl.store.trials import Trial

if TYPE_CHECKING:
    import pandas as pd

    from rrmctl.store.layout import Layout

#: The column of the curve that holds a score.
SCORE_COLUMN: dict[ScoreKind, str] = {"success": "success", "return": "true_return"}


class Absent(NamedTuple):
    """A planned run, or deployment, that is not in its series."""

    label: Label
    seed: int
    run: str
    state: str


@dataclass(frozen=True, eq=False)
class Series:
    """The runs one averages over."""

    label: Label
    score: ScoreKind
    steps: Steps  #: [T], the evaluation steps that all of these runs have
    values: Floats  #: [S, T], success as a fraction or true return; finite
    seeds: tuple[int, ...]  #: [S]
    runs: tuple[str, ...]  #: [S]
    planned: int  #: runs that were asked for
    finished: bool  #: False: runs under way, read as far as all of them have come
    rows: pd.DataFrame = field(repr=False)  #: the evaluations of these runs, all columns of the curve

    def measure(self, column: str) -> tuple[Steps, Floats]:
        """A column of the curve at the steps that all runs have: [T], and [S, T] in the order of `seeds`; NaN where
        the runs have no such figure.
        """
        return by_seed(self.rows if column in self.rows else self.rows.assign(**{column: float("nan")}), column)

    @property
    def n(self) -> int:
        """Runs in the series; 0 where none has an evaluation to show."""
        return len(self.seeds)


@dataclass(frozen=True, eq=False)
class Panel:
    """The series that are compared with one another: one task under one teacher and schedule."""

    task: str
    teacher: str
    feedback: str
    score: ScoreKind
    series: tuple[Series, ...]

    def present(self) -> tuple[Series, ...]:
        """The series with at least one run."""
        return tuple(series for series in self.series if series.n)

    def steps(self) -> Steps:
        """Evaluation steps common to all series present; an error where there is none: they cannot be compared."""
        present = self.present()
        common = reduce(np.intersect1d, (series.steps for series in present))
        if common.size == 0:
            seen = "; ".join(f"{s.label.method} at {s.steps[0]:,} to {s.steps[-1]:,}" for s in present)
            raise UserError(f"{self.task}: no evaluation step is common to all methods: {seen}")
        return common

    def row(self, series: Series) -> dict[str, Any]:
        """What a row of a table says of one of its series, whatever was measured."""
        return {
            "task": self.task, "teacher": self.teacher, "feedback": self.feedback, "method": series.label.method,
            "score": self.score, "n": series.n, "planned": series.planned,
        }  # fmt: skip

    def comparable(self) -> bool:
        """Whether some evaluation step is common to its methods."""
        try:
            return self.steps().size > 0
        except UserError:
            return False

    def read_at(self) -> CommonStep:
        """The step at which the methods are compared: the paper's rule for success, the last one for returns."""
        return common_step(self.steps(), self.rivals())

    def rivals(self) -> dict[str, Floats]:
        """Success at the common steps, [S, T], of the methods whose first arrival at 100 % says where one reads: of
        none where returns are compared.
        """
        rivals = [series for series in self.present() if not knows(series.label.method)]
        return {one.label.method: at_steps(one, self.steps()) for one in rivals if self.score == "success"}


@dataclass(frozen=True, eq=False)
class Section:
    """One variant of one experiment: everything that may stand in one table."""

    experiment: str
    profile: str
    variant: str
    overrides: Mapping[str, Any]
    series: tuple[Series, ...]
    absent: tuple[Absent, ...]
    planned: int  #: runs that were asked for
    evaluation: tuple[str, ...]  #: the protocol behind the scores; several where methods differ
    problems: tuple[str, ...]  #: what had to be left out of a series, or was let in against the rule, and why
    mixed: tuple[str, ...] = ()  #: in what its runs differ and should not, where a reader allowed it
    remarks: tuple[str, ...] = ()  #: how its runs were made, as far as a reader must know
    refusal: UserError | None = None  #: why its runs do not belong together, unless a reader allowed it
    trial: Trial | None = None  #: the rules of the sequential test that was begun on it
    source: Layout | None = None  #: the store it was read from, for what runs leave beside their curves
    deployments: tuple[Series, ...] = ()  #: of its policies, a step for each that was deployed; in no comparison
    undeployed: tuple[Absent, ...] = ()  #: planned deployments that are in none of those

    def accepted(self) -> Section:
        """The section, where its runs belong together; else the error says why they do not."""
        if self.refusal is not None:
            raise self.refusal
        return self

    def looks(self) -> Looks:
        """How its methods are drawn, with or without runs."""
        return styles(series.label.method for series in self.series)

    @property
    def contained(self) -> int:
        """Planned runs that are in it."""
        return len({run for series in self.series for run in series.runs})

    def deployment(self, label: Label) -> Series | None:
        """That of the policies of a series; None where it has none."""
        name = label._replace(method=deployed(label.method))
        return next((series for series in self.deployments if series.label == name), None)

    @property
    def answered(self) -> dict[str, str]:
        """Planned runs whose queries people answered, with their tasks, whether or not they have an evaluation."""
        tasks = {run: series.label.task for series in self.series for run in series.runs}
        tasks |= {absent.run: absent.label.task for absent in self.absent}
        source = self.source
        return {run: task for run, task in tasks.items() if source and source.run(run).labels.is_file()}

    def panels(self) -> tuple[Panel, ...]:
        """The comparisons, in the order of the plan; those without any run are left out."""
        by_label = {series.label: series for series in self.series}
        groups = ((where, tuple(by_label[label] for label in labels)) for where, labels in panels(by_label).items())
        return tuple(Panel(*where, own[0].score, own) for where, own in groups if any(series.n for series in own))


def by_seed(rows: pd.DataFrame, column: str) -> tuple[Steps, Floats]:
    """Steps [T] at which every seed was evaluated, and the column there, [S, T] with the seeds in order."""
    matrix = rows.pivot(index="seed", columns="step", values=column).sort_index()
    evaluations = rows.groupby("step")["seed"].nunique()
    matrix = matrix[sorted(evaluations.index[evaluations == len(matrix)])]
    return matrix.columns.to_numpy(dtype=np.int64), matrix.to_numpy(dtype=np.float64)


def finite(steps: Steps, values: Floats) -> tuple[Steps, Floats]:
    """The steps at which every seed has a number: nothing agrees with a reward before it has learned."""
    known = np.isfinite(values).all(axis=0)
    return steps[known], values[:, known]


def at_steps(series: Series, steps: Steps | Sequence[int], last: int = 1) -> Floats:
    """The series' values at these of its steps, [S, len(steps)]; see `ending`."""
    return ending(series.values, np.searchsorted(series.steps, steps), last)


def ending(values: Floats, at: Steps | Sequence[int], last: int) -> Floats:
    """What is read of curves [S, T] at each of these evaluations, [S, len(at)].

    It is the mean of the `last` ones up to it, of fewer where the curve has no more.
    """
    if last == 1:
        return values[:, at]
    return np.stack([values[:, max(0, end + 1 - last) : end + 1].mean(axis=1) for end in at], axis=1)

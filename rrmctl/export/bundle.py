"""What is exported, and what its columns mean."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from rrmctl.store.frame import NUMBER, TEXT, WHOLE, frame, typed
from rrmctl.store.reader import check_profile
from rrmctl.store.snapshot import Run, Snapshot

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False)
class Bundle:
    """The runs of one experiment."""

    experiment: str
    runs: tuple[Run, ...]  #: all that were planned, also those without an evaluation

    @property
    def begun(self) -> tuple[Run, ...]:
        """Those with at least one evaluation, finished or not."""
        return tuple(run for run in self.runs if len(run.curve))

    def evaluations(self) -> pd.DataFrame:
        """One row for each run and evaluation, with every label: the columns of `rrmctl.store.load`."""
        import pandas as pd

        kinds = {name: _KINDS[field.kind] for name, field in COLUMNS.items()}
        tables = [run.curve.assign(**{name: run.plan[name] for name in RUN_COLUMNS}) for run in self.begun]
        return typed(pd.concat([frame([], kinds), *tables], ignore_index=True), kinds)


def read(results: str | Path, experiment: str, profile: str | None = None) -> Bundle:
    """The runs of an experiment, of one profile or of all.

    Raises:
        UserError: no such experiment or profile, or a file is damaged; the message names it.
    """
    runs = Snapshot(results, experiment).runs()
    check_profile(profile, (str(run.plan["profile"]) for run in runs))
    return Bundle(experiment, tuple(run for run in runs if profile in (None, run.plan["profile"])))


class Field(NamedTuple):
    """What a column holds, for a data dictionary."""

    kind: str  #: string, integer or number
    unit: str  #: empty where there is none
    meaning: str


_KINDS = {"string": TEXT, "integer": WHOLE, "number": NUMBER}

#: Columns that say which run a row belongs to.
RUN_COLUMNS = {
    "experiment": Field("string", "", "name of the experiment"),
    "variant": Field("string", "", "profile and overrides together; runs of different variants are never averaged"),
    "profile": Field("string", "", "scale of the run: paper, laptop, quickstart or smoke"),
    "task": Field("string", "", "the task"),
    "method": Field("string", "", "the method"),
    "teacher": Field("string", "", "who answers queries; - where nothing is asked"),
    "feedback": Field(
        "string", "", "queries of a session @ steps between sessions / queries in all; - where nothing is asked"
    ),
    "seed": Field("integer", "", "seed of the run"),
    "run": Field("string", "", "identity of the run: a digest of everything that can change its numbers"),
    "cell": Field("string", "", "identity of the run without its seed; runs of one cell may be averaged"),
    "state": Field("string", "", "done, or why it is not: queued, running, interrupted, failed, blocked or unreadable"),
}

#: Columns that were measured.
MEASURED_COLUMNS = {
    "step": Field("integer", "environment steps", "steps taken when the policy was evaluated"),
    "episodes": Field("integer", "episodes", "evaluation episodes behind this row"),
    "true_return": Field("number", "reward", "mean undiscounted return of the true reward"),
    "success": Field("number", "fraction", "share of episodes with success; missing for tasks without a criterion"),
    "queries": Field("integer", "queries", "queries put to the teacher so far, skipped ones included"),
    "labels": Field("integer", "labels", "labels kept so far"),
    "prior_mean": Field("number", "reward", "mean of the prior reward over the transitions since the last row"),
    "residual_mean": Field("number", "reward", "mean of reward minus prior over those transitions"),
    "reward_mean": Field("number", "reward", "mean of the reward the agent was given for those transitions"),
    "reward_std": Field("number", "reward", "its standard deviation"),
    "true_reward_mean": Field("number", "reward", "mean true reward of those transitions"),
    "wall_s": Field("number", "s", "training time so far, interruptions left out"),
    "steps_per_s": Field("number", "1/s", "environment steps per second since the last row, evaluation included"),
}

#: Every column that each evaluation has, in order.
COLUMNS = RUN_COLUMNS | MEASURED_COLUMNS

#: More about figures than that a run's agent or source of rewards has them.
_FIGURES = {
    "label_accuracy": Field("number", "fraction", "agreement of the learned reward with the labels, last epoch"),
    "true_accuracy": Field("number", "fraction", "its agreement with the true reward on fresh uniform pairs"),
    "critic_loss": Field("number", "", "last loss of the critic; missing before the first update"),
    "actor_loss": Field("number", "", "last loss of the actor"),
    "entropy": Field("number", "nat", "last estimate of the policy's entropy"),
    "alpha": Field("number", "", "temperature of SAC"),
}


def described(column: str) -> Field:
    """What a column of `Bundle.evaluations` holds; all figures are there, whether or not more is known of them."""
    figure = Field("number", "", "a figure of the run's agent or source of rewards; missing where it has none")
    return COLUMNS.get(column) or _FIGURES.get(column, figure)

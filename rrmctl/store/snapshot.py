"""One look at a results root: what was planned there, where it stands and what came of it. Nothing is skipped."""

from __future__ import annotations

import datetime
import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rrmctl.errors import UserError
from rrmctl.labels import Label
from rrmctl.store.curve import read_curve
from rrmctl.store.frame import MAYBE_WHOLE, NUMBER, TEXT, WHOLE, frame, typed
from rrmctl.store.layout import open_results
from rrmctl.store.provenance import read_config, read_provenance
from rrmctl.store.schema import IDENTITY, LABELS, curve_schema
from rrmctl.store.status import Status, run_status, statuses
from rrmctl.store.sweeps import Job, SweepRecord, read_sweeps, readable_sweeps

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

#: Columns of `planned`, with their types.
PLANNED = dict.fromkeys(
    (
        "experiment", "variant", "profile", "overrides", "task", "method", "teacher", "feedback", "seed", "run", "cell",
        "state", "attempt", "step", "steps", "error",
    ), TEXT
) | dict.fromkeys(("seed", "attempt", "step", "steps"), WHOLE)  # fmt: skip

#: Columns of `table`, beside those of `planned`.
FACTS = {
    **dict.fromkeys(("evaluations", "queries", "labels"), MAYBE_WHOLE), "wall_s": NUMBER,
    **dict.fromkeys(("started", "host", "cpu", "platform", "python", "precision"), TEXT), "threads": MAYBE_WHOLE,
    "code": TEXT, **dict.fromkeys(("config_version", "resumed"), MAYBE_WHOLE), "versions": TEXT,
}  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """A planned run under one of its labels."""

    plan: dict[str, Any]  #: its row of `rrmctl.store.planned`
    config: dict[str, Any] | None  #: None where it was never started
    provenance: dict[str, Any] | None  #: None where it was never started
    curve: pd.DataFrame  #: the columns `MEASURED` and its figures, by step; empty before the first evaluation

    @property
    def id(self) -> str:
        """Sixteen hexadecimal digits."""
        return str(self.plan["run"])

    @property
    def row(self) -> Label:
        """What it is called, whatever its seed."""
        return Label(*(self.plan[name] for name in Label._fields))

    @property
    def label(self) -> str:
        """For people, with its seed."""
        return self.row.seeded(self.plan["seed"])

    @property
    def labels(self) -> dict[str, Any]:
        """What it is called: experiment, variant, profile, task, method, teacher, feedback, seed."""
        return {name: self.plan[name] for name in LABELS}

    @property
    def started(self) -> float | None:
        """When its first attempt began, seconds since the epoch; None where that is not recorded."""
        started = (self.provenance or {}).get("started")
        return None if started is None else datetime.datetime.fromisoformat(started).timestamp()

    def facts(self) -> dict[str, Any]:
        """The columns `FACTS`; None where nothing is known."""
        config, recorded = self.config or {}, self.provenance or {}
        last = dict(self.curve.iloc[-1]) if len(self.curve) else {}
        facts: dict[str, Any] = {name: recorded.get(name) for name in FACTS}
        facts |= {name: config.get(name) for name in ("precision", "threads", "config_version")}
        facts |= {name: last.get(name) for name in ("queries", "labels", "wall_s")} | {"evaluations": len(self.curve)}
        resumed, versions = recorded.get("resumed"), recorded.get("versions")
        facts["resumed"] = None if resumed is None else len(resumed)
        facts["versions"] = None if versions is None else json.dumps(versions, sort_keys=True)
        return facts


class Snapshot:
    """The sweeps of an experiment, or of all, and where their runs stand now; each run's files are read at most once.

    Args:
        results: the results root.
        experiment: only this one.
        lenient: go on without records that are damaged, and say so in `damage`; of one experiment none may be.
    """

    def __init__(
        self, results: str | Path = "results", experiment: str | None = None, *, lenient: bool = False
    ) -> None:
        self.layout = open_results(results)
        self.damage: list[UserError] = []
        if lenient and experiment is None:
            self.sweeps, self.damage = readable_sweeps(self.layout)
        else:
            self.sweeps = read_sweeps(self.layout, experiment)
        self.states = statuses(self.layout, (job for sweep in self.sweeps for job in sweep.everything))
        self.config = cache(lambda run: read_config(self.layout.run(run)))
        self.provenance = cache(lambda run: read_provenance(self.layout.run(run)))
        self.curve = cache(lambda run: read_curve(self.layout.run(run)))

    def begun(self, run: str) -> bool:
        """Whether the run has a configuration: without one somebody is about to write it, or died there."""
        return self.layout.run(run).config.exists()

    def planned(self, *, needed: bool = False) -> pd.DataFrame:
        """As the function of this name."""
        return self._planned(lambda sweep: (*sweep.merely_needed, *sweep.deployments) if needed else sweep.jobs)

    def deployments(self) -> pd.DataFrame:
        """The same of the deployments alone."""
        return self._planned(lambda sweep: sweep.deployments)

    def _planned(self, jobs: Callable[[SweepRecord], Iterable[Job]]) -> pd.DataFrame:
        rows = (
            (
                sweep.experiment, sweep.variant, sweep.profile, json.dumps(sweep.overrides, sort_keys=True), *job.row,
                job.seed, job.id, job.cell, *_progress(self.states[job.id], job.steps)
            )
            for sweep in self.sweeps
            for job in jobs(sweep)
        )  # fmt: skip
        return frame(rows, PLANNED)

    def unplanned(self) -> pd.DataFrame:
        """Rows like those of `planned`, for run folders that no sweep names."""
        rows, planned = [], {job.id for sweep in self.sweeps for job in sweep.jobs}
        for run in (run for run in self.layout.run_ids() if run not in planned and self.begun(run)):
            config = self.config(run)
            labels = (config["task"], config["method"], "", "", config["seed"], run, config["cell"])
            progress = _progress(run_status(self.layout.run(run)), config["steps"])
            rows.append(("", "", config["profile"], "{}", *labels, *progress))
        return frame(rows, PLANNED)

    def evaluations(self, jobs: pd.DataFrame) -> pd.DataFrame:
        """Of these rows of `planned`, as `load` has them; NaN where a run has no such figure."""
        import pyarrow as pa

        tables = [table for run in dict.fromkeys(jobs["run"]) if (table := self.curve(run)) is not None]
        curves: pa.Table = pa.concat_tables([curve_schema().empty_table(), *tables], promote_options="default")
        measured = curves.drop_columns([name for name in IDENTITY if name != "run"]).to_pandas(use_threads=False)
        return jobs[[*LABELS, "run", "cell", "state"]].merge(typed(measured), on="run", how="inner", sort=False)

    def runs(self, *, needed: bool = False) -> tuple[Run, ...]:
        """The planned runs in the order of the plan, or instead those that are there because of them: experts,
        demonstrations, deployments.
        """
        runs = []
        for plan in self.planned(needed=needed).to_dict("records"):
            labels = {str(name): value for name, value in plan.items()}
            run, curve = plan["run"], self.curve(plan["run"])
            config = self.config(run) if self.begun(run) else None
            table = (curve_schema().empty_table() if curve is None else curve).drop_columns(list(IDENTITY))
            measured = table.to_pandas(use_threads=False)
            runs.append(Run(plan=labels, config=config, provenance=self.provenance(run), curve=measured))
        return tuple(runs)


def _progress(status: Status, steps: int) -> tuple[Any, ...]:
    return (str(status.state), status.attempt, status.step, steps, str(status.error or ""))


def load(results: str | Path = "results", experiment: str | None = None, *, needed: bool = False) -> pd.DataFrame:
    """Every evaluation in the store as a tidy DataFrame: one row per experiment, run and evaluation.

    Args:
        results: the results root.
        experiment: only this one; default all, and runs that no sweep asked for under the experiment "".
        needed: instead of the jobs' those of runs that are there because of them, as of `planned`.

    Returns:
        Columns `experiment, variant, profile, task, method, teacher, feedback, seed, run, cell, state`, those of
        `rrm.types.EvalRow`, then whatever figures the runs have: text (`rrmctl.store.frame`), `seed` and what is
        counted int64, what is measured float64 and NaN where there is nothing. A run that two experiments or two labels
        share appears once for each.

    Raises:
        UserError: the experiment has never been run here, or a file is damaged; the message names it.
    """
    import pandas as pd

    store = Snapshot(results, experiment)
    jobs = store.planned(needed=needed)
    if experiment is None and not needed:
        jobs = pd.concat([jobs, store.unplanned()], ignore_index=True)
    return store.evaluations(jobs)


def planned(results: str | Path = "results", experiment: str | None = None, *, needed: bool = False) -> pd.DataFrame:
    """Every job a sweep asked for, with where it stands, as a DataFrame.

    Args:
        needed: instead of the jobs those runs that are there because of them: experts, demonstrations, deployments.

    Returns:
        The columns of `PLANNED`: `overrides` is JSON, `state` one of `rrmctl.store.status.RunState`, `step` the last
        known of a run and `steps` its length, `error` empty where there was none. `seed`, `attempt`, `step` and
        `steps` are int64, the others text (`rrmctl.store.frame`).

    Raises:
        UserError: the experiment has never been run here, or a sweep record is damaged.
    """
    return Snapshot(results, experiment).planned(needed=needed)


def table(runs: Iterable[Run]) -> pd.DataFrame:
    """One row for each run: the columns of `rrmctl.store.planned`, then `FACTS`, with what it spent."""
    return frame((run.plan | run.facts() for run in runs), PLANNED | FACTS)

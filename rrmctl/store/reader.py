"""Reading the store, at any time, while any number of workers write to it. Nothing is skipped silently."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rrm.errors import nearest
from rrm.files import open_regular, place, read_bounded
from rrmctl.commands import rrmctl
from rrmctl.errors import UserError
from rrmctl.store import validation
from rrmctl.store.curve import LARGEST, decode, rerunning
from rrmctl.store.files import DamagedError, StorageError, read_json, unreadable
from rrmctl.store.frame import TEXT, WHOLE, frame, typed
from rrmctl.store.layout import Layout, RunFolder
from rrmctl.store.owner import is_owned
from rrmctl.store.schema import IDENTITY, LABELS, curve_schema
from rrmctl.store.status import ErrorKind, RunError, RunState, Status, read_status
from rrmctl.store.sweeps import JobRecord, Requiring, SweepRecord, read_sweeps

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa


def run_status(folder: RunFolder) -> Status:
    """Where the run stands now: one that says it is running while nobody owns it is interrupted.

    A status file that is damaged, or cannot be read now, gives the state `unreadable` with the reason.

    Raises:
        VersionError: it is of another schema version.
    """
    try:
        status = read_status(folder)
        if status.state is RunState.RUNNING and not is_owned(folder):
            return dataclasses.replace(status, state=RunState.INTERRUPTED)
    except (DamagedError, StorageError) as error:
        problem = RunError(kind=ErrorKind.STORAGE, type=type(error).__name__, message=str(error))
        return Status(state=RunState.UNREADABLE, error=problem)
    return status


def statuses(layout: Layout, jobs: Iterable[Requiring]) -> dict[str, Status]:
    """Status of every run named by `jobs`, by id. Ten thousand take well under a second.

    A run that is not done while one that it needs, and that is named as well, has failed is blocked, for its reason.
    """
    requires = {job.id: job.requires for job in jobs}
    found = {run: run_status(layout.run(run)) for run in requires}

    def look(run: str, above: frozenset[str] = frozenset()) -> Status:
        status = found[run]
        if status.state in _WAITING:
            # Records that were put together by hand may need each other in a circle.
            needed = (each for each in requires[run] if each in found and each not in above)
            causes = ((each, look(each, above | {run})) for each in needed)
            for each, cause in causes:
                if cause.state in (RunState.FAILED, RunState.BLOCKED):
                    found[run] = dataclasses.replace(
                        status, state=RunState.BLOCKED, error=blocked_by(each, cause.error)
                    )
                    break
        return found[run]

    return {run: look(run) for run in requires}


_WAITING = (RunState.QUEUED, RunState.INTERRUPTED, RunState.WAITING)


def blocked_by(run: str, error: RunError | None) -> RunError:
    """What keeps a run from starting: the failure of another, which it needs."""
    if error is not None and error.kind is ErrorKind.BLOCKED:
        return error  # the first cause says it all
    reason = f"run {run}, which it needs, failed: {error or 'no reason was recorded'}"
    return RunError(kind=ErrorKind.BLOCKED, type="Blocked", message=reason)


def read_config(folder: RunFolder) -> dict[str, Any]:
    """The run's `config.json`.

    Raises:
        DamagedError: there is none, it is damaged, or lacks what every configuration has.
        StorageError: it cannot be read now.
    """
    try:
        config = read_json(folder.config)
    except DamagedError as error:
        raise DamagedError(str(error), CONFIG_HINT) from error
    if config is None:
        raise DamagedError(f"{folder.config} is missing", CONFIG_HINT)
    validation.check(config, _CONFIG, folder.config, CONFIG_HINT)
    return config


#: What to do about a configuration that is not what it should be.
CONFIG_HINT = "run its experiment again: `rrmctl run NAME` writes it anew"

#: What the program itself reads; the rest is checked when the run starts.
_CONFIG = dict.fromkeys(("id", "cell", "profile", "task", "method", "precision"), validation.TEXT) | dict.fromkeys(
    ("config_version", "seed", "steps", "threads"), validation.WHOLE
)


def log_tail(folder: RunFolder, lines: int = 15) -> list[str]:
    """The last lines of a run's log; none where it has not started, and why where it cannot be read."""
    try:
        with open_regular(folder.log) as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - 400 * lines))
            return file.read().decode(errors="replace").splitlines()[-lines:]
    except (FileNotFoundError, NotADirectoryError):
        return []
    except OSError as error:
        return [f"{folder.log} cannot be read: {error.strerror}"]


def read_curve(folder: RunFolder) -> pa.Table | None:
    """The run's curve as an arrow table; None before its first evaluation.

    Raises:
        DamagedError: the file is not an intact curve, or is another run's.
        StorageError: it cannot be read now.
        VersionError: it is of another schema version.
    """
    path = folder.curve
    try:
        # In one read: the file may be replaced by its successor at any moment, and this one stays what it was.
        data = read_bounded(path, LARGEST)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise unreadable(path, error) from error
    table = decode(data, path)
    others = set(table["run"].unique().to_pylist()) - {folder.id}
    if others:
        raise DamagedError(
            f"{path} is the curve of run {', '.join(sorted(others))}, not of {folder.id}",
            f"bring back its own, or train the run again: {rerunning(folder)}",
        )
    return table


def lost_rows(folder: RunFolder, status: Status) -> str | None:
    """What is wrong with the curve of a run that is done, in words; None when every evaluation is there."""
    try:
        table = read_curve(folder)
    except (DamagedError, StorageError) as error:
        return str(error)
    rows = 0 if table is None else table.num_rows
    if rows >= status.rows:
        return None
    if table is None:
        return f"{folder.curve} is missing, with {status.rows} evaluations"
    return f"{folder.curve} holds {rows} evaluations, {status.rows} had been written"


def load(results: str | Path = "results", experiment: str | None = None) -> pd.DataFrame:
    """Every evaluation in the store as a tidy DataFrame: one row per experiment, run and evaluation.

    Args:
        results: the results root.
        experiment: only this one; default all, and runs that no sweep asked for under the experiment "".

    Returns:
        Columns `experiment, variant, profile, task, method, teacher, feedback, seed, run, cell, state`, those of
        `rrm.types.EvalRow`, then whatever figures the runs have: text (`rrmctl.store.frame`), `seed` and what is
        counted int64, what is measured float64 and NaN where there is nothing. A run that two experiments or two labels
        share appears once for each.

    Raises:
        UserError: the experiment has never been run here, or a file is damaged; the message names it.
    """
    import pandas as pd

    layout, table = open_results(results), planned(results, experiment)
    if experiment is None:
        table = pd.concat([table, _unplanned(layout, set(table["run"]))], ignore_index=True)
    curves = _curves(layout, list(dict.fromkeys(table["run"])))
    labels = table[[*LABELS, "run", "cell", "state"]]
    return labels.merge(curves, on="run", how="inner", sort=False)


def planned(results: str | Path = "results", experiment: str | None = None, *, needed: bool = False) -> pd.DataFrame:
    """Every job a sweep asked for, with where it stands, as a DataFrame.

    Args:
        needed: instead of the jobs those runs that are there because jobs need them: experts, demonstrations.

    Returns:
        The columns of `PLANNED`: `overrides` is JSON, `state` one of `rrmctl.store.status.RunState`, `step` the last
        known of a run and `steps` its length, `error` empty where there was none. `seed`, `attempt`, `step` and
        `steps` are int64, the others text (`rrmctl.store.frame`).

    Raises:
        UserError: the experiment has never been run here, or a sweep record is damaged.
    """
    layout = open_results(results)
    sweeps = find_sweeps(layout, experiment) if experiment is not None else read_sweeps(layout)
    states = statuses(layout, (job for sweep in sweeps for job in sweep.everything))
    rows = (
        _planned_row(sweep, job, states[job.id])
        for sweep in sweeps
        for job in (sweep.merely_needed if needed else sweep.jobs)
    )
    return frame(rows, PLANNED_KINDS)


#: Columns of `planned`.
PLANNED = (
    "experiment", "variant", "profile", "overrides", "task", "method", "teacher", "feedback", "seed", "run", "cell",
    "state", "attempt", "step", "steps", "error",
)  # fmt: skip
#: The same with their types.
PLANNED_KINDS = dict.fromkeys(PLANNED, TEXT) | dict.fromkeys(("seed", "attempt", "step", "steps"), WHOLE)


def open_results(results: str | Path) -> Layout:
    """The layout of an existing results root.

    Raises:
        UserError: there is no such folder.
    """
    layout = new_results(results)
    if not layout.root.is_dir():
        begin = rrmctl("run", "quickstart", results=layout.root)
        raise UserError(f"there is no results folder {layout.root}", f"`{begin}` makes one; --results names another")
    return layout


def new_results(results: str | Path) -> Layout:
    """The layout of a results root, whether or not it exists.

    Raises:
        UserError: it is a file.
    """
    root = place(results)
    if root.exists() and not root.is_dir():
        raise UserError(f"{root} is a file, not a folder", "name a folder with --results; the default is results")
    return Layout(root)


def find_sweeps(layout: Layout, experiment: str) -> list[SweepRecord]:
    """The variants of an experiment that were run here.

    Raises:
        UserError: none was; the message lists what is there.
    """
    sweeps = read_sweeps(layout, experiment)
    if not sweeps:
        raise never_run(layout, experiment)
    return sweeps


def never_run(layout: Layout, *experiments: str) -> UserError:
    """What to say where the store holds no run of the first of these, or none at all."""
    known = layout.experiments()
    if not known:
        start = rrmctl("run", "quickstart", results=layout.root)
        return UserError(f"{layout.root} holds no experiment yet", f"start one, e.g. `{start}`")
    near = nearest(experiments[0], known)
    start = "" if near else "; `rrmctl list` names what there is to run"
    return UserError(f'{layout.root} holds no runs of "{experiments[0]}"{near}', f"it holds: {', '.join(known)}{start}")


def find_run(layout: Layout, prefix: str) -> RunFolder:
    """The folder of the one run whose id starts with `prefix`.

    Raises:
        UserError: none does, or several do, or `prefix` is empty.
    """
    if not prefix:
        raise UserError("no run was named", f"give its id or the first digits of it; {_ids(layout)}")
    matches = [run for run in layout.run_ids() if run.startswith(prefix)]
    if len(matches) == 1:
        return layout.run(matches[0])
    if not matches:
        raise UserError(f"no run in {layout.root} starts with {prefix!r}", _ids(layout))
    shown = ", ".join(matches[:8]) + (", ..." if len(matches) > 8 else "")
    raise UserError(f"{prefix!r} stands for {len(matches)} runs: {shown}", "give more digits")


def _ids(layout: Layout) -> str:
    return f"ids are the names of the folders in {layout.root / 'runs'}"


def _planned_row(sweep: SweepRecord, job: JobRecord, status: Status) -> tuple[Any, ...]:
    overrides = json.dumps(sweep.overrides, sort_keys=True)
    labels = (*job.row, job.seed, job.id, job.cell)
    progress = (str(status.state), status.attempt, status.step, job.steps, str(status.error or ""))
    return (sweep.experiment, sweep.variant, sweep.profile, overrides, *labels, *progress)


def _unplanned(layout: Layout, known: set[str]) -> pd.DataFrame:
    """Rows like those of `planned`, for run folders that no sweep names."""
    rows = []
    for run in (name for name in layout.run_ids() if name not in known):
        if not layout.run(run).config.exists():
            continue  # somebody is about to write it, or died there: nothing has been run yet
        config, status = read_config(layout.run(run)), run_status(layout.run(run))
        told = {key: config.get(key) for key in ("profile", "task", "method", "seed", "cell", "steps")}
        blank = {"experiment": "", "variant": "", "overrides": "{}", "teacher": "", "feedback": ""}
        progress = {"state": str(status.state), "attempt": status.attempt, "step": status.step}
        rows.append(blank | told | progress | {"run": run, "error": str(status.error or "")})
    return frame(rows, PLANNED_KINDS)


def _curves(layout: Layout, runs: Sequence[str]) -> pd.DataFrame:
    """`run`, the measured columns and the figures of all these runs; NaN where a run has no such figure."""
    import pyarrow as pa

    tables = [table for run in runs if (table := read_curve(layout.run(run))) is not None]
    curves: pa.Table = pa.concat_tables([curve_schema().empty_table(), *tables], promote_options="default")
    return typed(curves.drop_columns([name for name in IDENTITY if name != "run"]).to_pandas(use_threads=False))

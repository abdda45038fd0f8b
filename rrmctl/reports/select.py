"""From the store's rows to arrays: one matrix [seed, step] for each task, method, teacher and feedback schedule.

What belongs together is decided here and nowhere else. Variants (profile and overrides) never meet in one section, and
the runs of one series share their configuration but for the seed. A series is made of its finished runs; where none is
finished yet, of those under way. Failed runs never count. Whatever was planned and is not in it is listed.
"""

from __future__ import annotations

import dataclasses
import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rrm.envs.tasks import task
from rrmctl.commands import rrmctl
from rrmctl.errors import UserError
from rrmctl.labels import Label, policy
from rrmctl.reports import comparability
from rrmctl.reports.comparability import Making
from rrmctl.reports.series import SCORE_COLUMN, Absent, Section, Series, by_seed
from rrmctl.store.layout import check_profile, never_run
from rrmctl.store.snapshot import Snapshot
from rrmctl.store.trials import read_trial

if TYPE_CHECKING:
    import pandas as pd

_VARIANT = ("experiment", "variant")
_UNDER_WAY = ("running", "interrupted", "queued", "waiting")


def read_sections(
    results: str | Path, experiment: str | None = None, *, allow_mixed: bool = False
) -> tuple[Section, ...]:
    """The sections of one experiment, or of all in the store.

    A section whose runs do not belong together says so (`Section.refusal`), and is refused where it is chosen; unless
    runs of different versions or precisions may be mixed, which the section says then.

    Raises:
        UserError: no such results folder or experiment there, or a damaged file.
    """
    store = Snapshot(results, experiment)
    if not store.layout.experiments():
        raise never_run(store.layout)
    return sections_of(store, allow_mixed=allow_mixed)


def sections_of(store: Snapshot, *, allow_mixed: bool = False) -> tuple[Section, ...]:
    """The same of what has been read."""
    jobs, deployed = store.planned(), store.deployments()
    rows, played = store.evaluations(jobs), store.evaluations(deployed)
    runs = dict.fromkeys([*rows["run"], *played["run"], *filter(store.begun, jobs["run"])])
    makings = {run: comparability.making(store, run) for run in runs}
    superseded = {(sweep.experiment, sweep.variant): len(sweep.superseded) for sweep in store.sweeps}
    evaluation = {cell: makings[run].config.get("evaluation") for cell, run in _distinct(rows, "cell", "run")}
    sections = []
    for section in _split(rows, jobs, evaluation, makings, (played, deployed)):
        mixed = comparability.mixture(section, makings)
        differences = tuple(comparability.told(mixed)) if allow_mixed else ()  # else it is refused for them
        problems = [*section.problems]
        if gone := superseded[section.experiment, section.variant]:
            problems.append(
                f"{gone} run{'s are' if gone > 1 else ' is'} left out: of other settings, files or versions than what "
                "was asked for since."
            )
        refusal = comparability.refuse(section, mixed, store.layout) if mixed and not allow_mixed else None
        sections.append(dataclasses.replace(
            section, problems=(*problems, *(f"MIXED: {difference}." for difference in differences)), mixed=differences,
            remarks=tuple(comparability.remarks(section, makings)), refusal=section.refusal or refusal,
            trial=read_trial(store.layout, section.experiment, section.variant), source=store.layout,
        ))  # fmt: skip
    return tuple(sections)


def of_profile(sections: Sequence[Section], profile: str | None, *, apart: bool = False) -> tuple[Section, ...]:
    """The sections of this profile, some of which have a run or people's answers to show; of all profiles for None.

    Args:
        apart: whoever reads them deals with one whose runs do not belong together, where there are others.

    Raises:
        UserError: there is none, the message says what is there instead; or the runs of one do not belong together.
    """
    check_profile(profile, (section.profile for section in sections))
    chosen = [section for section in sections if profile in (None, section.profile)]
    if not apart or all(section.refusal for section in chosen):
        chosen = [section.accepted() for section in chosen]
    if not any(section.contained or section.answered for section in chosen):
        which = ", ".join(dict.fromkeys(section.experiment for section in chosen))
        states = Counter(absent.state for section in chosen for absent in section.absent)
        counts = ", ".join(f"{count} {state}" for state, count in states.items())
        problems = "".join(f"; {problem}" for section in chosen for problem in section.problems)
        root = next((section.source.root for section in chosen if section.source is not None), None)
        raise UserError(
            f"{which}: no run can be reported yet; of the planned ones {counts}{problems}",
            f"`{rrmctl('status', results=root)}` says where they stand, and what goes on with them",
        )
    return tuple(chosen)


def sections_for(
    results: str | Path,
    experiments: Sequence[str],
    profile: str | None = None,
    *,
    allow_mixed: bool = False,
    apart: bool = False,
) -> tuple[Section, ...]:
    """What a table or figure of these experiments is made of: `of_profile` of those that the store has, or of all of it
    where it has none of several, or none is asked for. Others may hold runs that do not belong together.
    """
    found = read_sections(results, *(experiments if len(experiments) == 1 else ()), allow_mixed=allow_mixed)
    chosen = [section for section in found if section.experiment in experiments]
    return of_profile(chosen or found, profile, apart=apart)


def sections(
    rows: pd.DataFrame,
    jobs: pd.DataFrame | None = None,
    *,
    evaluation: Mapping[str, Mapping[str, Any] | None] | None = None,
    deployments: tuple[pd.DataFrame, pd.DataFrame] | None = None,
) -> tuple[Section, ...]:
    """Split the store's rows into sections that may each be reported as a whole.

    Args:
        rows: as `rrmctl.store.load` returns them.
        jobs: as `rrmctl.store.planned` returns them; without it the runs in `rows` are taken for the whole plan.
        evaluation: for each cell its evaluation settings (`success`, `deterministic`), where known.
        deployments: rows and jobs among which those of their deployments are: `load` and `planned` with `needed`.

    Raises:
        UserError: one series holds runs of several configurations, or an unknown task.
    """
    if jobs is None:
        jobs = rows.drop_duplicates([*_VARIANT, *Label._fields, "run"]).assign(overrides="{}")
    return tuple(section.accepted() for section in _split(rows, jobs, evaluation or {}, {}, deployments))


def _split(
    every_row: pd.DataFrame,
    every_job: pd.DataFrame,
    evaluation: Mapping[str, Mapping[str, Any] | None],
    makings: Mapping[str, Making],
    after: tuple[pd.DataFrame, pd.DataFrame] | None = None,
) -> Iterator[Section]:
    """The sections, with those among them whose runs do not belong together; `after`: rows and jobs of deployments."""
    for experiment, variant in _distinct(every_job, *_VARIANT):
        rows, jobs = (_where(table, _VARIANT, (experiment, variant)) for table in (every_row, every_job))
        problems: list[str] = []
        refusals: list[UserError] = []
        series: list[Series] = []
        absent: list[Absent] = []
        labels = [Label(*names) for names in _distinct(jobs, *Label._fields)]
        tasks, methods = (list(dict.fromkeys(names)) for names in (jobs["task"], jobs["method"]))
        for label in sorted(labels, key=lambda label: (tasks.index(label.task), methods.index(label.method))):
            planned, own = (_where(table, Label._fields, label) for table in (jobs, rows))
            series.append(_series(label, own, makings, problems, refusals, planned=len(planned)))
            absent += _absent(planned, series[-1])
        deployments: list[Series] = []
        undeployed: list[Absent] = []
        if after is not None:
            rows_after, jobs_after = (_where(table, _VARIANT, (experiment, variant)) for table in after)
            after_jobs = (Label(*names) for names in _distinct(jobs_after, *Label._fields))
            for label in (label for label in after_jobs if label.method != policy(label.method)):
                planned, own = (_where(table, Label._fields, label) for table in (jobs_after, rows_after))
                deployments.append(_series(label, own, makings, problems, refusals, planned=len(planned)))
                undeployed += _absent(planned, deployments[-1])
        used = rows[rows["run"].isin([run for one in series for run in one.runs])]
        protocols = [
            _protocol(episodes, evaluation.get(cell)) for cell, episodes in _distinct(used, "cell", "episodes")
        ]
        first = jobs.iloc[0]
        yield Section(
            experiment=experiment, profile=str(first["profile"]), variant=variant,
            overrides=json.loads(first["overrides"]), series=tuple(series), absent=tuple(absent),
            planned=int(jobs["run"].nunique()), evaluation=tuple(dict.fromkeys(protocols)), problems=tuple(problems),
            refusal=next(iter(refusals), None), deployments=tuple(deployments), undeployed=tuple(undeployed),
        )  # fmt: skip


def _absent(planned: pd.DataFrame, series: Series) -> Iterator[Absent]:
    """What was planned of a series and is not in it."""
    states = planned[["seed", "run", "state"]].itertuples(index=False, name=None)
    return (Absent(series.label, *planned_run) for planned_run in states if planned_run[1] not in series.runs)


def _where(table: pd.DataFrame, columns: Sequence[str], values: Sequence[str]) -> pd.DataFrame:
    """The rows that have these values."""
    return table[(table[list(columns)] == list(values)).all(axis=1)]


def _distinct(table: pd.DataFrame, *columns: str) -> list[tuple[Any, ...]]:
    return list(dict.fromkeys(table[list(columns)].itertuples(index=False, name=None)))


def _protocol(episodes: int, settings: Mapping[str, Any] | None) -> str:
    """One evaluation in words."""
    words = f"{episodes} episode{'s' if episodes != 1 else ''} an evaluation"
    if settings is None:
        return words
    success = {"any": "success at any step of an episode", "last": "success at the last step of an episode"}
    policy = "deterministic policy" if settings["deterministic"] else "sampled actions"
    return f"{words}, {success[settings['success']]}, {policy}"


def _series(
    label: Label,
    rows: pd.DataFrame,
    makings: Mapping[str, Making],
    problems: list[str],
    refusals: list[UserError],
    *,
    planned: int,
) -> Series:
    """The series of one label.

    Adds to `problems` what was left out of it, and to `refusals` why its runs cannot be averaged; then it is empty.
    """
    score = task(label.task).score
    done = rows[rows["state"] == "done"]
    used = done if len(done) else rows[rows["state"].isin(_UNDER_WAY)]
    # Versions differ in their configurations; whether those meet is looked at when all series are known.
    version = used["run"].map(lambda run: makings[run].facts[comparability.VERSION] if run in makings else "")
    if several := [why for _, alike in used.groupby(version) if (why := comparability.configurations(label, alike))]:
        refusals += several
        used = used[:0]
    who = _distinct(used.sort_values("seed"), "seed", "run")
    steps, values = by_seed(used, SCORE_COLUMN[score])
    finite = np.isfinite(values).all(axis=0)
    if not finite.all():
        where = int(np.flatnonzero(~finite)[0])
        bad = ", ".join(run for (_, run), value in zip(who, values[:, where], strict=True) if not np.isfinite(value))
        problems.append(
            f"{label}: {SCORE_COLUMN[score]} is not a number at {int((~finite).sum())} of {steps.size} evaluation "
            f"steps (first at {steps[where]:,}, run {bad}); these steps are left out"
        )
    steps, values = steps[finite], values[:, finite]
    who = who if steps.size else []
    return Series(
        label=label, score=score, steps=steps, values=values, seeds=tuple(int(seed) for seed, _ in who),
        runs=tuple(str(run) for _, run in who), planned=planned, finished=len(done) > 0, rows=used,
    )  # fmt: skip

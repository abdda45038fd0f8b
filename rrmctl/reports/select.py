"""From the store's rows to arrays: one matrix [seed, step] for each task, method, teacher and feedback schedule.

What belongs together is decided here and nowhere else. Variants (profile and overrides) never meet in one section, and
the runs of one series share their configuration but for the seed. A series is made of its finished runs; where none is
finished yet, of those under way. Failed runs never count. Whatever was planned and is not in it is listed.
"""

from __future__ import annotations

import dataclasses
import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rrm.envs.tasks import task
from rrmctl.commands import rrmctl
from rrmctl.errors import UserError
from rrmctl.labels import Label
from rrmctl.reports import comparability, names
from rrmctl.reports.comparability import Making
from rrmctl.reports.series import SCORE_COLUMN, Absent, Section, Series, by_seed
from rrmctl.store.reader import load, open_results, planned
from rrmctl.store.sweeps import read_sweeps
from rrmctl.store.trials import read_trial

if TYPE_CHECKING:
    import pandas as pd

_UNDER_WAY = ("running", "interrupted", "queued")


def read_sections(
    results: str | Path, experiment: str | None = None, *, allow_mixed: bool = False
) -> tuple[Section, ...]:
    """The sections of one experiment, or of all in the store, from the files below `results`.

    A section whose runs do not belong together says so (`Section.refusal`), and is refused where it is chosen.

    Args:
        allow_mixed: take runs together that were made by different versions or precisions, and say so in the section.

    Raises:
        UserError: no such results folder or experiment there, or a damaged file.
    """
    layout = open_results(results)
    names.experiments(layout, [] if experiment is None else [experiment])
    rows, jobs = load(results, experiment), planned(results, experiment)
    rows = rows[rows["experiment"] != ""]  # runs that no sweep asked for have no labels to be reported under
    begun = [run for run in jobs["run"] if layout.run(run).config.exists()]
    makings = comparability.read_makings(layout, list(dict.fromkeys([*rows["run"], *begun])))
    superseded = {(each.experiment, each.variant): len(each.superseded) for each in read_sweeps(layout, experiment)}
    found = []
    for each in _split(rows, jobs, None, makings):
        mixed = comparability.mixture(each, makings)
        refusal = comparability.refuse(each, mixed, results) if mixed and not allow_mixed else None
        trial = read_trial(layout, each.experiment, each.variant)
        marked = _marked(
            each,
            comparability.told(mixed),
            tuple(comparability.remarks(each, makings)),
            superseded[each.experiment, each.variant],
        )
        found.append(dataclasses.replace(marked, refusal=each.refusal or refusal, trial=trial, source=layout))
    return tuple(found)


def _marked(section: Section, mixed: Sequence[str], remarks: tuple[str, ...], superseded: int) -> Section:
    """The section with what is to be said of how its runs were made, and of those that gave way to others."""
    gone = (
        f"{superseded} run{'s are' if superseded > 1 else ' is'} left out: of other settings, files or versions than "
    )
    loud = (*((f"{gone}what was asked for since.",) if superseded else ()), *(f"MIXED: {each}." for each in mixed))
    return dataclasses.replace(section, problems=(*section.problems, *loud), mixed=tuple(mixed), remarks=remarks)


def of_profile(found: Sequence[Section], profile: str | None) -> tuple[Section, ...]:
    """The sections of this profile that have a run to show; of all profiles for None.

    Raises:
        UserError: there is none, the message says what is there instead; or the runs of one do not belong together.
    """
    names.check_profile(profile, (each.profile for each in found))
    chosen = [each.accepted() for each in found if profile in (None, each.profile)]
    if not any(each.contained for each in chosen):
        which = ", ".join(dict.fromkeys(each.experiment for each in chosen))
        states = Counter(absent.state for each in chosen for absent in each.absent)
        told = ", ".join(f"{count} {state}" for state, count in states.items())
        problems = "".join(f"; {problem}" for each in chosen for problem in each.problems)
        root = next((each.source.root for each in chosen if each.source is not None), None)
        raise UserError(
            f"{which}: no run can be reported yet; of the planned ones {told}{problems}",
            f"`{rrmctl('status', results=root)}` says where they stand, and what goes on with them",
        )
    return tuple(chosen)


def sections(
    rows: pd.DataFrame,
    jobs: pd.DataFrame | None = None,
    *,
    evaluation: Mapping[str, Mapping[str, Any] | None] | None = None,
    makings: Mapping[str, Making] | None = None,
) -> tuple[Section, ...]:
    """Split the store's rows into sections that may each be reported as a whole.

    Args:
        rows: as `rrmctl.store.load` returns them.
        jobs: as `rrmctl.store.planned` returns them; without it the runs in `rows` are taken for the whole plan.
        evaluation: for each cell its evaluation settings (`success`, `deterministic`), where known.
        makings: for each run how it was made, of which `evaluation` is then taken; without it all are taken for alike.

    Raises:
        UserError: one series holds runs of several configurations, or an unknown task.
    """
    return tuple(each.accepted() for each in _split(rows, jobs, evaluation, makings or {}))


def _split(
    rows: pd.DataFrame,
    jobs: pd.DataFrame | None,
    evaluation: Mapping[str, Mapping[str, Any] | None] | None,
    makings: Mapping[str, Making],
) -> Iterator[Section]:
    """The sections, with those among them whose runs do not belong together."""
    if jobs is None:
        jobs = rows.drop_duplicates(["experiment", "variant", *Label._fields, "run"]).assign(overrides="{}")
    known = {cell: makings[run].config.get("evaluation") for cell, run in _distinct(rows, "cell", "run") if makings}
    versions = {run: made.version for run, made in makings.items()}
    for key in dict.fromkeys(zip(jobs["experiment"], jobs["variant"], strict=True)):
        yield _section(_of_variant(rows, key), _of_variant(jobs, key), evaluation or known, versions)


def _of_variant(table: pd.DataFrame, key: tuple[str, str]) -> pd.DataFrame:
    experiment, variant = key
    return table[(table["experiment"] == experiment) & (table["variant"] == variant)]


def _section(
    rows: pd.DataFrame,
    jobs: pd.DataFrame,
    evaluation: Mapping[str, Mapping[str, Any] | None],
    versions: Mapping[str, int],
) -> Section:
    problems: list[str] = []
    refusals: list[UserError] = []
    series, absent = [], []
    for label in _ordered(Label(*row) for row in jobs[list(Label._fields)].itertuples(index=False)):
        asked = _labelled(jobs, label)
        each = _series(label, _labelled(rows, label), versions, problems, refusals)
        series.append(dataclasses.replace(each, planned=len(asked)))
        absent += [
            Absent(label, int(seed), run, state)
            for seed, run, state in zip(asked["seed"], asked["run"], asked["state"], strict=True)
            if run not in each.runs
        ]
    used = rows[rows["run"].isin([run for each in series for run in each.runs])]
    protocols = [_protocol(episodes, evaluation.get(cell)) for cell, episodes in _distinct(used, "cell", "episodes")]
    first = jobs.iloc[0]
    return Section(
        experiment=str(first["experiment"]),
        profile=str(first["profile"]),
        variant=str(first["variant"]),
        overrides=json.loads(first["overrides"]),
        series=tuple(series),
        absent=tuple(absent),
        planned=int(jobs["run"].nunique()),
        evaluation=tuple(dict.fromkeys(protocols)),
        problems=tuple(problems),
        refusal=next(iter(refusals), None),
    )


def _ordered(labels: Iterable[Label]) -> list[Label]:
    """Distinct labels, tasks and then methods in the order in which they first appear."""
    distinct = list(dict.fromkeys(labels))
    tasks = list(dict.fromkeys(label.task for label in distinct))
    methods = list(dict.fromkeys(label.method for label in distinct))
    return sorted(distinct, key=lambda label: (tasks.index(label.task), methods.index(label.method)))


def _labelled(table: pd.DataFrame, label: Label) -> pd.DataFrame:
    mask = np.ones(len(table), dtype=bool)
    for column, value in label._asdict().items():
        mask &= (table[column] == value).to_numpy()
    return table[mask]


def _distinct(table: pd.DataFrame, *columns: str) -> list[tuple[Any, ...]]:
    return list(dict.fromkeys(table[list(columns)].itertuples(index=False, name=None)))


def _protocol(episodes: int, settings: Mapping[str, Any] | None) -> str:
    """One evaluation in words."""
    told = f"{episodes} episode{'s' if episodes != 1 else ''} an evaluation"
    if settings is None:
        return told
    success = {"any": "success at any step of an episode", "last": "success at the last step of an episode"}
    policy = "deterministic policy" if settings["deterministic"] else "sampled actions"
    return f"{told}, {success[settings['success']]}, {policy}"


def _series(
    label: Label, rows: pd.DataFrame, versions: Mapping[str, int], problems: list[str], refusals: list[UserError]
) -> Series:
    """The series of one label, as if its runs were all that was planned.

    Adds to `problems` what was left out of it, and to `refusals` why its runs cannot be averaged; then it is empty.
    """
    score = task(label.task).score
    done = rows[rows["state"] == "done"]
    used = done if len(done) else rows[rows["state"].isin(_UNDER_WAY)]
    # Versions differ in their configurations; whether those meet is looked at when all series are known.
    version = used["run"].map(lambda run: versions.get(run, 0))
    several = [why for _, alike in used.groupby(version) if (why := comparability.configurations(label, alike))]
    if several:
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
        label=label,
        score=score,
        steps=steps,
        values=values,
        seeds=tuple(int(seed) for seed, _ in who),
        runs=tuple(str(run) for _, run in who),
        planned=len(who),
        finished=len(done) > 0,
        rows=used,
    )

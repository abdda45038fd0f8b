"""A report ready to be written: raw values for programs, text for people, and the words that must stand beside them."""

from __future__ import annotations

import json
import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING, Any

from rrmctl.errors import UserError
from rrmctl.labels import NOTHING_ASKED, Label
from rrmctl.reports.columns import Column, Row, TextGrid
from rrmctl.reports.series import Absent, Section
from rrmctl.reports.statistics import BOOTSTRAP_SEED, SURE, Statistics
from rrmctl.stats import MIN_RUNS, REPLICATES
from rrmctl.store.frame import frame

if TYPE_CHECKING:
    import pandas as pd


class NoDataError(UserError):
    """A table has nothing to show of these sections."""


@dataclass(frozen=True, eq=False)
class Report:
    """One table with everything without which it must not be shown."""

    title: str
    table: pd.DataFrame  #: raw values: success as a fraction, returns as they are, nothing as NaN
    grid: TextGrid
    notes: tuple[str, ...]
    facts: dict[str, Any]  #: what the notes say, in JSON values; experiment, profile and variant among them


def section_report(
    section: Section,
    settings: Statistics,
    columns: Sequence[Column],
    rows: Iterable[Row],
    *,
    grid: Callable[[list[Row]], TextGrid] | None = None,
    notes: Iterable[str] = (),
    **more: Any,
) -> Report:
    """The report of one section.

    Args:
        grid: the table for people, where it is not the columns that have a heading.
        notes: what is particular to it beside what it contains and how it was made.
        more: facts beside those of every table.
    """
    table, whole = tabled(columns, rows)
    read = [(row.get("task", ""), row.get("step", row.get("last_step", math.nan))) for row in whole]
    words = (*contents_notes(section), *notes, *statistics_notes(section, settings, read))
    text = TextGrid.of(columns, whole) if grid is None else grid(whole)
    return Report(title(section), table, text, words, facts(section, settings) | more)


def tabled(columns: Sequence[Column], rows: Iterable[Row]) -> tuple[pd.DataFrame, list[Row]]:
    """The values of these columns as a frame, and the rows with NaN for what is missing."""
    kinds = {column.name: column.kind for column in columns}
    whole: list[Row] = [dict.fromkeys(kinds, math.nan) | dict(row) for row in rows]
    return frame(whole, kinds), whole


def some(reports: list[Report], sections: Sequence[Section], lacking: str, hint: str) -> list[Report]:
    """The reports of a kind; without any, a `NoDataError` that says what the sections lack and what to do."""
    if not reports:
        names = ", ".join(dict.fromkeys(section.experiment for section in sections))
        raise NoDataError(f"{names}: {lacking}", hint)
    return reports


def facts(section: Section, settings: Statistics) -> dict[str, Any]:
    """What a program must know of a table, in JSON values."""
    return {
        "experiment": section.experiment,
        "profile": section.profile,
        "variant": section.variant,
        "overrides": dict(section.overrides),
        "iqm_kind": settings.kind,
        "interval": f"{SURE} percentile bootstrap over seeds, stratified by task",
        "replicates": settings.replicates,
        "bootstrap_seed": BOOTSTRAP_SEED,
        "evaluation": list(section.evaluation),
        "planned_runs": section.planned,
        "contained_runs": section.contained,
        "absent": [
            {**absent.label._asdict(), "seed": absent.seed, "run": absent.run, "state": absent.state}
            for absent in section.absent
        ],
        "problems": list(section.problems),
        "mixed": list(section.mixed),
        "remarks": list(section.remarks),
        **({"score_at_step": settings.final} if settings.last > 1 else {}),
    }


def merged_facts(name: str, sections: Sequence[Section], settings: Statistics) -> dict[str, Any]:
    """The same of a table made of several experiments of one profile."""
    merged, *others = (facts(section, settings) for section in sections)
    for other in others:
        for key, value in merged.items():
            if isinstance(value, list) or key in ("planned_runs", "contained_runs"):
                merged[key] = value + other[key]
    return merged | {"experiment": name, "experiments": [section.experiment for section in sections]}


def title(section: Section, name: str | None = None) -> str:
    """Experiment (or another name), profile and overrides in one line."""
    text = f"{name or section.experiment} · profile {section.profile}"
    if section.profile == "smoke":
        text += " (machinery only, not results)"
    if section.overrides:
        texts = (value if isinstance(value, str) else json.dumps(value) for value in section.overrides.values())
        text += " · " + ", ".join(map("{}={}".format, section.overrides, texts))
    return text


def contents_notes(section: Section) -> Iterator[str]:
    """Where planned runs are not in it: how many and which; and what had to be left out or is remarkable."""
    if section.contained < section.planned:
        yield f"{section.contained} of {section.planned} planned runs."
    yield from absent_notes(section)
    yield from section.problems
    yield from section.remarks


def absent_notes(section: Section, *, short: bool = False) -> Iterator[str]:
    """What was planned and is not in it: a sentence for each state, and one for series read before their end.

    Where words are dear (`short`) with methods together that lack the same seeds, and teachers where needed.
    """
    asking = {
        (series.label.task, *series.label[2:]) for series in section.series if series.label.teacher != NOTHING_ASKED
    }
    several = {task for task, count in Counter(task for task, *_ in asking).items() if count > 1}
    for state, by_label in _by_state(section.absent).items():
        alike: dict[tuple[str, str], list[str]] = defaultdict(list)
        for label, seeds in by_label.items():
            place = label.place if label.task in several else label.task
            alike[place, _seeds(seeds)].append(label.method)
        which = [f"{place}, {', '.join(names)}: {seeds}" for (place, seeds), names in alike.items()]
        if not short:
            which = [f"{label}: {_seeds(seeds)}" for label, seeds in by_label.items()]
        yield f"Not contained, {state}: {'; '.join(which)}."
    early = [f"{s.label} up to step {s.steps[-1]:,}" for s in section.series if s.n and not s.finished]
    if early:
        yield f"Under way, read as far as all of their runs have come: {'; '.join(early)}."


def undeployed_notes(section: Section) -> Iterator[str]:
    """How many of the planned deployments there are, where that is not all, and which are not there."""
    if section.undeployed:
        planned = sum(series.planned for series in section.deployments)
        yield f"{planned - len(section.undeployed)} of {planned} planned deployments."
    for state, by_label in _by_state(section.undeployed).items():
        yield f"Not contained, {state}: {'; '.join(f'{label}: {_seeds(seeds)}' for label, seeds in by_label.items())}."


def _by_state(absences: Iterable[Absent]) -> Mapping[str, Mapping[Label, list[int]]]:
    """The seeds that are absent of each label, by the state that they are in."""
    by_state: dict[str, dict[Label, list[int]]] = defaultdict(lambda: defaultdict(list))
    for absent in absences:
        by_state[absent.state][absent.label].append(absent.seed)
    return by_state


def _seeds(seeds: Sequence[int]) -> str:
    """`seed 3`, `seeds 0, 3`, `seeds 0-9`."""
    by_distance = groupby(enumerate(sorted(seeds)), lambda numbered: numbered[1] - numbered[0])
    runs = [[seed for _, seed in run] for _, run in by_distance]  # of seeds that follow one another
    parts = (f"{run[0]}-{run[-1]}" if len(run) > 2 else ", ".join(map(str, run)) for run in runs)
    return f"seed{'s' if len(seeds) > 1 else ''} {', '.join(parts)}"


_KIND_IN_WORDS = {
    "rliable": "rliable's (the lowest and highest quarter of the runs are dropped, rounded down to whole runs)",
    "exact": "exact (fractional weights: half of the runs count, the two at the quartiles by the share inside)",
}

#: Fewest and most of hundred 95 % percentile intervals of an IQM that hold the true one, for so many seeds, over scores
#: that are normal, even, lopsided or in two heaps; measured, see tests/rrmctl/reports/test_coverage.py.
COVERAGE = {3: (71, 76), 4: (82, 87), 5: (84, 92), 7: (85, 92), 10: (90, 94), 20: (93, 95)}


def _covered(counts: Iterable[int]) -> str:
    return ", ".join(f"{COVERAGE[n][0]}-{COVERAGE[n][1]} % with {n}" for n in counts)


_USUAL_EVALUATION = "10 episodes an evaluation, success at any step of an episode, deterministic policy"

#: What holds of every table, unless a note below it says otherwise.
EXPLAINED = (
    "n: the runs behind a row, of those planned.",
    f"IQM: {_KIND_IN_WORDS['rliable']}, of one number per seed; its episodes are averaged first.",
    f"Interval: {SURE} percentile bootstrap over seeds with tasks as strata, {REPLICATES:,} replicates, generator seed "
    f"{BOOTSTRAP_SEED}; none below {MIN_RUNS} seeds. With few seeds it covers less than its name says: about "
    f"{_covered(COVERAGE)}.",
    "Score at a step: of one evaluation. With --final mean-K it is, of each run, the mean of the last K up to it, or "
    "of those that there are. Areas, means over steps, and the choice of the step stay of single evaluations.",
    "25-75 %: the spread of the seeds, not an interval.",
    "Bold: the highest of the methods but the oracle; where intervals overlap, that may be chance.",
    f"Evaluation: {_USUAL_EVALUATION}.",
)


def final_notes(section: Section, settings: Statistics, read: Iterable[tuple[str, float]] = ()) -> Iterator[str]:
    """What a score at a step is, where it is not of one evaluation; and at which of those that are read, by task and
    step, there are fewer.
    """
    if settings.last == 1:
        return
    yield f"Score at a step: {settings.final} up to it, or of those that there are."
    fewest: dict[str, None] = {}
    for task, step in dict.fromkeys(read):
        counts = [int((one.steps <= step).sum()) for one in section.series if one.n and one.label.task == task]
        if not math.isnan(step) and counts and min(counts) < settings.last:
            fewest[f"{task}, {min(counts)} at step {step:,}"] = None
    if fewest:
        yield f"There are fewer: {'; '.join(fewest)}."


def statistics_notes(section: Section, settings: Statistics, read: Iterable[tuple[str, float]] = ()) -> Iterator[str]:
    """In what the numbers were made otherwise than `EXPLAINED` says, and what intervals are worth with so few seeds.

    `read` as `final_notes` takes it.
    """
    yield from final_notes(section, settings, read)
    if settings.kind != "rliable":
        yield f"IQM: {_KIND_IN_WORDS[settings.kind]}."
    if settings.replicates != REPLICATES:
        yield f"Intervals: {settings.replicates:,} replicates."
    # With ten seeds an interval covers about what its name says.
    counts = {series.n for series in section.series if min(COVERAGE) <= series.n < 10}
    if counts:
        measured = sorted({max(n for n in COVERAGE if n <= count) for count in counts})
        yield f"A {SURE} interval of so few seeds holds the truth less often: about {_covered(measured)}."
    yield from (
        f"Evaluation: {protocol}." for protocol in section.evaluation if not _USUAL_EVALUATION.startswith(protocol)
    )

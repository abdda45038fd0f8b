"""What must stand beside a table: the runs it holds and lacks, how its numbers were made, where its curves are read."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rrmctl.reports.series import Panel, Section
from rrmctl.reports.tables import (
    ALL_TASKS,
    BOOTSTRAP_SEED,
    DEFAULTS,
    LEVEL,
    Curve,
    Settings,
    across_tasks,
    curve_rows,
    curves,
    iqm_rows,
)

if TYPE_CHECKING:
    import pandas as pd

    from rrmctl.reports.series import Series

#: Beside a step that is merely the last one, and before the note that says so.
LAST_MARK = "*"

_KIND_IN_WORDS = {
    "rliable": "rliable's (the lowest and highest quarter of the runs are dropped, rounded down to whole runs)",
    "exact": "exact (fractional weights: half of the runs count, the two at the quartiles by the share inside)",
}


@dataclass(frozen=True, eq=False)
class Report:
    """A table ready to be written: raw values, and the words without which they must not be shown."""

    title: str
    table: pd.DataFrame  #: as `rrmctl.reports.tables.iqm_table` makes it
    notes: tuple[str, ...]
    facts: dict[str, Any]  #: what the notes say, in JSON values


def reports(sections: Sequence[Section], settings: Settings = DEFAULTS) -> tuple[list[Report], pd.DataFrame]:
    """A report for each section, and the IQM curves of all of them in one table."""
    import pandas as pd

    made = [(section, curves(section, settings)) for section in sections]
    tables = [curve_rows(section, found, settings) for section, found in made]
    return [_report(section, found, settings) for section, found in made], pd.concat(tables, ignore_index=True)


def _report(section: Section, made: dict[Series, Curve], settings: Settings) -> Report:
    facts = {
        "experiment": section.experiment,
        "profile": section.profile,
        "variant": section.variant,
        "overrides": dict(section.overrides),
        "iqm_kind": settings.kind,
        "interval": f"{100 * LEVEL:g} % percentile bootstrap over seeds, stratified by task",
        "replicates": settings.replicates,
        "bootstrap_seed": BOOTSTRAP_SEED,
        "evaluation": list(section.evaluation),
        "planned_runs": section.planned,
        "contained_runs": section.contained,
        "absent": [
            {**each.label._asdict(), "seed": each.seed, "run": each.run, "state": each.state} for each in section.absent
        ],
        "problems": list(section.problems),
    }
    table = iqm_rows(section, made, settings)
    return Report(title(section), table, tuple(_notes(section, settings)), facts)


def title(section: Section) -> str:
    """Experiment, profile and overrides in one line."""
    text = f"{section.experiment} · profile {section.profile}"
    if section.profile == "smoke":
        text += " (machinery only, not results)"
    if section.overrides:
        text += " · " + ", ".join(f"{key}={_plain(value)}" for key, value in section.overrides.items())
    return text


def _plain(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)


def _notes(section: Section, settings: Settings) -> Iterator[str]:
    yield f"{section.contained} of {section.planned} planned runs; column n says how many of each row's."
    yield from absent_notes(section)
    yield from section.problems
    panels = section.panels()
    for panel in panels:
        alone = sum(each.task == panel.task for each in panels) == 1
        yield _step_note(panel.task if alone else f"{panel.task} ({panel.teacher}, {panel.feedback})", panel)
    if across_tasks(panels):
        yield f'"{ALL_TASKS}" pools the seeds of all tasks that are read by success, each at its own step.'
    yield f"IQM: {_KIND_IN_WORDS[settings.kind]}, of one number per seed; its episodes are averaged first."
    yield (
        f"Interval: {100 * LEVEL:g} % percentile bootstrap over seeds with tasks as strata, {settings.replicates:,} "
        f"replicates, generator seed {BOOTSTRAP_SEED}; none below 3 seeds. With few seeds it covers less than its name "
        "says: about 79-91 % with 5. The 25-75 % range is the spread of the seeds, not an interval."
    )
    yield "AUC: area under the IQM curve over the steps common to a task's methods, divided by their span."
    for protocol in section.evaluation:
        yield f"Evaluation: {protocol}."


def absent_notes(section: Section) -> Iterator[str]:
    """What was planned and is not in it: a sentence for each state, and one for series read before their end."""
    by_state: dict[str, dict[str, list[int]]] = defaultdict(lambda: defaultdict(list))
    for each in section.absent:
        by_state[each.state][str(each.label)].append(each.seed)
    for state, series in by_state.items():
        which = "; ".join(f"{name}: {_seeds(seeds)}" for name, seeds in series.items())
        yield f"Not contained, {state}: {which}."
    early = [f"{s.label} up to step {s.steps[-1]:,}" for s in section.series if s.n and not s.finished]
    if early:
        yield f"Under way, read as far as all of their runs have come: {'; '.join(early)}."


def _seeds(seeds: Sequence[int]) -> str:
    return f"seed{'s' if len(seeds) > 1 else ''} {', '.join(map(str, sorted(seeds)))}"


def _step_note(name: str, panel: Panel) -> str:
    """Where a panel is read, and why there."""
    read = panel.read_at()
    if panel.score == "return":
        return f"{name} is read at the last common step, {read.step:,}; scores are true returns."
    if read.reached:
        who = " and ".join(read.by)
        return f"{name} is read at step {read.step:,}, the first at which 80 % of the seeds of {who} are at 100 %."
    return (
        f"{LAST_MARK} {name} is read at the last common step, {read.step:,}: no method but the oracle ever has "
        "80 % of its seeds at 100 %."
    )

"""Lists of runs, settings, versions, cost and commands, as parts of the page."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from rrmctl.commands import run_commands
from rrmctl.labels import NOTHING_ASKED
from rrmctl.reports.page.parts import PageColumn, Part, Table
from rrmctl.reports.run_facts import GROUP, common_settings, differing_settings, makings, spending, total
from rrmctl.store.snapshot import Run

if TYPE_CHECKING:
    import pandas as pd

#: States of runs that need somebody's attention.
TROUBLE = ("failed", "blocked", "unreadable")


def clock(seconds: float) -> str:
    """Seconds for people: 12 s, 3 min 05 s, 2 h 07 min, 12 d 03 h."""
    whole = round(seconds)
    for unit, smaller, size, sub in (("d", "h", 86_400, 3_600), ("h", "min", 3_600, 60), ("min", "s", 60, 1)):
        if whole >= size:
            return f"{whole // size} {unit} {whole % size // sub:02} {smaller}"
    return f"{whole} s"


_WHOLE = ("runs", "done", "failed", "steps", "queries", "labels", "seed", "step", "planned", "evaluations", "attempt")
#: Numbers by field, and how they are told; every other field is of words.
_NUMBERS: dict[str, Callable[[Any], str]] = dict.fromkeys(_WHOLE, "{:,.0f}".format) | {
    "success": "{:.0%}".format, "true_return": "{:,.1f}".format, "wall_s": clock, "steps_per_s": "{:.3g}".format,
}  # fmt: skip
#: Headings that are not their field's name.
_HEADINGS = {
    "planned": "Of", "evaluations": "Evaluated", "true_return": "Return", "wall_s": "Time", "steps_per_s": "Steps/s",
    "attempt": "Attempts",
}  # fmt: skip


def columns(*fields: str) -> list[PageColumn]:
    """Columns of these fields."""
    return [
        PageColumn(_HEADINGS.get(name, name.capitalize()), name, name in _NUMBERS, _NUMBERS.get(name, str))
        for name in fields
    ]


def parts(name: str, runs: Sequence[Run], needed: Sequence[Run]) -> Iterator[Part]:
    """The lists of a variant."""
    everything = [*runs, *needed]
    shown = columns(*GROUP, "runs", "done", "steps", "queries", "labels", "wall_s", "steps_per_s")
    last = dict.fromkeys(GROUP, "") | {"task": "all"} | total(everything)
    spent = Table("What was spent", shown, spending(everything).to_dict("records"), last)
    common = _of_texts("Settings of all runs, values as JSON", common_settings(runs))
    versions = _of_texts("What runs were started with", makings(everything))
    words = "Training time as the runs recorded it, on the machines below, while others ran beside them or not."
    lists = [
        Part(id="spent", title="Steps, feedback and time", paragraphs=[words], tables=[spent]),
        Part(id="runs", title="Runs", tables=[_runs("Planned runs", runs), _runs("Runs that these need", needed)]),
        Part(id="settings", title="Settings", tables=[_differing(runs), common]),
        Part(id="versions", title="Machines and versions", tables=[versions]),
        _commands(runs),
    ]
    return (replace(part, id=f"{name}-{part.id}", folded=True) for part in lists)


def failures(runs: Sequence[Run]) -> list[tuple[str, str]]:
    """Reasons, the most frequent first, with the runs they stopped."""
    reasons: dict[str, list[str]] = {}
    for run in {run.id: run for run in runs}.values():
        if run.plan["state"] in TROUBLE:
            reasons.setdefault(run.plan["error"] or "no reason was recorded", []).append(f"{run.label} ({run.id})")
    return [(why, "; ".join(stopped)) for why, stopped in sorted(reasons.items(), key=lambda item: -len(item[1]))]


def _runs(which: str, runs: Sequence[Run]) -> Table:
    counts = ("step", "planned", "evaluations", "success", "true_return", "labels", "wall_s", "attempt")
    rows = []
    for run in runs:
        facts = run.plan | run.facts()
        scores = {name: run.curve[name].iloc[-1] if len(run.curve) else None for name in ("success", "true_return")}
        started = (facts["started"] or "")[:16].replace("T", " ") or None  # to the minute, in UTC as it was recorded
        rows.append(facts | scores | {"planned": facts["steps"], "started": started})
    shown = columns("run", *GROUP, "seed", "state", *counts, "started")
    return Table(f"{which}, with their last evaluation", shown, rows)


def _differing(runs: Sequence[Run]) -> Table:
    """Settings that differ; of few groups of runs with a column for each, called by what tells it from the others."""
    table = differing_settings(runs)
    if len(table) <= 8:  # fit side by side
        labels = table[[name for name in GROUP if table[name].nunique() > 1]].itertuples(index=False, name=None)
        table = table.drop(columns=list(GROUP)).T
        table.columns = [" ".join(name for name in label if name != NOTHING_ASKED) for label in labels]
        table = table.rename_axis("setting").reset_index()
    return _of_texts("Settings that differ, values as JSON", table)


def _of_texts(caption: str, table: pd.DataFrame) -> Table:
    """A frame without numbers."""
    words = (*GROUP, "setting", "value", "fact")
    names = [name.capitalize() if name in words else name for name in table.columns]
    shown = [PageColumn(name, at) for at, name in enumerate(names)]
    return Table(caption, shown, [*table.itertuples(index=False, name=None)])


def _commands(runs: Sequence[Run]) -> Part:
    """The commands that the runs were asked for with; those that ask for all of the plan where none is recorded."""
    asked = [shlex.join(run.provenance["argv"]) for run in runs if run.provenance and run.provenance.get("argv")]
    words = "As they were typed; given again, each trains what is missing."
    if not asked:
        plan, words = runs[0].plan, "These train what is missing."
        wanted = [(run.plan["task"], run.plan["method"], run.plan["seed"]) for run in runs]
        asked = run_commands(plan["experiment"], plan["profile"], json.loads(plan["overrides"]), wanted)
    commands = "\n".join(dict.fromkeys(asked))
    return Part(id="again", title="How to reproduce it", paragraphs=[words], commands=commands)

"""Lists of runs, settings, versions, cost and commands, as pieces of the page."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from rrmctl.commands import run_commands
from rrmctl.labels import NOTHING_ASKED
from rrmctl.reports.accounts import GROUP, common_settings, differing_settings, makings, spending, total
from rrmctl.reports.page.html import Html, element, joined
from rrmctl.reports.page.tables import Column, of_rows
from rrmctl.store.inventory import Run, table

if TYPE_CHECKING:
    import pandas as pd

_WHOLE = "{:,.0f}".format
#: Groups of runs whose settings fit side by side.
_FEW = 8
#: States of runs that need somebody's attention.
TROUBLE = ("failed", "blocked", "unreadable")


def clock(seconds: float) -> str:
    """Seconds for people: 12 s, 3 min 05 s, 2 h 07 min, 12 d 03 h."""
    whole = round(seconds)
    for unit, smaller, size, sub in (("d", "h", 86_400, 3_600), ("h", "min", 3_600, 60), ("min", "s", 60, 1)):
        if whole >= size:
            return f"{whole // size} {unit} {whole % size // sub:02} {smaller}"
    return f"{whole} s"


def parts(name: str, runs: Sequence[Run], needed: Sequence[Run]) -> Iterator[tuple[str, str, Html]]:
    """Id, title and content of each list; empty ones are left out by who takes them."""
    yield f"{name}-spent", "Steps, feedback and time", _spent(runs, needed)
    yield f"{name}-runs", "Runs", _inventory(runs, needed)
    yield f"{name}-settings", "Settings", _settings(runs)
    yield f"{name}-versions", "Machines and versions", _makings([*runs, *needed])
    yield f"{name}-again", "How to reproduce it", _commands(runs)


def failures(runs: Sequence[Run]) -> Html:
    """Reasons, the most frequent first, with the runs they stopped."""
    found: dict[str, list[Run]] = {}
    for run in {run.id: run for run in runs}.values():
        if run.plan["state"] in TROUBLE:
            found.setdefault(run.plan["error"] or "no reason was recorded", []).append(run)
    items = [
        element(
            "li",
            element("pre", reason),
            element("p", "; ".join(f"{run.label} ({run.id})" for run in stopped)),
        )
        for reason, stopped in sorted(found.items(), key=lambda item: -len(item[1]))
    ]
    return element("ul", *items) if items else Html()


def _spent(runs: Sequence[Run], needed: Sequence[Run]) -> Html:
    columns = [Column(name.capitalize()) for name in GROUP]
    columns += [Column(name, number=True, show=_WHOLE) for name in ("Runs", "Done", "Steps", "Queries", "Labels")]
    columns += [Column("Time", number=True, show=clock), Column("Steps/s", number=True, show="{:.3g}".format)]
    everything = [*runs, *needed]
    last = ["all", *[""] * (len(GROUP) - 1), *total(everything).values()]
    rows = spending(everything).itertuples(index=False, name=None)
    told = element(
        "p", "Training time as the runs recorded it, on the machines below, while others ran beside them or not."
    )
    return joined([told, of_rows(columns, rows, "What was spent", last)])


def _inventory(runs: Sequence[Run], needed: Sequence[Run]) -> Html:
    names = ["Run", *(name.capitalize() for name in GROUP)]
    columns = [*map(Column, names), Column("Seed", number=True, show=_WHOLE), Column("State")]
    counts = ("Step", "Of", "Evaluated", "Success", "Return", "Labels")
    shows = {"Success": "{:.0%}".format, "Return": "{:,.1f}".format}
    columns += [Column(name, number=True, show=shows.get(name, _WHOLE)) for name in counts]
    columns += [Column("Time", number=True, show=clock), Column("Attempts", number=True, show=_WHOLE)]
    columns += [Column("Started", show=_minute)]
    pieces = []
    for chosen, caption in ((runs, "Planned runs"), (needed, "Runs that these need")):
        facts = table(chosen).to_dict("records")
        rows = [_inventory_row(run, fact) for run, fact in zip(chosen, facts, strict=True)]
        if rows:
            pieces.append(of_rows(columns, rows, f"{caption}, with their last evaluation"))
    return joined(pieces)


def _minute(started: str) -> str:
    """An ISO 8601 time to the minute, in UTC as it was recorded."""
    return started[:16].replace("T", " ")


def _inventory_row(run: Run, fact: dict[object, object]) -> list[object]:
    scores = run.curve[["success", "true_return"]].iloc[-1] if len(run.curve) else (None, None)
    before = (fact[name] for name in ("run", *GROUP, "seed", "state", "step", "steps", "evaluations"))
    return [*before, *scores, *(fact[name] for name in ("labels", "wall_s", "attempt", "started"))]


def _settings(runs: Sequence[Run]) -> Html:
    """What differs, a column for each group of runs where they are few, and what all have in common."""
    common, differing = common_settings(runs), differing_settings(runs)
    pieces = []
    if len(differing.columns) > len(GROUP):
        turned = len(differing) <= _FEW
        shown = _turned(differing) if turned else differing
        columns = [Column(name.capitalize() if name in GROUP else str(name)) for name in shown.columns]
        rows = shown.itertuples(index=False, name=None)
        pieces.append(of_rows(columns, rows, "Settings that differ, values as JSON"))
    if len(common):
        rows = common.itertuples(index=False, name=None)
        pieces.append(of_rows([Column("Setting"), Column("Value")], rows, "Settings of all runs, values as JSON"))
    return joined(pieces)


def _turned(differing: pd.DataFrame) -> pd.DataFrame:
    """Settings as rows, and a column for each group, called by what tells it from the others."""
    labels = differing[[name for name in GROUP if differing[name].nunique() > 1]]
    turned = differing.drop(columns=list(GROUP)).T
    told = labels.itertuples(index=False, name=None)
    turned.columns = [" ".join(name for name in label if name != NOTHING_ASKED) for label in told]
    return turned.rename_axis("Setting").reset_index()


def _makings(runs: Sequence[Run]) -> Html:
    facts = makings(runs)
    if len(facts.columns) == 1:
        return Html()
    columns = [Column("Fact"), *map(Column, facts.columns[1:])]
    return of_rows(columns, facts.itertuples(index=False, name=None), "What runs were started with")


def _commands(runs: Sequence[Run]) -> Html:
    """The commands that the runs were asked for with; those that ask for all of the plan where none is recorded."""
    asked = [shlex.join(run.provenance["argv"]) for run in runs if run.provenance and run.provenance.get("argv")]
    told = "As they were typed; given again, each trains what is missing." if asked else "These train what is missing."
    return joined([element("p", told), element("pre", "\n".join(dict.fromkeys(asked or _whole_plan(runs))))])


def _whole_plan(runs: Sequence[Run]) -> list[str]:
    plan = runs[0].plan
    wanted = [(run.plan["task"], run.plan["method"], run.plan["seed"]) for run in runs]
    return run_commands(plan["experiment"], plan["profile"], json.loads(plan["overrides"]), wanted)

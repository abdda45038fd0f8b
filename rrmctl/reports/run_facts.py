"""What runs were made with and what they cost: settings, machines and versions, steps, feedback and time."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable
from itertools import product
from typing import TYPE_CHECKING, Any

from rrm.tuning import in_words
from rrmctl.labels import Label
from rrmctl.store.frame import NUMBER, TEXT, WHOLE, frame, typed
from rrmctl.store.records import settings
from rrmctl.store.snapshot import Run

if TYPE_CHECKING:
    import pandas as pd

#: What tells the rows of a variant from one another.
GROUP = Label._fields

#: Of a configuration, what says which run it is rather than how it runs.
_IDENTITY = ("id", "cell", "seed", "task", "method", "profile")

#: Of a provenance, what can change a number.
_MAKING = (
    "code", "python", "platform", "cpu", "card", "host", "precision", "threads", "products", "versions", "fingerprint"
)  # fmt: skip

#: What runs did before there was a setting for it, as JSON.
_BEFORE = {"device": '"cpu"'}

_SPENT = dict.fromkeys(("runs", "done", "steps", "queries", "labels"), WHOLE) | {"wall_s": NUMBER}


def spending(runs: Iterable[Run]) -> pd.DataFrame:
    """What each method took, on each task, summed over its runs, finished or not.

    Returns:
        Columns `task, method, teacher, feedback, runs, done, steps` (environment steps), `queries, labels`, `wall_s`
        (training time, seconds) and `steps_per_s`; queries, labels and time as of the last evaluations.
    """
    spent = frame(((*run.row, *_spent(run)) for run in runs), dict.fromkeys(GROUP, TEXT) | _SPENT)
    table = spent.groupby(list(GROUP), sort=False, as_index=False).sum()
    return typed(table.assign(steps_per_s=table["steps"] / table["wall_s"]), {"steps_per_s": NUMBER})


def total(runs: Iterable[Run]) -> dict[str, Any]:
    """The same for all of them together, a run that several labels share counted once."""
    once = {run.id: run for run in runs}.values()
    spent: dict[str, Any] = dict(zip(_SPENT, map(sum, zip(*map(_spent, once), strict=True)), strict=True))
    return spent | {"steps_per_s": spent["steps"] / spent["wall_s"] if spent["wall_s"] else float("nan")}


def _spent(run: Run) -> tuple[float, ...]:
    end = run.curve.iloc[-1] if len(run.curve) else dict.fromkeys(("step", "queries", "labels", "wall_s"), 0)
    counts = (int(end[name]) for name in ("step", "queries", "labels"))
    return (1, int(run.plan["state"] == "done"), *counts, float(end["wall_s"]))


def common_settings(runs: Iterable[Run]) -> pd.DataFrame:
    """The settings that all configured runs share: columns `setting, value`, values as JSON, none unset."""
    _, options = _settings(runs)
    rows = [(name, *values) for name, values in options.items() if len(values) == 1]
    return frame(rows, dict.fromkeys(("setting", "value"), TEXT))


def differing_settings(runs: Iterable[Run]) -> pd.DataFrame:
    """The other settings: a row for each task, method, teacher and feedback, a column for each setting, values as JSON.

    A value is missing where a group has no such setting; several values in a group stand side by side. No row is there
    where nothing differs.
    """
    runs = list(runs)
    values, options = _settings(runs)
    columns = [name for name, seen in options.items() if len(seen) > 1]
    rows: dict[Label, dict[str, dict[str, None]]] = {}
    for run in (run for run in runs if columns and run.id in values):
        row = rows.setdefault(run.row, {name: {} for name in columns})
        for name in set(columns) & set(values[run.id]):
            row[name][values[run.id][name]] = None
    table = [(*group, *(" / ".join(row[name]) or None for name in columns)) for group, row in rows.items()]
    return frame(table, dict.fromkeys((*GROUP, *columns), TEXT))


def _settings(runs: Iterable[Run]) -> tuple[dict[str, dict[str, str]], dict[str, set[str | None]]]:
    """The settings of configured runs, by id and name; and all values of each, None among them where a run has none."""
    flat = {run.id: settings(run.config) for run in runs if run.config is not None}
    values = {
        run: {name: json.dumps(value) for name, value in own.items() if name not in _IDENTITY and value is not None}
        for run, own in flat.items()
    }
    names = dict.fromkeys(name for own in values.values() for name in own)
    for own, name in product(values.values(), _BEFORE.keys() & names):
        own.setdefault(name, _BEFORE[name])
    return values, {name: {own.get(name) for own in values.values()} for name in names}


def makings(runs: Iterable[Run]) -> pd.DataFrame:
    """The machines, versions and digests of code that runs were started with, the most frequent first.

    Returns:
        A row for each fact, a column for each distinct making: `fact`, then `A`, `B`, ...; the first row counts runs.
        No row where none was started.
    """
    once = {run.id: run for run in runs if run.provenance is not None}.values()
    counted = Counter(json.dumps(_making(run), sort_keys=True) for run in once)
    columns = {_letters(at): json.loads(making) for at, (making, _) in enumerate(counted.most_common())}
    names = dict.fromkeys(name for making in columns.values() for name in making)
    rows = [("runs", *(str(count) for _, count in counted.most_common()))] if counted else []
    rows += [(name, *(making.get(name) for making in columns.values())) for name in names]
    return frame(rows, dict.fromkeys(("fact", *columns), TEXT))


def _making(run: Run) -> dict[str, str]:
    facts = {name: value for name, value in (run.provenance or {}).items() if name in _MAKING}
    facts["products"] = in_words(facts["products"])
    version = (run.config or {}).get("config_version")
    return {name: str(value) for name, value in settings({"config_version": version, **facts}).items()}


def _letters(number: int) -> str:
    """A to Z, then AA, AB, ..."""
    return (_letters(number // 26 - 1) if number >= 26 else "") + chr(ord("A") + number % 26)

"""What runs were made with and what they cost: settings, machines and versions, steps, feedback and time."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rrmctl.labels import Label
from rrmctl.store.frame import NUMBER, TEXT, WHOLE, frame
from rrmctl.store.records import settings
from rrmctl.store.snapshot import Run

if TYPE_CHECKING:
    import pandas as pd

#: What tells the rows of a variant from one another.
GROUP = Label._fields

#: Of a configuration, what says which run it is rather than how it runs.
_IDENTITY = ("id", "cell", "seed", "task", "method", "profile")

#: Of a provenance, what can change a number.
_MAKING = ("code", "python", "platform", "cpu", "host", "precision", "threads", "versions", "fingerprint")

_SPENDING = {
    **dict.fromkeys(GROUP, TEXT),
    **dict.fromkeys(("runs", "done", "steps", "queries", "labels"), WHOLE),
    **dict.fromkeys(("wall_s", "steps_per_s"), NUMBER),
}


def spending(runs: Iterable[Run]) -> pd.DataFrame:
    """What each method took, on each task, summed over its runs, finished or not.

    Returns:
        Columns `task, method, teacher, feedback, runs, done, steps` (environment steps), `queries, labels`, `wall_s`
        (training time, seconds) and `steps_per_s`; queries, labels and time as of the last evaluations.
    """
    groups: dict[tuple[str, ...], list[Run]] = {}
    for run in runs:
        groups.setdefault(tuple(run.plan[name] for name in GROUP), []).append(run)
    return frame(((*group, *_spent(members)) for group, members in groups.items()), _SPENDING)


def total(runs: Iterable[Run]) -> dict[str, Any]:
    """The same for all of them together, a run that several labels share counted once."""
    return dict(zip(list(_SPENDING)[len(GROUP) :], _spent(list({run.id: run for run in runs}.values())), strict=True))


def _spent(runs: Sequence[Run]) -> tuple[Any, ...]:
    ends = [run.curve.iloc[-1] for run in runs if len(run.curve)]
    steps, wall_s = sum(int(end["step"]) for end in ends), sum(float(end["wall_s"]) for end in ends)
    done = sum(run.plan["state"] == "done" for run in runs)
    asked = (sum(int(end[name]) for end in ends) for name in ("queries", "labels"))
    return (len(runs), done, steps, *asked, wall_s, steps / wall_s if wall_s else float("nan"))


def common_settings(runs: Iterable[Run]) -> pd.DataFrame:
    """The settings that all configured runs share: columns `setting, value`, values as JSON, none unset."""
    found = [_settings(run) for run in runs if run.config is not None]
    rows = [(name, value) for name, value in (found[0] if found else {}).items() if _shared(name, found)]
    return frame(rows, dict.fromkeys(("setting", "value"), TEXT))


def differing_settings(runs: Iterable[Run]) -> pd.DataFrame:
    """The other settings: a row for each task, method, teacher and feedback, a column for each setting, values as JSON.

    A value is missing where a group has no such setting; several values in a group stand side by side. No row is there
    where nothing differs.
    """
    configured = [run for run in runs if run.config is not None]
    found = {run.id: _settings(run) for run in configured}
    names = dict.fromkeys(name for each in found.values() for name in each)
    columns = [name for name in names if not _shared(name, list(found.values()))]
    rows: dict[tuple[str, ...], dict[str, dict[str, None]]] = {}
    for run in configured if columns else ():
        row = rows.setdefault(tuple(run.plan[name] for name in GROUP), {name: {} for name in columns})
        for name in set(columns) & set(found[run.id]):
            row[name][found[run.id][name]] = None
    table = [(*group, *(" / ".join(row[name]) or None for name in columns)) for group, row in rows.items()]
    return frame(table, dict.fromkeys((*GROUP, *columns), TEXT))


def _settings(run: Run) -> dict[str, str]:
    found = settings(run.config or {})
    return {name: json.dumps(value) for name, value in found.items() if name not in _IDENTITY and value is not None}


def _shared(name: str, found: Sequence[Mapping[str, str]]) -> bool:
    return len({each.get(name) for each in found}) == 1


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
    version = (run.config or {}).get("config_version")
    return {name: str(value) for name, value in settings({"config_version": version, **facts}).items()}


def _letters(number: int) -> str:
    """A to Z, then AA, AB, ..."""
    return (_letters(number // 26 - 1) if number >= 26 else "") + chr(ord("A") + number % 26)

"""Teachers who err: final success under each, beside the paper's (Tab. wrongiqm1).

Interquartile mean at the last step that all methods under a teacher have
in common: where the runs under the stochastic teacher are shorter, the
oracle is read there too. --plus-minus gives the paper's form, a column
for each teacher.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rrmctl.labels import NOTHING_ASKED, ORACLE, knows
from rrmctl.reports import published
from rrmctl.reports.captions import contents_notes, facts, statistics_notes, title
from rrmctl.reports.report import (
    INTERVAL,
    NOTHING,
    Cell,
    Grid,
    Report,
    best_methods,
    counts,
    highest,
    interval,
    number,
    plus_minus,
    some,
    tells_apart,
)
from rrmctl.reports.series import Section
from rrmctl.reports.statistics import DEFAULTS, Statistics
from rrmctl.reports.tables.final import final_rows

if TYPE_CHECKING:
    import pandas as pd

EXPERIMENT = "noisy-teacher"
OPTIONS = ("plus_minus",)

COLUMNS = (
    "task", "teacher", "feedback", "method", "score", "step", "iqm", "low", "high", "n", "planned", "published",
    "published_half", "difference",
)  # fmt: skip

#: What the paper calls a learner without a prior, and which those are.
_BASELINE = "baseline"
_BASELINES = ("pebble", "surf", "mrn")

EXPLAINED = (
    "Paper: in % ± half a 95 % interval. Difference: ours less the paper's, in percentage points.",
    "With --plus-minus, ± is half the width of the interval, which need not lie evenly about the value, nor end at "
    f"100 %; {_BASELINE} is the learner without a prior, which residual models build on.",
)
_RESIDUAL = re.compile(r"rrm-(?:surf-|mrn-)?(.+)")


def make(sections: Sequence[Section], settings: Statistics) -> list[Report]:
    """A table for each section with runs under a teacher who errs.

    Raises:
        NoDataError: there is none.
    """
    found = [(section, table(section, settings)) for section in sections]
    made = [_report(section, rows, settings) for section, rows in found if len(rows)]
    hint = "`rrmctl run noisy-teacher` makes them; `rrmctl report final` is the table for other experiments"
    return some(made, sections, "there are no runs under a teacher who errs", hint)


def table(section: Section, settings: Statistics = DEFAULTS) -> pd.DataFrame:
    """One row per teacher who errs and method: columns `COLUMNS`; success and differences as fractions."""
    import pandas as pd

    panels = [panel for panel in section.panels() if panel.teacher not in (ORACLE, NOTHING_ASKED)]
    rows = [_beside_published(row) for panel in panels for row in final_rows(panel, settings)]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def _beside_published(row: dict[str, Any]) -> dict[str, Any]:
    known = published.final(row["task"], row["teacher"], row["method"])
    if known is None:
        return row
    return row | {
        "published": known.success,
        "published_half": known.half,
        "difference": row.get("iqm", published.NAN) - known.success,
    }


def _report(section: Section, found: pd.DataFrame, settings: Statistics) -> Report:
    grid = _matrix(found) if settings.plus_minus else _list(found)
    notes = tuple(_notes(section, found, settings))
    return Report(title(section), found, grid, notes, facts(section, settings))


def _list(found: pd.DataFrame) -> Grid:
    """A row for each teacher and method."""
    rows = found.to_dict("records")
    names = [*_places(found), "method"]
    columns: dict[str, Sequence[str]] = {name.capitalize(): list(found[name]) for name in names}
    columns["Step"] = [f"{row['step']:,}" for row in rows]
    columns["Final"] = [number(row["iqm"], row["score"]) for row in rows]
    columns[INTERVAL] = [interval(row["low"], row["high"], row["score"], row["n"]) for row in rows]
    columns["n"] = [f"{row['n']}/{row['planned']}" for row in rows]
    columns["Paper"] = [_paper(row) for row in rows]
    columns["Difference"] = [_signed(row["difference"]) for row in rows]
    best = best_methods(found, "iqm", ("task", "teacher", "feedback"), list(columns).index("Final"))
    return Grid.of(columns, words=len(names), best=best)


def _places(found: pd.DataFrame) -> list[str]:
    """The columns that tell one comparison from another."""
    task = ["task"] if found["task"].nunique() > 1 else []
    return [*task, "teacher", *(["feedback"] if tells_apart(found, "feedback", ("task", "teacher")) else [])]


def _matrix(found: pd.DataFrame) -> Grid:
    """The paper's form: a row for each method whatever it builds on, a column for each teacher, the paper's beside.

    Methods of which several would share a row keep rows of their own, and schedules of one teacher have columns.
    """
    place, asked = ["task"], ["teacher", "feedback"]
    named = found.assign(family=found["method"].map(_family))
    shared = named.duplicated([*place, *asked, "family"]).any()
    place.append("method" if shared else "family")
    asked = [name for name in asked if name in _places(found)]
    by_key: dict[tuple[str, ...], dict[tuple[str, ...], dict[Any, Any]]] = {}
    for row in named.to_dict("records"):
        by_key.setdefault(_key(row, place), {})[_key(row, asked)] = row
    words = place if found["task"].nunique() > 1 else place[1:]
    header = [name.capitalize() if name == "task" else "Method" for name in words]
    columns = [list(column) for column in zip(*by_key, strict=True)][-len(words) :]
    best: list[tuple[Cell, tuple[str, ...], float]] = []
    for head in dict.fromkeys(_key(row, asked) for row in named.to_dict("records")):
        rows = [by_asked.get(head) for by_asked in by_key.values()]
        own = [(at, row) for at, row in enumerate(rows) if row and not knows(row["method"])]
        best += [((at, len(columns)), (row["task"], *head), row["iqm"]) for at, row in own]
        header += [" ".join(head), "paper"]
        columns += [[_halved(row) for row in rows], [NOTHING if row is None else _paper(row) for row in rows]]
    header.append("n")
    columns.append([counts(by_asked.values()) for by_asked in by_key.values()])
    return Grid(tuple(header), tuple(zip(*columns, strict=True)), len(words), highest(best))


def _key(row: Mapping[Any, Any], names: Sequence[str]) -> tuple[str, ...]:
    return tuple(row[name] for name in names)


def _family(method: str) -> str:
    """The method without the learner it builds on, as the paper's rows are named."""
    if method in _BASELINES:
        return _BASELINE
    residual = _RESIDUAL.fullmatch(method)
    return f"rrm-{residual[1]}" if residual else method


def _paper(row: dict[Any, Any]) -> str:
    return plus_minus(row["published"], row["published_half"], row["score"])


def _halved(row: dict[Any, Any] | None) -> str:
    return NOTHING if row is None else plus_minus(row["iqm"], (row["high"] - row["low"]) / 2, row["score"])


def _signed(difference: float) -> str:
    """Between two successes, in percentage points."""
    return NOTHING if math.isnan(difference) else f"{100 * difference:+.1f}"


def _notes(section: Section, found: pd.DataFrame, settings: Statistics) -> Iterator[str]:
    yield from contents_notes(section)
    steps = {" ".join(_key(row, _places(found))): row["step"] for row in found.to_dict("records")}
    yield f"Read at the last common step: {', '.join(f'{name} at {step:,}' for name, step in steps.items())}."
    yield f"Paper: {published.source(EXPERIMENT)}, at the paper's scale; ours is profile {section.profile}."
    yield from statistics_notes(section, settings)

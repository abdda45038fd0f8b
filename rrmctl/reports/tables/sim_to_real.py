"""The simulated robot: success and return at three checkpoints, beside the paper's (Tab. realiqm).

The paper's values are of a physical robot, ours of the evaluations in
simulation at the same steps (of shorter profiles, at the same share of the
training). Interquartile means over seeds.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from rrmctl.labels import knows
from rrmctl.planning.profiles import PAPER
from rrmctl.reports import published
from rrmctl.reports.captions import contents_notes, facts, statistics_notes, title
from rrmctl.reports.published import Checkpoint
from rrmctl.reports.report import NOTHING, Grid, Report, highest, interval, number, some
from rrmctl.reports.scores import score
from rrmctl.reports.series import SCORE_COLUMN, Section, Series, finite
from rrmctl.reports.statistics import DEFAULTS, SURE, Statistics

if TYPE_CHECKING:
    import pandas as pd

    from rrmctl.reports.series import Steps

EXPERIMENT = "sim-to-real"
EXPLAINED = (
    "Paper: 5 seeds x 20 episodes on a physical robot. In brackets: ours less the paper's, in percentage points for "
    "success.",
    "Step: the last evaluation up to the paper's checkpoint, or up to the same share of a shorter training.",
)

COLUMNS = (
    "task", "teacher", "feedback", "method", "score", "paper_step", "step", "iqm", "low", "high", "n", "planned",
    "published", "difference",
)  # fmt: skip


def make(sections: Sequence[Section], settings: Statistics) -> list[Report]:
    """A table for each section with runs of the simulated robot.

    Raises:
        NoDataError: there is none.
    """
    found = [(section, table(section, settings)) for section in sections]
    made = [_report(section, rows, settings) for section, rows in found if len(rows)]
    lacking = f"there are no runs of {', '.join(published.deployed_tasks())}"
    return some(made, sections, lacking, "`rrmctl list` names what there is to run")


def table(section: Section, settings: Statistics = DEFAULTS) -> pd.DataFrame:
    """One row per task, method, checkpoint and score: columns `COLUMNS`; success and its difference as fractions."""
    import pandas as pd

    rows = [
        row
        for series in section.series
        if series.label.task in published.deployed_tasks()
        for checkpoint in published.checkpoints(series.label.task, series.label.method)
        for row in _rows(series, checkpoint, section.profile, settings)
    ]
    return pd.DataFrame(rows, columns=list(COLUMNS)).astype({"step": "Int64"})


def _rows(series: Series, checkpoint: Checkpoint, profile: str, settings: Statistics) -> Iterator[dict[str, Any]]:
    told = {"success": checkpoint.success, "return": checkpoint.true_return}
    for name, column in SCORE_COLUMN.items():
        row: dict[str, Any] = {
            **series.label._asdict(), "score": name, "paper_step": checkpoint.step, "n": 0, "planned": series.planned,
            "published": told[name],
        }  # fmt: skip
        steps, values = finite(*series.measure(column)) if series.n else (np.zeros(0, np.int64), np.zeros((0, 0)))
        at = _position(steps, _wanted(series, checkpoint, profile))
        if at is not None:
            found = score([values[:, [at]]], settings).estimate()
            row |= {"step": int(steps[at]), "iqm": float(found.estimate), "n": series.n}
            row |= {"low": float(found.low), "high": float(found.high), "difference": row["iqm"] - told[name]}
        yield row


def _wanted(series: Series, checkpoint: Checkpoint, profile: str) -> int | None:
    """The step at which a checkpoint is due; None where it is not known how long a shorter training is going to be."""
    if profile == PAPER:
        return checkpoint.step
    return round(checkpoint.share * int(series.rows["step"].max())) if series.finished and series.n else None


def _position(steps: Steps, wanted: int | None) -> int | None:
    """Which evaluation stands for a checkpoint; None where there is none yet."""
    if wanted is None or not steps.size or steps[-1] < wanted:
        return None
    reached = np.flatnonzero(steps <= wanted)
    return int(reached[-1]) if reached.size else None


def _report(section: Section, found: pd.DataFrame, settings: Statistics) -> Report:
    notes = (
        *contents_notes(section),
        f"Paper: {published.source(EXPERIMENT)}, on a physical robot; ours is of the simulation, profile "
        f"{section.profile}.",
        *statistics_notes(section, settings),
    )
    return Report(title(section), found, _grid(found), notes, facts(section, settings))


def _grid(found: pd.DataFrame) -> Grid:
    """A row for each task, checkpoint and method; success and return beside one another."""
    order = ["task", "paper_step", "method"]
    table = found.assign(task=found["task"].astype("category").cat.set_categories(list(dict.fromkeys(found["task"]))))
    table = table.sort_values(order[:2], kind="stable")
    halves = {name: table[table["score"] == name].to_dict("records") for name in SCORE_COLUMN}
    success = halves["success"]
    columns: dict[str, Sequence[str]] = {
        "Task": [row["task"] for row in success],
        "Checkpoint": [f"{row['paper_step']:,}" for row in success],
        "Method": [row["method"] for row in success],
        "Step": [NOTHING if row["n"] == 0 else f"{row['step']:,}" for row in success],
    }
    best = []
    for name, rows in halves.items():
        best += [
            ((at, len(columns)), (row["task"], row["paper_step"], name), row["iqm"])
            for at, row in enumerate(rows)
            if not knows(row["method"])
        ]
        columns[name.capitalize()] = [number(row["iqm"], row["score"]) for row in rows]
        columns[f"{name.capitalize()}, {SURE}"] = [
            interval(row["low"], row["high"], row["score"], row["n"]) for row in rows
        ]
        columns[f"{name.capitalize()}, paper"] = [_beside(row) for row in rows]
    columns["n"] = [f"{row['n']}/{row['planned']}" for row in success]
    return Grid.of(columns, words=3, best=highest(best))


def _beside(row: dict[Any, Any]) -> str:
    """The published value, and the difference to it in brackets."""
    told, scale = number(row["published"], row["score"]), 100 if row["score"] == "success" else 1
    missing = math.isnan(row["published"]) or math.isnan(row["difference"])
    return told if missing else f"{told} ({scale * row['difference']:+.1f})"

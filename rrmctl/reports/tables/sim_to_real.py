"""The simulated robot: success and return at three checkpoints, beside the paper's (Tab. realiqm).

The paper's values are of a physical robot, ours of the evaluations in
simulation at the same steps (of shorter profiles, at the same share of the
training). Interquartile means over seeds.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from rrm.envs.tasks import ScoreKind
from rrmctl.planning.profiles import PAPER
from rrmctl.reports import published
from rrmctl.reports.columns import (
    COMPARED,
    METHOD,
    RUNS,
    SCORE,
    STEP,
    Column,
    Row,
    TextGrid,
    estimated,
    number,
    pivoted,
)
from rrmctl.reports.published import Checkpoint
from rrmctl.reports.report import Report, section_report, some
from rrmctl.reports.scores import score
from rrmctl.reports.series import SCORE_COLUMN, Section, Series, ending, finite
from rrmctl.reports.statistics import SURE, Statistics
from rrmctl.store.frame import MAYBE_WHOLE, NUMBER, TEXT, WHOLE

EXPERIMENT = "sim-to-real"
EXPLAINED = (
    "Paper: 5 seeds x 20 episodes on a physical robot. In brackets: ours less the paper's, in percentage points for "
    "success.",
    "Step: the last evaluation up to the paper's checkpoint, or up to the same share of a shorter training.",
)

IQM = estimated("iqm", "IQM")
COLUMNS = (
    *map(Column, COMPARED), METHOD, SCORE, Column("paper_step", WHOLE), Column("step", MAYBE_WHOLE),
    *IQM, *RUNS,
    *(Column(name, NUMBER) for name in ("published", "difference")),
)  # fmt: skip


def make(sections: Sequence[Section], settings: Statistics) -> list[Report]:
    """A table for each section with runs of the simulated robot."""
    reports, source = [], f"Paper: {published.source(EXPERIMENT)}, on a physical robot; ours is of the simulation"
    for section in sections:
        if rows := list(_rows(section, settings)):
            notes = [f"{source}, profile {section.profile}."]
            reports.append(section_report(section, settings, COLUMNS, rows, grid=_grid, notes=notes))
    lacking = f"there are no runs of {', '.join(published.deployed_tasks())}"
    return some(reports, sections, lacking, "`rrmctl list` names what there is to run")


def _rows(section: Section, settings: Statistics) -> Iterator[dict[str, Any]]:
    """A row for each task, method, checkpoint and score; success and its difference as fractions."""
    for series in section.series:
        if series.label.task in published.deployed_tasks():
            for checkpoint in published.checkpoints(series.label.task, series.label.method):
                for kind, theirs in checkpoint.scores.items():
                    row = {
                        **series.label._asdict(), "score": kind, "paper_step": checkpoint.step, "n": 0,
                        "planned": series.planned, "published": theirs,
                    }  # fmt: skip
                    ours = _ours(series, checkpoint, kind, section.profile, settings)
                    yield row | ours | ({"difference": ours["iqm"] - theirs} if ours else {})


def _ours(
    series: Series, checkpoint: Checkpoint, kind: ScoreKind, profile: str, settings: Statistics
) -> dict[str, Any]:
    """What is measured at the evaluation that stands for a checkpoint, where there is one yet.

    There is none of a shorter training under way, of which nobody knows how long it is going to be.
    """
    if not series.n or (profile != PAPER and not series.finished):
        return {}
    steps, values = finite(*series.measure(SCORE_COLUMN[kind]))
    due = checkpoint.step if profile == PAPER else round(checkpoint.share * int(series.rows["step"].max()))
    reached = np.flatnonzero(steps <= due)
    if not reached.size or steps[-1] < due:
        return {}
    here = score([ending(values, reached[-1:], settings.last)], settings).estimate().row("iqm")
    return {"step": int(steps[reached[-1]]), "n": series.n, **here}


def _grid(rows: Sequence[Row]) -> TextGrid:
    """A row for each task, checkpoint and method; success and return beside one another."""
    tasks = list(dict.fromkeys(row["task"] for row in rows))
    places = (
        Column("task", TEXT, "Task"),
        Column("paper_step", TEXT, "Checkpoint", lambda row: f"{row['paper_step']:,}"),
        METHOD,
    )
    return pivoted(
        sorted(rows, key=lambda row: (tasks.index(row["task"]), row["paper_step"])), places,
        lambda row: str(row["score"]).capitalize(),
        {"{}": IQM[0].text, f"{{}}, {SURE}": IQM[1].text, "{}, paper": _beside},
        best="iqm", compared=("task", "paper_step", "score"), beside=[STEP],
    )  # fmt: skip


def _beside(row: Row) -> str:
    """The published value, and the difference to it in brackets."""
    theirs, scale = number(row["published"], row["score"]), 100 if row["score"] == "success" else 1
    missing = math.isnan(row["published"]) or math.isnan(row["difference"])
    return theirs if missing else f"{theirs} ({scale * row['difference']:+.1f})"

"""The simulated rig: success and return of deployed checkpoints, beside the paper's of a physical robot (Tab. realiqm).

The paper's values are of a physical robot; ours of a second simulation, where the policy sees what two cameras make of
the cube. Interquartile means over seeds.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from rrm.envs.tasks import ScoreKind
from rrmctl.labels import policy
from rrmctl.planning.profiles import PAPER
from rrmctl.reports import published
from rrmctl.reports.columns import (
    COMPARED,
    METHOD,
    NOTHING,
    RUNS,
    SCORE,
    Column,
    Row,
    TextGrid,
    estimated,
    number,
    pivoted,
)
from rrmctl.reports.report import Report, section_report, some, undeployed_notes
from rrmctl.reports.scores import score
from rrmctl.reports.series import SCORE_COLUMN, Section, Series, ending, finite
from rrmctl.reports.statistics import SURE, Statistics
from rrmctl.store.frame import MAYBE_WHOLE, NUMBER, TEXT

EXPERIMENTS = ("sim-to-real",)
EXPLAINED = (
    "Simulated rig: another simulation than that of the training, with other masses, friction, motors and latency; two "
    "cameras see the cube. Sim: the last evaluation of the training up to that step, of the seeds that were deployed.",
    "Paper: 5 seeds x 20 episodes on a physical robot. In brackets: ours less the paper's, in percentage points.",
    "Checkpoint: of shorter trainings the same share of the training as the paper's, which stands in brackets.",
    "In our Push and Pick-and-Reach the goal lies beyond the cube; where the paper's may lie it does not say.",
    "Returns cannot be compared with the paper's: it does not say how long an episode is, how often the arm is "
    "commanded, and how high the hand stays in Reach; and those of Push and Pick-and-Reach are below zero, which sums "
    "of its true reward cannot be.",
)

IQM = estimated("iqm", "IQM")
COLUMNS = (
    *map(Column, COMPARED), METHOD, SCORE, Column("paper_step", MAYBE_WHOLE), Column("step", MAYBE_WHOLE),
    *IQM, *RUNS,
    Column("episodes", MAYBE_WHOLE),
    *(Column(name, NUMBER) for name in ("simulation", "published", "difference")),
)  # fmt: skip

#: Our steps are rounded to whole ones.
_ROUNDING = 1


def make(sections: Sequence[Section], settings: Statistics) -> list[Report]:
    """A table for each section with runs of the arm's tasks."""
    reports, source = [], f"Paper: {published.source(*EXPERIMENTS)}, on a physical robot"
    for section in sections:
        if found := list(rows(section, settings)):
            ours = f"ours is of a simulated rig, profile {section.profile}, and an interquartile mean over seeds"
            notes = [f"{source}, an average; {ours}.", *remarks(section)]
            report = section_report(section, settings, COLUMNS, found, grid=_grid, notes=notes)
            reports.append(replace(report, title=f"{report.title} · deployed at the simulated rig"))
    lacking = f"there are no runs of {', '.join(published.deployed_tasks())}"
    return some(reports, sections, lacking, "`rrmctl list` names what there is to run")


def rows(section: Section, settings: Statistics) -> Iterator[dict[str, Any]]:
    """A row for each task, method, checkpoint and score; success and its difference to the paper's as fractions."""
    for series in section.series:
        label = series.label
        if label.task not in published.deployed_tasks():
            continue
        deployed = section.deployment(label)
        own = [] if deployed is None else deployed.steps.tolist()
        theirs = published.checkpoints(label.task, label.method)
        steps = {at.step: _due(series, at.share, section.profile, own) for at in theirs}
        wanted: list[tuple[float, float, dict[ScoreKind, float]]]
        wanted = [(at.step, steps[at.step], at.scores) for at in theirs]
        wanted += [(math.nan, step, {}) for step in own if step not in steps.values()]
        for paper_step, step, scores in wanted:
            there = deployed if deployed is not None and step in own else None
            for kind in ("success", "return"):
                row = {
                    **label._asdict(), "score": kind, "paper_step": paper_step, "step": step, "n": 0,
                    "planned": series.planned if deployed is None else deployed.planned,
                    "published": (value := scores.get(kind, math.nan)),
                    "simulation": _simulated(series, step, kind, settings, None if there is None else there.seeds),
                }  # fmt: skip
                if there is not None:
                    row |= _played(there, int(step), kind, settings)
                    row["difference"] = row["iqm"] - value if kind == "success" else math.nan
                yield row


def _due(series: Series, share: float, profile: str, own: Sequence[int]) -> float:
    """Our step that stands for a share of the paper's training: one that was deployed, where there is one.

    NaN of a shorter training under way, of which nobody knows how long it is going to be.
    """
    if profile != PAPER and not series.finished:
        return math.nan
    length = published.length(series.label.task) if profile == PAPER else int(series.rows["step"].max())
    due = round(share * length)
    return next((step for step in own if abs(step - due) <= _ROUNDING), due)


def _played(deployed: Series, step: int, kind: ScoreKind, settings: Statistics) -> dict[str, Any]:
    """What the policies of a step are worth at the rig."""
    steps, values = deployed.measure(SCORE_COLUMN[kind])
    at = int(np.flatnonzero(steps == step)[0])
    episodes = deployed.rows.loc[deployed.rows["step"] == step, "episodes"]
    measured = score([ending(values, [at], 1)], settings).estimate().row("iqm")
    return {"n": deployed.n, "episodes": int(episodes.max()), **measured}


def _simulated(
    series: Series, step: float, kind: ScoreKind, settings: Statistics, seeds: Collection[int] | None
) -> float:
    """The interquartile mean of the evaluations in training's own simulation, up to a step; NaN before it. Of these
    seeds, or of all.
    """
    if not series.n or math.isnan(step):
        return math.nan
    steps, values = series.measure(SCORE_COLUMN[kind])
    steps, values = finite(steps, values[[seeds is None or seed in seeds for seed in series.seeds]])
    reached = np.flatnonzero(steps <= step)
    if not values.size or not reached.size or steps[-1] < step:
        return math.nan
    return float(score([ending(values, reached[-1:], settings.last)], settings).estimate().row("iqm")["iqm"])


def remarks(section: Section) -> Iterator[str]:
    """What happened at the rig that a reader must know."""
    played = [series for series in section.deployments if series.n]
    if not played:
        yield "Nothing was deployed yet: the runs keep networks for that where `deploy.checkpoints` names their steps."
    yield from undeployed_notes(section)
    if not played:
        return
    told = {
        "lost": "{} ended without success because the cube was lost from sight",
        "breakdowns": "{} times the rig broke down, and the episode was played anew",
    }
    each = sorted({int(count) for series in played for count in series.rows["episodes"]})
    yield f"Deployed: {' or '.join(map(str, each))} episodes of each checkpoint and seed."
    episodes = int(sum(series.rows["episodes"].sum() for series in played))
    for name, words in told.items():
        counts = {series.label: int(series.rows[f"deployed_{name}"].sum()) for series in played}
        if any(counts.values()):
            whose = ", ".join(f"{label.task} {policy(label.method)} {count}" for label, count in counts.items())
            yield f"Of {episodes} episodes {words.format(sum(counts.values()))}: {whose}."


def _grid(rows: Sequence[Row]) -> TextGrid:
    """A row for each task, checkpoint and method; success and return beside one another."""
    tasks = list(dict.fromkeys(row["task"] for row in rows))
    places = (Column("task", TEXT, "Task"), Column("step", TEXT, "Checkpoint", _checkpoint), METHOD)

    def rank(row: Row) -> tuple[int, float]:
        return tasks.index(row["task"]), row["paper_step"] if math.isnan(row["step"]) else row["step"]

    return pivoted(
        sorted(rows, key=rank), places,
        lambda row: str(row["score"]).capitalize(),
        {"{}": IQM[0].text, f"{{}}, {SURE}": IQM[1].text, "{}, sim": _simulation, "{}, paper": _beside},
        best="iqm", compared=("task", "paper_step", "step", "score"),
    )  # fmt: skip


def _checkpoint(row: Row) -> str:
    """Our step, and the paper's where that is another."""
    ours, theirs = ("" if math.isnan(row[name]) else f"{row[name]:,.0f}" for name in ("step", "paper_step"))
    return ours if ours == theirs or not theirs else f"{ours or NOTHING} ({theirs})"


def _simulation(row: Row) -> str:
    return NOTHING if math.isnan(row["simulation"]) else number(row["simulation"], row["score"])


def _beside(row: Row) -> str:
    """The published value, and in brackets by how much ours is above it, in percentage points."""
    theirs = number(row["published"], row["score"])
    return theirs if math.isnan(row["difference"]) else f"{theirs} ({100 * row['difference']:+.1f})"

"""Deployed checkpoints: success at the simulated rig, beside the training's own evaluation and the paper's robot.

A point is the interquartile mean over seeds at the rig, with its bootstrap interval; a hollow circle that of the last
evaluation in training up to that step; a dash is the paper's value, of a physical robot (Tab. realiqm).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from rrmctl.reports.columns import Row
from rrmctl.reports.figure_layout import Axes, Figure, Slot, one_section, sheet
from rrmctl.reports.plot_elements import UNITS, score_axis, short_steps
from rrmctl.reports.series import Section
from rrmctl.reports.statistics import DEFAULTS, SURE, Statistics, Width
from rrmctl.reports.styles import Looks
from rrmctl.reports.tables import sim_to_real
from rrmctl.stats import REPLICATES


def suits(section: Section) -> bool:
    """Some policies were deployed."""
    return any(series.n for series in section.deployments)


def draw(section: Section, settings: Statistics = DEFAULTS) -> Figure:
    """A panel for each task, with its checkpoints from left to right."""
    shown, looks = [row for row in sim_to_real.rows(section, settings) if row["score"] == "success"], section.looks()
    tasks = [task for task in dict.fromkeys(row["task"] for row in shown) if _deployed(shown, task)]
    return sheet(
        section,
        settings,
        [_slot(task, [row for row in shown if row["task"] == task], looks) for task in tasks],
        notes=[
            f"Points: interquartile mean over seeds ({settings.kind}) at a simulated rig, with its {SURE} bootstrap "
            "interval. Hollow: in the training's simulation. Dashes: the paper's, on a physical robot.",
            *sim_to_real.remarks(section),
        ],
        lacking="no deployments",
    )


def deployed_checkpoints(
    rows: pd.DataFrame,
    deployments: tuple[pd.DataFrame, pd.DataFrame],
    jobs: pd.DataFrame | None = None,
    *,
    width: Width = "page",
    replicates: int = REPLICATES,
) -> Figure:
    """The same in a notebook; `deployments`: what `rrmctl.store.load` and `planned` return with `needed=True`."""
    return draw(one_section(rows, jobs, deployments), Statistics(width=width, replicates=replicates))


def _deployed(shown: Sequence[Row], task: str) -> bool:
    return any(row["task"] == task and row["n"] for row in shown)


def _slot(task: str, shown: Sequence[Row], looks: Looks) -> Slot:
    methods = list(dict.fromkeys(row["method"] for row in shown))
    steps = sorted({_place(row) for row in shown})

    def fill(axes: Axes) -> None:
        for at, method in enumerate(methods):
            own = [row for row in shown if row["method"] == method]
            x = np.array([steps.index(_place(row)) for row in own]) + 0.16 * (at - (len(methods) - 1) / 2)
            ours, low, high, sim, paper = (
                [100 * float(row.get(name, math.nan)) for row in own]
                for name in ("iqm", "low", "high", "simulation", "published")
            )
            look: dict[str, Any] = looks[method]._asdict()
            axes.plot(x, ours, **look | {"markersize": 4})
            axes.vlines(x, low, high, color=looks[method].color, linewidth=0.9)
            hollow = {
                "linestyle": "none",
                "marker": "o",
                "markerfacecolor": "white",
                "markersize": 3.5,
                "markeredgewidth": 0.7,
            }
            axes.plot(x, sim, **look | hollow)
            axes.plot(x, paper, **look | {"linestyle": "none", "marker": "_", "markersize": 8})
        axes.set_xticks(range(len(steps)), [short_steps(int(step)) for step in steps])
        axes.set_xlim(-0.5, len(steps) - 0.5)
        score_axis(axes, "success")

    runs = [(method, max(row["n"] for row in shown if row["method"] == method)) for method in methods]
    return Slot(task, UNITS["success"], fill, "Checkpoint (environment steps)", runs)


def _place(row: Row) -> float:
    """Our step, or the paper's where ours is not known yet."""
    return float(row["paper_step"] if math.isnan(row["step"]) else row["step"])

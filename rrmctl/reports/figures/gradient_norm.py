"""Fine-tuning: the norm of the reward network's gradient over steps, across the change from one loss to the other.

Drawn of runs that left `gradients.parquet`: of the method `finetune` and those after it.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from rrmctl.errors import UserError
from rrmctl.reports.figure_layout import Axes, Figure, Slot, one_section, sheet
from rrmctl.reports.plot_elements import curve, panel_name, step_axis
from rrmctl.reports.series import Section, Series
from rrmctl.reports.statistics import DEFAULTS, Statistics, Width
from rrmctl.reports.styles import Looks
from rrmctl.stats import IqmKind
from rrmctl.store.curve import load_gradients

#: Over the length of a run: norms jump from minibatch to minibatch.
_BINS = 60
#: The loss after the change.
_FINE_TUNING = "preferences"


def suits(section: Section) -> bool:
    """Some run left the norms of its gradients."""
    source = section.source
    return source is not None and any(
        source.run(run).gradients.is_file() for series in section.series for run in series.runs
    )


def gradient_norms(
    rows: pd.DataFrame,
    gradients: pd.DataFrame,
    jobs: pd.DataFrame | None = None,
    *,
    kind: IqmKind = "rliable",
    width: Width = "page",
) -> Figure:
    """The same in a notebook; `gradients` as `rrmctl.store.load_gradients` returns it, the rest as everywhere."""
    return draw(one_section(rows, jobs), Statistics(kind=kind, width=width), gradients)


def draw(section: Section, settings: Statistics = DEFAULTS, gradients: pd.DataFrame | None = None) -> Figure:
    """A panel for each task, with the median norm in each sixtieth of the steps, before and after the change."""
    every = [run for series in section.series for run in series.runs]
    if gradients is None:
        if section.source is None:
            where = f"{section.experiment}, profile {section.profile}"
            raise UserError(f"{where}: no gradients beside the curves to draw", "hand them over, as `gradients`")
        gradients = load_gradients(section.source.root, every)
    panels, looks, normed = section.panels(), section.looks(), set(gradients["run"])
    notes = [
        f"Median over the gradient steps in each {_BINS}th of the run, then the interquartile mean over seeds "
        f"({settings.kind}). Band: 25 to 75 % of the seeds. Grey: where the loss changes.",
        f"Norms of {len(normed.intersection(every))} runs.",
    ]
    for series in section.series:
        seeded = zip(series.seeds, series.runs, strict=True)
        lacking = [f"{run} (seed {seed})" for seed, run in seeded if run not in normed]
        if 0 < len(lacking) < series.n:  # others of its series left norms
            notes.append(f"No norms of {series.label}: {', '.join(lacking)}.")
    slots = []
    for panel in panels:
        left = {series: [run for run in series.runs if run in normed] for series in panel.present()}
        if shown := {series: runs for series, runs in left.items() if runs}:
            slots.append(_slot(gradients, panel_name(panel, panels), shown, looks, settings.kind))
    return sheet(section, settings, slots, notes=notes, lacking="no norms of gradients")


def _slot(gradients: pd.DataFrame, name: str, shown: Mapping[Series, list[str]], looks: Looks, kind: IqmKind) -> Slot:
    """A panel of series, with those of their runs that left norms."""
    last = max(int(series.steps[-1]) for series in shown)
    length = last / _BINS

    def fill(axes: Axes) -> None:
        for position, (series, runs) in enumerate(shown.items()):
            own = gradients[gradients["run"].isin(runs)]
            tuned = own["loss"] == _FINE_TUNING
            bins = (own["step"] // length).rename("bin")
            for _, phase in own.groupby(tuned):  # medians of each run where all have one
                medians = phase.groupby([phase["run"], bins])["gradient_norm"].median().unstack("bin")
                norms = medians.reindex(runs).dropna(axis="columns")
                if norms.size:
                    middles = ((norms.columns.to_numpy(dtype=np.float64) + 0.5) * length).astype(np.int64)
                    curve(axes, middles, norms.to_numpy(), looks[series.label.method], kind, position=position)
            before = own["step"][~tuned]
            if len(before):
                axes.axvline(int(before.max()), color="#555555", linewidth=0.8, linestyle=(0, (3, 2)), zorder=1)
        axes.set_yscale("log", nonpositive="clip")
        step_axis(axes, last)

    counts = [(series.label.method, len(runs)) for series, runs in shown.items()]
    return Slot(name, "Norm of the reward's gradient", fill, runs=counts)

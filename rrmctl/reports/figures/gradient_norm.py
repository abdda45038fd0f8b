"""Fine-tuning: the norm of the reward network's gradient over steps, across the change from one loss to the other.

Drawn of runs that left `gradients.parquet`: of the method `finetune` and those after it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

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
    shown = {
        panel_name(panel, panels): [_only(series, normed) for series in panel.present() if normed & {*series.runs}]
        for panel in panels
    }
    notes = [
        f"Median over the gradient steps in each {_BINS}th of the run, then the interquartile mean over seeds "
        f"({settings.kind}). Band: 25 to 75 % of the seeds. Grey: where the loss changes.",
        f"Norms of {len(normed.intersection(every))} runs.",
    ]
    for series in section.series:
        runs = zip(series.seeds, series.runs, strict=True)
        lacking = [f"{run} (seed {seed})" for seed, run in runs if run not in normed]
        if 0 < len(lacking) < series.n:  # others of its series left norms
            notes.append(f"No norms of {series.label}: {', '.join(lacking)}.")
    slots = [_slot(gradients, name, series, looks, settings.kind) for name, series in shown.items() if series]
    return sheet(section, settings, slots, notes=notes, lacking="no norms of gradients")


def _only(series: Series, normed: set[str]) -> Series:
    """The series of those of its runs that left norms."""
    left = [at for at, run in enumerate(series.runs) if run in normed]
    seeds, runs = tuple(series.seeds[at] for at in left), tuple(series.runs[at] for at in left)
    return replace(series, values=series.values[left], seeds=seeds, runs=runs)


def _slot(gradients: pd.DataFrame, name: str, shown: Sequence[Series], looks: Looks, kind: IqmKind) -> Slot:
    last = max(int(series.steps[-1]) for series in shown)
    length = last / _BINS

    def fill(axes: Axes) -> None:
        for position, series in enumerate(shown):
            own = gradients[gradients["run"].isin(series.runs)]
            tuned = own["loss"] == _FINE_TUNING
            bins = (own["step"] // length).rename("bin")
            for _, phase in own.groupby(tuned):  # medians of each run where all have one
                medians = phase.groupby([phase["run"], bins])["gradient_norm"].median().unstack("bin")
                norms = medians.reindex(list(series.runs)).dropna(axis="columns")
                if norms.size:
                    middles = ((norms.columns.to_numpy(dtype=np.float64) + 0.5) * length).astype(np.int64)
                    curve(axes, middles, norms.to_numpy(), looks[series.label.method], kind, position=position)
            before = own["step"][~tuned]
            if len(before):
                axes.axvline(int(before.max()), color="#555555", linewidth=0.8, linestyle=(0, (3, 2)), zorder=1)
        axes.set_yscale("log", nonpositive="clip")
        step_axis(axes, last)

    runs = [(series.label.method, series.n) for series in shown]
    return Slot(name, "Norm of the reward's gradient", fill, runs=runs)
